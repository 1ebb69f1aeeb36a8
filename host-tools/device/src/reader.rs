//! A transport read in its own thread, so that slow output never delays reception.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Instant;

use anyhow::{Result, anyhow};
use firmware::protocol::messages::Message;
use firmware::protocol::serial::Packet;

use crate::source::Source;

/// Result of a read.
pub enum ReaderEvent {
    /// Packets received together.
    Packets {
        /// Time in seconds since the start.
        at_s: f64,
        /// Packets in order.
        packets: Vec<Packet>,
        /// Number of invalid packets so far.
        broken: u32,
    },
    /// End of the stream.
    Ended,
    /// The connection is lost.
    Failed(anyhow::Error),
}

/// Messages that are built when they are sent, so that they can state the age of a measurement.
pub type Outgoing = Box<dyn FnOnce() -> Vec<Message> + Send>;

/// Reader thread.
pub struct SourceReader {
    /// Name of the source.
    pub news: Receiver<ReaderEvent>,
    /// Start time.
    pub begun: Instant,
    /// Messages to the gripper, sent between two reads.
    pub outgoing: Sender<Outgoing>,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Box<dyn Source + Send>>,
}

impl SourceReader {
    /// Starts the thread.
    pub fn start(mut source: Box<dyn Source + Send>) -> Self {
        let (sender, news) = channel();
        let (outgoing, messages) = channel();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let begun = Instant::now();
        let thread = thread::spawn(move || {
            listen(source.as_mut(), begun, &stopped, &messages, &sender);
            source
        });
        Self { news, begun, outgoing, stop, thread }
    }

    /// Seconds since the start.
    pub fn elapsed_s(&self) -> f64 {
        self.begun.elapsed().as_secs_f64()
    }

    /// Stops the thread and returns the source.
    ///
    /// # Errors
    /// The thread panicked.
    pub fn stop(self) -> Result<Box<dyn Source + Send>> {
        self.stop.store(true, Relaxed);
        let source = self.thread.join();
        source.map_err(|_| anyhow!("the thread that reads from the gripper panicked"))
    }
}

fn listen(
    source: &mut dyn Source,
    begun: Instant,
    stop: &AtomicBool,
    messages: &Receiver<Outgoing>,
    sender: &Sender<ReaderEvent>,
) {
    while !stop.load(Relaxed) {
        let mut packets = Vec::new();
        let mut sent = messages.try_iter().flat_map(|build| build());
        let sent = sent.try_for_each(|message| source.send(message));
        let more = sent.and_then(|()| source.receive(&mut packets));
        let packets_event = ReaderEvent::Packets {
            at_s: begun.elapsed().as_secs_f64(),
            packets,
            broken: source.broken(),
        };
        let last = match more {
            Ok(true) => None,
            Ok(false) => Some(ReaderEvent::Ended),
            Err(error) => Some(ReaderEvent::Failed(error)),
        };
        // The receiver is gone: stop.
        let goes_on = last.is_none();
        let taken = [Some(packets_event), last].into_iter().flatten();
        let wanted = taken.map(|news| sender.send(news)).all(|sent| sent.is_ok());
        if !(goes_on && wanted) {
            return;
        }
    }
}

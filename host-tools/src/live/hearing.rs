//! A source heard in a thread of its own: whoever writes files or draws must not keep the line waiting.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Instant;

use anyhow::{Result, anyhow};
use firmware::wire::serial::Packet;

use super::source::Source;

/// What a source gave.
pub enum News {
    /// Packets that came together.
    Heard {
        /// When, since hearing began, in seconds.
        at_s: f64,
        /// In their order.
        packets: Vec<Packet>,
        /// Packets so far that were not understood.
        broken: u32,
    },
    /// Nothing will come any more.
    Ended,
    /// The line or the bus is gone.
    Failed(anyhow::Error),
}

/// The thread.
pub struct Hearing {
    /// What it hears.
    pub news: Receiver<News>,
    /// When it began.
    pub begun: Instant,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Box<dyn Source>>,
}

impl Hearing {
    /// Begins.
    pub fn start(mut source: Box<dyn Source>) -> Self {
        let (sender, news) = channel();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let begun = Instant::now();
        let thread = thread::spawn(move || {
            listen(source.as_mut(), begun, &stopped, &sender);
            source
        });
        Self {
            news,
            begun,
            stop,
            thread,
        }
    }

    /// Seconds since it began.
    pub fn elapsed_s(&self) -> f64 {
        self.begun.elapsed().as_secs_f64()
    }

    /// Ends it and gives the source back.
    ///
    /// # Errors
    /// The thread broke off.
    pub fn stop(self) -> Result<Box<dyn Source>> {
        self.stop.store(true, Relaxed);
        let source = self.thread.join();
        source.map_err(|_| anyhow!("the thread that hears the gripper broke off"))
    }
}

fn listen(source: &mut dyn Source, begun: Instant, stop: &AtomicBool, sender: &Sender<News>) {
    while !stop.load(Relaxed) {
        let mut packets = Vec::new();
        let more = source.hear(&mut packets);
        let heard = News::Heard {
            at_s: begun.elapsed().as_secs_f64(),
            packets,
            broken: source.broken(),
        };
        let last = match more {
            Ok(true) => None,
            Ok(false) => Some(News::Ended),
            Err(error) => Some(News::Failed(error)),
        };
        // Where nobody takes the news, nobody wants to hear.
        let goes_on = last.is_none();
        let taken = [Some(heard), last].into_iter().flatten();
        let wanted = taken.map(|news| sender.send(news)).all(|sent| sent.is_ok());
        if !(goes_on && wanted) {
            return;
        }
    }
}

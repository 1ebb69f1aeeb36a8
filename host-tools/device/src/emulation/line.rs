//! Serial line of an emulated board as a transport, for programs that run in the board's own time.

use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;

use anyhow::{Context, Result};
use firmware::protocol::messages::Message;
use firmware::protocol::serial::{MAX_PACKET_BYTES, Packet, PacketDecoder, encode};
use sim::board::serial::SerialLink;

use crate::source::Source;

/// Time that the board runs for each look at its line.
const LOOK: Duration = Duration::from_millis(3);
/// Time of a step.
const STEP: Duration = Duration::from_millis(1);

/// The line, and how the board goes on.
pub struct EmulatedLine<S> {
    link: Rc<RefCell<SerialLink>>,
    decoder: PacketDecoder,
    /// Runs the board for [`STEP`].
    step: S,
    /// Time of the board, and of the host, which is ahead by less than a step.
    times: [Duration; 2],
}

impl<S: FnMut() -> Result<()>> EmulatedLine<S> {
    /// The line of a board that `step` runs for a millisecond.
    pub fn new(link: Rc<RefCell<SerialLink>>, step: S) -> Self {
        Self { link, decoder: PacketDecoder::default(), step, times: [Duration::ZERO; 2] }
    }
}

impl<S: FnMut() -> Result<()>> Source for EmulatedLine<S> {
    fn receive(&mut self, packets: &mut Vec<Packet>) -> Result<bool> {
        self.pause(LOOK)?;
        let mut line = self.link.borrow_mut();
        line.ended.clear();
        let bytes = std::mem::take(&mut line.sent);
        packets.extend(bytes.into_iter().filter_map(|byte| self.decoder.push(byte)));
        Ok(true)
    }

    fn send(&mut self, message: Message) -> Result<()> {
        let mut buffer = [0; MAX_PACKET_BYTES];
        let packet = Packet::Message { copy: 0, message };
        let bytes = encode(&packet, &mut buffer).context("the message does not fit a packet")?;
        let mut line = self.link.borrow_mut();
        bytes.iter().for_each(|byte| line.put(*byte));
        Ok(())
    }

    fn broken(&self) -> u32 {
        self.decoder.broken
    }

    fn name(&self) -> String {
        "emulated board".to_owned()
    }

    fn now(&self) -> Duration {
        self.times[1]
    }

    fn pause(&mut self, time: Duration) -> Result<()> {
        self.times[1] += time;
        while self.times[0] + STEP <= self.times[1] {
            (self.step)()?;
            self.times[0] += STEP;
        }
        Ok(())
    }
}

//! Serial line of an emulated board as a transport, for programs that run in the board's own time.

use std::cell::RefCell;
use std::rc::Rc;

use anyhow::{Context, Result};
use firmware::protocol::messages::Message;
use firmware::protocol::serial::{MAX_PACKET_BYTES, Packet, PacketDecoder, encode};
use sim::board::serial::SerialLink;

use crate::source::Source;

/// The line, and how the board goes on.
pub struct EmulatedLine<S> {
    link: Rc<RefCell<SerialLink>>,
    decoder: PacketDecoder,
    /// Runs the board for a few milliseconds.
    step: S,
}

impl<S: FnMut() -> Result<()>> EmulatedLine<S> {
    /// The line of a board that `step` runs on.
    pub fn new(link: Rc<RefCell<SerialLink>>, step: S) -> Self {
        Self { link, decoder: PacketDecoder::default(), step }
    }
}

impl<S: FnMut() -> Result<()>> Source for EmulatedLine<S> {
    fn receive(&mut self, packets: &mut Vec<Packet>) -> Result<bool> {
        (self.step)()?;
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
}

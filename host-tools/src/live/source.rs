//! Where a gripper's packets come from.

use std::time::Duration;

use anyhow::Result;
use firmware::wire::identifier;
use firmware::wire::messages::Message;
use firmware::wire::serial::Packet;

/// How long [`Source::hear`] waits at the most.
pub const WAIT: Duration = Duration::from_millis(50);

/// A gripper at the other end.
pub trait Source: Send {
    /// Adds what has come, in its order; false where nothing will come any more.
    ///
    /// # Errors
    /// The line or the bus is gone.
    fn hear(&mut self, packets: &mut Vec<Packet>) -> Result<bool>;

    /// Says something to the gripper.
    ///
    /// # Errors
    /// The line or the bus did not take it.
    fn say(&mut self, message: Message) -> Result<()>;

    /// Packets so far that were not understood.
    fn broken(&self) -> u32;

    /// As people call it.
    fn name(&self) -> String;
}

/// The packet that says what a frame of a node says; `None` where it is another's, or no message.
pub fn packet(node: u16, id: u16, data: &[u8]) -> Option<Packet> {
    let number = (id & 0x1F) as u8;
    if identifier(node, number) != id {
        return None;
    }
    let message = Message::from_frame(number, data).ok()?;
    let copy = number.checked_sub(message.layout().number)?;
    Some(Packet::Message { copy, message })
}

#[cfg(test)]
mod tests {
    use firmware::wire::DEFAULT_NODE;
    use firmware::wire::layout::Direction;
    use firmware::wire::messages::LAYOUTS;

    use super::*;

    #[test]
    fn every_frame_of_the_table_is_the_packet_that_the_serial_line_would_carry() {
        let mut frames = 0;
        for layout in LAYOUTS {
            for (copy, number) in (0..).zip(layout.numbers()) {
                let data = (layout.used() & 0x0123_4567_89AB_CDEF).to_le_bytes();
                let heard = packet(DEFAULT_NODE, identifier(DEFAULT_NODE, number), &data);
                let Some(Packet::Message {
                    copy: told,
                    message,
                }) = heard
                else {
                    panic!("{} is not heard", layout.name);
                };
                assert_eq!((told, message.to_bytes()), (copy, data), "{}", layout.name);
                frames += usize::from(layout.direction == Direction::Out);
            }
        }
        assert_eq!(frames, 14);
    }

    #[test]
    fn frames_of_others_and_what_is_no_message_are_not_heard() {
        let id = identifier(DEFAULT_NODE, 0x01);
        assert!(packet(DEFAULT_NODE, id, &[0; 8]).is_some());
        assert!(packet(DEFAULT_NODE + 1, id, &[0; 8]).is_none());
        assert!(packet(DEFAULT_NODE, id, &[0; 7]).is_none());
        assert!(packet(DEFAULT_NODE, identifier(DEFAULT_NODE, 0x1F), &[0; 8]).is_none());
    }
}

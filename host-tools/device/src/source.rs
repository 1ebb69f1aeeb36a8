//! Transport of packets from and to a gripper, and requests with their replies over it.

use std::sync::LazyLock;
use std::thread::sleep;
use std::time::{Duration, Instant};
use std::{fmt, io};

use anyhow::{Result, bail};
use firmware::protocol::frame_id;
use firmware::protocol::messages::Message;
use firmware::protocol::serial::Packet;

/// Maximum waiting time of [`Source::receive`].
pub const WAIT: Duration = Duration::from_millis(50);

/// Time without a message after which a gripper counts as unreachable: 30 heartbeats.
pub const SILENCE: Duration = Duration::from_secs(3);

/// The connection to the gripper has ended, or nothing arrives any more: where, and what to check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConnectionLost(pub String);

impl ConnectionLost {
    /// Of a connection on which nothing has arrived.
    pub fn unreachable(name: &str) -> Self {
        Self(format!(
            "{name}: no gripper replies; is this the right line or bus, is the board powered, and is its firmware running?"
        ))
    }

    /// Of a connection on which nothing arrives any more.
    pub fn silent(name: &str) -> Self {
        Self(format!(
            "{name}: no message for {} s; check the cable, and whether the board is powered",
            SILENCE.as_secs()
        ))
    }
}

impl fmt::Display for ConnectionLost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "connection lost: {}", self.0)
    }
}

impl std::error::Error for ConnectionLost {}

/// Connection to a gripper.
pub trait Source {
    /// Appends received packets in order; returns false at the end of a replayed recording.
    ///
    /// # Errors
    /// The connection is lost ([`ConnectionLost`]).
    fn receive(&mut self, packets: &mut Vec<Packet>) -> Result<bool>;

    /// Sends a message to the gripper.
    ///
    /// # Errors
    /// The connection is lost or does not accept the message.
    fn send(&mut self, message: Message) -> Result<()>;

    /// Number of invalid packets so far.
    fn broken(&self) -> u32;

    /// Name for messages to people.
    fn name(&self) -> String;

    /// Time from any origin, for timeouts: that of this machine, or of the board where it is emulated.
    fn now(&self) -> Duration {
        static ORIGIN: LazyLock<Instant> = LazyLock::new(Instant::now);
        ORIGIN.elapsed()
    }

    /// Waits for this time.
    ///
    /// # Errors
    /// The connection is lost.
    fn pause(&mut self, time: Duration) -> Result<()> {
        sleep(time);
        Ok(())
    }
}

/// Whether a read or a write has only to be tried again.
pub(crate) fn is_pending(error: &io::Error) -> bool {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), WouldBlock | TimedOut | Interrupted)
}

/// Messages that arrive within [`WAIT`], without ticks.
///
/// # Errors
/// The connection is lost or closed.
pub(crate) fn receive_messages(source: &mut dyn Source) -> Result<Vec<Message>> {
    let mut packets = Vec::new();
    if !source.receive(&mut packets)? && packets.is_empty() {
        bail!("{}: connection closed", source.name());
    }
    let message = |packet| match packet {
        Packet::Message { message, .. } => Some(message),
        Packet::Tick(_) => None,
    };
    Ok(packets.into_iter().filter_map(message).collect())
}

/// Sends a request up to `attempts` times and waits for a reply for `timeout` each time.
///
/// # Errors
/// No reply, or the connection is lost.
pub(crate) fn request<T>(
    source: &mut dyn Source,
    message: Message,
    (timeout, attempts): (Duration, u32),
    reply_of: impl Fn(&Message) -> Option<T>,
) -> Result<T> {
    for _ in 0..attempts {
        if let Some(reply) = request_once(source, message, timeout, &reply_of)? {
            return Ok(reply);
        }
    }
    Err(ConnectionLost::unreachable(&source.name()).into())
}

/// Sends a request once; `None` without a reply within `timeout`.
///
/// # Errors
/// The connection is lost.
pub(crate) fn request_once<T>(
    source: &mut dyn Source,
    message: Message,
    timeout: Duration,
    reply_of: impl Fn(&Message) -> Option<T>,
) -> Result<Option<T>> {
    source.send(message)?;
    let sent = source.now();
    while source.now() < sent + timeout {
        if let Some(reply) = receive_messages(source)?.iter().find_map(&reply_of) {
            return Ok(Some(reply));
        }
    }
    Ok(None)
}

/// Packet for a CAN frame of a node; `None` for other identifiers or invalid frames.
pub fn packet(node: u16, id: u16, data: &[u8]) -> Option<Packet> {
    let number = (id & 0x1F) as u8;
    if frame_id(node, number) != id {
        return None;
    }
    let message = Message::from_frame(number, data).ok()?;
    let copy = number.checked_sub(message.layout().number)?;
    Some(Packet::Message { copy, message })
}

#[cfg(test)]
mod tests {
    use firmware::protocol::DEFAULT_NODE;
    use firmware::protocol::layout::Direction;
    use firmware::protocol::messages::LAYOUTS;

    use super::*;

    #[test]
    fn every_frame_equals_the_packet_of_the_serial_line() {
        let mut frames = 0;
        for layout in LAYOUTS {
            for (copy, number) in (0..).zip(layout.numbers()) {
                let data = (layout.used() & 0x0123_4567_89AB_CDEF).to_le_bytes();
                let received = packet(DEFAULT_NODE, frame_id(DEFAULT_NODE, number), &data);
                let Some(Packet::Message { copy: actual, message }) = received else {
                    panic!("{} has no packet", layout.name);
                };
                assert_eq!((actual, message.to_bytes()), (copy, data), "{}", layout.name);
                frames += usize::from(layout.direction == Direction::Out);
            }
        }
        assert_eq!(frames, 14);
    }

    #[test]
    fn foreign_and_invalid_frames_have_no_packet() {
        let id = frame_id(DEFAULT_NODE, 0x01);
        assert!(packet(DEFAULT_NODE, id, &[0; 8]).is_some());
        assert!(packet(DEFAULT_NODE + 1, id, &[0; 8]).is_none());
        assert!(packet(DEFAULT_NODE, id, &[0; 7]).is_none());
        assert!(packet(DEFAULT_NODE, frame_id(DEFAULT_NODE, 0x1F), &[0; 8]).is_none());
    }
}

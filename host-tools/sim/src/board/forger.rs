//! A host without the key that floods the bus.

use std::cell::RefCell;

use firmware::grip::commands::mode;
use firmware::protocol::can::CanFrame;
use firmware::protocol::messages::{Authentication, Command, Message};
use firmware::protocol::{DEFAULT_NODE, frame_id};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::board::can::CanBus;
use crate::random::{Purpose, stream};

/// Sends authentications with random counters and codes, each before a command that would open the fingers at full speed.
pub struct Forger {
    rng: ChaCha8Rng,
    is_command: bool,
}

impl Forger {
    /// With random numbers of this seed.
    pub fn new(seed: u64) -> Self {
        Self { rng: stream(seed, Purpose::FaultInjection, 0), is_command: false }
    }

    /// Puts frames on the bus.
    pub fn flood(&mut self, bus: &RefCell<CanBus>, frames: u32) {
        for _ in 0..frames {
            let message = if self.is_command {
                Message::Command(Command {
                    mode: mode::MOVE,
                    position: 1600,
                    speed: 232,
                    ..Command::default()
                })
            } else {
                let (tag_low, tag_high) = (self.rng.random(), self.rng.random());
                let counter = self.rng.random_range(0..1 << 24);
                Message::Authentication(Authentication { counter, tag_low, tag_high })
            };
            self.is_command = !self.is_command;
            let id = frame_id(DEFAULT_NODE, message.number());
            bus.borrow_mut().put(CanFrame::from_bytes(id, message.to_bytes()));
        }
    }
}

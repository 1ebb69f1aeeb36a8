//! What is told of a millisecond.

use super::states::{Power, Task};
use super::{Grip, Inputs, Outputs};
use crate::wire::messages::GripStatus;

/// What the messages call an object.
mod object {
    /// Moving.
    pub const MOVING: u8 = 0;
    /// Contact while opening.
    pub const WHILE_OPENING: u8 = 1;
    /// Contact while closing.
    pub const WHILE_CLOSING: u8 = 2;
    /// At position.
    pub const AT_POSITION: u8 = 3;
}

/// Counts of the bus for one unit: position, speed, force, current.
const PER_UNIT: [f32; 4] = match GripStatus::LAYOUT.fields {
    [position, speed, force, current, ..] => [
        position.counts_per_unit() as f32,
        speed.counts_per_unit() as f32,
        force.counts_per_unit() as f32,
        current.counts_per_unit() as f32,
    ],
    _ => [0.0; 4],
};

impl Grip {
    pub(super) fn tell(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        outputs.state = self.state();
        let motor = &inputs.motor;
        let [per_mm, per_mm_s, per_n, per_a] = PER_UNIT;
        outputs.status = GripStatus {
            position: (motor.opening_mm.unwrap_or_default() * per_mm) as u16,
            speed: (-motor.closing_mm_s * per_mm_s) as i16,
            force: (self.force_n * per_n) as i16,
            current: (motor.current.q * per_a) as i16,
            object: self.object(),
            ..GripStatus::default()
        };
        let is_foot = self.power == Power::Enabled && self.task == Task::Foot;
        outputs.foot = is_foot.then(|| self.standing.message());
    }

    fn object(&self) -> u8 {
        let is_enabled = self.power == Power::Enabled;
        match self.task {
            task if is_enabled && task.moves() => object::MOVING,
            Task::Stopping if is_enabled => object::MOVING,
            _ if !self.contact.is_believed() => object::AT_POSITION,
            Task::ContactStop | Task::Idle if self.is_opening => object::WHILE_OPENING,
            _ => object::WHILE_CLOSING,
        }
    }
}

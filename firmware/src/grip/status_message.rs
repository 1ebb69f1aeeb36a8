//! Status message of one control step.

use crate::grip::GripController;
use crate::grip::interface::{ControlInputs, ControlOutputs};
use crate::grip::states::{PowerState, TaskState};
use crate::protocol::OPENING_UNKNOWN;
use crate::protocol::messages::GripStatus;

/// Values of the field `object` of [`GripStatus`].
mod object {
    pub const MOVING: u8 = 0;
    pub const CONTACT_WHILE_OPENING: u8 = 1;
    pub const CONTACT_WHILE_CLOSING: u8 = 2;
    pub const AT_POSITION: u8 = 3;
}

/// Bus counts per unit of position, speed, force and current.
const PER_UNIT: [f32; 4] = match GripStatus::LAYOUT.signals {
    [position, speed, force, current, ..] => [
        position.counts_per_unit() as f32,
        speed.counts_per_unit() as f32,
        force.counts_per_unit() as f32,
        current.counts_per_unit() as f32,
    ],
    _ => [0.0; 4],
};

impl GripController {
    /// Fills in state code and messages.
    pub(super) fn report(&mut self, inputs: &ControlInputs, outputs: &mut ControlOutputs) {
        outputs.state = self.state();
        let motor = &inputs.motor;
        let [per_mm, per_mm_s, per_n, per_a] = PER_UNIT;
        outputs.status = GripStatus {
            position: motor.opening_mm.map_or(OPENING_UNKNOWN, |mm| (mm * per_mm) as u16),
            speed: (-motor.closing_mm_s * per_mm_s) as i16,
            force: (self.contact.force_n() * per_n) as i16,
            current: (motor.current.q * per_a) as i16,
            object: self.object(),
            ..GripStatus::default()
        };
        let is_foot = self.power() == PowerState::Enabled && self.task() == TaskState::Foot;
        outputs.foot = is_foot.then(|| self.ground_contact().message());
    }

    fn object(&self) -> u8 {
        let is_enabled = self.power() == PowerState::Enabled;
        match self.task() {
            task if is_enabled && task.moves() => object::MOVING,
            TaskState::Stopping if is_enabled => object::MOVING,
            _ if !self.contact.detector().is_confirmed() => object::AT_POSITION,
            TaskState::ContactStop | TaskState::Idle if self.task.is_opening() => {
                object::CONTACT_WHILE_OPENING
            }
            _ => object::CONTACT_WHILE_CLOSING,
        }
    }
}

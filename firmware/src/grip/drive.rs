//! The set-point that each state asks for.

use super::home::Step;
use super::law;
use super::react::Reaction;
use super::states::{Power, Task};
use super::{Grip, PEAK_A};
use crate::motor::number::within;
use crate::motor::{Setpoint, Telling};
use crate::params;

/// The law takes no contact for softer than this, in newtons to the millimetre: the noise of the force would
/// shake the fingers.
const SOFTEST: f32 = 50.0;
/// A force that is right is kept by the mean of the last forces, and the loop is slower by this factor.
const CALM: f32 = 4.0;
/// Speed in mm/s at which a place is taken up again.
const PLACE_MM_S: f32 = 5.0;
/// Milliseconds of a force that is right after which a hold's current falls.
const RELAX_MS: u32 = 100;
/// What is left of the difference with each millisecond.
const RELAXES: f32 = 0.99;
/// A hold's current falls, and a screw that locks itself holds alone, once the mean force is off by less than so
/// many times what moves nothing.
pub(super) const RELAXED: f32 = 1.5;
/// Current of a hold over what it takes by the screw's friction as it is assumed.
const MARGIN: f32 = 1.4;
/// What the margin grows by where it was too small.
const MARGIN_GROWS: f32 = 1.25;

/// The current of a hold: friction helps it, so that it takes less than the grip did.
#[derive(Clone, Copy, Debug)]
pub struct Hold {
    right_ms: u32,
    most_a: f32,
    margin: f32,
}

impl Default for Hold {
    fn default() -> Self {
        Self {
            right_ms: 0,
            most_a: PEAK_A,
            margin: MARGIN,
        }
    }
}

impl Hold {
    /// The greatest current for this millisecond: `needed_a` is what the screw takes, `flows_a` what flows.
    fn most_a(&mut self, is_right: bool, needed_a: f32, flows_a: f32) -> f32 {
        if !is_right {
            if self.right_ms > RELAX_MS {
                self.margin *= MARGIN_GROWS;
            }
            (self.right_ms, self.most_a) = (0, PEAK_A);
            return PEAK_A;
        }
        self.right_ms = self.right_ms.saturating_add(1);
        if self.right_ms > RELAX_MS {
            let from_a = self.most_a.min(flows_a.max(needed_a));
            let to_a = (needed_a * self.margin).min(PEAK_A);
            self.most_a = to_a + (from_a - to_a).max(0.0) * RELAXES;
        }
        self.most_a
    }
}

impl Grip {
    /// What the motor is asked to do.
    pub(super) fn drive(&mut self, motor: &Telling) -> Setpoint {
        match self.power {
            Power::Boot
            | Power::SelfTest
            | Power::Safe
            | Power::ArmPending
            | Power::Calibrating => Setpoint::Off,
            Power::Fault => match self.reaction {
                Reaction::Brake => Setpoint::Brake,
                _ => Setpoint::Off,
            },
            Power::Armed => match self.is_gripped && !self.locks {
                true => self.keep(motor, self.hold_a.max(self.needed_a() * MARGIN)),
                false => Setpoint::Off,
            },
            Power::QuickStop if self.task == Task::Foot => self.stand(motor),
            // What presses so much may be harder than what was gripped.
            Power::QuickStop if self.backs_off => {
                self.press(self.limits.backed_off_n, law::HARDEST)
            }
            Power::QuickStop => STILL,
            Power::FaultReaction => match self.reaction {
                Reaction::Brake => Setpoint::Brake,
                _ => Setpoint::Off,
            },
            Power::Enabled => self.drive_task(motor),
        }
    }

    fn drive_task(&mut self, motor: &Telling) -> Setpoint {
        match self.task {
            Task::Unhomed => Setpoint::Off,
            Task::Homing => match self.home_step {
                Step::Drive(setpoint) => setpoint,
                _ => STILL,
            },
            Task::Moving | Task::Releasing => Setpoint::Position {
                opening_mm: self.way.opening_mm,
                speed_mm_s: self.way.speed_mm_s,
                most_a: PEAK_A,
            },
            Task::Approach => self.approach(motor),
            Task::Force => self.press(self.set_n, self.stiffness.told().max(SOFTEST)),
            Task::HoldActive => self.hold_active(motor),
            Task::HoldLatched => self.let_go(),
            Task::HoldFrozen => match self.locks {
                true => Setpoint::Off,
                false => self.keep(motor, self.hold_a),
            },
            Task::Foot => self.stand(motor),
            Task::ContactStop | Task::Stopping => STILL,
            Task::Idle | Task::NoObject | Task::GripFailed | Task::Lost | Task::TimeoutHold => {
                self.keep(motor, PEAK_A)
            }
        }
    }

    fn approach(&mut self, motor: &Telling) -> Setpoint {
        let most_mm_s = match self.is_far(motor) {
            true => law::FASTEST,
            false => law::approach_mm_s(self.set_n),
        };
        let most_mm_s = most_mm_s.min(self.grip.most_mm_s);
        let closing_mm_s = match self.contact.is_suspected() {
            true => law::closing_mm_s(self.set_n - self.force_n, law::HARDEST, most_mm_s),
            false => most_mm_s,
        };
        Setpoint::Speed {
            closing_mm_s,
            most_a: PEAK_A,
        }
    }

    /// Towards a force in newtons, at a contact of some newtons to the millimetre.
    fn press(&self, set_n: f32, stiffness: f32) -> Setpoint {
        let most_mm_s = law::approach_mm_s(set_n).min(self.grip.most_mm_s);
        Setpoint::Speed {
            closing_mm_s: law::closing_mm_s(set_n - self.force_n, stiffness, most_mm_s),
            most_a: PEAK_A,
        }
    }

    fn hold_active(&mut self, motor: &Telling) -> Setpoint {
        let dead_n = self.limits.dead_n.max(self.limits.dead * self.set_n);
        let right_n = self.limits.right_n.max(self.limits.right * self.set_n);
        let raw_n = self.set_n - self.force_n;
        let missing_n = match raw_n.abs() < right_n {
            true => self.set_n - self.mean_n,
            false => raw_n,
        };
        let beyond_n = missing_n - within(missing_n, -dead_n, dead_n);
        let slower = if raw_n.abs() < right_n { CALM } else { 1.0 };
        let stiffness = self.stiffness.told().max(SOFTEST) * slower;
        let most_mm_s = law::approach_mm_s(self.set_n).min(self.grip.most_mm_s);
        let flows_a = motor.asked.q.abs();
        let most_a = self
            .hold
            .most_a(missing_n.abs() < RELAXED * dead_n, self.needed_a(), flows_a);
        self.hold_a = flows_a;
        Setpoint::Speed {
            closing_mm_s: law::closing_mm_s(beyond_n, stiffness, most_mm_s),
            most_a,
        }
    }

    /// The screw holds alone: the current falls to nothing.
    fn let_go(&self) -> Setpoint {
        let ramp_ms = self.limits.ramp_ms;
        match ramp_ms.saturating_sub(self.task_ms) {
            0 => Setpoint::Off,
            left_ms => Setpoint::Current {
                closing_a: self.hold_a * left_ms as f32 / ramp_ms as f32,
            },
        }
    }

    /// A foot: off, or kept where it is by little current.
    fn stand(&self, motor: &Telling) -> Setpoint {
        match self.locks {
            true => Setpoint::Off,
            false => self.keep(motor, self.limits.foot_a),
        }
    }

    /// Where the fingers are; as long as they do not rest, they are stopped.
    fn keep(&self, motor: &Telling, most_a: f32) -> Setpoint {
        match (self.place_mm, motor.opening_mm) {
            (Some(opening_mm), Some(_)) => Setpoint::Position {
                opening_mm,
                speed_mm_s: PLACE_MM_S,
                most_a,
            },
            _ => Setpoint::Speed {
                closing_mm_s: 0.0,
                most_a,
            },
        }
    }

    /// Amperes that hold the force against turning back, dry friction not counted on.
    fn needed_a(&self) -> f32 {
        const TORQUE_NM_A: f32 = params::TORQUE_CONSTANT.value as f32;
        self.screw.holding_nm(self.force_n, 0.0) / TORQUE_NM_A
    }
}

/// Stops.
const STILL: Setpoint = Setpoint::Speed {
    closing_mm_s: 0.0,
    most_a: PEAK_A,
};

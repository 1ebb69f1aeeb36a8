//! What the forces of the fingers and the motor show: the force and its mean, contact, rest, load of a foot.

use crate::grip::commands::GripProfile;
use crate::grip::contact::ContactDetector;
use crate::grip::debounce::{next_ms, next_ticks};
use crate::grip::finger_force::{BeyondRange, FingerForce, FingerForces};
use crate::grip::ground_contact::{GroundContact, GroundContactDetector};
use crate::grip::interface::{ControlInputs, GripSettings};
use crate::grip::rise::RiseDetector;
use crate::grip::stall_detector::VelocityFilter;
use crate::math::{greater, lesser};
use crate::motor::MotorStatus;
use crate::motor::calibration::{CalibrationFailure, CalibrationKind};

/// Time constant of the mean force, in steps.
pub(super) const MEAN_TICKS: f32 = 16.0;
/// Difference of the fingers' forces in newtons up to which a hold controls their mean: one that reads low raises the force by at
/// most half of it.
const SYMMETRIC_N: f32 = 2.0;

/// Observes the fingers; the other parts only read it.
#[derive(Clone, Debug, Default)]
pub(super) struct ContactObserver {
    fingers: FingerForces,
    /// Last valid force.
    force_n: f32,
    force_rise: RiseDetector,
    rise_n: f32,
    /// Force beyond the range of the model.
    beyond: BeyondRange,
    /// Rotor position in radians at the contact of a calibration.
    touched_rad: Option<f32>,
    /// Mean force of each finger in newtons; none while it is invalid.
    means_n: [Option<f32>; 2],
    mean_n: f32,
    invalid_ticks: u8,
    lost_ticks: u8,
    valid_ms: u16,
    detector: ContactDetector,
    ground_detector: GroundContactDetector,
    ground: GroundContact,
    unloaded_ms: u16,
    velocity: VelocityFilter,
    resting_ms: u16,
}

impl ContactObserver {
    /// Adds one millisecond. `is_unloaded`: nothing is gripped and nothing moves, so that a force is a drift of the sensors;
    /// `is_tared`: the forces are not comparable with earlier ones.
    pub(super) fn update(
        &mut self,
        inputs: &ControlInputs,
        settings: &GripSettings,
        is_unloaded: bool,
        is_tared: bool,
    ) {
        let GripSettings { limits, .. } = settings;
        self.fingers = FingerForces::of(inputs.estimates);
        let valid_n = self.fingers.max_n();
        self.invalid_ticks = next_ticks(self.invalid_ticks, valid_n.is_none());
        self.lost_ticks = next_ticks(self.lost_ticks, self.fingers.are_lost());
        self.valid_ms = next_ms(self.valid_ms, valid_n.is_some());
        if let Some(force_n) = valid_n {
            self.force_n = force_n;
            self.update_means();
            self.detector.update(force_n, limits);
            self.rise_n = self.force_rise.update(force_n);
            if is_unloaded {
                self.force_rise.follow(force_n);
            }
        }
        if is_tared {
            self.force_rise = RiseDetector::default();
        }
        self.beyond.update(inputs.estimates, limits);
        let motor = &inputs.motor;
        let speed_mm_s = self.velocity.update(motor.closing_mm_s);
        self.resting_ms = next_ms(self.resting_ms, speed_mm_s.abs() < limits.resting_mm_s);
        self.ground = self.ground_detector.update(
            inputs.estimates,
            inputs.acceleration,
            motor.opening_mm,
            limits,
        );
        self.unloaded_ms = next_ms(self.unloaded_ms, self.ground.is_unloaded);
    }

    fn update_means(&mut self) {
        let fingers = [self.fingers.left, self.fingers.right];
        for (mean_n, finger) in self.means_n.iter_mut().zip(fingers) {
            *mean_n = match (finger, *mean_n) {
                (FingerForce::Valid(now_n), Some(mean_n)) => {
                    Some(mean_n + (now_n - mean_n) / MEAN_TICKS)
                }
                (FingerForce::Valid(now_n), None) => Some(now_n),
                _ => None,
            };
        }
        self.mean_n = match self.means_n {
            // A field that is the same at both fingers, as of the Earth, raises one and lowers the other.
            [Some(left_n), Some(right_n)] => {
                greater(left_n, right_n) - 0.5 * lesser((left_n - right_n).abs(), SYMMETRIC_N)
            }
            [Some(one_n), None] | [None, Some(one_n)] => one_n,
            [None, None] => self.force_n,
        };
    }

    pub(super) const fn fingers(&self) -> &FingerForces {
        &self.fingers
    }

    /// Last valid force in newtons, the greater of both fingers.
    pub(super) const fn force_n(&self) -> f32 {
        self.force_n
    }

    /// Rise of the force in newtons since the fingers were last unloaded.
    pub(super) const fn rise_n(&self) -> f32 {
        self.rise_n
    }

    /// Mean of both fingers' mean forces in newtons, less than the greater by half of [`SYMMETRIC_N`] at most; the greater of two
    /// noisy forces would be biased.
    pub(super) const fn mean_n(&self) -> f32 {
        self.mean_n
    }

    /// Contact of the fingers.
    pub(super) const fn detector(&self) -> &ContactDetector {
        &self.detector
    }

    /// Contact of the fingertips with the ground.
    pub(super) const fn ground(&self) -> &GroundContact {
        &self.ground
    }

    /// Whether a finger has a valid force in this millisecond.
    pub(super) const fn is_valid(&self) -> bool {
        self.invalid_ticks == 0
    }

    /// Milliseconds with a valid force.
    pub(super) const fn valid_ms(&self) -> u16 {
        self.valid_ms
    }

    /// Whether neither finger has had a valid force for [`crate::config::limits::GripLimits::invalid_ticks`].
    pub(super) const fn is_blind(&self, settings: &GripSettings) -> bool {
        self.invalid_ticks >= settings.limits.invalid_ticks
    }

    /// As [`Self::is_blind`], and not because of a disturbance.
    pub(super) const fn is_lost(&self, settings: &GripSettings) -> bool {
        self.lost_ticks >= settings.limits.invalid_ticks
    }

    /// Whether a force is excessive, also one beyond the range of the model.
    pub(super) fn is_over(&self, settings: &GripSettings) -> bool {
        self.beyond.is_over() || (self.is_valid() && self.force_n > settings.limits.trip_n)
    }

    pub(super) const fn is_at_rest(&self, settings: &GripSettings) -> bool {
        self.resting_ms >= settings.limits.resting_ms
    }

    /// Whether the fingertips have been unloaded long enough to leave foot mode.
    pub(super) const fn is_unloaded(&self, settings: &GripSettings) -> bool {
        self.unloaded_ms >= settings.limits.unloaded_ms
    }

    /// Whether something around the fingers presses on them.
    pub(super) fn presses_outward(&self, settings: &GripSettings) -> bool {
        self.fingers.outward_n().is_some_and(|outward_n| outward_n > settings.limits.outward_n)
    }

    /// Whether both fingers press with more than a force in newtons.
    pub(super) fn is_pressed_by_more_than(&self, least_n: f32) -> bool {
        let presses = |finger| matches!(finger, FingerForce::Valid(n) if n > least_n);
        presses(self.fingers.left) && presses(self.fingers.right)
    }

    /// Why the forces end a calibration of the motor.
    pub(super) fn calibration_failure(
        &mut self,
        kind: CalibrationKind,
        motor: &MotorStatus,
        settings: &GripSettings,
    ) -> Option<CalibrationFailure> {
        let max_n = match kind {
            CalibrationKind::Motor => settings.limits.move_n,
            // The test grips with about 100 N.
            CalibrationKind::Screw => 2.0 * GripProfile::Normal.max_n(),
        };
        if self.force_n.max(self.rise_n) > max_n || self.presses_outward(settings) {
            Some(CalibrationFailure::Force)
        } else {
            self.presses_soft_part(motor, settings).then_some(CalibrationFailure::SoftPart)
        }
    }

    /// Whether the rise of the force over the rotor's travel since contact is that of something soft, such as a hand.
    fn presses_soft_part(&mut self, motor: &MotorStatus, settings: &GripSettings) -> bool {
        let GripSettings { limits, screw, .. } = settings;
        if self.rise_n < limits.contact_n {
            self.touched_rad = None;
            return false;
        }
        let touched_rad = *self.touched_rad.get_or_insert(motor.rotor_rad);
        let travel_mm = (motor.rotor_rad - touched_rad) * screw.ratio_mm;
        let stiff_n = limits.part_n_per_mm * travel_mm;
        self.rise_n > limits.part_n && self.rise_n - limits.contact_n < stiff_n
    }
}

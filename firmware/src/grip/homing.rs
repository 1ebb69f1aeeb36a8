//! Homing on force: closes until the fingers press on each other, opens to the far end, and compares the travel
//! with the stroke. An object between the fingers makes the travel too short; one around them ends the opening.

use crate::config::constants;
use crate::config::limits::GripLimits;
use crate::grip::debounce::next_ms;
use crate::grip::stall_detector::StallDetector;
use crate::motor::{MotorStatus, Setpoint};

/// Opening speed in mm/s.
const OPENING_MM_S: f32 = 20.0;
/// Opening speed in mm/s close to the far end, so that the screw does not jam there, and where that begins, in
/// millimetres before it.
const LANDING: (f32, f32) = (5.0, 3.0);
/// Milliseconds after the reversal in which rest is not taken for the far end.
const REVERSAL_MS: u32 = 100;
/// Samples of a force that confirm it.
const PRESSED_MS: u16 = 2;
/// Stiffness of both fingers in N/mm: two flexures carry each, one finger behind the other.
const FLEXURES: f32 = constants::STIFFNESS_X.value as f32;

/// Result of one step of [`Homing`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum HomingStep {
    /// Next motor set-point.
    Drive(Setpoint),
    /// The fingers press on each other: the opening in millimetres, negative by the flexures' deflection.
    Zeroed(f32),
    /// The far end is at the stroke.
    Homed,
    /// The fingers stalled while closing.
    Stalled,
    /// Timeout, or the travel in millimetres is not the stroke.
    Failed(f32),
}

/// Forces of the fingers in newtons.
#[derive(Clone, Copy, Debug)]
pub struct HomingForces {
    /// The greater of the closing force and its rise.
    pub closing_n: f32,
    /// See [`crate::grip::finger_force::FingerForces::outward_n`].
    pub outward_n: Option<f32>,
}

/// State of a homing run.
#[derive(Clone, Copy, Debug, Default)]
pub struct Homing {
    elapsed_ms: u32,
    /// Time since the fingers pressed; none while closing.
    opening_ms: Option<u32>,
    resting_ms: u16,
    /// Milliseconds of the force that ends the present direction.
    pressed_ms: u16,
    stall: StallDetector,
}

impl Homing {
    /// One millisecond.
    pub fn tick(
        &mut self,
        motor: &MotorStatus,
        forces: HomingForces,
        limits: &GripLimits,
    ) -> HomingStep {
        self.elapsed_ms = self.elapsed_ms.saturating_add(1);
        if self.elapsed_ms > limits.home_ms {
            return HomingStep::Failed(motor.opening_mm.unwrap_or_default());
        }
        match self.opening_ms {
            None => self.close(motor, forces.closing_n, limits),
            Some(since_ms) => {
                self.opening_ms = Some(since_ms.saturating_add(1));
                self.open(motor, since_ms, forces, limits)
            }
        }
    }

    fn close(&mut self, motor: &MotorStatus, force_n: f32, limits: &GripLimits) -> HomingStep {
        self.pressed_ms = next_ms(self.pressed_ms, force_n >= limits.home_n);
        if self.pressed_ms >= PRESSED_MS {
            (self.opening_ms, self.pressed_ms) = (Some(0), 0);
            return HomingStep::Zeroed(-force_n / FLEXURES);
        }
        // A screw that jammed at the far end needs more current than the one that it jammed with.
        let is_loosening = self.elapsed_ms <= limits.loosening_ms;
        if !is_loosening && self.stall.update(motor, force_n, limits) {
            return HomingStep::Stalled;
        }
        let max_a = if is_loosening { limits.blind_a } else { limits.home_a };
        HomingStep::Drive(Setpoint::Speed { closing_mm_s: limits.home_mm_s, max_a })
    }

    fn open(
        &mut self,
        motor: &MotorStatus,
        since_ms: u32,
        forces: HomingForces,
        limits: &GripLimits,
    ) -> HomingStep {
        let is_outward = forces.outward_n.is_some_and(|outward_n| outward_n > limits.outward_n);
        self.pressed_ms = next_ms(self.pressed_ms, is_outward);
        if self.pressed_ms >= PRESSED_MS {
            return HomingStep::Failed(motor.opening_mm.unwrap_or_default());
        }
        let stroke = constants::STROKE.value as f32;
        let is_resting = since_ms > REVERSAL_MS && motor.closing_mm_s.abs() < limits.end_stop_mm_s;
        self.resting_ms = next_ms(self.resting_ms, is_resting);
        if self.resting_ms < limits.end_stop_ms {
            let (landing_mm_s, before_mm) = LANDING;
            let is_near = motor.opening_mm.is_some_and(|mm| mm > stroke - before_mm);
            let opening_mm_s = if is_near { landing_mm_s } else { OPENING_MM_S };
            return HomingStep::Drive(Setpoint::Speed {
                closing_mm_s: -opening_mm_s,
                max_a: limits.home_a,
            });
        }
        match motor.opening_mm {
            Some(mm) if (mm - stroke).abs() <= limits.stroke_mm => HomingStep::Homed,
            mm => HomingStep::Failed(mm.unwrap_or_default()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: GripLimits = GripLimits::GRIPPER;

    fn at(opening_mm: f32, closing_mm_s: f32, current_a: f32) -> MotorStatus {
        MotorStatus {
            opening_mm: Some(opening_mm),
            closing_mm_s,
            current: crate::motor::foc::Dq { d: 0.0, q: current_a },
            ..MotorStatus::default()
        }
    }

    const fn forces(closing_n: f32, outward_n: f32) -> HomingForces {
        HomingForces { closing_n, outward_n: Some(outward_n) }
    }

    fn speed(closing_mm_s: f32, max_a: f32) -> HomingStep {
        HomingStep::Drive(Setpoint::Speed { closing_mm_s, max_a })
    }

    /// A run whose fingers have pressed on each other.
    fn opening() -> Homing {
        let mut homing = Homing::default();
        homing.tick(&at(5.0, 5.0, 0.5), forces(10.0, 0.0), &LIMITS);
        let zeroed = homing.tick(&at(5.0, 5.0, 0.5), forces(20.0, 0.0), &LIMITS);
        // 20 N over 500 N/mm.
        assert_eq!(zeroed, HomingStep::Zeroed(-0.04));
        homing
    }

    #[test]
    fn fingers_meet_at_10_n_for_two_samples() {
        let mut homing = Homing::default();
        let steps = [10.0, 9.9, 10.0, 10.0]
            .map(|force_n| homing.tick(&at(5.0, 5.0, 0.5), forces(force_n, 0.0), &LIMITS));
        let closing = speed(5.0, 4.0);
        assert_eq!(steps, [closing, closing, closing, HomingStep::Zeroed(-0.02)]);
    }

    #[test]
    fn closing_has_more_current_for_100_ms_and_stalls_after_40_more() {
        let mut homing = Homing::default();
        let stalled = at(50.0, 0.0, 1.5);
        for tick in 1..=139 {
            let max_a = if tick <= 100 { 4.0 } else { 1.5 };
            let step = homing.tick(&stalled, forces(0.0, 0.0), &LIMITS);
            assert_eq!(step, speed(5.0, max_a), "{tick}");
        }
        assert_eq!(homing.tick(&stalled, forces(0.0, 0.0), &LIMITS), HomingStep::Stalled);
    }

    #[test]
    fn homing_fails_after_30_s() {
        let mut homing = Homing::default();
        let closing = at(50.0, 5.0, 0.5);
        let failed = |step| matches!(step, HomingStep::Failed(50.0));
        let mut steps = (0..30_002).map(|_| homing.tick(&closing, forces(0.0, 0.0), &LIMITS));
        assert!(!steps.by_ref().take(30_000).any(failed));
        assert!(steps.all(failed));
    }

    #[test]
    fn opening_ends_at_15_n_outward_for_two_samples() {
        for (outward_n, fails) in [(15.0, false), (15.1, true)] {
            let mut homing = opening();
            let moving = at(30.0, -20.0, -0.5);
            let steps = [(); 2].map(|()| homing.tick(&moving, forces(0.0, outward_n), &LIMITS));
            assert_eq!(steps[0], speed(-20.0, 1.5));
            assert_eq!(steps[1] == HomingStep::Failed(30.0), fails, "{outward_n}");
        }
        let mut homing = opening();
        let unknown = HomingForces { closing_n: 0.0, outward_n: None };
        for _ in 0..5 {
            let step = homing.tick(&at(30.0, -20.0, -0.5), unknown, &LIMITS);
            assert_eq!(step, speed(-20.0, 1.5));
        }
    }

    #[test]
    fn opening_slows_down_3_mm_before_the_far_end() {
        let mut homing = opening();
        for (opening_mm, opening_mm_s) in [(30.0, 20.0), (77.0, 20.0), (77.1, 5.0), (79.0, 5.0)] {
            let step = homing.tick(&at(opening_mm, -20.0, -0.5), forces(0.0, 0.0), &LIMITS);
            assert_eq!(step, speed(-opening_mm_s, 1.5), "{opening_mm}");
        }
    }

    /// Steps after the reversal until the run ends at an opening, with a speed, and how it ends.
    fn end_at(opening_mm: f32, closing_mm_s: f32) -> Option<(usize, HomingStep)> {
        let mut homing = opening();
        let motor = at(opening_mm, closing_mm_s, -0.5);
        let mut steps = (1..400).map(|tick| (tick, homing.tick(&motor, forces(0.0, 0.0), &LIMITS)));
        steps.find(|(_, step)| !matches!(step, HomingStep::Drive(_)))
    }

    #[test]
    fn rest_of_50_ms_is_the_far_end_100_ms_after_the_reversal() {
        // Steps 102 to 151 count: the time before the first one is 0.
        assert_eq!(end_at(80.0, 0.0), Some((151, HomingStep::Homed)));
        assert_eq!(end_at(80.0, -0.9), Some((151, HomingStep::Homed)));
        assert_eq!(end_at(80.0, -1.0), None);
        assert_eq!(end_at(79.0, 0.0), Some((151, HomingStep::Homed)));
        assert_eq!(end_at(81.0, 0.0), Some((151, HomingStep::Homed)));
        assert_eq!(end_at(78.9, 0.0), Some((151, HomingStep::Failed(78.9))));
        assert_eq!(end_at(81.1, 0.0), Some((151, HomingStep::Failed(81.1))));
    }
}

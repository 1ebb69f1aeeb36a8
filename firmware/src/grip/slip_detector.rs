//! Detection of slip and loss of the gripped object.

use core::mem;

use crate::config::constants;
use crate::config::limits::GripLimits;
use crate::grip::debounce::{next_ms, next_ticks};
use crate::grip::finger_force::FingerForces;

/// Milliseconds over which a drop of the drag force is evaluated.
const DROP_MS: usize = 5;
/// Milliseconds over which a drag force is averaged.
const MEAN_MS: usize = 3;
/// Stored drag forces.
const HISTORY: usize = DROP_MS + MEAN_MS;

/// Detects slip and loss of the object.
#[derive(Clone, Copy, Debug, Default)]
pub struct SlipDetector {
    low_ms: u16,
    /// Drag forces in newtons, newest first.
    drags: [f32; HISTORY],
    stored: usize,
    near_ms: u8,
    since_slip_ms: u16,
}

/// State of the object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectState {
    /// Held.
    Held,
    /// The drag force drops, or is close to the friction limit.
    Slipping,
    /// Lost.
    Lost,
}

impl SlipDetector {
    /// Adds one millisecond: force set-point in newtons and closing speed in mm/s.
    pub fn update(
        &mut self,
        fingers: &FingerForces,
        (setpoint_n, closing_mm_s): (f32, f32),
        limits: &GripLimits,
    ) -> ObjectState {
        let (Some(force_n), Some(sum_n)) = (fingers.max_n(), fingers.sum_n()) else {
            // Invalid forces restart the detector, but not the pause after a slip.
            *self = Self { since_slip_ms: self.since_slip_ms, ..Self::default() };
            return ObjectState::Held;
        };
        let is_collapsing = force_n < 0.5 * setpoint_n && closing_mm_s > limits.resting_mm_s;
        self.low_ms = next_ms(self.low_ms, is_collapsing || force_n < limits.no_object_n);
        self.since_slip_ms = self.since_slip_ms.saturating_add(1);
        self.push_drag(fingers.drag_n);
        if self.low_ms >= limits.object_lost_ms {
            return ObjectState::Lost;
        }
        if self.is_slipping(sum_n, limits) && self.since_slip_ms >= limits.slip_pause_ms {
            self.since_slip_ms = 0;
            return ObjectState::Slipping;
        }
        ObjectState::Held
    }

    fn push_drag(&mut self, drag_n: f32) {
        // One by one: `copy_within` takes more flash than the rest of this file.
        let mut newer = drag_n;
        for drag_n in &mut self.drags {
            newer = mem::replace(drag_n, newer);
        }
        self.stored = self.stored.saturating_add(1).min(HISTORY);
    }

    /// Whether the drag is close to the friction limit, or above half of it and dropping.
    fn is_slipping(&mut self, sum_n: f32, limits: &GripLimits) -> bool {
        const FRICTION: f32 = constants::OBJECT_FRICTION.value as f32;
        let friction_n = FRICTION * sum_n;
        let [now, before] = [0, DROP_MS].map(|from| {
            let window = self.drags.iter().skip(from).take(MEAN_MS);
            window.sum::<f32>().abs() / MEAN_MS as f32
        });
        let is_near = now > limits.slip_ratio * friction_n;
        self.near_ms = next_ticks(self.near_ms, is_near);
        let dropped = before > 0.5 * friction_n && before - now > limits.slip_drop_n;
        self.stored == HISTORY && (usize::from(self.near_ms) >= MEAN_MS || dropped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::Estimate;
    use crate::grip::tests::rig::pressed;
    use crate::sensors::hall::SENSORS;

    const LIMITS: GripLimits = GripLimits::GRIPPER;

    fn forces(force_n: f32, drag_n: f32) -> FingerForces {
        let half = 0.5 * force_n;
        let lateral = [half, half, -half, -half].map(f64::from);
        FingerForces::of(&pressed(lateral, [(0.25 * drag_n).into(); 4]))
    }

    /// First millisecond with a state.
    fn first(
        state: ObjectState,
        ticks: impl Iterator<Item = (FingerForces, f32)>,
    ) -> Option<usize> {
        let mut detector = SlipDetector::default();
        let mut states =
            ticks.map(|(fingers, speed)| detector.update(&fingers, (100.0, speed), &LIMITS));
        states.position(|found| found == state)
    }

    #[test]
    fn force_below_3_n_for_three_milliseconds_is_a_lost_object() {
        let force = |tick| if tick < 10 { 100.0 } else { 2.9 };
        let at = first(ObjectState::Lost, (0..20).map(|tick| (forces(force(tick), 0.0), 0.0)));
        assert_eq!(at, Some(12));
        let interrupted = (0..1000).map(|tick| (forces([2.9, 2.9, 3.1][tick % 3], 0.0), 0.0));
        assert_eq!(first(ObjectState::Lost, interrupted), None);
    }

    #[test]
    fn half_force_is_a_lost_object_only_while_closing() {
        let of = |speed| first(ObjectState::Lost, (0..50).map(|_| (forces(49.0, 0.0), speed)));
        assert_eq!((of(5.0), of(0.0)), (Some(2), None));
    }

    #[test]
    fn drag_near_the_friction_limit_is_a_slip() {
        // Friction limit of both fingers at 100 N: 0.5 * 200 N; 0.9 of it is 90 N.
        let of = |drag| first(ObjectState::Slipping, (0..300).map(|_| (forces(100.0, drag), 0.0)));
        assert_eq!(of(89.0), None);
        assert_eq!(of(91.0), Some(usize::from(LIMITS.slip_pause_ms) - 1));
    }

    #[test]
    fn drag_drop_under_load_is_a_slip() {
        let falling = |from: f32, to: f32| {
            let drag = move |tick: usize| if tick < 400 { from } else { to };
            first(ObjectState::Slipping, (0..600).map(move |tick| (forces(100.0, drag(tick)), 0.0)))
        };
        // Detected within five milliseconds.
        let at = falling(80.0, 60.0).unwrap();
        assert!((400..=405).contains(&at), "{at}");
        assert_eq!(falling(30.0, 10.0), None);
        assert_eq!(falling(80.0, 77.0), None);
        assert_eq!(falling(60.0, 80.0), None);
    }

    #[test]
    fn invalid_forces_do_not_lose_the_object() {
        let lost = FingerForces::of(&[crate::estimator::Estimate::MISSING; 4]);
        assert_eq!(first(ObjectState::Lost, (0..50).map(|_| (lost, 5.0))), None);
    }

    #[test]
    fn values_at_their_thresholds_are_neither_slip_nor_loss() {
        // Half of 100 N while closing, and 3 N at rest.
        assert_eq!(first(ObjectState::Lost, (0..50).map(|_| (forces(50.0, 0.0), 5.0))), None);
        assert_eq!(first(ObjectState::Lost, (0..50).map(|_| (forces(3.0, 0.0), 0.0))), None);
        // 0.5 mm/s is rest.
        assert_eq!(first(ObjectState::Lost, (0..50).map(|_| (forces(49.0, 0.0), 0.5))), None);
        let falling = |from: f32, to: f32| {
            let drag = move |tick: usize| if tick < 400 { from } else { to };
            first(ObjectState::Slipping, (0..600).map(move |tick| (forces(100.0, drag(tick)), 0.0)))
        };
        // 0.9 and 0.5 of the friction limit of 100 N, and a drop of 6 N.
        assert_eq!(falling(90.0, 90.0), None);
        assert_eq!(falling(50.0, 20.0), None);
        assert_eq!(falling(80.0, 74.0), None);
        assert!(falling(80.0, 73.0).is_some());
    }

    #[test]
    fn drag_counts_by_its_magnitude_and_as_a_mean_of_three() {
        let at = |drags: &[f32]| {
            let ticks = (0..400).map(|_| 80.0).chain(drags.iter().copied());
            first(ObjectState::Slipping, ticks.map(|drag| (forces(100.0, drag), 0.0)))
        };
        // The mean falls below 74 N with the second of 68 N: (80 + 68 + 68) / 3 = 72.
        assert_eq!(at(&[68.0, 68.0, 68.0]), Some(401));
        assert_eq!(at(&[-80.0, -80.0, -80.0, -80.0]), Some(400));
        let opposite = (0..300).map(|_| (forces(100.0, -91.0), 0.0));
        let expected = usize::from(LIMITS.slip_pause_ms) - 1;
        assert_eq!(first(ObjectState::Slipping, opposite), Some(expected));
    }

    #[test]
    fn invalid_forces_restart_the_history_but_not_the_pause() {
        let missing = FingerForces::of(&[Estimate::MISSING; SENSORS]);
        let at = |tick: usize| match tick {
            ..300 => forces(100.0, 0.0),
            300 => missing,
            _ => forces(100.0, 91.0),
        };
        let found = first(ObjectState::Slipping, (0..600).map(|tick| (at(tick), 0.0)));
        // Eight samples after the invalid one.
        assert_eq!(found, Some(308));
    }
}

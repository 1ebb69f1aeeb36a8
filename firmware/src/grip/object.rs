//! What becomes of the object that is held: it is there, it slips, it is gone.

use core::mem;

use super::fingers::Fingers;
use crate::limits::Grasp;
use crate::params;

/// Milliseconds over which a fall of the drag is looked for.
const FALL_MS: usize = 5;
/// Milliseconds of which a drag is the mean.
const MEAN_MS: usize = 3;
/// Drags that are remembered.
const REMEMBERED: usize = FALL_MS + MEAN_MS;

/// Watches over the object.
#[derive(Clone, Copy, Debug, Default)]
pub struct Watch {
    weak_ms: u16,
    /// Newest first, in newtons.
    drags: [f32; REMEMBERED],
    remembered: usize,
    near_ms: u8,
    since_slip_ms: u16,
}

/// What is seen in a millisecond.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// It is there.
    Held,
    /// It slips: the drag falls, or is nearly all that friction bears.
    Slipping,
    /// It is gone.
    Gone,
}

impl Watch {
    /// Takes a millisecond: the force asked for and the speed of closing, in newtons and mm/s.
    pub fn note(
        &mut self,
        fingers: &Fingers,
        (set_n, closing_mm_s): (f32, f32),
        limits: &Grasp,
    ) -> Seen {
        let (Some(force_n), Some(sum_n)) = (fingers.greatest_n(), fingers.sum_n()) else {
            // What is not told is not judged.
            *self = Self {
                since_slip_ms: self.since_slip_ms,
                ..Self::default()
            };
            return Seen::Held;
        };
        let falls = force_n < 0.5 * set_n && closing_mm_s > limits.resting_mm_s;
        self.weak_ms = match falls || force_n < limits.nothing_n {
            true => self.weak_ms.saturating_add(1),
            false => 0,
        };
        self.since_slip_ms = self.since_slip_ms.saturating_add(1);
        self.remember(fingers.drag_n);
        if self.weak_ms >= limits.gone_ms {
            return Seen::Gone;
        }
        match self.slips(sum_n, limits) && self.since_slip_ms >= limits.slip_pause_ms {
            true => {
                self.since_slip_ms = 0;
                Seen::Slipping
            }
            false => Seen::Held,
        }
    }

    fn remember(&mut self, drag_n: f32) {
        // One by one: the library's move of any length takes more flash than all of this.
        let mut newer = drag_n;
        for drag_n in &mut self.drags {
            newer = mem::replace(drag_n, newer);
        }
        self.remembered = self.remembered.saturating_add(1).min(REMEMBERED);
    }

    /// Whether the drag is nearly all that friction bears, or most of it and falls.
    fn slips(&mut self, sum_n: f32, limits: &Grasp) -> bool {
        const FRICTION: f32 = params::OBJECT_FRICTION.value as f32;
        let bears_n = FRICTION * sum_n;
        let [now, before] = [0, FALL_MS].map(|from| {
            let window = self.drags.iter().skip(from).take(MEAN_MS);
            window.sum::<f32>().abs() / MEAN_MS as f32
        });
        let is_near = now > limits.slip_share * bears_n;
        self.near_ms = match is_near {
            true => self.near_ms.saturating_add(1),
            false => 0,
        };
        let fell = before > 0.5 * bears_n && before - now > limits.slip_fall_n;
        self.remembered == REMEMBERED && (usize::from(self.near_ms) >= MEAN_MS || fell)
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::pressed;
    use super::*;

    const LIMITS: Grasp = Grasp::GRIPPER;

    fn held(force_n: f32, drag_n: f32) -> Fingers {
        let half = 0.5 * force_n;
        Fingers::of(&pressed([half.into(); 4], [(0.25 * drag_n).into(); 4]))
    }

    /// The millisecond in which something is seen.
    fn first(seen: Seen, ticks: impl Iterator<Item = (Fingers, f32)>) -> Option<usize> {
        let mut watch = Watch::default();
        let mut notes = ticks.map(|(fingers, speed)| watch.note(&fingers, (100.0, speed), &LIMITS));
        notes.position(|note| note == seen)
    }

    #[test]
    fn less_than_three_newtons_for_three_milliseconds_is_nothing() {
        let force = |tick| if tick < 10 { 100.0 } else { 2.9 };
        let at = first(
            Seen::Gone,
            (0..20).map(|tick| (held(force(tick), 0.0), 0.0)),
        );
        assert_eq!(at, Some(12));
        let blinks = (0..1000).map(|tick| (held([2.9, 2.9, 3.1][tick % 3], 0.0), 0.0));
        assert_eq!(first(Seen::Gone, blinks), None);
    }

    #[test]
    fn half_of_the_force_while_closing_is_gone_and_at_rest_it_is_weak() {
        let of = |speed| first(Seen::Gone, (0..50).map(|_| (held(49.0, 0.0), speed)));
        assert_eq!((of(5.0), of(0.0)), (Some(2), None));
    }

    #[test]
    fn a_drag_near_what_friction_bears_slips_and_a_lesser_one_does_not() {
        // Both fingers at 100 N bear 0.5 * 200 N; 0.9 of that is 90 N.
        let of = |drag| first(Seen::Slipping, (0..300).map(|_| (held(100.0, drag), 0.0)));
        assert_eq!(of(89.0), None);
        assert_eq!(of(91.0), Some(usize::from(LIMITS.slip_pause_ms) - 1));
    }

    #[test]
    fn a_drag_that_falls_under_load_is_a_slip_and_a_weight_that_is_put_down_is_none() {
        let falling = |from: f32, to: f32| {
            let drag = move |tick: usize| if tick < 400 { from } else { to };
            first(
                Seen::Slipping,
                (0..600).map(move |tick| (held(100.0, drag(tick)), 0.0)),
            )
        };
        // Told within five milliseconds.
        let told = falling(80.0, 60.0).unwrap();
        assert!((400..=405).contains(&told), "{told}");
        assert_eq!(falling(30.0, 10.0), None);
        assert_eq!(falling(80.0, 77.0), None);
        assert_eq!(falling(60.0, 80.0), None);
    }

    #[test]
    fn what_is_not_told_is_not_gone() {
        let lost = Fingers::of(&[crate::force::Estimate::MISSING; 4]);
        assert_eq!(first(Seen::Gone, (0..50).map(|_| (lost, 5.0))), None);
    }
}

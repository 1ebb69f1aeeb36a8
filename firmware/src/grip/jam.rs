//! A jam: current flows, nothing moves, and nothing presses.

use super::pace::Pace;
use crate::limits::Grasp;
use crate::motor::Telling;

/// Watches for it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Jam {
    pace: Pace,
    stands_ms: u16,
}

impl Jam {
    /// Takes a millisecond in which the fingers are meant to move; whether they are jammed.
    pub fn note(&mut self, motor: &Telling, force_n: f32, limits: &Grasp) -> bool {
        let stands = self.pace.note(motor.closing_mm_s).abs() < limits.jam_mm_s;
        let pushes = motor.current.q.abs() > limits.jam_a;
        self.stands_ms = match stands && pushes && force_n < limits.contact_n {
            true => self.stands_ms.saturating_add(1),
            false => 0,
        };
        self.stands_ms >= limits.jam_ms
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::transform::Dq;

    fn after(ticks: u16, current_a: f32, speed: f32, force_n: f32) -> bool {
        let motor = Telling {
            closing_mm_s: speed,
            current: Dq {
                d: 0.0,
                q: current_a,
            },
            ..Telling::default()
        };
        let mut jam = Jam::default();
        (0..ticks).any(|_| jam.note(&motor, force_n, &Grasp::GRIPPER))
    }

    #[test]
    fn current_without_motion_and_without_force_is_a_jam_after_40_ms() {
        assert!(after(40, 1.3, 0.1, 1.0) && !after(39, 1.3, 0.1, 1.0));
        assert!(after(40, -1.3, -0.1, 1.0));
        assert!(!after(500, 1.1, 0.1, 1.0));
        assert!(!after(500, 5.0, 1.0, 1.0));
        assert!(!after(500, 5.0, 0.0, 6.0));
    }
}

//! The force law: a speed of closing from the force that is missing.
//!
//! The contact's stiffness integrates speed into force, so that no force is left over and nothing winds up in
//! free air. Before the contact the speed is one from which the fingers stop before the force is passed.

use core::f32::consts::TAU;

use crate::motor::number::{sqrt, within};
use crate::params;

/// Stiffness of the hardest contact in newtons to the millimetre.
pub const HARDEST: f32 = params::CONTACT_STIFFNESS.value as f32;
/// Fastest closing in mm/s.
pub const FASTEST: f32 = params::CLOSING_SPEED.value as f32;
/// Slowest approach in mm/s.
const SLOWEST: f32 = 2.0;
/// Seconds from a contact to the speed that answers it.
const STOP_S: f32 = (params::STOPPING_TIME.value * 1e-3) as f32;
/// Newtons that a contact may bring before it is answered: so much, and a share of the force asked for.
const ALLOWED_N: f32 = 2.0;
/// See [`ALLOWED_N`].
const ALLOWED: f32 = 0.1;
/// Crossover of the loop in 1/s.
const CROSSOVER: f32 = TAU * params::FORCE_BANDWIDTH.value as f32;
/// Deceleration of the fingers in mm/s^2 that is counted on: by the rated torque, of which a way takes half.
const BRAKES_MM_S2: f32 = 2.0 * params::MOTION_ACCELERATION.value as f32;
/// Speed in mm/s up to which the loop's own slowing asks for no more than that.
const BRAKED_MM_S: f32 = BRAKES_MM_S2 / CROSSOVER;

/// Speed in mm/s at which an object is approached that is to be gripped with a force in newtons.
pub fn approach_mm_s(set_n: f32) -> f32 {
    within(
        (ALLOWED * set_n + ALLOWED_N) / (HARDEST * STOP_S),
        SLOWEST,
        FASTEST,
    )
}

/// Speed of closing in mm/s for the newtons that are missing, at a contact of some newtons to the millimetre;
/// closing at most at `most_mm_s`. Opening at most at [`FASTEST`], and at one from which the motor can still brake
/// until the force is right: it would let go otherwise.
pub fn closing_mm_s(missing_n: f32, stiffness: f32, most_mm_s: f32) -> f32 {
    let beside_mm = missing_n / stiffness;
    let wanted = CROSSOVER * beside_mm;
    let given = match wanted < -BRAKED_MM_S {
        true => -sqrt(-2.0 * BRAKES_MM_S2 * beside_mm - BRAKED_MM_S * BRAKED_MM_S),
        false => wanted,
    };
    within(given, -FASTEST, most_mm_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_approach_is_as_fast_as_its_force_allows() {
        // (0.1 F + 2 N) / (333 N/mm * 2.5 ms).
        for (set_n, expected) in [(10.0, 3.6), (50.0, 8.4), (100.0, 14.4), (350.0, 44.4)] {
            let speed = approach_mm_s(set_n);
            assert!((speed - expected).abs() < 0.05, "{set_n}: {speed}");
        }
        assert_eq!([approach_mm_s(-20.0), approach_mm_s(1e3)], [2.0, 58.3]);
    }

    #[test]
    fn what_is_missing_closes_and_what_is_too_much_opens() {
        // 32 Hz: 201.1 / 333 * 10 N = 6.04 mm/s.
        assert!((closing_mm_s(10.0, 333.0, 14.4) - 6.04).abs() < 0.01);
        assert!((closing_mm_s(-10.0, 333.0, 14.4) + 6.04).abs() < 0.01);
        assert_eq!(closing_mm_s(100.0, 333.0, 14.4), 14.4);
        assert_eq!(closing_mm_s(-400.0, 5.0, 14.4), -58.3);
    }

    #[test]
    fn what_is_much_too_much_opens_no_faster_than_can_be_braked() {
        // Up to 4000 / 201.1 = 19.9 mm/s the loop slows by less; from there 4000 mm/s^2.
        assert!((closing_mm_s(-30.0, 333.0, 14.4) + 18.12).abs() < 0.01);
        // (2 * 4000 * 100 / 333 - 19.9^2)^0.5.
        assert!((closing_mm_s(-100.0, 333.0, 14.4) + 44.79).abs() < 0.01);
        let slowest = (1..1000).map(|n| closing_mm_s(-0.3 * n as f32, 333.0, 14.4));
        assert!(
            slowest
                .clone()
                .zip(slowest.skip(1))
                .all(|(less, more)| more <= less)
        );
    }
}

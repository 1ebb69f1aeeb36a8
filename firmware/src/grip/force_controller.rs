//! Force controller: closing speed from the force error, and the estimate of the contact stiffness that it needs.
//!
//! The contact's stiffness integrates speed into force, so that no steady-state error remains and no integrator
//! winds up in free air. Before contact the speed is limited so that the fingers stop without overshoot.

use core::f32::consts::TAU;

use crate::config::constants;
use crate::math::{sqrt, within};

/// Stiffness of the hardest contact in N/mm.
pub const HARDEST: f32 = constants::CONTACT_STIFFNESS.value as f32;
/// Maximum closing speed in mm/s.
pub const FASTEST: f32 = constants::CLOSING_SPEED.value as f32;
/// Minimum approach speed in mm/s.
const SLOWEST: f32 = 2.0;
/// Seconds from contact until the speed reacts.
const STOP_S: f32 = (constants::CONTACT_REACTION_TIME.value * 1e-3) as f32;
/// Newtons of overshoot allowed before the reaction, plus [`ALLOWED`].
const ALLOWED_N: f32 = 2.0;
/// Overshoot allowed, as a fraction of the set-point.
const ALLOWED: f32 = 0.1;
/// Crossover of the loop in rad/s.
const CROSSOVER: f32 = TAU * constants::FORCE_BANDWIDTH.value as f32;
/// Deceleration of the fingers at rated torque in mm/s^2; a trajectory uses half of it.
const BRAKES_MM_S2: f32 = 2.0 * constants::MOTION_ACCELERATION.value as f32;
/// Speed in mm/s below which the linear law needs no more than that deceleration.
const BRAKED_MM_S: f32 = BRAKES_MM_S2 / CROSSOVER;
/// Range of the stiffness estimate in N/mm.
const RANGE: [f32; 2] = [5.0, 600.0];
/// Minimum travel in millimetres between two samples; closer ones contain only noise.
const STEP_MM: f32 = 0.002;
/// Forgetting factor per sample.
const FORGETTING: f32 = 0.95;
/// Weight of the initial guess in mm^2: 0.5 N of noise over 10 um is 50 N/mm.
const GUESS_MM2: f32 = 1e-4;

/// Approach speed in mm/s for a force set-point in newtons.
pub fn approach_mm_s(setpoint_n: f32) -> f32 {
    within((ALLOWED * setpoint_n + ALLOWED_N) / (HARDEST * STOP_S), SLOWEST, FASTEST)
}

/// Closing speed in mm/s for a force error in newtons at a contact stiffness in N/mm, at most `max_mm_s`. Opening
/// is limited to [`FASTEST`] and to the speed from which the motor can brake until the error is zero; a faster one
/// would release the object.
pub fn closing_mm_s(error_n: f32, stiffness: f32, max_mm_s: f32) -> f32 {
    let error_mm = error_n / stiffness;
    let linear = CROSSOVER * error_mm;
    let limited = if linear < -BRAKED_MM_S {
        -sqrt(-2.0 * BRAKES_MM_S2 * error_mm - BRAKED_MM_S * BRAKED_MM_S)
    } else {
        linear
    };
    within(limited, -FASTEST, max_mm_s)
}

/// Recursive least-squares estimate of the contact stiffness (force over travel) with exponential forgetting.
/// Starts at the hardest contact, which gives the slowest control.
#[derive(Clone, Copy, Debug)]
pub struct StiffnessEstimator {
    last_mm: Option<f32>,
    weight: f32,
    mean_mm: f32,
    mean_n: f32,
    /// Weighted variance of the travel.
    squares: f32,
    /// Weighted covariance of travel and force.
    product: f32,
    value: f32,
}

impl Default for StiffnessEstimator {
    fn default() -> Self {
        Self {
            last_mm: None,
            weight: 0.0,
            mean_mm: 0.0,
            mean_n: 0.0,
            squares: 0.0,
            product: 0.0,
            value: HARDEST,
        }
    }
}

impl StiffnessEstimator {
    /// The estimate in N/mm.
    pub const fn value(&self) -> f32 {
        self.value
    }

    /// Adds a force in newtons at a travel in millimetres, closing positive.
    pub fn update(&mut self, travel_mm: f32, force_n: f32) {
        let moved = self.last_mm.map(|last| (travel_mm - last).abs());
        if moved.is_some_and(|moved| moved < STEP_MM) {
            return;
        }
        self.last_mm = Some(travel_mm);
        self.weight = self.weight * FORGETTING + 1.0;
        let (off_mm, off_n) = (travel_mm - self.mean_mm, force_n - self.mean_n);
        self.mean_mm += off_mm / self.weight;
        self.mean_n += off_n / self.weight;
        let residual_mm = travel_mm - self.mean_mm;
        self.squares = self.squares * FORGETTING + off_mm * residual_mm;
        self.product = self.product * FORGETTING + off_n * residual_mm;
        let slope = (self.product + GUESS_MM2 * HARDEST) / (self.squares + GUESS_MM2);
        let [softest, hardest] = RANGE;
        self.value = within(slope, softest, hardest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn approach_speed_grows_with_the_force() {
        // (0.1 F + 2 N) / (333 N/mm * 2.5 ms).
        for (setpoint_n, expected) in [(10.0, 3.6), (50.0, 8.4), (100.0, 14.4), (350.0, 44.4)] {
            let speed = approach_mm_s(setpoint_n);
            assert!((speed - expected).abs() < 0.05, "{setpoint_n}: {speed}");
        }
        assert_eq!([approach_mm_s(-20.0), approach_mm_s(1e3)], [2.0, 58.3]);
    }

    #[test]
    fn force_error_sets_the_closing_speed() {
        // 32 Hz: 201.1 / 333 * 10 N = 6.04 mm/s.
        assert!((closing_mm_s(10.0, 333.0, 14.4) - 6.04).abs() < 0.01);
        assert!((closing_mm_s(-10.0, 333.0, 14.4) + 6.04).abs() < 0.01);
        assert_eq!(closing_mm_s(100.0, 333.0, 14.4), 14.4);
        assert_eq!(closing_mm_s(-400.0, 5.0, 14.4), -58.3);
    }

    #[test]
    fn large_excess_force_limits_the_opening_speed() {
        // Linear up to 4000 / 201.1 = 19.9 mm/s, then 4000 mm/s^2.
        assert!((closing_mm_s(-30.0, 333.0, 14.4) + 18.12).abs() < 0.01);
        // (2 * 4000 * 100 / 333 - 19.9^2)^0.5.
        assert!((closing_mm_s(-100.0, 333.0, 14.4) + 44.79).abs() < 0.01);
        let slowest = (1..1000).map(|n| closing_mm_s(-0.3 * n as f32, 333.0, 14.4));
        assert!(slowest.clone().zip(slowest.skip(1)).all(|(less, more)| more <= less));
    }

    /// Estimate while closing at constant speed, with noise of half a newton.
    fn estimated(stiffness: f32, speed_mm_s: f32, until_n: f32) -> f32 {
        let mut estimate = StiffnessEstimator::default();
        for tick in 0..100_000 {
            let travel = speed_mm_s * 1e-3 * tick as f32;
            let noise = [0.5, -0.5, -0.5, 0.5][tick % 4];
            if stiffness * travel > until_n {
                return estimate.value();
            }
            estimate.update(travel, stiffness * travel + noise);
        }
        panic!("no contact");
    }

    #[test]
    fn stiffness_without_information_stays_in_its_range() {
        type Case = (&'static str, fn(u16) -> (f32, f32), u16, f32);
        let cases: [Case; 4] = [
            ("no sample", |_| (0.0, 0.0), 0, 333.0),
            ("one sample", |_| (3.0, 50.0), 1, 333.0),
            (
                "no travel",
                |tick| (10.0 + 1e-4 * f32::from(tick % 5), f32::from(tick % 7)),
                1000,
                333.0,
            ),
            ("falling force", |tick| (0.01 * f32::from(tick), -30.0 * f32::from(tick)), 100, 5.0),
        ];
        for (name, sample, ticks, stiffness) in cases {
            let mut estimate = StiffnessEstimator::default();
            for tick in 0..ticks {
                let (travel_mm, force_n) = sample(tick);
                estimate.update(travel_mm, force_n);
            }
            assert!((estimate.value() - stiffness).abs() < 1e-3, "{name}: {}", estimate.value());
        }
    }

    #[test]
    fn stiffness_converges_before_half_of_the_force() {
        for stiffness in [5.0, 50.0, 333.0] {
            for (setpoint_n, speed) in [(50.0, 8.4), (100.0, 14.4), (350.0, 44.4)] {
                let estimate = estimated(stiffness, speed, 0.5 * setpoint_n);
                let ratio = estimate / stiffness;
                assert!((0.8..1.3).contains(&ratio), "{stiffness} {setpoint_n}: {estimate}");
            }
        }
    }

    #[test]
    fn stiffness_of_three_samples_is_their_weighted_regression() {
        // Weights 1, 1.95, 2.8525. After (0, 0), (1, 100): covariance 48.7179, variance 0.487179 of the travel, both with the
        // guess of 333 N/mm over 1e-4 mm^2. After (2, 300): 286.4985 and 1.899166.
        let mut estimate = StiffnessEstimator::default();
        for (travel_mm, force_n, expected) in
            [(0.0, 0.0, 333.0), (1.0, 100.0, 100.048), (2.0, 300.0, 150.865)]
        {
            estimate.update(travel_mm, force_n);
            assert!((estimate.value() - expected).abs() < 0.01, "{}", estimate.value());
        }
        // Less than 2 um of travel adds nothing, 2 um are a sample.
        let mut shortest = StiffnessEstimator::default();
        shortest.update(0.0, 0.0);
        shortest.update(0.002, 5.0);
        assert!(shortest.value() > 334.0, "{}", shortest.value());
        estimate.update(2.0015, 900.0);
        assert!((estimate.value() - 150.865).abs() < 0.01);
        estimate.update(1.9975, 900.0);
        assert!((estimate.value() - 150.865).abs() > 1.0);
    }
}

//! The contact's stiffness, estimated while the force rises: the slope of force over travel, newer samples
//! counting more, and at first the hardest contact, which is the slowest.

use super::law::HARDEST;
use crate::motor::number::within;

/// Softest and hardest that is believed, in newtons to the millimetre.
const RANGE: [f32; 2] = [5.0, 600.0];
/// Travel in millimetres between two samples: what lies nearer tells noise.
const STEP_MM: f32 = 0.002;
/// What is left of a sample's weight with the next.
const KEPT: f32 = 0.95;
/// Weight of the first guess, in square millimetres: 0.5 N of noise over 10 um is 50 N/mm.
const GUESS_MM2: f32 = 1e-4;

/// The estimate. Travel is closing positive.
#[derive(Clone, Copy, Debug)]
pub struct Stiffness {
    last_mm: Option<f32>,
    weight: f32,
    mean_mm: f32,
    mean_n: f32,
    /// Weighted squares of the travel, and its product with the force, about their means.
    squares: f32,
    product: f32,
    told: f32,
}

impl Default for Stiffness {
    fn default() -> Self {
        Self {
            last_mm: None,
            weight: 0.0,
            mean_mm: 0.0,
            mean_n: 0.0,
            squares: 0.0,
            product: 0.0,
            told: HARDEST,
        }
    }
}

impl Stiffness {
    /// In newtons to the millimetre.
    pub const fn told(&self) -> f32 {
        self.told
    }

    /// Takes a force in newtons at the travel in millimetres at which it was sensed.
    pub fn take(&mut self, travel_mm: f32, force_n: f32) {
        let moved = self.last_mm.map(|last| (travel_mm - last).abs());
        if moved.is_some_and(|moved| moved < STEP_MM) {
            return;
        }
        self.last_mm = Some(travel_mm);
        self.weight = self.weight * KEPT + 1.0;
        let (off_mm, off_n) = (travel_mm - self.mean_mm, force_n - self.mean_n);
        self.mean_mm += off_mm / self.weight;
        self.mean_n += off_n / self.weight;
        let left_mm = travel_mm - self.mean_mm;
        self.squares = self.squares * KEPT + off_mm * left_mm;
        self.product = self.product * KEPT + off_n * left_mm;
        let slope = (self.product + GUESS_MM2 * HARDEST) / (self.squares + GUESS_MM2);
        let [softest, hardest] = RANGE;
        self.told = within(slope, softest, hardest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Closes by steps of a millisecond; the noise is half a newton of either sign in turn.
    fn told(stiffness: f32, speed_mm_s: f32, until_n: f32) -> f32 {
        let mut estimate = Stiffness::default();
        for tick in 0..100_000 {
            let travel = speed_mm_s * 1e-3 * tick as f32;
            let noise = [0.5, -0.5, -0.5, 0.5][tick % 4];
            if stiffness * travel > until_n {
                return estimate.told();
            }
            estimate.take(travel, stiffness * travel + noise);
        }
        panic!("no contact");
    }

    #[test]
    fn before_anything_is_known_the_contact_is_the_hardest() {
        assert_eq!(Stiffness::default().told(), 333.0);
        let mut once = Stiffness::default();
        once.take(3.0, 50.0);
        assert!((once.told() - 333.0).abs() < 1e-3);
    }

    #[test]
    fn a_contact_is_known_within_a_third_before_half_of_the_force_is_there() {
        for stiffness in [5.0, 50.0, 333.0] {
            for (set_n, speed) in [(50.0, 8.4), (100.0, 14.4), (350.0, 44.4)] {
                let told = told(stiffness, speed, 0.5 * set_n);
                let ratio = told / stiffness;
                assert!((0.8..1.3).contains(&ratio), "{stiffness} {set_n}: {told}");
            }
        }
    }

    #[test]
    fn what_does_not_move_teaches_nothing() {
        let mut estimate = Stiffness::default();
        for tick in 0..1000 {
            estimate.take(10.0 + 1e-4 * (tick % 5) as f32, (tick % 7) as f32);
        }
        assert!((estimate.told() - 333.0).abs() < 1e-3);
    }

    #[test]
    fn the_estimate_stays_in_its_range() {
        let mut estimate = Stiffness::default();
        for tick in 0..100 {
            estimate.take(0.01 * tick as f32, -30.0 * tick as f32);
        }
        assert_eq!(estimate.told(), 5.0);
    }
}

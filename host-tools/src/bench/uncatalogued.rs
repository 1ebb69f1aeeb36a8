//! Fields that no catalogue holds: a product of two covariates, and a disturbance that nobody recorded.

use nalgebra::Vector3;

use super::draw::{Purpose, direction, stream};
use super::effects::Effects;
use super::stroke::Drive;
use super::waves::Waves;

/// Current and opening (from the middle of the stroke, in mm) at which the product is stated.
const STATED: (f64, f64) = (10.0, 10.0);
/// Middle of the stroke in mm.
const MIDDLE_MM: f64 = 15.0;
/// Frequencies of the disturbance: those of the loads, and slower.
const DISTURBANCE_HZ: [f64; 2] = [0.03, 0.6];
/// Sines of each axis.
const SINES: u32 = 6;

/// What acts on every sensor alike, beside the catalogue.
pub struct Uncatalogued {
    product_g: Vector3<f64>,
    disturbance: [Waves; 3],
}

impl Uncatalogued {
    /// Draws directions, frequencies and phases.
    pub fn draw(effects: &Effects, seed: u64) -> Self {
        let mut rng = stream(seed, Purpose::Uncatalogued, 0);
        let product_g = direction(&mut rng) * effects.size("cross_term");
        let peaks = direction(&mut rng) * effects.size("unlogged");
        let mut waves = |peak: f64| Waves::draw(&mut rng, SINES, DISTURBANCE_HZ, peak);
        Self {
            product_g,
            disturbance: [waves(peaks.x), waves(peaks.y), waves(peaks.z)],
        }
    }

    /// Field in gauss, gripper's axes, so many seconds into the session.
    pub fn field(&self, drive: &Drive, session_s: f64) -> Vector3<f64> {
        let off = (drive.opening_mm - MIDDLE_MM) / STATED.1;
        let disturbance = self.disturbance.each_ref().map(|waves| waves.at(session_s));
        self.product_g * (drive.current_a / STATED.0 * off) + Vector3::from(disturbance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(wanted: &str) -> Uncatalogued {
        let effects = Effects::new(&[wanted.parse().unwrap()], 3, 1, 0.0).unwrap();
        Uncatalogued::draw(&effects, 3)
    }

    fn drive(opening_mm: f64, current_a: f64) -> Drive {
        Drive {
            opening_mm,
            angle_rad: 0.0,
            current_a,
        }
    }

    #[test]
    fn a_product_needs_both_its_factors() {
        let drawn = drawn("cross_term=2");
        assert!((drawn.field(&drive(25.0, 10.0), 7.0).norm() - 2.0).abs() < 1e-12);
        assert_eq!(drawn.field(&drive(25.0, 0.0), 7.0).norm(), 0.0);
        assert_eq!(drawn.field(&drive(15.0, 10.0), 7.0).norm(), 0.0);
    }

    #[test]
    fn a_disturbance_follows_nothing_but_time_and_stays_within_its_size() {
        let drawn = drawn("unlogged=3");
        let at = |s: f64| drawn.field(&drive(0.0, 5.0), s);
        assert_eq!(at(2.0), drawn.field(&drive(20.0, -5.0), 2.0));
        let greatest = (0..2000).map(|i| at(0.1 * f64::from(i)).norm());
        let greatest = greatest.fold(0.0, f64::max);
        assert!((0.5..=3.0).contains(&greatest), "{greatest}");
    }
}

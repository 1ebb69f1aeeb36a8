//! Tare: the mean estimate while the sensor is unloaded.
//!
//! On a gripper a command does the same with unloaded fingers. The device's rule ([`firmware::estimator::tare::offset`])
//! excludes offsets that friction or the predicted standard deviation explains.

use firmware::estimator::tare::offset;
use firmware::fixed_point::Force;
use model_export::inverse::compensation::OwnedCompensation;

use crate::statistics::Moments;

/// Unloaded: both forces below this fraction of the range, 1 N of MAGPIE's 250 N.
const UNLOADED: f64 = 1.0 / 250.0;
/// Lower limit of that threshold in newtons: four standard deviations of a reference with 0.15 N of noise.
const REFERENCE_N: f64 = 0.6;
/// Upper limit of that threshold as a fraction of the range.
const MAX_UNLOADED: f64 = 0.05;
/// A tare that multiplies the error by this factor is reported.
pub const TARE_HARM: f64 = 1.2;
/// Maximum averaging time of a tare in seconds.
const MAX_TARE_S: f64 = 1.0;
/// Shorter unloaded intervals are zero crossings of the load.
const MIN_TARE_S: f64 = 0.2;

/// Static friction of a sensor in newtons, Fx and Fz; zero where the model has none.
pub fn friction_n(compensations: &[OwnedCompensation], sensor: u32) -> [f64; 2] {
    let own = compensations.iter().find(|one| one.number() == sensor);
    own.map_or([0.0; 2], OwnedCompensation::friction_n)
}

/// Averages the first unloaded interval of a recording.
#[derive(Clone, Copy, Debug)]
pub struct TareEstimator {
    unloaded_n: f64,
    since_s: Option<f64>,
    last_s: f64,
    estimates: [Moments; 2],
    sigmas: [Moments; 2],
    friction_n: [f64; 2],
    tare: Option<([f64; 2], f64)>,
}

impl TareEstimator {
    /// For a sensor with a range of `range_n` newtons in each direction and the static friction `friction_n`.
    pub fn new(range_n: f64, friction_n: [f64; 2]) -> Self {
        Self {
            unloaded_n: (UNLOADED * range_n).max(REFERENCE_N.min(MAX_UNLOADED * range_n)),
            since_s: None,
            last_s: 0.0,
            estimates: Default::default(),
            sigmas: Default::default(),
            friction_n,
            tare: None,
        }
    }

    /// Adds a row: reference, estimate, and the standard deviations where a network predicts them.
    pub fn add(
        &mut self,
        time_s: f64,
        reference_n: [f64; 2],
        estimate_n: [f64; 2],
        sigma_n: Option<[f64; 2]>,
    ) {
        if self.tare.is_some() {
            return;
        }
        let loaded = reference_n.iter().any(|n| n.abs() > self.unloaded_n);
        let since_s = *self.since_s.get_or_insert(time_s);
        if loaded || time_s - since_s >= MAX_TARE_S {
            self.close();
            self.since_s = None;
            self.last_s = 0.0;
            (self.estimates, self.sigmas) = Default::default();
        }
        if !loaded && self.tare.is_none() {
            self.since_s.get_or_insert(time_s);
            self.last_s = time_s;
            for (moments, estimate) in self.estimates.iter_mut().zip(estimate_n) {
                moments.add(estimate);
            }
            for (moments, sigma) in self.sigmas.iter_mut().zip(sigma_n.unwrap_or_default()) {
                moments.add(sigma);
            }
        }
    }

    fn close(&mut self) {
        let length_s = self.last_s - self.since_s.unwrap_or(self.last_s);
        if length_s >= MIN_TARE_S {
            let tare = [0, 1].map(|axis| {
                let (mean, sigma) = (self.estimates[axis].mean(), self.sigmas[axis].mean());
                let error = self.estimates[axis].std() / self.estimates[axis].rows().sqrt();
                let variance = (error * Force::PER_NEWTON).powi(2).round() as i64;
                let [mean, friction, sigma] = [mean, self.friction_n[axis], sigma].map(raw);
                offset(mean, variance, friction, sigma).newtons()
            });
            self.tare = Some((tare, length_s));
        }
    }

    /// Tare of Fx and Fz in newtons and the length of the interval in seconds; `None` without an unloaded
    /// interval.
    pub fn tare(mut self) -> Option<([f64; 2], f64)> {
        if self.tare.is_none() {
            self.close();
        }
        self.tare
    }
}

/// Newtons in the device's unit.
fn raw(newtons: f64) -> Force {
    Force((newtons * Force::PER_NEWTON).round() as i32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tare_of(
        range_n: f64,
        rows: impl IntoIterator<Item = (f64, f64, f64)>,
    ) -> Option<([f64; 2], f64)> {
        let mut estimator = TareEstimator::new(range_n, [0.0; 2]);
        for (time_s, reference, estimate) in rows {
            estimator.add(time_s, [reference, 0.0], [estimate, 2.0 * estimate], None);
        }
        estimator.tare()
    }

    #[test]
    fn tare_is_the_mean_of_the_first_unloaded_second() {
        let rows =
            (0..3000).map(|ms| (f64::from(ms) * 1e-3, 0.1, if ms < 1000 { 5.0 } else { 50.0 }));
        let (tare, length_s) = tare_of(250.0, rows).unwrap();
        assert_eq!(tare, [5.0, 10.0]);
        assert!((length_s - 0.999).abs() < 1e-9);
    }

    #[test]
    fn unloaded_threshold_scales_with_the_force_range() {
        // A load for a second, then nothing: 0.75 N are 15 % of 5 N and 0.3 % of 250 N.
        let rows = |loaded_n: f64| {
            (0..2000).map(move |ms| {
                let reference = if ms < 1000 { loaded_n } else { 0.0 };
                (f64::from(ms) * 1e-3, reference, reference + 0.25)
            })
        };
        let tare = |range_n, loaded_n| tare_of(range_n, rows(loaded_n)).unwrap().0[0];
        assert_eq!(tare(5.0, 0.75), 0.25);
        assert_eq!(tare(250.0, 0.75), 1.0);
        assert_eq!(tare(250.0, 5.0), 0.25);
        assert_eq!(tare(2000.0, 5.0), 5.25);
        // Noise of the reference does not end the interval, however small the range.
        assert_eq!(tare(5.0, 0.25), 0.5);
    }

    #[test]
    fn tare_excludes_offsets_within_static_friction() {
        let tare = |friction_n: [f64; 2]| {
            let mut estimator = TareEstimator::new(250.0, friction_n);
            for ms in 0..1500 {
                // Half a newton with noise.
                let noise = if ms % 2 == 0 { 0.1 } else { -0.1 };
                let estimate = [0.5 + noise, -0.5 + noise];
                estimator.add(f64::from(ms) * 1e-3, [0.0; 2], estimate, None);
            }
            estimator.tare().unwrap().0.map(|n| (n * 1e3).round() / 1e3)
        };
        assert_eq!(tare([0.0, 0.0]), [0.5, -0.5]);
        assert_eq!(tare([0.6, 0.4]), [0.0, -0.1]);
        // An excess within the noise of the mean is ignored: 3 * 0.1 / sqrt(1000) is 0.0095.
        assert_eq!(tare([0.495, 0.48]), [0.0, -0.02]);
    }

    #[test]
    fn tare_excludes_offsets_within_predicted_sigma() {
        let tare = |sigma_n: f64| {
            let mut estimator = TareEstimator::new(250.0, [0.0; 2]);
            for ms in 0..1500 {
                estimator.add(f64::from(ms) * 1e-3, [0.0; 2], [0.5, 0.0], Some([sigma_n; 2]));
            }
            estimator.tare().unwrap().0[0]
        };
        assert_eq!(tare(0.26), 0.0);
        assert_eq!(tare(0.24), 0.5);
    }

    #[test]
    fn zero_crossing_of_the_load_gives_no_tare() {
        let rows = (0..3000)
            .map(|ms| (f64::from(ms) * 1e-3, 200.0 * (f64::from(ms) * 3.14e-3).sin(), 1.0));
        assert_eq!(tare_of(250.0, rows), None);
    }
}

//! The tare: what is told where nothing loads.
//!
//! On a gripper the same is done with the unloaded fingers, by a command; which means are left alone
//! since friction or the network itself accounts for them, the device's own rule says
//! ([`firmware::tare::offset`]).

use firmware::tare::offset;
use firmware::units::Force;
use model_export::inverse::compensation::OwnedCompensation;

use crate::sums::Sums;

/// The load counts as none below this share of the range, both axes: 1 N of MAGPIE's 250 N.
const UNLOADED: f64 = 1.0 / 250.0;
/// Nor below this, in newtons: the noise of a reference, four standard deviations of 0.15 N, is no load.
const REFERENCE_N: f64 = 0.6;
/// A tare is the mean over up to this long an unloaded stretch, in seconds.
const TARE_S: f64 = 1.0;
/// Shorter stretches are no rest, only a load that passes zero.
const SHORTEST_TARE_S: f64 = 0.2;

/// Friction that may be held at rest, Fx and Fz of a sensor in newtons; zero where the model knows none.
pub fn held_n(compensations: &[OwnedCompensation], sensor: u32) -> [f64; 2] {
    let found = compensations.iter().find(|one| one.number() == sensor);
    found.map_or([0.0; 2], OwnedCompensation::friction_n)
}

/// Looks for the first stretch without load.
#[derive(Clone, Copy, Debug)]
pub struct Rest {
    unloaded_n: f64,
    since_s: Option<f64>,
    last_s: f64,
    sums: [Sums; 2],
    sigmas: [Sums; 2],
    held_n: [f64; 2],
    found: Option<([f64; 2], f64)>,
}

impl Rest {
    /// Of a sensor for forces up to `range_n` in newtons, either way, where friction may hold `held_n`.
    pub fn new(range_n: f64, held_n: [f64; 2]) -> Self {
        Self {
            unloaded_n: (UNLOADED * range_n).max(REFERENCE_N),
            since_s: None,
            last_s: 0.0,
            sums: Default::default(),
            sigmas: Default::default(),
            held_n,
            found: None,
        }
    }

    /// A row: the reference, what is told of it, and the standard deviations where a network tells them.
    pub fn add(
        &mut self,
        time_s: f64,
        reference_n: [f64; 2],
        found_n: [f64; 2],
        sigma_n: Option<[f64; 2]>,
    ) {
        if self.found.is_some() {
            return;
        }
        let loaded = reference_n.iter().any(|n| n.abs() > self.unloaded_n);
        let since_s = *self.since_s.get_or_insert(time_s);
        if loaded || time_s - since_s >= TARE_S {
            self.close();
            self.since_s = None;
            self.last_s = 0.0;
            (self.sums, self.sigmas) = Default::default();
        }
        if !loaded && self.found.is_none() {
            self.since_s.get_or_insert(time_s);
            self.last_s = time_s;
            for (sums, found) in self.sums.iter_mut().zip(found_n) {
                sums.add(found);
            }
            for (sums, sigma) in self.sigmas.iter_mut().zip(sigma_n.unwrap_or_default()) {
                sums.add(sigma);
            }
        }
    }

    fn close(&mut self) {
        let length_s = self.last_s - self.since_s.unwrap_or(self.last_s);
        if length_s >= SHORTEST_TARE_S {
            let tare = [0, 1].map(|axis| {
                let (mean, sigma) = (self.sums[axis].mean(), self.sigmas[axis].mean());
                let error = self.sums[axis].std() / self.sums[axis].rows().sqrt();
                let variance = (error * Force::PER_NEWTON).powi(2).round() as i64;
                let [mean, held, sigma] = [mean, self.held_n[axis], sigma].map(raw);
                offset(mean, variance, held, sigma).newtons()
            });
            self.found = Some((tare, length_s));
        }
    }

    /// Mean of what was told over the stretch, zero where it is no offset, and the stretch's length in
    /// seconds.
    pub fn tare(mut self) -> Option<([f64; 2], f64)> {
        if self.found.is_none() {
            self.close();
        }
        self.found
    }
}

/// In the device's unit.
fn raw(newtons: f64) -> Force {
    Force((newtons * Force::PER_NEWTON).round() as i32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rest_of(
        range_n: f64,
        rows: impl IntoIterator<Item = (f64, f64, f64)>,
    ) -> Option<([f64; 2], f64)> {
        let mut rest = Rest::new(range_n, [0.0; 2]);
        for (time_s, reference, found) in rows {
            rest.add(time_s, [reference, 0.0], [found, 2.0 * found], None);
        }
        rest.tare()
    }

    #[test]
    fn a_tare_is_the_mean_of_the_first_unloaded_second_and_no_more() {
        let rows = (0..3000).map(|ms| {
            (
                f64::from(ms) * 1e-3,
                0.1,
                if ms < 1000 { 5.0 } else { 50.0 },
            )
        });
        let (tare, length_s) = rest_of(250.0, rows).unwrap();
        assert_eq!(tare, [5.0, 10.0]);
        assert!((length_s - 0.999).abs() < 1e-9);
    }

    #[test]
    fn what_is_no_load_to_a_strong_sensor_is_one_to_a_weak_sensor() {
        // A load for a second, then nothing: 0.75 N are 15 % of 5 N and 0.3 % of 250 N.
        let rows = |loaded_n: f64| {
            (0..2000).map(move |ms| {
                let reference = if ms < 1000 { loaded_n } else { 0.0 };
                (f64::from(ms) * 1e-3, reference, reference + 0.25)
            })
        };
        let tare = |range_n, loaded_n| rest_of(range_n, rows(loaded_n)).unwrap().0[0];
        assert_eq!(tare(5.0, 0.75), 0.25);
        assert_eq!(tare(250.0, 0.75), 1.0);
        assert_eq!(tare(250.0, 5.0), 0.25);
        assert_eq!(tare(2000.0, 5.0), 5.25);
        // Noise of the reference ends no rest, however weak the sensor.
        assert_eq!(tare(5.0, 0.25), 0.5);
    }

    #[test]
    fn what_friction_may_hold_at_rest_is_no_tare_and_only_more_is_one() {
        let tare = |held_n: [f64; 2]| {
            let mut rest = Rest::new(250.0, held_n);
            for ms in 0..1500 {
                // Half a newton, told with noise.
                let noise = if ms % 2 == 0 { 0.1 } else { -0.1 };
                let told = [0.5 + noise, -0.5 + noise];
                rest.add(f64::from(ms) * 1e-3, [0.0; 2], told, None);
            }
            rest.tare().unwrap().0.map(|n| (n * 1e3).round() / 1e3)
        };
        assert_eq!(tare([0.0, 0.0]), [0.5, -0.5]);
        assert_eq!(tare([0.6, 0.4]), [0.0, -0.1]);
        // As much as the noise of the mean beyond it says nothing: 3 * 0.1 / sqrt(1000) is 0.0095.
        assert_eq!(tare([0.495, 0.48]), [0.0, -0.02]);
    }

    #[test]
    fn what_a_network_allows_for_is_no_tare() {
        let tare = |sigma_n: f64| {
            let mut rest = Rest::new(250.0, [0.0; 2]);
            for ms in 0..1500 {
                rest.add(
                    f64::from(ms) * 1e-3,
                    [0.0; 2],
                    [0.5, 0.0],
                    Some([sigma_n; 2]),
                );
            }
            rest.tare().unwrap().0[0]
        };
        assert_eq!(tare(0.26), 0.0);
        assert_eq!(tare(0.24), 0.5);
    }

    #[test]
    fn a_load_that_passes_zero_is_no_rest() {
        let rows = (0..3000).map(|ms| {
            (
                f64::from(ms) * 1e-3,
                200.0 * (f64::from(ms) * 3.14e-3).sin(),
                1.0,
            )
        });
        assert_eq!(rest_of(250.0, rows), None);
    }
}

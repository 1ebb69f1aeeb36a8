//! The tare: what is told where nothing loads.

use crate::sums::Sums;

/// The load counts as none below this, both axes, in newtons.
const UNLOADED_N: f64 = 1.0;
/// A tare is the mean over up to this long an unloaded stretch, in seconds.
const TARE_S: f64 = 1.0;
/// Shorter stretches are no rest, only a load that passes zero.
const SHORTEST_TARE_S: f64 = 0.2;

/// Looks for the first stretch without load.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rest {
    since_s: Option<f64>,
    last_s: f64,
    sums: [Sums; 2],
    found: Option<([f64; 2], f64)>,
}

impl Rest {
    /// A row: the reference, and what is told of it.
    pub fn add(&mut self, time_s: f64, reference_n: [f64; 2], found_n: [f64; 2]) {
        if self.found.is_some() {
            return;
        }
        let loaded = reference_n.iter().any(|n| n.abs() > UNLOADED_N);
        let since_s = *self.since_s.get_or_insert(time_s);
        if loaded || time_s - since_s >= TARE_S {
            self.close();
            *self = Self {
                found: self.found,
                ..Self::default()
            };
        }
        if !loaded && self.found.is_none() {
            self.since_s.get_or_insert(time_s);
            self.last_s = time_s;
            for (sums, found) in self.sums.iter_mut().zip(found_n) {
                sums.add(found);
            }
        }
    }

    fn close(&mut self) {
        let length_s = self.last_s - self.since_s.unwrap_or(self.last_s);
        if length_s >= SHORTEST_TARE_S {
            self.found = Some((self.sums.map(|sums| sums.mean()), length_s));
        }
    }

    /// Mean of what was told over the stretch, and its length in seconds.
    pub fn tare(mut self) -> Option<([f64; 2], f64)> {
        if self.found.is_none() {
            self.close();
        }
        self.found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rest_of(rows: impl IntoIterator<Item = (f64, f64, f64)>) -> Option<([f64; 2], f64)> {
        let mut rest = Rest::default();
        for (time_s, reference, found) in rows {
            rest.add(time_s, [reference, 0.0], [found, 2.0 * found]);
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
        let (tare, length_s) = rest_of(rows).unwrap();
        assert_eq!(tare, [5.0, 10.0]);
        assert!((length_s - 0.999).abs() < 1e-9);
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
        assert_eq!(rest_of(rows), None);
    }
}

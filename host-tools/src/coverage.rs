//! Do standard deviations mean what they say? Shares of errors within their multiples, beside those of a
//! Gaussian, with intervals that respect how errors hang together in time.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use statrs::distribution::{ContinuousCDF, Normal};

/// Multiples of a standard deviation that are looked at.
pub const WIDTHS: [f64; 3] = [1.0, 2.0, 3.0];
/// Length of a block of time in seconds: longer than errors hang together at loads of 0.2 Hz and more.
pub const BLOCK_S: f64 = 5.0;
/// Draws of a bootstrap, and its seed.
const DRAWS: usize = 1000;
const SEED: u64 = 1;
/// Shares of a Gaussian at which the calibration curve is told.
const CURVE: [f64; 9] = [0.1, 0.25, 0.5, 0.683, 0.8, 0.9, 0.954, 0.99, 0.997];

/// One error beside the standard deviation that was told of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Told {
    /// The board's clock in seconds.
    pub time_s: f64,
    /// Estimate minus reference in newtons.
    pub error_n: f64,
    /// Standard deviation in newtons.
    pub sigma_n: f64,
}

impl Told {
    fn share(&self) -> f64 {
        self.error_n.abs() / self.sigma_n.max(f64::MIN_POSITIVE)
    }

    /// Number of its block of time.
    pub fn block(&self) -> usize {
        (self.time_s.max(0.0) / BLOCK_S) as usize
    }
}

/// Errors less a tare.
pub fn tared(told: &[Told], tare_n: f64) -> Vec<Told> {
    let less = |one: &Told| Told {
        error_n: one.error_n - tare_n,
        ..*one
    };
    told.iter().map(less).collect()
}

/// The factor on a standard deviation that brings the shares within one and two of it to those of a
/// Gaussian, in the geometric mean of both; `None` where nothing was told.
pub fn factor(told: &[Told]) -> Option<f64> {
    let mut shares: Vec<f64> = told.iter().map(Told::share).collect();
    shares.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        let place = (share * shares.len() as f64) as usize;
        shares.get(place.min(shares.len().checked_sub(1)?)).copied()
    };
    let widths = WIDTHS.iter().take(2);
    let logs = widths.map(|&width| Some((quantile(gaussian(width))? / width).ln()));
    let sum: f64 = logs.sum::<Option<f64>>()?;
    let factor = (0.5 * sum).exp();
    (factor.is_finite() && factor > 0.0).then_some(factor)
}

/// Share of a Gaussian within so many standard deviations.
pub fn gaussian(width: f64) -> f64 {
    let normal = Normal::standard();
    normal.cdf(width) - normal.cdf(-width)
}

/// What the shares came to, over any number of forces that were judged in the same time.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    /// Errors.
    pub rows: usize,
    /// Blocks of time.
    pub blocks: usize,
    /// Shares within [`WIDTHS`].
    pub within: [f64; 3],
    /// Their intervals of 95 %, by drawing blocks of time with replacement, all forces together.
    pub interval: [[f64; 2]; 3],
    /// A Gaussian's share beside that which was found at the same multiple.
    pub curve: Vec<[f64; 2]>,
    /// Root mean square of the standard deviations in newtons.
    pub sigma_n: f64,
    /// Root mean square of the errors in newtons.
    pub rmse_n: f64,
}

impl Coverage {
    /// Of these forces; `None` where nothing was told.
    pub fn of<'a>(forces: impl IntoIterator<Item = &'a [Told]>) -> Option<Self> {
        let told: Vec<Told> = forces.into_iter().flatten().copied().collect();
        let blocks = told.iter().map(Told::block).max()? + 1;
        let mut counts = vec![[0_u32; 4]; blocks];
        for one in &told {
            let own = &mut counts[one.block()];
            own[3] += 1;
            for (count, width) in own.iter_mut().zip(WIDTHS) {
                *count += u32::from(one.share() <= width);
            }
        }
        counts.retain(|own| own[3] > 0);
        let shares = |chosen: &mut dyn Iterator<Item = &[u32; 4]>| {
            let sums = chosen.fold([0.0; 4], |mut sums, own| {
                sums.iter_mut()
                    .zip(own)
                    .for_each(|(s, o)| *s += f64::from(*o));
                sums
            });
            [0, 1, 2].map(|i| sums[i] / sums[3])
        };
        let within = shares(&mut counts.iter());
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let draws: Vec<[f64; 3]> = (0..DRAWS)
            .map(|_| {
                let places: Vec<usize> = (0..counts.len())
                    .map(|_| rng.random_range(0..counts.len()))
                    .collect();
                shares(&mut places.iter().map(|&place| &counts[place]))
            })
            .collect();
        let interval = [0, 1, 2].map(|i| {
            let mut drawn: Vec<f64> = draws.iter().map(|draw| draw[i]).collect();
            drawn.sort_by(f64::total_cmp);
            [drawn[DRAWS / 40], drawn[DRAWS - 1 - DRAWS / 40]]
        });
        let normal = Normal::standard();
        let curve = CURVE.map(|expected| {
            let width = normal.inverse_cdf(0.5 + 0.5 * expected);
            let found = told.iter().filter(|one| one.share() <= width).count();
            [expected, found as f64 / told.len() as f64]
        });
        let rms = |of: fn(&Told) -> f64| {
            let squares: f64 = told.iter().map(|one| of(one) * of(one)).sum();
            (squares / told.len() as f64).sqrt()
        };
        Some(Self {
            rows: told.len(),
            blocks: counts.len(),
            within,
            interval,
            curve: curve.to_vec(),
            sigma_n: rms(|one| one.sigma_n),
            rmse_n: rms(|one| one.error_n),
        })
    }

    /// `68.1 % (66.0 to 70.2)`.
    pub fn words(&self, place: usize) -> String {
        let [least, most] = self.interval[place].map(|share| 100.0 * share);
        format!(
            "{:.1} % ({least:.1} to {most:.1})",
            100.0 * self.within[place]
        )
    }

    /// For `--json`.
    pub fn json(&self) -> Value {
        let [one, two, three] = self.within;
        json!({
            "1": one, "2": two, "3": three, "interval_95": self.interval, "rows": self.rows,
            "blocks": self.blocks, "block_s": BLOCK_S, "seed": SEED, "curve": self.curve,
            "sigma_n": self.sigma_n, "rmse_n": self.rmse_n,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    /// Gaussian errors of 3 N, a hundred in a second, told as `sigma_n`.
    fn told(sigma_n: f64) -> Vec<Told> {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let one = |row: usize| {
            let normal: f64 = StandardNormal.sample(&mut rng);
            Told {
                time_s: 0.01 * row as f64,
                error_n: 3.0 * normal,
                sigma_n,
            }
        };
        (0..10_000).map(one).collect()
    }

    #[test]
    fn a_true_sigma_covers_what_a_gaussian_covers_and_its_factor_is_one() {
        let told = told(3.0);
        let found = Coverage::of([told.as_slice()]).unwrap();
        for (place, width) in WIDTHS.into_iter().enumerate() {
            let expected = gaussian(width);
            assert!((found.within[place] - expected).abs() < 0.01, "{found:?}");
            let [least, most] = found.interval[place];
            assert!(least <= found.within[place] && found.within[place] <= most);
        }
        assert!((factor(&told).unwrap() - 1.0).abs() < 0.02);
        assert!(found.curve.iter().all(|[a, b]| (a - b).abs() < 0.015));
    }

    #[test]
    fn half_a_sigma_covers_too_little_and_its_factor_is_two() {
        let told = told(1.5);
        let found = Coverage::of([told.as_slice()]).unwrap();
        // Within half a standard deviation are 38.3 %.
        assert!((found.within[0] - 0.383).abs() < 0.015, "{found:?}");
        assert!((factor(&told).unwrap() - 2.0).abs() < 0.04);
    }

    #[test]
    fn errors_that_come_in_blocks_widen_the_interval() {
        let width = |errors: &dyn Fn(usize) -> f64| {
            let one = |row: usize| Told {
                time_s: 0.01 * row as f64,
                error_n: errors(row),
                sigma_n: 1.0,
            };
            let told: Vec<Told> = (0..10_000).map(one).collect();
            let [least, most] = Coverage::of([told.as_slice()]).unwrap().interval[0];
            most - least
        };
        // Two thirds within one: by single rows, or by stretches of five seconds.
        let alone = width(&|row| if row % 3 == 0 { 1.5 } else { 0.5 });
        let blocks = width(&|row| if row / 500 % 3 == 0 { 1.5 } else { 0.5 });
        assert!(alone < 0.01 && blocks > 0.2, "{alone} {blocks}");
    }

    #[test]
    fn nothing_told_is_nothing_covered() {
        assert_eq!(Coverage::of([&[] as &[Told]]), None);
        assert_eq!(factor(&[]), None);
    }
}

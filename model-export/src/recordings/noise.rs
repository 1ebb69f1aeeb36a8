//! White noise of a stream, from differences of its own rows.
//!
//! The third difference `x0 - 3 x1 + 3 x2 - x3` of white noise has 20 times its variance, while a
//! smooth motion all but vanishes in it: 200 N at 0.5 Hz leaves 6 mN at 100 Hz. The variance is
//! taken in blocks, and the median over the blocks is used, so that a few jerky stretches do not
//! count. What is smooth over four rows (drift, hum far below the row rate) is not in it.

/// Rows in a block.
const BLOCK: usize = 200;
/// Sum of the squares of the weights 1, -3, 3, -1.
const VARIANCE_GAIN: f64 = 20.0;

/// Collects one column; keeps one number for each 200 rows.
#[derive(Clone, Debug, Default)]
pub struct WhiteNoise {
    last: [f64; 3],
    seen: usize,
    sum: f64,
    count: usize,
    blocks: Vec<f64>,
}

impl WhiteNoise {
    /// Takes the next row's value; NaN starts anew after it.
    pub fn push(&mut self, value: f64) {
        if value.is_nan() {
            self.seen = 0;
            return;
        }
        let [a, b, c] = self.last;
        if self.seen >= 3 {
            let difference = a - 3.0 * b + 3.0 * c - value;
            self.sum += difference * difference;
            self.count += 1;
        }
        self.last = [b, c, value];
        self.seen += 1;
        if self.count == BLOCK {
            self.blocks.push(self.sum / BLOCK as f64);
            (self.sum, self.count) = (0.0, 0);
        }
    }

    /// Standard deviation of the white part, in the unit of the values; `None` before four rows.
    pub fn estimate(&self) -> Option<f64> {
        let mut blocks = self.blocks.clone();
        if blocks.is_empty() && self.count > 0 {
            blocks.push(self.sum / self.count as f64);
        }
        blocks.sort_by(f64::total_cmp);
        let middle = blocks.len() / 2;
        let median = match blocks.len() {
            0 => return None,
            n if n % 2 == 1 => blocks[middle],
            _ => 0.5 * (blocks[middle - 1] + blocks[middle]),
        };
        Some((median / VARIANCE_GAIN).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn noise_is_found_under_a_large_motion_and_a_rough_stretch() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut noise = WhiteNoise::default();
        for row in 0..20_000 {
            let t = f64::from(row) * 0.01;
            // Variance of the sum of 12 uniform numbers is 1.
            let gauss: f64 = (0..12).map(|_| rng.random::<f64>() - 0.5).sum();
            let rough = if row % 5000 < 500 { 40.0 * gauss } else { 0.0 };
            noise.push(200.0 * (std::f64::consts::PI * t).sin() + 0.15 * gauss + rough);
        }
        let found = noise.estimate().unwrap();
        assert!((found / 0.15 - 1.0).abs() < 0.03, "{found}");
    }

    #[test]
    fn a_cubic_has_no_noise_but_its_third_derivative() {
        let mut noise = WhiteNoise::default();
        (0..10).for_each(|i| noise.push(f64::from(i * i)));
        assert_eq!(noise.estimate(), Some(0.0));
    }

    #[test]
    fn three_rows_cannot_tell() {
        let mut noise = WhiteNoise::default();
        [1.0, 2.0, 3.0].into_iter().for_each(|x| noise.push(x));
        assert_eq!(noise.estimate(), None);
    }
}

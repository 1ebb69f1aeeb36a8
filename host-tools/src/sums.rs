//! Sums over rows, from which mean, root mean square and standard deviation follow.

/// Sums over rows from which every statistic follows.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sums {
    count: f64,
    sum: f64,
    squares: f64,
}

impl Sums {
    /// One value more.
    pub fn add(&mut self, value: f64) {
        self.count += 1.0;
        self.sum += value;
        self.squares += value * value;
    }

    /// The sums over both.
    pub fn with(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            sum: self.sum + other.sum,
            squares: self.squares + other.squares,
        }
    }

    /// The sums had every value been less by `offset`.
    pub fn less(self, offset: f64) -> Self {
        Self {
            squares: self.squares - 2.0 * offset * self.sum + self.count * offset * offset,
            sum: self.sum - self.count * offset,
            ..self
        }
    }

    /// Mean.
    pub fn mean(&self) -> f64 {
        self.sum / self.count
    }

    /// Root of the mean square.
    pub fn rms(&self) -> f64 {
        (self.squares / self.count).sqrt()
    }

    /// Standard deviation: what is left of the root mean square without the mean.
    pub fn std(&self) -> f64 {
        (self.squares / self.count - self.mean().powi(2))
            .max(0.0)
            .sqrt()
    }

    /// Rows.
    pub fn rows(&self) -> f64 {
        self.count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_after_an_offset_are_those_of_the_shifted_values() {
        let mut sums = Sums::default();
        [1.0, 2.0, 6.0]
            .into_iter()
            .for_each(|value| sums.add(value));
        let shifted = sums.less(3.0);
        assert_eq!((sums.mean(), shifted.mean()), (3.0, 0.0));
        assert!((shifted.rms() - (14.0_f64 / 3.0).sqrt()).abs() < 1e-12);
        assert!((shifted.std() - sums.std()).abs() < 1e-12);
    }
}

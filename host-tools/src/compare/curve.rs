//! Long traces, decimated without hiding their peaks.

/// A trace as an envelope: in each stretch of time the least and the greatest value.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// Middle of each stretch in seconds.
    pub time_s: Vec<f64>,
    /// Least value in it.
    pub low: Vec<f64>,
    /// Greatest value in it; the same as `low` where a stretch is one row.
    pub high: Vec<f64>,
}

impl Curve {
    /// The envelope of these rows in at most `most` stretches of equally many rows; numbers that are
    /// none leave a hole only where a whole stretch has no other.
    pub fn of(time_s: &[f64], values: &[f64], most: usize) -> Self {
        let rows = time_s.len().min(values.len());
        let each = rows.div_ceil(most.max(1)).max(1);
        let mut curve = Self::default();
        for (time, values) in time_s[..rows].chunks(each).zip(values[..rows].chunks(each)) {
            curve
                .time_s
                .push(time.iter().sum::<f64>() / time.len() as f64);
            curve
                .low
                .push(values.iter().copied().fold(f64::NAN, f64::min));
            curve
                .high
                .push(values.iter().copied().fold(f64::NAN, f64::max));
        }
        curve
    }

    /// Number of stretches.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True without any.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// The same in fewer stretches.
    pub fn coarser(&self, most: usize) -> Self {
        Self {
            low: Self::of(&self.time_s, &self.low, most).low,
            high: Self::of(&self.time_s, &self.high, most).high,
            time_s: Self::of(&self.time_s, &self.low, most).time_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_highest_and_the_lowest_row_survive_however_few_stretches_are_drawn() {
        let time_s: Vec<f64> = (0..1000).map(f64::from).collect();
        let mut values = vec![0.0; 1000];
        values[313] = 7.0;
        values[314] = -9.0;
        for most in [1, 3, 10, 999] {
            let curve = Curve::of(&time_s, &values, most);
            assert!(curve.len() <= most);
            for curve in [curve.coarser(2), curve] {
                assert_eq!(curve.high.iter().copied().fold(0.0, f64::max), 7.0);
                assert_eq!(curve.low.iter().copied().fold(0.0, f64::min), -9.0);
            }
        }
    }

    #[test]
    fn a_short_trace_is_kept_row_by_row() {
        let curve = Curve::of(&[0.0, 1.0, 2.0], &[5.0, f64::NAN, 4.0], 10);
        assert_eq!(curve.time_s, [0.0, 1.0, 2.0]);
        assert_eq!(curve.low[0], curve.high[0]);
        assert!(curve.low[1].is_nan());
    }
}

//! A covariate cut into bins: quantiles, or one bin for each value where there are few.

/// Quantile bins of a covariate.
const BINS: usize = 12;

/// The bins of one covariate.
#[derive(Clone, Debug, PartialEq)]
pub struct Binning {
    /// Least and greatest value in each bin.
    pub ranges: Vec<(f64, f64)>,
    /// Mean value in each bin.
    pub centres: Vec<f64>,
    /// For each sensor the bin of each row; [`Binning::NONE`] where the covariate was not recorded.
    pub of: Vec<Vec<u16>>,
}

impl Binning {
    /// No bin.
    pub const NONE: u16 = u16::MAX;

    /// One bin for everything.
    pub fn whole(values: &[&[f32]]) -> Self {
        Self {
            ranges: vec![(0.0, 0.0)],
            centres: vec![0.0],
            of: values.iter().map(|values| vec![0; values.len()]).collect(),
        }
    }

    /// Bins of the values of all sensors together; `None` where there are not two different ones.
    pub fn of(values: &[&[f32]]) -> Option<Self> {
        let all = || values.iter().flat_map(|values| values.iter().copied());
        let mut sorted: Vec<f32> = all().filter(|value| value.is_finite()).collect();
        sorted.sort_by(f32::total_cmp);
        let lower = lower_edges(&sorted);
        if lower.len() < 2 {
            return None;
        }
        let bin = |value: &f32| match value.is_finite() {
            true => lower
                .partition_point(|edge| edge <= value)
                .saturating_sub(1) as u16,
            false => Self::NONE,
        };
        let mut binning = Self {
            of: values
                .iter()
                .map(|values| values.iter().map(bin).collect())
                .collect(),
            ranges: Vec::new(),
            centres: Vec::new(),
        };
        for (i, low) in lower.iter().enumerate() {
            let from = sorted.partition_point(|value| value < low);
            let to = lower.get(i + 1).map_or(sorted.len(), |next| {
                sorted.partition_point(|value| value < next)
            });
            let inside = &sorted[from..to];
            let sum: f64 = inside.iter().map(|value| f64::from(*value)).sum();
            binning.centres.push(sum / inside.len().max(1) as f64);
            let end = |value: Option<&f32>| value.map_or(f64::NAN, |value| f64::from(*value));
            binning
                .ranges
                .push((end(inside.first()), end(inside.last())));
        }
        Some(binning)
    }

    /// Number of bins.
    pub fn count(&self) -> usize {
        self.ranges.len()
    }
}

/// The least value of each bin, rising: quantiles, each once.
fn lower_edges(sorted: &[f32]) -> Vec<f32> {
    let mut distinct: Vec<f32> = Vec::new();
    for value in sorted {
        if distinct.last() != Some(value) {
            distinct.push(*value);
        }
        if distinct.len() > BINS {
            break;
        }
    }
    if distinct.len() <= BINS {
        return distinct;
    }
    let mut edges: Vec<f32> = (0..BINS).map(|i| sorted[i * sorted.len() / BINS]).collect();
    edges.dedup();
    edges
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_values_fall_into_bins_of_equally_many_rows() {
        let values: Vec<f32> = (0..1200).map(|i| (i as f32).powi(2)).collect();
        let binning = Binning::of(&[&values[..700], &values[700..]]).unwrap();
        assert_eq!(binning.count(), 12);
        for bin in 0..12 {
            let rows = binning.of.iter().flatten().filter(|b| **b == bin).count();
            assert_eq!(rows, 100, "bin {bin}");
        }
        assert_eq!(binning.ranges[1], (10_000.0, 39_601.0));
    }

    #[test]
    fn few_values_have_a_bin_each_and_holes_have_none() {
        let binning = Binning::of(&[&[-1.0, 0.0, 1.0, f32::NAN, 1.0]]).unwrap();
        assert_eq!(binning.centres, [-1.0, 0.0, 1.0]);
        assert_eq!(binning.of[0], [0, 1, 2, Binning::NONE, 2]);
    }

    #[test]
    fn a_covariate_that_never_moves_has_no_bins() {
        assert_eq!(Binning::of(&[&[5.0, 5.0], &[5.0]]), None);
    }
}

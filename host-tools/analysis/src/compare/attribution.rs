//! Attribution of the residual to covariates by forward selection.
//!
//! A covariate explains what a straight line through the residual in each of its bins predicts on held-out
//! rows. The best covariate is selected, its prediction subtracted, and the next one evaluated on the
//! remainder, so that two correlated covariates are not both selected.

use crate::compare::covariates::CovariateKind;
use crate::compare::residual_table::ResidualTable;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Minimum fraction of the excess that a selected covariate explains.
pub const MIN_SHARE: f64 = 0.05;
/// A squared residual above the floor by more than this fraction of the floor is structure.
const STRUCTURE: f64 = 0.3;
/// Below [`MIN_SHARE`], covariates are selected while they explain this fraction of the remaining structure.
const MIN_OF_REMAINDER: f64 = 0.25;
/// Maximum number of selected covariates.
const MAX_SELECTED: usize = 6;
/// Time is selected only if it explains this many times as much as the best quantity, because it is confounded
/// with everything slow.
const TIME_FACTOR: f64 = 2.0;
/// Minimum of the excess relative to the squared residual; avoids division by zero at the floor.
const MIN_EXCESS: f64 = 0.1;
/// Minimum rows for a prediction.
const MIN_ROWS: f64 = 5.0;
/// Number of folds within recordings.
const FOLDS: usize = 6;
/// Maximum number of folds by recording; more recordings are grouped.
const MAX_FOLDS: usize = 10;

/// A covariate with its explained fraction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RankedCovariate {
    /// Column index of the covariate.
    pub covariate: usize,
    /// Fraction of the excess explained in addition to the covariates selected before.
    pub share: f64,
    /// Fraction explained alone.
    pub alone: f64,
    /// Whether it was selected.
    pub chosen: bool,
}

/// Attributes the residuals of all sensors to covariates.
pub struct Attributor<'a> {
    sensors: &'a [ResidualTable],
    kinds: Vec<CovariateKind>,
    /// Bins by covariate; `None` where it is missing or constant.
    pub binnings: Vec<Option<Binning>>,
    /// Fold of each row by sensor: by recordings (or sixths of them), and by blocks of time.
    folds: [Vec<Vec<u8>>; 2],
    /// True if the first kind of fold leaves out whole recordings.
    by_recordings: bool,
    excess: f64,
    /// Squared floor over all rows.
    floor: f64,
}

impl<'a> Attributor<'a> {
    /// `block_s`: length of the blocks in seconds, longer than the correlation time of the residual.
    pub fn new(sensors: &'a [ResidualTable], block_s: f64) -> Self {
        let recordings = sensors
            .iter()
            .flat_map(|sensor| sensor.recording.last())
            .max()
            .map_or(0, |last| *last as usize + 1);
        let by_recordings = recordings >= 3;
        let group = |recording: u32| (recording as usize % MAX_FOLDS) as u8;
        let block = |time: f64| ((time / block_s) as usize % FOLDS) as u8;
        let first = |sensor: &ResidualTable| {
            if by_recordings {
                sensor.recording.iter().map(|r| group(*r)).collect()
            } else {
                sixths(sensor)
            }
        };
        let second =
            |sensor: &ResidualTable| sensor.time_s.iter().map(|t| block(*t)).collect::<Vec<u8>>();
        let kinds: Vec<CovariateKind> = sensors
            .first()
            .map_or_else(Vec::new, |s| s.covariates.iter().map(|c| c.of.kind).collect());
        let binnings = (0..kinds.len())
            .into_par_iter()
            .map(|c| {
                let values: Vec<&[f32]> =
                    sensors.iter().map(|sensor| sensor.covariates[c].values.as_slice()).collect();
                match kinds[c] {
                    CovariateKind::Constant => Some(Binning::whole(&values)),
                    _ => Binning::of(&values),
                }
            })
            .collect();
        let (squares, floor) = sums(sensors);
        Self {
            binnings,
            folds: [sensors.iter().map(first).collect(), sensors.iter().map(second).collect()],
            by_recordings,
            excess: (squares - floor).max(MIN_EXCESS * squares).max(f64::MIN_POSITIVE),
            floor,
            sensors,
            kinds,
        }
    }

    /// All covariates that vary: the selected ones in order, then the others by the fraction of the remainder
    /// that they explain.
    pub fn rank(&self) -> Vec<RankedCovariate> {
        let mut residual: Vec<Vec<Vector3<f64>>> =
            self.sensors.iter().map(|sensor| sensor.residual.clone()).collect();
        let mut remaining: Vec<usize> =
            (0..self.kinds.len()).filter(|c| self.binnings[*c].is_some()).collect();
        let alone = self.shares(&remaining, &residual);
        let alone_of = |covariate: usize| {
            alone.iter().find(|(c, _)| *c == covariate).map_or(0.0, |(_, share)| *share)
        };
        let mut ranked = Vec::new();
        let mut shares = alone.clone();
        while ranked.len() < MAX_SELECTED
            && let Some((covariate, share)) = self.best(&shares)
            && self.is_relevant(share, &residual)
        {
            ranked.push(RankedCovariate {
                covariate,
                share,
                alone: alone_of(covariate),
                chosen: true,
            });
            if let Some(predicted) = self.predict(covariate, &residual) {
                for (residual, predicted) in residual.iter_mut().zip(&predicted) {
                    residual.iter_mut().zip(predicted).for_each(|(r, p)| *r -= p);
                }
            }
            remaining.retain(|other| *other != covariate);
            shares = self.shares(&remaining, &residual);
        }
        shares.sort_by(|a, b| b.1.total_cmp(&a.1));
        ranked.extend(shares.into_iter().map(|(covariate, share)| RankedCovariate {
            covariate,
            share,
            alone: alone_of(covariate),
            chosen: false,
        }));
        ranked
    }

    /// Explained fraction of each covariate; zero if the prediction increases the error.
    fn shares(&self, of: &[usize], residual: &[Vec<Vector3<f64>>]) -> Vec<(usize, f64)> {
        of.par_iter()
            .map(|&covariate| {
                let gain = self.predict(covariate, residual).map_or(0.0, |predicted| {
                    let pairs = residual.iter().flatten().zip(predicted.iter().flatten());
                    pairs.map(|(r, p)| r.norm_squared() - (r - p).norm_squared()).sum::<f64>()
                });
                (covariate, (gain / self.excess).max(0.0))
            })
            .collect()
    }

    /// Prediction of each row from the other folds.
    fn predict(
        &self,
        covariate: usize,
        residual: &[Vec<Vector3<f64>>],
    ) -> Option<Vec<Vec<Vector3<f64>>>> {
        let binning = self.binnings[covariate].as_ref()?;
        let within = match self.kinds[covariate] {
            CovariateKind::Constant | CovariateKind::Quantity => false,
            CovariateKind::Time => !self.by_recordings,
            CovariateKind::TimeOfCampaign => true,
        };
        let folds = &self.folds[usize::from(within)];
        let one = |i: usize| {
            let values = &self.sensors[i].covariates[covariate].values;
            predict_held_out(&residual[i], values, &binning.of[i], &folds[i], binning)
        };
        Some((0..residual.len()).map(one).collect())
    }

    /// Whether a covariate explains enough of the excess, or of the remaining structure.
    fn is_relevant(&self, share: f64, residual: &[Vec<Vector3<f64>>]) -> bool {
        let remainder: f64 = residual.iter().flatten().map(Vector3::norm_squared).sum();
        let structure = remainder - self.floor;
        share >= MIN_SHARE
            || (structure > STRUCTURE * self.floor
                && share * self.excess >= MIN_OF_REMAINDER * structure)
    }

    /// The covariate to select next.
    fn best(&self, shares: &[(usize, f64)]) -> Option<(usize, f64)> {
        // Any covariate would explain a constant, so the constant comes first.
        let constant = shares.iter().find(|(c, _)| self.kinds[*c] == CovariateKind::Constant);
        if let Some(constant) = constant.filter(|(_, share)| *share >= MIN_SHARE) {
            return Some(*constant);
        }
        let max = |time: bool| {
            let is_time = |c: usize| {
                matches!(self.kinds[c], CovariateKind::Time | CovariateKind::TimeOfCampaign)
            };
            let of = shares
                .iter()
                .filter(|(c, _)| is_time(*c) == time && self.kinds[*c] != CovariateKind::Constant);
            of.copied().max_by(|a, b| a.1.total_cmp(&b.1))
        };
        match (max(false), max(true)) {
            (Some(quantity), Some(time)) if time.1 > TIME_FACTOR * quantity.1.max(MIN_SHARE) => {
                Some(time)
            }
            // Time may explain what no quantity does.
            (Some(quantity), Some(time)) if quantity.1 < MIN_SHARE => Some(time),
            (quantity, time) => quantity.or(time),
        }
    }
}

/// Sums over the rows of one bin for a linear regression.
#[derive(Clone, Copy, Default)]
struct Regression {
    rows: f64,
    x: f64,
    xx: f64,
    r: Vector3<f64>,
    xr: Vector3<f64>,
}

impl Regression {
    fn add(&mut self, x: f64, r: &Vector3<f64>) {
        self.rows += 1.0;
        self.x += x;
        self.xx += x * x;
        self.r += r;
        self.xr += r * x;
    }

    fn without(&self, other: &Self) -> Self {
        Self {
            rows: self.rows - other.rows,
            x: self.x - other.x,
            xx: self.xx - other.xx,
            r: self.r - other.r,
            xr: self.xr - other.xr,
        }
    }

    /// Value of the line at `x`: zero with too few rows, the mean if `x` is constant.
    fn at(&self, x: f64) -> Vector3<f64> {
        if self.rows < MIN_ROWS {
            return Vector3::zeros();
        }
        let (middle, mean) = (self.x / self.rows, self.r / self.rows);
        let variance = self.xx / self.rows - middle * middle;
        if variance <= 1e-9 * (self.xx / self.rows) {
            return mean;
        }
        // No extrapolation beyond two standard deviations.
        let reach = 2.0 * variance.sqrt();
        let slope = (self.xr / self.rows - mean * middle) / variance;
        mean + slope * (x - middle).clamp(-reach, reach)
    }
}

/// Prediction of each row by the line through its bin, without its own fold.
fn predict_held_out(
    residual: &[Vector3<f64>],
    values: &[f32],
    bins: &[u16],
    folds: &[u8],
    binning: &Binning,
) -> Vec<Vector3<f64>> {
    let folds_count = FOLDS.max(MAX_FOLDS);
    let mut sums = vec![Regression::default(); binning.count() * (folds_count + 1)];
    let at = |bin: u16, fold: usize| usize::from(bin) * (folds_count + 1) + fold;
    let from_centre = |value: f32, bin: u16| f64::from(value) - binning.centres[usize::from(bin)];
    for (((r, &bin), &fold), &value) in residual.iter().zip(bins).zip(folds).zip(values) {
        if bin != Binning::NONE {
            let x = from_centre(value, bin);
            sums[at(bin, usize::from(fold))].add(x, r);
            sums[at(bin, folds_count)].add(x, r);
        }
    }
    let line = |((&bin, &fold), &value): ((&u16, &u8), &f32)| match bin {
        Binning::NONE => Vector3::zeros(),
        _ => sums[at(bin, folds_count)]
            .without(&sums[at(bin, usize::from(fold))])
            .at(from_centre(value, bin)),
    };
    bins.iter().zip(folds).zip(values).map(line).collect()
}

/// Sums of squared residual and squared floor.
fn sums(sensors: &[ResidualTable]) -> (f64, f64) {
    let squares = sensors.iter().flat_map(|s| &s.residual).map(Vector3::norm_squared);
    let floor = sensors.iter().flat_map(|s| &s.floor2).map(Vector3::sum);
    (squares.sum(), floor.sum())
}

/// Contiguous sixths of each recording.
fn sixths(sensor: &ResidualTable) -> Vec<u8> {
    let mut folds = Vec::with_capacity(sensor.len());
    for chunk in sensor.recording.chunk_by(|a, b| a == b) {
        folds.extend((0..chunk.len()).map(|row| (row * FOLDS / chunk.len()) as u8));
    }
    folds
}

/// Number of quantile bins, at least and at most.
const BINS: (usize, usize) = (3, 12);
/// Rows of a bin: a table of settings has fewer bins than a recording.
const BIN_ROWS: usize = 12;

/// Bins of one covariate: quantiles, or one bin per value where there are few.
#[derive(Clone, Debug, PartialEq)]
pub struct Binning {
    /// Minimum and maximum of each bin.
    pub ranges: Vec<(f64, f64)>,
    /// Mean of each bin.
    pub centres: Vec<f64>,
    /// Bin of each row by sensor; [`Binning::NONE`] where the covariate was not recorded.
    pub of: Vec<Vec<u16>>,
}

impl Binning {
    /// Bin of rows without the covariate.
    pub const NONE: u16 = u16::MAX;

    /// One bin for all rows.
    pub fn whole(values: &[&[f32]]) -> Self {
        Self {
            ranges: vec![(0.0, 0.0)],
            centres: vec![0.0],
            of: values.iter().map(|values| vec![0; values.len()]).collect(),
        }
    }

    /// Bins over the values of all sensors; `None` for a constant.
    pub fn of(values: &[&[f32]]) -> Option<Self> {
        let all = || values.iter().flat_map(|values| values.iter().copied());
        let mut sorted: Vec<f32> = all().filter(|value| value.is_finite()).collect();
        sorted.sort_by(f32::total_cmp);
        let lower = lower_edges(&sorted);
        if lower.len() < 2 {
            return None;
        }
        let bin = |value: &f32| {
            if value.is_finite() {
                lower.partition_point(|edge| edge <= value).saturating_sub(1) as u16
            } else {
                Self::NONE
            }
        };
        let mut binning = Self {
            of: values.iter().map(|values| values.iter().map(bin).collect()).collect(),
            ranges: Vec::new(),
            centres: Vec::new(),
        };
        for (i, low) in lower.iter().enumerate() {
            let from = sorted.partition_point(|value| value < low);
            let to = lower
                .get(i + 1)
                .map_or(sorted.len(), |next| sorted.partition_point(|value| value < next));
            let inside = &sorted[from..to];
            let sum: f64 = inside.iter().map(|value| f64::from(*value)).sum();
            binning.centres.push(sum / inside.len().max(1) as f64);
            let end = |value: Option<&f32>| value.map_or(f64::NAN, |value| f64::from(*value));
            binning.ranges.push((end(inside.first()), end(inside.last())));
        }
        Some(binning)
    }

    /// Number of bins.
    pub fn count(&self) -> usize {
        self.ranges.len()
    }
}

/// Lower edges of the bins: distinct quantiles in rising order.
fn lower_edges(sorted: &[f32]) -> Vec<f32> {
    let (least, most) = BINS;
    let bins = (sorted.len() / BIN_ROWS).clamp(least, most);
    let mut distinct: Vec<f32> = Vec::new();
    for value in sorted {
        if distinct.last() != Some(value) {
            distinct.push(*value);
        }
        if distinct.len() > bins {
            break;
        }
    }
    if distinct.len() <= bins {
        return distinct;
    }
    let mut edges: Vec<f32> = (0..bins).map(|i| sorted[i * sorted.len() / bins]).collect();
    edges.dedup();
    edges
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantile_bins_have_equal_row_counts() {
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
    fn few_values_have_one_bin_each_and_nan_has_none() {
        let binning = Binning::of(&[&[-1.0, 0.0, 1.0, f32::NAN, 1.0]]).unwrap();
        assert_eq!(binning.centres, [-1.0, 0.0, 1.0]);
        assert_eq!(binning.of[0], [0, 1, 2, Binning::NONE, 2]);
    }

    #[test]
    fn constant_covariate_has_no_bins() {
        assert_eq!(Binning::of(&[&[5.0, 5.0], &[5.0]]), None);
    }
}

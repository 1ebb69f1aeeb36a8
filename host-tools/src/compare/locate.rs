//! Where a model fails: which covariates the residual follows, one after the other.
//!
//! A covariate locates what the residual in its bins (a straight line in each) predicts of rows that
//! took no part. The one that locates most comes first; what it predicts is taken away, and the next
//! is judged on what is left, so that two covariates which move together are not both blamed.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::binning::Binning;
use super::covariate::Kind;
use super::rows::SensorColumns;

/// Covariates are chosen while the next locates at least this share of the excess.
pub const WORTH: f64 = 0.05;
/// More than this share of the squared floor, above it, is structure and no noise.
const STRUCTURE: f64 = 0.3;
/// Beyond [`WORTH`], covariates are chosen while the next locates this share of the structure left.
const OF_THE_REST: f64 = 0.25;
/// Covariates that are chosen at the most: a person reads no longer list.
const MOST: usize = 6;
/// Time must locate this many times what the best quantity does: it can stand in for anything slow.
const TIME_BEYOND: f64 = 2.0;
/// The excess over the floor counts as at least this share of the squared residual: at the floor
/// there is next to nothing that could be located, and shares of nothing mean nothing.
const LEAST_EXCESS: f64 = 0.1;
/// Fewer rows predict nothing.
const FEWEST_ROWS: f64 = 20.0;
/// Folds where recordings are not left out one by one.
const FOLDS: usize = 6;
/// More recordings than this are left out in groups.
const MOST_FOLDS: usize = 10;

/// One covariate and what it locates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Its place among the columns.
    pub covariate: usize,
    /// Share of the excess beyond the chosen ones before it.
    pub share: f64,
    /// The same had nothing been located before.
    pub alone: f64,
    /// Whether it was chosen.
    pub chosen: bool,
}

/// Residuals of all sensors, ready to be located.
pub struct Locator<'a> {
    sensors: &'a [SensorColumns],
    kinds: Vec<Kind>,
    /// For each covariate its bins; `None` where it is absent or never moves.
    pub binnings: Vec<Option<Binning>>,
    /// For each sensor and row: the fold by recordings (or stretches of them), and by blocks of time.
    folds: [Vec<Vec<u8>>; 2],
    /// True where the first kind of fold leaves out whole recordings.
    by_recordings: bool,
    excess: f64,
    /// Squared floor over everything.
    floor: f64,
}

impl<'a> Locator<'a> {
    /// `block_s` is the length of the blocks in which a residual forgets.
    pub fn new(sensors: &'a [SensorColumns], block_s: f64) -> Self {
        let recordings = sensors
            .iter()
            .flat_map(|sensor| sensor.recording.last())
            .max()
            .map_or(0, |last| *last as usize + 1);
        let by_recordings = recordings >= 3;
        let group = |recording: u32| (recording as usize % MOST_FOLDS) as u8;
        let block = |time: f64| ((time / block_s) as usize % FOLDS) as u8;
        let first = |sensor: &SensorColumns| match by_recordings {
            true => sensor.recording.iter().map(|r| group(*r)).collect(),
            false => sixths(sensor),
        };
        let second =
            |sensor: &SensorColumns| sensor.time_s.iter().map(|t| block(*t)).collect::<Vec<u8>>();
        let kinds: Vec<Kind> = sensors.first().map_or_else(Vec::new, |s| {
            s.covariates.iter().map(|c| c.of.kind).collect()
        });
        let binnings = (0..kinds.len())
            .into_par_iter()
            .map(|c| {
                let values: Vec<&[f32]> = sensors
                    .iter()
                    .map(|sensor| sensor.covariates[c].values.as_slice())
                    .collect();
                match kinds[c] {
                    Kind::Constant => Some(Binning::whole(&values)),
                    _ => Binning::of(&values),
                }
            })
            .collect();
        let (squares, floor) = sums(sensors);
        Self {
            binnings,
            folds: [
                sensors.iter().map(first).collect(),
                sensors.iter().map(second).collect(),
            ],
            by_recordings,
            excess: (squares - floor)
                .max(LEAST_EXCESS * squares)
                .max(f64::MIN_POSITIVE),
            floor,
            sensors,
            kinds,
        }
    }

    /// Every covariate that moves: the chosen ones in their order, then the rest by what they would
    /// still locate.
    pub fn rank(&self) -> Vec<Found> {
        let mut residual: Vec<Vec<Vector3<f64>>> = self
            .sensors
            .iter()
            .map(|sensor| sensor.residual_g.clone())
            .collect();
        let mut left: Vec<usize> = (0..self.kinds.len())
            .filter(|c| self.binnings[*c].is_some())
            .collect();
        let alone = self.shares(&left, &residual);
        let alone_of = |covariate: usize| {
            alone
                .iter()
                .find(|(c, _)| *c == covariate)
                .map_or(0.0, |(_, share)| *share)
        };
        let mut ranked = Vec::new();
        let mut shares = alone.clone();
        while ranked.len() < MOST
            && let Some((covariate, share)) = self.best(&shares)
            && self.is_worth(share, &residual)
        {
            ranked.push(Found {
                covariate,
                share,
                alone: alone_of(covariate),
                chosen: true,
            });
            if let Some(predicted) = self.predict(covariate, &residual) {
                for (residual, predicted) in residual.iter_mut().zip(&predicted) {
                    residual
                        .iter_mut()
                        .zip(predicted)
                        .for_each(|(r, p)| *r -= p);
                }
            }
            left.retain(|other| *other != covariate);
            shares = self.shares(&left, &residual);
        }
        shares.sort_by(|a, b| b.1.total_cmp(&a.1));
        ranked.extend(shares.into_iter().map(|(covariate, share)| Found {
            covariate,
            share,
            alone: alone_of(covariate),
            chosen: false,
        }));
        ranked
    }

    /// The share of each covariate: zero where it predicts worse than nothing.
    fn shares(&self, of: &[usize], residual: &[Vec<Vector3<f64>>]) -> Vec<(usize, f64)> {
        of.par_iter()
            .map(|&covariate| {
                let gain = self.predict(covariate, residual).map_or(0.0, |predicted| {
                    let pairs = residual.iter().flatten().zip(predicted.iter().flatten());
                    pairs
                        .map(|(r, p)| r.norm_squared() - (r - p).norm_squared())
                        .sum::<f64>()
                });
                (covariate, (gain / self.excess).max(0.0))
            })
            .collect()
    }

    /// What the rows of all other folds say of each row's bin.
    fn predict(
        &self,
        covariate: usize,
        residual: &[Vec<Vector3<f64>>],
    ) -> Option<Vec<Vec<Vector3<f64>>>> {
        let binning = self.binnings[covariate].as_ref()?;
        let within = match self.kinds[covariate] {
            Kind::Constant | Kind::Quantity => false,
            Kind::Time => !self.by_recordings,
            Kind::TimeOfCampaign => true,
        };
        let folds = &self.folds[usize::from(within)];
        let one = |i: usize| {
            let values = &self.sensors[i].covariates[covariate].values;
            without_own(&residual[i], values, &binning.of[i], &folds[i], binning)
        };
        Some((0..residual.len()).map(one).collect())
    }

    /// Whether the next covariate is worth naming: for its share of everything, or, where far more than
    /// noise is left, for its share of that.
    fn is_worth(&self, share: f64, residual: &[Vec<Vector3<f64>>]) -> bool {
        let left: f64 = residual.iter().flatten().map(Vector3::norm_squared).sum();
        let structure = left - self.floor;
        share >= WORTH
            || (structure > STRUCTURE * self.floor
                && share * self.excess >= OF_THE_REST * structure)
    }

    /// The covariate to choose next.
    fn best(&self, shares: &[(usize, f64)]) -> Option<(usize, f64)> {
        // What is a constant, every covariate would locate.
        let constant = shares
            .iter()
            .find(|(c, _)| self.kinds[*c] == Kind::Constant);
        if let Some(constant) = constant.filter(|(_, share)| *share >= WORTH) {
            return Some(*constant);
        }
        let most = |time: bool| {
            let is_time = |c: usize| matches!(self.kinds[c], Kind::Time | Kind::TimeOfCampaign);
            let of = shares
                .iter()
                .filter(|(c, _)| is_time(*c) == time && self.kinds[*c] != Kind::Constant);
            of.copied().max_by(|a, b| a.1.total_cmp(&b.1))
        };
        match (most(false), most(true)) {
            (Some(quantity), Some(time)) if time.1 > TIME_BEYOND * quantity.1.max(WORTH) => {
                Some(time)
            }
            // What no quantity locates, time may.
            (Some(quantity), Some(time)) if quantity.1 < WORTH => Some(time),
            (quantity, time) => quantity.or(time),
        }
    }
}

/// Sums over the rows of one bin, from which the straight line through them follows.
#[derive(Clone, Copy, Default)]
struct Line {
    rows: f64,
    x: f64,
    xx: f64,
    r: Vector3<f64>,
    xr: Vector3<f64>,
}

impl Line {
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

    /// The line's value at `x`; nothing where too few rows tell it, and level where they are at one
    /// value.
    fn at(&self, x: f64) -> Vector3<f64> {
        if self.rows < FEWEST_ROWS {
            return Vector3::zeros();
        }
        let (middle, mean) = (self.x / self.rows, self.r / self.rows);
        let spread = self.xx / self.rows - middle * middle;
        if spread <= 1e-9 * (self.xx / self.rows) {
            return mean;
        }
        // Outside the values that tell it, a line says nothing more.
        let reach = 2.0 * spread.sqrt();
        let slope = (self.xr / self.rows - mean * middle) / spread;
        mean + slope * (x - middle).clamp(-reach, reach)
    }
}

/// For each row the straight line through its bin without its own fold: a bin may be wide where a
/// residual is steep.
fn without_own(
    residual: &[Vector3<f64>],
    values: &[f32],
    bins: &[u16],
    folds: &[u8],
    binning: &Binning,
) -> Vec<Vector3<f64>> {
    let folds_count = FOLDS.max(MOST_FOLDS);
    let mut sums = vec![Line::default(); binning.count() * (folds_count + 1)];
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

/// Squared residual and squared floor over everything.
fn sums(sensors: &[SensorColumns]) -> (f64, f64) {
    let squares = sensors
        .iter()
        .flat_map(|s| &s.residual_g)
        .map(Vector3::norm_squared);
    let floor = sensors.iter().flat_map(|s| &s.floor_g2).map(Vector3::sum);
    (squares.sum(), floor.sum())
}

/// Contiguous sixths of each recording.
fn sixths(sensor: &SensorColumns) -> Vec<u8> {
    let mut folds = Vec::with_capacity(sensor.len());
    for chunk in sensor.recording.chunk_by(|a, b| a == b) {
        folds.extend((0..chunk.len()).map(|row| (row * FOLDS / chunk.len()) as u8));
    }
    folds
}

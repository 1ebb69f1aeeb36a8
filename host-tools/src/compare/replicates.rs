//! Scatter between visits of the same condition: what no model of these columns can explain.

use std::collections::HashMap;

use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::covariate::{COVARIATES, Kind};
use super::rows::SensorColumns;

/// Two rows are at the same condition where every covariate agrees to this share of its standard
/// deviation.
const CELL: f64 = 0.1;
/// Visits of one condition are apart by at least this many seconds.
const APART_S: f64 = 1.0;
/// Fewer degrees of freedom tell no scatter.
const FEWEST: usize = 30;
/// Probability below which scatter alone does not explain the residual.
const LEVEL: f64 = 0.05;

/// Residuals in groups that share a condition, taken apart into scatter within the groups (pure error)
/// and what is left of their means (lack of fit).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LackOfFit {
    /// Mean square within groups.
    pub pure: f64,
    /// Degrees of freedom within groups.
    pub pure_freedom: usize,
    /// Mean square of the groups' means, as lack of fit.
    pub lack: f64,
    /// Its degrees of freedom.
    pub lack_freedom: usize,
}

impl LackOfFit {
    /// Of residuals by group, left by a model of `parameters` coefficients that was fitted to them.
    /// `None` where no group has two, or the groups are not more than the parameters.
    pub fn of(groups: &[Vec<f64>], parameters: usize) -> Option<Self> {
        let (mut within, mut between) = (0.0, 0.0);
        let mut pure_freedom = 0;
        let filled = groups.iter().filter(|group| !group.is_empty());
        let count = filled.clone().count();
        for group in filled {
            let mean = group.iter().sum::<f64>() / group.len() as f64;
            within += group
                .iter()
                .map(|value| (value - mean).powi(2))
                .sum::<f64>();
            between += group.len() as f64 * mean * mean;
            pure_freedom += group.len() - 1;
        }
        let lack_freedom = count
            .checked_sub(parameters)
            .filter(|freedom| *freedom > 0)?;
        (pure_freedom > 0).then(|| Self {
            pure: within / pure_freedom as f64,
            pure_freedom,
            lack: between / lack_freedom as f64,
            lack_freedom,
        })
    }

    /// How many times the lack of fit exceeds the pure error.
    pub fn f(&self) -> f64 {
        self.lack / self.pure
    }

    /// Probability of such an excess by scatter alone.
    pub fn probability(&self) -> f64 {
        let (lack, pure) = (self.lack_freedom as f64, self.pure_freedom as f64);
        FisherSnedecor::new(lack, pure).map_or(f64::NAN, |f| f.sf(self.f()))
    }

    /// In words.
    pub fn verdict(&self) -> &'static str {
        match self.probability() < LEVEL {
            true => "structure remains",
            false => "at the replicate floor",
        }
    }
}

/// Standard deviation between visits of the same condition on each axis of one sensor, in gauss;
/// `None` where too few conditions were met twice.
pub fn scatter(sensor: &SensorColumns) -> Option<[f64; 3]> {
    let widths: Vec<(usize, f64)> = COVARIATES
        .iter()
        .enumerate()
        .filter(|(_, covariate)| covariate.kind == Kind::Quantity)
        .filter_map(|(i, _)| Some((i, CELL * deviation(&sensor.covariates[i])?)))
        .collect();
    let mut cells: HashMap<Vec<i32>, Vec<usize>> = HashMap::new();
    for row in 0..sensor.len() {
        let place = |(i, width): &(usize, f64)| {
            (f64::from(sensor.covariates[*i][row]) / width).floor() as i32
        };
        let visits = cells.entry(widths.iter().map(place).collect()).or_default();
        let again = visits.last().is_none_or(|&last| {
            sensor.recording[last] != sensor.recording[row]
                || sensor.time_s[row] - sensor.time_s[last] > APART_S
        });
        if again {
            visits.push(row);
        }
    }
    let found = [0, 1, 2].map(|axis| {
        let residual = |row: &usize| sensor.residual_g[*row][axis];
        let groups: Vec<Vec<f64>> = cells
            .values()
            .map(|visits| visits.iter().map(residual).collect())
            .collect();
        let split = LackOfFit::of(&groups, 0)?;
        (split.pure_freedom >= FEWEST).then(|| split.pure.sqrt())
    });
    Some([found[0]?, found[1]?, found[2]?])
}

/// Standard deviation of a column; `None` where it was not recorded or never moves.
fn deviation(values: &[f32]) -> Option<f64> {
    let finite = || {
        values
            .iter()
            .map(|value| f64::from(*value))
            .filter(|v| v.is_finite())
    };
    let count = finite().count();
    let mean = finite().sum::<f64>() / count.max(1) as f64;
    let variance = finite().map(|value| (value - mean).powi(2)).sum::<f64>() / count.max(1) as f64;
    (count == values.len() && variance > 0.0).then(|| variance.sqrt())
}

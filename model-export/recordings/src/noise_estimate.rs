//! Noise of a recording as its estimators give it.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::columns::{Axis, SignalUnit};

/// Estimator of the noise of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseEstimator {
    /// Scatter of rows with equal forces and covariates (pure error).
    Repeats,
    /// Differences of the residual of a smooth in forces and covariates.
    ResidualDifferences,
    /// Differences of successive rows.
    #[default]
    Differences,
    /// Scatter about a smooth in forces and covariates: an upper limit, where the order of rows carries no time.
    Smooth,
}

impl NoiseEstimator {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Repeats => "the scatter of repeated settings (pure error)",
            Self::ResidualDifferences => {
                "differences of what a smooth in forces and covariates leaves of successive rows"
            }
            Self::Differences => "differences of successive rows",
            Self::Smooth => "the scatter about a smooth in forces and covariates (an upper limit)",
        }
    }
}

/// What the order of the rows of a recording carries.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RowOrder {
    /// Time: successive rows are close to each other in forces, covariates or residual.
    #[default]
    Time,
    /// Nothing: successive rows are as far from each other as any two, in forces, covariates and residual.
    Shuffled,
}

/// Result of the estimators over a recording.
#[derive(Clone, Debug, Default)]
pub struct NoiseEstimate {
    /// Unit of the floors: that of the first sensor's signal.
    pub unit: SignalUnit,
    /// Estimator of the noise of `Recording::sensors` and `Recording::forces`.
    pub estimator: NoiseEstimator,
    /// Noise floor by each estimator that applies: root mean square over rows, axes and sensors in gauss.
    pub floors_g: Vec<(NoiseEstimator, f64)>,
    /// What the smooths leave of the field: root mean square over rows, axes and sensors in gauss; zero without one. Unlike the floors, it
    /// holds what is as slow as the load.
    pub smooth_g: f64,
    /// Floor in the rows in which the load moves least, by their raw differences and by the estimator that is used, in gauss.
    pub quiet_g: Option<[f64; 2]>,
    /// Whether the raw differences hold the motion of the load: they are then no estimate of the noise.
    pub differences_hold_motion: bool,
    /// Jitter of the reference's clock in seconds, one standard deviation, with its standard error; zero where it is not significant.
    pub jitter_s: (f64, f64),
    /// Covariates on which the field depends, by column name; `temp_c` for a temperature.
    pub covariates: Vec<String>,
    /// Variance of the noise without the jitter relative to all of it, by sensor and row of the recording; empty without jitter.
    pub precision: BTreeMap<u32, Vec<f64>>,
    /// What the order of the rows carries.
    pub order: RowOrder,
    /// Correlation time of what the smooth leaves of the field, in seconds: the longest of all axes.
    pub correlation_s: f64,
    /// Rows between independent samples of the slower table: more than one where it was held or interpolated.
    pub sample_rows: usize,
    /// Noise that it replaced: that of the raw differences.
    pub(super) raw: Option<RawNoise>,
}

/// Noise by raw differences.
#[derive(Clone, Debug, Default)]
pub(super) struct RawNoise {
    /// Of one board row in gauss, by sensor.
    pub(super) field_g: BTreeMap<u32, [f64; 3]>,
    /// Of one row in newtons.
    pub(super) forces_n: BTreeMap<(u32, Axis), f64>,
}

impl NoiseEstimate {
    /// Whether the field depends on this covariate: a column that was set anew for each row varies like noise.
    pub fn follows(&self, covariate: &str) -> bool {
        self.covariates.iter().any(|own| own == covariate)
    }

    /// Floor by the estimator that is used, in gauss.
    pub fn floor_g(&self) -> Option<f64> {
        self.floors_g.iter().find(|(of, _)| *of == self.estimator).map(|(_, floor_g)| *floor_g)
    }
}

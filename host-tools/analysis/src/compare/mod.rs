//! Comparison of a model with a campaign: its error relative to the noise floor, and what the error depends on.
//!
//! [`Comparison`] holds all results; terminal, report and `--json` format them.
//!
//! - [`pipeline`]: from model and campaign to a [`Comparison`].
//! - [`campaign_reader`]: recordings, cached or streamed. [`checked_campaign`]: with their setup errors.
//! - `campaign_excitation`: excitation of the sensors, by which recordings are corrected for the effects of a model.
//! - `cv_plan`: cross-validation, so that no row is predicted by a model fitted to it.
//! - `field_errors`, `force_errors`: errors of the field, and of the forces through the device's code.
//! - [`covariates`], `residual_table`: residuals with everything they may depend on.
//! - [`attribution`], `bootstrap_bands`: which covariates explain the residual.
//! - `pure_error`: scatter between repeated conditions, and drift at rest.

use std::borrow::Cow;

use crate::data_quality::finding::Finding;
use crate::noise_floor::NoiseSummary;
use crate::notes::{MissingForces, Note};
use crate::parameters::ParameterTable;
use crate::statistics::{ErrorStatistics, pooled_rms};
use model_export::effects::ErrorOrigin;
use model_export::fit::cross_validation::CvSplit;
use model_export::model_file::{EffectModel, SensorScale};
use model_export::recordings::columns::{Axis, SignalUnit};
use serde::Serialize;
use serde::ser::{SerializeStruct, Serializer};

pub mod attribution;
pub(crate) mod bootstrap_bands;
pub(crate) mod campaign_excitation;
pub mod campaign_reader;
pub mod checked_campaign;
pub mod covariates;
mod cv_plan;
mod field_errors;
pub(crate) mod force_errors;
pub mod pipeline;
mod pure_error;
pub(crate) mod residual_table;

/// Residuals up to this factor times the floor are indistinguishable from noise.
pub const AT_FLOOR: f64 = 1.15;

/// The same for the residual of one axis, of which a recording has many.
const AXIS_AT_FLOOR: f64 = AT_FLOOR * AT_FLOOR;

/// Whether a residual is that of noise, in noise floors: over all axes and on the `worst` one. The noise of the reference may hide
/// on some axes what another one shows.
pub fn is_at_floor(floors: f64, worst: Option<f64>) -> bool {
    floors <= AT_FLOOR && worst.is_none_or(|worst| worst <= AXIS_AT_FLOOR)
}

/// Residuals below this factor times the floor show that the floor is too high: no model is better than the noise.
pub const BELOW_FLOOR: f64 = 0.9;

/// Cross-validated error over all channels, in gauss.
pub fn rms_g(axes: &[FieldAxisErrors]) -> f64 {
    pooled_rms(axes.iter().map(|axis| axis.error.rms))
}

/// Noise floor over all channels, in gauss.
pub fn floor_g(axes: &[FieldAxisErrors]) -> f64 {
    pooled_rms(axes.iter().map(|axis| axis.floor.total))
}

/// Rows in which the device detects an event of the model; they are not in the errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FlaggedRows {
    /// Fraction of all rows.
    pub share: f64,
    /// Error of these rows, root mean square in newtons.
    pub rms_n: f64,
}

/// Error over all forces through the device's own code, with the noise next to it: the figure that every command states first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForceError {
    /// Root mean square over all forces in newtons, against the reference corrected for its own errors in the model.
    pub rms_n: f64,
    /// The same from the white noise of sensors and reference alone.
    pub noise_n: f64,
    /// The same against the reference as recorded.
    pub recorded_rms_n: f64,
    /// The same without what no model of the device could remove.
    pub reducible_rms_n: f64,
    /// Rows in which the device detects an event of the model.
    pub flagged: Option<FlaggedRows>,
    /// How the rows are separated from the fit.
    pub rows: ErrorRows,
}

/// How the rows of an error are separated from the fit: errors of one model on one campaign are the same number only for the same
/// rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ErrorRows {
    /// Recordings that the model was not fitted to.
    Unseen,
    /// Each recording (of more than ten, each tenth of them) is predicted by a fit to the others.
    LeaveRecordingOut,
    /// Each sixth of the recordings is predicted by a fit to the rest.
    LeaveSixthOut,
    /// Every sixth block of this many milliseconds is predicted by a fit to the rest.
    LeaveBlocksOut {
        /// Length of a block.
        block_ms: u32,
    },
    /// Not held out: the model was fitted to them.
    Fitted,
    /// The model was fitted to some of them.
    PartlyFitted,
}

impl ErrorRows {
    /// Rows of a validation.
    pub fn of(validation: &Validation) -> Self {
        match validation {
            Validation::UnseenRecordings => Self::Unseen,
            Validation::NotHeldOut(_) | Validation::Edited(_) => Self::Fitted,
            Validation::CrossValidated { split, .. } => match *split {
                CvSplit::Recordings(_) => Self::LeaveRecordingOut,
                CvSplit::KFold => Self::LeaveSixthOut,
                CvSplit::Interleaved { block_ms } | CvSplit::Blocks { block_ms, .. } => {
                    Self::LeaveBlocksOut { block_ms }
                }
            },
        }
    }

    /// True where the model was fitted to recordings of the same campaign.
    pub fn is_of_campaign(self) -> bool {
        self != Self::Unseen
    }
}

/// An effect of a model whose error is not one of the device's model, with its magnitude over all sensors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EffectOrigin {
    pub effect: String,
    #[serde(skip)]
    pub origin: ErrorOrigin,
    /// Magnitude.
    pub value: f64,
    /// Unit of the magnitude.
    pub unit: String,
}

impl EffectOrigin {
    /// Those of the effects of a model.
    pub fn of(effects: &[EffectModel]) -> Vec<Self> {
        let origin = |effect: &EffectModel| {
            let origin = effect.term().ok()?.error_origin();
            (origin != ErrorOrigin::Compensated).then(|| Self {
                effect: effect.name.clone(),
                origin,
                value: effect.value,
                unit: effect.unit.clone(),
            })
        };
        effects.iter().filter_map(origin).collect()
    }
}

impl Serialize for ForceError {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut object = serializer.serialize_struct("ForceError", 7)?;
        object.serialize_field("rms_n", &self.rms_n)?;
        object.serialize_field("noise_n", &self.noise_n)?;
        object.serialize_field("excess_n", &self.excess_n())?;
        object.serialize_field("recorded_rms_n", &self.recorded_rms_n)?;
        object.serialize_field("irreducible_n", &self.irreducible_n())?;
        object.serialize_field("flagged", &self.flagged)?;
        object.serialize_field("rows", &self.rows)?;
        object.end()
    }
}

impl ForceError {
    /// Pools the forces over these rows; `None` without any.
    pub fn of(forces: &[ForceAxisErrors], rows: ErrorRows) -> Option<Self> {
        let pooled = |of: fn(&ForceAxisErrors) -> f64| pooled_rms(forces.iter().map(of));
        let flagged = || forces.iter().filter_map(|force| force.flagged);
        let share = flagged().map(|rows| rows.share).sum::<f64>() / forces.len() as f64;
        (!forces.is_empty()).then(|| Self {
            rms_n: pooled(|force| force.error.rms),
            noise_n: pooled(|force| force.floor),
            recorded_rms_n: pooled(|force| force.recorded_rms),
            reducible_rms_n: pooled(|force| force.reducible_rms),
            flagged: (share > 0.0).then(|| FlaggedRows {
                share,
                rms_n: pooled_rms(flagged().map(|rows| rows.rms_n)),
            }),
            rows,
        })
    }

    /// An error of the device alone, against a reference without errors of its own.
    pub fn of_device(rms_n: f64, noise_n: f64, rows: ErrorRows) -> Self {
        let (recorded_rms_n, reducible_rms_n) = (rms_n, rms_n);
        Self { rms_n, noise_n, recorded_rms_n, reducible_rms_n, flagged: None, rows }
    }

    /// Error that a better model of the device could remove, in newtons: root of the difference of squares.
    pub fn excess_n(&self) -> f64 {
        (self.reducible_rms_n.powi(2) - self.noise_n.powi(2)).max(0.0).sqrt()
    }

    /// The excess in newtons where the mean square of the error falls by this much, in N^2.
    pub fn excess_less(&self, reduction_n2: f64) -> f64 {
        (self.reducible_rms_n.powi(2) - reduction_n2 - self.noise_n.powi(2)).max(0.0).sqrt()
    }

    /// Error of the device that none of its models could remove, in newtons: root of the difference of squares.
    pub fn irreducible_n(&self) -> f64 {
        (self.rms_n.powi(2) - self.reducible_rms_n.powi(2)).max(0.0).sqrt()
    }
}

/// How the errors of a model are separated from its fit.
#[derive(Clone, Debug, PartialEq)]
pub enum Validation {
    /// The model was not fitted to any of the recordings.
    UnseenRecordings,
    /// Not held out: the model was fitted to the recordings and a new fit fails, for this reason.
    NotHeldOut(String),
    /// The parameters have this multiple of the error of a new fit, so they were edited; they are used unchanged.
    Edited(f64),
    /// Every row is predicted by a fit without it.
    CrossValidated {
        /// The folds.
        split: CvSplit,
        /// Number of recordings to which the model was fitted.
        seen: usize,
        /// How many of them were fitted again.
        refitted: usize,
        /// Number of all recordings.
        all: usize,
    },
}

/// Results of a model on a campaign.
#[derive(Clone, Debug, Default)]
pub struct Comparison {
    /// The model's file.
    pub model: String,
    /// The campaign's folder.
    pub campaign: String,
    /// Setup errors in the recordings, most severe first.
    pub findings: Vec<Finding>,
    /// How the errors were cross-validated; `None` if a setup error stops the comparison.
    pub validation: Option<Validation>,
    /// Errors of the field by sensor and axis. Empty if a setup error stops the comparison.
    pub axes: Vec<FieldAxisErrors>,
    /// Errors of the forces through the device's code by sensor, lateral then longitudinal. Empty if the
    /// model has no inverse; `no_forces` then has the reason.
    pub forces: Vec<ForceAxisErrors>,
    /// Effects of the model whose error is not one of the device's model.
    pub origins: Vec<EffectOrigin>,
    /// Reason for missing forces.
    pub no_forces: Option<MissingForces>,
    /// Covariates that explain the residual: first the selected ones in order of selection, then the others
    /// by their share of the remaining residual.
    pub located: Vec<Attribution>,
    /// Standard covariates that no recording has: whether the residual depends on them is unknown.
    pub not_recorded: Vec<Cow<'static, str>>,
    /// RMS residual over the two leading covariates.
    pub map: Option<ResidualMap>,
    /// Intervals with the largest error, largest first.
    pub worst: Vec<WorstInterval>,
    /// Integrated autocorrelation time of the residual in seconds, maximum over all channels.
    pub correlation_s: f64,
    /// Measurement and model over time.
    pub traces: Vec<Trace>,
    /// Errors of lateral and longitudinal force over all sensors, as in the paper's Fig. 8.
    pub histograms: Vec<Histogram>,
    /// Noise of the recordings, and how it was estimated.
    pub noise: NoiseSummary,
    /// Parameters of the model, as they were fitted to the recordings of its provenance.
    pub parameters: ParameterTable,
    /// Provenance of the results; `None` if a setup error stops the comparison.
    pub provenance: Option<ComparisonProvenance>,
    /// Notes on the recordings and on the models, including the baseline model.
    pub notes: Vec<Note>,
    /// The baseline model of `--baseline` on the same rows.
    pub other: Option<Box<Comparison>>,
}

/// What the results of a comparison were computed from.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ComparisonProvenance {
    /// Campaign that the model was fitted to.
    pub fitted_campaign: String,
    pub fitted_recordings: usize,
    /// Number of its aligned rows.
    pub fitted_rows: usize,
    /// Name and version of the tool that fitted the model.
    pub fitted_by: String,
    /// Names of the model's effects.
    pub effects: Vec<String>,
    /// Block length of the bootstrap in seconds.
    pub block_s: f64,
    /// Seed of the bootstrap.
    pub seed: u64,
    pub sensor_scale: SensorScale,
    /// Names of the compared recordings, each with the SHA-256 over its files.
    pub recordings: Vec<(String, String)>,
}

impl Comparison {
    /// Error over all forces; `None` without forces.
    pub fn force(&self) -> Option<ForceError> {
        ForceError::of(&self.forces, ErrorRows::of(self.validation.as_ref()?))
    }
}

/// Error of a perfect model in gauss, and its components.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NoiseFloor {
    /// White noise of the sensor after averaging.
    pub white: f64,
    /// Quantisation after averaging; part of the white noise where that is larger.
    pub quantisation: f64,
    /// Noise of the reference force times dB/dF.
    pub reference: f64,
    /// Drift over 10 s and more at rest; `None` without such an interval.
    pub slow: Option<f64>,
    /// Scatter between visits of the same condition; `None` without repeated conditions.
    pub replicates: Option<f64>,
    /// White noise and reference noise combined: the floor that errors are compared with.
    pub total: f64,
}

/// Error of the field on one axis of one sensor, in gauss.
#[derive(Clone, Copy, Debug)]
pub struct FieldAxisErrors {
    pub sensor: u32,
    pub axis: Axis,
    /// Measured minus modelled, cross-validated.
    pub error: ErrorStatistics,
    /// Noise floor of this axis.
    pub floor: NoiseFloor,
    /// Reducible error: sqrt(rms^2 - floor^2).
    pub explainable: f64,
}

/// Error of one force of one sensor in newtons: device minus reference.
#[derive(Clone, Copy, Debug)]
pub struct ForceAxisErrors {
    pub sensor: u32,
    /// X lateral, Z longitudinal.
    pub axis: Axis,
    /// Error of the device's fixed-point code at the board's rate, against the corrected reference.
    pub error: ErrorStatistics,
    /// RMS error against the reference as recorded.
    pub recorded_rms: f64,
    /// RMS error without what no model of the device could remove.
    pub reducible_rms: f64,
    /// Rows in which the device detects an event of the model.
    pub flagged: Option<FlaggedRows>,
    /// RMS after a tare; `None` without an unloaded interval.
    pub tared_rms: Option<f64>,
    /// RMS error from white noise alone.
    pub floor: f64,
    /// Reducible error.
    pub explainable: f64,
}

/// Unit of a residual: of the forces through the device's inverse, or of the signal where the forces are not determined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorUnit {
    Newton,
    /// That of the sensors' signals.
    Signal(SignalUnit),
}

impl Default for ErrorUnit {
    fn default() -> Self {
        Self::Signal(SignalUnit::default())
    }
}

impl Serialize for ErrorUnit {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.symbol())
    }
}

impl ErrorUnit {
    /// Symbol of the unit.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Newton => "N",
            Self::Signal(unit) => unit.symbol(),
        }
    }

    /// Number of components of a residual.
    pub fn axes(self) -> usize {
        match self {
            Self::Newton => 2,
            Self::Signal(_) => 3,
        }
    }

    /// Name of each component, by axis.
    pub fn axis_names(self) -> [&'static str; 3] {
        match self {
            Self::Newton => ["Fx", "", "Fz"],
            Self::Signal(_) => ["x", "y", "z"],
        }
    }
}

/// Dependence of the residual on one covariate.
#[derive(Clone, Debug, Serialize)]
pub struct Attribution {
    /// Name of a recorded column, or of a derived one (`fx_rate_n_per_s`, `loading_x`).
    pub covariate: Cow<'static, str>,
    /// Label in text: `opening`.
    #[serde(skip)]
    pub words: Cow<'static, str>,
    /// Unit, empty for a dimensionless number.
    pub unit: &'static str,
    /// Cross-validated fraction of the squared residual above the floor that it explains in addition to the
    /// covariates before it. The fractions of the selected covariates are additive.
    pub share: f64,
    /// The same fraction for this covariate alone.
    pub alone: f64,
    /// True if it was selected, false if its share is below the threshold.
    pub chosen: bool,
    /// Unit of the residual in the bins.
    pub error_unit: ErrorUnit,
    /// Sensor numbers, in the order of each bin's means.
    pub sensors: Vec<u32>,
    /// Quantile bins, or one per value where there are few, over the original residual.
    pub bins: Vec<Bin>,
}

/// Rows with a covariate between two values.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Bin {
    /// Minimum of the covariate.
    pub from: f64,
    /// Maximum of the covariate.
    pub to: f64,
    /// Mean of the covariate.
    pub centre: f64,
    /// Number of rows over all sensors.
    pub rows: usize,
    /// Root mean square of the residual over all sensors and axes.
    pub rms: f64,
    /// Fraction of the squared residual above the floor in these rows.
    pub share: f64,
    /// Mean residual by sensor and axis; NaN without rows. Of forces, y is zero.
    pub mean: Vec<[f64; 3]>,
    /// 95 % confidence interval of that mean by block bootstrap.
    pub band: Vec<[(f64, f64); 3]>,
}

/// RMS residual over two covariates.
#[derive(Clone, Debug)]
pub struct ResidualMap {
    /// Labels of horizontal and vertical axis, with unit.
    pub axes: [String; 2],
    /// Column edges.
    pub across: Vec<f64>,
    /// Row edges.
    pub upwards: Vec<f64>,
    /// `rms[row][column]`; NaN without data.
    pub rms: Vec<Vec<f64>>,
    /// Noise floor, for the colour scale.
    pub floor: f64,
    /// Unit of both.
    pub error_unit: ErrorUnit,
}

/// An interval of time with a large error.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WorstInterval {
    pub recording: String,
    /// Start in seconds.
    pub from_s: f64,
    /// End in seconds.
    pub to_s: f64,
    /// Sensor with the largest error.
    pub sensor: u32,
    /// RMS residual over all sensors and axes.
    pub rms: f64,
    pub error_unit: ErrorUnit,
    /// Means of the main covariates.
    #[serde(skip)]
    pub conditions: Vec<MeanCondition>,
}

/// Mean of a covariate over an interval.
#[derive(Clone, Debug, PartialEq)]
pub struct MeanCondition {
    /// Short label; empty where the unit says it.
    pub label: &'static str,
    pub mean: f64,
    pub unit: &'static str,
}

/// One sensor over one recording.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    pub recording: String,
    pub sensor: u32,
    /// Unit of the field.
    pub unit: SignalUnit,
    /// Field by axis: measured, modelled.
    pub field: Vec<[Envelope; 2]>,
    /// Lateral and longitudinal force in newtons: reference, device. Empty without an inverse.
    pub force: Vec<[Envelope; 2]>,
}

/// Histogram of an error.
#[derive(Clone, Debug)]
pub struct Histogram {
    /// The force: X lateral, Z longitudinal.
    pub axis: Axis,
    /// Bin edges in newtons; the first and last bin include errors beyond them.
    pub edges: Vec<f64>,
    /// Rows per bin.
    pub counts: Vec<u64>,
}

/// A decimated trace that preserves its extremes: minimum and maximum of each interval.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Envelope {
    /// Centre of each interval in seconds.
    pub time_s: Vec<f64>,
    /// Minimum of each interval.
    pub low: Vec<f64>,
    /// Maximum of each interval.
    pub high: Vec<f64>,
}

impl Envelope {
    /// Decimates to at most `points` intervals of equally many rows. NaN is ignored unless an interval has no
    /// other value.
    pub fn of(time_s: &[f64], values: &[f64], points: usize) -> Self {
        let rows = time_s.len().min(values.len());
        let each = rows.div_ceil(points.max(1)).max(1);
        let mut curve = Self::default();
        for (time, values) in time_s[..rows].chunks(each).zip(values[..rows].chunks(each)) {
            curve.time_s.push(time.iter().sum::<f64>() / time.len() as f64);
            curve.low.push(values.iter().copied().fold(f64::NAN, f64::min));
            curve.high.push(values.iter().copied().fold(f64::NAN, f64::max));
        }
        curve
    }

    /// Number of intervals.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True without intervals.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// The same in fewer intervals.
    pub fn coarser(&self, points: usize) -> Self {
        Self {
            low: Self::of(&self.time_s, &self.low, points).low,
            high: Self::of(&self.time_s, &self.high, points).high,
            time_s: Self::of(&self.time_s, &self.low, points).time_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn envelope_preserves_the_extremes() {
        let time_s: Vec<f64> = (0..1000).map(f64::from).collect();
        let mut values = vec![0.0; 1000];
        values[313] = 7.0;
        values[314] = -9.0;
        for points in [1, 3, 10, 999] {
            let curve = Envelope::of(&time_s, &values, points);
            assert!(curve.len() <= points);
            for curve in [curve.coarser(2), curve] {
                assert_eq!(curve.high.iter().copied().fold(0.0, f64::max), 7.0);
                assert_eq!(curve.low.iter().copied().fold(0.0, f64::min), -9.0);
            }
        }
    }

    #[test]
    fn envelope_of_a_short_trace_is_exact() {
        let curve = Envelope::of(&[0.0, 1.0, 2.0], &[5.0, f64::NAN, 4.0], 10);
        assert_eq!(curve.time_s, [0.0, 1.0, 2.0]);
        assert_eq!(curve.low[0], curve.high[0]);
        assert!(curve.low[1].is_nan());
    }
}

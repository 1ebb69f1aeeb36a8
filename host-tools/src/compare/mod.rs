//! A model beside a measurement: how good it is on a scale that means something, and where it fails.
//!
//! - [`finding`]: what is wrong with the recordings themselves.
//! - [`curve`]: long traces, decimated without hiding their peaks.
//!
//! [`Comparison`] is everything that is known; the terminal, the report and `--json` only show it.

pub mod bands;
pub mod binning;
pub mod collect;
pub mod compute;
pub mod covariate;
pub mod curve;
pub mod device;
pub mod errors;
pub mod finding;
pub mod locate;
pub mod map;
pub mod plan;
pub mod replicates;
pub mod rest;
pub mod rows;
pub mod source;
pub mod words;
pub mod worst;

use std::borrow::Cow;

use model_export::recordings::columns::Axis;

pub use curve::Curve;
pub use finding::Finding;

/// A model beside a campaign.
#[derive(Clone, Debug, Default)]
pub struct Comparison {
    /// The model's file.
    pub model: String,
    /// The campaign's folder.
    pub campaign: String,
    /// What is wrong with the recordings, the gravest first.
    pub findings: Vec<Finding>,
    /// How what follows was kept out of the fit, in one sentence.
    pub judged: String,
    /// The field's errors: every sensor, axis by axis. Empty where a finding stops the comparison.
    pub axes: Vec<AxisFigures>,
    /// The forces' errors through the device's code: every sensor, lateral then longitudinal. Empty
    /// where the model has no inverse; `no_forces` then says why.
    pub forces: Vec<ForceFigures>,
    /// Why there are no forces.
    pub no_forces: Option<String>,
    /// Covariates in the order in which they locate what is left: first those that were chosen, one
    /// after the other, then the rest by their share of what the chosen ones leave.
    pub located: Vec<Located>,
    /// Root mean square over the leading pair of covariates.
    pub map: Option<Map>,
    /// The worst stretches, the worst first.
    pub worst: Vec<Worst>,
    /// Integrated autocorrelation time of the residual in seconds, the longest of all channels.
    pub correlation_s: f64,
    /// Measured and modelled over time.
    pub traces: Vec<Trace>,
    /// Errors of the forces: the paper's Fig. 8; lateral and longitudinal, all sensors together.
    pub histograms: Vec<Histogram>,
    /// One line in words.
    pub verdict: String,
    /// Where all this comes from, name by name: version, files with their hashes, seeds, assumptions.
    pub provenance: Vec<(String, String)>,
    /// The other model of `--with`, judged on the same rows.
    pub other: Option<Box<Comparison>>,
}

/// What is said of an error, in the unit of the error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Root mean square.
    pub rms: f64,
    /// Mean: what a tare or an offset would remove.
    pub mean: f64,
    /// Standard deviation.
    pub std: f64,
    /// 95 % of the rows err less, in size.
    pub p95: f64,
    /// Greatest, in size.
    pub greatest: f64,
    /// Peak-to-peak of what was measured: what an error is a share of.
    pub span: f64,
}

/// What a perfect model would leave, in gauss, and of what it consists.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Floor {
    /// The sensor's white noise after averaging.
    pub white: f64,
    /// Steps of the sensor's word after averaging (part of the white noise where that is larger).
    pub quantisation: f64,
    /// The reference's noise through dB/dF.
    pub reference: f64,
    /// What wanders over 10 s and more while nothing changes; `None` where the recordings never rest.
    pub slow: Option<f64>,
    /// Scatter between visits of the same condition; `None` where no condition was met twice.
    pub replicates: Option<f64>,
    /// White noise and the reference's together: the floor that errors are held against.
    pub total: f64,
}

/// The field's error on one axis of one sensor, in gauss.
#[derive(Clone, Copy, Debug)]
pub struct AxisFigures {
    /// Number of the sensor.
    pub sensor: u32,
    /// Axis.
    pub axis: Axis,
    /// Measured minus modelled, on rows that the model has not seen.
    pub error: Figures,
    /// The floor beneath.
    pub floor: Floor,
    /// What a better model could remove: sqrt(rms^2 - floor^2).
    pub explainable: f64,
}

/// The force's error on one axis of one sensor, in newtons: device minus reference.
#[derive(Clone, Copy, Debug)]
pub struct ForceFigures {
    /// Number of the sensor.
    pub sensor: u32,
    /// X lateral, Z longitudinal.
    pub axis: Axis,
    /// Through the device's fixed-point code, at the board's rate.
    pub error: Figures,
    /// After a tare at rest, where the recordings rest.
    pub tared_rms: Option<f64>,
    /// What white noise alone would leave.
    pub floor: f64,
    /// What a better model could remove.
    pub explainable: f64,
}

/// How the residual depends on one covariate.
#[derive(Clone, Debug)]
pub struct Located {
    /// Name as in the recordings, or one of those made from them (`fx_rate_n_per_s`, `loading_x`).
    pub covariate: Cow<'static, str>,
    /// In words, for people: `opening`.
    pub words: Cow<'static, str>,
    /// Unit, empty for a number without one.
    pub unit: &'static str,
    /// Share of the squared residual above the floor that it locates beyond the ones before it,
    /// judged on what was held out. Shares of the chosen ones add up.
    pub share: f64,
    /// The same had nothing been located before.
    pub alone: f64,
    /// True for those that were chosen; a share below the threshold is not.
    pub chosen: bool,
    /// Numbers of the sensors, in the order of each bin's means.
    pub sensors: Vec<u32>,
    /// Quantile bins, or one for each value where there are few. Taken of the whole residual, before
    /// anything is located.
    pub bins: Vec<Bin>,
}

/// The rows in which a covariate lies between two values.
#[derive(Clone, Debug, Default)]
pub struct Bin {
    /// Least value.
    pub from: f64,
    /// Greatest value.
    pub to: f64,
    /// Mean value.
    pub centre: f64,
    /// Rows over all sensors.
    pub rows: usize,
    /// Root mean square of the residual over all sensors and axes, in gauss.
    pub rms_g: f64,
    /// Share of the squared residual above the floor that lies in these rows.
    pub share: f64,
    /// Mean residual of each sensor, each axis, in gauss; NaN without rows.
    pub mean_g: Vec<[f64; 3]>,
    /// 95 % band of that mean by block bootstrap: least and greatest.
    pub band_g: Vec<[(f64, f64); 3]>,
}

/// Root mean square of the residual over two covariates.
#[derive(Clone, Debug)]
pub struct Map {
    /// Covariates: across, upwards; each in words with its unit.
    pub axes: [String; 2],
    /// Edges of the columns.
    pub across: Vec<f64>,
    /// Edges of the rows.
    pub upwards: Vec<f64>,
    /// `rms_g[row][column]` in gauss; NaN where nothing was measured.
    pub rms_g: Vec<Vec<f64>>,
    /// The floor, for the scale.
    pub floor_g: f64,
}

/// A contiguous stretch in which the model fails.
#[derive(Clone, Debug, PartialEq)]
pub struct Worst {
    /// Name of the recording.
    pub recording: String,
    /// From this second of it.
    pub from_s: f64,
    /// To this.
    pub to_s: f64,
    /// The sensor that errs most.
    pub sensor: u32,
    /// Root mean square over all sensors and axes, in gauss.
    pub rms_g: f64,
    /// What was going on: covariates with their means, in words.
    pub doing: String,
}

/// One sensor over one recording.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// Name of the recording.
    pub recording: String,
    /// Number of the sensor.
    pub sensor: u32,
    /// Field in gauss: x, y, z; measured, modelled.
    pub field: Vec<[Curve; 2]>,
    /// Force in newtons: lateral, longitudinal; reference, device. Empty where there is no inverse.
    pub force: Vec<[Curve; 2]>,
}

/// How often errors of each size occur.
#[derive(Clone, Debug, Default)]
pub struct Histogram {
    /// Of what, in words with its unit.
    pub of: String,
    /// Edges of the bins; errors beyond them are in the first and last.
    pub edges: Vec<f64>,
    /// Rows in each bin.
    pub counts: Vec<u64>,
}

//! Evidence of the setup errors, as data.

use std::collections::BTreeSet;

use model_export::fit::recording_differences::DifferenceCause;
use model_export::recordings::dependence::DependenceKind;
use serde::Serialize;

use crate::noise_floor::Disagreement;

/// What a check found, with the figures that support it. Values are in the unit of their column unless stated.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Evidence {
    /// Recordings that are not independent.
    DependentRecordings {
        /// Why.
        kind: DependenceKind,
        recordings: RecordingSet,
        /// Least share of rows, time or variance that two of them have in common.
        share: f64,
    },
    /// Rows in an order without time.
    ShuffledRows { recordings: RecordingSet },
    /// Two estimates of the noise disagree.
    NoiseDisagreement(Disagreement),
    /// Timestamps decrease.
    ClockBackwards {
        /// Number of decreases.
        falls: u64,
        /// Time before the first decrease in microseconds.
        before_us: f64,
        /// Time after it in microseconds.
        after_us: f64,
        /// Rows earlier than a previous row.
        late: u64,
        rows: u64,
        /// Exact duplicates of a previous row.
        copies: u64,
        /// True where sorting nearby rows restores the order.
        sortable: bool,
    },
    /// Rows have the time of the previous row.
    DuplicateRows {
        /// Rows with identical cells.
        identical: u64,
        /// Rows with different cells.
        different: u64,
    },
    /// A sampling period that no logger has.
    ClockUnit {
        /// Recordings with such a period.
        recordings: RecordingSet,
        /// Sampling period in microseconds.
        period_us: f64,
        /// Duration of the first of these recordings in seconds.
        duration_s: f64,
    },
    /// Counts wrapped: the values are lower or higher by the range of an integer.
    Wrapped {
        columns: ColumnSet,
        /// Column with the most of these rows.
        worst: String,
        rows: u64,
        /// Its number of rows in all.
        of: u64,
        counts: f64,
        /// To be added, in the unit of the column.
        offset: f64,
    },
    /// Timestamp steps far above the sampling period.
    ClockGaps {
        gaps: u64,
        /// Recordings with gaps.
        recordings: RecordingSet,
        /// Length of all gaps, as a fraction of the duration of these recordings.
        lost: f64,
        /// Start of the longest gap in seconds.
        from_s: f64,
        /// Length of the longest gap in milliseconds.
        longest_ms: f64,
        /// Sampling period in milliseconds.
        period_ms: f64,
    },
    /// Sensors are read less often than rows are written.
    RepeatedSamples {
        /// Numbers of the sensors; `None` for all.
        sensors: Option<Vec<u32>>,
        /// Recordings with repeated samples.
        recordings: RecordingSet,
        /// Maximum fraction of rows that repeat the previous field.
        share: f64,
        /// Fraction expected from the noise.
        by_chance: f64,
        /// Rate of new samples in hertz.
        rate_hz: f64,
    },
    /// Magnitudes of a covariate are those of another unit.
    CovariateUnit {
        columns: ColumnSet,
        /// Detected unit.
        found: &'static str,
        /// Expected unit.
        expected: &'static str,
        /// True where the conversion is unambiguous.
        certain: bool,
        /// A column, as an example.
        example: String,
        magnitude: Magnitude,
    },
    /// Field channels differ from all others by one factor in noise and magnitude.
    ChannelUnit {
        columns: ColumnSet,
        /// Noise of the first column relative to the median of the other channels.
        noise_ratio: f64,
        /// The power of ten that it is; `None` if it is near none.
        factor: Option<f64>,
    },
    /// Columns have one value in every row.
    StuckThroughout {
        columns: ColumnSet,
        /// The value of all of them; `None` where each has its own.
        value: Option<f64>,
        /// True where all are at the end of the sensor's range.
        at_limit: bool,
        /// True where a column is stuck in every recording.
        in_every_recording: bool,
    },
    /// Columns are constant for a while.
    Frozen {
        columns: ColumnSet,
        /// Start in seconds.
        from_s: f64,
        /// End in seconds.
        to_s: f64,
        rows: u64,
        /// The value of all of them; `None` where each has its own.
        value: Option<f64>,
        /// White noise of the column.
        noise: f64,
    },
    /// Columns reach the end of the sensor's range.
    Saturated {
        columns: ColumnSet,
        /// Column with the most saturated rows.
        worst: String,
        /// Fraction of its rows.
        share: f64,
    },
    /// Columns are clipped within the sensor's range.
    Clipped {
        columns: ColumnSet,
        /// Column with the most clipped rows.
        worst: String,
        /// Fraction of its rows.
        share: f64,
        /// Its limit.
        value: f64,
        /// True for a force clipped at zero, which may be correct.
        at_rest: bool,
    },
    /// Sensors without a temperature, where others have one.
    MissingTemperature {
        sensors: Vec<u32>,
        /// Recordings without it.
        recordings: RecordingSet,
    },
    /// Covariates do not vary above their noise in the whole campaign.
    ConstantCovariates {
        /// Columns with their means; zero within the noise.
        columns: Vec<(String, f64)>,
        /// Effects of the catalogue that cannot be tested.
        effects: Vec<&'static str>,
    },
    /// Single values deviate from both neighbours.
    Outliers {
        columns: ColumnSet,
        values: u64,
        /// Threshold in standard deviations of the noise.
        threshold: f64,
        /// Column with the largest deviation.
        worst: String,
        deviation_g: f64,
        noise_g: f64,
    },
    /// Quantisation is too coarse for the noise.
    CoarseSteps {
        columns: ColumnSet,
        /// Column with the coarsest steps.
        worst: String,
        step: f64,
        in_counts: bool,
        /// Its span in steps.
        steps: f64,
    },
    /// Periodic disturbance.
    SpectralLine {
        columns: ColumnSet,
        /// Frequencies in hertz.
        lines_hz: Vec<f64>,
        /// Column with the largest amplitude.
        worst: String,
        /// Its amplitude, of a field in gauss.
        amplitude: f64,
        /// Unit of the amplitude.
        unit: &'static str,
        /// Source of the disturbance.
        source: LineSource,
    },
    /// Columns are exchanged, inverted or in another unit.
    ColumnErrors {
        columns: Vec<(String, ColumnError)>,
        /// Recordings with these errors.
        recordings: RecordingSet,
        /// RMS residual of the model as recorded, in gauss.
        before_g: f64,
        /// RMS residual of the model with the errors corrected, in gauss.
        after_g: f64,
        /// Errors that explain the residual equally well.
        alternatives: Vec<Vec<(String, ColumnError)>>,
        /// True for the unit, false for order or sign of the columns.
        is_unit: bool,
    },
    /// Clocks of the reference that differ from the board's.
    ClockOffsets {
        /// The recordings.
        offsets: Vec<ClockOffset>,
        /// Minimum fraction of the error above the noise that aligning them removes.
        share: f64,
        /// Delay of the reference, in milliseconds, that aligns all recordings; `None` where they differ.
        delay_ms: Option<f64>,
    },
    /// Recordings differ by a zero, a gain or a place that no covariate explains.
    RecordingDifference {
        /// What differs.
        cause: DifferenceCause,
        /// Name of the recording against which the others are compared.
        reference: String,
        /// Unit of the offsets.
        unit: &'static str,
        /// The differences.
        offsets: Vec<RecordingOffset>,
        /// Causes that explain as much.
        equivalent: Vec<DifferenceCause>,
        /// Effects that explain as much.
        effects: Vec<String>,
        /// Residual without and with it, in noise floors, on rows that the regression did not use.
        floors: [f64; 2],
    },
    /// Constant offset between the two clocks, as a model shows it.
    ClockLag {
        /// Delay of the field after the force in milliseconds.
        lag_ms: f64,
        /// Recordings with this offset.
        recordings: RecordingSet,
        sensors: usize,
        /// Fraction of the error above the noise that correcting the offset removes.
        share: f64,
        /// Delay of the reference, in milliseconds, that corrects the offset.
        delay_ms: f64,
    },
}

/// Offset and rate of the reference's clock in one recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockOffset {
    pub recording: String,
    /// To be added to the reference's time zero, in milliseconds.
    pub offset_ms: f64,
    /// Standard error of the offset.
    pub offset_error_ms: f64,
    /// To be added to the rate of the reference's clock, in parts per million; zero where it is not significant.
    pub rate_ppm: f64,
    /// Standard error of the rate; NaN where it was not estimated.
    pub rate_error_ppm: f64,
}

/// Difference of one recording from the first.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecordingOffset {
    pub recording: String,
    /// Column, or what differs.
    pub quantity: String,
    /// The difference.
    pub value: f64,
    /// Its standard error, by the scatter within the recordings.
    pub std_error: f64,
}

/// Some recordings of a campaign.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecordingSet {
    pub names: Vec<String>,
    /// True if these are all recordings of the campaign.
    pub is_all: bool,
}

impl RecordingSet {
    /// Of the places of some of these recordings.
    pub fn of<'a>(
        places: impl IntoIterator<Item = usize>,
        names: impl ExactSizeIterator<Item = &'a String>,
    ) -> Self {
        let places: BTreeSet<usize> = places.into_iter().collect();
        let is_all = places.len() == names.len();
        let named = names.enumerate().filter(|(place, _)| places.contains(place));
        Self { names: named.map(|(_, name)| name.clone()).collect(), is_all }
    }
}

/// Columns with the same finding: those of the same recordings together.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ColumnSet(pub Vec<(Vec<String>, RecordingSet)>);

impl ColumnSet {
    /// Whether it is one column.
    pub fn is_single(&self) -> bool {
        self.0.iter().map(|(names, _)| names.len()).sum::<usize>() == 1
    }
}

/// Magnitude of a column.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Magnitude {
    /// Maximum absolute value.
    Maximum(f64),
    Median(f64),
    /// Median length of the vector that the column is part of.
    VectorLength(f64),
}

/// Source of a periodic disturbance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum LineSource {
    /// Mains, with its frequency in hertz.
    Mains(f64),
    /// Rotor, with its speed in turns per second.
    Rotor(f64),
    /// Source unknown.
    Unknown,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum ColumnError {
    OtherSign,
    /// The values are in another column.
    RecordedAs {
        /// The other column.
        column: String,
        /// True if they have the other sign there.
        negated: bool,
    },
    FieldUnit(&'static str),
    /// A field is this multiple of the model's.
    FieldFactor {
        /// Recorded by modelled field.
        factor: f64,
        /// True for raw counts, whose scale is stated in the recording.
        in_counts: bool,
    },
    ForceUnit(&'static str),
    /// A force is this multiple of the one that the model needs.
    ForceFactor(f64),
}

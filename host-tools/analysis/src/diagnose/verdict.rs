//! The verdict on one effect: present, absent or open, and why.

use model_export::effects::{EffectTerm, find};
use serde::Serialize;

/// Kind of a verdict, in the order of display.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum VerdictKind {
    /// Present; no other effect explains the same.
    Found,
    /// It or one of its equivalents is present.
    Tied,
    /// It explains only what another effect explains better.
    Shadow,
    /// These recordings are not sufficient.
    Inconclusive,
    /// Absent up to an upper bound.
    Absent,
}

impl VerdictKind {
    /// Identifier in JSON.
    pub fn id(self) -> &'static str {
        match self {
            Self::Found => "found",
            Self::Tied => "tied",
            Self::Shadow => "shadow",
            Self::Inconclusive => "not_judgeable",
            Self::Absent => "absent",
        }
    }
}

/// The recording that shows an effect best; empty for a formula.
pub(super) fn record_of(effect: &EffectTerm) -> String {
    effect.effect().map_or("", |known| known.record).to_owned()
}

/// Reason of a verdict.
#[derive(Clone, Debug, PartialEq)]
pub enum Reason {
    /// It reduces the cross-validated error.
    ReducesError,
    /// Others explain the same on these recordings.
    Equivalent,
    /// The effects of this step, the accepted one first, explain more of the same.
    ExplainedBetter(Vec<String>),
    /// Other forms of an accepted effect explain nearly as much.
    FormOf(String),
    /// The residual drifts with time more freely than the effect can.
    DriftsWithTime,
    /// It fits part of a residual with another cause.
    OtherCause,
    /// It only fits with a magnitude that is implausible, negligible or not determined.
    Implausible,
    /// Significant by itself, but not in a full fit.
    Unconfirmed,
    /// Much more than noise is unexplained; the covariate that it follows most, if any.
    UnexplainedResidual(Option<Unexplained>),
    /// A typical magnitude hardly changes the field.
    HardlyChangesField,
    /// It is confounded with the model's parameters.
    Confounded,
    /// The residual of other causes masks a typical magnitude.
    Masked,
    /// 95 % upper bound as a multiple of the typical magnitude.
    BelowBound(f64),
    /// It acts on the magnet, which a polynomial does not model.
    NeedsGeometry,
    /// It depends on the present forces alone: a polynomial of them contains it.
    InPolynomial,
    /// It acts through a force, and none was recorded.
    NeedsForce,
    /// Its magnitude is a field, and the signal of the sensors is in this unit.
    NotAField(&'static str),
    /// A column was not recorded in these recordings; none listed: in no recording.
    NotRecorded(String, Vec<String>),
    /// It depends on times that are assumed.
    AssumedTimes(AssumedTimes),
    /// A column does not vary beyond its noise.
    DoesNotVary(String),
    /// The order of the rows carries no time.
    NoTimeOrder,
    /// The base model cannot be fitted, with the error.
    Unfitted(String),
}

impl Reason {
    /// What the recordings lack for a test, as a sentence; `None` for other reasons.
    pub fn missing_data(&self) -> Option<String> {
        Some(match self {
            Self::NotRecorded(column, recordings) => match recordings.as_slice() {
                [] => format!("{column} was not recorded"),
                [one] => format!("{column} was not recorded in recording {one}"),
                many => format!("{column} was not recorded in recordings {}", many.join(", ")),
            },
            Self::DoesNotVary(column) => format!("{column} does not vary"),
            Self::NotAField(unit) => format!("the signal is in {unit} and no magnetic field"),
            Self::AssumedTimes(AssumedTimes::Starts) => {
                "the times between the recordings are assumed (state start_s and start = \"stated\" in each recording.toml, or in the \
                 mapping starts_s = [...] or one_clock = true)"
                    .to_owned()
            }
            Self::AssumedTimes(AssumedTimes::Rows) => {
                "the times of the rows are assumed (import with a clock)".to_owned()
            }
            _ => return None,
        })
    }
}

/// Times that are not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AssumedTimes {
    /// Of the recordings' starts.
    Starts,
    Rows,
}

/// The verdict on one effect.
#[derive(Clone, Debug)]
pub struct Verdict {
    pub effect: String,
    pub kind: VerdictKind,
    /// True if much more than noise remains unexplained: names are then provisional, and other effects
    /// inconclusive.
    pub provisional: bool,
    /// Equivalent effects.
    pub tied_with: Vec<String>,
    /// Other effects, each with the share of its pattern on these recordings that this one reproduces, largest first.
    pub reproduces: Vec<(String, f64)>,
    /// Excess of the held-out force error over its noise with this effect, in newtons: of an accepted effect that of its step, of others
    /// as the linearised model predicts it next to the accepted ones. `None` where the force error was not computed, or the effect is
    /// equivalent to an accepted one.
    pub excess_n: Option<f64>,
    /// Reduction of the cross-validated squared error, as a fraction.
    pub gain: f64,
    /// p-value adjusted for all candidates; NaN if not tested.
    pub p_adjusted: f64,
    /// Share of the resamples of the blocks of time in which it reduces the held-out squared error of the linearised model; NaN
    /// if not tested.
    pub inclusion: f64,
    /// Magnitude in `unit`; NaN if not fitted.
    pub value: f64,
    /// Standard error of the magnitude.
    pub std_error: f64,
    /// Least and largest magnitude of a sensor, where that of all describes none of them.
    pub differs: Option<[f64; 2]>,
    /// Unit of the magnitude.
    pub unit: String,
    /// Typical magnitude in standard errors of these recordings.
    pub z_typical: f64,
    /// Plausible range of the magnitude, where the estimate is outside.
    pub implausible: Option<(f64, f64)>,
    pub reason: Reason,
    /// Recording that would decide; empty if none is needed.
    pub record: String,
}

impl Verdict {
    /// Of an effect, without estimates.
    pub fn new(effect: &str, kind: VerdictKind, reason: Reason) -> Self {
        Self {
            effect: effect.to_owned(),
            kind,
            provisional: false,
            tied_with: Vec::new(),
            reproduces: Vec::new(),
            excess_n: None,
            gain: 0.0,
            p_adjusted: f64::NAN,
            inclusion: f64::NAN,
            value: f64::NAN,
            std_error: f64::NAN,
            differs: None,
            unit: String::new(),
            z_typical: 0.0,
            implausible: None,
            reason,
            record: String::new(),
        }
    }

    /// Whether the effect is present, or equivalent to one that is.
    pub fn is_accepted(&self) -> bool {
        matches!(self.kind, VerdictKind::Found | VerdictKind::Tied)
    }

    /// Makes it equivalent to these causes.
    pub(super) fn tie(&mut self, causes: &[String]) {
        (self.kind, self.reason) = (VerdictKind::Tied, Reason::Equivalent);
        self.tied_with.extend(causes.iter().cloned());
        if self.record.is_empty() {
            self.record = find(&self.effect).map_or("", |effect| effect.record).to_owned();
        }
    }
}

/// Residual structure that depends on a covariate and that no effect explains.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unexplained {
    pub covariate: String,
    /// Label in text.
    #[serde(skip)]
    pub words: String,
    /// Fraction of the squared residual above the floor.
    pub share: f64,
}

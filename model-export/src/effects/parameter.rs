//! Parameters of an effect and the definition of its magnitude.

use std::borrow::Cow;

/// Role of a parameter.
#[derive(Clone, Debug, PartialEq)]
pub enum ParameterKind {
    /// Linear: the effect vanishes with all coefficients zero.
    Coefficient,
    /// Nonlinear: a time constant, a threshold, a distance. The fit starts from the best value of `grid`.
    Shape {
        /// Start values of the search.
        grid: Cow<'static, [f64]>,
    },
    /// Initial state of a memory in a recording, from -1 to 1; prior mean zero.
    InitialState,
    /// Instant of the campaign in seconds (recordings laid end to end), searched on the data and refined.
    Instant,
}

/// Parameter of an effect.
#[derive(Clone, Debug, PartialEq)]
pub struct EffectParameter {
    /// Name in files and reports.
    pub name: Cow<'static, str>,
    /// Unit.
    pub unit: Cow<'static, str>,
    /// Role.
    pub kind: ParameterKind,
    /// Typical detectable magnitude in `unit`; the prior of the fit allows about ten times this.
    pub typical: f64,
    /// True if all sensors of a gripper have the same value.
    pub shared: bool,
    /// True for a shape selected by cross-validation over recordings: within the fitted recordings, a time
    /// constant of their length is confounded with every unmodelled slow change.
    pub cross_validated: bool,
    /// True for a slider's reach in newtons: limited to a quarter of the range of the load, where the slider slips
    /// before the middle of the largest loop. One that does not adds less to the loop than its friction, and one
    /// that never slips is a spring: their friction is not measured.
    pub slips_in_range: bool,
    /// Limits of the value; beyond, the fit would be another effect.
    pub limits: Option<(f64, f64)>,
    /// Recordings to which a value applies.
    pub scope: ParameterScope,
    /// Index of the only recording whose field depends on it, if there is one.
    pub recording: Option<usize>,
}

/// Recordings to which a value of a parameter applies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterScope {
    /// One value for all recordings.
    Campaign,
    /// One value for each recording.
    EachRecording,
    /// One value for each recording except the first.
    EachLaterRecording,
}

impl EffectParameter {
    const fn new(
        name: &'static str,
        unit: &'static str,
        kind: ParameterKind,
        typical: f64,
    ) -> Self {
        Self {
            name: Cow::Borrowed(name),
            unit: Cow::Borrowed(unit),
            kind,
            typical,
            shared: false,
            cross_validated: false,
            slips_in_range: false,
            limits: None,
            scope: ParameterScope::Campaign,
            recording: None,
        }
    }

    /// A coefficient.
    pub const fn coefficient(name: &'static str, unit: &'static str, typical: f64) -> Self {
        Self::new(name, unit, ParameterKind::Coefficient, typical)
    }

    /// A shape with the start values of its search.
    pub const fn shape(name: &'static str, unit: &'static str, grid: &'static [f64]) -> Self {
        let grid = Cow::Borrowed(grid);
        Self::new(name, unit, ParameterKind::Shape { grid }, 0.0)
    }

    /// An event time.
    pub const fn instant(name: &'static str, unit: &'static str) -> Self {
        Self::new(name, unit, ParameterKind::Instant, 0.0)
    }

    /// Shared by all sensors.
    pub const fn shared(mut self) -> Self {
        self.shared = true;
        self
    }

    /// Limited to these values.
    pub const fn within(mut self, low: f64, high: f64) -> Self {
        self.limits = Some((low, high));
        self
    }

    /// Selected by cross-validation where there are several recordings.
    pub(crate) const fn cross_validated(mut self) -> Self {
        self.cross_validated = true;
        self
    }

    /// Limited to a quarter of the range of the load.
    pub(crate) const fn slips_in_range(mut self) -> Self {
        self.slips_in_range = true;
        self
    }

    /// The initial state of a memory in each recording; `typical` is its standard deviation.
    pub const fn initial_state(name: &'static str, unit: &'static str, typical: f64) -> Self {
        let mut parameter = Self::new(name, unit, ParameterKind::InitialState, typical);
        parameter.scope = ParameterScope::EachRecording;
        parameter.limits = Some((-1.0, 1.0));
        parameter
    }

    /// One value for each recording except the first.
    pub(crate) const fn each_later_recording(mut self) -> Self {
        self.scope = ParameterScope::EachLaterRecording;
        self
    }

    /// One copy for each value in a campaign of `recordings` recordings, numbered where there are several.
    pub(super) fn repeated(&self, recordings: usize) -> Vec<Self> {
        let first = match self.scope {
            ParameterScope::Campaign => return vec![self.clone()],
            ParameterScope::EachRecording => 1,
            ParameterScope::EachLaterRecording => 2,
        };
        let numbered = |n: usize| Self {
            name: Cow::Owned(format!("{}_{n}", self.name)),
            recording: (self.kind == ParameterKind::InitialState).then_some(n - 1),
            ..self.clone()
        };
        (first..=recordings).map(numbered).collect()
    }

    /// True for [`ParameterKind::Coefficient`].
    pub fn is_coefficient(&self) -> bool {
        self.kind == ParameterKind::Coefficient
    }
}

/// Reduction of several values to one magnitude.
#[derive(Clone, Copy, Debug)]
pub enum Aggregation {
    /// The largest significant coefficient.
    Largest,
    /// Euclidean norm of the coefficients, mean over the sensors.
    Norm,
    /// A function of all values, mean over the sensors.
    Mean(fn(&[f64]) -> f64),
    /// A function of all values, maximum over the sensors.
    Max(fn(&[f64]) -> f64),
}

/// Definition of the magnitude of an effect, as one number.
#[derive(Clone, Copy, Debug)]
pub struct MagnitudeSpec {
    /// Physical quantity, for reports.
    pub description: &'static str,
    /// Unit of the magnitude.
    pub unit: &'static str,
    /// Number of leading coefficients that enter; zero for all.
    pub first: usize,
    /// Reduction over the coefficients.
    pub aggregation: Aggregation,
    /// Factor applied after the reduction.
    pub factor: f64,
    /// Typical magnitude, with its usual sign.
    pub typical: f64,
    /// Range outside which a fitted magnitude is reported as implausible.
    pub plausible: (f64, f64),
    /// Range outside which a fit is rejected.
    pub possible: (f64, f64),
}

impl MagnitudeSpec {
    /// The largest significant coefficient, without factor; the other fields are
    /// unset.
    pub const DEFAULT: Self = Self {
        description: "",
        unit: "",
        first: 0,
        aggregation: Aggregation::Largest,
        factor: 1.0,
        typical: f64::NAN,
        plausible: (f64::NEG_INFINITY, f64::INFINITY),
        possible: (f64::NEG_INFINITY, f64::INFINITY),
    };

    /// Euclidean norm of the coefficients without prior knowledge of its range.
    pub(crate) const fn norm_without_prior(description: &'static str, unit: &'static str) -> Self {
        Self { description, unit, aggregation: Aggregation::Norm, ..Self::DEFAULT }
    }
}

//! A number of an effect.

use std::borrow::Cow;

/// How a parameter enters.
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    /// The effect vanishes where all its coefficients are zero, and grows with them.
    Coefficient,
    /// It gives the effect its form: a time constant, a reach, a distance. Above zero; the fit
    /// starts from the best of `grid`.
    Shape {
        /// Where the search begins.
        grid: Cow<'static, [f64]>,
    },
    /// Where a memory stands as a recording begins; zero unless the data say otherwise.
    Beginning,
    /// An instant of the campaign in seconds (recordings laid end to end), searched on the data and
    /// then refined.
    Instant,
}

/// One parameter of an effect, of one sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Name in files and tables.
    pub name: Cow<'static, str>,
    /// Unit.
    pub unit: Cow<'static, str>,
    /// How it enters.
    pub kind: Kind,
    /// A size that shows on a gripper, in its unit; its sign does not matter. The fit expects nothing
    /// beyond some ten times this unless the data say so.
    pub typical: f64,
    /// True where all sensors of a gripper have the same value.
    pub shared: bool,
    /// True for a shape that spans recordings. Within the recordings fitted, a time constant of their own
    /// length trades against every slow thing that the model lacks; what counts is whether it carries
    /// over to a recording that the fit did not see, so that decides.
    pub across: bool,
    /// True for a travel, in newtons, that the load must go through twice before it shows: a slider whose
    /// reach is more than half the load's swing never slips, and is a spring like the flexure.
    pub within_swing: bool,
    /// For which recordings it stands.
    pub of: Of,
}

/// For which recordings of a campaign a parameter stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Of {
    /// One for all.
    Campaign,
    /// One for each.
    EachRecording,
    /// One for each but the first.
    EachLaterRecording,
}

impl Parameter {
    const fn new(name: &'static str, unit: &'static str, kind: Kind, typical: f64) -> Self {
        Self {
            name: Cow::Borrowed(name),
            unit: Cow::Borrowed(unit),
            kind,
            typical,
            shared: false,
            across: false,
            within_swing: false,
            of: Of::Campaign,
        }
    }

    /// A coefficient of each sensor.
    pub const fn coefficient(name: &'static str, unit: &'static str, typical: f64) -> Self {
        Self::new(name, unit, Kind::Coefficient, typical)
    }

    /// A shape of each sensor, with the values from which its search begins.
    pub const fn shape(name: &'static str, unit: &'static str, grid: &'static [f64]) -> Self {
        let grid = Cow::Borrowed(grid);
        Self::new(name, unit, Kind::Shape { grid }, 0.0)
    }

    /// An instant of the campaign.
    pub const fn instant(name: &'static str, unit: &'static str) -> Self {
        Self::new(name, unit, Kind::Instant, 0.0)
    }

    /// The same for all sensors.
    pub const fn shared(mut self) -> Self {
        self.shared = true;
        self
    }

    /// Told by what carries over to recordings left out, where there are several.
    pub const fn across_recordings(mut self) -> Self {
        self.across = true;
        self
    }

    /// Sought only up to half the swing of the load.
    pub const fn within_swing(mut self) -> Self {
        self.within_swing = true;
        self
    }

    /// Where a memory begins, in each recording; `typical` is its spread.
    pub const fn beginning(name: &'static str, unit: &'static str, typical: f64) -> Self {
        let mut parameter = Self::new(name, unit, Kind::Beginning, typical);
        parameter.of = Of::EachRecording;
        parameter
    }

    /// One for every recording but the first.
    pub const fn each_later_recording(mut self) -> Self {
        self.of = Of::EachLaterRecording;
        self
    }

    /// True for coefficients.
    pub fn is_coefficient(&self) -> bool {
        self.kind == Kind::Coefficient
    }
}

/// How one number is made of several coefficients.
#[derive(Clone, Copy, Debug)]
pub enum SizeOf {
    /// The largest of those that stand out from their error bars.
    Largest,
    /// Root of the sum of squares, mean over the sensors.
    Norm,
    /// What this makes of all values, mean over the sensors.
    Mean(fn(&[f64]) -> f64),
    /// What this makes of all values, at the sensor where it is greatest.
    Greatest(fn(&[f64]) -> f64),
}

/// The one number that says how large an effect is.
#[derive(Clone, Copy, Debug)]
pub struct Size {
    /// What it is, for people.
    pub words: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// The first this many coefficients make it; zero for all.
    pub first: usize,
    /// How.
    pub of: SizeOf,
    /// Multiplies what they make.
    pub factor: f64,
    /// What no number of rows can better, one standard deviation in the size's unit, added to the
    /// error bar: two clocks' stamps agree to some hundredths of a millisecond at best (assumed).
    pub resolution: f64,
    /// A size that shows.
    pub typical: f64,
    /// Sizes that no one would wonder at.
    pub plausible: (f64, f64),
    /// Sizes that physics allows at all.
    pub possible: (f64, f64),
}

impl Size {
    /// The coefficients' root of the sum of squares, where nobody knows what to expect.
    pub const fn unexpected(words: &'static str, unit: &'static str) -> Self {
        let all = (f64::NEG_INFINITY, f64::INFINITY);
        Self {
            words,
            unit,
            first: 0,
            of: SizeOf::Norm,
            factor: 1.0,
            resolution: 0.0,
            typical: f64::NAN,
            plausible: all,
            possible: all,
        }
    }
}

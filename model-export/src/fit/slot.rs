//! One number that a fit may move: of the base or of an effect.

use crate::effects::{Kind, Parameter};

/// Coefficients of an effect are expected within this many times their typical size.
const EXPECTED: f64 = 10.0;
/// Least width of a shape's prior, relative.
const LEAST_SHAPE_WIDTH: f64 = 0.1;

/// A parameter of one sensor, measured in departures: how many of its scales it lies from its start.
#[derive(Clone, Debug, PartialEq)]
pub struct Slot {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Where departures count from.
    pub start: f64,
    /// One departure; where `relative`, of the value's logarithm. The prior is as wide.
    pub scale: f64,
    /// True for shapes, which stay above zero.
    pub relative: bool,
    /// True where all sensors share the value.
    pub shared: bool,
    /// True for coefficients and for the base: what each fold fits anew from scratch. Shapes and
    /// beginnings depart from those of the whole campaign.
    pub from_scratch: bool,
    /// Chosen by recordings left out, and no longer moved by any fit: its standard deviation in
    /// departures.
    pub chosen: Option<f64>,
}

impl Slot {
    /// The slot of an effect's parameter.
    pub fn of(parameter: &Parameter) -> Self {
        let (start, scale, relative) = match &parameter.kind {
            // Until the search for a start knows better.
            Kind::Coefficient if parameter.typical.is_nan() => (0.0, 1.0, false),
            Kind::Coefficient => (0.0, EXPECTED * parameter.typical.abs(), false),
            Kind::Beginning => (0.0, parameter.typical, false),
            Kind::Instant => (0.0, 0.5, false),
            Kind::Shape { grid } => {
                let (first, last) = (grid[0], grid[grid.len() - 1]);
                let step = (last / first).ln() / (grid.len() - 1) as f64;
                match first > 0.0 {
                    true => (grid[grid.len() / 2], step.max(LEAST_SHAPE_WIDTH), true),
                    false => (
                        grid[grid.len() / 2],
                        (last - first) / (grid.len() - 1) as f64,
                        false,
                    ),
                }
            }
        };
        Self {
            name: parameter.name.to_string(),
            unit: parameter.unit.to_string(),
            start,
            scale,
            relative,
            shared: parameter.shared,
            from_scratch: parameter.is_coefficient(),
            chosen: None,
        }
    }

    /// The value at a departure.
    pub fn value(&self, departure: f64) -> f64 {
        match self.relative {
            true => self.start * libm::exp(self.scale * departure),
            false => self.start + self.scale * departure,
        }
    }

    /// The departure of a value.
    pub fn departure(&self, value: f64) -> f64 {
        match self.relative {
            true => (value / self.start).ln() / self.scale,
            false => (value - self.start) / self.scale,
        }
    }

    /// d value / d departure.
    pub fn slope(&self, departure: f64) -> f64 {
        match self.relative {
            true => self.scale * self.value(departure),
            false => self.scale,
        }
    }
}

//! What the device reads, row by row: of a recording, or of a simulated gripper.

mod recorded;
mod simulated;

use anyhow::Result;
use firmware::frame::SENSORS;
use firmware::hall::Reading;
use firmware::surroundings::Surroundings;
use nalgebra::Vector3;

pub use recorded::Recorded;
pub use simulated::Simulated;

use crate::wiring::counts;

/// One row without a foreign magnet.
#[derive(Clone, Debug)]
pub struct Row {
    /// Seconds since the first row.
    pub time_s: f64,
    /// Field with its noise in gauss, and the temperature's word; nothing where there is no sensor.
    pub sensors: [Option<(Vector3<f64>, i16)>; SENSORS],
    /// What the board knows beside.
    pub around: Surroundings,
}

impl Row {
    /// What the sensors read where `foreign` is added to their fields, in gauss.
    pub fn readings(
        &self,
        gauss_per_lsb: f64,
        foreign: impl Fn(usize) -> Vector3<f64>,
    ) -> [Option<Reading>; SENSORS] {
        std::array::from_fn(|sensor| {
            let (field_g, temperature) = self.sensors[sensor]?;
            let seen = field_g + foreign(sensor);
            Some(Reading {
                field: seen.map(|gauss| counts(gauss, gauss_per_lsb)).into(),
                temperature,
            })
        })
    }
}

/// Rows in their order.
pub trait Rows {
    /// The next one; nothing after the last.
    fn next_row(&mut self) -> Result<Option<Row>>;

    /// What a small field from outside, in the gripper's axes, adds to a sensor's own.
    fn felt(&self, sensor: usize, field_g: Vector3<f64>) -> Vector3<f64>;
}

/// Where rows come from.
pub enum World {
    /// One recording: the same rows in every run, with other magnets.
    Recorded(Recorded),
    /// Fresh recordings of a simulated gripper, another in every run.
    Simulated(Box<Simulated>),
}

impl World {
    /// Seconds of a run.
    pub fn seconds(&self) -> f64 {
        match self {
            Self::Recorded(recorded) => recorded.seconds,
            Self::Simulated(simulated) => simulated.seconds(),
        }
    }

    /// Seed of the magnets.
    pub fn seed(&self) -> u64 {
        match self {
            Self::Recorded(recorded) => recorded.seed,
            Self::Simulated(simulated) => simulated.seed(),
        }
    }

    /// True where a run's rows without magnets are those of no run before.
    pub fn is_fresh(&self, number: u32) -> bool {
        matches!(self, Self::Simulated(_)) || number == 0
    }

    /// The rows of a run.
    pub fn rows(&self, number: u32) -> Result<Box<dyn Rows + '_>> {
        Ok(match self {
            Self::Recorded(recorded) => Box::new(recorded.rows()?),
            Self::Simulated(simulated) => Box::new(simulated.rows(number)),
        })
    }
}

//! A recording as a world: what its sensors measured, row by row.

use model_export::inverse::build::Built;
use model_export::recordings::problem::Problem;
use model_export::recordings::raw::RawStream;

use super::world::{Moment, World};
use crate::surroundings::Covariates;
use crate::wiring::{Wiring, readings, wire};

/// A recording that goes on at the board's rate, whatever its clock says.
pub struct Recorded {
    stream: RawStream,
    wiring: Vec<Wiring>,
    covariates: Covariates,
    gauss_per_lsb: f64,
    /// What could not be read: the world ends there.
    pub problem: Option<Problem>,
}

impl Recorded {
    /// The recording as sensors of this model would feel it.
    pub fn new(stream: RawStream, built: &Built) -> Self {
        Self {
            wiring: wire(&built.header.sensors, &stream),
            covariates: Covariates::find(stream.layout(), built.model.design.as_ref()),
            gauss_per_lsb: built.model.sensor_scale.gauss_per_lsb,
            stream,
            problem: None,
        }
    }
}

impl World for Recorded {
    fn next(&mut self) -> Option<Moment> {
        let row = match self.stream.next_row() {
            Ok(row) => row?,
            Err(problem) => {
                self.problem = Some(problem);
                return None;
            }
        };
        Some(Moment {
            readings: readings(&row, &self.wiring, self.gauss_per_lsb),
            around: self.covariates.at(&row),
        })
    }
}

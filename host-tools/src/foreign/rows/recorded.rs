//! Rows of a recording.

use std::path::PathBuf;

use anyhow::Result;
use firmware::frame::SENSORS;
use model_export::inverse::build::Built;
use model_export::recordings::align::Alignment;
use model_export::recordings::description::Description;
use model_export::recordings::raw::RawStream;
use nalgebra::Vector3;

use super::{Row, Rows};
use crate::surroundings::Covariates;
use crate::wiring::{Wiring, temperature, wire};

/// A recording without a foreign magnet.
pub struct Recorded {
    /// Its folder.
    pub folder: PathBuf,
    /// How its clocks belong together.
    pub alignment: Alignment,
    /// Seconds that it takes.
    pub seconds: f64,
    /// Seed of the magnets.
    pub seed: u64,
    numbers: Vec<u32>,
    design: Option<model_export::recordings::description::Design>,
}

impl Recorded {
    /// A recording of the gripper that a model was fitted to.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn open(folder: PathBuf, alignment: Alignment, built: &Built, seed: u64) -> Result<Self> {
        let mut own = Self {
            folder,
            alignment,
            seconds: 0.0,
            seed,
            numbers: built.header.sensors.clone(),
            design: built.model.design.clone(),
        };
        let mut rows = own.rows()?;
        while let Some(row) = rows.next_row()? {
            own.seconds = row.time_s;
        }
        Ok(own)
    }

    /// From its first row on.
    pub fn rows(&self) -> Result<RecordedRows> {
        let (description, _) = Description::read(&self.folder)?;
        let stream = RawStream::open(&self.folder, &description, self.alignment)?;
        Ok(RecordedRows {
            wiring: wire(&self.numbers, &stream),
            covariates: Covariates::find(stream.layout(), self.design.as_ref()),
            stream,
            first_s: None,
        })
    }
}

/// Rows on their way.
pub struct RecordedRows {
    stream: RawStream,
    wiring: Vec<Wiring>,
    covariates: Covariates,
    first_s: Option<f64>,
}

impl Rows for RecordedRows {
    fn next_row(&mut self) -> Result<Option<Row>> {
        let Some(row) = self.stream.next_row()? else {
            return Ok(None);
        };
        let mut sensors = [None; SENSORS];
        for wires in &self.wiring {
            if let Some(sensor) = sensors.get_mut(wires.number as usize) {
                let field_g = Vector3::from(wires.field.map(|channel| row.hall[channel]));
                *sensor = Some((field_g, temperature(&row, wires)));
            }
        }
        Ok(Some(Row {
            time_s: row.time_s - *self.first_s.get_or_insert(row.time_s),
            sensors,
            around: self.covariates.at(&row),
        }))
    }

    /// How its elements are turned is not known, and magnets come from all directions.
    fn felt(&self, _sensor: usize, field_g: Vector3<f64>) -> Vector3<f64> {
        field_g
    }
}

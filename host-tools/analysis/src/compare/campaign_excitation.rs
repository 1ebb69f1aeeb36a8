//! Excitation of the sensors over a campaign, by which recordings are corrected for the effects of a model.

use std::borrow::Cow;

use model_export::effects::ExcitationSeries;
use model_export::effects::excitation::LoadCycleCounter;
use model_export::fit::rows::RecordingRows;
use model_export::model_file::RowCorrection;
use model_export::recordings::columns::Axis;
use model_export::recordings::{DataError, Recording};

use crate::compare::campaign_reader::RecordingId;
use crate::model::Model;
use crate::replay::corrections::SensorCorrections;

/// Excitation of the sensors, recording by recording in their order, where a model corrects recordings by it.
pub struct CampaignExcitation {
    /// Sensors with the load cycles so far; empty where nothing is corrected.
    sensors: Vec<SensorLoads>,
    before_s: f64,
}

/// The loads of one sensor so far.
struct SensorLoads {
    number: u32,
    /// Forces of its model.
    forces: Vec<(u32, Axis)>,
    cycles: LoadCycleCounter,
}

/// Excitation of each sensor over one recording.
pub type RecordingExcitation = Vec<(u32, ExcitationSeries)>;

impl CampaignExcitation {
    /// Of the sensors of these models.
    pub fn of<'m>(models: impl Iterator<Item = &'m Model>) -> Self {
        let mut forces: Vec<(u32, Vec<(u32, Axis)>)> = models
            .filter(|model| model.needs_corrections())
            .flat_map(|model| model.file.sensors.iter().map(|of| (of.number, of.forces())))
            .collect();
        forces.sort_unstable();
        forces.dedup_by_key(|(number, _)| *number);
        let sensors = forces.into_iter().map(|(number, forces)| SensorLoads {
            number,
            forces,
            cycles: LoadCycleCounter::default(),
        });
        Self { sensors: sensors.collect(), before_s: 0.0 }
    }

    /// Excitation of the next recording; empty where nothing is corrected.
    ///
    /// # Errors
    /// The recording is unreadable.
    pub fn next<'a>(
        &mut self,
        place: usize,
        read: impl Fn(usize) -> Result<Cow<'a, Recording>, DataError>,
    ) -> Result<RecordingExcitation, DataError> {
        if self.sensors.is_empty() {
            return Ok(Vec::new());
        }
        let recording = read(place)?;
        let position = (place, self.before_s);
        self.before_s += recording.span_s();
        let series = self.sensors.iter_mut().filter_map(|sensor| {
            let rows = RecordingRows::of(&recording, position, sensor.number, &sensor.forces)?;
            let mut track = rows.track;
            sensor.cycles.update(&mut track);
            Some((sensor.number, track))
        });
        Ok(series.collect())
    }
}

/// What separates a recording from the conditions of a model's tables, by sensor. `excitation` is that of each sensor, `clock_s` its
/// first row on the board's clock.
pub fn recording_corrections(
    named: &RecordingId,
    model: &Model,
    excitation: &[(u32, ExcitationSeries)],
    clock_s: f64,
) -> Vec<SensorCorrections> {
    let place = model.place_of(&named.sha256);
    let is_new = place == model.file.provenance.recordings.len();
    let of_sensor = |(sensor, series): &(u32, ExcitationSeries)| {
        let series = ExcitationSeries { recording: place, ..series.clone() };
        let predictor = model.file.predictor(*sensor, &model.effects)?;
        let own = model.file.sensors.iter().find(|own| own.number == *sensor)?;
        // Readings are in the sensor's axes.
        let turned = |row: RowCorrection| RowCorrection {
            reading: (row.reading.0, own.orientation.to_sensor(row.reading.1)),
            irreducible_g: own.orientation.to_sensor(row.irreducible_g),
            ..row
        };
        let rows = predictor.corrections(&series, is_new)?;
        Some(SensorCorrections {
            sensor: *sensor,
            rows: rows.into_iter().map(turned).collect(),
            time_s: series.time_s.iter().map(|time_s| time_s + clock_s).collect(),
        })
    };
    excitation.iter().filter_map(of_sensor).collect()
}

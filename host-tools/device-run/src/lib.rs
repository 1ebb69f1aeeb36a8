//! Recorded rows through the device's own code.
//!
//! [`RecordedRows`] turns each row of a recording into the sensor readings and covariates that the board has at
//! that time. Replay, training data, disturbance evaluation and the simulated board read recordings with it.
//!
//! - [`channel_map`]: columns of a recording as readings and covariates in the device's units.
//! - [`mcap`]: a recording with the device's estimates as an MCAP file.
//! - [`networks`]: recurrent networks in fixed and floating point.

pub mod channel_map;
pub mod mcap;
pub mod networks;

use std::collections::VecDeque;

use firmware::compensation::auxiliary_inputs::AuxiliaryInputs;
use firmware::compensation::covariates::Covariates;
use firmware::compensation::{Compensation, CompensationState};
use firmware::config::constants;
use firmware::estimator::{Validity, estimate};
use firmware::fixed_point::{Field, Force};
use firmware::sensors::hall::{HallReading, SENSORS};
use model_export::fit::rows::ForcePair;
use model_export::gru::train::dataset::{SensorSequence, Sequence};
use model_export::inverse::build::DeviceModel;
use model_export::inverse::compensation::OwnedCompensation;
use model_export::inverse::grbf::Grbf;
use model_export::inverse::quantise::TableSet;
use model_export::recordings::DataError;
use model_export::recordings::columns::ChannelLayout;
use model_export::recordings::csv_table::GAP_STEPS;
use model_export::recordings::description::NominalDesign;
use model_export::recordings::stream::{RawRow, RawStream};

use crate::channel_map::{CovariateChannels, SensorChannels};
use crate::networks::NetworkSet;

/// The device's tables, and the same model in floating point.
#[derive(Clone, Copy, Debug)]
pub struct ReplayModels<'a> {
    /// Sensor numbers, in the order of the tables.
    pub numbers: &'a [u32],
    /// Forces that each of them was fitted to.
    pub forces: &'a [ForcePair],
    /// Fixed-point tables of the device.
    pub tables: &'a TableSet,
    /// Compensations of effects around the tables.
    pub compensations: &'a [OwnedCompensation],
    /// Nominal design of the gripper, which scales the covariates.
    pub design: Option<&'a NominalDesign>,
    /// Floating-point models, in the order of the tables, where the error of fixed point is wanted.
    pub float: Option<&'a [Grbf]>,
    /// Field per count, in gauss.
    pub gauss_per_lsb: f64,
    /// Largest force of each axis in newtons, both signs.
    pub force_range_n: f64,
    /// Recurrent networks on top of the tables.
    pub networks: Option<&'a NetworkSet>,
}

impl<'a> ReplayModels<'a> {
    /// Everything built from a model, without networks and floating point.
    pub fn of(built: &'a DeviceModel) -> Self {
        Self {
            numbers: &built.header.sensors,
            forces: &built.header.forces,
            tables: &built.chosen.tables,
            compensations: &built.compensations,
            design: built.model.design.as_ref(),
            float: None,
            gauss_per_lsb: built.model.sensor_scale.gauss_per_lsb,
            force_range_n: built.model.force_range_n(),
            networks: None,
        }
    }

    /// Compensations as the device's tables borrow them.
    pub fn compensation_views(&self) -> Vec<Compensation<'a>> {
        let owned = self.compensations.iter();
        owned.map(OwnedCompensation::view).collect()
    }

    /// The rows of a recording as inputs of these models.
    pub fn rows(&self, stream: RawStream) -> RecordedRows {
        let channels = self.channels(stream.layout());
        RecordedRows::new(stream, channels)
    }

    /// Channels of these models in a layout.
    pub fn channels(&self, layout: &ChannelLayout) -> InputChannels {
        let sensors = (self.numbers, self.forces);
        InputChannels::find(layout, sensors, self.design, self.gauss_per_lsb)
    }
}

/// One row of a recording as inputs of the device.
#[derive(Clone, Debug)]
pub struct DeviceRow {
    /// The row as recorded.
    pub raw: RawRow,
    /// Readings of the board's sensors, through the bytes on their buses.
    pub readings: [Option<HallReading>; SENSORS],
    /// Covariates, as the device sends them.
    pub covariates: Covariates,
    /// Inputs of the compensation.
    pub inputs: AuxiliaryInputs,
    /// False for a row that was interpolated between two recorded ones.
    pub is_recorded: bool,
    /// True for the first row at or after a reference row ([`RawStream::at_reference_row`]).
    pub at_reference_row: bool,
}

/// Channels of rows that are inputs of the device.
#[derive(Clone, Debug)]
pub struct InputChannels {
    sensors: Vec<SensorChannels>,
    covariates: CovariateChannels,
    gauss_per_lsb: f64,
}

impl InputChannels {
    /// Of the sensors of the tables, each with the forces of its model; those without a field or a force in the layout are left out.
    pub fn find(
        layout: &ChannelLayout,
        (numbers, forces): (&[u32], &[ForcePair]),
        design: Option<&NominalDesign>,
        gauss_per_lsb: f64,
    ) -> Self {
        Self {
            sensors: SensorChannels::find(numbers, forces, layout),
            covariates: CovariateChannels::find(layout, design),
            gauss_per_lsb,
        }
    }

    /// Channels of the sensors, in the order of the tables.
    pub fn sensors(&self) -> &[SensorChannels] {
        &self.sensors
    }

    /// A row as the board has it.
    pub fn row(&self, raw: RawRow) -> DeviceRow {
        let mut readings = [None; SENSORS];
        for channels in &self.sensors {
            if let Some(slot) = readings.get_mut(channels.number as usize) {
                *slot = Some(channels.reading(&raw, self.gauss_per_lsb));
            }
        }
        let covariates = self.covariates.at(&raw);
        let inputs = covariates.inputs(self.covariates.pole_pairs());
        DeviceRow { raw, readings, covariates, inputs, is_recorded: true, at_reference_row: false }
    }
}

/// Time between two samples of the device, in microseconds.
const TICK_US: f64 = constants::TICK_US as f64;

/// The walk over the rows of a recording, as inputs of the device, in order, at the device's rate: its compensation and its
/// networks advance by one step with each sample. Of a slower recording, rows are interpolated linearly; of a faster one,
/// some are left out.
pub struct RecordedRows {
    stream: RawStream,
    channels: InputChannels,
    /// Whether there are device samples between the recorded rows.
    is_slower: bool,
    /// Recorded rows for each device sample, at least one.
    rows_per_tick: usize,
    last: Option<RawRow>,
    /// Rows to return next, and whether they were recorded.
    pending: VecDeque<(RawRow, bool)>,
    at_reference_row: bool,
}

impl RecordedRows {
    /// The rows of a stream through its `channels`.
    pub fn new(stream: RawStream, channels: InputChannels) -> Self {
        let ratio = stream.period_us() / TICK_US;
        // The cast saturates, and the clock of a single row has no period.
        let rows_per_tick = if ratio > 0.0 { (1.0 / ratio).round() as usize } else { 1 };
        Self {
            channels,
            is_slower: ratio.round() > 1.0,
            rows_per_tick: rows_per_tick.max(1),
            last: None,
            pending: VecDeque::new(),
            at_reference_row: false,
            stream,
        }
    }

    /// Reads the next row, with the rows between it and the one before.
    fn read(&mut self) -> Result<(), DataError> {
        let mut read = None;
        self.at_reference_row = false;
        for _ in 0..self.rows_per_tick {
            let Some(row) = self.stream.next_row()? else { break };
            self.at_reference_row |= self.stream.at_reference_row();
            read.get_or_insert(row);
        }
        let Some(row) = read else {
            return Ok(());
        };
        if self.is_slower {
            if let Some(last) = &self.last {
                let step_us = 1e6 * (row.time_s - last.time_s);
                let is_gap = step_us > GAP_STEPS * self.stream.period_us();
                let ticks = if is_gap { 1 } else { (step_us / TICK_US).round() as usize };
                for tick in 1..ticks {
                    let between = Self::between(last, &row, tick as f64 / ticks as f64);
                    self.pending.push_back((between, false));
                }
            }
            self.last = Some(row.clone());
        }
        self.pending.push_back((row, true));
        Ok(())
    }

    /// A row at this share of the time between two; without forces, since it is not compared with them.
    fn between(from: &RawRow, to: &RawRow, share: f64) -> RawRow {
        // Angles are unwrapped.
        let value = |(from, to): (&f64, &f64)| from + share * (to - from);
        RawRow {
            time_s: from.time_s + share * (to.time_s - from.time_s),
            hall: from.hall.iter().zip(&to.hall).map(value).collect(),
            forces: vec![f64::NAN; from.forces.len()],
        }
    }

    /// Channels of the sensors, in the order of the tables.
    pub fn sensors(&self) -> &[SensorChannels] {
        self.channels.sensors()
    }

    /// The recording.
    pub fn stream(&self) -> &RawStream {
        &self.stream
    }
}

impl Iterator for RecordedRows {
    type Item = Result<DeviceRow, DataError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.pending.is_empty()
            && let Err(error) = self.read()
        {
            return Some(Err(error));
        }
        let (raw, is_recorded) = self.pending.pop_front()?;
        let at_reference_row = is_recorded && self.at_reference_row;
        Some(Ok(DeviceRow { is_recorded, at_reference_row, ..self.channels.row(raw) }))
    }
}

/// Training sequence of a recording: inputs of every row by the device's code, and the reference force.
///
/// The reference is much slower than the board, and every board row is used. The first board row at or after
/// a reference row has a target, interpolated linearly to the time of the field. Rows whose estimate is
/// invalid have none. `done` receives the number of rows so far.
///
/// # Errors
/// The recording cannot be read.
pub fn training_sequence(
    models: ReplayModels,
    name: &str,
    stream: RawStream,
    done: impl Fn(u64),
) -> Result<Sequence, DataError> {
    const ROWS_PER_REPORT: usize = 4096;
    let compensations = models.compensation_views();
    let tables = models.tables.tables(&compensations);
    let mut input = models.rows(stream);
    let sensors = input.sensors().to_vec();
    let mut memories = vec![CompensationState::default(); sensors.len()];
    let track = |channels: &SensorChannels| SensorSequence {
        number: channels.number,
        ..SensorSequence::default()
    };
    let mut tracks: Vec<SensorSequence> = sensors.iter().map(track).collect();
    let mut rows = 0;
    while let Some(row) = input.next().transpose()? {
        for ((channels, memory), track) in sensors.iter().zip(&mut memories).zip(&mut tracks) {
            let reading = Some(channels.reading(&row.raw, models.gauss_per_lsb));
            let number = channels.number as usize;
            let estimate = estimate(&tables, number, reading, &row.inputs, memory);
            let gauss = |field: Field| (field.counts() * models.gauss_per_lsb) as f32;
            track.field_g.push(estimate.field.map(gauss));
            let ideal_n = estimate.force.map(|force: Force| force.newtons() as f32);
            track.ideal_n.push(ideal_n);
            track.parity_residual_g.push(gauss(estimate.parity.residual));
            let truth = channels.force_n(&row.raw);
            let has_target = row.at_reference_row && truth.iter().all(|n| n.is_finite());
            if has_target && estimate.validity == Validity::Valid {
                track.truth_n.push((rows, truth.map(|n| n as f32)));
            }
        }
        rows += 1;
        if rows % ROWS_PER_REPORT == 0 {
            done(rows as u64);
        }
    }
    done(rows as u64);
    Ok(Sequence { name: name.to_owned(), rows, tracks })
}

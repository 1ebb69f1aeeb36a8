//! Input rows of the device without a disturbance: of a recording, or of a simulated gripper.

use std::path::PathBuf;

use anyhow::Result;
use firmware::compensation::auxiliary_inputs::AuxiliaryInputs;
use firmware::config::constants;
use firmware::sensors::hall::{HallReading, SENSORS};
use model_export::effects::REFERENCE_C;
use model_export::fit::rows::ForcePair;
use model_export::inverse::build::DeviceModel;
use model_export::recordings::align::Alignment;
use model_export::recordings::columns::{COVARIATES, ChannelLayout, HallColumn};
use model_export::recordings::description::NominalDesign;
use model_export::recordings::stream::{RawRow, RawStream};
use nalgebra::Vector3;

use device_run::channel_map::{CovariateChannels, field_counts, temperature_counts};
use device_run::{DeviceRow, InputChannels, RecordedRows};
use sim::campaign::excitation::Excitation;
use sim::campaign::gripper::CampaignGripper;
use sim::campaign::recording::{RecordingSampler, SETTLING_S};
use sim::campaign::settings::CampaignSettings;
use sim::effects::Effects;

/// Duration of a simulated recording in seconds.
pub const SECONDS: f64 = 100.0;
/// Upper bound of the recording numbers, which select what is lost between recordings.
const MAX_RECORDINGS: u32 = 100_000;

/// One row without a disturbance.
#[derive(Clone, Debug)]
pub struct InputRow {
    /// Seconds since the first row.
    pub time_s: f64,
    /// Field with noise in gauss, and the temperature word; `None` without a sensor.
    pub sensors: [Option<(Vector3<f64>, i16)>; SENSORS],
    /// Covariates in the device's units.
    pub inputs: AuxiliaryInputs,
}

impl InputRow {
    /// Readings of the sensors with `added` fields, in gauss.
    pub fn readings(
        &self,
        gauss_per_lsb: f64,
        added: impl Fn(usize) -> Vector3<f64>,
    ) -> [Option<HallReading>; SENSORS] {
        std::array::from_fn(|sensor| {
            let (field_g, temperature) = self.sensors[sensor]?;
            let total_g = field_g + added(sensor);
            Some(HallReading {
                field: total_g.map(|gauss| field_counts(gauss, gauss_per_lsb)).into(),
                temperature,
            })
        })
    }
}

/// Rows in order.
pub trait InputRows {
    /// The next row; `None` after the last.
    fn next_row(&mut self) -> Result<Option<InputRow>>;

    /// A small field in the gripper's axes, as measured by a sensor.
    fn in_sensor_axes(&self, sensor: usize, field_g: Vector3<f64>) -> Vector3<f64>;
}

/// Source of input rows.
pub enum RowSource {
    /// One recording: the same rows in every run, with other magnets.
    Recorded(Box<RecordedGripper>),
    /// New recordings of a simulated gripper, another one in every run.
    Simulated(Box<SimulatedGripper>),
}

impl RowSource {
    /// Duration of a run in seconds.
    pub fn seconds(&self) -> f64 {
        match self {
            Self::Recorded(recorded) => recorded.seconds,
            Self::Simulated(simulated) => simulated.settings.seconds,
        }
    }

    /// Seed of the magnets.
    pub fn seed(&self) -> u64 {
        match self {
            Self::Recorded(recorded) => recorded.seed,
            Self::Simulated(simulated) => simulated.settings.seed,
        }
    }

    /// True if no earlier run had the same rows.
    pub fn has_new_rows(&self, number: u32) -> bool {
        matches!(self, Self::Simulated(_)) || number == 0
    }

    /// The rows of a run.
    ///
    /// # Errors
    /// The recording cannot be read.
    pub fn rows(&self, number: u32) -> Result<Box<dyn InputRows + '_>> {
        Ok(match self {
            Self::Recorded(recorded) => Box::new(recorded.rows()?),
            Self::Simulated(simulated) => Box::new(simulated.rows(number)),
        })
    }
}

/// A recording without a disturbance.
pub struct RecordedGripper {
    folder: PathBuf,
    alignment: Alignment,
    seconds: f64,
    seed: u64,
    numbers: Vec<u32>,
    forces: Vec<ForcePair>,
    design: Option<NominalDesign>,
    gauss_per_lsb: f64,
}

impl RecordedGripper {
    /// A recording of the gripper that the model was fitted to; `seed` draws the magnets.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn open(
        folder: PathBuf,
        alignment: Alignment,
        built: &DeviceModel,
        seed: u64,
    ) -> Result<Self> {
        let mut own = Self {
            folder,
            alignment,
            seconds: 0.0,
            seed,
            numbers: built.header.sensors.clone(),
            forces: built.header.forces.clone(),
            design: built.model.design.clone(),
            gauss_per_lsb: built.model.sensor_scale.gauss_per_lsb,
        };
        let mut rows = own.rows()?;
        while let Some(row) = rows.next_row()? {
            own.seconds = row.time_s;
        }
        Ok(own)
    }

    fn rows(&self) -> Result<RecordedInput> {
        let stream = RawStream::open_folder(&self.folder, self.alignment)?;
        let sensors = (self.numbers.as_slice(), self.forces.as_slice());
        let design = self.design.as_ref();
        let channels = InputChannels::find(stream.layout(), sensors, design, self.gauss_per_lsb);
        let rows = RecordedRows::new(stream, channels);
        Ok(RecordedInput { rows, first_s: None })
    }
}

struct RecordedInput {
    rows: RecordedRows,
    first_s: Option<f64>,
}

impl InputRows for RecordedInput {
    fn next_row(&mut self) -> Result<Option<InputRow>> {
        let Some(DeviceRow { raw, inputs, .. }) = self.rows.next().transpose()? else {
            return Ok(None);
        };
        let mut sensors = [None; SENSORS];
        for channels in self.rows.sensors() {
            if let Some(sensor) = sensors.get_mut(channels.number as usize) {
                *sensor = Some((channels.field_g(&raw).into(), channels.temperature(&raw)));
            }
        }
        let time_s = raw.time_s - *self.first_s.get_or_insert(raw.time_s);
        Ok(Some(InputRow { time_s, sensors, inputs }))
    }

    /// The orientation of the elements is unknown; the directions of the magnets are isotropic.
    fn in_sensor_axes(&self, _sensor: usize, field_g: Vector3<f64>) -> Vector3<f64> {
        field_g
    }
}

/// The simulated gripper of a campaign, in new recordings. They are generated in memory, so ten hours take
/// minutes.
pub struct SimulatedGripper {
    /// Settings of the campaign; higher recording numbers are new recordings.
    campaign: CampaignSettings,
    /// The same with longer and more recordings.
    settings: CampaignSettings,
    effects: Effects,
    /// Loads of the campaign, which determine the position of a hard stop.
    excitations: Vec<Excitation>,
}

impl SimulatedGripper {
    /// The gripper of a campaign that was simulated with these settings.
    ///
    /// # Errors
    /// An effect is not possible.
    pub fn from_settings(campaign: CampaignSettings) -> Result<Self> {
        let excitations = (1..=campaign.recordings).map(|number| campaign.excitation(number));
        Ok(Self {
            effects: campaign.effects()?,
            excitations: excitations.collect(),
            settings: CampaignSettings {
                seconds: SECONDS,
                recordings: MAX_RECORDINGS,
                plan: None,
                ..campaign.clone()
            },
            campaign,
        })
    }

    fn rows(&self, number: u32) -> SimulatedInput<'_> {
        let recording = self.campaign.recordings + 1 + number;
        let settings = &self.settings;
        let columns =
            COVARIATES.iter().map(|name| HallColumn::Covariate { name: (*name).to_owned() });
        let layout = ChannelLayout { hall: columns.collect(), forces: Vec::new() };
        SimulatedInput {
            settings,
            excitation: settings.excitation(recording),
            mechanics: CampaignGripper::new(settings, &self.effects, &self.excitations),
            sampler: RecordingSampler::new(settings, recording),
            covariates: CovariateChannels::find(&layout, Some(&settings.design)),
            frame: 0,
        }
    }
}

struct SimulatedInput<'a> {
    settings: &'a CampaignSettings,
    excitation: Excitation,
    mechanics: CampaignGripper,
    sampler: RecordingSampler<'a>,
    covariates: CovariateChannels,
    frame: u32,
}

impl InputRows for SimulatedInput<'_> {
    fn next_row(&mut self) -> Result<Option<InputRow>> {
        let period_s = 1.0 / constants::SENSE_RATE.value;
        let time_s = f64::from(self.frame) * period_s;
        if time_s >= self.settings.seconds {
            return Ok(None);
        }
        let since_s = if self.frame == 0 { SETTLING_S } else { period_s };
        self.frame += 1;
        let sample = self.sampler.sample(&mut self.mechanics, &self.excitation, time_s, since_s);
        let mut sensors = [None; SENSORS];
        for (slot, (field_g, temperature_c)) in sensors.iter_mut().zip(sample.sensors) {
            *slot = Some((field_g, temperature_counts(temperature_c - REFERENCE_C)));
        }
        let row = RawRow { time_s, hall: sample.covariates.into(), forces: Vec::new() };
        let covariates = self.covariates.at(&row);
        let inputs = covariates.inputs(self.covariates.pole_pairs());
        Ok(Some(InputRow { time_s, sensors, inputs }))
    }

    fn in_sensor_axes(&self, sensor: usize, field_g: Vector3<f64>) -> Vector3<f64> {
        let sensor = self.mechanics.sensors.get(sensor);
        sensor.map_or(field_g, |sensor| sensor.element.rotate(field_g))
    }
}

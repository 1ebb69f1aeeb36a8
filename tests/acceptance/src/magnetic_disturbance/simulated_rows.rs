//! Input rows of the device without a disturbance, of a simulated gripper.

use anyhow::Result;
use firmware::compensation::auxiliary_inputs::AuxiliaryInputs;
use firmware::config::constants;
use firmware::sensors::hall::{HallReading, SENSORS};
use model_export::effects::REFERENCE_C;
use model_export::recordings::columns::{COVARIATES, ChannelLayout, HallColumn};
use model_export::recordings::stream::RawRow;
use nalgebra::Vector3;

use device_run::channel_map::{CovariateChannels, field_counts, temperature_counts};
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

    /// Duration of a recording in seconds.
    pub fn seconds(&self) -> f64 {
        self.settings.seconds
    }

    /// Seed of the gripper and of the magnets.
    pub fn seed(&self) -> u64 {
        self.settings.seed
    }

    /// The rows of a new recording.
    pub fn rows(&self, number: u32) -> SimulatedRows<'_> {
        let recording = self.campaign.recordings + 1 + number;
        let settings = &self.settings;
        let columns =
            COVARIATES.iter().map(|name| HallColumn::Covariate { name: (*name).to_owned() });
        let layout = ChannelLayout { hall: columns.collect(), forces: Vec::new() };
        SimulatedRows {
            settings,
            excitation: settings.excitation(recording),
            mechanics: CampaignGripper::new(settings, &self.effects, &self.excitations),
            sampler: RecordingSampler::new(settings, recording),
            covariates: CovariateChannels::find(&layout, Some(&settings.design)),
            frame: 0,
        }
    }
}

/// Rows in order.
pub struct SimulatedRows<'a> {
    settings: &'a CampaignSettings,
    excitation: Excitation,
    mechanics: CampaignGripper,
    sampler: RecordingSampler<'a>,
    covariates: CovariateChannels,
    frame: u32,
}

impl SimulatedRows<'_> {
    /// The next row; `None` after the last.
    pub fn next_row(&mut self) -> Option<InputRow> {
        let period_s = 1.0 / constants::SENSE_RATE.value;
        let time_s = f64::from(self.frame) * period_s;
        if time_s >= self.settings.seconds {
            return None;
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
        Some(InputRow { time_s, sensors, inputs })
    }

    /// A small field in the gripper's axes, as measured by a sensor.
    pub fn in_sensor_axes(&self, sensor: usize, field_g: Vector3<f64>) -> Vector3<f64> {
        let sensor = self.mechanics.sensors.get(sensor);
        sensor.map_or(field_g, |sensor| sensor.element.rotate(field_g))
    }
}

//! Rows of a simulated gripper, in recordings that nothing was fitted to. No file is written on the
//! way, so that ten hours take minutes.

use anyhow::Result;
use firmware::frame::SENSORS;
use firmware::params;
use model_export::recordings::columns::{COVARIATES, HallColumn};
use model_export::recordings::layout::Layout;
use model_export::recordings::raw::RawRow;
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;

use super::{Row, Rows};
use crate::bench::Settings;
use crate::bench::draw::{Purpose, normal, stream};
use crate::bench::effects::Effects;
use crate::bench::element::Noise;
use crate::bench::gripper::{Gripper, Moment};
use crate::bench::programme::Excitation;
use crate::bench::record::{SETTLING_S, TEMPERATURE_C, covariates};
use crate::bench::warmth::REFERENCE_C;
use crate::surroundings::Covariates;

/// Length of a fresh recording in seconds.
pub const SECONDS: f64 = 100.0;
/// More than there will ever be: what is lost between recordings is asked for by their number.
const MOST_RECORDINGS: u32 = 100_000;

/// The gripper of a campaign, on the bench again.
pub struct Simulated {
    /// As the campaign was made; recordings beyond its own are fresh.
    campaign: Settings,
    /// The same with longer recordings, and more of them.
    settings: Settings,
    effects: Effects,
    /// What the campaign did to it: a stop stands where its loads say.
    excitations: Vec<Excitation>,
}

impl Simulated {
    /// The gripper of a campaign that was made with these settings.
    ///
    /// # Errors
    /// An effect is not possible.
    pub fn again(campaign: Settings) -> Result<Self> {
        let excitations = (1..=campaign.recordings).map(|number| campaign.excitation(number));
        Ok(Self {
            effects: campaign.effects()?,
            excitations: excitations.collect(),
            settings: Settings {
                seconds: SECONDS,
                recordings: MOST_RECORDINGS,
                ..campaign.clone()
            },
            campaign,
        })
    }

    /// Seconds of a fresh recording.
    pub fn seconds(&self) -> f64 {
        self.settings.seconds
    }

    /// Seed of everything that is drawn.
    pub fn seed(&self) -> u64 {
        self.settings.seed
    }

    /// From the first row of a fresh recording on.
    pub fn rows(&self, number: u32) -> SimulatedRows<'_> {
        let recording = self.campaign.recordings + 1 + number;
        let settings = &self.settings;
        let columns = COVARIATES.iter().map(|name| HallColumn::Covariate {
            name: (*name).to_owned(),
        });
        let layout = Layout {
            hall: columns.collect(),
            forces: Vec::new(),
        };
        SimulatedRows {
            settings,
            recording,
            excitation: settings.excitation(recording),
            mechanics: Gripper::new(settings, &self.effects, &self.excitations),
            noises: (0..settings.sensors)
                .map(|sensor| settings.noise_of(recording, sensor))
                .collect(),
            rng: stream(settings.seed, Purpose::Covariates, recording),
            covariates: Covariates::find(&layout, Some(&settings.design)),
            frame: 0,
        }
    }
}

/// Rows on their way.
pub struct SimulatedRows<'a> {
    settings: &'a Settings,
    recording: u32,
    excitation: Excitation,
    mechanics: Gripper,
    noises: Vec<Noise>,
    rng: ChaCha8Rng,
    covariates: Covariates,
    frame: u32,
}

impl Rows for SimulatedRows<'_> {
    fn next_row(&mut self) -> Result<Option<Row>> {
        let period_s = 1.0 / params::SENSE_RATE.value;
        let time_s = f64::from(self.frame) * period_s;
        if time_s >= self.settings.seconds {
            return Ok(None);
        }
        let moment = Moment {
            recording: self.recording,
            time_s,
            since_s: if self.frame == 0 {
                SETTLING_S
            } else {
                period_s
            },
        };
        self.frame += 1;
        let fields = self
            .mechanics
            .go_on(self.settings, &self.excitation, moment);
        let mut sensors = [None; SENSORS];
        let places = fields.iter().zip(&mut self.noises).zip(&mut sensors);
        for (number, ((field, noise), place)) in places.enumerate() {
            let warm_k = self.excitation.temperature_c(number, time_s) - REFERENCE_C;
            let seen_k = warm_k + TEMPERATURE_C * normal(&mut self.rng);
            let word = (seen_k * params::TEMPERATURE_SCALE.value).round() as i16;
            *place = Some((field + noise.next(moment.since_s), word));
        }
        let around = RawRow {
            time_s,
            hall: covariates(&self.excitation, time_s, &mut self.rng).into(),
            forces: Vec::new(),
        };
        Ok(Some(Row {
            time_s,
            sensors,
            around: self.covariates.at(&around),
        }))
    }

    fn felt(&self, sensor: usize, field_g: Vector3<f64>) -> Vector3<f64> {
        let sensor = self.mechanics.sensors.get(sensor);
        sensor.map_or(field_g, |sensor| sensor.element.turned(field_g))
    }
}

//! Settings of a simulated campaign.

use std::ops::RangeInclusive;

use anyhow::Result;
use firmware::config::constants;
use model_export::recordings::description::NominalDesign;

use crate::campaign::excitation::Excitation;
use crate::campaign::plan::RecordingPlan;
use crate::effects::{Effect, Effects};
use crate::hall_sensor::{HallNoise, HallScale, NoiseKind};
use crate::motion::{OpeningProfile, Programme};

/// Recordings start at multiples of this interval, in seconds.
const SPACING_S: f64 = 600.0;

/// Settings of a campaign; with the seed they determine every byte of it.
#[derive(Clone, Debug, PartialEq)]
pub struct CampaignSettings {
    /// Seed of all random streams.
    pub seed: u64,
    /// Excitation programme.
    pub programme: Programme,
    /// Number of recordings of the programme.
    pub recordings: u32,
    /// Length of each of them in seconds.
    pub seconds: f64,
    /// Plan of more recordings after them.
    pub plan: Option<RecordingPlan>,
    /// Nominal design; each sensor deviates from it.
    pub design: NominalDesign,
    /// Scale and range of the Hall sensors.
    pub part: HallScale,
    /// Number of sensors.
    pub sensors: u32,
    /// Factor on all manufacturing tolerances.
    pub scatter: f64,
    /// Kind of field noise in addition to white noise.
    pub noise: NoiseKind,
    /// Factor on every load.
    pub harder: f64,
    /// Offset on every temperature, in kelvin.
    pub warmer_k: f64,
    /// White noise of one field sample in gauss.
    pub field_noise_g: f64,
    /// White noise of one reference row in newtons.
    pub reference_noise_n: f64,
    /// Effects of the simulated gripper.
    pub effects: Vec<Effect>,
    /// The effects were drawn at random; their time constants are drawn as well.
    pub hidden: bool,
}

impl CampaignSettings {
    /// Effects with their magnitude in each sensor.
    ///
    /// # Errors
    /// An effect is given twice.
    pub fn effects(&self) -> Result<Effects> {
        let effects = Effects::new(&self.effects, self.seed, self.sensors, self.scatter)?;
        Ok(if self.hidden { effects.with_random_time_constants(self.seed) } else { effects })
    }

    /// Excitation of a recording, numbered from 1.
    pub fn excitation(&self, recording: u32) -> Excitation {
        let (seed, sensors) = (self.seed, self.sensors);
        let planned = self
            .plan
            .as_ref()
            .and_then(|plan| plan.recording(recording.checked_sub(self.recordings)?));
        if let Some(plan) = planned {
            return Excitation::planned(&plan, OpeningProfile::rotor_rad(seed))
                .scaled(1.0, self.warmer_k);
        }
        let range = self.design.force_range_n() / constants::FORCE_RANGE.value;
        Excitation::draw(self.programme, seed, recording, sensors, self.seconds)
            .scaled(self.harder * range, self.warmer_k)
    }

    /// Numbers of all recordings.
    pub fn numbers(&self) -> RangeInclusive<u32> {
        1..=self.recordings + self.plan.as_ref().map_or(0, |plan| plan.recordings)
    }

    /// Noise of a sensor in a recording.
    pub fn noise_of(&self, recording: u32, sensor: u32) -> HallNoise {
        HallNoise::begin(self.noise, self.field_noise_g, self.seed, (recording, sensor))
    }
}

/// Start of a recording in seconds since the campaign began.
pub fn start_s(seconds: f64, recording: u32) -> f64 {
    let spacing_s = SPACING_S * (seconds / SPACING_S).ceil().max(1.0);
    f64::from(recording - 1) * spacing_s
}

//! Settings of a simulated campaign.

use std::ops::RangeInclusive;

use anyhow::{Result, bail};
use firmware::config::constants;
use model_export::design::SensorDesign;
use model_export::physics::ForwardModel;
use model_export::recordings::description::NominalDesign;

use crate::campaign::excitation::Excitation;
use crate::campaign::plan::RecordingPlan;
use crate::effects::{Effect, Effects};
use crate::hall_sensor::{HallNoise, HallScale, NoiseKind};
use crate::motion::{OpeningProfile, Programme};
use crate::mountings::Mountings;

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
    /// Mountings of the sensors.
    pub mountings: Mountings,
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

/// Maximum number of simulated sensors; the board reads four.
pub const MAX_SENSORS: u32 = 8;
/// Maximum number of recordings of the programme.
pub const MAX_RECORDINGS: u32 = 100;
/// Default number of recordings, their length in seconds, and the white noise of a reference row in newtons.
pub const DEFAULT_RECORDINGS: u32 = 3;
/// See [`DEFAULT_RECORDINGS`].
pub const DEFAULT_SECONDS: f64 = 30.0;
/// See [`DEFAULT_RECORDINGS`].
pub const DEFAULT_REFERENCE_NOISE_N: f64 = 0.15;
/// Minimum length of a recording: the ramp-up of the load.
const MIN_SECONDS: f64 = 3.0;
/// Maximum length of a recording: the range of its clocks.
const MAX_SECONDS: f64 = 3600.0;
/// Maximum white noise of the field: a thousand times that of the sensor.
const MAX_FIELD_NOISE_G: f64 = 350.0;
/// Maximum white noise of the reference: the design force.
const MAX_REFERENCE_NOISE_N: f64 = 250.0;
/// Above this load the field leaves the sensor's range.
const MAX_LOAD: f64 = 2.0;
/// Temperature range of the board.
const MAX_WARMER_K: f64 = 60.0;
/// At this scatter five standard deviations of the stiffness equal its value.
const MAX_SCATTER: f64 = 4.0;

impl CampaignSettings {
    /// The default: a gripper of this design without effects.
    pub fn of_design(design: &SensorDesign) -> Self {
        Self {
            seed: 1,
            programme: Programme::Bench,
            recordings: DEFAULT_RECORDINGS,
            seconds: DEFAULT_SECONDS,
            plan: None,
            design: design.nominal(),
            part: HallScale {
                gauss_per_lsb: design.sensor.gauss_per_lsb,
                range_gauss: design.sensor.range_gauss,
            },
            sensors: design.sensors,
            mountings: Mountings::default(),
            scatter: 1.0,
            noise: NoiseKind::White,
            harder: 1.0,
            warmer_k: 0.0,
            field_noise_g: design.sensor.noise_gauss,
            reference_noise_n: DEFAULT_REFERENCE_NOISE_N,
            effects: Vec::new(),
            hidden: false,
        }
    }

    /// Checks that such a gripper can be built and its recordings be made.
    ///
    /// # Errors
    /// A value is out of range, or the field at rest exceeds that of the sensor.
    pub fn check(&self) -> Result<()> {
        self.check_ranges()?;
        let rest_g = ForwardModel::nominal(&self.design).field([0.0; 2]).amax();
        let range_g = self.part.range_gauss;
        if rest_g >= range_g {
            bail!(
                "the design's field at rest is {rest_g:.0} G, beyond the sensor's range of {range_g:.0} G; use a weaker magnet or a wider gap"
            );
        }
        Ok(())
    }

    /// Checks each number by itself.
    ///
    /// # Errors
    /// One is out of range; the message begins with its name, that of the option of `simulate`.
    pub fn check_ranges(&self) -> Result<()> {
        let ranges = [
            ("scatter", self.scatter, 0.0..=MAX_SCATTER),
            ("load", self.harder, 0.0..=MAX_LOAD),
            ("warmer", self.warmer_k, -MAX_WARMER_K..=MAX_WARMER_K),
            ("field-noise", self.field_noise_g, 0.0..=MAX_FIELD_NOISE_G),
            ("reference-noise", self.reference_noise_n, 0.0..=MAX_REFERENCE_NOISE_N),
            ("seconds", self.seconds, MIN_SECONDS..=MAX_SECONDS),
            ("sensors", f64::from(self.sensors), 1.0..=f64::from(MAX_SENSORS)),
            ("recordings", f64::from(self.recordings), 1.0..=f64::from(MAX_RECORDINGS)),
        ];
        for (name, value, range) in ranges {
            if !range.contains(&value) {
                let (low, high) = (range.start(), range.end());
                bail!("{name} = {value} is not possible here; give {low} to {high}");
            }
        }
        Ok(())
    }

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

//! A simulated bench: campaigns of a gripper whose physics are known.
//!
//! It exists to judge the fit, so it must not repeat it. The two share the closed-form fields of
//! magnets (checked against MagpyLib), the format of recordings and the nominal design with how it
//! mounts its magnet, and nothing else. Everything mechanical is the bench's own and runs in time: springs
//! that stiffen, sliders that stick, dampers and creeping elements as differential equations, loads
//! that are counted, magnets that really move, clocks that tick apart. No effect is written as a
//! term that a fit would look for.
//!
//! What the bench does not have: heat that flows, the fingers' own vibration, a motor controller,
//! lost transfers, a reference that is not calibrated.
//!
//! - [`sizes`]: the effects, and what their sizes mean.
//! - [`effects`]: which of them a campaign has, how large.
//! - [`draw`]: random numbers.
//! - [`scatter`]: how a gripper is made.
//! - [`waves`], [`load`], [`stroke`], [`attitude`], [`warmth`], [`programme`]: what is done to it.
//! - [`friction`], [`flexure`], [`finger`]: how it gives way.
//! - [`surroundings`], [`foreign`], [`uncatalogued`]: fields from outside.
//! - [`element`]: the Hall element.
//! - [`gripper`]: all of it together, in time.
//! - [`clocks`], [`reference`](mod@reference), [`record`]: what is measured and written.
//! - [`truth`]: what was hidden; [`again`]: the same gripper, from its truth.

pub mod again;
pub mod attitude;
pub mod clocks;
pub mod draw;
pub mod effects;
pub mod element;
pub mod finger;
pub mod flexure;
pub mod foreign;
pub mod friction;
pub mod gripper;
pub mod load;
pub mod programme;
pub mod record;
pub mod reference;
pub mod scatter;
pub mod sizes;
pub mod stroke;
pub mod surroundings;
pub mod truth;
pub mod uncatalogued;
pub mod warmth;
pub mod waves;

use std::path::Path;

use anyhow::Result;
use firmware::params;
use model_export::recordings::description::Design;

use clocks::Clock;
use effects::{Effect, Effects};
use element::{Noise, NoiseKind, Part};
use gripper::Gripper;
use programme::{Excitation, Programme};
use record::Recorder;
use truth::Truth;

/// Recordings start so far apart, in seconds, or a multiple of it where they are longer.
const SPACING_S: f64 = 600.0;

/// How the bench is set.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Seed of everything that is drawn.
    pub seed: u64,
    /// What is done to the gripper.
    pub programme: Programme,
    /// Number of recordings.
    pub recordings: u32,
    /// Length of each in seconds.
    pub seconds: f64,
    /// What every sensor departs from.
    pub design: Design,
    /// The Hall sensors.
    pub part: Part,
    /// Number of sensors.
    pub sensors: u32,
    /// Multiplies all scatter of manufacture.
    pub scatter: f64,
    /// Noise of the field beside white noise.
    pub noise: NoiseKind,
    /// Multiplies every load.
    pub harder: f64,
    /// Added to every temperature, in kelvin.
    pub warmer_k: f64,
    /// White noise of one field sample in gauss.
    pub field_noise_g: f64,
    /// White noise of one reference row in newtons.
    pub reference_noise_n: f64,
    /// The effects.
    pub effects: Vec<Effect>,
    /// They were drawn and nobody was told.
    pub hidden: bool,
}

impl Settings {
    /// Its effects.
    ///
    /// # Errors
    /// One of them is not possible.
    pub fn effects(&self) -> Result<Effects> {
        let effects = Effects::new(&self.effects, self.seed, self.sensors, self.scatter)?;
        Ok(match self.hidden {
            true => effects.with_hidden_times(self.seed),
            false => effects,
        })
    }

    /// What is done to the gripper in a recording, counted from 1.
    pub fn excitation(&self, recording: u32) -> Excitation {
        let (seed, sensors) = (self.seed, self.sensors);
        let range = self.design.force_range_n() / params::FORCE_RANGE.value;
        Excitation::draw(self.programme, seed, recording, sensors, self.seconds)
            .beyond(self.harder * range, self.warmer_k)
    }

    /// Noise of a sensor in a recording.
    pub fn noise_of(&self, recording: u32, sensor: u32) -> Noise {
        Noise::begin(
            self.noise,
            self.field_noise_g,
            self.seed,
            (recording, sensor),
        )
    }
}

/// Start of a recording in seconds since the campaign began.
pub fn start_s(seconds: f64, recording: u32) -> f64 {
    let spacing_s = SPACING_S * (seconds / SPACING_S).ceil().max(1.0);
    f64::from(recording - 1) * spacing_s
}

/// Writes a campaign into a folder; `done` is called after each recording.
pub fn simulate(settings: &Settings, folder: &Path, done: impl Fn()) -> Result<Truth> {
    let (seed, seconds) = (settings.seed, settings.seconds);
    let effects = settings.effects()?;
    let numbers = 1..=settings.recordings;
    let excitations: Vec<Excitation> = numbers.clone().map(|n| settings.excitation(n)).collect();
    let rates_hz = [params::SENSE_RATE.value, params::REFERENCE_RATE.value];
    let clocks: Vec<[Clock; 2]> = numbers
        .clone()
        .map(|n| Clock::draw(seed, n, rates_hz))
        .collect();
    let mut gripper = Gripper::new(settings, &effects, &excitations);
    for ((recording, excitation), &clocks) in numbers.zip(&excitations).zip(&clocks) {
        let recorder = Recorder {
            settings,
            effects: &effects,
            recording,
            excitation,
            clocks,
        };
        recorder.write(&folder.join(recording.to_string()), &mut gripper)?;
        gripper.pause(start_s(seconds, recording + 1) - start_s(seconds, recording) - seconds);
        done();
    }
    Truth::new(settings, &effects, &gripper, &clocks)
}

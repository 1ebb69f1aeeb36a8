//! A simulated gripper with its model, fitted by commands of `magpie`.

use std::path::Path;

use anyhow::{Context, Result};
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use sim::campaign::truth;
use tempfile::TempDir;

use super::simulated_rows::SimulatedGripper;
use crate::magpie;

/// Effects of every gripper.
const EFFECTS: [&str; 3] = ["hysteresis", "cross_coupling", "magnet_temperature"];
/// Length of the recordings that the model is fitted to, in seconds.
const SECONDS: &str = "100";

pub struct Gripper {
    /// Source of new recordings.
    pub world: SimulatedGripper,
    /// Model and its tables.
    pub built: DeviceModel,
}

impl Gripper {
    /// Simulates, fits and builds.
    pub fn new(seed: u64, temperature: bool) -> Result<Self> {
        let folder = TempDir::new()?;
        let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
        let [campaign, base, model] = ["campaign", "base.toml", "model.toml"].map(path);
        let seed = seed.to_string();
        let mut simulate = vec!["simulate", "--seed", &seed, "--seconds", SECONDS];
        EFFECTS.iter().for_each(|id| simulate.extend(["--effect", id]));
        simulate.extend(["-o", &campaign]);
        magpie::run(&simulate, None)?;
        if temperature {
            magpie::run(&["fit", &campaign, "-o", &base], None)?;
            magpie::run(&["add", &base, &campaign, "magnet_temperature", "-o", &model], None)?;
        } else {
            magpie::run(&["fit", &campaign, "-o", &model], None)?;
        }
        let built = build(Path::new(&model), ModelVariant::Fitted)?;
        let truth = truth::default_path(Path::new(&campaign)).context("a campaign with a name")?;
        let settings = truth::read_settings(&truth)?;
        let world = SimulatedGripper::from_settings(settings)?;
        Ok(Self { world, built })
    }

    /// Standard deviations of the residuals of the sensors, in gauss.
    pub fn residuals(&self) -> String {
        let sensors = self.built.model.sensors.iter();
        let sigmas = sensors.zip(&self.built.chosen.surfaces).map(|(sensor, surface)| {
            let sigma = self.built.model.residual_sigma(sensor.number, surface.axis);
            format!("{sigma:.3} ({:.3})", surface.fit_rms_g)
        });
        sigmas.collect::<Vec<_>>().join(", ")
    }
}

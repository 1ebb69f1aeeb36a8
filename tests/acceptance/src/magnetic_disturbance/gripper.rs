//! A simulated gripper with its model, fitted by commands of `magpie`.

use std::path::Path;

use analysis::magnetic_disturbance::DeviceUnderTest;
use analysis::magnetic_disturbance::input_rows::{RowSource, SimulatedGripper};
use anyhow::{Context, Result};
use device_run::networks::NetworkSet;
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use sim::campaign::truth;
use tempfile::TempDir;

use crate::magpie;

/// Effects of every gripper.
const EFFECTS: [&str; 3] = ["hysteresis", "cross_coupling", "magnet_temperature"];
/// Length of the recordings that the model is fitted to, in seconds.
const SECONDS: &str = "100";

/// A gripper.
pub struct Gripper {
    /// Source of new recordings.
    pub world: RowSource,
    /// Model and its tables.
    built: DeviceModel,
    /// Networks of the model.
    networks: Option<NetworkSet>,
}

impl Gripper {
    /// Simulates, fits and builds; trains with `networks`.
    pub fn new(seed: u64, temperature: bool, networks: bool) -> Result<Self> {
        let folder = TempDir::new()?;
        let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
        let [campaign, base, model, network] =
            ["campaign", "base.toml", "model.toml", "network"].map(path);
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
        let networks = if networks {
            magpie::run(&["train", &model, &campaign, "-o", &network, "--epochs", "40"], None)?;
            Some(NetworkSet::read(Path::new(&network), &built)?)
        } else {
            None
        };
        let truth = truth::default_path(Path::new(&campaign)).context("a campaign with a name")?;
        let settings = truth::read_settings(&truth)?;
        let world = SimulatedGripper::from_settings(settings)?;
        Ok(Self { world: RowSource::Simulated(Box::new(world)), built, networks })
    }

    /// The device with this model.
    pub fn device(&self) -> DeviceUnderTest<'_> {
        DeviceUnderTest { built: &self.built, networks: self.networks.as_ref() }
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

//! One simulated gripper with its fitted model, by the tool's own commands.

use std::path::Path;
use std::process::Command;

use analysis::magnetic_disturbance::DeviceUnderTest;
use analysis::magnetic_disturbance::input_rows::{RowSource, SimulatedGripper};
use device_run::networks::NetworkSet;
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use sim::campaign::truth;
use tempfile::TempDir;

/// What every gripper has.
const EFFECTS: [&str; 3] = ["hysteresis", "cross_coupling", "magnet_temperature"];
/// Length of the recordings that the model is fitted to.
const SECONDS: &str = "100";

/// A gripper.
pub struct Gripper {
    /// It on the bench again, in recordings that nothing was fitted to.
    pub world: RowSource,
    /// The model and its tables.
    pub built: DeviceModel,
    /// Behind it.
    pub networks: Option<NetworkSet>,
}

impl Gripper {
    /// Simulates, fits and builds; with networks also trains.
    pub fn new(seed: u64, temperature: bool, networks: bool) -> Self {
        let folder = TempDir::new().expect("a folder for the campaign");
        let path = |name: &str| folder.path().join(name);
        let (campaign, base, model) = (path("campaign"), path("base.toml"), path("model.toml"));
        let text = |path: &Path| path.to_str().expect("a name in letters").to_owned();
        let seed = seed.to_string();
        let mut simulate = vec!["simulate", "--seed", &seed, "--seconds", SECONDS];
        EFFECTS.iter().for_each(|id| simulate.extend(["--effect", id]));
        let (campaign, base, model) = (text(&campaign), text(&base), text(&model));
        magpie(&[&simulate[..], &["-o", &campaign]].concat());
        magpie(&["fit", &campaign, "-o", &base]);
        if temperature {
            magpie(&["add", &base, &campaign, "magnet_temperature", "-o", &model])
        } else {
            magpie(&["fit", &campaign, "-o", &model])
        }
        let built =
            build(Path::new(&model), ModelVariant::Fitted).expect("a model that can be inverted");
        let network = text(&path("network"));
        let networks = networks.then(|| {
            magpie(&["train", &model, &campaign, "-o", &network, "--epochs", "40"]);
            NetworkSet::read(Path::new(&network), &built).expect("networks of this model")
        });
        let truth = truth::default_path(Path::new(&campaign)).expect("a campaign with a name");
        let settings = truth::read_settings(&truth).expect("the truth beside the campaign");
        let world = SimulatedGripper::from_settings(settings).expect("effects of the bench");
        Self { world: RowSource::Simulated(Box::new(world)), built, networks }
    }

    /// What runs on its board.
    pub fn device(&self) -> DeviceUnderTest<'_> {
        DeviceUnderTest { built: &self.built, networks: self.networks.as_ref() }
    }

    /// What the model knows of its own residual.
    pub fn words(&self) -> String {
        let sensors = self.built.model.sensors.iter();
        let spreads = sensors.zip(&self.built.chosen.surfaces).map(|(sensor, surface)| {
            let spread = self.built.model.residual_sigma(sensor.number, surface.axis);
            format!("{spread:.3} ({:.3})", surface.fit_rms_g)
        });
        let spreads: Vec<String> = spreads.collect();
        format!("spread beside the surface {} G (of it by the polynomial)", spreads.join(", "))
    }
}

fn magpie(arguments: &[&str]) {
    let output =
        Command::new(env!("CARGO_BIN_EXE_magpie")).args(arguments).output().expect("the tool runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {said}");
}

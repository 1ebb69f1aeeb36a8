//! One simulated gripper with its fitted model, by the tool's own commands.

use std::path::Path;
use std::process::Command;

use host_tools::bench::{again, truth};
use host_tools::foreign::pass::Device;
use host_tools::foreign::rows::{Simulated, World};
use host_tools::networks::Networks;
use model_export::inverse::build::{Built, Variant, build};
use tempfile::TempDir;

/// What every gripper has.
const EFFECTS: [&str; 3] = ["hysteresis", "cross_coupling", "magnet_temperature"];
/// Length of the recordings that the model is fitted to.
const SECONDS: &str = "100";

/// A gripper.
pub struct Gripper {
    /// It on the bench again, in recordings that nothing was fitted to.
    pub world: World,
    /// The model and its tables.
    pub built: Built,
    /// Behind it.
    pub networks: Option<Networks>,
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
        EFFECTS
            .iter()
            .for_each(|id| simulate.extend(["--effect", id]));
        let (campaign, base, model) = (text(&campaign), text(&base), text(&model));
        magpie(&[&simulate[..], &["-o", &campaign]].concat());
        magpie(&["fit", &campaign, "-o", &base]);
        match temperature {
            true => magpie(&["add", &base, &campaign, "magnet_temperature", "-o", &model]),
            false => magpie(&["fit", &campaign, "-o", &model]),
        }
        let built =
            build(Path::new(&model), Variant::Fitted).expect("a model that can be inverted");
        let network = text(&path("network"));
        let networks = networks.then(|| {
            magpie(&["train", &model, &campaign, "-o", &network, "--epochs", "40"]);
            Networks::read(Path::new(&network), &built).expect("networks of this model")
        });
        let truth = truth::default_path(Path::new(&campaign)).expect("a campaign with a name");
        let settings = again::settings(&truth).expect("the truth beside the campaign");
        let world = Simulated::again(settings).expect("effects of the bench");
        Self {
            world: World::Simulated(Box::new(world)),
            built,
            networks,
        }
    }

    /// What runs on its board.
    pub fn device(&self) -> Device<'_> {
        Device {
            built: &self.built,
            networks: self.networks.as_ref(),
        }
    }

    /// What the model knows of its own residual.
    pub fn words(&self) -> String {
        let sensors = self.built.model.sensors.iter();
        let spreads = sensors
            .zip(&self.built.chosen.surfaces)
            .map(|(sensor, surface)| {
                let spread = self.built.model.spread_beside(sensor.number, surface.axis);
                format!("{spread:.3} ({:.3})", surface.left_g)
            });
        let spreads: Vec<String> = spreads.collect();
        format!(
            "spread beside the surface {} G (of it by the polynomial)",
            spreads.join(", ")
        )
    }
}

fn magpie(arguments: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_magpie"))
        .args(arguments)
        .output()
        .expect("the tool runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {said}");
}

//! One simulated gripper with its fitted model, by the tool's own commands.

use std::path::Path;
use std::process::Command;

use host_tools::bench::Settings;
use host_tools::bench::effects::{Effect, Effects};
use host_tools::bench::element::NoiseKind;
use host_tools::bench::programme::Programme;
use host_tools::networks::Networks;
use model_export::inverse::build::{Built, Variant, build};
use tempfile::TempDir;

use super::world::SECONDS;

/// What every gripper has.
const EFFECTS: [&str; 3] = ["hysteresis", "cross_coupling", "magnet_temperature"];
/// Recordings that the model is fitted to.
const FITTED: u32 = 3;
/// More than there will ever be: what is lost between recordings is asked for by their number.
const MOST_RECORDINGS: u32 = 100_000;

/// A gripper.
pub struct Gripper {
    /// How the bench is set; its recordings are numbered beyond those that were fitted.
    pub settings: Settings,
    /// The same effects.
    pub effects: Effects,
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
        let (seed_text, seconds) = (seed.to_string(), SECONDS.to_string());
        let mut simulate = vec!["simulate", "--seed", &seed_text, "--seconds", &seconds];
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
        let effects: Vec<Effect> = EFFECTS
            .iter()
            .map(|id| id.parse().expect("an effect of the bench"))
            .collect();
        let settings = Settings {
            seed,
            programme: Programme::Bench,
            recordings: MOST_RECORDINGS,
            seconds: SECONDS,
            sensors: 4,
            scatter: 1.0,
            noise: NoiseKind::White,
            harder: 1.0,
            warmer_k: 0.0,
            field_noise_g: 0.35,
            reference_noise_n: 0.15,
            effects,
            hidden: false,
        };
        Self {
            effects: Effects::new(&settings.effects, seed, 4, 1.0).expect("effects of the bench"),
            settings,
            built,
            networks,
        }
    }

    /// Number of a recording that nothing was fitted to.
    pub fn fresh(number: u32) -> u32 {
        FITTED + 1 + number
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

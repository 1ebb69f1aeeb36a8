//! The images that the tests run: built with the compiler of this machine, once for each set of sources and tables.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use device_run::networks::NetworkSet;
use emulator::Image;
use model_export::effects::{CATALOGUE, DeviceForm};
use model_export::inverse::build::{DeviceModel, ModelVariant as Fit, build};
use tests::data;
use tests::image::compile;

use crate::workdir::WorkDir;

/// An image, by the tables that it is linked with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variant {
    /// The committed tables: a fit of the demo's campaign with its effect, and a network for each sensor.
    Default,
    /// A plain fit of another gripper.
    Clean,
    /// The same with every effect that the device compensates, and a formula over a force.
    Effects,
    /// Two of four sensors, with effects and networks behind them.
    Friction,
    /// A formula of one's own, over the opening.
    Ripple,
    /// A plain fit with a network for each sensor.
    Networks,
    /// The nominal design: what fits the fingertips of a simulated gripper.
    Nominal,
}

const VARIANTS: usize = Variant::Nominal as usize + 1;

impl Variant {
    /// Those that are fitted to a campaign.
    pub const ALL: [Self; 6] =
        [Self::Default, Self::Clean, Self::Effects, Self::Friction, Self::Ripple, Self::Networks];

    pub fn name(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Clean => "clean",
            Self::Effects => "effects",
            Self::Friction => "friction",
            Self::Ripple => "ripple",
            Self::Networks => "networks",
            Self::Nominal => "nominal",
        }
    }

    /// Campaign that its model is fitted to.
    pub fn campaign(self) -> PathBuf {
        data(match self {
            Self::Default | Self::Networks | Self::Nominal => "demo",
            Self::Clean | Self::Effects => "clean",
            Self::Friction => "friction",
            Self::Ripple => "ripple",
        })
    }

    fn effects(self) -> Vec<&'static str> {
        match self {
            Self::Default | Self::Clean | Self::Networks | Self::Nominal => Vec::new(),
            Self::Effects => {
                let compensated = CATALOGUE.into_iter().filter(|effect| {
                    matches!(effect.device, DeviceForm::Field(_) | DeviceForm::Force(_))
                });
                let ids = compensated.map(|effect| effect.id);
                ids.chain(["--expr=own: bx_g = a*opening_mm*fz_n"]).collect()
            }
            Self::Friction => vec!["hysteresis", "magnet_temperature"],
            Self::Ripple => vec![
                "--expr=ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)",
                "--range=p=2..5",
            ],
        }
    }

    /// Whether networks are behind the model; they are trained too briefly to agree with it for long.
    pub fn has_networks(self) -> bool {
        self == Self::Default || self.training().is_some()
    }

    fn training(self) -> Option<&'static str> {
        match self {
            Self::Friction => Some("--epochs 2 --hidden 4"),
            Self::Networks => Some("--epochs 1"),
            _ => None,
        }
    }
}

/// What an image is made of.
pub struct Made {
    pub path: PathBuf,
    pub image: Image,
    pub built: DeviceModel,
    pub networks: Option<NetworkSet>,
    pub campaign: PathBuf,
}

/// An image with the model that its tables come from. Built on first use; others of the same tables wait meanwhile.
///
/// # Errors
/// This machine has no compiler for the chip, or the image does not build: what the tools print.
pub fn get(variant: Variant) -> Result<Arc<Made>, String> {
    type Result<T> = std::result::Result<T, String>;
    static MADE: [OnceLock<Result<Arc<Made>>>; VARIANTS] = [const { OnceLock::new() }; VARIANTS];
    MADE[variant as usize].get_or_init(|| make(variant).map(Arc::new)).clone()
}

fn make(variant: Variant) -> Result<Made, String> {
    let dir = WorkDir::empty();
    model(&dir, variant);
    let file = |name: &str| dir.0.path().join(name);
    let fit = if variant == Variant::Nominal { Fit::Nominal } else { Fit::Fitted };
    let built = build(&file("model.toml"), fit).map_err(|error| format!("{error:#}"))?;
    let networks = variant
        .has_networks()
        .then(|| NetworkSet::read(&file("networks.safetensors"), &built).unwrap());
    let tables = (variant != Variant::Default).then(|| file("tables.rs"));
    let path = compile(variant.name(), tables.as_deref())?;
    let image = Image::read(&path).map_err(|error| error.to_string())?;
    Ok(Made { path, image, built, networks, campaign: variant.campaign() })
}

/// Fits, adds, trains and exports on a dir.
fn model(dir: &WorkDir, variant: Variant) {
    if variant == Variant::Default {
        for (from, to) in
            [("model.toml", "model.toml"), ("network.safetensors", "networks.safetensors")]
        {
            std::fs::copy(data("default").join(from), dir.path(to)).unwrap();
        }
        return;
    }
    let campaign = variant.campaign();
    let campaign = campaign.to_str().unwrap();
    let effects = variant.effects();
    if effects.is_empty() {
        dir.stdout(&["fit", campaign, "-o", "model.toml"]);
    } else {
        dir.stdout(&["fit", campaign, "-o", "base.toml"]);
        dir.stdout(&[&["add", "base.toml", campaign, "-o", "model.toml"], &effects[..]].concat());
    }
    let mut export = vec!["dev", "export", "model.toml", "-o", "tables.rs"];
    if let Some(training) = variant.training() {
        let mut train = vec!["train", "model.toml", campaign, "-o", "networks.safetensors"];
        train.extend(training.split_whitespace());
        dir.stdout(&train);
        export.extend(["--network", "networks.safetensors"]);
    }
    if variant == Variant::Nominal {
        export.push("--nominal");
    }
    dir.stdout(&export);
}

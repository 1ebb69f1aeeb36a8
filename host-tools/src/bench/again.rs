//! A simulated campaign's settings, from the truth that was written beside it.

use std::path::Path;

use anyhow::{Context, Result, bail};
use model_export::recordings::description::Design;
use serde::Deserialize;

use super::Settings;
use super::effects::{Effect, Flexures};
use super::element::{NoiseKind, Part};
use super::programme::Programme;
use super::truth::MARK;

/// What of [`super::truth::Truth`] was asked for; the rest follows from it.
#[derive(Deserialize)]
struct Asked {
    seed: u64,
    programme: Programme,
    recordings: u32,
    seconds: f64,
    sensors: u32,
    scatter: f64,
    noise: NoiseKind,
    load: f64,
    warmer_k: f64,
    field_noise_g: f64,
    reference_noise_n: f64,
    hidden: bool,
    /// A truth of former versions has none: it was the gripper's own.
    #[serde(default = "Design::magpie")]
    design: Design,
    #[serde(default = "Part::a31301")]
    part: Part,
    #[serde(default)]
    effect: Vec<AskedEffect>,
}

#[derive(Deserialize)]
struct AskedEffect {
    id: String,
    size: f64,
    flexures: Option<Flexures>,
    needed_by: Option<String>,
}

/// Reads the settings from a truth.
///
/// # Errors
/// The file cannot be read, is no truth, or holds an effect that the bench does not know.
pub fn settings(truth: &Path) -> Result<Settings> {
    let text = std::fs::read_to_string(truth)
        .with_context(|| format!("{} cannot be read", truth.display()))?;
    if !text.starts_with(MARK) {
        bail!("{}: it is not a campaign's truth", truth.display());
    }
    let asked: Asked = toml::from_str(&text).with_context(|| truth.display().to_string())?;
    // What another effect needed comes with that effect again.
    let effects = asked.effect.iter().filter(|one| one.needed_by.is_none());
    let effect = |one: &AskedEffect| -> Result<Effect> {
        let effect: Effect = format!("{}={}", one.id, one.size).parse()?;
        Ok(Effect {
            flexures: one.flexures.unwrap_or(effect.flexures),
            ..effect
        })
    };
    Ok(Settings {
        seed: asked.seed,
        programme: asked.programme,
        recordings: asked.recordings,
        seconds: asked.seconds,
        sensors: asked.sensors,
        scatter: asked.scatter,
        noise: asked.noise,
        harder: asked.load,
        warmer_k: asked.warmer_k,
        field_noise_g: asked.field_noise_g,
        reference_noise_n: asked.reference_noise_n,
        effects: effects.map(effect).collect::<Result<_>>()?,
        hidden: asked.hidden,
        design: asked.design,
        part: asked.part,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::simulate;

    #[test]
    fn the_gripper_of_a_truth_is_the_one_that_it_was_written_of() {
        let folder = tempfile::TempDir::new().unwrap();
        let wanted = ["hysteresis=0.5:both", "screw_backlash", "creep=3"];
        let settings_then = Settings {
            seed: 7,
            programme: Programme::Level,
            recordings: 1,
            seconds: 3.0,
            sensors: 2,
            scatter: 1.5,
            noise: NoiseKind::Ar1,
            harder: 1.25,
            warmer_k: -3.5,
            field_noise_g: 0.3,
            reference_noise_n: 0.1,
            effects: wanted.iter().map(|text| text.parse().unwrap()).collect(),
            hidden: true,
            design: Design {
                force_range_n: Some(90.0),
                ..Design::magpie()
            },
            part: Part {
                gauss_per_lsb: 0.25,
                range_gauss: 4000.0,
            },
        };
        let truth = simulate(&settings_then, &folder.path().join("then"), || ()).unwrap();
        let path = folder.path().join("truth.toml");
        std::fs::write(&path, truth.text().unwrap()).unwrap();
        let again = simulate(
            &settings(&path).unwrap(),
            &folder.path().join("again"),
            || (),
        );
        assert_eq!(again.unwrap().text().unwrap(), truth.text().unwrap());
    }
}

//! What a simulated campaign holds: the file that stays outside its folder.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use model_export::recordings::description::Design;
use serde::Serialize;
use toml::{Table, Value};

use super::Settings;
use super::clocks::Clock;
use super::effects::{Chosen, Effects};
use super::element::{DRIFT_S, NoiseKind, Part};
use super::gripper::Gripper;
use super::programme::Programme;
use super::scatter::Made;

/// The file's first line.
pub const MARK: &str = "# What a simulated campaign of magpie holds.";

/// Everything that was drawn.
#[derive(Debug, Serialize)]
pub struct Truth {
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
    /// What the gripper departs from.
    design: Design,
    part: Part,
    /// The effects; empty where the campaign has none.
    pub effect: Vec<EffectTruth>,
    sensor: Vec<Made>,
    clocks: Vec<Clocks>,
}

/// One effect.
#[derive(Debug, Serialize)]
pub struct EffectTruth {
    /// Its id.
    pub id: String,
    /// Its size, the mean over the sensors.
    pub size: f64,
    /// Unit of all sizes.
    pub unit: String,
    meaning: String,
    /// Size in each sensor.
    each: Vec<f64>,
    /// What else was drawn for it.
    #[serde(flatten)]
    details: Table,
}

#[derive(Debug, Serialize)]
struct Clocks {
    recording: u32,
    board: Clock,
    reference: Clock,
}

impl Truth {
    /// Gathers what a campaign holds, after its last recording.
    pub fn new(
        settings: &Settings,
        effects: &Effects,
        gripper: &Gripper,
        clocks: &[[Clock; 2]],
    ) -> Result<Self> {
        Ok(Self {
            seed: settings.seed,
            programme: settings.programme,
            recordings: settings.recordings,
            seconds: settings.seconds,
            sensors: settings.sensors,
            scatter: settings.scatter,
            noise: settings.noise,
            load: settings.harder,
            warmer_k: settings.warmer_k,
            field_noise_g: settings.field_noise_g,
            reference_noise_n: settings.reference_noise_n,
            hidden: settings.hidden,
            design: settings.design.clone(),
            part: settings.part,
            effect: effects
                .chosen
                .iter()
                .map(|chosen| EffectTruth::new(chosen, effects, gripper))
                .collect::<Result<_>>()?,
            sensor: gripper
                .sensors
                .iter()
                .map(|sensor| sensor.made.clone())
                .collect(),
            clocks: (1..)
                .zip(clocks)
                .map(|(recording, &[board, reference])| Clocks {
                    recording,
                    board,
                    reference,
                })
                .collect(),
        })
    }

    /// The file's text.
    pub fn text(&self) -> Result<String> {
        Ok(format!("{MARK}\n{}", toml::to_string(self)?))
    }
}

impl EffectTruth {
    fn new(chosen: &Chosen, effects: &Effects, gripper: &Gripper) -> Result<Self> {
        let kind = chosen.effect.kind;
        let mut details = details(chosen, effects, gripper)?;
        if let Some(id) = chosen.needed_by {
            details.insert("needed_by".into(), id.into());
        }
        Ok(Self {
            id: kind.id.to_owned(),
            size: chosen.effect.size,
            unit: kind.unit().to_owned(),
            meaning: kind.meaning.to_owned(),
            each: chosen.each.clone(),
            details,
        })
    }
}

/// What was drawn for one effect beside its size.
fn details(chosen: &Chosen, effects: &Effects, gripper: &Gripper) -> Result<Table> {
    let sensors = || gripper.sensors.iter();
    let mut table = Table::new();
    let mut tell = |key: &str, value: Result<Value, toml::ser::Error>| -> Result<()> {
        table.insert(key.to_owned(), value?);
        Ok(())
    };
    match chosen.effect.kind.id {
        "hysteresis" => tell("flexures", Value::try_from(chosen.effect.flexures))?,
        "creep" => tell("time_constant_s", Value::try_from(effects.creep_s))?,
        "softening" => {
            let cycles: Vec<[u32; 2]> = sensors().map(|s| s.finger.cycles()).collect();
            tell(
                "time_constant_cycles",
                Value::try_from(effects.softening_cycles),
            )?;
            tell("cycles_in_the_end", Value::try_from(cycles))?;
        }
        "neighbour_magnet" => {
            let closed: Vec<[f64; 3]> = sensors().map(|s| s.neighbour.closed_mm.into()).collect();
            tell("closed_mm", Value::try_from(closed))?;
        }
        "motor_leakage" => {
            let rows: Vec<[[f64; 3]; 3]> =
                sensors().map(|s| s.leakage.transpose().into()).collect();
            tell(
                "axes_by_alpha_beta_quadrature_g_per_a",
                Value::try_from(rows),
            )?;
        }
        "earth_field" => tell(
            "world_g",
            Value::try_from(<[f64; 3]>::from(gripper.earth_g)),
        )?,
        "sensor_temperature" => {
            let drifts: Vec<[f64; 3]> = sensors().map(|s| s.element.per_kelvin_g.into()).collect();
            tell("drift_g_per_k", Value::try_from(drifts))?;
        }
        "field_drift" => {
            let drifts: Vec<[f64; 3]> = sensors().map(|s| s.element.drift_g.into()).collect();
            tell("final_g", Value::try_from(drifts))?;
            tell("time_constant_s", Value::try_from(DRIFT_S))?;
        }
        "demagnetisation" => tell("loss_by_recording", Value::try_from(&gripper.losses))?,
        "external_magnet" => {
            tell("path", Value::try_from(&gripper.foreign))?;
            let count = gripper.sensors.len() as u32;
            if let Some(stretch_s) = gripper.foreign.above_s(1.0, count) {
                tell("above_1_g_s", Value::try_from(stretch_s))?;
            }
        }
        _ => {}
    }
    Ok(table)
}

/// Where the truth goes if nothing else is said: beside the campaign, never in it.
pub fn default_path(campaign: &Path) -> Result<PathBuf> {
    let Some(name) = campaign.file_name() else {
        bail!(
            "{} has no name to put the truth beside; give --truth PATH",
            campaign.display()
        );
    };
    let mut name = OsString::from(name);
    name.push("-truth.toml");
    Ok(campaign.with_file_name(name))
}

/// Refuses a truth inside its campaign.
pub fn check_outside(truth: &Path, campaign: &Path) -> Result<()> {
    let (truth_at, campaign_at) = (std::path::absolute(truth)?, std::path::absolute(campaign)?);
    if truth_at.starts_with(&campaign_at) {
        bail!(
            "{} lies in the campaign's folder, and who reads the campaign would read it; choose another place",
            truth.display()
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_truth_lies_beside_its_campaign() {
        let path = |campaign: &str| default_path(Path::new(campaign)).unwrap();
        assert_eq!(path("out/one"), Path::new("out/one-truth.toml"));
        assert_eq!(path("one/"), Path::new("one-truth.toml"));
        assert!(default_path(Path::new("..")).is_err());
        assert!(check_outside(Path::new("out/one/truth.toml"), Path::new("out/one")).is_err());
        assert!(check_outside(&path("out/one"), Path::new("out/one")).is_ok());
    }
}

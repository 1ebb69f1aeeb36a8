//! Truth file of a simulated campaign: its settings and drawn values, stored outside its folder.

use crate::campaign::gripper::CampaignGripper;
use crate::campaign::plan::RecordingPlan;
use crate::campaign::recording::SampleClock;
use crate::campaign::settings::CampaignSettings;
use crate::effects::{AssignedEffect, Effect, Effects, Flexures};
use crate::finger::SensorSpecimen;
use crate::hall_sensor::{DRIFT_S, HallScale, NoiseKind};
use crate::motion::Programme;
use crate::uncatalogued::Law;
use anyhow::{Context, Result, bail};
use model_export::effects::catalogue::{
    CREEP, DEMAGNETISATION, EARTH_FIELD, EXTERNAL_MAGNET, FIELD_DRIFT, HYSTERESIS, MOTOR_LEAKAGE,
    NEIGHBOUR_MAGNET, SENSOR_TEMPERATURE, SOFTENING,
};
use model_export::input;
use model_export::physics::{SensorMounting, SensorOrientation};
use model_export::recordings::description::NominalDesign;
use serde::{Deserialize, Serialize};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// First line of the file, which identifies it.
pub const MARK: &str = "# What a simulated campaign of magpie holds.";

/// Settings and drawn values of a campaign.
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
    /// Nominal design.
    design: NominalDesign,
    part: HallScale,
    /// Plan of the last recording, after those of the programme.
    #[serde(skip_serializing_if = "Option::is_none")]
    plan: Option<RecordingPlan>,
    /// Simulated effects.
    pub effect: Vec<EffectTruth>,
    sensor: Vec<SensorSpecimen>,
    clocks: Vec<Clocks>,
}

/// One effect in the truth file.
#[derive(Debug, Serialize)]
pub struct EffectTruth {
    /// Identifier of the effect.
    pub id: String,
    /// Magnitude, the mean over the sensors.
    pub size: f64,
    /// Unit of the magnitude.
    pub unit: String,
    meaning: String,
    /// Magnitude in each sensor.
    each: Vec<f64>,
    /// Further drawn values.
    #[serde(flatten)]
    details: Table,
}

#[derive(Debug, Serialize)]
struct Clocks {
    recording: u32,
    board: SampleClock,
    reference: SampleClock,
}

impl Truth {
    /// Truth of a campaign after its last recording.
    pub fn new(
        settings: &CampaignSettings,
        effects: &Effects,
        gripper: &CampaignGripper,
        clocks: &[[SampleClock; 2]],
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
            plan: settings.plan.clone(),
            effect: effects
                .chosen
                .iter()
                .map(|chosen| EffectTruth::new(chosen, effects, gripper))
                .collect::<Result<_>>()?,
            sensor: gripper.sensors.iter().map(|sensor| sensor.specimen.clone()).collect(),
            clocks: (1..)
                .zip(clocks)
                .map(|(recording, &[board, reference])| Clocks { recording, board, reference })
                .collect(),
        })
    }

    /// The file's text.
    pub fn text(&self) -> Result<String> {
        Ok(format!("{MARK}\n{}", toml::to_string(self)?))
    }
}

impl EffectTruth {
    fn new(chosen: &AssignedEffect, effects: &Effects, gripper: &CampaignGripper) -> Result<Self> {
        let kind = chosen.effect.kind;
        let mut details = details(chosen, effects, gripper)?;
        if let Some(id) = chosen.needed_by {
            details.insert("needed_by".into(), id.into());
        }
        Ok(Self {
            id: kind.id.to_owned(),
            size: chosen.effect.size,
            unit: kind.unit.to_owned(),
            meaning: kind.magnitude.meaning.to_owned(),
            each: chosen.each.clone(),
            details,
        })
    }
}

/// Drawn values of an effect other than its magnitude.
fn details(chosen: &AssignedEffect, effects: &Effects, gripper: &CampaignGripper) -> Result<Table> {
    let sensors = || gripper.sensors.iter();
    let mut table = Table::new();
    let mut insert = |key: &str, value: Result<Value, toml::ser::Error>| -> Result<()> {
        table.insert(key.to_owned(), value?);
        Ok(())
    };
    let kind = chosen.effect.kind;
    let id = kind.id;
    if !kind.is_in_catalogue {
        insert("outside_catalogue", Value::try_from(true))?;
        insert("equation", Value::try_from(kind.equation))?;
        insert("covariates", Value::try_from(kind.covariates))?;
        let laws: Vec<&Law> = sensors().filter_map(|s| s.uncatalogued.law(id)).collect();
        if !laws.is_empty() {
            insert("drawn", Value::try_from(laws))?;
        }
    } else if id == HYSTERESIS.id {
        insert("flexures", Value::try_from(chosen.effect.flexures))?;
    } else if id == CREEP.id {
        insert("time_constant_s", Value::try_from(effects.creep_s))?;
    } else if id == SOFTENING.id {
        let cycles: Vec<[u32; 2]> = sensors().map(|s| s.finger.cycles()).collect();
        insert("time_constant_cycles", Value::try_from(effects.softening_cycles))?;
        insert("cycles_in_the_end", Value::try_from(cycles))?;
    } else if id == NEIGHBOUR_MAGNET.id {
        let closed: Vec<[f64; 3]> = sensors().map(|s| s.neighbour.closed_mm.into()).collect();
        insert("closed_mm", Value::try_from(closed))?;
    } else if id == MOTOR_LEAKAGE.id {
        let rows: Vec<[[f64; 3]; 3]> = sensors().map(|s| s.leakage.transpose().into()).collect();
        insert("axes_by_alpha_beta_quadrature_g_per_a", Value::try_from(rows))?;
    } else if id == EARTH_FIELD.id {
        insert("world_g", Value::try_from(<[f64; 3]>::from(gripper.earth_g)))?;
    } else if id == SENSOR_TEMPERATURE.id {
        let drifts: Vec<[f64; 3]> = sensors().map(|s| s.element.per_kelvin_g.into()).collect();
        insert("drift_g_per_k", Value::try_from(drifts))?;
    } else if id == FIELD_DRIFT.id {
        let drifts: Vec<[f64; 3]> = sensors().map(|s| s.element.drift_g.into()).collect();
        insert("final_g", Value::try_from(drifts))?;
        insert("time_constant_s", Value::try_from(DRIFT_S))?;
    } else if id == DEMAGNETISATION.id {
        insert("loss_by_recording", Value::try_from(&gripper.losses))?;
    } else if id == EXTERNAL_MAGNET.id {
        insert("path", Value::try_from(&gripper.foreign))?;
        let count = gripper.sensors.len() as u32;
        if let Some(stretch_s) = gripper.foreign.interval_above_s(1.0, count) {
            insert("above_1_g_s", Value::try_from(stretch_s))?;
        }
    }
    Ok(table)
}

/// Default path: next to the campaign's folder, not in it.
pub fn default_path(campaign: &Path) -> Result<PathBuf> {
    let Some(name) = campaign.file_name() else {
        bail!("cannot derive a truth path from {}; give --truth PATH", campaign.display());
    };
    let mut name = OsString::from(name);
    name.push("-truth.toml");
    Ok(campaign.with_file_name(name))
}

/// Rejects a truth file inside its campaign.
pub fn check_outside(truth: &Path, campaign: &Path) -> Result<()> {
    let (truth_at, campaign_at) = (std::path::absolute(truth)?, std::path::absolute(campaign)?);
    if truth_at.starts_with(&campaign_at) {
        bail!("{} is inside the campaign's folder; choose a path outside it", truth.display());
    }
    Ok(())
}

/// Maximum magnitude of a number in a truth file: the length of a recording in seconds.
const MAX_NUMBER: f64 = 3600.0;
/// Maximum number of recordings or sensors in a truth file.
const MAX_COUNT: u32 = 100;

/// Settings in a truth file; all other values follow from them.
#[derive(Deserialize)]
struct TruthSettings {
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
    /// Absent in old files, which used the gripper's own.
    #[serde(default = "NominalDesign::magpie")]
    design: NominalDesign,
    #[serde(default = "HallScale::a31301")]
    part: HallScale,
    #[serde(default)]
    plan: Option<RecordingPlan>,
    #[serde(default)]
    effect: Vec<TruthEffect>,
    #[serde(default)]
    sensor: Vec<TruthSensor>,
}

#[derive(Deserialize)]
struct TruthSensor {
    number: u32,
    #[serde(default)]
    orientation: SensorOrientation,
    remanence_t: f64,
}

#[derive(Deserialize)]
struct TruthEffect {
    id: String,
    size: f64,
    flexures: Option<Flexures>,
    needed_by: Option<String>,
}

/// Reads the settings of a campaign from its truth file.
///
/// # Errors
/// The file cannot be read, is not a truth file, or contains an unknown effect.
pub fn read_settings(truth: &Path) -> Result<CampaignSettings> {
    let text = input::read_text(truth)?;
    if !text.starts_with(MARK) {
        bail!("{}: not the truth file of a campaign", truth.display());
    }
    let truth_settings: TruthSettings =
        toml::from_str(&text).with_context(|| truth.display().to_string())?;
    let TruthSettings { recordings, sensors, seconds, scatter, load, warmer_k, .. } =
        truth_settings;
    let TruthSettings { field_noise_g, reference_noise_n, .. } = truth_settings;
    let numbers = [seconds, scatter, load, warmer_k, field_noise_g, reference_noise_n];
    if numbers.iter().any(|number| !(-MAX_NUMBER..=MAX_NUMBER).contains(number))
        || recordings.max(sensors) > MAX_COUNT
    {
        bail!(
            "{}: a number is implausible, the limits are {MAX_NUMBER} and {MAX_COUNT} recordings or sensors; simulate the campaign again",
            truth.display()
        );
    }
    if let Some(plan) = &truth_settings.plan {
        plan.check().with_context(|| truth.display().to_string())?;
    }
    // Implicit effects are added again by the effects that need them.
    let effects = truth_settings.effect.iter().filter(|one| one.needed_by.is_none());
    let effect = |one: &TruthEffect| -> Result<Effect> {
        let effect: Effect = format!("{}={}", one.id, one.size).parse()?;
        Ok(Effect { flexures: one.flexures.unwrap_or(effect.flexures), ..effect })
    };
    let design_t = truth_settings.design.magnet.remanence_t;
    let mountings = truth_settings.sensor.iter().map(|sensor| {
        let is_reversed = sensor.remanence_t * design_t < 0.0;
        (sensor.number, SensorMounting { orientation: sensor.orientation, is_reversed })
    });
    Ok(CampaignSettings {
        seed: truth_settings.seed,
        programme: truth_settings.programme,
        recordings: truth_settings.recordings,
        seconds: truth_settings.seconds,
        sensors: truth_settings.sensors,
        mountings: mountings.collect(),
        scatter: truth_settings.scatter,
        noise: truth_settings.noise,
        harder: truth_settings.load,
        warmer_k: truth_settings.warmer_k,
        field_noise_g: truth_settings.field_noise_g,
        reference_noise_n: truth_settings.reference_noise_n,
        effects: effects.map(effect).collect::<Result<_>>()?,
        hidden: truth_settings.hidden,
        design: truth_settings.design,
        part: truth_settings.part,
        plan: truth_settings.plan,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::plan::{AttitudePattern, LoadPattern, PlanStep};
    use crate::campaign::simulate;
    use crate::mountings::Mountings;

    #[test]
    fn truth_is_written_next_to_its_campaign() {
        let path = |campaign: &str| default_path(Path::new(campaign)).unwrap();
        assert_eq!(path("out/one"), Path::new("out/one-truth.toml"));
        assert_eq!(path("one/"), Path::new("one-truth.toml"));
        assert!(default_path(Path::new("..")).is_err());
        assert!(check_outside(Path::new("out/one/truth.toml"), Path::new("out/one")).is_err());
        assert!(check_outside(&path("out/one"), Path::new("out/one")).is_ok());
    }

    #[test]
    fn settings_of_a_truth_reproduce_the_campaign() {
        let folder = tempfile::TempDir::new().unwrap();
        let effects = ["hysteresis=0.5:both", "screw_backlash", "creep=3", "bracket_lag"];
        let original = CampaignSettings {
            seed: 7,
            programme: Programme::Level,
            recordings: 1,
            seconds: 3.0,
            sensors: 2,
            mountings: Mountings::new(&["1=+y-x+z:reversed".parse().unwrap()], 2).unwrap(),
            scatter: 1.5,
            noise: NoiseKind::Ar1,
            harder: 1.25,
            warmer_k: -3.5,
            field_noise_g: 0.3,
            reference_noise_n: 0.1,
            effects: effects.iter().map(|text| text.parse().unwrap()).collect(),
            hidden: true,
            design: NominalDesign { force_range_n: Some(90.0), ..NominalDesign::magpie() },
            part: HallScale { gauss_per_lsb: 0.25, range_gauss: 4000.0 },
            plan: Some(
                RecordingPlan::new(vec![PlanStep {
                    seconds: 4.0,
                    load: LoadPattern::Cycles,
                    load_n: [80.0, 60.0],
                    opening_mm: [10.0, 30.0],
                    temperature_k: 2.0,
                    attitude: AttitudePattern::Turning,
                }])
                .repeated(2),
            ),
        };
        let truth = simulate(&original, &folder.path().join("then"), || ()).unwrap();
        let path = folder.path().join("truth.toml");
        std::fs::write(&path, truth.text().unwrap()).unwrap();
        let again = simulate(&read_settings(&path).unwrap(), &folder.path().join("again"), || ());
        assert_eq!(again.unwrap().text().unwrap(), truth.text().unwrap());
        for recording in ["1", "2", "3"] {
            let of = |campaign: &str| {
                let file = folder.path().join(campaign).join(recording).join("hall.csv.gz");
                std::fs::read(file).unwrap()
            };
            assert_eq!(of("then"), of("again"));
        }
        let text: Table = truth.text().unwrap().parse().unwrap();
        let of = |id: &str| {
            let mut effects = text["effect"].as_array().unwrap().iter();
            effects.find(|effect| effect["id"].as_str() == Some(id)).unwrap().as_table().unwrap()
        };
        let outside = of("bracket_lag");
        assert_eq!(outside["covariates"], Value::from(vec!["temp_c"]));
        assert_eq!(outside["drawn"].as_array().unwrap().len(), 2);
        assert!((3.0..8.0).contains(&outside["drawn"][0]["tau_s"].as_float().unwrap()));
        assert!(!of("creep").contains_key("covariates"));
    }
}

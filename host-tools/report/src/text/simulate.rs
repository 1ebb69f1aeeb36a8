//! Text and JSON of a simulated campaign.

use std::path::Path;

use analysis::numbers;
use serde::Serialize;
use serde_json::{Value, json};
use sim::campaign::plan::RecordingPlan;
use sim::campaign::settings::CampaignSettings;
use sim::campaign::truth::Truth;

use crate::text::terminal;

/// Table of the effects, unless they are random.
fn effect_table(settings: &CampaignSettings, truth: &Truth) -> String {
    if settings.hidden {
        let count = settings.effects.len();
        return format!("Random effects: {count}.\n");
    }
    if truth.effect.is_empty() {
        return "No effects besides the magnet on two flexures.\n".to_owned();
    }
    let mut table = terminal::table(["effect", "unit", "magnitude"]);
    for effect in &truth.effect {
        table.add_row([effect.id.clone(), effect.unit.clone(), numbers::decimal(effect.size, 6)]);
    }
    terminal::right_align(&mut table, 2);
    format!("{table}\n")
}

pub fn format_report(
    settings: &CampaignSettings,
    truth: &Truth,
    campaign: &Path,
    truth_path: &Path,
) -> String {
    format!(
        "Simulated: {} recordings of {} s, {}{} sensors, programme {}, noise {}, seed {}.\n{}\
         Written to {}; true parameters in {}.\n\
         Next: cargo magpie fit {:?} -o model.toml\n",
        settings.recordings,
        numbers::decimal(settings.seconds, 3),
        settings.plan.as_ref().map_or_else(String::new, |plan| format!(
            "{} of {} s by the plan, ",
            plan.recordings,
            numbers::decimal(plan.seconds(), 3)
        )),
        settings.sensors,
        value_name(&settings.programme),
        value_name(&settings.noise),
        settings.seed,
        effect_table(settings, truth),
        campaign.display(),
        truth_path.display(),
        campaign,
    )
}

pub fn to_json(
    settings: &CampaignSettings,
    truth: &Truth,
    campaign: &Path,
    truth_path: &Path,
) -> Value {
    let effects = truth
        .effect
        .iter()
        .map(|effect| json!({ "id": effect.id, "size": effect.size, "unit": effect.unit }));
    let effects: Option<Vec<Value>> = (!settings.hidden).then(|| effects.collect());
    json!({
        "campaign": campaign,
        "truth": truth_path,
        "seed": settings.seed,
        "programme": settings.programme,
        "noise": settings.noise,
        "recordings": settings.recordings,
        "seconds": settings.seconds,
        "planned_recordings": settings.plan.as_ref().map(|plan| plan.recordings),
        "planned_seconds": settings.plan.as_ref().map(RecordingPlan::seconds),
        "sensors": settings.sensors,
        "hidden": settings.hidden.then_some(settings.effects.len()),
        "effects": effects,
    })
}

/// The name of a value in files and on the command line.
fn value_name(value: &impl Serialize) -> String {
    json!(value).as_str().unwrap_or_default().to_owned()
}

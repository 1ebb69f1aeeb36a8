//! Text and JSON of the catalogue of effects.

use analysis::numbers;
use model_export::effects::{
    CATALOGUE, DeviceForm, Effect, EffectParameter, ParameterKind, ParameterScope,
};
use model_export::inverse::compensation::board_conditions;
use serde_json::{Value, json};

use crate::text::terminal;

pub fn catalogue_table() -> String {
    let mut table = terminal::table(["effect", "typical", "magnitude", "requires", "compensated"]);
    for effect in CATALOGUE {
        table.add_row([
            effect.id.to_owned(),
            format!("{} {}", numbers::decimal(effect.size.typical, 3), effect.size.unit),
            effect.size.description.to_owned(),
            if effect.needs.is_empty() { "-".to_owned() } else { effect.needs.join(", ") },
            effect.device.label().to_owned(),
        ]);
    }
    let legend = terminal::paragraph(
        "compensated: tables, by the tables of the ideal model; device, by a compensation on the device; settled, the tables \
         hold the state at the end of the campaign; bench, an error of the test bench, which the device does not have; no, the error stays.",
    );
    format!(
        "{table}\n{legend}`cargo magpie effects NAME` describes one; `cargo magpie add MODEL CAMPAIGN NAME` adds it to a model.\n"
    )
}

/// How the device compensates an effect, in one sentence.
fn compensation(effect: &Effect) -> String {
    match effect.device {
        DeviceForm::Field(_) | DeviceForm::Force(_) => {
            match board_conditions(effect.needs).as_slice() {
                [] => "on the device, by its own compensation.".to_owned(),
                conditions => {
                    format!("on the device, by its own compensation: {}.", conditions.join("; "))
                }
            }
        }
        DeviceForm::Tables => "on the device, by the tables of the ideal model.".to_owned(),
        DeviceForm::Settled => {
            "not over time; the device's tables hold the state at the end of the campaign."
                .to_owned()
        }
        DeviceForm::Bench { remedy, .. } => {
            format!("not needed on the device: it is an error of the test bench; {remedy}.")
        }
        DeviceForm::Never(why) => format!("not on the device: {why}."),
    }
}

pub fn describe(effect: &Effect) -> String {
    let mut parameters = terminal::table(["parameter", "unit", "description"]);
    for parameter in effect.parameters {
        let mut description = match &parameter.kind {
            ParameterKind::Coefficient => {
                format!("coefficient, typically {}", numbers::decimal(parameter.typical, 3))
            }
            ParameterKind::Shape { grid } => {
                format!("searched from {} to {}", grid[0], grid[grid.len() - 1])
            }
            ParameterKind::InitialState => "initial state".to_owned(),
            ParameterKind::Instant => "instant, searched over the campaign".to_owned(),
        };
        if parameter.shared {
            description += ", the same for all sensors";
        }
        description += match parameter.scope {
            ParameterScope::Campaign => "",
            ParameterScope::EachRecording => ", one for each recording",
            ParameterScope::EachLaterRecording => ", one for each recording but the first",
        };
        parameters.add_row([parameter.name.to_string(), parameter.unit.to_string(), description]);
    }
    let (low, high) = effect.size.plausible;
    let needs = match effect.needs {
        [] => "field and force".to_owned(),
        needs => needs.join(", "),
    };
    let outside = Some(effect.similar_outside).filter(|outside| !outside.is_empty());
    let confused: String = effect
        .confused_with
        .iter()
        .map(|(id, when)| format!("  {id}: {when}"))
        .chain(outside.map(|outside| format!("  {outside}, which is no effect of the catalogue")))
        .map(|line| terminal::paragraph(&line))
        .collect();
    format!(
        "{}\n\n{}\n  {}\n\nRegressors: {}.\nRequires: {needs}.\n\n{parameters}\nMagnitude: {}, typically {} {unit}, plausibly {} to {} {unit}.\n\n\
         {}\nConfused with\n{confused}\n{}",
        effect.id,
        terminal::paragraph(effect.physics),
        effect.equation,
        effect.regressors,
        effect.size.description,
        numbers::decimal(effect.size.typical, 3),
        numbers::decimal(low, 3),
        numbers::decimal(high, 3),
        terminal::paragraph(&format!("To identify it: {}", effect.record)),
        terminal::paragraph(&format!("Compensated: {}", compensation(effect))),
        unit = effect.size.unit,
    )
}

pub fn to_json(effect: &Effect) -> Value {
    let parameter = |parameter: &EffectParameter| {
        json!({
            "name": parameter.name, "unit": parameter.unit, "coefficient": parameter.is_coefficient(),
            "typical": parameter.typical, "shared": parameter.shared,
        })
    };
    json!({
        "effect": effect.id, "physics": effect.physics, "equation": effect.equation, "regressors": effect.regressors,
        "needs": effect.needs, "parameters": effect.parameters.iter().map(parameter).collect::<Vec<_>>(),
        "size": { "means": effect.size.description, "unit": effect.size.unit, "typical": effect.size.typical, "plausible": effect.size.plausible },
        "record": effect.record, "confused_with": effect.confused_with.iter().map(|(id, _)| id).collect::<Vec<_>>(),
        "similar_outside": effect.similar_outside, "compensated": compensation(effect),
    })
}

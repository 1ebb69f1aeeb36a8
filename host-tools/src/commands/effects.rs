//! `magpie effects`: the catalogue, for reading.

use anyhow::Result;
use model_export::effects::{CATALOGUE, Effect, Kind, Of, Undone, find};
use serde_json::{Value, json};

use crate::show;

/// List the physical effects that the tool knows, or explain one.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie effects
  cargo magpie effects hysteresis")]
pub struct Args {
    /// The effect to explain; without it all are listed.
    effect: Option<String>,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let text = match (&args.effect, args.json) {
        (Some(name), false) => explain(find(name)?),
        (Some(name), true) => format!("{}\n", json(find(name)?)),
        (None, false) => list(),
        (None, true) => format!("{}\n", json!({ "effects": CATALOGUE.map(json) })),
    };
    show::page(&text)?;
    Ok(())
}

fn list() -> String {
    let mut table = show::table(["effect", "typical", "size is", "needs", "undone"]);
    for effect in CATALOGUE {
        table.add_row([
            effect.id.to_owned(),
            format!(
                "{} {}",
                show::plain(effect.size.typical, 3),
                effect.size.unit
            ),
            effect.size.words.to_owned(),
            if effect.needs.is_empty() {
                "-".to_owned()
            } else {
                effect.needs.join(", ")
            },
            undone(effect).0.to_owned(),
        ]);
    }
    format!(
        "{table}\n`magpie effects NAME` explains one; `magpie add MODEL CAMPAIGN NAME` adds it to a model.\n"
    )
}

/// In a word, and in a sentence.
fn undone(effect: &Effect) -> (&'static str, String) {
    match effect.undone {
        Undone::Compensation => (
            "device",
            "on the device, by a compensation of its own.".to_owned(),
        ),
        Undone::Tables => (
            "tables",
            "on the device, within the tables of the ideal model.".to_owned(),
        ),
        Undone::Settled => (
            "settled",
            "not step by step; the device's tables are those of the gripper as it is in the end."
                .to_owned(),
        ),
        Undone::Never(why) => ("no", format!("not on the device: {why}.")),
    }
}

fn explain(effect: &Effect) -> String {
    let mut parameters = show::table(["parameter", "unit", "what"]);
    for parameter in effect.parameters {
        let mut what = match &parameter.kind {
            Kind::Coefficient => format!(
                "coefficient, typically {}",
                show::plain(parameter.typical, 3)
            ),
            Kind::Shape { grid } => {
                format!("searched from {} to {}", grid[0], grid[grid.len() - 1])
            }
            Kind::Beginning => "where its memory begins".to_owned(),
            Kind::Instant => "searched over the campaign".to_owned(),
        };
        if parameter.shared {
            what += ", the same for all sensors";
        }
        what += match parameter.of {
            Of::Campaign => "",
            Of::EachRecording => ", one for each recording",
            Of::EachLaterRecording => ", one for each recording but the first",
        };
        parameters.add_row([parameter.name.to_string(), parameter.unit.to_string(), what]);
    }
    let (low, high) = effect.size.plausible;
    let needs = match effect.needs {
        [] => "field and force".to_owned(),
        needs => needs.join(", "),
    };
    let confused: String = effect
        .confused_with
        .iter()
        .map(|(id, when)| show::paragraph(&format!("  {id}: {when}")))
        .collect();
    format!(
        "{}\n\n{}\n  {}\n\nShows as: {}.\nNeeds: {needs}.\n\n{parameters}\nSize: {}, typically {} {unit}, plausibly {} to {} {unit}.\n\n\
         {}\nConfused with\n{confused}\n{}",
        effect.id,
        show::paragraph(effect.physics),
        effect.equation,
        effect.regressors,
        effect.size.words,
        show::plain(effect.size.typical, 3),
        show::plain(low, 3),
        show::plain(high, 3),
        show::paragraph(&format!("To judge it: {}", effect.record)),
        show::paragraph(&format!("Undone: {}", undone(effect).1)),
        unit = effect.size.unit,
    )
}

fn json(effect: &Effect) -> Value {
    let parameter = |parameter: &model_export::effects::Parameter| {
        json!({
            "name": parameter.name, "unit": parameter.unit, "coefficient": parameter.is_coefficient(),
            "typical": parameter.typical, "shared": parameter.shared,
        })
    };
    json!({
        "effect": effect.id, "physics": effect.physics, "equation": effect.equation, "regressors": effect.regressors,
        "needs": effect.needs, "parameters": effect.parameters.iter().map(parameter).collect::<Vec<_>>(),
        "size": { "means": effect.size.words, "unit": effect.size.unit, "typical": effect.size.typical, "plausible": effect.size.plausible },
        "record": effect.record, "confused_with": effect.confused_with.iter().map(|(id, _)| id).collect::<Vec<_>>(),
        "undone": undone(effect).1,
    })
}

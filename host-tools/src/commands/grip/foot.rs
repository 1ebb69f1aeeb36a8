//! A landing: the ground's force as it is and as it is told, and where it pushes.

use anyhow::{Result, bail};
use serde_json::{Value, json};

use super::{Args, assumed_json, ends, figures_json};
use crate::drive::landing::{Landed, Landing};
use crate::drive::runs::Case;
use crate::report::{self, grasp as page};
use crate::show;

/// Forces in N and times in ms that are landings.
const FORCES_N: std::ops::RangeInclusive<f64> = 20.0..=1000.0;
const TIMES_MS: std::ops::RangeInclusive<f64> = 1.0..=200.0;
/// Where the ground pushes, in mm along the fingers from their middle.
const ALONG_MM: f64 = 12.0;
/// The touch falls so far into a millisecond.
const PHASE: f64 = 0.3;

pub(super) fn run(args: &Args, case: Case, peak_n: f64) -> Result<()> {
    for (option, value, range) in [
        ("--foot", peak_n, FORCES_N),
        ("--lasts", args.lasts, TIMES_MS),
    ] {
        if !range.contains(&value) {
            let (least, most) = (range.start(), range.end());
            bail!("{option} {value} is not possible here; give {least} to {most}");
        }
    }
    let landing = Landing {
        peak_n,
        lasts_s: 1e-3 * args.lasts,
        along_mm: ALONG_MM,
        phase: PHASE,
    };
    let landed = landing.run(&case);
    if let Some(path) = &args.output {
        report::write_sections(path, &page::landing_title(&landed), &page::landing(&landed))?;
    }
    let page = match args.json {
        true => format!("{}\n", json_of(args, &landed)),
        false => text(args, &landed),
    };
    show::page(&page)?;
    Ok(())
}

fn text(args: &Args, landed: &Landed) -> String {
    let mut table = show::table(["figure", "told", "true", "unit"]);
    for (name, [told, is], unit) in landed.figures() {
        let cell = |value: f64| match value.is_finite() {
            true => show::plain(value, 2),
            false => "-".to_owned(),
        };
        table.add_row([name.to_owned(), cell(told), cell(is), unit.to_owned()]);
    }
    show::right_align(&mut table, 1);
    let mut page = show::paragraph(&landed.sentence());
    page += &format!("{table}\n");
    page += &ends(args, &landed.assumed());
    page
}

fn json_of(args: &Args, landed: &Landed) -> Value {
    let points = landed.points.iter().map(|point| {
        json!({
            "time_s": point.time_s,
            "true_n": point.true_n,
            "told_n": point.told_n,
            "peak_n": point.held_n,
            "along_mm": point.along_mm,
            "contacts": point.contacts,
        })
    });
    let told: Vec<_> = landed
        .figures()
        .into_iter()
        .map(|(name, [told, _], unit)| (name, told, unit))
        .collect();
    json!({
        "simulated": true,
        "screw": format!("{:?}", landed.case.lead).to_lowercase(),
        "seed": args.seed,
        "force_n": landed.landing.peak_n,
        "lasts_ms": args.lasts,
        "report": args.output,
        "figures": figures_json(&told),
        "points": points.collect::<Vec<_>>(),
        "assumed": assumed_json(&landed.assumed()),
    })
}

//! Text and JSON of simulated motions, grasps and landings.

use std::path::Path;

use analysis::numbers;
use firmware::config::constants::Constant;
use serde_json::{Value, json};
use sim::closed_loop::drive_result::DriveResult;
use sim::closed_loop::grasp_result::{GraspResult, GraspSample, GraspTrace};
use sim::closed_loop::landing::LandingResult;

use crate::text::terminal::{self, TextTable};

/// A motion as text; `report` is the path of the HTML report.
pub fn format_motion(result: &DriveResult, report: Option<&Path>) -> String {
    page(&result.sentence(), &[motion_table(result)], &result.assumed(), report)
}

pub fn motion_table(result: &DriveResult) -> TextTable {
    let rows = result.figures().into_iter();
    let rows = rows.map(|(name, value, unit)| {
        [name, &numbers::decimal_or_dash(value, 3), unit].map(str::to_owned)
    });
    TextTable::new(&["quantity", "value", "unit"], 1, rows)
}

/// A sentence, tables, and the footer.
fn page(
    sentence: &str,
    tables: &[TextTable],
    assumed: &[Constant],
    report: Option<&Path>,
) -> String {
    let tables = tables.iter().map(|table| format!("{table}\n"));
    terminal::paragraph(sentence) + &tables.collect::<String>() + &footer(assumed, report)
}

/// Footer of every report: assumed constants, path of the HTML report.
fn footer(assumed: &[Constant], report: Option<&Path>) -> String {
    let assumed: Vec<String> = assumed
        .iter()
        .map(|constant| {
            let value = numbers::decimal(constant.value, 6);
            format!("{} {value} {}", constant.name, constant.unit).trim_end().to_owned()
        })
        .collect();
    let mut page = terminal::paragraph(&format!("Simulated. Assumed: {}.", assumed.join(", ")));
    page += &terminal::report_line(report);
    page
}

fn assumed_json(assumed: &[Constant]) -> Vec<Value> {
    let json = |constant: &Constant| json!({ "name": constant.name, "value": constant.value, "unit": constant.unit });
    assumed.iter().map(json).collect()
}

fn figures_json(figures: &[(&'static str, f64, &'static str)]) -> Vec<Value> {
    let json = |(name, value, unit): &(&str, f64, &str)| json!({ "name": name, "value": value, "unit": unit });
    figures.iter().map(json).collect()
}

/// The object of `--json` of a motion from `from_mm` with parameters perturbed by up to `scatter`.
pub fn motion_json(
    result: &DriveResult,
    from_mm: f64,
    scatter: f64,
    report: Option<&Path>,
) -> Value {
    let points = result.run.points.iter().step_by(20).map(|point| {
        json!({
            "time_s": point.time_s,
            "opening_mm": point.opening_mm,
            "asked_mm": point.setpoint_mm,
            "closing_mm_s": point.closing_mm_s,
            "current_d_a": point.current_a[0],
            "current_q_a": point.current_a[1],
            "voltage_d_v": point.voltage_v[0],
            "voltage_q_v": point.voltage_v[1],
            "bus_v": point.bus_v,
        })
    });
    json!({
        "simulated": true,
        "screw": format!("{:?}", result.case.lead).to_lowercase(),
        "seed": result.case.seed,
        "scatter": scatter,
        "from_mm": from_mm,
        "report": report,
        "figures": figures_json(&result.figures()),
        "points": points.collect::<Vec<_>>(),
        "current_step": result.step.points,
        "current_sweep": result.sweep,
        "assumed": assumed_json(&result.assumed()),
    })
}

/// A grasp as text; `report` is the path of the HTML report.
pub fn format_grasp(result: &GraspResult, report: Option<&Path>) -> String {
    page(&result.sentence(), &grasp_tables(result), &result.assumed(), report)
}

/// The results of a grasp, next to those of a current limit, and the states of the firmware.
pub fn grasp_tables(result: &GraspResult) -> [TextTable; 2] {
    let mut heads = vec!["quantity", "value", "unit"];
    heads.extend(result.other.as_ref().map(|_| "current limit"));
    let other = result.other.as_ref().map(GraspResult::figures);
    let rows = GraspResult::figures(&result.own).into_iter().enumerate();
    let rows = rows.map(|(index, (name, value, unit))| {
        let other = other.as_ref().and_then(|other| other.get(index));
        let other = other.map(|(_, value, _)| numbers::decimal_or_dash(*value, 2));
        let own = [name.to_owned(), numbers::decimal_or_dash(value, 2), unit.to_owned()];
        own.into_iter().chain(other).collect::<Vec<_>>()
    });
    let states = result.states().into_iter();
    let states = states.map(|(time_s, state)| [state, numbers::decimal(1e3 * time_s, 0)]);
    [TextTable::new(&heads, 1, rows), TextTable::new(&["state", "from, ms"], 1, states)]
}

/// The object of `--json` of a grasp with parameters perturbed by up to `scatter`.
pub fn grasp_json(result: &GraspResult, scatter: f64, report: Option<&Path>) -> Value {
    let points = |course: &GraspTrace| {
        let json = |point: &GraspSample| {
            json!({
                "time_s": point.time_s,
                "set_n": point.set_n,
                "estimated_n": point.estimated_n,
                "true_n": point.true_n,
                "opening_mm": point.opening_mm,
                "current_q_a": point.current_a,
                "state": point.state.map(GraspResult::state_name),
            })
        };
        course.points.iter().map(json).collect::<Vec<_>>()
    };
    let current_limit = result.other.as_ref().map(|other| {
        json!({ "figures": figures_json(&GraspResult::figures(other)), "points": points(other) })
    });
    json!({
        "simulated": true,
        "screw": format!("{:?}", result.case.lead).to_lowercase(),
        "seed": result.case.seed,
        "scatter": scatter,
        "force_n": result.own.target.set_n,
        "contact_n_per_mm": result.own.target.contact_n_per_mm,
        "report": report,
        "figures": figures_json(&GraspResult::figures(&result.own)),
        "points": points(&result.own),
        "current_limit": current_limit,
        "assumed": assumed_json(&result.assumed()),
    })
}

/// A landing as text; `report` is the path of the HTML report.
pub fn format_landing(result: &LandingResult, report: Option<&Path>) -> String {
    page(&result.sentence(), &[landing_table(result)], &result.assumed(), report)
}

pub fn landing_table(result: &LandingResult) -> TextTable {
    let rows = result.figures().into_iter().map(|(name, values, unit)| {
        let [estimate, truth] = values.map(|value| numbers::decimal_or_dash(value, 2));
        [name.to_owned(), estimate, truth, unit.to_owned()]
    });
    TextTable::new(&["quantity", "estimated", "true", "unit"], 1, rows)
}

/// The object of `--json` of a landing that lasts `lasts_ms`.
pub fn landing_json(result: &LandingResult, lasts_ms: f64, report: Option<&Path>) -> Value {
    let estimates: Vec<_> = result
        .figures()
        .into_iter()
        .map(|(name, [estimate, _], unit)| (name, estimate, unit))
        .collect();
    json!({
        "simulated": true,
        "screw": format!("{:?}", result.case.lead).to_lowercase(),
        "seed": result.case.seed,
        "force_n": result.landing.peak_n,
        "lasts_ms": lasts_ms,
        "report": report,
        "figures": figures_json(&estimates),
        "points": result.points,
        "assumed": assumed_json(&result.assumed()),
    })
}

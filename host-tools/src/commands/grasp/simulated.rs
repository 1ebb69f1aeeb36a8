//! Simulated grasps and landings.

use analysis::numbers;
use analysis::progress;
use anyhow::{Result, bail};
use firmware::grip::commands::GripProfile;
use serde_json::{Value, json};

use crate::commands::grasp::{
    Args, ObjectStiffness, OtherController, assumed_json, figures_json, footer,
};
use report::html::grasp as page;
use report::text::terminal;
use sim::closed_loop::grasp_result::{
    GraspResult, GraspSample, GraspTarget, GraspTrace, run_current_limited, run_grasp,
};
use sim::closed_loop::landing::{Landing, LandingResult};
use sim::closed_loop::motor_rig::DriveCase;

/// Hold time in seconds.
const HOLD_S: f64 = 0.5;
/// Minimum grasp force in N.
const MIN_FORCE_N: f64 = 5.0;
/// Initial distance to the object in mm.
const APPROACH_MM: f64 = 2.0;
/// The same for the current-limited grasp, which accelerates to full speed.
const CURRENT_LIMITED_APPROACH_MM: f64 = 15.0;

impl ObjectStiffness {
    /// Contact stiffness in N/mm.
    fn contact_n_per_mm(self) -> f64 {
        match self {
            Self::Rigid => 333.0,
            Self::Medium => 50.0,
            Self::Soft => 5.0,
        }
    }
}

/// Checks the range of a grasp force.
pub(super) fn check_force(set_n: f64) -> Result<()> {
    let max_n = f64::from(GripProfile::Strong.max_n());
    if !(MIN_FORCE_N..=max_n).contains(&set_n) {
        bail!("--force {set_n} is not possible here; give {MIN_FORCE_N} to {max_n} N");
    }
    Ok(())
}

pub(super) fn grasp(args: &Args, case: DriveCase, set_n: f64) -> Result<()> {
    check_force(set_n)?;
    let spec = grasp_spec(args, set_n)?;
    let bar =
        progress::progress_bar("simulating the grasp", 1 + usize::from(args.compare.is_some()));
    let own = run_grasp(case.lead, case.parameters, spec, case.seed);
    bar.inc(1);
    let other = args.compare.map(|OtherController::CurrentLimit| {
        let spec = GraspTarget { from_mm: CURRENT_LIMITED_APPROACH_MM, ..spec };
        run_current_limited(case.lead, case.parameters, spec, case.seed)
    });
    bar.finish_and_clear();
    let result = GraspResult { case, own, other };
    if let Some(path) = &args.output {
        report::html::write_sections(path, &page::title(&result), &page::sections(&result))?;
    }
    terminal::print_result(args.json, || grasp_json(args, &result), || grasp_report(args, &result))
}

fn grasp_spec(args: &Args, set_n: f64) -> Result<GraspTarget> {
    let contact_n_per_mm = args.object.contact_n_per_mm();
    let spec =
        GraspTarget { from_mm: APPROACH_MM, ..GraspTarget::new(contact_n_per_mm, set_n, HOLD_S) };
    if spec.is_possible() {
        Ok(spec)
    } else {
        bail!(
            "--force {set_n} compresses the object by {} mm, more than the finger opening; reduce it",
            numbers::decimal(set_n / contact_n_per_mm, 0)
        )
    }
}

fn grasp_report(args: &Args, result: &GraspResult) -> String {
    let mut headers = vec!["quantity", "value", "unit"];
    headers.extend(result.other.as_ref().map(|_| "current limit"));
    let mut table = terminal::table(headers);
    let other = result.other.as_ref().map(GraspResult::figures);
    for (index, (name, value, unit)) in GraspResult::figures(&result.own).into_iter().enumerate() {
        let mut row = vec![name.to_owned(), numbers::decimal(value, 2), unit.to_owned()];
        let other = other.as_ref().and_then(|other| other.get(index));
        row.extend(other.map(|(_, value, _)| numbers::decimal_or_dash(*value, 2)));
        table.add_row(row);
    }
    terminal::right_align(&mut table, 1);
    let mut states = terminal::table(["from, ms", "state"]);
    for (time_s, state) in result.states() {
        states.add_row([numbers::decimal(1e3 * time_s, 0), state]);
    }
    let mut page = terminal::paragraph(&result.sentence());
    page += &format!("{table}\n{states}\n");
    page += &footer(args, &result.assumed());
    page
}

fn grasp_json(args: &Args, result: &GraspResult) -> Value {
    let points = |course: &GraspTrace| {
        let json = |point: &GraspSample| {
            json!({
                "time_s": point.time_s,
                "set_n": point.set_n,
                "told_n": point.estimated_n,
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
        "seed": args.seed,
        "scatter": args.scatter,
        "force_n": result.own.target.set_n,
        "contact_n_per_mm": result.own.target.contact_n_per_mm,
        "report": args.output,
        "figures": figures_json(&GraspResult::figures(&result.own)),
        "points": points(&result.own),
        "current_limit": current_limit,
        "assumed": assumed_json(&result.assumed()),
    })
}

/// Ranges of the peak ground force in N and of the contact duration in ms.
const GROUND_FORCE_N: std::ops::RangeInclusive<f64> = 20.0..=1000.0;
const CONTACT_MS: std::ops::RangeInclusive<f64> = 1.0..=200.0;
/// Centre of ground contact in mm along the fingers from their centre.
const CONTACT_POINT_MM: f64 = 12.0;
/// Phase of the contact within a control period.
const PHASE: f64 = 0.3;

pub(super) fn run_landing(args: &Args, case: DriveCase, peak_n: f64) -> Result<()> {
    for (option, value, range) in
        [("--foot", peak_n, GROUND_FORCE_N), ("--lasts", args.lasts, CONTACT_MS)]
    {
        if !range.contains(&value) {
            let (min, max) = (range.start(), range.end());
            bail!("{option} {value} is not possible here; give {min} to {max}");
        }
    }
    let landing =
        Landing { peak_n, lasts_s: 1e-3 * args.lasts, along_mm: CONTACT_POINT_MM, phase: PHASE };
    let result = landing.run(&case);
    if let Some(path) = &args.output {
        report::html::write_sections(path, &page::landing_title(&result), &page::landing(&result))?;
    }
    terminal::print_result(
        args.json,
        || landing_json(args, &result),
        || landing_report(args, &result),
    )
}

fn landing_report(args: &Args, result: &LandingResult) -> String {
    let mut table = terminal::table(["quantity", "estimated", "true", "unit"]);
    for (name, [estimate, truth], unit) in result.figures() {
        table.add_row([
            name.to_owned(),
            numbers::decimal_or_dash(estimate, 2),
            numbers::decimal_or_dash(truth, 2),
            unit.to_owned(),
        ]);
    }
    terminal::right_align(&mut table, 1);
    let mut page = terminal::paragraph(&result.sentence());
    page += &format!("{table}\n");
    page += &footer(args, &result.assumed());
    page
}

fn landing_json(args: &Args, result: &LandingResult) -> Value {
    let points = result.points.iter().map(|point| {
        json!({
            "time_s": point.time_s,
            "true_n": point.true_n,
            "told_n": point.estimated_n,
            "peak_n": point.held_n,
            "along_mm": point.along_mm,
            "contacts": point.contacts,
        })
    });
    let estimates: Vec<_> = result
        .figures()
        .into_iter()
        .map(|(name, [estimate, _], unit)| (name, estimate, unit))
        .collect();
    json!({
        "simulated": true,
        "screw": format!("{:?}", result.case.lead).to_lowercase(),
        "seed": args.seed,
        "force_n": result.landing.peak_n,
        "lasts_ms": args.lasts,
        "report": args.output,
        "figures": figures_json(&estimates),
        "points": points.collect::<Vec<_>>(),
        "assumed": assumed_json(&result.assumed()),
    })
}

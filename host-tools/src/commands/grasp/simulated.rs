//! Simulated grasps and landings.

use analysis::numbers;
use analysis::progress;
use anyhow::{Result, bail};
use device::control::check_force;

use crate::commands::grasp::args::{Args, OtherController};
use report::html::grasp as page;
use report::text::grasp::{format_grasp, format_landing, grasp_json, landing_json};
use report::text::terminal;
use sim::closed_loop::grasp_result::{GraspResult, GraspTarget, run_current_limited, run_grasp};
use sim::closed_loop::landing::{FootContact, Landing};
use sim::closed_loop::motor_rig::DriveCase;

/// Hold time in seconds.
const HOLD_S: f64 = 0.5;
/// Initial distance to the object in mm.
const APPROACH_MM: f64 = 2.0;
/// The same for the current-limited grasp, which accelerates to full speed.
const CURRENT_LIMITED_APPROACH_MM: f64 = 15.0;

pub(super) fn grasp(args: &Args, case: DriveCase, set_n: f64) -> Result<()> {
    check_force(set_n)?;
    let spec = grasp_spec(args, set_n)?;
    let output = args.page(&(case, spec, args.compare))?;
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
    if let Some(output) = &output {
        report::html::write_sections(output, &page::title(&result), &page::sections(&result))?;
    }
    let report = args.output.as_deref();
    terminal::print_result(
        args.json,
        || grasp_json(&result, args.scatter, report),
        || format_grasp(&result, report),
    )
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

/// Ranges of the peak ground force in N and of the contact duration in ms.
const GROUND_FORCE_N: std::ops::RangeInclusive<f64> = 20.0..=1000.0;
const CONTACT_MS: std::ops::RangeInclusive<f64> = 1.0..=200.0;
/// Centre of ground contact in mm along the fingers from their centre.
const CONTACT_POINT_MM: f64 = 12.0;
/// The same across open fingers.
const ACROSS_MM: f64 = 6.0;
/// Phase of the contact within a control period.
const PHASE: f64 = 0.3;

pub(super) fn run_landing(args: &Args, case: DriveCase, peak_n: f64) -> Result<()> {
    for (option, value, range) in
        [("--foot", peak_n, GROUND_FORCE_N), ("--lasts", args.lasts, CONTACT_MS)]
    {
        if !range.contains(&value) {
            let (min, max) = (range.start(), range.end());
            bail!("{option} {value:?} is not possible here; give {min} to {max}");
        }
    }
    let landing = Landing {
        peak_n,
        lasts_s: 1e-3 * args.lasts,
        contact: args.contact,
        along_mm: CONTACT_POINT_MM,
        across_mm: if args.contact == FootContact::Line { ACROSS_MM } else { 0.0 },
        phase: PHASE,
    };
    let output = args.page(&(case, landing))?;
    let result = landing.run(&case);
    if let Some(output) = &output {
        report::html::write_sections(
            output,
            &page::landing_title(&result),
            &page::landing(&result),
        )?;
    }
    let report = args.output.as_deref();
    terminal::print_result(
        args.json,
        || landing_json(&result, args.lasts, report),
        || format_landing(&result, report),
    )
}

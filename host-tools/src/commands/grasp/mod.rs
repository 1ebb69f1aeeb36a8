//! `magpie grasp`: motions, grasps and landings of a simulated, emulated or real gripper.
//!
//! - `args`: the arguments.
//! - here: simulated position and speed commands.
//! - `simulated`: simulated grasps and landings.
//! - `hardware`: commands to a gripper on a serial line or CAN bus.

mod args;
mod hardware;
mod simulated;

use analysis::progress;

use anyhow::{Result, bail};
use firmware::config::constants;

pub use args::Args;
use device::control::{MARGIN_MM, check_opening};
use report::html::drive;
use report::text::grasp::{format_motion, motion_json};
use report::text::terminal;
use sim::closed_loop::drive_result::{DriveResult, DriveTarget};
use sim::closed_loop::motor_rig::DriveCase;
use sim::drivetrain::parameters::Lead;

/// Maximum duration of a speed command in seconds.
const MAX_SPEED_RUN_S: f64 = 0.5;
/// Maximum duration of a position command in seconds.
const MAX_MOTION_S: f64 = 15.0;
/// Maximum perturbation.
const MAX_SCATTER: f64 = 0.5;

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    if args.port.is_given() {
        return hardware::run(args);
    }
    let lead = args.screw;
    let case = match args.scatter {
        0.0 => DriveCase::nominal(lead, args.seed),
        fraction if fraction > 0.0 && fraction <= MAX_SCATTER => {
            DriveCase::scattered(lead, fraction, args.seed)
        }
        fraction => bail!("--scatter {fraction:?} is not possible here; give 0 to {MAX_SCATTER}"),
    };
    if args.force.is_some() && args.speed.is_some() {
        bail!("--speed of a grasp is possible with --port or --can only");
    }
    if let Some(set_n) = args.force {
        return simulated::grasp(args, case, set_n);
    }
    if let Some(peak_n) = args.foot {
        let Some(peak_n) = peak_n else {
            bail!("--foot requires the peak ground force in newtons, as in --foot 150");
        };
        return simulated::run_landing(args, case, peak_n);
    }
    let setpoint = setpoint(args, lead)?;
    let page = args.page(&(case, args.from, setpoint))?;
    let bar = progress::progress_bar("simulating the drive", DriveResult::PARTS);
    let result = DriveResult::of(case, args.from, setpoint, || bar.inc(1));
    bar.finish_and_clear();
    if let Some(page) = &page {
        report::html::write_sections(page, &drive::title(&result), &drive::sections(&result))?;
    }
    let report = args.output.as_deref();
    terminal::print_result(
        args.json,
        || motion_json(&result, args.from, args.scatter, report),
        || format_motion(&result, report),
    )
}

/// The set-point, checked against the limits of the drive.
fn setpoint(args: &Args, lead: Lead) -> Result<DriveTarget> {
    check_opening("--from", args.from, MARGIN_MM)?;
    if let Some(opening_mm) = args.position {
        check_opening("--position", opening_mm, MARGIN_MM)?;
    }
    let stroke_mm = constants::STROKE.value;
    let full_mm_s = lead.closing_mm_s();
    if let Some(speed) = args.speed.filter(|mm_s| !(0.1..=full_mm_s).contains(&mm_s.abs())) {
        bail!(
            "--speed {speed:?} is not possible here; give 0.1 to {full_mm_s} mm/s with this screw"
        );
    }
    match (args.position, args.speed) {
        (Some(_), Some(speed)) if speed < 0.0 => {
            bail!("--speed {speed} with --position must be positive")
        }
        (Some(opening_mm), speed) => {
            let (distance_mm, speed_mm_s) =
                ((opening_mm - args.from).abs(), speed.unwrap_or(full_mm_s));
            if distance_mm > MAX_MOTION_S * speed_mm_s {
                bail!(
                    "{distance_mm} mm at {speed_mm_s} mm/s take longer than {MAX_MOTION_S} s; increase --speed"
                )
            }
            Ok(DriveTarget::Position { opening_mm, speed_mm_s })
        }
        (None, Some(closing_mm_s)) => {
            let distance_mm = if closing_mm_s > 0.0 {
                args.from - MARGIN_MM
            } else {
                stroke_mm - MARGIN_MM - args.from
            };
            let seconds = (distance_mm / closing_mm_s.abs()).min(MAX_SPEED_RUN_S);
            Ok(DriveTarget::Speed {
                closing_mm_s,
                // Whole milliseconds.
                seconds: (1e3 * seconds).floor().max(1.0) / 1e3,
            })
        }
        (None, None) => bail!("give --position, --speed, or both"),
    }
}

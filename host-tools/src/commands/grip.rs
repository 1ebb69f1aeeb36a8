//! `magpie grip`: the firmware's control of motor and grasp on a simulated gripper, or commands to a real or emulated one.
//!
//! - here: a way to a place, a speed.
//! - `force`: a grasp; `foot`: a landing.
//! - `commanded`: a gripper on a serial line or CAN bus; `course`: what it reported meanwhile.

mod commanded;
mod course;
mod foot;
mod force;

use std::path::PathBuf;

use anyhow::{Result, bail};
use firmware::params::{self, Constant};
use serde_json::{Value, json};

use super::live::{Line, parse_seconds};
use crate::drive::runs::Case;
use crate::drive::told::{Asked, Told};
use crate::plant::parameters::Lead;
use crate::report::{self, drive};
use crate::{progress, show};

/// Move, grip or land: a simulated gripper under the firmware's own control, or a real or emulated one (--port, --can).
#[derive(Debug, clap::Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "\
Examples:
  cargo magpie grip --position 20 -o grip.html
  cargo magpie grip --speed 58.3 --screw b --json
  cargo magpie grip --position 60 --speed 10 --from 20 --scatter 0.2 --seed 7
  cargo magpie grip --force 100 --object rigid -o grip.html
  cargo magpie grip --force 50 --compare current-limit
  cargo magpie grip --foot 150 --lasts 10 -o landing.html
  cargo magpie grip --port /dev/ttyACM0 --home --position 40    # moves a real gripper
  cargo magpie grip --can can0 --force 80 --seconds 10
  cargo magpie grip --can 127.0.0.1:29536 --home --force 80     # one that `magpie emulate` runs

With --port or --can it arms the gripper, enables it, homes it (only with --home), commands it and prints state, force and
opening as they come. Ctrl-C, and the end of --seconds, stop it: a grip is released, a foot is left, and the drive is
disabled. Ctrl-C again is an emergency stop."
)]
#[command(group = clap::ArgGroup::new("asked").required(true).multiple(true)
    .args(["position", "speed", "force", "foot"]))]
#[command(group = clap::ArgGroup::new("commanded").args(["port", "can"]))]
pub struct Args {
    #[command(flatten)]
    line: Line,
    /// Home the gripper where its opening is not known: the fingers close until they press, then open fully.
    #[arg(long, requires = "commanded")]
    home: bool,
    /// Clear latched faults first.
    #[arg(long, requires = "commanded")]
    clear_faults: bool,
    /// Time for which force, foot or position is kept once it is reached; without it, until Ctrl-C, a position not at all.
    #[arg(long, value_name = "S", requires = "commanded", value_parser = parse_seconds)]
    seconds: Option<f64>,
    /// Opening to go to.
    #[arg(long, value_name = "MM")]
    position: Option<f64>,
    /// Greatest speed on the way to a place; without one, speed of closing (below zero opens), then the brake.
    #[arg(long, value_name = "MM_S", allow_negative_numbers = true)]
    speed: Option<f64>,
    /// Grip with this force.
    #[arg(long, value_name = "N", conflicts_with_all = ["position", "speed", "from", "foot"])]
    force: Option<f64>,
    /// What is gripped.
    #[arg(
        long,
        value_enum,
        default_value = "rigid",
        requires = "force",
        conflicts_with = "commanded"
    )]
    object: Stuff,
    /// The same grasp beside it, otherwise controlled.
    #[arg(long, value_enum, requires = "force", conflicts_with = "commanded")]
    compare: Option<Other>,
    /// Land as a foot: in the simulation, the ground pushes with this force at the most.
    #[arg(long, value_name = "N", conflicts_with_all = ["position", "speed", "from"])]
    foot: Option<Option<f64>>,
    /// Time from touching the ground to leaving it.
    #[arg(
        long,
        value_name = "MS",
        default_value_t = 10.0,
        requires = "foot",
        conflicts_with = "commanded"
    )]
    lasts: f64,
    /// Opening at the beginning.
    #[arg(
        long,
        value_name = "MM",
        default_value_t = 40.0,
        conflicts_with = "commanded"
    )]
    from: f64,
    /// Lead screw: a locks itself, b is driven back.
    #[arg(long, value_enum, default_value = "a", conflicts_with = "commanded")]
    screw: Lead,
    /// Everything uncertain is off the card by up to this share, as the seed draws it.
    #[arg(
        long,
        value_name = "SHARE",
        default_value_t = 0.0,
        conflicts_with = "commanded"
    )]
    scatter: f64,
    /// Seed of noise and scatter: the same seed, the same run.
    #[arg(long, default_value_t = 1, conflicts_with = "commanded")]
    seed: u64,
    /// Where the report goes.
    #[arg(short, long, value_name = "FILE", conflicts_with = "commanded")]
    output: Option<PathBuf>,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// What is gripped, by the stiffness of its contact, flexures included.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Stuff {
    /// 333 N/mm: steel between the flexures.
    Rigid,
    /// 50 N/mm: rubber.
    Medium,
    /// 5 N/mm: foam.
    Soft,
}

/// How else a grasp may be controlled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Other {
    /// By nothing but a bound of the motor's current: that which presses with the force at rest.
    CurrentLimit,
}

/// A run at a speed lasts this long, or as long as the way is.
const RUN_S: f64 = 0.5;
/// No way to a place takes longer.
const MOST_WAY_S: f64 = 15.0;
/// Room that is left to the ends of the travel, in mm.
const ROOM_MM: f64 = 2.0;
/// Most of what is uncertain.
const MOST_SCATTER: f64 = 0.5;

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    if args.line.is_given() {
        return commanded::run(args);
    }
    let lead = args.screw;
    let case = match args.scatter {
        0.0 => Case::nominal(lead, args.seed),
        share if share > 0.0 && share <= MOST_SCATTER => Case::scattered(lead, share, args.seed),
        share => bail!("--scatter {share} is not possible here; give 0 to {MOST_SCATTER}"),
    };
    if let Some(set_n) = args.force {
        return force::run(args, case, set_n);
    }
    if let Some(peak_n) = args.foot {
        let Some(peak_n) = peak_n else {
            bail!("--foot needs the ground's greatest force in newtons, as --foot 150");
        };
        return foot::run(args, case, peak_n);
    }
    let asked = asked(args, lead)?;
    let bar = progress::bar("simulating the drive", Told::PARTS);
    let told = Told::of(case, args.from, asked, || bar.inc(1));
    bar.finish_and_clear();
    if let Some(path) = &args.output {
        report::write_sections(path, &drive::title(&told), &drive::sections(&told))?;
    }
    let page = match args.json {
        true => format!("{}\n", report_json(args, &told)),
        false => text(args, &told),
    };
    show::page(&page)?;
    Ok(())
}

/// Checks that an opening is within the travel.
fn check_place(option: &str, mm: f64) -> Result<()> {
    let most_mm = params::STROKE.value - ROOM_MM;
    if !(ROOM_MM..=most_mm).contains(&mm) {
        bail!("{option} {mm} is not possible here; give {ROOM_MM} to {most_mm} mm");
    }
    Ok(())
}

/// What is asked, within what the drive can.
fn asked(args: &Args, lead: Lead) -> Result<Asked> {
    check_place("--from", args.from)?;
    if let Some(opening_mm) = args.position {
        check_place("--position", opening_mm)?;
    }
    let stroke_mm = params::STROKE.value;
    let full_mm_s = lead.closing_mm_s();
    if let Some(speed) = args
        .speed
        .filter(|mm_s| !(0.1..=full_mm_s).contains(&mm_s.abs()))
    {
        bail!("--speed {speed} is not possible here; give 0.1 to {full_mm_s} mm/s with this screw");
    }
    match (args.position, args.speed) {
        (Some(_), Some(speed)) if speed < 0.0 => {
            bail!("--speed {speed} on the way to a place is its size; leave the sign out")
        }
        (Some(opening_mm), speed) => {
            let (way_mm, speed_mm_s) = ((opening_mm - args.from).abs(), speed.unwrap_or(full_mm_s));
            if way_mm > MOST_WAY_S * speed_mm_s {
                bail!(
                    "{way_mm} mm at {speed_mm_s} mm/s take longer than {MOST_WAY_S} s; give a greater --speed"
                )
            }
            Ok(Asked::Place {
                opening_mm,
                speed_mm_s,
            })
        }
        (None, Some(closing_mm_s)) => {
            let room_mm = match closing_mm_s > 0.0 {
                true => args.from - ROOM_MM,
                false => stroke_mm - ROOM_MM - args.from,
            };
            let seconds = (room_mm / closing_mm_s.abs()).min(RUN_S);
            Ok(Asked::Speed {
                closing_mm_s,
                // Whole milliseconds.
                seconds: (1e3 * seconds).floor().max(1.0) / 1e3,
            })
        }
        (None, None) => bail!("give --position, --speed, or both"),
    }
}

fn text(args: &Args, told: &Told) -> String {
    let mut table = show::table(["figure", "", "unit"]);
    for (name, value, unit) in told.figures() {
        table.add_row([name, &show::plain(value, 3), unit]);
    }
    show::right_align(&mut table, 1);
    let mut page = show::paragraph(&told.sentence());
    page += &format!("{table}\n");
    page += &ends(args, &told.assumed());
    page
}

/// What every page in the terminal ends with: what is assumed, and where the report is.
fn ends(args: &Args, assumed: &[Constant]) -> String {
    let assumed: Vec<String> = assumed
        .iter()
        .map(|constant| {
            let value = show::plain(constant.value, 6);
            format!("{} {value} {}", constant.name, constant.unit)
                .trim_end()
                .to_owned()
        })
        .collect();
    let mut page = show::paragraph(&format!("Simulated. Assumed: {}.", assumed.join(", ")));
    if let Some(path) = &args.output {
        page += &format!("Report: {}\n", path.display());
    }
    page
}

/// The same constants in JSON.
fn assumed_json(assumed: &[Constant]) -> Vec<Value> {
    let json = |constant: &Constant| json!({ "name": constant.name, "value": constant.value, "unit": constant.unit });
    assumed.iter().map(json).collect()
}

/// Figures in JSON: name, value, unit.
fn figures_json(figures: &[(&'static str, f64, &'static str)]) -> Vec<Value> {
    let json = |(name, value, unit): &(&str, f64, &str)| json!({ "name": name, "value": value, "unit": unit });
    figures.iter().map(json).collect()
}

fn report_json(args: &Args, told: &Told) -> Value {
    let points = told.run.points.iter().step_by(20).map(|point| {
        json!({
            "time_s": point.time_s,
            "opening_mm": point.opening_mm,
            "asked_mm": point.asked_mm,
            "closing_mm_s": point.closing_mm_s,
            "current_d_a": point.current_a[0],
            "current_q_a": point.current_a[1],
            "voltage_d_v": point.voltage_v[0],
            "voltage_q_v": point.voltage_v[1],
            "bus_v": point.bus_v,
        })
    });
    let sweep = told.sweep.iter().map(|tone| {
        json!({ "frequency_hz": tone.frequency_hz, "gain": tone.gain, "lag_deg": tone.lag_deg })
    });
    json!({
        "simulated": true,
        "screw": format!("{:?}", told.case.lead).to_lowercase(),
        "seed": args.seed,
        "scatter": args.scatter,
        "from_mm": args.from,
        "report": args.output,
        "figures": figures_json(&told.figures()),
        "points": points.collect::<Vec<_>>(),
        "current_step": told.step.points,
        "current_sweep": sweep.collect::<Vec<_>>(),
        "assumed": assumed_json(&told.assumed()),
    })
}

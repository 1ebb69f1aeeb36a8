//! Arguments of `magpie grasp`.

use std::fmt::Debug;
use std::path::PathBuf;

use anyhow::Result;
use device::control::{WidthWindow, result_code};
use device::session::foot_openings;
use firmware::config::constants;
use model_export::output::{Output, Overwrite, fingerprint_of};
use sim::closed_loop::landing::FootContact;
use sim::drivetrain::parameters::Lead;

use crate::commands::args::{ObjectStiffness, parse_number, parse_object};
use crate::commands::connection::{PortArgs, parse_seconds};

/// Move, grasp or land with a simulated gripper, or a real or emulated one (--port, --can).
#[derive(Debug, clap::Args)]
#[command(
    allow_negative_numbers = true,
    after_help = help()
)]
#[command(group = clap::ArgGroup::new("setpoint").required(true).multiple(true)
    .args(["position", "speed", "force", "foot", "release", "stop"]))]
#[command(group = clap::ArgGroup::new("hardware").args(["port", "can"]))]
pub struct Args {
    #[command(flatten)]
    pub(super) port: PortArgs,
    /// Home the gripper if required: the fingers close to the end stop, then open fully.
    #[arg(long, requires = "hardware")]
    pub(super) home: bool,
    /// Clear latched faults first.
    #[arg(long, requires = "hardware")]
    pub(super) clear_faults: bool,
    /// The forces are not believed, as before a calibration: the move ends where the current, at most 0.6 A, finds an obstacle.
    #[arg(long, requires_all = ["hardware", "position"])]
    pub(super) uncalibrated: bool,
    /// Return with the object gripped: what is reached is held without this program, until `grasp --release`.
    #[arg(long, requires_all = ["force", "hardware"])]
    pub(super) keep: bool,
    /// Hold time at the set-point [default: until Ctrl-C; 0 for a position and with --keep].
    #[arg(long, value_name = "S", requires = "hardware", value_parser = parse_seconds)]
    pub(super) seconds: Option<f64>,
    /// Target opening.
    #[arg(long, value_name = "MM")]
    pub(super) position: Option<f64>,
    /// Maximum speed to the target opening, or of the approach to a grasp (--port, --can) [default: by the force]; without a
    /// target, closing speed (negative opens), then braking.
    #[arg(long, value_name = "MM_S", allow_negative_numbers = true)]
    pub(super) speed: Option<f64>,
    /// Grasp force.
    #[arg(long, value_name = "N", conflicts_with_all = ["position", "from", "foot"])]
    pub(super) force: Option<f64>,
    /// Limits of force and speed of the grasp, also after a slip [default: normal, strong above 100 N].
    #[arg(long, value_enum, requires_all = ["force", "hardware"])]
    pub(super) profile: Option<Profile>,
    /// Expected width of the object, and half of the window around it: 1, 2, 4, 8, 16, 32 or 64 mm.
    #[arg(long, value_name = "MM:HALF_MM", requires_all = ["force", "hardware"], value_parser = parse_width)]
    pub(super) width: Option<[f64; 2]>,
    /// Full speed until close to the window of --width.
    #[arg(long, requires = "width")]
    pub(super) fast: bool,
    /// Grasped object: rigid, medium or soft (333, 50 and 5 N/mm).
    #[arg(
        long,
        value_name = "STIFFNESS",
        value_parser = parse_object,
        default_value = "rigid",
        requires = "force",
        conflicts_with = "hardware"
    )]
    pub(super) object: ObjectStiffness,
    /// Compare with the same grasp under another controller.
    #[arg(long, value_enum, requires = "force", conflicts_with = "hardware")]
    pub(super) compare: Option<OtherController>,
    /// Ground contact (landing); the value is the peak ground force of the simulation.
    #[arg(long, value_name = "N", conflicts_with_all = ["position", "speed", "from"])]
    pub(super) foot: Option<Option<f64>>,
    /// Open without enabling, homing or valid forces, to this opening [default: fully].
    #[arg(long, value_name = "MM", requires = "hardware", conflicts_with_all = ["position", "speed", "force", "foot"])]
    pub(super) release: Option<Option<f64>>,
    /// Stop the gripper, whoever controls it (not over a serial port that another program uses); it keeps what it holds until the
    /// stop is cleared (--clear-faults).
    #[arg(long, requires = "hardware", conflicts_with_all = ["position", "speed", "force", "foot", "release", "clear_faults"])]
    pub(super) stop: bool,
    /// Contact with the ground: flat on closed fingers, or on the line between open ones.
    #[arg(long, value_enum, default_value = "flat", requires = "foot")]
    pub(super) contact: FootContact,
    /// Duration of the ground contact.
    #[arg(
        long,
        value_name = "MS",
        default_value_t = 10.0,
        requires = "foot",
        conflicts_with = "hardware"
    )]
    pub(super) lasts: f64,
    /// Initial opening.
    #[arg(long, value_name = "MM", default_value_t = 40.0, conflicts_with = "hardware")]
    pub(super) from: f64,
    /// Lead screw: a is self-locking, b is backdrivable.
    #[arg(long, value_enum, default_value = "a", conflicts_with = "hardware")]
    pub(super) screw: Lead,
    /// Perturb every uncertain parameter by up to this fraction (seeded).
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0, conflicts_with = "hardware")]
    pub(super) scatter: f64,
    /// Seed of noise and perturbations.
    #[arg(long, default_value_t = 1, conflicts_with = "hardware")]
    pub(super) seed: u64,
    /// HTML report to write.
    #[arg(short, long, value_name = "FILE", conflicts_with = "hardware")]
    pub(super) output: Option<PathBuf>,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    pub(super) json: bool,
    /// Print JSON objects on stdout as they come, one per line: states, points, faults, last the result.
    #[arg(long, requires = "hardware", conflicts_with_all = ["json", "stop"])]
    pub(super) json_lines: bool,
}

/// Examples, behaviour and limits for `--help`.
const EXAMPLES: &str = "\
Examples:
  cargo magpie grasp --position 20 -o grasp.html
  cargo magpie grasp --speed 58.3 --screw b --json
  cargo magpie grasp --position 60 --speed 10 --from 20 --scatter 0.2 --seed 7
  cargo magpie grasp --force 100 --object rigid -o grasp.html
  cargo magpie grasp --force 50 --compare current-limit
  cargo magpie grasp --foot 150 --lasts 10 -o landing.html
  cargo magpie grasp --foot 150 --contact line
  cargo magpie grasp --port /dev/ttyACM0 --home --position 40    # moves a real gripper
  cargo magpie grasp --port /dev/ttyACM0 --position 20 --uncalibrated
  cargo magpie grasp --can can0 --force 80 --seconds 10
  cargo magpie grasp --can can0 --force 80 --keep && cargo magpie grasp --can can0 --release
  cargo magpie grasp --can can0 --force 80 --json-lines | jq '.state'
  cargo magpie grasp --can can0 --force 15 --profile fragile --width 40:4 --speed 4
  cargo magpie grasp --can 127.0.0.1:29536 --home --force 80     # `cargo magpie dev emulate`
  # frees what is gripped, also under a fault of the sensors
  cargo magpie grasp --port /dev/ttyACM0 --release
  cargo magpie grasp --can can0 --stop

With --port or --can it arms, enables, homes (only with --home) and commands the gripper, and prints state, force and \
opening. Ctrl-C or the end of --seconds opens a grasp of this command or leaves its ground contact, and disables the drive. \
A second Ctrl-C is an emergency stop, after which the fingers do not move. What was gripped before the command stays \
gripped, however it ends, except with --release: a refusal, a lost connection or a kill opens nothing.

Only one program at a time can use a serial port: next to another one, --stop and --release work over the CAN bus only.
";

/// What follows the options in `--help`.
fn help() -> String {
    format!("{EXAMPLES}\nGround contact (--foot): {}.\n\n{}", foot_openings(), result_code::HELP)
}

/// Limits of a grasp.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Profile {
    /// Up to 20 N, 5 mm/s.
    Fragile,
    /// Up to 100 N.
    Normal,
    /// Up to 350 N.
    Strong,
}

fn parse_width(text: &str) -> Result<[f64; 2], String> {
    let number = |text: &str| parse_number(text, (0.0, constants::STROKE.value)).ok();
    let width =
        text.split_once(':').and_then(|(width, half)| Some([number(width)?, number(half)?]));
    width.ok_or_else(|| "write MM:HALF_MM, as 40:2".to_owned())
}

impl Args {
    /// The HTML report, of a simulation with these settings.
    pub(super) fn page(&self, settings: &impl Debug) -> Result<Option<Output>> {
        // Here --force is that of the fingers.
        let inputs = vec![fingerprint_of(settings)];
        let check = |path| Output::check(path, report::html::MARK, inputs, Overwrite::NEVER);
        Ok(self.output.as_deref().map(check).transpose()?)
    }

    /// Width window of a grasp.
    pub(super) fn window(&self) -> Option<WidthWindow> {
        let is_fast = self.fast;
        self.width.map(|[width_mm, half_mm]| WidthWindow { width_mm, half_mm, is_fast })
    }
}

/// Controllers to compare with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum OtherController {
    /// A motor current limit that gives the same force at standstill.
    CurrentLimit,
}

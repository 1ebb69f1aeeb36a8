//! Arguments of `magpie dev emulate`.

use std::path::PathBuf;

use crate::commands::args::{ObjectStiffness, parse_object};
use crate::commands::connection::parse_seconds;

/// Run the unmodified firmware image in an emulated chip with a simulated gripper.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  # until Ctrl-C; prints its serial line and CAN bus
  cargo magpie dev emulate
  cargo magpie monitor --port /dev/pts/3             # in another terminal, with the printed path
  cargo magpie dev emulate --object-width-mm 40 --can-port 29536 --log
  cargo magpie grasp --can 127.0.0.1:29536 --home --force 80    # in another terminal
  # a virtual CAN interface of Linux: candump, SavvyCAN, ...
  cargo magpie dev emulate --can vcan0
  cargo magpie dev emulate --seconds 10 --speed max --json > profile.json
  cargo magpie dev emulate --replay tests/data/clean/1 --model model.toml --speed 0.2

At the end, and after Ctrl-C, it prints a profile (load of each priority level and interrupt, longest blocking and \
latency, stack, hottest functions), the latency from tick to packet on the serial line and to the CAN frames with forces, \
rule violations, resets and faults. Without --can, the CAN bus is a local TCP port with the socketcand protocol (ASCII, raw mode), which \
python-can and other tools support. Times are virtual (chip time). The simulated fingertips have the \
nominal design: build the image with tables of `cargo magpie dev export MODEL --nominal`. The peripherals are modelled from manuals and not \
validated on a chip.")]
pub struct Args {
    /// Firmware image (ELF) [default: the newest build of `cargo image` or `.ci/image`].
    #[arg(value_name = "ELF")]
    pub(super) image: Option<PathBuf>,
    /// Finger opening at power-on.
    #[arg(long, value_name = "MM", default_value_t = 40.0, value_parser = parse_opening)]
    pub(super) opening: f64,
    /// Width of an object, inserted as soon as the gripper is homed and sufficiently open.
    #[arg(long, value_name = "MM", value_parser = parse_opening)]
    pub(super) object_width_mm: Option<f64>,
    /// Take the object away at this virtual time.
    #[arg(long, value_name = "S", requires = "object_width_mm", value_parser = parse_seconds)]
    pub(super) remove_object: Option<f64>,
    /// The object: rigid, medium or soft (333, 50 and 5 N/mm, including the flexures).
    #[arg(long, value_name = "STIFFNESS", default_value = "rigid", requires = "object_width_mm", value_parser = parse_object)]
    pub(super) object: ObjectStiffness,
    /// File with the settings of the board (parameters, key, calibrations): read at power-on if it exists, written at the end.
    #[arg(long, value_name = "FILE")]
    pub(super) flash: Option<PathBuf>,
    /// Recording that replaces the simulated sensor readings; the emulation ends with it.
    #[arg(long, value_name = "RECORDING", requires = "model", conflicts_with_all = ["opening", "object_width_mm"])]
    pub(super) replay: Option<PathBuf>,
    /// Model of the recording's sensors.
    #[arg(long, value_name = "MODEL", requires = "replay")]
    pub(super) model: Option<PathBuf>,
    /// Seed of noise, random numbers and memory at power-on.
    #[arg(long, default_value_t = 1)]
    pub(super) seed: u64,
    /// Execution times: minimum of Arm's manual with all flash cached, maximum with none cached, or typical.
    #[arg(long, value_enum, default_value = "typical")]
    pub(super) timing: Timing,
    /// Virtual seconds per second, or max (unlimited).
    #[arg(long, value_name = "X", default_value = "1", value_parser = parse_speed)]
    pub(super) speed: Speed,
    /// End after this virtual time.
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    pub(super) seconds: Option<f64>,
    /// CAN interface of this machine to bridge to, such as vcan0 (Linux).
    #[arg(long, value_name = "INTERFACE", conflicts_with = "can_port")]
    pub(super) can: Option<String>,
    /// TCP port of the CAN bus on 127.0.0.1; 0 selects a free port.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    pub(super) can_port: u16,
    /// Print the log of the image on stderr.
    #[arg(long)]
    pub(super) log: bool,
    /// Print one JSON object at the end on stdout and nothing else.
    #[arg(long)]
    pub(super) json: bool,
}

/// Execution time models.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Timing {
    /// Minimum times, fastest buses.
    Fast,
    /// Intermediate times.
    Typical,
    /// Maximum times, slowest buses.
    Slow,
}

/// Virtual seconds per second; `None` is unlimited.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speed(pub(super) Option<f64>);

fn parse_speed(text: &str) -> Result<Speed, String> {
    if text == "max" {
        return Ok(Speed(None));
    }
    let speed = text.parse().ok();
    let speed = speed.filter(|speed| (0.001..=1000.0).contains(speed));
    let usage = || "give 0.001 to 1000 virtual seconds per second, or max".to_owned();
    speed.map(|speed| Speed(Some(speed))).ok_or_else(usage)
}

fn parse_opening(text: &str) -> Result<f64, String> {
    // The mechanical end stops differ from the nominal stroke.
    const MARGIN_MM: f64 = 1.0;
    let max_mm = firmware::config::constants::STROKE.value - MARGIN_MM;
    let mm = text.parse().ok();
    let mm = mm.filter(|mm| (MARGIN_MM..=max_mm).contains(mm));
    mm.ok_or_else(|| format!("give {MARGIN_MM} to {max_mm} mm, within the stroke"))
}

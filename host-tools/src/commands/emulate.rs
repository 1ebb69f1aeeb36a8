//! `magpie emulate`: the firmware's unmodified image in the emulated chip, for other programs a board.

#[cfg(unix)]
mod report;
#[cfg(unix)]
mod run;

use std::path::PathBuf;

use anyhow::Result;

use super::live::parse_seconds;

/// Run the firmware's unmodified image in an emulated chip with a simulated gripper around it.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie emulate                               # until Ctrl-C; prints where its serial line and CAN bus are
  cargo magpie monitor --port /dev/pts/3             # in another terminal, with the path that it has printed
  cargo magpie emulate --object 40 --can-port 29536 --log
  cargo magpie grip --can 127.0.0.1:29536 --home --force 80    # in another terminal
  cargo magpie emulate --can vcan0                   # a virtual CAN interface of Linux: candump, SavvyCAN, ...
  cargo magpie emulate --seconds 10 --speed max --json > profile.json
  cargo magpie emulate --replay tests/data/clean/1 --model model.toml --speed 0.2

At the end, Ctrl-C included, it prints where the core's time went: load of each priority level and interrupt, longest
blocking and latency, stack, hottest functions; how long after its tick each packet had passed on the serial line;
violations of the chip's rules, resets and faults. Without --can, the CAN bus is a TCP port on this machine with the
protocol of socketcand (ASCII, raw mode), which python-can and others speak. Times are virtual: those of the chip.
The peripherals were written from manuals; nothing was compared with a chip.")]
pub struct Args {
    /// The image, an ELF file; without it, the one that `cargo image` or `.ci/image` has built.
    #[arg(value_name = "ELF")]
    image: Option<PathBuf>,
    /// Opening of the fingers at power-on.
    #[arg(long, value_name = "MM", default_value_t = 40.0, value_parser = parse_opening)]
    opening: f64,
    /// Width of an object that is put between the fingers as soon as the gripper is homed and open wide enough.
    #[arg(long, value_name = "MM", value_parser = parse_opening)]
    object: Option<f64>,
    /// Stiffness of the object's contact, flexures included: 333 is steel, 50 rubber, 5 foam.
    #[arg(long, value_name = "N_MM", default_value_t = 333.0, requires = "object", value_parser = parse_stiffness)]
    stiffness: f64,
    /// Recording that the sensors measure instead of the simulated gripper; its end ends the emulation.
    #[arg(long, value_name = "RECORDING", requires = "model", conflicts_with_all = ["opening", "object"])]
    replay: Option<PathBuf>,
    /// Model of the recording's sensors.
    #[arg(long, value_name = "MODEL", requires = "replay")]
    model: Option<PathBuf>,
    /// Seed of noise, random numbers and memory at power-on.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Execution times: the shortest that Arm's manual states with all of flash cached, the longest with none of it
    /// cached, or between.
    #[arg(long, value_enum, default_value = "typical")]
    timing: Timing,
    /// Virtual seconds in a second, or max: as fast as this machine computes.
    #[arg(long, value_name = "X", default_value = "1", value_parser = parse_speed)]
    speed: Speed,
    /// End after this virtual time.
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    seconds: Option<f64>,
    /// CAN interface of this machine that the bus is bridged to, such as vcan0 (Linux).
    #[arg(long, value_name = "INTERFACE", conflicts_with = "can_port")]
    can: Option<String>,
    /// TCP port of the CAN bus on 127.0.0.1; 0 is any that is free.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    can_port: u16,
    /// Print the lines of the image's log as they come, on stderr.
    #[arg(long)]
    log: bool,
    /// Print one JSON object at the end on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Models of execution time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Timing {
    /// The shortest times, the fastest buses.
    Fast,
    /// Between.
    Typical,
    /// The longest times, the slowest buses.
    Slow,
}

/// Virtual seconds in a second; none: as many as possible.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Speed(Option<f64>);

/// Runs the command.
#[cfg(unix)]
pub fn run(args: &Args) -> Result<()> {
    run::run(args)
}

/// Says why it does not run.
#[cfg(not(unix))]
pub fn run(_: &Args) -> Result<()> {
    anyhow::bail!("emulate needs pseudo-terminals, which this system does not have")
}

fn parse_speed(text: &str) -> Result<Speed, String> {
    if text == "max" {
        return Ok(Speed(None));
    }
    let speed = text.parse().ok();
    let speed = speed.filter(|speed| (0.001..=1000.0).contains(speed));
    let wrong = || "give virtual seconds in a second, 0.001 to 1000, or max".to_owned();
    speed.map(|speed| Speed(Some(speed))).ok_or_else(wrong)
}

fn parse_opening(text: &str) -> Result<f64, String> {
    // The ends of the travel are the mechanics', not those of the stroke on paper.
    const MARGIN_MM: f64 = 1.0;
    let most_mm = firmware::params::STROKE.value - MARGIN_MM;
    let mm = text.parse().ok();
    let mm = mm.filter(|mm| (MARGIN_MM..=most_mm).contains(mm));
    mm.ok_or_else(|| format!("give {MARGIN_MM} to {most_mm} mm, within the stroke"))
}

fn parse_stiffness(text: &str) -> Result<f64, String> {
    let stiffness = text.parse().ok();
    let stiffness = stiffness.filter(|stiffness| (0.1..=400.0).contains(stiffness));
    stiffness.ok_or_else(|| "give 0.1 to 400 N/mm".to_owned())
}

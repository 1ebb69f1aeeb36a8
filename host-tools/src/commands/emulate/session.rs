//! An emulation session: set-up, run, report.

use analysis::progress;
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::atomic::Ordering::Relaxed;

use anyhow::{Context, Result, anyhow};
use emulator::peripherals::flash;
use emulator::{Image, Time};
use indicatif::ProgressBar;
use model_export::input;
use model_export::inverse::build::{ModelVariant, build};
use model_export::output::{check_output, write_output};

use crate::commands::emulate::args::{Args, Timing};
use crate::commands::emulate::text::{self, End, Setup, format_fault, format_reset};
use crate::commands::interrupt::interrupted;
use device::emulation::pace::Pace;
use device::emulation::{CanPort, Emulation, Notice};
use device::pty::Pty;
use device::socket_can::Bridge;
use device::socketcand::server::Server;
use device::virtual_board::world::SensorInput;
use report::text::terminal;
use sim::board::world::World;
use sim::closed_loop::coupling::{GripperWorld, SharedGripper, SimulatedGripper};
use sim::closed_loop::emulated_board::{ChipConditions, EmulatedBoard};
use sim::closed_loop::grasp_rig::contact_object;
use sim::closed_loop::motor_rig::MotorRig;
use sim::drivetrain::fingertips::Fingertips;
use sim::drivetrain::parameters::{Lead, PlantParameters};

/// Output paths of the image builds.
const IMAGES: [&str; 2] = [
    "target/thumbv7em-none-eabihf/image/firmware",
    "target/debian/thumbv7em-none-eabihf/image/firmware",
];
/// First bytes of a file with the settings of a board, bank 2 of its flash.
const FLASH_MARK: &str = "MAGPIE emulated flash, bank 2\n";
/// Sampling period of the program counter, no divisor of the task periods.
const SAMPLE_PERIOD: Time = Time::from_ns(7_411);
/// Update period of the progress line in real seconds.
const UPDATE_PERIOD_S: f64 = 0.2;
/// Real seconds before a speed below the set-point is reported.
const SETTLE_S: f64 = 2.0;

pub(super) fn run(args: &Args) -> Result<()> {
    let path = match &args.image {
        Some(path) => path.clone(),
        None => default_image()?,
    };
    let image = Image::parse(input::read_bytes(&path, input::MAX_IMAGE_BYTES)?, &path)?;
    let length = image.length();
    let gripper = gripper(args);
    let mut board =
        EmulatedBoard::start(image, conditions(args), world(args, &gripper)?, gripper.clone())?;
    if let Some(path) = &args.flash {
        load_flash(&mut board, path)?;
    }
    let (can, can_name) = can(args)?;
    let pty = Pty::open().context("no pseudo-terminal available for the serial line")?;
    let parameters = PlantParameters::nominal(Lead::A);
    let stiffness = args.object.contact_n_per_mm();
    let object =
        args.object_width_mm.map(|width_mm| contact_object(&parameters, width_mm, stiffness));
    let mut emulation = Emulation::new(board, gripper, object, pty, can);
    emulation.remove_object_at = args.remove_object.map(time);
    let setup = Setup { path, length, serial: emulation.serial().to_owned(), can: can_name };
    announce(&setup, args);
    emulation.board.chip.sample_every(SAMPLE_PERIOD);
    let mut pace = Pace::new(args.speed.0);
    let end = run_until_end(args, &mut emulation, &mut pace)?;
    let saved = args.flash.as_deref().map_or(Ok(()), |path| save_flash(&emulation.board, path));
    let output = if args.json {
        format!("{}\n", text::to_json(&setup, args, &mut emulation, &pace, &end))
    } else {
        text::format_report(args, &mut emulation, &pace, &end)
    };
    terminal::print(&output)?;
    saved?;
    match end {
        End::Failed(error) => Err(error),
        _ => Ok(()),
    }
}

/// The newest image build.
///
/// # Errors
/// There is none.
fn default_image() -> Result<PathBuf> {
    let existing = IMAGES.iter().map(PathBuf::from).filter(|path| path.is_file());
    let newest =
        existing.max_by_key(|path| path.metadata().and_then(|metadata| metadata.modified()).ok());
    newest.ok_or_else(|| {
        anyhow!(
            "no image at {} or {}: build one with `cargo image` (or `.ci/image debian`, with Debian's \
             compiler), or give an ELF file",
            IMAGES[0],
            IMAGES[1]
        )
    })
}

/// Settings from an earlier emulation.
fn load_flash(board: &mut EmulatedBoard, path: &Path) -> Result<()> {
    check_output(path, FLASH_MARK)?;
    if !path.exists() {
        return Ok(());
    }
    let bytes = input::read_bytes(path, input::MAX_IMAGE_BYTES)?;
    let bank = bytes.strip_prefix(FLASH_MARK.as_bytes()).filter(|bank| bank.len() == flash::BANK);
    let bank = bank.with_context(|| {
        format!("{}: not the settings of an emulated board; give another file", path.display())
    })?;
    board.chip.soc.load_flash(flash::BANK, bank);
    Ok(())
}

fn save_flash(board: &EmulatedBoard, path: &Path) -> Result<()> {
    let bank = board.chip.soc.memory(flash::BASE + flash::BANK as u32, flash::BANK);
    let bank = bank.context("the chip has no second bank")?;
    write_output(path, &[FLASH_MARK.as_bytes(), bank].concat(), FLASH_MARK)?;
    Ok(())
}

const fn conditions(args: &Args) -> ChipConditions {
    let conditions = match args.timing {
        Timing::Fast => ChipConditions::FAST,
        Timing::Typical => ChipConditions::TYPICAL,
        Timing::Slow => ChipConditions::SLOW,
    };
    ChipConditions { seed: args.seed, ..conditions }
}

fn gripper(args: &Args) -> SharedGripper {
    let rig = MotorRig::new(Lead::A, PlantParameters::nominal(Lead::A), args.opening, args.seed);
    // Fingertips without effects are always possible.
    let tips = Fingertips::new(args.seed, 0.0, &[]).unwrap_or_else(|_| unreachable!());
    Rc::new(RefCell::new(SimulatedGripper::new(rig, tips, args.seed)))
}

fn world(args: &Args, gripper: &SharedGripper) -> Result<Box<dyn World>> {
    let (Some(folder), Some(model)) = (&args.replay, &args.model) else {
        return Ok(Box::new(GripperWorld(gripper.clone())));
    };
    let bar = progress::progress_bar("building tables", 1);
    let built = build(model, ModelVariant::Fitted)?;
    bar.finish_and_clear();
    let doing = SensorInput::Recorded(folder.clone());
    Ok(doing.world(doing.stream()?, &built))
}

fn can(args: &Args) -> Result<(CanPort, String)> {
    match &args.can {
        Some(interface) => Ok((CanPort::Interface(Bridge::open(interface)?), interface.clone())),
        None => {
            let server = Server::open(args.can_port)?;
            let name = server.address().to_string();
            Ok((CanPort::Server(server), name))
        }
    }
}

fn time(seconds: f64) -> Time {
    Time::from_us((1e6 * seconds) as u64)
}

fn announce(setup: &Setup, args: &Args) {
    let protocol = if args.can.is_some() { "interface" } else { "TCP, socketcand protocol" };
    eprintln!("image: {} ({} bytes of flash)", setup.path.display(), setup.length);
    eprintln!("serial line: --port {}", setup.serial.display());
    eprintln!("CAN bus ({protocol}): --can {}", setup.can);
}

fn run_until_end(args: &Args, emulation: &mut Emulation, pace: &mut Pace) -> Result<End> {
    let interrupted = interrupted()?;
    let bar = progress::status_spinner("emulating");
    let end = args.seconds.map_or(Time::NEVER, time);
    let mut status = StatusLine::default();
    let reason = loop {
        if emulation.now() >= end {
            break End::Seconds;
        }
        if interrupted.load(Relaxed) {
            break End::Interrupted;
        }
        if emulation.is_over() {
            break End::Recording;
        }
        match emulation.step() {
            Ok(notices) => {
                for notice in &notices {
                    if let Some(line) = notice_line(notice, emulation, args.log) {
                        bar.suspend(|| eprintln!("{line}"));
                    }
                }
            }
            Err(error) => break End::Failed(error),
        }
        status.update(&bar, emulation.now(), pace, args);
        pace.wait(emulation.now());
    };
    bar.finish_and_clear();
    Ok(reason)
}

/// The progress line: virtual time, and its recent ratio to real time.
#[derive(Default)]
struct StatusLine {
    at_s: f64,
    at: Time,
    is_late_reported: bool,
}

impl StatusLine {
    fn update(&mut self, bar: &ProgressBar, now: Time, pace: &Pace, args: &Args) {
        let elapsed_s = pace.elapsed_s();
        if elapsed_s < self.at_s + UPDATE_PERIOD_S {
            return;
        }
        let share = (now - self.at).as_s() / (elapsed_s - self.at_s);
        (self.at_s, self.at) = (elapsed_s, now);
        bar.set_message(format!("emulating  {:.1} s, {share:.2} of real time", now.as_s()));
        if !pace.keeps_up() && elapsed_s > SETTLE_S && !self.is_late_reported {
            self.is_late_reported = true;
            let share = now.as_s() / elapsed_s;
            let target = args.speed.0.unwrap_or(1.0);
            bar.suspend(|| {
                eprintln!(
                    "this machine does not keep up: {share:.2} virtual seconds per second instead of {target}; to other \
                     programs the board is slower"
                );
            });
        }
    }
}

/// Text of a notice; `None` for log lines without --log.
fn notice_line(notice: &Notice, emulation: &Emulation, log: bool) -> Option<String> {
    let now_s = emulation.now().as_s();
    match notice {
        Notice::Log(line) if log => {
            let stamp = line.stamp.as_deref().unwrap_or("-");
            Some(format!("{stamp:>12} {}", line.text))
        }
        Notice::Log(_) => None,
        Notice::Reset(record) => Some(format_reset(record, emulation)),
        Notice::Fault(event) => Some(format!("{now_s:>12.6} {}", format_fault(event, emulation))),
        Notice::Port(text) => Some(format!("{now_s:>12.6} {text}")),
    }
}

//! The emulation from its start to its profile.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::atomic::Ordering::Relaxed;

use anyhow::{Context, Result, anyhow};
use firmware::status::Fault;
use firmware::wire::messages::FaultEvent;
use indicatif::ProgressBar;
use model_export::inverse::build::{Variant, build};
use sim_board::{Image, ResetRecord, Time};

use super::{Args, Timing, report};
use crate::board::emulated::{Conditions, EmulatedBoard};
use crate::board::world::World;
use crate::commands::live::interrupted;
use crate::drive::Rig;
use crate::drive::grasp::object;
use crate::drive::world::{Gripper, Senses, Shared};
use crate::live::emulation::pace::Pace;
use crate::live::emulation::{CanPort, Emulation, Notice};
use crate::live::pty::Pty;
use crate::live::socket_can::Bridge;
use crate::live::socketcand::server::Server;
use crate::live::virtual_board::world::Doing;
use crate::live::words;
use crate::plant::hall::Fingertips;
use crate::plant::parameters::{Lead, Parameters};
use crate::{progress, show};

/// Where builds leave the image.
const IMAGES: [&str; 2] = [
    "target/thumbv7em-none-eabihf/image/firmware",
    "target/debian/thumbv7em-none-eabihf/image/firmware",
];
/// Between samples of the program counter. No divisor of the program's periods.
const SAMPLE: Time = Time::from_ns(7_411);
/// Seconds of this machine's clock between two updates of the progress line, and until a pace that cannot be kept is
/// reported: the first seconds of a busy machine say little.
const SHOW_S: f64 = 0.2;
const SETTLE_S: f64 = 2.0;

/// Why the emulation ended.
pub enum End {
    /// Its time is over.
    Seconds,
    /// Ctrl-C, or a request of the system.
    Interrupted,
    /// The recording has ended.
    Recording,
    /// The chip cannot go on, or a port is gone.
    Failed(anyhow::Error),
}

/// What it is called and what ran.
pub struct Setup {
    /// The ELF file.
    pub path: PathBuf,
    /// Bytes of flash that it takes.
    pub length: usize,
    /// Path of the serial line.
    pub serial: PathBuf,
    /// Name of the CAN bus.
    pub can: String,
}

pub(super) fn run(args: &Args) -> Result<()> {
    let path = match &args.image {
        Some(path) => path.clone(),
        None => default_image()?,
    };
    let image = Image::read(&path)?;
    let length = image.length();
    let gripper = gripper(args);
    let board = EmulatedBoard::start(
        image,
        conditions(args),
        world(args, &gripper)?,
        gripper.clone(),
    )?;
    let (can, can_name) = can(args)?;
    let pty = Pty::open().context("the system gives no pseudo-terminal for the serial line")?;
    let parameters = Parameters::nominal(Lead::A);
    let object = args
        .object
        .map(|width_mm| object(&parameters, width_mm, args.stiffness));
    let mut emulation = Emulation::new(board, gripper, object, pty, can);
    let setup = Setup {
        path,
        length,
        serial: emulation.serial().to_owned(),
        can: can_name,
    };
    announce(&setup, args);
    emulation.board.chip.sample_every(SAMPLE);
    let mut pace = Pace::new(args.speed.0);
    let end = go(args, &mut emulation, &mut pace)?;
    let page = match args.json {
        true => format!(
            "{}\n",
            report::json(&setup, args, &mut emulation, &pace, &end)
        ),
        false => report::text(args, &mut emulation, &pace, &end),
    };
    show::page(&page)?;
    match end {
        End::Failed(error) => Err(error),
        _ => Ok(()),
    }
}

/// The newest of the images that were built.
fn default_image() -> Result<PathBuf> {
    let found = IMAGES
        .iter()
        .map(PathBuf::from)
        .filter(|path| path.is_file());
    let newest = found.max_by_key(|path| {
        path.metadata()
            .and_then(|metadata| metadata.modified())
            .ok()
    });
    newest.ok_or_else(|| {
        anyhow!(
            "there is no image at {} nor {}: build one with `cargo image` (or `.ci/image debian`, with Debian's \
             compiler), or name an ELF file",
            IMAGES[0],
            IMAGES[1]
        )
    })
}

const fn conditions(args: &Args) -> Conditions {
    let conditions = match args.timing {
        Timing::Fast => Conditions::FAST,
        Timing::Typical => Conditions::TYPICAL,
        Timing::Slow => Conditions::SLOW,
    };
    Conditions {
        seed: args.seed,
        ..conditions
    }
}

fn gripper(args: &Args) -> Shared {
    let rig = Rig::new(
        Lead::A,
        Parameters::nominal(Lead::A),
        args.opening,
        args.seed,
    );
    // Fingertips without effects are always possible.
    let tips = Fingertips::new(args.seed, 0.0, &[]).unwrap_or_else(|_| unreachable!());
    Rc::new(RefCell::new(Gripper::new(rig, tips, args.seed)))
}

fn world(args: &Args, gripper: &Shared) -> Result<Box<dyn World>> {
    let (Some(folder), Some(model)) = (&args.replay, &args.model) else {
        return Ok(Box::new(Senses(gripper.clone())));
    };
    let bar = progress::bar("building tables", 1);
    let built = build(model, Variant::Fitted)?;
    bar.finish_and_clear();
    let doing = Doing::Recorded(folder.clone());
    Ok(doing.world(doing.stream()?, &built))
}

fn can(args: &Args) -> Result<(CanPort, String)> {
    match &args.can {
        Some(interface) => Ok((
            CanPort::Interface(Bridge::open(interface)?),
            interface.clone(),
        )),
        None => {
            let server = Server::open(args.can_port)?;
            let name = server.address().to_string();
            Ok((CanPort::Server(server), name))
        }
    }
}

fn announce(setup: &Setup, args: &Args) {
    let protocol = if args.can.is_some() {
        "interface"
    } else {
        "TCP, socketcand protocol"
    };
    eprintln!(
        "image: {} ({} bytes of flash)",
        setup.path.display(),
        setup.length
    );
    eprintln!("serial line: --port {}", setup.serial.display());
    eprintln!("CAN bus ({protocol}): --can {}", setup.can);
}

/// Runs until it ends.
fn go(args: &Args, emulation: &mut Emulation, pace: &mut Pace) -> Result<End> {
    let interrupted = interrupted()?;
    let bar = progress::message("emulating");
    let end = args
        .seconds
        .map_or(Time::NEVER, |seconds| Time::from_us((1e6 * seconds) as u64));
    let mut shown = Shown::default();
    let ended = loop {
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
            Ok(notices) => bar_lines(
                &bar,
                notices
                    .iter()
                    .filter_map(|notice| line(notice, emulation, args.log)),
            ),
            Err(error) => break End::Failed(error),
        }
        shown.update(&bar, emulation.now(), pace, args);
        pace.wait(emulation.now());
    };
    bar.finish_and_clear();
    Ok(ended)
}

/// Prints lines above the progress.
fn bar_lines(bar: &ProgressBar, lines: impl Iterator<Item = String>) {
    for line in lines {
        bar.suspend(|| eprintln!("{line}"));
    }
}

/// The progress line: virtual time, and its share of real time in the last moments.
#[derive(Default)]
struct Shown {
    at_s: f64,
    at: Time,
    is_late_reported: bool,
}

impl Shown {
    fn update(&mut self, bar: &ProgressBar, now: Time, pace: &Pace, args: &Args) {
        let elapsed_s = pace.elapsed_s();
        if elapsed_s < self.at_s + SHOW_S {
            return;
        }
        let share = (now - self.at).as_s() / (elapsed_s - self.at_s);
        (self.at_s, self.at) = (elapsed_s, now);
        bar.set_message(format!(
            "emulating  {:.1} s, {share:.2} of real time",
            now.as_s()
        ));
        if !pace.keeps_up() && elapsed_s > SETTLE_S && !self.is_late_reported {
            self.is_late_reported = true;
            let share = now.as_s() / elapsed_s;
            let asked = args.speed.0.unwrap_or(1.0);
            bar.suspend(|| {
                eprintln!(
                    "this machine does not keep up: {share:.2} virtual seconds in a second instead of {asked}; to other \
                     programs the board is slower"
                );
            });
        }
    }
}

/// A line about what happened; none where nobody asked for it.
fn line(notice: &Notice, emulation: &Emulation, log: bool) -> Option<String> {
    let now_s = emulation.now().as_s();
    match notice {
        Notice::Log(line) if log => {
            let stamp = line.stamp.as_deref().unwrap_or("-");
            Some(format!("{stamp:>12} {}", line.text))
        }
        Notice::Log(_) => None,
        Notice::Reset(record) => Some(reset_words(record, emulation)),
        Notice::Fault(event) => Some(format!("{now_s:>12.6} {}", fault_words(event, emulation))),
        Notice::Port(text) => Some(format!("{now_s:>12.6} {text}")),
    }
}

/// A reset with its cause and place.
pub fn reset_words(record: &ResetRecord, emulation: &Emulation) -> String {
    let place = emulation.board.chip.image().place(record.pc);
    format!(
        "{:>12.6} reset: {}, at {place}",
        record.time.as_s(),
        record.cause
    )
}

/// A fault in words; of a crash before the last reset, with its function.
pub fn fault_words(event: &FaultEvent, emulation: &Emulation) -> String {
    let words = words::fault_event(event);
    match crash_address(event) {
        Some(address) => {
            let place = emulation.board.chip.image().place(address);
            format!(
                "fault: {}: before the last reset, at {place}",
                crate::live::faults::name(Fault::Crashed)
            )
        }
        None => format!("fault: {words}"),
    }
}

/// Where the program crashed: the event's detail holds the lower three bytes of an address in flash.
fn crash_address(event: &FaultEvent) -> Option<u32> {
    const FLASH: u32 = 0x0800_0000;
    let is_crash = event.code == Fault::Crashed as u16 && event.active != 0;
    is_crash.then_some(FLASH | event.detail & 0x00FF_FFFF)
}

/// Name of the recording, for the report.
pub fn replayed(args: &Args) -> Option<&Path> {
    args.replay.as_deref()
}

//! Which gripper `monitor`, `record` and `grip` talk to.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result, bail};
use firmware::wire::{DEFAULT_NODE, PROTOCOL};
use model_export::fit::Options;
use model_export::inverse::build::{Built, Variant, build};
use model_export::model_file::{ModelFile, Provenance};
use model_export::recordings::align::Alignment;

use super::demo::CAMPAIGN;
use super::fit::{BaseChoice, fit_campaign, read_campaign};
use crate::live::serial_port::SerialLine;
use crate::live::socket_can::CanBus;
use crate::live::socketcand::client::RemoteBus;
use crate::live::source::Source;
use crate::live::state::State;
use crate::live::virtual_board::Unplug;
use crate::live::virtual_board::world::Doing;
use crate::networks::Networks;
use crate::progress;

/// Serial line or CAN bus of a gripper.
#[derive(Debug, clap::Args)]
pub struct Line {
    /// Serial port of a gripper, such as /dev/ttyACM0.
    #[arg(long, value_name = "PATH", conflicts_with = "can")]
    port: Option<String>,
    /// CAN bus of a gripper: an interface such as can0 (Linux), or HOST:PORT of `magpie emulate` or socketcand.
    #[arg(long, value_name = "BUS")]
    can: Option<String>,
    /// Number of the gripper on the CAN bus.
    #[arg(long, default_value_t = DEFAULT_NODE, requires = "can", value_parser = clap::value_parser!(u16).range(1..=63))]
    node: u16,
}

impl Line {
    /// Opens it; none where neither port nor bus is given.
    pub fn open(&self) -> Result<Option<Box<dyn Source>>> {
        Ok(match (&self.port, &self.can) {
            (Some(port), _) => Some(Box::new(SerialLine::open(port)?)),
            (None, Some(bus)) if bus.contains(':') => {
                Some(Box::new(RemoteBus::open(bus, self.node)?))
            }
            (None, Some(interface)) => Some(Box::new(CanBus::open(interface, self.node)?)),
            (None, None) => None,
        })
    }

    /// Whether port or bus is given.
    pub const fn is_given(&self) -> bool {
        self.port.is_some() || self.can.is_some()
    }

    /// Number of the gripper: on a serial line, too, its commands are sealed for it.
    pub const fn node(&self) -> u16 {
        self.node
    }
}

/// Which gripper.
#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("gripper").required(true).args(["port", "can", "virtual"]))]
pub struct Gripper {
    #[command(flatten)]
    line: Line,
    /// A board without hardware: the firmware's loops behind a pseudo-terminal.
    #[arg(long = "virtual", id = "virtual")]
    no_hardware: bool,
    /// Model that the virtual board runs; without it, one is fitted to the campaign that comes with the
    /// project.
    #[arg(long, requires = "virtual", value_name = "MODEL")]
    model: Option<PathBuf>,
    /// Networks that it runs behind the model.
    #[arg(long, requires = "model", value_name = "NETWORK")]
    network: Option<PathBuf>,
    /// Recording that its sensors feel; without it, the fingers grasp again and again.
    #[arg(long, requires = "model", value_name = "RECORDING")]
    replay: Option<PathBuf>,
    /// Forces in newtons that press on each of its fingers all the time, lateral and longitudinal.
    #[arg(long, requires = "virtual", conflicts_with = "replay", value_name = "FX,FZ", value_parser = parse_forces, allow_hyphen_values = true)]
    press: Option<[f64; 2]>,
    /// Sensor whose connector comes off, and after how many seconds; may be given several times.
    #[arg(long, requires = "virtual", value_name = "SENSOR@S")]
    unplug: Vec<Unplug>,
}

impl Gripper {
    /// Begins to hear it.
    pub fn open(&self) -> Result<Box<dyn Source>> {
        match self.line.open()? {
            Some(source) => Ok(source),
            None => self.virtual_board(),
        }
    }

    /// Whether it is on a CAN bus.
    pub fn is_on_bus(&self) -> bool {
        self.line.can.is_some()
    }

    #[cfg(unix)]
    fn virtual_board(&self) -> Result<Box<dyn Source>> {
        use crate::live::virtual_board::VirtualBoard;
        let doing = match (&self.replay, self.press) {
            (Some(folder), _) => Doing::Recorded(folder.clone()),
            (None, Some(forces_n)) => Doing::Pressed(forces_n),
            (None, None) => Doing::Grasps,
        };
        let built = self.built()?;
        let networks = self.network.as_deref();
        let networks = networks
            .map(|path| Networks::read(path, &built))
            .transpose()?;
        let board = VirtualBoard::start(built, networks, doing, self.unplug.clone())?;
        eprintln!(
            "virtual board: other programs find its line at {}",
            board.outside.display()
        );
        Ok(Box::new(board))
    }

    #[cfg(not(unix))]
    fn virtual_board(&self) -> Result<Box<dyn Source>> {
        bail!("--virtual needs pseudo terminals, which this system has not; use --port")
    }

    #[cfg(unix)]
    fn built(&self) -> Result<Built> {
        let building = progress::bar("building tables", 1);
        let built = match &self.model {
            Some(path) => build(path, Variant::Fitted)?,
            None => of_demo()?,
        };
        building.finish_and_clear();
        Ok(built)
    }
}

/// What the demo fits first.
#[cfg(unix)]
fn of_demo() -> Result<Built> {
    let options = Options::default();
    let alignment = Alignment { delay_us: 0.0 };
    let campaign = read_campaign(Path::new(CAMPAIGN), alignment)?;
    let (fits, _) = fit_campaign(&campaign, BaseChoice::Cylinder, None, options)?;
    let provenance = Provenance::of(&campaign, alignment.delay_us, options)?;
    let folder = tempfile::tempdir().context("there is no room for a model")?;
    let path = folder.path().join("model.toml");
    ModelFile::of(&campaign, &fits, provenance).write(&path)?;
    Ok(build(&path, Variant::Fitted)?)
}

/// Another major number is another language: what was heard means something else.
pub fn check_language(state: &State) -> Result<()> {
    let told = state.version.map(|version| version.protocol_major);
    match told.or(state.heartbeat.map(|told| told.value.protocol_major)) {
        Some(major) if major != PROTOCOL.0 => bail!(
            "the gripper speaks version {major} of the messages, this tool {}: use the tool that its firmware was \
             built with",
            PROTOCOL.0
        ),
        _ => Ok(()),
    }
}

/// Set as somebody wants the command to end: Ctrl-C, or a request of the system.
pub fn interrupted() -> Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, flag.clone())
            .context("the system does not tell of Ctrl-C")?;
    }
    Ok(flag)
}

/// A time in seconds above zero.
pub fn parse_seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok();
    let seconds = seconds.filter(|seconds: &f64| seconds.is_finite() && *seconds > 0.0);
    seconds.ok_or_else(|| "give a number of seconds above zero".to_owned())
}

fn parse_forces(text: &str) -> Result<[f64; 2], String> {
    let number = |text: &str| text.trim().parse().ok().filter(|n: &f64| n.is_finite());
    let forces = text
        .split_once(',')
        .and_then(|(x, z)| Some([number(x)?, number(z)?]));
    forces.ok_or_else(|| "write FX,FZ in newtons, as 20,-5".to_owned())
}

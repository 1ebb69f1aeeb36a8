//! Arguments for the connection to a gripper, serial line, CAN bus or virtual board, and to a reference next to it.

use analysis::progress;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use firmware::protocol::DEFAULT_NODE;
use model_export::fit::FitOptions;
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use model_export::model_file::{BaseKind, ModelFile, Provenance};
use model_export::output::StagingDir;
use model_export::recordings::align::Alignment;

use crate::commands::args::parse_number;
use analysis::compare::campaign_reader::read_campaign;
use analysis::fit::fit_campaign;
use device::reference::{ReferenceMapping, ReferenceSource};
use device::session::{Credentials, SessionSource, with_session};
use device::source::Source;
use device::virtual_board::world::{SensorInput, Unplug};
use device::{connect, key_file};
use device_run::networks::NetworkSet;

/// Reference next to a gripper.
#[derive(Clone, Debug, clap::Args)]
pub struct ReferenceArgs {
    /// Reference force sensor or pose: a serial port (PORT or PORT@BAUD), a socket (tcp:HOST:PORT) or - for standard input.
    #[arg(long, value_name = "SOURCE", requires = "reference_map")]
    reference: Option<ReferenceSource>,
    /// Mapping of the reference's columns to those of force.csv and to the pose.
    #[arg(long, value_name = "PATH", requires = "reference")]
    reference_map: Option<PathBuf>,
}

impl ReferenceArgs {
    /// The reference, if one is given.
    ///
    /// # Errors
    /// The mapping cannot be read.
    pub fn read(&self) -> Result<Option<Reference>> {
        let (Some(source), Some(path)) = (&self.reference, &self.reference_map) else {
            return Ok(None);
        };
        let mapping = ReferenceMapping::read(path)?;
        Ok(Some(Reference { source: source.clone(), mapping, path: path.clone() }))
    }
}

/// A reference and the mapping of its columns.
pub struct Reference {
    /// Where its lines come from.
    pub source: ReferenceSource,
    /// The mapping.
    pub mapping: ReferenceMapping,
    path: PathBuf,
}

impl Reference {
    /// As options of another command.
    pub fn arguments(&self) -> [String; 4] {
        let path = self.path.display().to_string();
        ["--reference".to_owned(), self.source.option(), "--reference-map".to_owned(), path]
    }
}

/// Serial line or CAN bus of a gripper.
#[derive(Clone, Debug, clap::Args)]
pub struct PortArgs {
    /// Serial port, such as /dev/ttyACM0.
    #[arg(long, value_name = "PATH", conflicts_with = "can")]
    port: Option<String>,
    /// CAN bus: an interface such as can0 (Linux), or HOST:PORT of `magpie dev emulate` or socketcand.
    #[arg(long, value_name = "BUS")]
    can: Option<String>,
    /// Node number of the gripper on the CAN bus.
    #[arg(long, default_value_t = DEFAULT_NODE, requires = "can", value_parser = clap::value_parser!(u16).range(1..=63))]
    node: u16,
    /// File with the key of the gripper [default: $MAGPIE_KEY_FILE, then magpie/key in the configuration folder, then none].
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
}

impl PortArgs {
    /// Opens the connection; `None` if neither port nor bus is given.
    pub fn open(&self) -> Result<Option<Box<dyn Source + Send>>> {
        connect::open(self.port.as_deref(), self.can.as_deref(), self.node)
    }

    /// Opens the connection.
    ///
    /// # Errors
    /// Neither port nor bus is given, or it cannot be opened.
    pub fn open_given(&self) -> Result<Box<dyn Source + Send>> {
        self.open()?.context("give the gripper's line: --port PATH or --can BUS")
    }

    /// The connection as it is typed.
    pub fn words(&self) -> String {
        match (&self.port, &self.can) {
            (Some(port), _) => format!("--port {port}"),
            (None, Some(bus)) if self.node == DEFAULT_NODE => format!("--can {bus}"),
            (None, Some(bus)) => format!("--can {bus} --node {}", self.node),
            (None, None) => String::new(),
        }
    }

    /// The connection as arguments of another command.
    pub fn arguments(&self) -> Vec<String> {
        let mut arguments = Vec::new();
        let mut add = |name: &str, value: String| arguments.extend([name.to_owned(), value]);
        if let Some(port) = &self.port {
            add("--port", port.clone());
        } else if let Some(bus) = &self.can {
            add("--can", bus.clone());
            add("--node", self.node.to_string());
        }
        if let Some(key) = &self.key {
            add("--key", key.display().to_string());
        }
        arguments
    }

    /// Does some work in a session with the gripper.
    ///
    /// # Errors
    /// As [`with_session`].
    pub fn in_session<T>(
        &self,
        source: &mut dyn Source,
        work: impl FnOnce(&mut SessionSource<'_>) -> Result<T>,
    ) -> Result<T> {
        with_session(source, self.credentials()?, work)
    }

    /// True if a port or bus is given.
    pub const fn is_given(&self) -> bool {
        self.port.is_some() || self.can.is_some()
    }

    /// True for a gripper on a CAN bus.
    pub const fn is_bus(&self) -> bool {
        self.can.is_some()
    }

    /// Node number and key, for a session.
    pub fn credentials(&self) -> Result<Credentials> {
        key_file::credentials(self.node, self.key.clone())
    }
}

/// A gripper on a serial line or CAN bus, or a virtual board.
#[derive(Debug, clap::Args)]
#[command(group = clap::ArgGroup::new("gripper").required(true).args(["port", "can", "virtual"]))]
pub struct GripperArgs {
    #[command(flatten)]
    port: PortArgs,
    /// Virtual board: the firmware's tasks behind a pseudo-terminal.
    #[arg(long = "virtual", id = "virtual")]
    is_virtual: bool,
    /// Model of the virtual board [default: fitted to a campaign of the project, with four sensors].
    #[arg(long, requires = "virtual", value_name = "MODEL")]
    model: Option<PathBuf>,
    /// Networks of the virtual board.
    #[arg(long, requires = "model", value_name = "NETWORK")]
    network: Option<PathBuf>,
    /// Recording that the sensors of the virtual board measure [default: repeated grasps].
    #[arg(long, requires = "model", value_name = "RECORDING")]
    replay: Option<PathBuf>,
    /// Constant lateral and longitudinal force on each finger of the virtual board in newtons.
    #[arg(long, requires = "virtual", conflicts_with = "replay", value_name = "FX,FZ", value_parser = parse_forces, allow_hyphen_values = true)]
    press: Option<[f64; 2]>,
    /// Sensor that is unplugged, and the time in seconds; may be given several times.
    #[arg(long, requires = "virtual", value_name = "SENSOR@S")]
    unplug: Vec<Unplug>,
}

impl GripperArgs {
    /// Opens the connection or starts the virtual board.
    pub fn open(&self) -> Result<Box<dyn Source + Send>> {
        match self.port.open()? {
            Some(source) => Ok(source),
            None => self.virtual_board(),
        }
    }

    /// Node number and key, for a session; a virtual board is unprotected.
    pub fn credentials(&self) -> Result<Credentials> {
        if self.port.is_given() { self.port.credentials() } else { Ok(Credentials::UNPROTECTED) }
    }

    /// True for a virtual board, which has sensors and no drive.
    pub const fn is_virtual(&self) -> bool {
        self.is_virtual
    }

    /// True for a gripper on a CAN bus.
    pub fn is_on_bus(&self) -> bool {
        self.port.is_bus()
    }

    #[cfg(unix)]
    fn virtual_board(&self) -> Result<Box<dyn Source + Send>> {
        let doing = match (&self.replay, self.press) {
            (Some(folder), _) => SensorInput::Recorded(folder.clone()),
            (None, Some(forces_n)) => SensorInput::Pressed(forces_n),
            (None, None) => SensorInput::Grasps,
        };
        let built = self.built()?;
        let networks = self.network.as_deref();
        let networks = networks.map(|path| NetworkSet::read(path, &built)).transpose()?;
        virtual_board(built, networks, doing, self.unplug.clone())
    }

    #[cfg(not(unix))]
    fn virtual_board(&self) -> Result<Box<dyn Source + Send>> {
        anyhow::bail!(
            "--virtual needs pseudo-terminals, which this system does not have; use --port"
        )
    }

    #[cfg(unix)]
    fn built(&self) -> Result<DeviceModel> {
        let bar = progress::progress_bar("building tables", 1);
        let built = match &self.model {
            Some(path) => build(path, ModelVariant::Fitted)?,
            None => default_model()?,
        };
        bar.finish_and_clear();
        Ok(built)
    }
}

/// Starts a virtual board.
#[cfg(unix)]
fn virtual_board(
    built: DeviceModel,
    networks: Option<NetworkSet>,
    input: SensorInput,
    unplug: Vec<Unplug>,
) -> Result<Box<dyn Source + Send>> {
    let board = device::virtual_board::VirtualBoard::start(built, networks, input, unplug)?;
    eprintln!("virtual board: serial line for other programs at {}", board.outside.display());
    Ok(Box::new(board))
}

/// A virtual board with the default model, whose sensors measure repeated grasps.
///
/// # Errors
/// The model cannot be fitted, or there is no pseudo terminal.
#[cfg(unix)]
pub fn default_virtual_board() -> Result<Box<dyn Source + Send>> {
    virtual_board(default_model()?, None, SensorInput::Grasps, Vec::new())
}

/// A virtual board needs pseudo-terminals.
///
/// # Errors
/// Always.
#[cfg(not(unix))]
pub fn default_virtual_board() -> Result<Box<dyn Source + Send>> {
    anyhow::bail!("--virtual needs pseudo-terminals, which this system does not have; use --port")
}

/// Campaign of four sensors in the source tree of this build.
#[cfg(unix)]
const CAMPAIGN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/demo");

/// The model of that campaign.
#[cfg(unix)]
fn default_model() -> Result<DeviceModel> {
    let options = FitOptions::default();
    let alignment = Alignment { delay_us: 0.0 };
    let campaign = read_campaign(Path::new(CAMPAIGN), alignment)?;
    let (fits, _) = fit_campaign(&campaign, BaseKind::Cylinder, None, options)?;
    let provenance = Provenance::of(&campaign, alignment.delay_us, options)?;
    let folder = StagingDir::new(&std::env::temp_dir().join("model"), "default")?;
    let path = folder.path().join("model.toml");
    ModelFile::of(&campaign, &fits, provenance).write(&path)?;
    Ok(build(&path, ModelVariant::Fitted)?)
}

/// States that a gripper has no key.
pub fn print_unprotected(name: &str) {
    eprintln!(
        "note: {name}: the gripper is unprotected, everybody on its bus can move it; see `cargo magpie board key --help`"
    );
}

/// Durations in seconds: a millisecond to a year.
const SECONDS: (f64, f64) = (1e-3, 3.2e7);
/// Maximum force on a finger of the virtual board in newtons, four times the design force.
const MAX_PRESS_N: f64 = 1000.0;

/// Parses a positive time in seconds.
pub fn parse_seconds(text: &str) -> Result<f64, String> {
    parse_number(text, SECONDS).map_err(|advice| format!("{advice}, in seconds"))
}

fn parse_forces(text: &str) -> Result<[f64; 2], String> {
    let number = |text: &str| parse_number(text, (-MAX_PRESS_N, MAX_PRESS_N)).ok();
    let forces = text.split_once(',').and_then(|(x, z)| Some([number(x)?, number(z)?]));
    forces.ok_or_else(|| format!("write FX,FZ in newtons, up to {MAX_PRESS_N}, as 20,-5"))
}

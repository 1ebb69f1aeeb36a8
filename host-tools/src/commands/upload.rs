//! `magpie upload`: writes a model and its networks to the flash of a gripper.

use std::path::PathBuf;
use std::time::{Duration, Instant, SystemTime};

use analysis::notes::{Note, UncompensatedEffect};
use analysis::progress;
use anyhow::{Context, Result, bail};
use device::calibration_client;
use device::source::Source;
use device_run::networks::NetworkSet;
use model_export::gru::network::Network;
use model_export::inverse::build::{DeviceModel, ModelVariant, build};
use model_export::inverse::calibration::{CalibrationDescription, encode_calibration};
use report::text::terminal;
use serde_json::json;

use crate::commands::connection::PortArgs;
use crate::commands::output::{
    check_compensated, print_conditions, print_missing_sensors, print_notes,
};

/// Upload force model, compensation and networks to a gripper, without a compiler.
///
/// The gripper must be disabled. It verifies the calibration, keeps the previous one until then, and runs the new one after
/// a reboot, also when the power failed in between.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie upload model.toml --port /dev/ttyACM0
  cargo magpie upload model.toml --network network.safetensors --can can0
  cargo magpie board --port /dev/ttyACM0    # what is on it")]
pub struct Args {
    /// Model file written by `magpie fit`.
    model: PathBuf,
    /// Recurrent networks to run after the model, written by `magpie train`.
    #[arg(long, value_name = "NETWORK")]
    network: Option<PathBuf>,
    #[command(flatten)]
    port: PortArgs,
    /// Upload the nominal design of the model instead of its fit, for a gripper that is not calibrated yet.
    #[arg(long, conflicts_with = "network")]
    nominal: bool,
    /// Upload although the device never compensates an effect of the model: the forces keep its error.
    #[arg(long)]
    uncompensated: bool,
    /// Upload although the fit is far from its own design: all forces change by as much.
    #[arg(long)]
    far_from_design: bool,
    /// Do not reboot the gripper: it runs the new calibration after the next one.
    #[arg(long)]
    no_reboot: bool,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let mut source = args.port.open_given()?;
    let variant = if args.nominal { ModelVariant::Nominal } else { ModelVariant::Fitted };
    let built = build(&args.model, variant)?;
    built.check_sensors(&args.model)?;
    if !args.nominal {
        check_design(&built, args.far_from_design)
            .with_context(|| args.model.display().to_string())?;
    }
    if !args.uncompensated {
        check_compensated(&built, "upload")?;
    }
    let set = args.network.as_deref().map(|path| NetworkSet::read(path, &built)).transpose()?;
    let networks = set.as_ref().map_or(&[][..], |set| &set.file.networks);
    let uncompensated = UncompensatedEffect::of(&built).map(Note::Uncompensated);
    print_notes(&uncompensated.collect::<Vec<_>>());
    print_conditions(&built);
    print_missing_sensors(&built.header);
    let uploaded = upload(&args.port, source.as_mut(), &built, networks, !args.no_reboot)
        .with_context(|| args.model.display().to_string())?;
    let UploadedCalibration { tables, sequence, bytes, took, description } = &uploaded;
    terminal::print_result(
        args.json,
        || {
            json!({
                "tables": format!("{tables:04x}"),
                "sequence": sequence,
                "bytes": bytes,
                "seconds": took.as_secs_f64(),
                "running": !args.no_reboot,
                "calibration": description,
            })
        },
        || uploaded.text(args.no_reboot),
    )
}

/// Ratio of a fitted gain to its design, either way, from which it is stated, and from which it must be accepted: one and three
/// tolerances of the stiffness, which are 10 % (assumed).
const STATED: f64 = 1.1;
const ACCEPTED: f64 = 1.3;

/// States how far the fit is from its own design.
///
/// # Errors
/// It is far, as with forces in another unit or a wrong stiffness in the design, and not `accepted`.
fn check_design(built: &DeviceModel, accepted: bool) -> Result<()> {
    let Some((sensor, parameter, ratio)) = built.largest_deviation() else { return Ok(()) };
    let is_beyond = |limit: f64| !(1.0 / limit..=limit).contains(&ratio);
    let found = format!("{parameter} of sensor {sensor} is fitted as {ratio:.2} times its design");
    if is_beyond(ACCEPTED) && !accepted {
        bail!(
            "{found}, and the forces change by as much: check the unit of the reference and the design in recording.toml; or upload with --far-from-design"
        );
    }
    if is_beyond(STATED) {
        eprintln!("note: {found}");
    }
    Ok(())
}

/// A calibration that was uploaded.
pub struct UploadedCalibration {
    /// Identifier of its tables.
    pub tables: u16,
    sequence: u32,
    bytes: usize,
    took: Duration,
    description: CalibrationDescription,
}

impl UploadedCalibration {
    /// Result in words; `waits` if the gripper was not rebooted.
    pub fn text(&self, waits: bool) -> String {
        let state = if waits { "runs after the next reboot" } else { "runs on the gripper" };
        format!(
            "Calibration {:04x} {state}: {:.1} KiB uploaded in {:.1} s.\n\
             A tare belongs to the former calibration: repeat it without load (`cargo magpie board tare`).\n",
            self.tables,
            self.bytes as f64 / 1024.0,
            self.took.as_secs_f64()
        )
    }
}

/// Uploads a calibration in a session, and reboots the gripper into it unless `reboot` is false.
///
/// # Errors
/// The calibration does not fit the board, or the gripper refuses it or does not answer.
pub fn upload(
    port: &PortArgs,
    source: &mut dyn Source,
    built: &DeviceModel,
    networks: &[Network],
    reboot: bool,
) -> Result<UploadedCalibration> {
    let now = humantime::format_rfc3339_seconds(SystemTime::now()).to_string();
    let description = CalibrationDescription {
        uploaded: Some(now),
        ..CalibrationDescription::of(built, networks)
    };
    let bytes = encode_calibration(built, networks, &description)?;
    let bar = progress::progress_bar("uploading", bytes.len());
    let begun = Instant::now();
    let tables = built.chosen.tables.id;
    let (sequence, took) = port.in_session(source, |session| {
        let sequence =
            calibration_client::upload(session, &bytes, |done| bar.set_position(done as u64))?;
        let took = begun.elapsed();
        bar.finish_and_clear();
        if reboot {
            calibration_client::reboot_into(session, tables)?;
        }
        Ok((sequence, took))
    })?;
    Ok(UploadedCalibration { tables, sequence, bytes: bytes.len(), took, description })
}

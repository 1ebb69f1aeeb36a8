//! `magpie board bringup`: the first power-up of a board, step by step.

use std::io::{BufRead, Write, stdin};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use device::bringup::{self, Action, Expected, Operator, Reading, Record, STEPS};
use model_export::output::{check_output, write_output};
use report::text::terminal;

use crate::commands::args::parse_number;
use crate::commands::connection::{PortArgs, parse_seconds};

/// Switch a new board on for the first time, step by step; THE FINGERS MOVE from step 8 on.
///
/// Twelve steps (firmware/BRING-UP.md), each with what to connect, what is measured and what to do if it is beyond its limits.
/// The record is written after each step; the command goes on where it ended. After the last step, and with --by, it removes the
/// limits of the bench: without that, the gripper refuses more than 20 N, as every board does that was never commissioned.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie board bringup --port /dev/ttyACM0
  cargo magpie board bringup --port /dev/ttyACM0 --torque-constant 0.065 --by 'A. Engineer'
  cargo magpie board bringup --port /dev/ttyACM0 --again 8     # from step 8 on
  cargo magpie board bringup --list")]
pub struct Args {
    #[command(flatten)]
    port: PortArgs,
    /// Print the steps and end.
    #[arg(long)]
    list: bool,
    /// Record of all values.
    #[arg(long, default_value = "bring-up.toml", value_name = "TOML")]
    record: PathBuf,
    /// Repeat the steps from this one on.
    #[arg(long, value_name = "STEP", value_parser = clap::value_parser!(u8).range(1..=STEPS.len() as i64))]
    again: Option<u8>,
    /// Who signs the record once all steps are passed.
    #[arg(long, value_name = "NAME")]
    by: Option<String>,
    /// Phase resistance by the motor's data sheet in ohms [default of this and all below: the assumed motor].
    #[arg(long, value_name = "OHM", value_parser = positive)]
    resistance: Option<f64>,
    /// Phase inductance in millihenries.
    #[arg(long, value_name = "MH", value_parser = positive)]
    inductance: Option<f64>,
    /// Pole pairs.
    #[arg(long, value_name = "COUNT", value_parser = positive)]
    pole_pairs: Option<f64>,
    /// Torque constant in N m per ampere of a phase's amplitude.
    #[arg(long, value_name = "NM_A", value_parser = positive)]
    torque_constant: Option<f64>,
    /// Inertia of rotor and coupling in kg m^2.
    #[arg(long, value_name = "KG_M2", value_parser = positive)]
    inertia: Option<f64>,
    /// Weight of the last step in newtons.
    #[arg(long, default_value = "10", value_name = "N", value_parser = positive)]
    weight: f64,
    /// Observation of the rotor sensor in seconds.
    #[arg(long, default_value = "600", value_name = "S", value_parser = parse_seconds)]
    watch: f64,
}

/// First line of a record.
const MARK: &str = "# bring-up of a gripper\n";

fn positive(text: &str) -> Result<f64, String> {
    parse_number(text, (1e-9, 1e6))
}

/// A person at a terminal.
struct Person;

impl Person {
    fn answer(&self, question: &str) -> Result<String> {
        eprint!("{question} ");
        std::io::stderr().flush()?;
        let mut line = String::new();
        if stdin().lock().read_line(&mut line)? == 0 {
            bail!("no answer: the record keeps the passed steps");
        }
        Ok(line.trim().to_owned())
    }
}

impl Operator for Person {
    fn act(&mut self, action: Action) -> Result<()> {
        if let Action::Connect { step: number, .. } = action {
            let step = &STEPS[number - 1];
            eprintln!("\nStep {number} of {}: {}", STEPS.len(), step.name);
            eprintln!("Expected: {}.", step.expectation());
        }
        self.answer(&format!("{action} [Enter]")).map(|_| ())
    }

    fn read(&mut self, reading: Reading) -> Result<f64> {
        loop {
            match self.answer(&reading.to_string())?.parse() {
                Ok(value) => return Ok(value),
                Err(_) => eprintln!("write a number, as 0.1"),
            }
        }
    }
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    if args.list {
        return Ok(terminal::print(&bringup::document())?);
    }
    let mut record = read(&args.record)?;
    if let Some(again) = args.again {
        record.steps.retain(|done| done.step < usize::from(again));
        record.signed_by = None;
    }
    let assumed = Expected::default();
    let expected = Expected {
        resistance_ohm: args.resistance.unwrap_or(assumed.resistance_ohm),
        inductance_mh: args.inductance.unwrap_or(assumed.inductance_mh),
        pole_pairs: args.pole_pairs.unwrap_or(assumed.pole_pairs),
        torque_nm_a: args.torque_constant.unwrap_or(assumed.torque_nm_a),
        inertia_kg_m2: args.inertia.unwrap_or(assumed.inertia_kg_m2),
        weight_n: args.weight,
        watch: Duration::from_secs_f64(args.watch),
    };
    let mut source = args.port.open_given()?;
    let credentials = args.port.credentials()?;
    let save = |record: &Record| write(&args.record, record);
    bringup::run(source.as_mut(), credentials, &mut Person, expected, &mut record, save)?;
    match &args.by {
        None => {
            eprintln!("All steps are passed. Sign the record: the same command with --by NAME.")
        }
        Some(name) => {
            bringup::sign_off(source.as_mut(), credentials, &mut record, name)?;
            save(&record)?;
            eprintln!("Signed. The limits of the gripper apply from its next boot on.");
        }
    }
    Ok(())
}

fn read(path: &Path) -> Result<Record> {
    check_output(path, MARK)?;
    if !path.exists() {
        return Ok(Record::default());
    }
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    toml::from_str(&text).with_context(|| format!("{}: no record of a bring-up", path.display()))
}

fn write(path: &Path, record: &Record) -> Result<()> {
    let text = MARK.to_owned() + &toml::to_string(record)?;
    Ok(write_output(path, text.as_bytes(), MARK)?)
}

//! `magpie record`: what a gripper's sensors read, written down while it runs.

pub mod campaign_time;
mod report;

use std::path::PathBuf;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, SystemTime};

use anyhow::{Result, anyhow};
use firmware::parameters::table::id;
use firmware::params;
use indicatif::ProgressBar;
use model_export::design::Design;
use model_export::recordings::description::Description;

use super::live::{Gripper, interrupted, parse_seconds};
use crate::live::asking;
use crate::live::hearing::{Hearing, News};
use crate::live::recorder::{Recorder, Tally};
use crate::live::rows::Rows;
use crate::live::source::Source;
use crate::{progress, show};

/// Write down what a gripper's sensors read, as a recording.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie record --port /dev/ttyACM0 -o bench/1 --seconds 30 --note 'lateral, by hand'
  cargo magpie record --can can0 --rate 500 -o bench/2
  cargo magpie record --virtual -o rehearsal/1 --seconds 10    # without hardware

Ctrl-C ends it. Whenever it is killed, what it wrote until the last second is a recording. A serial line
carries every tick, a CAN bus every second one at the most (--rate). The board does not know the forces: put
the reference's table, with t_us from the same start, in the place of force.csv.")]
pub struct Args {
    #[command(flatten)]
    gripper: Gripper,
    /// Folder of the recording; must be empty or not exist yet.
    #[arg(short, long, value_name = "RECORDING")]
    output: PathBuf,
    /// End after this time.
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    seconds: Option<f64>,
    /// What is recorded, in your words.
    #[arg(long, value_name = "TEXT", default_value = "recorded live")]
    note: String,
    /// Seconds since the campaign began; without it, by the dates of the recordings beside this one.
    #[arg(long, value_name = "S")]
    start_s: Option<f64>,
    /// The gripper's nominal design; otherwise MAGPIE's own.
    #[arg(long, value_name = "PATH")]
    design: Option<PathBuf>,
    /// Rows a second over a CAN bus: 100, 250 or 500.
    #[arg(long, value_name = "HZ", default_value_t = 100, requires = "can", value_parser = parse_rate)]
    rate: u32,
    /// Print one JSON object on stdout and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Where nothing comes for this time, the rows so far are written.
const PATIENCE: Duration = Duration::from_millis(250);

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let description = description(args)?;
    let start_s = description.start_s;
    let rows = match args.gripper.is_on_bus() {
        true => Rows::of_sets(1_000_000 / u64::from(args.rate)),
        false => Rows::of_ticks(),
    };
    let recorder = Recorder::new(&args.output, description, rows.period_us())?;
    let mut source = args.gripper.open()?;
    let before = ask_for_readings(source.as_mut(), args)?;
    let hearing = Hearing::start(source);
    let written = write(&hearing, rows, recorder, args);
    let mut source = hearing.stop()?;
    for (id, value) in before {
        // A gripper that is gone starts with what is stored.
        let _ = asking::write(source.as_mut(), id, value);
    }
    let (tally, ended) = written?;
    let page = match args.json {
        true => format!("{}\n", report::json(&args.output, start_s, &tally)),
        false => report::text(&args.output, start_s, &tally),
    };
    show::page(&page)?;
    ended
}

fn description(args: &Args) -> Result<Description> {
    let now = SystemTime::now();
    let start_s = match args.start_s {
        Some(start_s) => start_s,
        None => campaign_time::start_s(&args.output, now)?,
    };
    let mut description = Description::new(args.note.clone(), start_s);
    description.recorded = Some(humantime::format_rfc3339_seconds(now).to_string());
    let design = match &args.design {
        Some(path) => Design::read(path)?,
        None => Design::magpie(),
    };
    // The board's own part, whatever a design may wish.
    description.gauss_per_lsb = Some(params::SENSOR_SCALE.value);
    description.range_gauss = Some(params::SENSOR_RANGE.value);
    description.design = Some(design.nominal());
    Ok(description)
}

/// Has the gripper tell what its sensors read; the values that it had before, to be given back.
fn ask_for_readings(source: &mut dyn Source, args: &Args) -> Result<Vec<(u16, i32)>> {
    let wanted = match args.gripper.is_on_bus() {
        true => vec![(id::RAW, 1), (id::FORCE_RATE, args.rate as i32)],
        false => vec![(id::TELEMETRY, 1)],
    };
    let mut before = Vec::new();
    for (id, value) in wanted {
        let found = asking::read(source, id)?;
        if found != value {
            asking::write(source, id, value)?;
            before.push((id, found));
        }
    }
    Ok(before)
}

/// Writes rows until the time is over, somebody ends it, or nothing more comes; what was written, and how
/// it ended.
fn write(
    hearing: &Hearing,
    mut rows: Rows,
    mut recorder: Recorder,
    args: &Args,
) -> Result<(Tally, Result<()>)> {
    let interrupted = interrupted()?;
    let spinner = progress::rows("recording");
    let end_s = args.seconds.unwrap_or(f64::INFINITY);
    let ended = loop {
        if hearing.elapsed_s() >= end_s || interrupted.load(Relaxed) {
            break Ok(());
        }
        match hearing.news.recv_timeout(PATIENCE) {
            Ok(News::Heard { at_s, packets, .. }) => {
                let mut restarted = false;
                for packet in &packets {
                    match rows.take(at_s, packet) {
                        Ok(None) => {}
                        Ok(Some(row)) => {
                            recorder.take(row)?;
                            spinner.inc(1);
                        }
                        Err(_) => {
                            restarted = true;
                            break;
                        }
                    }
                }
                if restarted {
                    break Err(anyhow!(
                        "the board started anew: a recording is one run, so it ends there; record again, to \
                         another folder"
                    ));
                }
                if packets.is_empty() {
                    recorder.flush()?;
                }
            }
            Ok(News::Failed(error)) => break Err(error),
            Ok(News::Ended) | Err(RecvTimeoutError::Disconnected) => break Ok(()),
            Err(RecvTimeoutError::Timeout) => recorder.flush()?,
        }
    };
    finish(recorder, ended, &spinner)
}

/// Where nothing was recorded, how it ended says why.
fn finish(
    recorder: Recorder,
    ended: Result<()>,
    spinner: &ProgressBar,
) -> Result<(Tally, Result<()>)> {
    spinner.finish_and_clear();
    match (recorder.finish(), ended) {
        (Ok(tally), ended) => Ok((tally, ended)),
        (Err(_), Err(error)) | (Err(error), Ok(())) => Err(error),
    }
}

fn parse_rate(text: &str) -> Result<u32, String> {
    let rate = text
        .parse()
        .ok()
        .filter(|rate| [100, 250, 500].contains(rate));
    rate.ok_or_else(|| "give 100, 250 or 500".to_owned())
}

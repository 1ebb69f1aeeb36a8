//! `magpie record`: writes sensor readings of a running gripper to a recording.

use analysis::numbers;
use analysis::progress;
use analysis::reference_delay::{ReferenceAlignment, align_recording};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, SystemTime};

use anyhow::{Result, anyhow, bail};
use firmware::config::constants;
use firmware::parameters::schema::id;
use indicatif::ProgressBar;
use model_export::output::check_vacant;
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::description::RecordingDescription;
use serde_json::{Value, json};

use crate::commands::args::read_design;
use crate::commands::connection::{GripperArgs, interrupted, parse_seconds};
use device::params_client;
use device::reader::{ReaderEvent, SourceReader};
use device::recorder::{Recorder, RecordingCounts, SensorRowAssembler};
use device::reference::{ReferenceClock, ReferenceMapping, ReferenceReader, ReferenceSource};
use device::source::Source;
use report::text::terminal;

/// Write sensor readings of a running gripper to a recording.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie record --port /dev/ttyACM0 -o bench/1 --seconds 30 --note 'lateral, by hand'
  cargo magpie record --can can0 --rate 500 -o bench/2
  cargo magpie record --port /dev/ttyACM0 --reference /dev/ttyUSB0 --reference-map load-cell.toml -o bench/3
  cargo magpie record --virtual -o rehearsal/1 --seconds 10    # without hardware

Ctrl-C ends the recording. A killed process leaves a valid recording up to the last second. A serial line
carries every tick with the covariates that the board has, a CAN bus at most every second one without them (--rate).

A reference sensor sends lines of numbers; the mapping assigns their columns:

  clock = { column = 1, unit = \"ms\" }                              # optional: the reference's own clock
  columns = [{ column = 2, unit = \"N\", to = \"f0_x_n\", scale = -1 }]

Its clock is aligned with the board's by the loads: vary them, or tap. Without --reference, replace force.csv by the
reference's table, with t_us from the same start.")]
pub struct Args {
    #[command(flatten)]
    gripper: GripperArgs,
    /// Folder of the recording; must be empty or not exist yet.
    #[arg(short, long, value_name = "RECORDING")]
    output: PathBuf,
    /// End after this time.
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    seconds: Option<f64>,
    /// Description of the recording.
    #[arg(long, value_name = "TEXT", default_value = "recorded live")]
    note: String,
    /// Start time within the campaign [default: from the dates of the other recordings].
    #[arg(long, value_name = "S")]
    start_s: Option<f64>,
    /// Nominal design of the gripper [default: MAGPIE].
    #[arg(long, value_name = "PATH")]
    design: Option<PathBuf>,
    /// Reference force sensor: a serial port (PORT or PORT@BAUD), a socket (tcp:HOST:PORT) or - for standard input.
    #[arg(long, value_name = "SOURCE", requires = "reference_map")]
    reference: Option<ReferenceSource>,
    /// Mapping of the reference's columns to those of force.csv.
    #[arg(long, value_name = "PATH", requires = "reference")]
    reference_map: Option<PathBuf>,
    /// Row rate over a CAN bus: 100, 250 or 500.
    #[arg(long, value_name = "HZ", default_value_t = 100, requires = "can", value_parser = parse_rate)]
    rate: u32,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Rows are flushed after this time without data.
const FLUSH_TIMEOUT: Duration = Duration::from_millis(250);

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    check_vacant(&args.output)?;
    let mut description = description(args)?;
    let start_s = description.start_s;
    let rows = if args.gripper.is_on_bus() {
        SensorRowAssembler::of_sets(1_000_000 / u64::from(args.rate))
    } else {
        SensorRowAssembler::of_ticks()
    };
    let mapping = args.reference_map.as_deref().map(ReferenceMapping::read).transpose()?;
    let columns = mapping
        .as_ref()
        .map(|mapping| mapping.columns.iter().map(|force| force.to.clone()).collect::<Vec<_>>());
    let mut source = args.gripper.open()?;
    if let Some(design) = &mut description.design {
        // The electrical angle of the compensation follows from the board's number.
        let pole_pairs = params_client::read(source.as_mut(), id::POLE_PAIRS)?;
        design.more.insert("motor_pole_pairs".to_owned(), i64::from(pole_pairs).into());
    }
    let recorder = Recorder::new(&args.output, description, rows.period_us(), columns)?;
    let previous = enable_readings(source.as_mut(), args)?;
    let hearing = SourceReader::start(source);
    let reference = args.reference.as_ref().zip(mapping);
    let reference = reference
        .map(|(source, mapping)| ReferenceReader::start(source, mapping, hearing.begun))
        .transpose();
    let written =
        reference.and_then(|reference| write_rows(&hearing, reference, rows, recorder, args));
    let mut source = hearing.stop()?;
    for (id, value) in previous {
        // After a loss of connection the gripper restarts with its stored settings.
        let _ = params_client::write(source.as_mut(), id, value);
    }
    let (tally, ended) = written?;
    let alignment = args.reference.is_some().then(|| align_recording(&args.output)).transpose()?;
    terminal::print_result(
        args.json,
        || to_json(&args.output, start_s, &tally, alignment.as_ref()),
        || format_report(&args.output, start_s, &tally, alignment.as_ref()),
    )?;
    ended
}

fn description(args: &Args) -> Result<RecordingDescription> {
    let now = SystemTime::now();
    let start_s = match args.start_s {
        Some(start_s) => start_s,
        None => campaign_time_s(&args.output, now)?,
    };
    let mut description = RecordingDescription::new(args.note.clone(), start_s);
    description.recorded = Some(humantime::format_rfc3339_seconds(now).to_string());
    let design = read_design(args.design.as_deref())?;
    // The sensor of the board, not of the design.
    description.gauss_per_lsb = Some(constants::SENSOR_SCALE.value);
    description.range_gauss = Some(constants::SENSOR_RANGE.value);
    description.design = Some(design.nominal());
    Ok(description)
}

/// Enables transmission of raw readings; returns the previous settings, to be restored.
fn enable_readings(source: &mut dyn Source, args: &Args) -> Result<Vec<(u16, i32)>> {
    let settings = if args.gripper.is_on_bus() {
        vec![(id::RAW, 1), (id::FORCE_RATE, args.rate as i32)]
    } else {
        vec![(id::TELEMETRY, 1)]
    };
    let mut previous = Vec::new();
    for (id, value) in settings {
        let old = params_client::read(source, id)?;
        if old != value {
            params_client::write(source, id, value)?;
            previous.push((id, old));
        }
    }
    Ok(previous)
}

/// Writes rows until the time limit, Ctrl-C or the end of the stream; returns the row counts and the reason of
/// the end.
fn write_rows(
    hearing: &SourceReader,
    reference: Option<ReferenceReader>,
    mut rows: SensorRowAssembler,
    mut recorder: Recorder,
    args: &Args,
) -> Result<(RecordingCounts, Result<()>)> {
    let interrupted = interrupted()?;
    let spinner = progress::row_spinner("recording");
    let end_s = args.seconds.unwrap_or(f64::INFINITY);
    let mut clock = ReferenceClock::default();
    let ended = loop {
        if hearing.elapsed_s() >= end_s || interrupted.load(Relaxed) {
            break Ok(());
        }
        match hearing.news.recv_timeout(FLUSH_TIMEOUT) {
            Ok(ReaderEvent::Packets { at_s, packets, .. }) => {
                let mut restarted = false;
                for packet in &packets {
                    match rows.take(at_s, packet) {
                        Ok(None) => {}
                        Ok(Some(row)) => {
                            clock.board(at_s, row.time_us);
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
                        "the board restarted, which ends the recording; record again to another folder"
                    ));
                }
                if packets.is_empty() {
                    recorder.flush()?;
                }
            }
            Ok(ReaderEvent::Failed(error)) => break Err(error),
            Ok(ReaderEvent::Ended) | Err(RecvTimeoutError::Disconnected) => break Ok(()),
            Err(RecvTimeoutError::Timeout) => recorder.flush()?,
        }
        if let Some(reference) = &reference
            && let Err(error) = take_reference(reference, &mut clock, &mut recorder)
        {
            break Err(error);
        }
    };
    finish(recorder, ended, &spinner)
}

/// Writes the rows of the reference that have arrived.
fn take_reference(
    reference: &ReferenceReader,
    clock: &mut ReferenceClock,
    recorder: &mut Recorder,
) -> Result<()> {
    for row in reference.rows.try_iter() {
        let row = row?;
        if let Some(board_us) = clock.board_us(&row) {
            recorder.take_reference(board_us, &row.force_n)?;
        }
    }
    Ok(())
}

/// Closes the recording. If it is empty, the reason of the end is the error.
fn finish(
    recorder: Recorder,
    ended: Result<()>,
    spinner: &ProgressBar,
) -> Result<(RecordingCounts, Result<()>)> {
    spinner.finish_and_clear();
    match (recorder.finish(), ended) {
        (Ok(tally), ended) => Ok((tally, ended)),
        (Err(_), Err(error)) | (Err(error), Ok(())) => Err(error),
    }
}

fn parse_rate(text: &str) -> Result<u32, String> {
    let rate = text.parse().ok().filter(|rate| [100, 250, 500].contains(rate));
    rate.ok_or_else(|| "give 100, 250 or 500".to_owned())
}

/// Seconds from the start of the campaign to `now`, from the dates and start times of the recordings next to
/// `target`.
///
/// # Errors
/// Another recording is unreadable or has no date with a time.
fn campaign_time_s(target: &Path, now: SystemTime) -> Result<f64> {
    let campaign = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    // No folder, or one without recordings: a new campaign.
    let Ok(folders) = recording_folders(campaign) else {
        return Ok(0.0);
    };
    let mut latest_s = f64::NEG_INFINITY;
    for folder in folders.iter().filter(|folder| *folder != campaign) {
        let (description, _) = RecordingDescription::read(folder)?;
        let recorded = description.recorded.as_deref().unwrap_or_default();
        let Ok(recorded) = humantime::parse_rfc3339_weak(recorded) else {
            bail!(
                "{}: recording.toml has no date with a time (recorded = \"2026-01-31T12:00:00Z\"), so the start time in \
                 the campaign is unknown: give --start-s",
                folder.display()
            );
        };
        // A clock that was set back gives zero, not an earlier start.
        let since = now.duration_since(recorded).unwrap_or_default();
        latest_s = latest_s.max(description.start_s + since.as_secs_f64());
    }
    Ok(if latest_s.is_finite() { latest_s.round() } else { 0.0 })
}

fn format_report(
    output: &Path,
    start_s: f64,
    tally: &RecordingCounts,
    alignment: Option<&ReferenceAlignment>,
) -> String {
    let seconds = |us: u64| us as f64 * 1e-6;
    let numbers = |sensors: &[usize]| {
        let numbers: Vec<String> = sensors.iter().map(usize::to_string).collect();
        numbers.join(", ")
    };
    let mut text = format!(
        "Recorded to {}: {:.1} s, {} rows of sensors {}; start_s = {}.\n",
        output.display(),
        seconds(tally.span_us),
        tally.rows,
        numbers(&tally.sensors),
        numbers::decimal(start_s, 3),
    );
    match tally.gaps {
        0 => text += "No rows lost.\n",
        gaps => {
            let gaps = if gaps == 1 { "1 gap".to_owned() } else { format!("{gaps} gaps") };
            let (longest_us, at_us) = tally.longest_us;
            text += &format!(
                "Lost: {} rows in {gaps} of t_us, the longest {:.1} ms at {:.3} s.\n",
                tally.lost,
                1e3 * seconds(longest_us),
                seconds(at_us),
            );
        }
    }
    text += &match tally.covariates.as_slice() {
        [] => "No covariates: effects of opening, motor and orientation cannot be diagnosed.\n"
            .to_owned(),
        names => terminal::paragraph(&format!("Covariates: {}.", names.join(", "))),
    };
    if !tally.covariates.contains(&"opening_mm") {
        text += "The opening was unknown: home the gripper first.\n";
    }
    if tally.without_covariates > 0 {
        text += &format!(
            "Excluded: {} rows in which a covariate was missing.\n",
            tally.without_covariates
        );
    }
    if tally.left_out > tally.without_covariates {
        let silent = tally.silent.iter().enumerate();
        let silent = silent.filter(|(sensor, count)| **count > 0 && tally.sensors.contains(sensor));
        let silent: Vec<String> =
            silent.map(|(sensor, count)| format!("sensor {sensor} in {count}")).collect();
        text += &terminal::paragraph(&format!(
            "Excluded: {} rows without a reading of all sensors ({}).",
            tally.left_out - tally.without_covariates,
            silent.join(", ")
        ));
    }
    text += &terminal::paragraph(&match alignment {
        None => "force.csv has times but no forces: replace it by the reference's table (t_us from the same start) before \
                 fit, compare and replay."
            .to_owned(),
        Some(ReferenceAlignment { delay: None, .. }) => format!(
            "Reference: {} rows; its delay cannot be determined, because its forces hardly vary: t_us is that of arrival.",
            tally.reference_rows
        ),
        Some(ReferenceAlignment { delay: Some(delay), is_applied }) => {
            let [low_ms, high_ms] = delay.interval_s.map(|s| 1e3 * s);
            format!(
                "Reference: {} rows; delay {:.2} ms, standard error {:.2} ms, 95 % from {low_ms:.2} to {high_ms:.2} ms; the \
                 fields explain {:.1} % of its variance. {}",
                tally.reference_rows,
                1e3 * delay.delay_s,
                1e3 * delay.standard_error_s,
                100.0 * delay.explained,
                if *is_applied {
                    "t_us of force.csv is corrected by it."
                } else {
                    "That is not precise enough: t_us is that of arrival. Vary the loads faster, or tap."
                }
            )
        }
    });
    text
}

fn to_json(
    output: &Path,
    start_s: f64,
    tally: &RecordingCounts,
    alignment: Option<&ReferenceAlignment>,
) -> Value {
    json!({
        "recording": output,
        "start_s": start_s,
        "span_s": tally.span_us as f64 * 1e-6,
        "sensors": tally.sensors,
        "rows": tally.rows,
        "lost_rows": tally.lost,
        "gaps": tally.gaps,
        "longest_gap_s": tally.longest_us.0 as f64 * 1e-6,
        "longest_gap_at_s": tally.longest_us.1 as f64 * 1e-6,
        "covariates": tally.covariates,
        "left_out_rows": tally.left_out,
        "rows_without_covariates": tally.without_covariates,
        "silent_rows": tally.silent,
        "reference": alignment.is_some(),
        "reference_rows": tally.reference_rows,
        "reference_delay": alignment.and_then(|alignment| alignment.delay),
        "reference_delay_applied": alignment.map(|alignment| alignment.is_applied),
    })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tempfile::TempDir;

    use super::*;

    fn recording(campaign: &Path, name: &str, start_s: f64, recorded: Option<&str>) {
        let folder = campaign.join(name);
        std::fs::create_dir(&folder).unwrap();
        let mut description = RecordingDescription::new("", start_s);
        description.recorded = recorded.map(str::to_owned);
        description.write(&folder).unwrap();
    }

    #[test]
    fn start_time_follows_the_dates_of_other_recordings() {
        let campaign = TempDir::new().unwrap();
        let target = campaign.path().join("2");
        let now = SystemTime::UNIX_EPOCH + Duration::from_secs(3600);
        assert_eq!(campaign_time_s(&target, now).unwrap(), 0.0);
        assert_eq!(campaign_time_s(&campaign.path().join("new/1"), now).unwrap(), 0.0);
        recording(campaign.path(), "1", 20.0, Some("1970-01-01T00:50:00Z"));
        assert_eq!(campaign_time_s(&target, now).unwrap(), 20.0 + 600.0);
    }

    #[test]
    fn missing_date_requires_explicit_start_time() {
        let campaign = TempDir::new().unwrap();
        recording(campaign.path(), "1", 0.0, None);
        let error = campaign_time_s(&campaign.path().join("2"), SystemTime::now()).unwrap_err();
        assert!(error.to_string().contains("give --start-s"), "{error}");
    }
}

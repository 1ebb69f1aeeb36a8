//! `magpie record`: writes sensor readings of a running gripper to a recording.

use analysis::diagnose::recording_check::{add_missing_forces, check_recordings};
use analysis::progress;
use analysis::reference_delay::align_recording;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::{RecvTimeoutError, TryRecvError};
use std::time::{Duration, Instant, SystemTime};

use anyhow::{Result, anyhow, bail};
use firmware::config::constants;
use firmware::parameters::schema::id;
use firmware::protocol::serial::Packet;
use indicatif::ProgressBar;
use model_export::design::SensorDesign;
use model_export::fit::FitOptions;
use model_export::input::MAX_START_S;
use model_export::output::check_vacant;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::columns::Axis;
use model_export::recordings::description::{NominalDesign, RecordingDescription};
use model_export::recordings::{Campaign, Recording};

mod guide;
mod summary;

use crate::commands::connection::{GripperArgs, Reference, ReferenceArgs, parse_seconds};
use crate::commands::interrupt::interrupted;
use device::control::result_code::ResultCode;
use device::params_client;
use device::reader::{ReaderEvent, SourceReader};
use device::recorder::{
    Coverage, CoveredRange, ForceEstimates, Recorder, RecordingCounts, SensorRow,
    SensorRowAssembler,
};
use device::reference::{
    HostPose, MAX_WAITING_ROWS, ReferenceClock, ReferenceMapping, ReferenceReader, ReferenceSource,
};
use device::session::{Credentials, with_session};
use device::source::{ConnectionLost, SILENCE, Source};
use guide::Guide;
use report::text::terminal;
use sim::campaign::plan::RecordingPlan;
use summary::{CheckResult, Summary};

/// Write sensor readings of a running gripper to a recording.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie record --port /dev/ttyACM0 -o bench/1 --seconds 30 --note 'lateral, by hand'
  cargo magpie record --can can0 --rate 500 -o bench/2
  cargo magpie record --port /dev/ttyACM0 --reference /dev/ttyUSB0 --reference-map load-cell.toml -o bench/3
  # the recording of diagnose --plan
  cargo magpie record --port /dev/ttyACM0 --plan plan.toml -o bench/4
  cargo magpie record --virtual -o rehearsal/1 --seconds 10 --check    # without hardware
  cargo magpie record --port /dev/ttyACM0 -o bench/5 --mcap bench-5.mcap    # also for Foxglove

Ctrl-C ends the recording. A killed process leaves a valid recording up to the last second; its MCAP file can be \
imported up to its last whole chunk of a second. A serial line carries every tick with the covariates that the board has, a CAN bus at most every second one without them (--rate).

A reference sensor sends lines of numbers; the mapping assigns their columns:

  # optional: the reference's own clock
  clock = { column = 1, unit = \"ms\" }
  columns = [{ column = 2, unit = \"N\", to = \"f0_x_n\", scale = -1 }]

Its clock is aligned with the board's by the loads: vary them, or tap. If it ends before the recording, the exit status is \
20. Without --reference, replace force.csv by the reference's table, with t_us from the same start.

Columns mapped to yaw_rad, with or without roll_rad and pitch_rad (rad, deg) and linear_accel_x_mps2, _y_ and _z_ (m/s2, \
g0; gripper axes, without gravity), are the pose of the arm: it is sent to the board at up to 100 Hz and recorded as the \
board's covariates.

--check shows the covered share of each range while recording. At the end it lists the effects on which a diagnosis of this \
recording alone can decide, and what to record for the others. Forces that the reference does not measure are then those \
that the board estimates, for this list only.")]
pub struct Args {
    #[command(flatten)]
    gripper: GripperArgs,
    /// Folder of the recording; must be empty or not exist yet.
    #[arg(short, long, value_name = "RECORDING")]
    output: PathBuf,
    /// End after this time.
    #[arg(long, value_name = "S", value_parser = parse_seconds)]
    seconds: Option<f64>,
    /// Plan of the recording, step by step; ends after the last one.
    #[arg(long, value_name = "PLAN", conflicts_with = "seconds")]
    plan: Option<PathBuf>,
    /// Number of the recording within the plan.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "plan")]
    plan_recording: u32,
    /// Description of the recording.
    #[arg(long, value_name = "TEXT", default_value = "recorded live")]
    note: String,
    /// Start time within the campaign [default: from the dates of the other recordings].
    #[arg(long, value_name = "S")]
    start_s: Option<f64>,
    /// Nominal design of the gripper [default: MAGPIE].
    #[arg(long, value_name = "PATH")]
    design: Option<PathBuf>,
    #[command(flatten)]
    reference: ReferenceArgs,
    /// Row rate over a CAN bus: 100, 250 or 500.
    #[arg(long, value_name = "HZ", default_value_t = 100, requires = "can", value_parser = parse_rate)]
    rate: u32,
    /// Show the covered ranges, and at the end the effects on which the recording can decide.
    #[arg(long)]
    check: bool,
    /// Also write an MCAP file for Foxglove and others: readings, covariates, reference, the board's estimates and its state.
    #[arg(long, value_name = "FILE")]
    mcap: Option<PathBuf>,
    /// End with standard input too, as with Ctrl-C: a program that started the recording takes it along, however it ends.
    #[arg(long)]
    end_with_stdin: bool,
    /// Print one JSON object on stdout and nothing else.
    #[arg(long)]
    json: bool,
}

/// Rows are flushed after this time without data.
const FLUSH_TIMEOUT: Duration = Duration::from_millis(250);
/// Minimum time between two messages with the pose.
const POSE_PERIOD_S: f64 = 0.01;
/// Maximum time from the start until the board's covariates contain the pose.
const POSE_TIMEOUT_S: f64 = 3.0;
/// Period of the line with the covered ranges.
const COVERAGE_PERIOD: Duration = Duration::from_secs(1);

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    check_vacant(&args.output)?;
    let plan = args.plan.as_deref().map(|path| read_plan(path, args.plan_recording)).transpose()?;
    let mut description = description(args)?;
    let start_s = description.start_s;
    let rows = if args.gripper.is_on_bus() {
        SensorRowAssembler::of_sets(1_000_000 / u64::from(args.rate))
    } else {
        SensorRowAssembler::of_ticks()
    };
    let reference = args.reference.read()?;
    if args.end_with_stdin {
        if reference.as_ref().is_some_and(|reference| reference.source == ReferenceSource::Stdin) {
            bail!("standard input is the reference: leave out --end-with-stdin");
        }
        std::thread::spawn(|| {
            let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
            signal_hook::low_level::raise(signal_hook::consts::SIGINT)
        });
    }
    let mapping = reference.as_ref().map(|reference| &reference.mapping);
    let columns = mapping.map(ReferenceMapping::force_columns);
    let columns = columns.filter(|columns| !columns.is_empty());
    let (has_forces, has_pose) =
        (columns.is_some(), mapping.is_some_and(ReferenceMapping::has_pose));
    let forces = mapping.map(ReferenceMapping::forces).unwrap_or_default();
    let force_range_n = description.design.as_ref().map(NominalDesign::force_range_n);
    let mut source = args.gripper.open()?;
    if let Some(design) = &mut description.design {
        // The electrical angle of the compensation follows from the board's number.
        let pole_pairs = params_client::read(source.as_mut(), id::POLE_PAIRS)?;
        design.more.insert("motor_pole_pairs".to_owned(), i64::from(pole_pairs).into());
    }
    let mut recorder =
        Recorder::new(&args.output, description, rows.period_us(), columns)?.with_pose(has_pose);
    if let Some(path) = &args.mcap {
        recorder = recorder.with_mcap(path)?;
    }
    let credentials = args.gripper.credentials()?;
    let previous = enable_readings(source.as_mut(), args, credentials)?;
    let name = source.name();
    let hearing = SourceReader::start(source);
    let reference = reference
        .map(|Reference { source, mapping, .. }| {
            ReferenceReader::start(&source, mapping, hearing.begun)
        })
        .transpose();
    let coverage =
        Coverage::new(force_range_n.unwrap_or(constants::FORCE_RANGE.value), forces.clone());
    let mut progress = RecordingProgress {
        name,
        guide: plan.map(|plan| Guide::new(plan, coverage.clone())),
        coverage: if args.check { coverage.with_estimates() } else { coverage },
        forces,
        clock: ReferenceClock::default(),
        reference_end_s: None,
        pose_sent_s: f64::NEG_INFINITY,
        poses: 0,
        // A bus carries no covariates.
        waits_for_pose: has_pose && !args.gripper.is_on_bus(),
    };
    let written = reference
        .and_then(|reference| write_rows(&hearing, reference, rows, recorder, &mut progress, args));
    let mut source = hearing.stop()?;
    // After a loss of connection the gripper restarts with its stored settings.
    let _ = write_settings(source.as_mut(), &previous, credentials);
    let (tally, ended) = written?;
    let alignment = has_forces.then(|| align_recording(&args.output)).transpose()?;
    let ranges = progress.coverage.ranges();
    let estimates = progress.coverage.estimates();
    let check = args.check.then(|| check(&args.output, ranges, &estimates));
    let (check, failed) = match check.transpose() {
        Ok(check) => (check, Ok(())),
        Err(error) => (None, Err(error)),
    };
    let summary = Summary {
        output: &args.output,
        start_s,
        tally: &tally,
        alignment: alignment.as_ref(),
        steps: progress.guide.as_ref().map(|guide| guide.results.as_slice()),
        reference_end_s: progress.reference_end_s,
        poses: has_pose.then_some(progress.poses),
        check: check.as_ref(),
        is_on_bus: args.gripper.is_on_bus(),
        is_virtual: args.gripper.is_virtual(),
        is_cut: ended.as_ref().is_err_and(|error| error.is::<ConnectionLost>()),
    };
    terminal::print_result(args.json, || summary.to_json(), || summary.format())?;
    let reference = match progress.reference_end_s {
        None => Ok(()),
        Some(end_s) => Err(ResultCode::ReferenceEnded.error(reference_ended(end_s))),
    };
    ended.and(failed).and(reference)
}

/// One sentence for a person who is recording, and for the end.
fn reference_ended(end_s: f64) -> String {
    format!("the reference ended after {end_s:.1} s: nothing of it is recorded from then on")
}

/// One recording of a plan.
fn read_plan(path: &Path, number: u32) -> Result<RecordingPlan> {
    let plan = RecordingPlan::read(path)?;
    plan.recording(number).ok_or_else(|| {
        anyhow!("{}: --plan-recording {number}; the plan has {}", path.display(), plan.recordings)
    })
}

/// Checks a finished recording; forces that it lacks are the board's estimates.
fn check(
    folder: &Path,
    ranges: Vec<CoveredRange>,
    estimates: &ForceEstimates,
) -> Result<CheckResult> {
    let spinner = progress::status_spinner("checking the recording");
    let mut recording = Recording::read(folder, Alignment { delay_us: 0.0 })?;
    let estimated_forces = add_missing_forces(&mut recording, estimates);
    let campaign = Campaign { folder: folder.to_path_buf(), recordings: vec![recording] };
    let effects = check_recordings(&campaign, FitOptions::default());
    spinner.finish_and_clear();
    Ok(CheckResult { ranges, estimated_forces, effects })
}

/// Shares of the needed ranges in one line.
fn coverage_line(ranges: &[CoveredRange]) -> String {
    let share = |range: &CoveredRange| format!("{} {:.0} %", range.quantity, 100.0 * range.share());
    ranges.iter().map(share).collect::<Vec<_>>().join(", ")
}

/// What is known while recording.
struct RecordingProgress {
    /// Name of the line or bus.
    name: String,
    coverage: Coverage,
    /// Forces of the reference, in the order of its rows.
    forces: Vec<(u32, Axis)>,
    /// Steps of the plan, if there is one.
    guide: Option<Guide>,
    clock: ReferenceClock,
    /// Time in the recording at which the reference ended, before the recording did.
    reference_end_s: Option<f64>,
    /// Time of the last pose sent to the board.
    pose_sent_s: f64,
    poses: u64,
    /// Rows are dropped until the board's covariates contain the pose.
    waits_for_pose: bool,
}

impl RecordingProgress {
    /// Whether a row is recorded.
    fn is_ready(&mut self, at_s: f64, row: &SensorRow) -> bool {
        let has_pose = row.covariates.attitude.is_some();
        self.waits_for_pose &= !has_pose && at_s < POSE_TIMEOUT_S;
        !self.waits_for_pose
    }

    /// Adds a row to the present step of the plan; at its end, shows the next one.
    fn guide(&mut self, row: &SensorRow, spinner: &ProgressBar) {
        let Some(guide) = &mut self.guide else { return };
        if guide.update(row) && !guide.is_finished() {
            spinner.suspend(|| eprintln!("Enough. {}", guide.instruction()));
        }
    }

    /// Sends a pose that arrived at `at_s` to the board, at most at 100 Hz.
    fn send_pose(&mut self, hearing: &SourceReader, pose: HostPose, at_s: f64) {
        if at_s < self.pose_sent_s + POSE_PERIOD_S {
            return;
        }
        self.pose_sent_s = at_s;
        self.poses += 1;
        let measured = hearing.begun + Duration::from_secs_f64(at_s);
        let messages = move || pose.messages(measured.elapsed());
        // Where the reader has ended, its last event has the reason.
        let _ = hearing.outgoing.send(Box::new(messages));
    }
}

fn description(args: &Args) -> Result<RecordingDescription> {
    let now = SystemTime::now();
    let start_s = match args.start_s {
        Some(start_s) if !(-MAX_START_S..=MAX_START_S).contains(&start_s) => {
            bail!("--start-s {start_s:?} is not possible here; give seconds up to {MAX_START_S:e}")
        }
        Some(start_s) => start_s,
        None => campaign_time_s(&args.output, now)?,
    };
    let mut description = RecordingDescription::new(args.note.clone(), start_s);
    description.recorded = Some(humantime::format_rfc3339_seconds(now).to_string());
    let design = SensorDesign::read_or_magpie(args.design.as_deref())?;
    // The sensor of the board, not of the design.
    description.gauss_per_lsb = Some(constants::SENSOR_SCALE.value);
    description.range_gauss = Some(constants::SENSOR_RANGE.value);
    description.design = Some(design.nominal());
    Ok(description)
}

/// Enables transmission of raw readings; returns the previous settings, to be restored.
fn enable_readings(
    source: &mut dyn Source,
    args: &Args,
    credentials: Credentials,
) -> Result<Vec<(u16, i32)>> {
    let settings = if args.gripper.is_on_bus() {
        vec![(id::RAW, 1), (id::FORCE_RATE, args.rate as i32)]
    } else {
        vec![(id::TELEMETRY, 1)]
    };
    let (mut changed, mut previous) = (Vec::new(), Vec::new());
    for (id, value) in settings {
        let old = params_client::read(source, id)?;
        if old != value {
            changed.push((id, value));
            previous.push((id, old));
        }
    }
    write_settings(source, &changed, credentials)?;
    Ok(previous)
}

fn write_settings(
    source: &mut dyn Source,
    settings: &[(u16, i32)],
    credentials: Credentials,
) -> Result<()> {
    if settings.is_empty() {
        return Ok(());
    }
    with_session(source, credentials, |session| {
        settings.iter().try_for_each(|(id, value)| params_client::write(session, *id, *value))
    })
}

/// Writes rows until the time limit, Ctrl-C or the end of the stream; returns the row counts and the reason of
/// the end.
fn write_rows(
    hearing: &SourceReader,
    mut reference: Option<ReferenceReader>,
    mut rows: SensorRowAssembler,
    mut recorder: Recorder,
    recorded: &mut RecordingProgress,
    args: &Args,
) -> Result<(RecordingCounts, Result<()>)> {
    let interrupted = interrupted()?;
    let spinner = progress::row_spinner("recording");
    let end_s = args.seconds.unwrap_or(f64::INFINITY);
    if let Some(guide) = &recorded.guide {
        spinner.suspend(|| eprintln!("{}", guide.instruction()));
    }
    let (mut shown, mut received_s) = (Instant::now(), 0.0);
    let ended = loop {
        if (args.check || recorded.guide.is_some()) && shown.elapsed() >= COVERAGE_PERIOD {
            shown = Instant::now();
            let line = match &recorded.guide {
                Some(guide) => guide.status(),
                None => coverage_line(&recorded.coverage.ranges()),
            };
            if std::io::stderr().is_terminal() {
                spinner.set_message(line);
            } else {
                eprintln!("covered: {line}");
            }
        }
        let is_finished = recorded.guide.as_ref().is_some_and(Guide::is_finished);
        if is_finished || hearing.elapsed_s() >= end_s || interrupted.load(Relaxed) {
            break Ok(());
        }
        match hearing.news.recv_timeout(FLUSH_TIMEOUT) {
            Ok(ReaderEvent::Packets { at_s, packets, .. }) => {
                let mut restarted = false;
                for packet in &packets {
                    if let Packet::Message { message, .. } = packet {
                        recorder.take_message(message)?;
                    }
                    match rows.take(at_s, packet) {
                        Ok(None) => {}
                        Ok(Some(row)) if !recorded.is_ready(at_s, &row) => {}
                        Ok(Some(row)) => {
                            recorded.clock.board(at_s, row.time_us);
                            recorded.coverage.update(&row);
                            recorded.guide(&row, &spinner);
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
                if !packets.is_empty() {
                    received_s = at_s;
                } else if at_s > received_s + SILENCE.as_secs_f64() {
                    break Err(ConnectionLost::silent(&recorded.name).into());
                } else {
                    recorder.flush()?;
                }
            }
            Ok(ReaderEvent::Failed(error)) => break Err(error),
            Ok(ReaderEvent::Ended) | Err(RecvTimeoutError::Disconnected) => break Ok(()),
            Err(RecvTimeoutError::Timeout) => recorder.flush()?,
        }
        let Some(reader) = &reference else { continue };
        match take_reference(reader, hearing, recorded, &mut recorder) {
            Ok(true) => {}
            Ok(false) => {
                reference = None;
                let end_s = 1e-6 * recorder.elapsed_us() as f64;
                recorded.reference_end_s = Some(end_s);
                spinner.suspend(|| eprintln!("Note: {}.", reference_ended(end_s)));
            }
            Err(error) => break Err(error),
        }
    };
    finish(recorder, ended, &spinner)
}

/// Writes the forces of the rows of the reference that have arrived, and sends the newest pose to the board; returns false once the
/// reference has ended.
fn take_reference(
    reference: &ReferenceReader,
    hearing: &SourceReader,
    recorded: &mut RecordingProgress,
    recorder: &mut Recorder,
) -> Result<bool> {
    let (mut newest, mut goes_on) = (None, true);
    for _ in 0..MAX_WAITING_ROWS {
        let row = match reference.rows.try_recv() {
            Ok(row) => row?,
            Err(error) => {
                goes_on = error == TryRecvError::Empty;
                break;
            }
        };
        newest = Some((row.pose, row.at_s));
        if let Some(board_us) = recorded.clock.board_us(row.at_s, row.clock_s)
            && !row.force_n.is_empty()
        {
            recorder.take_reference(board_us, &row.force_n)?;
            for (key, newtons) in recorded.forces.iter().zip(&row.force_n) {
                recorded.coverage.update_force(*key, *newtons);
                if let Some(guide) = &mut recorded.guide {
                    guide.update_force(*key, *newtons);
                }
            }
        }
    }
    if let Some((pose, at_s)) = newest.filter(|(pose, _)| *pose != HostPose::default()) {
        recorded.send_pose(hearing, pose, at_s);
    }
    Ok(goes_on)
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

//! The gripper of the workbench: watched in the background next to a reference force sensor, recorded by a process of its own,
//! and calibrated.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use device::format;
use device::reader::{ReaderEvent, SourceReader};
use device::reference::ReferenceReader;
use device::source::Source;
use device::state::GripperState;
use firmware::protocol::host_session::service;
use firmware::protocol::session::op;
use model_export::inverse::build::DeviceModel;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::commands::connection::{PortArgs, Reference};
use crate::commands::upload::{UploadedCalibration, upload};
use device::session::check_protocol;

/// Time after which the watching thread looks whether it should end.
const WAIT: Duration = Duration::from_millis(100);
/// Time for a recording to align its reference and to complete its files.
const ENDING: Duration = Duration::from_secs(10);
/// Lines of a recording that are shown.
const SHOWN_LINES: usize = 12;
/// Limits of a recording in seconds, as the page states them.
const SECONDS: RangeInclusive<f64> = 1.0..=36_000.0;

/// A recording to start: by a plan, or for a time.
#[derive(Deserialize)]
pub struct RecordRequest {
    output: PathBuf,
    plan: Option<PathBuf>,
    seconds: Option<f64>,
}

/// A gripper that is watched in the background, but for uploads.
pub struct LiveGripper {
    name: String,
    port: PortArgs,
    reference: Option<Reference>,
    state: Arc<Mutex<LiveState>>,
    watching: Mutex<Option<Watching>>,
    recording: Mutex<Option<RecordingProcess>>,
}

/// The thread that watches, and the request to end it.
struct Watching {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<SourceReader>,
}

/// A recording by a process of its own, `magpie record`.
struct RecordingProcess {
    child: Child,
    /// It ends when this is closed: by [`RecordingProcess::end`], or with this process, however that ends.
    stdin: Option<ChildStdin>,
    /// When it was first asked to end.
    asked: Option<Instant>,
    /// What it prints, the last lines.
    lines: Arc<Mutex<VecDeque<String>>>,
    readers: Vec<JoinHandle<()>>,
    /// Whether it uses the connection, which is watched again after its end.
    uses_connection: bool,
}

impl RecordingProcess {
    fn start(arguments: &[String], uses_connection: bool) -> Result<Self> {
        let program = std::env::current_exe().context("the path of this program is unknown")?;
        let mut child = Command::new(program)
            .arg("record")
            .args(arguments)
            .arg("--end-with-stdin")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .context("the recording cannot be started")?;
        let lines = Arc::new(Mutex::new(VecDeque::new()));
        let read = |source: Option<Box<dyn Read + Send>>| {
            let shown = lines.clone();
            std::thread::spawn(move || {
                let source = source.into_iter().flat_map(|source| BufReader::new(source).lines());
                for line in source.map_while(Result::ok) {
                    let mut shown = shown.lock().unwrap_or_else(PoisonError::into_inner);
                    shown.push_back(line);
                    if shown.len() > SHOWN_LINES {
                        shown.pop_front();
                    }
                }
            })
        };
        let stdout = child.stdout.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>);
        let stderr = child.stderr.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>);
        let readers = vec![read(stdout), read(stderr)];
        let stdin = child.stdin.take();
        Ok(Self { child, stdin, asked: None, lines, readers, uses_connection })
    }

    fn goes_on(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Whether it goes on, and what it printed.
    fn status(&mut self) -> (bool, String) {
        let goes_on = self.goes_on();
        if !goes_on {
            // What was printed last.
            self.readers.drain(..).for_each(|reader| drop(reader.join()));
        }
        let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        (goes_on, lines.iter().map(String::as_str).collect::<Vec<_>>().join("\n"))
    }

    /// Asks it to end, as Ctrl-C does; what was recorded is kept. One that does not end is killed by a later request.
    fn end(&mut self) -> Result<()> {
        self.stdin = None;
        if self.asked.get_or_insert_with(Instant::now).elapsed() > ENDING {
            self.child.kill()?;
        }
        Ok(())
    }
}

/// What a gripper sends, or why nothing more follows.
struct LiveState {
    gripper: GripperState,
    /// Start of the gripper's times.
    start: Instant,
    ended: Option<String>,
    /// The newest forces of the reference in newtons, in the order of its mapping, and the time of their arrival in seconds.
    reference: Option<(f64, Vec<f64>)>,
    /// Why nothing more comes from the reference.
    reference_error: Option<String>,
}

impl LiveState {
    fn new(start: Instant) -> Self {
        Self {
            gripper: GripperState::default(),
            start,
            ended: None,
            reference: None,
            reference_error: None,
        }
    }
}

/// Time without a line after which the reference is not shown, in seconds.
const SILENT_S: f64 = 1.0;

impl LiveGripper {
    /// Watches a gripper.
    ///
    /// # Errors
    /// The thread cannot be started, or the reference cannot be opened.
    pub fn new(
        source: Box<dyn Source + Send>,
        port: PortArgs,
        reference: Option<Reference>,
    ) -> Result<Self> {
        let live = Self {
            name: source.name(),
            port,
            reference,
            state: Arc::new(Mutex::new(LiveState::new(Instant::now()))),
            watching: Mutex::new(None),
            recording: Mutex::new(None),
        };
        live.watch(source)?;
        Ok(live)
    }

    fn watch(&self, mut source: Box<dyn Source + Send>) -> Result<()> {
        // Requests the version; a listen-only connection still receives data.
        let _ = source.send(service(op::VERSION, 0));
        let reader = SourceReader::start(source);
        let (shared, stop) = (self.state.clone(), Arc::new(AtomicBool::new(false)));
        *shared.lock().unwrap_or_else(PoisonError::into_inner) = LiveState::new(reader.begun);
        let open = |one: &Reference| {
            ReferenceReader::start(&one.source, one.mapping.clone(), reader.begun)
        };
        let reference = self.reference.as_ref().map(open).transpose()?;
        let stopped = stop.clone();
        let thread = std::thread::Builder::new().name("gripper".to_owned()).spawn(move || {
            while !stopped.load(Ordering::Relaxed) {
                let event = reader.news.recv_timeout(WAIT);
                let mut state = shared.lock().unwrap_or_else(PoisonError::into_inner);
                for row in reference.iter().flat_map(|reference| reference.rows.try_iter()) {
                    match row {
                        Ok(row) => state.reference = Some((row.at_s, row.force_n)),
                        Err(error) => state.reference_error = Some(format!("{error:#}")),
                    }
                }
                let event = match event {
                    Ok(event) => event,
                    Err(RecvTimeoutError::Timeout) => continue,
                    Err(RecvTimeoutError::Disconnected) => ReaderEvent::Ended,
                };
                let ended = match event {
                    ReaderEvent::Packets { at_s, packets, broken } => {
                        state.gripper.lost.broken = broken;
                        packets.iter().for_each(|packet| state.gripper.update(at_s, packet));
                        check_protocol(&state.gripper).err().map(|error| format!("{error:#}"))
                    }
                    ReaderEvent::Failed(error) => Some(format!("{error:#}")),
                    ReaderEvent::Ended => Some("The connection ended.".to_owned()),
                };
                if ended.is_some() {
                    state.ended = ended;
                    break;
                }
            }
            reader
        })?;
        *self.watching.lock().unwrap_or_else(PoisonError::into_inner) =
            Some(Watching { stop, thread });
        Ok(())
    }

    /// Ends the watching and returns the connection.
    fn release(&self) -> Result<Box<dyn Source + Send>> {
        let watching = self.watching.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Watching { stop, thread } =
            watching.context("the gripper is in use: an upload or a recording is under way")?;
        stop.store(true, Ordering::Relaxed);
        let reader = thread.join();
        reader.map_err(|_| anyhow!("the thread that watches the gripper panicked"))?.stop()
    }

    /// Starts a recording. A gripper has one connection, so that it is not watched meanwhile; a virtual board records one of its
    /// own.
    ///
    /// # Errors
    /// A recording or an upload is under way, or the process cannot be started.
    pub fn record(&self, request: &RecordRequest) -> Result<()> {
        let mut recording = self.recording.lock().unwrap_or_else(PoisonError::into_inner);
        if recording.as_mut().is_some_and(RecordingProcess::goes_on) {
            bail!("a recording is under way");
        }
        let seconds = request.seconds.filter(|seconds| SECONDS.contains(seconds));
        let end = match (&request.plan, seconds) {
            (Some(plan), _) => format!("--plan={}", plan.display()),
            (None, Some(seconds)) => format!("--seconds={seconds}"),
            (None, None) => bail!(
                "a recording takes {} to {} seconds, or has a plan",
                SECONDS.start(),
                SECONDS.end()
            ),
        };
        let uses_connection = self.port.is_given();
        let mut arguments = if uses_connection {
            drop(self.release()?);
            self.port.arguments()
        } else {
            vec!["--virtual".to_owned()]
        };
        arguments.extend([format!("--output={}", request.output.display()), end]);
        // A virtual board records its own loads.
        if let Some(reference) = self.reference.as_ref().filter(|_| uses_connection) {
            arguments.extend(reference.arguments());
        }
        let started = RecordingProcess::start(&arguments, uses_connection);
        if started.is_err() && uses_connection {
            self.watch_again();
        }
        *recording = Some(started?);
        Ok(())
    }

    /// Opens the connection again and watches it.
    fn watch_again(&self) {
        let again = self.port.open_given().and_then(|source| self.watch(source));
        if let Err(error) = again {
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            state.ended = Some(format!("{error:#}"));
        }
    }

    /// State of the recording, if there was one; watches the gripper again after its end.
    fn recording_json(&self) -> Value {
        let mut recording = self.recording.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(process) = recording.as_mut() else {
            return Value::Null;
        };
        let (goes_on, lines) = process.status();
        // Once: later an upload may have the connection.
        if !goes_on && std::mem::take(&mut process.uses_connection) {
            self.watch_again();
        }
        json!({ "goes_on": goes_on, "lines": lines })
    }

    /// Asks the recording to end, as Ctrl-C does.
    ///
    /// # Errors
    /// None is under way.
    pub fn end_recording(&self) -> Result<()> {
        let mut recording = self.recording.lock().unwrap_or_else(PoisonError::into_inner);
        let recording = recording.as_mut().context("there is no recording")?;
        if recording.goes_on() { recording.end() } else { bail!("the recording has ended") }
    }

    /// Uploads a calibration; the gripper is not watched meanwhile.
    ///
    /// # Errors
    /// The board is virtual or in use, or the upload fails.
    pub fn upload(&self, built: &DeviceModel) -> Result<UploadedCalibration> {
        if !self.port.is_given() {
            bail!(
                "a virtual board takes no calibration: give --port or --can, also of `cargo magpie dev emulate`"
            );
        }
        let mut source = self.release()?;
        let uploaded = upload(&self.port, source.as_mut(), built, &[], true);
        self.watch(source)?;
        uploaded
    }

    /// Forces of the reference by sensor, none while it is silent; null without a reference.
    fn reference_json(&self, state: &LiveState, now_s: f64) -> Value {
        let Some(reference) = &self.reference else {
            return Value::Null;
        };
        let newest = state.reference.as_ref().filter(|(at_s, _)| now_s - at_s < SILENT_S);
        let values = newest.map_or(&[][..], |(_, force_n)| force_n);
        let forces = reference.mapping.forces().into_iter().zip(values).map(
            |((sensor, axis), newtons)| {
                json!({ "sensor": sensor, "axis": axis.letter(), "newtons": newtons })
            },
        );
        json!({ "forces": forces.collect::<Vec<_>>(), "error": state.reference_error })
    }

    /// What the gripper and the reference send, and the state of the recording.
    pub fn to_json(&self) -> Value {
        let recording = self.recording_json();
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let now_s = state.start.elapsed().as_secs_f64();
        json!({
            "name": self.name, "ended": state.ended, "recording": recording,
            "state": format::state_json(&state.gripper, now_s),
            "reference": self.reference_json(&state, now_s),
        })
    }
}

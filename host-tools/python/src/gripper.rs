//! A gripper on a line or bus. The session that keeps it alive has its own thread, as in `magpie grasp`, which no Python code delays.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use device::control::outcome::Outcome;
use device::control::result_code::ResultCode;
use device::control::session::{Session, View};
use device::control::{Request, SessionOptions, WidthWindow};
use device::{connect, key_file};
use firmware::grip::commands::GripProfile;
use firmware::protocol::DEFAULT_NODE;
use pyo3::create_exception;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyString;
use serde_json::{Value, json};

use crate::{interrupt, to_text, with_arguments};

create_exception!(
    magpie,
    GripperError,
    PyRuntimeError,
    "A gripper that did not do what was requested. Attributes: code and status as in the results of `cargo magpie grasp`, and data, the result as JSON."
);

/// Interval between two looks at a session.
const POLL: Duration = Duration::from_millis(10);

/// Connection to a gripper. Each call opens it; from a grasp to its release it stays open.
#[pyclass(frozen)]
pub struct Gripper {
    port: Option<String>,
    bus: Option<String>,
    node: u16,
    key: Option<PathBuf>,
    grasp: Mutex<Option<Running>>,
}

/// A session in its own thread.
struct Running {
    thread: JoinHandle<Outcome>,
    interrupted: Arc<AtomicBool>,
    view: Arc<Mutex<View>>,
}

#[pymethods]
impl Gripper {
    #[new]
    #[pyo3(signature = (port, can, node, key))]
    fn new(
        py: Python<'_>,
        port: Option<String>,
        can: Option<String>,
        node: Option<u16>,
        key: Option<PathBuf>,
    ) -> PyResult<Self> {
        let node = node.unwrap_or(DEFAULT_NODE);
        let gripper = Self { port, bus: can, node, key, grasp: Mutex::default() };
        gripper.ask(py, |gripper, _| {
            gripper.session(SessionOptions::default(), &Arc::default()).map(|_| json!({}))
        })?;
        Ok(gripper)
    }

    fn status(&self, py: Python<'_>) -> PyResult<Py<PyString>> {
        self.ask(py, |gripper, interrupted| {
            let of_session = || {
                let running = gripper.running();
                let running = running.as_ref().filter(|running| !running.thread.is_finished())?;
                Some(lock(&running.view).clone())
            };
            while let Some(view) = of_session() {
                // It has just begun where the gripper has not said anything yet.
                if view.measured.force_n.is_some() || interrupted.load(Relaxed) {
                    return Ok(json!(view));
                }
                thread::sleep(POLL);
            }
            Ok(json!(gripper.session(SessionOptions::default(), interrupted)?.observe()?))
        })
    }

    #[allow(clippy::too_many_arguments, reason = "one for each of the Python function")]
    fn grasp(
        &self,
        py: Python<'_>,
        force_n: Option<f64>,
        position_mm: Option<f64>,
        profile: Option<String>,
        speed_mm_s: Option<f64>,
        width: Option<(f64, f64)>,
        home: bool,
        clear_faults: bool,
        uncalibrated: bool,
    ) -> PyResult<Py<PyString>> {
        self.ask(py, |gripper, interrupted| {
            let request = match (force_n, position_mm) {
                (Some(set_n), None) if !uncalibrated => {
                    let profile = profile.as_deref().map(parse_profile).transpose()?;
                    let window = width.map(|(width_mm, half_mm)| WidthWindow {
                        width_mm,
                        half_mm,
                        is_fast: false,
                    });
                    Request::force(set_n, profile, speed_mm_s, window)?
                }
                (None, Some(mm)) if profile.is_none() && width.is_none() => {
                    Request::position(mm, speed_mm_s, uncalibrated)?
                }
                _ => {
                    bail!("give force_n, with profile or width, or position_mm, with uncalibrated")
                }
            };
            let options = SessionOptions { home, clear_faults, ..SessionOptions::default() };
            gripper.begin(request, options, interrupted)
        })
    }

    fn release(&self, py: Python<'_>, opening_mm: Option<f64>) -> PyResult<Py<PyString>> {
        self.ask(py, |gripper, interrupted| {
            let ended = gripper.end();
            if opening_mm.is_none()
                && let Some(outcome) = ended
            {
                return result(outcome);
            }
            let request = Request::release(opening_mm)?;
            gripper.begin(request, SessionOptions::default(), interrupted)
        })
    }

    fn stop(&self, py: Python<'_>) -> PyResult<Py<PyString>> {
        self.ask(py, |gripper, interrupted| {
            if let Some(grasp) = gripper.running().take() {
                // The second interrupt of a session is its emergency stop.
                while !grasp.thread.is_finished() {
                    grasp.interrupted.store(true, Relaxed);
                    thread::sleep(Duration::from_millis(1));
                }
            }
            let state = gripper.session(SessionOptions::default(), interrupted)?.stop()?;
            Ok(json!({ "state": state }))
        })
    }

    /// Opens what a grasp of this object holds, and closes the connection; moves nothing else.
    fn close(&self, py: Python<'_>) -> PyResult<Py<PyString>> {
        self.ask(py, |gripper, _| gripper.end().map_or(Ok(Value::Null), result))
    }
}

/// As [`Gripper::close`], also at the end of the program: an exit in the middle would leave the fingers anywhere.
impl Drop for Gripper {
    fn drop(&mut self) {
        if let Some(running) = self.running().take() {
            running.interrupted.store(true, Relaxed);
            let _ = running.thread.join();
        }
    }
}

impl Gripper {
    fn running(&self) -> MutexGuard<'_, Option<Running>> {
        lock(&self.grasp)
    }

    fn session(&self, options: SessionOptions, interrupted: &Arc<AtomicBool>) -> Result<Session> {
        let source = connect::open(self.port.as_deref(), self.bus.as_deref(), self.node)?;
        let source = source.context("give port= or can=")?;
        let credentials = key_file::credentials(self.node, self.key.clone())?;
        Ok(Session::new(source, credentials, options, interrupted.clone()))
    }

    /// Runs a request until its set-point is reached; a grasp goes on in its thread.
    fn begin(
        &self,
        request: Request,
        options: SessionOptions,
        interrupted: &Arc<AtomicBool>,
    ) -> Result<Value> {
        let mut running = self.running();
        if running.as_ref().is_some_and(|running| !running.thread.is_finished()) {
            return Err(ResultCode::Refused.error(
                "this object moves the gripper or holds something: release() it, or stop() the gripper, first",
            ));
        }
        let session = self.session(options, interrupted)?;
        let view = session.view();
        let thread = thread::Builder::new()
            .name("magpie gripper".to_owned())
            .spawn(move || session.run(request))
            .context("no thread for the gripper")?;
        *running = Some(Running { thread, interrupted: interrupted.clone(), view: view.clone() });
        drop(running);
        // Without the lock, so that another thread of the program can stop the gripper.
        loop {
            let mut running = self.running();
            let is_own = |running: &mut Running| Arc::ptr_eq(&running.view, &view);
            let Some(own) = running.take_if(is_own) else {
                let code = ResultCode::Interrupted;
                return Err(code.error("another thread of this program ended the motion"));
            };
            if own.thread.is_finished() {
                drop(running);
                return result(joined(own.thread));
            }
            *running = Some(own);
            drop(running);
            let seen = lock(&view).clone();
            if seen.is_reached && matches!(request, Request::Force { .. }) {
                return Ok(json!(seen));
            }
            thread::sleep(POLL);
        }
    }

    /// Ends a grasp: how it ended.
    fn end(&self) -> Option<Outcome> {
        let grasp = self.running().take()?;
        grasp.interrupted.store(true, Relaxed);
        Some(joined(grasp.thread))
    }

    /// Works without the interpreter's lock; Ctrl-C ends it as it ends the command.
    fn ask(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Self, &Arc<AtomicBool>) -> Result<Value> + Send,
    ) -> PyResult<Py<PyString>> {
        let stop = Arc::new(AtomicBool::new(false));
        let value = interrupt::run_with(py, &stop, to_python, || work(self, &stop))?;
        Ok(to_text(py, &value))
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn joined(thread: JoinHandle<Outcome>) -> Outcome {
    thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

/// The result of a session that was to end.
fn result(outcome: Outcome) -> Result<Value> {
    let value = outcome.result_json();
    match outcome.error {
        None => Ok(value),
        Some(error) => Err(error.context(Ended(value))),
    }
}

/// Result of a session with an error, which its text leaves out.
#[derive(Debug)]
struct Ended(Value);

impl std::fmt::Display for Ended {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.0["error"].as_str().unwrap_or_default())
    }
}

/// The exception of an error, with its code.
fn to_python(py: Python<'_>, error: anyhow::Error) -> PyErr {
    let data = error.downcast_ref::<Ended>().map_or(Value::Null, |ended| ended.0.clone());
    let code = ResultCode::of(&error);
    let raised = match error.downcast_ref::<Ended>() {
        Some(ended) => ended.to_string(),
        None => format!("{error:#}"),
    };
    let raised = GripperError::new_err(with_arguments(&raised));
    let value = raised.value(py);
    let set = value
        .setattr("code", code.name())
        .and_then(|()| value.setattr("status", code.status()))
        .and_then(|()| value.setattr("data", to_text(py, &data)));
    set.err().unwrap_or(raised)
}

fn parse_profile(name: &str) -> Result<GripProfile> {
    Ok(match name {
        "fragile" => GripProfile::Fragile,
        "normal" => GripProfile::Normal,
        "strong" => GripProfile::Strong,
        _ => bail!("profile={name:?} is not possible here; give fragile, normal or strong"),
    })
}

//! Work that Ctrl-C can end: on a thread of its own, while the interpreter's thread handles signals.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Error, Result};
use pyo3::prelude::*;

use crate::to_python;

/// Interval between two looks at the signals.
const POLL: Duration = Duration::from_millis(50);

/// Runs `work` without the interpreter's lock; it receives a flag that Ctrl-C sets. Work that does not look at the flag is
/// finished before the exception is raised.
pub fn run<T: Send>(
    py: Python<'_>,
    work: impl FnOnce(&AtomicBool) -> Result<T> + Send,
) -> PyResult<T> {
    let stop = AtomicBool::new(false);
    run_with(py, &stop, to_python, || work(&stop))
}

/// As [`run`], with this flag, and the exception that `raised` makes of an error.
pub fn run_with<T: Send>(
    py: Python<'_>,
    stop: &AtomicBool,
    raised: fn(Python<'_>, Error) -> PyErr,
    work: impl FnOnce() -> Result<T> + Send,
) -> PyResult<T> {
    py.detach(|| {
        let (running, ended) = mpsc::channel::<()>();
        std::thread::scope(|scope| {
            let worker = scope.spawn(move || {
                let _running = running;
                work()
            });
            let mut interrupt = None;
            while ended.recv_timeout(POLL) == Err(RecvTimeoutError::Timeout) {
                if let Err(error) = Python::attach(|py| py.check_signals()) {
                    stop.store(true, Ordering::Relaxed);
                    interrupt = Some(error);
                }
            }
            let result = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            let raise = |error| Python::attach(|py| raised(py, error));
            interrupt.map_or_else(|| result.map_err(raise), Err)
        })
    })
}

/// A Python function that is called with the stage of the work and the share that is done. An exception in it ends the work.
pub struct Progress {
    function: Option<Py<PyAny>>,
    raised: Mutex<Option<PyErr>>,
}

impl Progress {
    pub fn new(function: Option<Py<PyAny>>) -> Self {
        Self { function, raised: Mutex::new(None) }
    }

    /// Calls the function, unless the work is about to end.
    pub fn call(&self, stop: &AtomicBool, stage: &str, share: f64) {
        let Some(function) = self.function.as_ref().filter(|_| !stop.load(Ordering::Relaxed))
        else {
            return;
        };
        let called = Python::attach(|py| function.call1(py, (stage, share)).map(drop));
        if let Err(error) = called {
            stop.store(true, Ordering::Relaxed);
            *self.raised.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
        }
    }

    /// # Errors
    /// The exception of the function.
    pub fn finish(self) -> PyResult<()> {
        let raised = self.raised.into_inner().unwrap_or_else(PoisonError::into_inner);
        raised.map_or(Ok(()), Err)
    }
}

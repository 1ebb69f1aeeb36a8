//! Long computations that can be stopped: they run on threads of their own, and look at each [`check`] whether they should end.

use std::cell::RefCell;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::ThreadPoolBuilder;

thread_local! {
    /// The request to which this thread's computation listens.
    static OF_THREAD: RefCell<Option<Stop>> = const { RefCell::new(None) };
}

/// What unwinds a computation that was stopped.
struct Stopped;

/// Request to end a computation.
#[derive(Clone, Debug, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Requests the end.
    pub fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether the end was requested.
    pub fn is_requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Does some work on threads of its own, so that other work goes on meanwhile. `None` if it was stopped.
    ///
    /// # Errors
    /// The threads cannot be started.
    pub fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> io::Result<Option<T>> {
        let stop = self.clone();
        let threads = ThreadPoolBuilder::new()
            .start_handler(move |_| OF_THREAD.set(Some(stop.clone())))
            .build()
            .map_err(io::Error::other)?;
        match catch_unwind(AssertUnwindSafe(|| threads.install(work))) {
            Ok(done) => Ok(Some(done)),
            Err(cause) if cause.is::<Stopped>() => Ok(None),
            Err(cause) => resume_unwind(cause),
        }
    }
}

/// Ends the computation of this thread if that was requested. It unwinds: between the request and the loops that see it are
/// many functions that cannot fail otherwise.
pub fn check() {
    if OF_THREAD.with_borrow(|own| own.as_ref().is_some_and(Stop::is_requested)) {
        resume_unwind(Box::new(Stopped));
    }
}

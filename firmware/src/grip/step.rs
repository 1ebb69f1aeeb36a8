//! What all parts of the controller read.

use crate::grip::contact_observer::ContactObserver;
use crate::grip::interface::{ControlInputs, GripSettings};

/// What all parts of the controller read in one step. Passed by value: its fields stay in registers where a call is inlined.
#[derive(Clone, Copy, Debug)]
pub(super) struct GripStep<'a> {
    pub(super) inputs: &'a ControlInputs<'a>,
    pub(super) contact: &'a ContactObserver,
    pub(super) settings: &'a GripSettings,
    /// Milliseconds since start; wraps around.
    pub(super) now_ms: u32,
}

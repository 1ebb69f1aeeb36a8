//! A setup error that a check found.

use model_export::recordings::Location;
use serde::Serialize;

use crate::data_quality::evidence::Evidence;
use crate::data_quality::fix::Fix;

/// A setup error in the recordings, with evidence and remedy.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Identifier: `clock_backwards`.
    pub id: &'static str,
    /// File, line and column, where applicable.
    pub place: Location,
    /// What was found, in numbers.
    pub evidence: Evidence,
    /// True if no further result is valid before it is fixed.
    pub stops: bool,
    /// Repair by `--fix`; `None` where it is ambiguous.
    pub fix: Option<Fix>,
}

impl Finding {
    /// True for single channels in another unit.
    pub fn is_channel_unit(&self) -> bool {
        matches!(self.evidence, Evidence::ChannelUnit { .. })
    }
}

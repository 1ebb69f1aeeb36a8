//! What is wrong with the recordings themselves: a mistake of the rig, not of the model.

use model_export::recordings::Place;

use crate::findings::repair::Fix;

/// One mistake of the rig, with its evidence and its cure.
#[derive(Clone, Debug)]
pub struct Finding {
    /// What kind, for machines: `clock_backwards`.
    pub id: &'static str,
    /// Where: file, line and column as far as they are known.
    pub place: Place,
    /// One sentence: what was found, the evidence in numbers, and what to do.
    pub message: String,
    /// True where nothing that follows would mean anything before it is mended.
    pub stops: bool,
    /// What `--fix` does about it; it displays in words. `None` where that is not unambiguous.
    pub fix: Option<Fix>,
}

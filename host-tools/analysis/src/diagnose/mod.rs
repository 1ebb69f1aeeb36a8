//! Diagnosis: which physical effect is missing from a model, which effects are equivalent or inconclusive on the data, and
//! what no effect explains.
//!
//! [`Diagnosis`] holds all results; terminal, report and `--json` format them.
//!
//! - `pipeline`: from model and campaign to a [`Diagnosis`].
//! - `diagnosis`, `verdict`: the results.
//! - [`mod@candidates`]: testable effects, and their screening by a bootstrap score test.
//! - `candidate_fit`: a full fit of the significant candidates, of which the best is added.
//! - [`fitted_model`]: a model while effects are added to it.
//! - `selection`: state of the selection.
//! - `forward_selection`: forward selection, equivalent effects, backward elimination.
//! - `refinement`: the selection on all rows.
//! - `confusable_effects`: how similar the effects are on the recordings, and data that cannot separate them.
//! - `residuals`: the remaining residual.
//! - `shapes`: what each effect removed of it.
//! - [`remaining_structure`]: what follows no covariate.
//! - [`formulas`]: formulas of the covariates, where the catalogue leaves structure.
//! - `drifts`: drifts that explain the same as an effect of time.
//! - [`observer`]: progress, first answer, early end.
//! - `conclude`: a verdict on every candidate.
//! - [`recording_differences`]: zeros and places that differ between recordings, before any effect.
//! - [`recording_plan`]: the shortest recording that decides what is open.
//! - [`recording_check`]: effects on which recordings can decide, before a diagnosis.
//! - `suggestions`: the next command.

pub use diagnosis::{ConfoundedOffsets, Diagnosis, StaircaseStep, Suggestion, SuggestionKind};
pub use formulas::discovered::DiscoveredFormula;
pub use pipeline::{Scope, diagnose, diagnose_checked};
pub use selection::{DropReason, DroppedStep};
pub use shapes::EffectShape;
pub use verdict::{AssumedTimes, Reason, Unexplained, Verdict, VerdictKind};

mod candidate_fit;
pub mod candidates;
mod conclude;
mod confusable_effects;
mod diagnosis;
mod drifts;
pub mod fitted_model;
pub mod formulas;
mod forward_selection;
pub mod observer;
mod pipeline;
pub mod recording_check;
pub mod recording_differences;
pub mod recording_plan;
mod refinement;
pub mod remaining_structure;
pub(crate) mod residuals;
mod selection;
mod shapes;
mod suggestions;
mod verdict;

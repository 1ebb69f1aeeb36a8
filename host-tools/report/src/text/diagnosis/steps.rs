//! The steps of a diagnosis: the error after each, those that were dropped, and the forces before and after.

use analysis::compare::ForceError;
use analysis::diagnose::{Diagnosis, DropReason, DroppedStep, StaircaseStep};
use analysis::numbers::signal;

use crate::text::force_error;
use crate::text::terminal::{NARROW_WIDTH, TextTable, narrow, or_dash};

pub fn step_table(diagnosis: &Diagnosis) -> TextTable {
    let heads = ["step", "params", "excess / N", "force / N", "noise / N", "field", "x floor"];
    let rows = diagnosis.staircase.iter().map(|stair| {
        let floors = stair.held_out_rms_g / stair.floor_g;
        let newtons = |figure: fn(&ForceError) -> f64| {
            stair.force.as_ref().map_or_else(|| "-".to_owned(), |of| format!("{:.3}", figure(of)))
        };
        [
            added_effects(stair),
            stair.parameters.to_string(),
            newtons(ForceError::excess_n),
            newtons(|force| force.rms_n),
            newtons(|force| force.noise_n),
            or_dash(stair.held_out_rms_g, signal(stair.held_out_rms_g, diagnosis.noise.unit)),
            or_dash(floors, format!("{floors:.2}")),
        ]
    });
    TextTable { width: NARROW_WIDTH, ..TextTable::new(&heads, 1, rows) }
}

pub(super) fn format_steps(diagnosis: &Diagnosis) -> String {
    let rise = rising_force(&diagnosis.staircase).map_or_else(String::new, |note| narrow(&note));
    let dropped = match dropped_steps(diagnosis) {
        text if text.is_empty() => text,
        text => narrow(&text),
    };
    format!("{}\n{}{rise}{dropped}\n", step_table(diagnosis), narrow(STEP_NOTE))
}

/// What the columns of the steps are.
pub const STEP_NOTE: &str = "Held out. Params: free parameters of the model at one sensor. Force: RMS over all forces through the device's code, of which noise alone, and the excess over it \
                         (root of the difference of squares). Field: RMS over all channels, and in multiples of the noise floor.";

pub fn added_effects(stair: &StaircaseStep) -> String {
    match stair.added.as_slice() {
        [] => "the model as it is".to_owned(),
        added => format!("+ {}", added.join(" or ")),
    }
}

/// Steps that lower the error of the field and raise that of the forces; `None` without one.
pub fn rising_force(steps: &[StaircaseStep]) -> Option<String> {
    let raises = |pair: &&[StaircaseStep]| match (pair[0].force, pair[1].force) {
        (Some(before), Some(after)) => {
            let rises = after.excess_n() > before.excess_n() && !force_error::is_at_noise(&after);
            pair[1].held_out_rms_g < pair[0].held_out_rms_g && rises
        }
        _ => false,
    };
    let raising: Vec<String> =
        steps.windows(2).filter(raises).map(|pair| pair[1].added.join(" or ")).collect();
    (!raising.is_empty()).then(|| {
        format!(
            "With {} the excess of the forces rises although the error of the field falls.",
            raising.join(" and with ")
        )
    })
}

/// What was accepted and dropped again, with the reasons; empty without any.
pub fn dropped_steps(diagnosis: &Diagnosis) -> String {
    let of = |step: &DroppedStep| {
        let why = match step.reason {
            DropReason::Needless => "next to the other steps the error does not rise without it",
            DropReason::Replaced => "formulas leave less, or as much with fewer terms",
            DropReason::Undetermined => {
                "next to the others its magnitude is smaller than two of its standard errors"
            }
            DropReason::NotOnAllRows => {
                "it lowers the error of all rows by too little, or not in every fold"
            }
            DropReason::IrrelevantForces => {
                "the field is at the floor without it, and the squared error of the forces rises by less than 1 %"
            }
        };
        format!(
            "Dropped: {} (gain {:.1} % when it was accepted): {why}.",
            step.step,
            100.0 * step.gain
        )
    };
    diagnosis.dropped.iter().map(of).collect::<Vec<_>>().join(" ")
}

/// The force error of the model as it is and with everything that was found; empty without forces.
pub fn force_headline(diagnosis: &Diagnosis) -> String {
    let force = |step: Option<&StaircaseStep>| step.and_then(|step| step.force);
    let steps = &diagnosis.staircase;
    let rows = |error: &ForceError| match diagnosis.is_without_places() {
        true => format!(
            "{}, fitted without the other places of the magnets",
            force_error::rows(error.rows)
        ),
        false => force_error::rows(error.rows).into_owned(),
    };
    match (force(steps.first()), force(steps.last())) {
        (Some(before), Some(after)) if steps.len() > 1 => {
            force_error::change_of(&before, &after, &rows(&after))
        }
        (Some(only), _) => force_error::headline_of(&only, &rows(&only)),
        (None, _) => String::new(),
    }
}

/// What of the force error is not of the device's model.
pub fn force_origins(diagnosis: &Diagnosis) -> Vec<String> {
    let last = diagnosis.staircase.last().and_then(|last| last.force);
    last.map_or_else(Vec::new, |last| force_error::origins(&last, &diagnosis.origins))
}

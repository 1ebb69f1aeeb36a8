//! The error over all forces through the device's own code, in the words of every command.

use std::borrow::Cow;

use analysis::compare::{AT_FLOOR, EffectOrigin, ErrorRows, ForceError};
use analysis::numbers;
use model_export::effects::{DeviceForm, ErrorOrigin, find};

/// The terms of a headline, where a user meets them first.
pub const TERMS: &str = "Held out: on rows that the fit did not use. Noise: the error that the white noise of sensor and reference, \
    and the interpolation between rows of the reference, cause alone. Excess: the root of the difference of their squares, which a better model of the device could remove.";

/// Smallest part of an error that is mentioned.
const MIN_PART: f64 = 0.02;

/// The rows of an error: errors with the same words are of the same rows.
pub fn rows(rows: ErrorRows) -> Cow<'static, str> {
    match rows {
        ErrorRows::Unseen => "held out: recordings that the model was not fitted to".into(),
        ErrorRows::LeaveRecordingOut => "held out by recording".into(),
        ErrorRows::LeaveSixthOut => "held out by sixths of the recordings".into(),
        ErrorRows::LeaveBlocksOut { block_ms } => {
            let block_s = numbers::decimal(1e-3 * f64::from(block_ms), 3);
            format!("held out by blocks of {block_s} s within the recordings").into()
        }
        ErrorRows::Fitted => "NOT held out: the model was fitted to these recordings".into(),
        ErrorRows::PartlyFitted => {
            "partly NOT held out: the model was fitted to some of these recordings".into()
        }
    }
}

/// Headline of one model.
pub fn headline(error: &ForceError) -> String {
    headline_of(error, &rows(error.rows))
}

/// Headline of one model; `rows` says of which rows and which fit the error is.
pub fn headline_of(error: &ForceError, rows: &str) -> String {
    format!(
        "Force error ({rows}; device's code, RMS over all forces): {:.3} N; noise {:.3} N, excess over noise {:.3} N.",
        error.rms_n,
        error.noise_n,
        error.excess_n()
    )
}

/// Headline of a model before and after a change, on the same rows.
pub fn change(before: &ForceError, after: &ForceError) -> String {
    change_of(before, after, &rows(after.rows))
}

/// [`change`]; `rows` as of [`headline_of`].
pub fn change_of(before: &ForceError, after: &ForceError, rows: &str) -> String {
    format!(
        "Force error ({rows}; device's code, RMS over all forces): {:.3} N → {:.3} N; noise {:.3} N, excess over noise \
         {:.3} N → {:.3} N.",
        before.rms_n,
        after.rms_n,
        after.noise_n,
        before.excess_n(),
        after.excess_n()
    )
}

/// What of the error is not of the device's model, by the effects of the model: one sentence each.
pub fn origins(error: &ForceError, origins: &[EffectOrigin]) -> Vec<String> {
    let of = |origin: ErrorOrigin| origins.iter().filter(move |one| one.origin == origin);
    let names = |is_meant: fn(ErrorOrigin) -> bool| {
        let names = origins.iter().filter(|one| is_meant(one.origin)).map(|one| &*one.effect);
        names.collect::<Vec<_>>().join(" and ")
    };
    let mut sentences = Vec::new();
    let reference: Vec<String> = of(ErrorOrigin::Reference).map(reference_error).collect();
    if !reference.is_empty() {
        let sentence = format!(
            "{}; corrected for that: {:.3} N → {:.3} N.",
            reference.join(", "),
            error.recorded_rms_n,
            error.rms_n
        );
        sentences.push(numbers::capitalised(&sentence));
    }
    let lasting = names(|origin| origin == ErrorOrigin::History);
    if !lasting.is_empty() && error.rows.is_of_campaign() {
        sentences.push(format!(
            "{lasting}: the device's tables hold the state at the end of the campaign; each recording is replayed with that of its time."
        ));
    }
    if let Some(flagged) = &error.flagged {
        sentences.push(format!(
            "Counted apart: {:.1} % of the rows, in which the device detects a magnetic disturbance (error {:.3} N).",
            100.0 * flagged.share,
            flagged.rms_n
        ));
    }
    if error.irreducible_n() > MIN_PART * error.rms_n {
        sentences.push(format!(
            "{:.3} N of the error (root of the difference of squares) are of {}, which no model of the device compensates; the excess \
             is without them.",
            error.irreducible_n(),
            names(ErrorOrigin::is_irreducible)
        ));
    }
    sentences
}

/// "the reference drifts by 0.93 N/min"
fn reference_error(of: &EffectOrigin) -> String {
    let error = match find(&of.effect).map(|effect| effect.device) {
        Ok(DeviceForm::Bench { error, .. }) => error,
        _ => &of.effect,
    };
    format!("{error} {} {}", numbers::decimal(of.value, 3), of.unit)
}

/// Excess relative to the noise of a force that is as close to its noise as a field at the noise floor.
fn margin() -> f64 {
    (AT_FLOOR * AT_FLOOR - 1.0).sqrt()
}

/// Whether the forces are as close to their noise as a field at its noise floor.
pub fn is_at_noise(force: &ForceError) -> bool {
    force.excess_n() <= margin() * force.noise_n
}

/// Note to a field at its noise floor, where the forces are not: what is left is of the device's own computation.
pub fn larger_excess(force: &ForceError) -> Option<String> {
    excess_of(
        force,
        "The field leaves no effect to find, so this is the error of the device's tables and of its compensation of the effects; \
         `replay` shows it by sensor and recording.",
    )
}

/// The same where the field is that of recordings without the other places of their magnets.
pub fn excess_of_places(force: &ForceError) -> Option<String> {
    excess_of(
        force,
        "They are of the recordings as they are, by a fit without the other places of the magnets: a calibration holds for one mounting.",
    )
}

fn excess_of(force: &ForceError, cause: &str) -> Option<String> {
    (!is_at_noise(force)).then(|| {
        format!(
            "The forces are not at their noise: excess {:.3} N, {:.1} times the noise. {cause}",
            force.excess_n(),
            force.excess_n() / force.noise_n
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis::compare::FlaggedRows;

    const BY_RECORDING: ErrorRows = ErrorRows::LeaveRecordingOut;

    fn origin(effect: &str, origin: ErrorOrigin, value: f64, unit: &str) -> EffectOrigin {
        EffectOrigin { effect: effect.to_owned(), origin, value, unit: unit.to_owned() }
    }

    #[test]
    fn the_excess_is_the_root_of_the_difference_of_squares() {
        // 0.5^2 - 0.4^2 = 0.3^2; an error below the noise has no excess.
        let before = ForceError::of_device(0.5, 0.4, BY_RECORDING);
        let after = ForceError::of_device(0.39, 0.4, BY_RECORDING);
        assert!(headline(&before).contains("0.500 N; noise 0.400 N, excess over noise 0.300 N"));
        assert!(change(&before, &after).contains("excess over noise 0.300 N → 0.000 N"));
    }

    #[test]
    fn a_corrected_reference_is_stated_with_the_error_without_the_correction() {
        let recorded_rms_n = 2.31;
        let error = ForceError { recorded_rms_n, ..ForceError::of_device(0.44, 0.4, BY_RECORDING) };
        let drift = origin("reference_drift", ErrorOrigin::Reference, 0.93, "N/min");
        assert_eq!(
            origins(&error, &[drift]),
            ["The reference drifts by 0.93 N/min; corrected for that: 2.310 N → 0.440 N."]
        );
    }

    #[test]
    fn an_event_is_counted_apart_and_outside_of_the_excess() {
        let flagged = Some(FlaggedRows { share: 0.025, rms_n: 1.5 });
        // 0.5^2 = 0.3^2 + 0.4^2: 0.3 N are of the event.
        let error = ForceError {
            flagged,
            reducible_rms_n: 0.4,
            ..ForceError::of_device(0.5, 0.4, ErrorRows::LeaveBlocksOut { block_ms: 250 })
        };
        let magnet = origin("external_magnet", ErrorOrigin::Event, 5.0, "G");
        let sentences = origins(&error, &[magnet]);
        assert!(sentences[0].starts_with("Counted apart: 2.5 % of the rows"), "{sentences:?}");
        assert!(sentences[1].starts_with("0.300 N of the error"), "{sentences:?}");
        assert_eq!(error.excess_n(), 0.0);
        assert!(headline(&error).starts_with("Force error (held out by blocks of 0.25 s"));
    }
}

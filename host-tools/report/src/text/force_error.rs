//! The error over all forces through the device's own code, in the words of every command.

use analysis::compare::{AT_FLOOR, ForceError};
use analysis::notes::UncompensatedEffect;

use crate::text::notes;

/// Of rows that the model was not fitted to.
pub const HELD_OUT: &str = "held out";

/// The terms of a headline, where a user meets them first.
pub const TERMS: &str = "Held out: on recordings that the fit did not use. Noise: the error that the white noise of sensor and \
    reference causes alone. Excess: the root of the difference of their squares, which a better model could remove.";

/// Headline of one model on held-out rows.
pub fn headline(error: &ForceError) -> String {
    of(HELD_OUT, error)
}

/// Headline of one model on rows that are used like this: "held out".
pub fn of(rows: &str, error: &ForceError) -> String {
    format!(
        "Force error ({rows}, device's code, RMS over all forces): {:.3} N; noise {:.3} N, excess over noise {:.3} N.",
        error.rms_n,
        error.noise_n,
        error.excess_n()
    )
}

/// Headline of a model before and after a change, on held-out rows.
pub fn change(before: &ForceError, after: &ForceError) -> String {
    change_of(HELD_OUT, before, after)
}

/// Headline of a model before and after a change, on rows that are used like this.
pub fn change_of(rows: &str, before: &ForceError, after: &ForceError) -> String {
    format!(
        "Force error ({rows}, device's code, RMS over all forces): {:.3} N → {:.3} N; noise {:.3} N, excess over noise \
         {:.3} N → {:.3} N.",
        before.rms_n,
        after.rms_n,
        after.noise_n,
        before.excess_n(),
        after.excess_n()
    )
}

/// Excess relative to the noise of a force that is as close to its noise as a field at the noise floor.
pub fn margin() -> f64 {
    (AT_FLOOR * AT_FLOOR - 1.0).sqrt()
}

/// Note to a field at its noise floor, where the forces are not; `uncompensated` are effects of the model.
pub fn larger_excess(force: &ForceError, uncompensated: &[UncompensatedEffect]) -> Option<String> {
    if force.excess_n() <= margin() * force.noise_n {
        return None;
    }
    let why = if uncompensated.is_empty() {
        "`replay` shows it by sensor and recording".to_owned()
    } else {
        uncompensated.iter().map(notes::uncompensated).collect::<Vec<_>>().join("; ")
    };
    Some(format!(" The forces of the device have a larger excess: {why}."))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_excess_is_the_root_of_the_difference_of_squares() {
        // 0.5^2 - 0.4^2 = 0.3^2; an error below the noise has no excess.
        let (before, after) = (ForceError::of_device(0.5, 0.4), ForceError::of_device(0.39, 0.4));
        assert!(headline(&before).contains("0.500 N; noise 0.400 N, excess over noise 0.300 N"));
        assert!(change(&before, &after).contains("excess over noise 0.300 N → 0.000 N"));
    }
}

//! What commonly moves with a covariate: suggestions to check where a formula was found, not verdicts.

use model_export::effects::excitation::source_column;

/// Common causes of an error that follows a covariate; empty for a column of the user's own.
pub fn usual_causes(covariate: &str) -> &'static str {
    match source_column(covariate) {
        "motor_angle_rad" => {
            "an eccentric or bent screw, an eccentric encoder magnet, the rotor's magnets, cogging torque"
        }
        "opening_mm" if covariate != "opening_mm" => {
            "drag of a seal or a wiper, friction of the guide, eddy currents"
        }
        "opening_mm" => {
            "straightness, preload or rolling elements of the guide (periodic), a neighbouring magnet or steel part, the pull of a cable"
        }
        "motor_iq_a" => {
            "the field of motor leads or windings, the torque's reaction on the body, heating"
        }
        "temp_c" => {
            "remanence, offset or gain of the Hall sensor, thermal growth of the gap, stiffness of a polymer, span of the load cell"
        }
        "roll_rad" | "pitch_rad" | "yaw_rad" => {
            "the Earth's field, the weight of the fingertip, the pull of a cable, magnets of the wrist"
        }
        "accel_x_mps2" | "accel_y_mps2" | "accel_z_mps2" => {
            "mass on the flexures, bending of the body, the pull of a cable"
        }
        "fx_n" | "fz_n" => {
            "a nonlinear flexure, a stop, clearance of a joint, cross-talk of the reference, compression of the sensor"
        }
        "fx_rate_n_per_s" | "fz_rate_n_per_s" => {
            "a delay between the clocks, a filter of the reference, damping, friction"
        }
        "time_s" | "session_s" => {
            "drift of the reference or of the sensor, a temperature that was not recorded, run-in, creep"
        }
        _ => "",
    }
}

/// "Usual causes, to check: opening: ...; rotor angle: ..."; empty where none is known.
pub fn causes_sentence<'a>(covariates: impl IntoIterator<Item = &'a String>) -> String {
    let known = covariates.into_iter().filter_map(|covariate| {
        let causes = usual_causes(covariate);
        (!causes.is_empty()).then(|| format!("with {covariate}: {causes}"))
    });
    let known: Vec<String> = known.collect();
    if known.is_empty() {
        return String::new();
    }
    format!("What commonly moves, to check: {}.", known.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use model_export::effects::excitation::{BUILT_IN_COVARIATES, OPENING_RATE};

    #[test]
    fn every_built_in_covariate_has_usual_causes() {
        for covariate in BUILT_IN_COVARIATES.into_iter().chain([OPENING_RATE, "motor_angle_rad"]) {
            assert!(!usual_causes(covariate).is_empty(), "{covariate}");
        }
        assert_ne!(usual_causes(OPENING_RATE), usual_causes("opening_mm"));
    }

    #[test]
    fn a_column_of_the_user_has_no_suggestion() {
        assert_eq!(causes_sentence(&["coolant_flow".to_owned()]), "");
        let sentence = causes_sentence(&["motor_angle_rad".to_owned(), "coolant_flow".to_owned()]);
        assert!(
            sentence.starts_with("What commonly moves, to check: with motor_angle_rad: an ecc")
        );
    }
}

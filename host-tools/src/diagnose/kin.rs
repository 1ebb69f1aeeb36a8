//! Effects that show against the same covariates, and so can stand in for each other's form.
//!
//! No effect of a catalogue has quite the form of a real one: friction is not three sliders, creep not two
//! time constants. What an accepted effect leaves of itself looks like its kin, and far smaller. Such a
//! remainder gets no name of its own.

use model_export::effects::Addition;

/// Effects by the load's history and rate.
pub const BY_HISTORY: &[&str] = &[
    "hysteresis",
    "viscous_lag",
    "creep",
    "clock_skew",
    "reference_filter",
];

/// Sets of effects that show against the same covariate.
const KIN: [&[&str]; 4] = [
    // The load itself.
    &[
        "geometric_stiffening",
        "tip_slope",
        "hard_stop",
        "sensor_compression",
    ],
    BY_HISTORY,
    // Slow time.
    &[
        "creep",
        "softening",
        "field_drift",
        "reference_drift",
        "demagnetisation",
        "external_magnet",
    ],
    // Temperature.
    &["magnet_temperature", "sensor_temperature", "thermal_gap"],
];

/// True where two effects show against the same covariate.
pub fn are_kin(one: &Addition, other: &Addition) -> bool {
    let both = |set: &&[&str]| set.contains(&one.name()) && set.contains(&other.name());
    KIN.iter().any(both)
}

#[cfg(test)]
mod tests {
    use super::*;
    use model_export::effects::find;

    #[test]
    fn kin_are_effects_of_the_catalogue() {
        for id in KIN.iter().flat_map(|set| set.iter()) {
            assert!(find(id).is_ok(), "{id}");
        }
    }

    #[test]
    fn creep_is_kin_of_lags_and_of_drifts_which_are_none_of_each_other() {
        let effect = |id| Addition::Catalogue(find(id).unwrap());
        assert!(are_kin(&effect("creep"), &effect("viscous_lag")));
        assert!(are_kin(&effect("field_drift"), &effect("creep")));
        assert!(!are_kin(&effect("field_drift"), &effect("viscous_lag")));
    }
}

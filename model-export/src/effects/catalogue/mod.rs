//! The catalogue: one file for each effect, with its physics, equation, parameters and action.

use crate::effects::Effect;
use crate::error::closest_match;

/// Declares the file of each effect, a constant for it, and the list of all.
macro_rules! catalogue {
    ($($name:ident: $file:ident,)*) => {
        $(
            mod $file;
            #[doc = concat!("The effect `", stringify!($file), "`.")]
            pub const $name: &Effect = &$file::EFFECT;
        )*

        /// All effects, by decreasing prior plausibility.
        pub const CATALOGUE: [&Effect; [$(stringify!($name)),*].len()] = [$($name),*];
    };
}

// By decreasing prior plausibility. rustfmt does not follow modules in a macro: format an effect's file by name.
catalogue! {
    GEOMETRIC_STIFFENING: geometric_stiffening,
    TIP_SLOPE: tip_slope,
    CROSS_COUPLING: cross_coupling,
    HARD_STOP: hard_stop,
    HYSTERESIS: hysteresis,
    VISCOUS_LAG: viscous_lag,
    CREEP: creep,
    SOFTENING: softening,
    FINGERTIP_MASS: fingertip_mass,
    NEIGHBOUR_MAGNET: neighbour_magnet,
    SCREW_BACKLASH: screw_backlash,
    MOTOR_LEAKAGE: motor_leakage,
    EARTH_FIELD: earth_field,
    EXTERNAL_MAGNET: external_magnet,
    MAGNET_TEMPERATURE: magnet_temperature,
    SENSOR_TEMPERATURE: sensor_temperature,
    THERMAL_GAP: thermal_gap,
    DEMAGNETISATION: demagnetisation,
    FIELD_DRIFT: field_drift,
    SENSOR_COMPRESSION: sensor_compression,
    CLOCK_SKEW: clock_skew,
    REFERENCE_FILTER: reference_filter,
    REFERENCE_DRIFT: reference_drift,
}

/// The catalogue has no effect of this name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no effect {name:?}; {advice}")]
pub struct UnknownEffect {
    name: String,
    advice: String,
}

/// The effect with this id.
pub fn find(name: &str) -> Result<&'static Effect, UnknownEffect> {
    let found = CATALOGUE.iter().find(|effect| effect.id == name);
    found.copied().ok_or_else(|| UnknownEffect {
        name: name.to_owned(),
        advice: match closest_match(name, CATALOGUE.iter().map(|effect| effect.id)) {
            Some(id) => format!("did you mean {id}?"),
            None => "`cargo magpie effects` lists them".to_owned(),
        },
    })
}

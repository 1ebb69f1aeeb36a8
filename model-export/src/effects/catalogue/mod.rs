//! The catalogue: one file for each effect, with its physics, equation, parameters and action.

mod clock_skew;
pub(super) mod creep;
mod cross_coupling;
mod demagnetisation;
pub(super) mod earth_field;
mod external_magnet;
mod field_drift;
mod fingertip_mass;
mod geometric_stiffening;
mod hard_stop;
pub(super) mod hysteresis;
mod magnet_temperature;
mod motor_leakage;
pub(super) mod neighbour_magnet;
mod reference_drift;
mod reference_filter;
mod screw_backlash;
mod sensor_compression;
mod sensor_temperature;
mod softening;
mod thermal_gap;
mod tip_slope;
mod viscous_lag;

use crate::effects::Effect;
use crate::recordings::error::closest_match;

/// All effects, by decreasing prior plausibility.
pub const CATALOGUE: [&Effect; 23] = [
    &geometric_stiffening::EFFECT,
    &tip_slope::EFFECT,
    &cross_coupling::EFFECT,
    &hard_stop::EFFECT,
    &hysteresis::EFFECT,
    &viscous_lag::EFFECT,
    &creep::EFFECT,
    &softening::EFFECT,
    &fingertip_mass::EFFECT,
    &neighbour_magnet::EFFECT,
    &screw_backlash::EFFECT,
    &motor_leakage::EFFECT,
    &earth_field::EFFECT,
    &external_magnet::EFFECT,
    &magnet_temperature::EFFECT,
    &sensor_temperature::EFFECT,
    &thermal_gap::EFFECT,
    &demagnetisation::EFFECT,
    &field_drift::EFFECT,
    &sensor_compression::EFFECT,
    &clock_skew::EFFECT,
    &reference_filter::EFFECT,
    &reference_drift::EFFECT,
];

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
            None => "`magpie effects` lists them".to_owned(),
        },
    })
}

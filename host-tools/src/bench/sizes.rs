//! The effects that the bench knows: id, unit of the size, typical and possible sizes.

use std::ops::RangeInclusive;

use model_export::effects::find;

/// One effect, and what its size means.
#[derive(Clone, Debug, PartialEq)]
pub struct Size {
    /// Name on the command line and in the truth.
    pub id: &'static str,
    /// Typical size and unit of what the catalogue does not hold.
    own: Option<(f64, &'static str)>,
    /// Sizes for which the bench's physics hold.
    pub possible: RangeInclusive<f64>,
    /// What the size is.
    pub meaning: &'static str,
    /// A property of a material or of the whole gripper: the same in every sensor.
    pub shared: bool,
    /// May be hidden; what is not in the catalogue of effects is only simulated by name.
    pub hidden: bool,
}

impl Size {
    /// Unit of the size: the catalogue's.
    pub fn unit(&self) -> &'static str {
        match self.own {
            Some((_, unit)) => unit,
            None => find(self.id).map_or("", |effect| effect.size.unit),
        }
    }

    /// Size where none is given: the catalogue's.
    pub fn typical(&self) -> f64 {
        match self.own {
            Some((typical, _)) => typical,
            None => find(self.id).map_or(0.0, |effect| effect.size.typical),
        }
    }
}

const fn size(id: &'static str, possible: RangeInclusive<f64>, meaning: &'static str) -> Size {
    Size {
        id,
        own: None,
        possible,
        meaning,
        shared: false,
        hidden: true,
    }
}

const fn shared(size: Size) -> Size {
    Size {
        shared: true,
        ..size
    }
}

const fn by_name_only(typical: f64, unit: &'static str, size: Size) -> Size {
    Size {
        own: Some((typical, unit)),
        hidden: false,
        ..size
    }
}

/// All effects.
#[rustfmt::skip] // One line for each effect.
pub const SIZES: &[Size] = &[
    size("geometric_stiffening", -20.0..=100.0, "growth of both flexures' stiffness at 0.5 mm"),
    size("tip_slope", -50.0..=50.0, "foreshortening of each flexure at 0.5 mm; the magnet leans"),
    size("neighbour_magnet", -50.0..=50.0, "field of the opposite finger's magnet at an opening of 10 mm"),
    size("motor_leakage", 0.0..=50.0, "norm of the nine coefficients (axes by currents), times 10 A"),
    shared(size("earth_field", 0.0..=5.0, "norm of the world's field")),
    shared(size("magnet_temperature", -1.0..=1.0, "change of remanence from 25 C")),
    size("sensor_temperature", 0.0..=5.0, "norm of the drift of the offset from 25 C"),
    size("thermal_gap", -10.0..=10.0, "growth of the gap from 25 C"),
    size("hysteresis", 0.0..=50.0, "Coulomb friction beside the flexure, half the loop's width"),
    size("viscous_lag", 0.0..=200.0, "retardation time, lateral; half of it longitudinally"),
    size("creep", 0.0..=50.0, "delayed compliance, as a share of the instantaneous one"),
    size("softening", -20.0..=50.0, "growth of the compliance over many load cycles"),
    shared(size("clock_skew", -100.0..=100.0, "the field is recorded later than the reference says")),
    shared(size("reference_filter", 0.0..=200.0, "time constant of the reference's own filter")),
    size("cross_coupling", -20.0..=20.0, "share of Fz that acts as Fx, and -0.4 times as much back"),
    size("hard_stop", 0.0..=95.0, "compliance lost beyond 60 % of the greatest load"),
    size("fingertip_mass", 0.0..=2.0, "mass carried by the flexures"),
    shared(size("screw_backlash", 0.0..=5.0, "full play between the reported opening and the real one")),
    size("demagnetisation", -10.0..=10.0, "loss of remanence from the first recording to the second"),
    shared(size("external_magnet", 0.0..=200.0, "greatest field of a foreign magnet that passes once")),
    shared(size("reference_drift", -5.0..=5.0, "steady wander of the reference's lateral zero")),
    size("field_drift", 0.0..=20.0, "norm of the final shift of the field"),
    size("sensor_compression", -5.0..=10.0, "loss of gain at 1300 G"),
    by_name_only(2.0, "um", size("screw_ripple", -50.0..=50.0, "longitudinal motion of the magnet with the screw's turn")),
    by_name_only(1.0, "G", shared(size("cross_term", -50.0..=50.0, "field of current times opening: 10 A, 10 mm off the middle"))),
    by_name_only(3.0, "G", shared(size("unlogged", 0.0..=50.0, "greatest field of a disturbance that nobody records"))),
];

/// The effect of this name.
pub fn size_of(id: &str) -> Option<&'static Size> {
    SIZES.iter().find(|size| size.id == id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_typical_size_is_possible_and_every_id_stands_once() {
        for (i, size) in SIZES.iter().enumerate() {
            assert!(size.possible.contains(&size.typical()), "{}", size.id);
            assert!(SIZES[..i].iter().all(|other| other.id != size.id));
        }
    }

    #[test]
    fn every_effect_of_the_catalogue_can_be_simulated() {
        for effect in model_export::effects::CATALOGUE {
            assert!(
                size_of(effect.id).is_some_and(|size| size.own.is_none()),
                "{}",
                effect.id
            );
        }
    }

    #[test]
    fn every_meaning_fits_its_line_in_the_help() {
        assert!(SIZES.iter().all(|size| size.meaning.len() <= 62));
    }

    #[test]
    fn all_effects_but_those_of_no_catalogue_may_be_hidden() {
        let open: Vec<&str> = SIZES.iter().filter(|s| !s.hidden).map(|s| s.id).collect();
        assert_eq!(open, ["screw_ripple", "cross_term", "unlogged"]);
    }
}

//! The effects that the bench knows: id, unit of the size, typical and possible sizes.

use std::ops::RangeInclusive;

/// One effect, and what its size means.
#[derive(Clone, Debug, PartialEq)]
pub struct Size {
    /// Name on the command line and in the truth.
    pub id: &'static str,
    /// Unit of the size.
    pub unit: &'static str,
    /// Size where none is given.
    pub typical: f64,
    /// Sizes for which the bench's physics hold.
    pub possible: RangeInclusive<f64>,
    /// What the size is.
    pub meaning: &'static str,
    /// A property of a material or of the whole gripper: the same in every sensor.
    pub shared: bool,
    /// May be hidden; what is not in the catalogue of effects is only simulated by name.
    pub hidden: bool,
}

const fn size(
    id: &'static str,
    typical: f64,
    unit: &'static str,
    possible: RangeInclusive<f64>,
    meaning: &'static str,
) -> Size {
    Size {
        id,
        unit,
        typical,
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

const fn by_name_only(size: Size) -> Size {
    Size {
        hidden: false,
        ..size
    }
}

/// All effects.
#[rustfmt::skip] // One line for each effect.
pub const SIZES: &[Size] = &[
    size("geometric_stiffening", 5.0, "%", -20.0..=100.0, "growth of both flexures' stiffness at 0.5 mm"),
    size("tip_slope", 5.0, "um", -50.0..=50.0, "foreshortening of each flexure at 0.5 mm; the magnet leans"),
    size("neighbour_magnet", 2.0, "G", -50.0..=50.0, "field of the opposite finger's magnet at an opening of 10 mm"),
    size("motor_leakage", 1.0, "G", 0.0..=50.0, "norm of the nine coefficients (axes by currents), times 10 A"),
    shared(size("earth_field", 0.48, "G", 0.0..=5.0, "norm of the world's field")),
    shared(size("magnet_temperature", -0.11, "%/K", -1.0..=1.0, "change of remanence from 25 C")),
    size("sensor_temperature", 0.1, "G/K", 0.0..=5.0, "norm of the drift of the offset from 25 C"),
    size("thermal_gap", 0.5, "um/K", -10.0..=10.0, "growth of the gap from 25 C"),
    size("hysteresis", 2.5, "N", 0.0..=50.0, "Coulomb friction beside the flexure, half the loop's width"),
    size("viscous_lag", 10.0, "ms", 0.0..=200.0, "retardation time, lateral; half of it longitudinally"),
    size("creep", 2.0, "%", 0.0..=50.0, "delayed compliance, as a share of the instantaneous one"),
    size("softening", 3.0, "%", -20.0..=50.0, "growth of the compliance over many load cycles"),
    shared(size("clock_skew", 5.0, "ms", -100.0..=100.0, "the field is recorded later than the reference says")),
    shared(size("reference_filter", 4.0, "ms", 0.0..=200.0, "time constant of the reference's own filter")),
    size("cross_coupling", 1.5, "%", -20.0..=20.0, "share of Fz that acts as Fx, and -0.4 times as much back"),
    size("hard_stop", 60.0, "%", 0.0..=95.0, "compliance lost beyond 60 % of the greatest load"),
    size("fingertip_mass", 0.1, "kg", 0.0..=2.0, "mass carried by the flexures"),
    shared(size("screw_backlash", 0.3, "mm", 0.0..=5.0, "full play between the reported opening and the real one")),
    size("demagnetisation", 0.5, "%", -10.0..=10.0, "loss of remanence from the first recording to the second"),
    shared(size("external_magnet", 5.0, "G", 0.0..=200.0, "greatest field of a foreign magnet that passes once")),
    shared(size("reference_drift", 0.4, "N/min", -5.0..=5.0, "steady wander of the reference's lateral zero")),
    size("field_drift", 0.7, "G", 0.0..=20.0, "norm of the final shift of the field"),
    size("sensor_compression", 1.0, "%", -5.0..=10.0, "loss of gain at 1300 G"),
    by_name_only(size("screw_ripple", 2.0, "um", -50.0..=50.0, "longitudinal motion of the magnet with the screw's turn")),
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
            assert!(size.possible.contains(&size.typical), "{}", size.id);
            assert!(SIZES[..i].iter().all(|other| other.id != size.id));
        }
    }

    #[test]
    fn every_meaning_fits_its_line_in_the_help() {
        assert!(SIZES.iter().all(|size| size.meaning.len() <= 62));
    }

    #[test]
    fn all_effects_but_the_screw_s_ripple_may_be_hidden() {
        let open: Vec<&str> = SIZES.iter().filter(|s| !s.hidden).map(|s| s.id).collect();
        assert_eq!(open, ["screw_ripple"]);
    }
}

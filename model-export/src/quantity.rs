//! Units that people write, and the one unit that each quantity has inside the project.
//!
//! A column name ends in its unit (`f0_x_n`); an import mapping states the unit of the source
//! (`"uT"`). This file is the only place where the two meet.

/// A unit as people write it: `name` times `factor` is the project's unit `canonical`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit {
    /// As written in an import mapping, for example `uT`.
    pub name: &'static str,
    /// The suffix that the same quantity carries in a recording's column names.
    pub canonical: &'static str,
    /// Multiply by this to get the canonical unit.
    pub factor: f64,
}

const fn unit(name: &'static str, canonical: &'static str, factor: f64) -> Unit {
    Unit {
        name,
        canonical,
        factor,
    }
}

/// Standard gravity in m/s^2 (CGPM 1901), to turn a scale's reading into a force.
const STANDARD_GRAVITY: f64 = 9.806_65;

/// Every unit that an import mapping may state.
pub const UNITS: &[Unit] = &[
    unit("s", "us", 1e6),
    unit("ms", "us", 1e3),
    unit("us", "us", 1.0),
    unit("ns", "us", 1e-3),
    unit("lsb", "lsb", 1.0),
    unit("T", "gauss", 1e4),
    unit("mT", "gauss", 10.0),
    unit("uT", "gauss", 0.01),
    unit("nT", "gauss", 1e-5),
    unit("G", "gauss", 1.0),
    unit("gauss", "gauss", 1.0),
    unit("mG", "gauss", 1e-3),
    unit("N", "n", 1.0),
    unit("mN", "n", 1e-3),
    unit("kN", "n", 1e3),
    unit("g", "n", 1e-3 * STANDARD_GRAVITY),
    unit("kg", "n", STANDARD_GRAVITY),
    unit("kgf", "n", STANDARD_GRAVITY),
    unit("lbf", "n", 4.448_221_615_260_5),
    unit("mm", "mm", 1.0),
    unit("um", "mm", 1e-3),
    unit("m", "mm", 1e3),
    unit("degC", "c", 1.0),
    unit("A", "a", 1.0),
    unit("mA", "a", 1e-3),
    unit("rad", "rad", 1.0),
    unit("deg", "rad", std::f64::consts::PI / 180.0),
    unit("m/s2", "mps2", 1.0),
    unit("g0", "mps2", STANDARD_GRAVITY),
];

/// The unit of that name, exactly as written: `mT` and `MT` are not the same.
pub fn unit_named(name: &str) -> Option<Unit> {
    UNITS.iter().copied().find(|unit| unit.name == name)
}

/// The suffixes that a column of a recording may end in.
pub fn column_units() -> Vec<&'static str> {
    let mut suffixes: Vec<_> = UNITS.iter().map(|unit| unit.canonical).collect();
    suffixes.sort_unstable();
    suffixes.dedup();
    suffixes
}

/// The unit that a column's name ends in, if it ends in one.
pub fn column_unit(column: &str) -> Option<&'static str> {
    let (_, suffix) = column.rsplit_once('_')?;
    column_units().into_iter().find(|unit| *unit == suffix)
}

/// `value` to this many significant digits.
pub fn rounded(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits.saturating_sub(1))
        .parse()
        .unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hundred_microtesla_are_one_gauss() {
        let microtesla = unit_named("uT").unwrap();
        assert_eq!(100.0 * microtesla.factor, 1.0);
        assert_eq!(microtesla.canonical, "gauss");
    }

    #[test]
    fn a_kilogram_on_a_scale_weighs_nine_point_eight_newtons() {
        assert_eq!(unit_named("kg").unwrap().factor, 9.806_65);
    }

    #[test]
    fn rounding_keeps_the_leading_digits_and_what_has_none() {
        assert_eq!(rounded(0.1 + 0.2, 9), 0.3);
        assert_eq!(rounded(-123_456.789, 4), -123_500.0);
        assert_eq!(rounded(0.0, 9), 0.0);
        assert!(rounded(f64::INFINITY, 9).is_infinite());
    }

    #[test]
    fn a_column_without_a_unit_is_seen_as_such() {
        assert_eq!(column_unit("f0_x"), None);
        assert_eq!(column_unit("f0_x_n"), Some("n"));
    }
}

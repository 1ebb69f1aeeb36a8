//! Accepted units and their conversion to the internal unit of each quantity.
//!
//! Column names end in the internal unit (`f0_x_n`); import mappings state the unit of the source (`"uT"`).

/// A unit and its conversion to the internal unit `canonical`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit {
    /// Symbol in import mappings, for example `uT`.
    pub name: &'static str,
    /// Internal unit: the suffix of column names.
    pub canonical: &'static str,
    /// Conversion factor to the internal unit.
    pub factor: f64,
}

const fn unit(name: &'static str, canonical: &'static str, factor: f64) -> Unit {
    Unit { name, canonical, factor }
}

/// Standard gravity in m/s^2 (CGPM 1901): converts readings of a scale to forces.
const STANDARD_GRAVITY: f64 = 9.806_65;

/// Units accepted in import mappings.
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
    unit("K", "k", 1.0),
    unit("A", "a", 1.0),
    unit("mA", "a", 1e-3),
    unit("V", "v", 1.0),
    unit("mV", "v", 1e-3),
    unit("uV", "v", 1e-6),
    unit("W", "w", 1.0),
    unit("mW", "w", 1e-3),
    unit("N m", "nm", 1.0),
    unit("Nm", "nm", 1.0),
    unit("N mm", "nm", 1e-3),
    unit("Nmm", "nm", 1e-3),
    unit("rad", "rad", 1.0),
    unit("deg", "rad", std::f64::consts::PI / 180.0),
    unit("rad/s", "radps", 1.0),
    unit("deg/s", "radps", std::f64::consts::PI / 180.0),
    unit("m/s2", "mps2", 1.0),
    unit("g0", "mps2", STANDARD_GRAVITY),
    unit("Hz", "hz", 1.0),
    unit("kHz", "hz", 1e3),
    unit("%", "percent", 1.0),
    unit("1", "ratio", 1.0),
];

/// The unit with this symbol; case-sensitive, since `mT` and `MT` differ.
pub fn find_unit(name: &str) -> Option<Unit> {
    UNITS.iter().copied().find(|unit| unit.name == name)
}

/// The unit with this symbol or word as people write it, such as `sec` or `Gauss`, with micro and degree signs.
pub(crate) fn unit_of_text(text: &str) -> Option<Unit> {
    let symbol = text.replace(['\u{b5}', '\u{3bc}'], "u").replace('\u{b0}', "deg");
    let name = match symbol.to_lowercase().as_str() {
        "sec" | "secs" | "second" | "seconds" => "s",
        "msec" | "millis" | "milliseconds" => "ms",
        "usec" | "micros" | "microseconds" => "us",
        "nsec" | "nanos" | "nanoseconds" => "ns",
        "count" | "counts" | "raw" | "adc" => "lsb",
        "tesla" => "T",
        "newton" | "newtons" => "N",
        "gram" | "grams" | "gf" => "g",
        "lbs" | "lb" => "lbf",
        "c" | "degc" | "celsius" => "degC",
        "amp" | "amps" | "ampere" | "amperes" => "A",
        "radians" => "rad",
        "degree" | "degrees" => "deg",
        "radps" | "rads" => "rad/s",
        "dps" | "degps" => "deg/s",
        "percent" | "pct" => "%",
        "mps2" | "ms2" | "m/s^2" | "m/s\u{b2}" => "m/s2",
        _ => symbol.as_str(),
    };
    /// Symbols that are clear in another case.
    const ANY_CASE: [&str; 15] = [
        "s", "ms", "us", "ns", "lsb", "uT", "nT", "gauss", "N", "kN", "kg", "mm", "A", "rad", "deg",
    ];
    let other_case = || ANY_CASE.into_iter().find(|unit| unit.eq_ignore_ascii_case(&symbol));
    find_unit(name).or_else(|| find_unit(other_case()?))
}

/// Symbol of the unit that columns with this suffix are in, for example `V` for `v`.
pub fn symbol(canonical: &str) -> Option<&'static str> {
    let unit = UNITS.iter().find(|unit| unit.canonical == canonical && unit.factor == 1.0);
    unit.map(|unit| unit.name)
}

/// Unit suffixes of column names, sorted.
pub(crate) fn column_units() -> Vec<&'static str> {
    let mut suffixes: Vec<_> = UNITS.iter().map(|unit| unit.canonical).collect();
    suffixes.sort_unstable();
    suffixes.dedup();
    suffixes
}

/// Unit suffix of a column name.
pub fn column_unit(column: &str) -> Option<&'static str> {
    let (_, suffix) = column.rsplit_once('_')?;
    column_units().into_iter().find(|unit| *unit == suffix)
}

/// `value` rounded to `digits` significant digits.
pub fn round_significant(value: f64, digits: usize) -> f64 {
    // Counts have no more digits.
    let limit = 10_f64.powi(i32::try_from(digits).unwrap_or(i32::MAX));
    if value.fract() == 0.0 && value.abs() < limit {
        return value;
    }
    format!("{value:.*e}", digits.saturating_sub(1)).parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_convert_to_their_canonical_unit() {
        for (name, factor, canonical) in [
            ("uT", 0.01, "gauss"),
            ("kg", 9.806_65, "n"),
            ("mV", 1e-3, "v"),
            ("N mm", 1e-3, "nm"),
            ("%", 1.0, "percent"),
        ] {
            let unit = find_unit(name).unwrap();
            assert_eq!((unit.factor, unit.canonical), (factor, canonical), "{name}");
        }
    }

    #[test]
    fn rounding_preserves_leading_digits_zero_and_infinity() {
        assert_eq!(round_significant(0.1 + 0.2, 9), 0.3);
        assert_eq!(round_significant(-123_456.789, 4), -123_500.0);
        assert_eq!(round_significant(0.0, 9), 0.0);
        assert_eq!(round_significant(123_456_789.0, 9), 123_456_789.0);
        assert_eq!(round_significant(1_234_567_891.0, 9), 1_234_567_890.0);
        assert!(round_significant(f64::INFINITY, 9).is_infinite());
    }

    #[test]
    fn column_unit_is_none_without_a_unit_suffix() {
        assert_eq!(column_unit("f0_x"), None);
        assert_eq!(column_unit("f0_x_n"), Some("n"));
    }
}

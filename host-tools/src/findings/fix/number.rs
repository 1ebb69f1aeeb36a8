//! A number converted as it is written: no more digits than it had, and no fewer.

/// `text` times `factor` plus `offset`, written to a tenth of the step of `text` (to its own step where
/// the factor is a power of ten or 1). `None` where the text is no number.
pub fn convert(text: &str, factor: f64, offset: f64) -> Option<String> {
    let trimmed = text.trim();
    let value: f64 = trimmed
        .parse()
        .ok()
        .filter(|value: &f64| value.is_finite())?;
    let shift = factor.abs().log10();
    let power_of_ten = (shift - shift.round()).abs() < 1e-9;
    let finer = match power_of_ten {
        true => -shift.round() as i32,
        false => 1 - shift.floor() as i32,
    };
    let of_offset = decimals(&offset.to_string());
    let decimals = (decimals(trimmed) + finer).max(0);
    let decimals = match offset == 0.0 {
        true => decimals,
        false => decimals.max(of_offset),
    };
    let written = format!("{:.*}", decimals as usize, value * factor + offset);
    Some(written)
}

/// The same number with the other sign.
pub fn negate(text: &str) -> String {
    let trimmed = text.trim();
    match (trimmed.strip_prefix('-'), trimmed.strip_prefix('+')) {
        (Some(rest), _) => rest.to_owned(),
        (None, Some(rest)) => format!("-{rest}"),
        // Nothing, and zero, have no sign.
        _ if trimmed.parse::<f64>().is_ok_and(|value| value != 0.0) => format!("-{trimmed}"),
        _ => trimmed.to_owned(),
    }
}

/// Digits after the point, less the exponent.
fn decimals(text: &str) -> i32 {
    let (mantissa, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let digits = mantissa
        .split_once('.')
        .map_or(0, |(_, digits)| digits.len());
    digits as i32 - exponent.parse::<i32>().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_of_ten_only_moves_the_point() {
        assert_eq!(convert("1234.5", 1e-3, 0.0).unwrap(), "1.2345");
        assert_eq!(convert("0.0400", 1e3, 0.0).unwrap(), "40.0");
        assert_eq!(convert("-0.021", 1e3, 0.0).unwrap(), "-21");
    }

    #[test]
    fn kelvin_becomes_degrees_with_the_digits_that_it_had() {
        assert_eq!(convert("297.40", 1.0, -273.15).unwrap(), "24.25");
        assert_eq!(convert("300", 1.0, -273.15).unwrap(), "26.85");
    }

    #[test]
    fn degrees_become_rad_without_losing_a_step() {
        let factor = std::f64::consts::PI / 180.0;
        assert_eq!(convert("57.296", factor, 0.0).unwrap(), "1.000004");
        assert_eq!(convert("1e2", factor, 0.0).unwrap(), "1.7");
        assert_eq!(convert("none", factor, 0.0), None);
    }

    #[test]
    fn a_sign_is_turned_in_the_text() {
        assert_eq!(negate("-98"), "98");
        assert_eq!(negate("0.10"), "-0.10");
        assert_eq!(negate("0"), "0");
        assert_eq!(negate(""), "");
    }
}

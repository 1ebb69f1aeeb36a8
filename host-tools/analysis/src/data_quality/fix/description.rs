//! Appends the applied corrections to `recording.toml`; number conversion that preserves the resolution.

use anyhow::{Context, Result};
use std::fs;
use std::path::Path;
use toml_edit::{DocumentMut, value};

/// Appends the corrections to the key `description`; the rest of the file is unchanged.
pub fn extend(path: &Path, done: &[String]) -> Result<()> {
    let named = || format!("{}", path.display());
    let text = fs::read_to_string(path).with_context(named)?;
    let extended = with_words(&text, &done.join("; ")).with_context(named)?;
    fs::write(path, extended).with_context(named)
}

fn with_words(text: &str, done: &str) -> Result<String> {
    let mut document: DocumentMut = text.parse()?;
    let before = document.get("description").and_then(|item| item.as_str()).unwrap_or_default();
    let after = if before.is_empty() {
        format!("corrected: {done}")
    } else {
        format!("{before} (corrected: {done})")
    };
    document["description"] = value(after);
    Ok(document.to_string())
}

/// `text` times `factor` plus `offset`, with a resolution of a tenth of the step of `text` (its own step where
/// the factor is 1 or a power of ten). `None` where the text is not a number.
pub fn convert(text: &str, factor: f64, offset: f64) -> Option<String> {
    let trimmed = text.trim();
    let value: f64 = trimmed.parse().ok().filter(|value: &f64| value.is_finite())?;
    let shift = factor.abs().log10();
    let power_of_ten = (shift - shift.round()).abs() < 1e-9;
    let finer = if power_of_ten { -shift.round() as i32 } else { 1 - shift.floor() as i32 };
    let of_offset = decimals(&offset.to_string());
    let decimals = (decimals(trimmed) + finer).max(0);
    let decimals = if offset == 0.0 { decimals } else { decimals.max(of_offset) };
    let written = format!("{:.*}", decimals as usize, value * factor + offset);
    Some(written)
}

/// The number with the opposite sign, as text.
pub fn negate(text: &str) -> String {
    let trimmed = text.trim();
    match (trimmed.strip_prefix('-'), trimmed.strip_prefix('+')) {
        (Some(rest), _) => rest.to_owned(),
        (None, Some(rest)) => format!("-{rest}"),
        // An empty cell and zero have no sign.
        _ if trimmed.parse::<f64>().is_ok_and(|value| value != 0.0) => format!("-{trimmed}"),
        _ => trimmed.to_owned(),
    }
}

/// Decimal places minus the exponent.
fn decimals(text: &str) -> i32 {
    let (mantissa, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let digits = mantissa.split_once('.').map_or(0, |(_, digits)| digits.len());
    digits as i32 - exponent.parse::<i32>().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_description_changes() {
        let text = "format = 1\ndescription = \"bench\"\nstart_s  =  0.0 # first\n[design]\ngap_mm = 1.50\n";
        let expected = text.replace("\"bench\"", "\"bench (corrected: rows sorted)\"");
        assert_eq!(with_words(text, "rows sorted").unwrap(), expected);
    }

    #[test]
    fn power_of_ten_moves_the_decimal_point() {
        assert_eq!(convert("1234.5", 1e-3, 0.0).unwrap(), "1.2345");
        assert_eq!(convert("0.0400", 1e3, 0.0).unwrap(), "40.0");
        assert_eq!(convert("-0.021", 1e3, 0.0).unwrap(), "-21");
    }

    #[test]
    fn kelvin_to_celsius_keeps_the_decimals() {
        assert_eq!(convert("297.40", 1.0, -273.15).unwrap(), "24.25");
        assert_eq!(convert("300", 1.0, -273.15).unwrap(), "26.85");
    }

    #[test]
    fn degrees_to_rad_keep_the_resolution() {
        let factor = std::f64::consts::PI / 180.0;
        assert_eq!(convert("57.296", factor, 0.0).unwrap(), "1.000004");
        assert_eq!(convert("1e2", factor, 0.0).unwrap(), "1.7");
        assert_eq!(convert("none", factor, 0.0), None);
    }

    #[test]
    fn negate_changes_the_text_only() {
        assert_eq!(negate("-98"), "98");
        assert_eq!(negate("0.10"), "-0.10");
        assert_eq!(negate("0"), "0");
        assert_eq!(negate(""), "");
    }
}

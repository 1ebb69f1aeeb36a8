//! Number format of the report.

use crate::terminal::decimal;

/// Significant digits.
const DIGITS: f64 = 3.0;

/// Three digits with a true minus; a dash for NaN.
pub fn number(value: f64) -> String {
    if !value.is_finite() {
        return "\u{2013}".to_owned();
    }
    let before = match value.abs() {
        size if size > 0.0 => size.log10().floor() + 1.0,
        _ => 1.0,
    };
    let decimals = (DIGITS - before).clamp(0.0, 4.0) as usize;
    let text = format!("{value:.decimals$}");
    let nothing = text.chars().all(|letter| matches!(letter, '-' | '0' | '.'));
    if nothing { "0".to_owned() } else { text.replace('-', "\u{2212}") }
}

/// Number, or a dash for `None`.
pub fn maybe(value: Option<f64>) -> String {
    number(value.unwrap_or(f64::NAN))
}

/// Share in percent.
pub fn percent(share: f64) -> String {
    if share.is_finite() { format!("{}\u{a0}%", number(100.0 * share)) } else { number(share) }
}

/// Share in whole percent.
pub fn whole_percent(share: f64) -> String {
    match share.is_finite() {
        true if share > 0.0 && share < 0.005 => "less than 1\u{a0}%".to_owned(),
        true => format!("{}\u{a0}%", decimal(100.0 * share, 0).replace('-', "\u{2212}")),
        false => number(share),
    }
}

/// Root mean square of numbers; those that are none do not count.
pub fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values
        .into_iter()
        .filter(|value| value.is_finite())
        .fold((0.0, 0_u32), |(sum, count), value| (sum + value * value, count + 1));
    (sum / f64::from(count)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_shown_to_three_digits() {
        assert_eq!(number(1234.5), "1234");
        assert_eq!(number(12.345), "12.3");
        assert_eq!(number(-0.012_34), "\u{2212}0.0123");
        assert_eq!(number(-1e-9), "0");
        assert_eq!(number(f64::NAN), "\u{2013}");
    }

    #[test]
    fn shares_are_percent() {
        assert_eq!(percent(0.012_34), "1.23\u{a0}%");
        assert_eq!(whole_percent(0.484), "48\u{a0}%");
        assert_eq!(whole_percent(0.001), "less than 1\u{a0}%");
    }

    #[test]
    fn a_mean_of_squares_leaves_out_what_is_no_number() {
        assert_eq!(rms([3.0, f64::NAN, 4.0]), 12.5_f64.sqrt());
        assert!(rms([]).is_nan());
    }
}

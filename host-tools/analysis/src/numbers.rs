//! Numbers as text.

use model_export::recordings::columns::SignalUnit;
use model_export::recordings::units::round_significant;

/// `value±error`, both to two significant digits of the error, but no finer than a thousandth of `scale`; the value to three digits
/// where there is no error.
pub fn with_error(value: f64, error: f64, scale: f64) -> String {
    if error.is_nan() {
        return three_digits(value);
    }
    let decimals = decimals_for(error).min(decimals_for(0.01 * scale));
    format!("{value:.decimals$}±{error:.decimals$}")
}

/// "0.00 to 1.94": both to three digits of the larger magnitude.
pub fn between([least, largest]: [f64; 2]) -> String {
    let decimals = decimals_for(0.1 * least.abs().max(largest.abs()));
    format!("{least:.decimals$} to {largest:.decimals$}")
}

/// A number with at most `decimals` decimals, without trailing zeros.
pub fn decimal(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// [`decimal`] of a finite number, otherwise a dash.
pub fn decimal_or_dash(value: f64, decimals: usize) -> String {
    if value.is_finite() { decimal(value, decimals) } else { "-".to_owned() }
}

/// Number of decimals (0 to 6) that gives `magnitude` two significant digits.
pub fn decimals_for(magnitude: f64) -> usize {
    if !(magnitude.is_finite() && magnitude > 0.0) {
        return 3;
    }
    (1.0 - magnitude.log10().floor()).clamp(0.0, 6.0) as usize
}

pub fn three_digits(value: f64) -> String {
    match value.abs() {
        size if size >= 99.95 => format!("{value:.0}"),
        size if size >= 9.995 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}

/// A sensor's signal: a field in gauss, or in milligauss below 0.1 G; another signal to three digits.
pub fn signal(value: f64, unit: SignalUnit) -> String {
    match unit {
        SignalUnit::Gauss if value.abs() < 0.1 => format!("{} mG", three_digits(1e3 * value)),
        SignalUnit::Gauss => format!("{value:.3} G"),
        SignalUnit::Other(symbol) => format!("{} {symbol}", round_significant(value, 3)),
    }
}

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

pub fn percent(share: f64) -> String {
    if share.is_finite() { format!("{}\u{a0}%", number(100.0 * share)) } else { number(share) }
}

pub fn whole_percent(share: f64) -> String {
    match share {
        share if !share.is_finite() => number(share),
        share if share > 0.0 && share < 0.005 => "less than 1\u{a0}%".to_owned(),
        share => format!("{}\u{a0}%", decimal(100.0 * share, 0).replace('-', "\u{2212}")),
    }
}

/// A sentence with a capital at its start.
pub fn capitalised(sentence: &str) -> String {
    let mut letters = sentence.chars();
    let first = letters.next().map(|letter| letter.to_uppercase().to_string());
    first.unwrap_or_default() + letters.as_str()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_follow_the_error_and_are_limited_by_the_scale() {
        for (value, error, scale, text) in [
            (501.097_4, 0.019_68, 0.1, "501.097±0.020"),
            (-35.2, 17.0, 50.0, "-35±17"),
            (501.097_4, 0.001_9, 50.0, "501.10±0.00"),
            (6.475_7, f64::NAN, 6.5, "6.48"),
        ] {
            assert_eq!(with_error(value, error, scale), text);
        }
    }

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
}

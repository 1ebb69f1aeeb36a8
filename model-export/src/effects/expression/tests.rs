//! Valid formulas, and error messages of invalid ones.

use super::*;
use crate::input::{
    MAX_FORMULA_BYTES, MAX_FORMULA_DEPTH, MAX_FORMULA_OPERATORS, MAX_FORMULA_PARAMETERS,
};
use crate::physics::PhysicalState;

const RIPPLE: &str = "ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)";

fn columns() -> Vec<String> {
    vec!["opening_mm".to_owned(), "motor_iq_a".to_owned()]
}

fn period() -> Vec<ParameterRange> {
    vec![ParameterRange { name: "p".to_owned(), from: 2.0, to: 5.0 }]
}

fn error(text: &str, ranges: &[ParameterRange]) -> String {
    Expression::parse(text, ranges, &columns()).unwrap_err().to_string()
}

#[test]
fn names_are_classified_by_unit_and_range() {
    let ripple = Expression::parse(RIPPLE, &period(), &columns()).unwrap();
    let names: Vec<String> = ripple.parameters().iter().map(|p| p.name.to_string()).collect();
    assert_eq!(names, ["a", "b", "p"]);
    assert_eq!(ripple.covariates, ["opening_mm"]);
    assert_eq!((ripple.name.as_str(), ripple.stage()), ("ripple", EffectStage::Displacement));
    // A quarter of a period into the sine.
    let (value, axis) = ripple.value(&[2.0, 5.0, 4.0], &[1.0]);
    assert!((value - 2.0).abs() < 1e-12 && axis == 2);
}

#[test]
fn error_message_marks_the_position() {
    let text = "ripple: dz_um = a*sin(2*pi*openning_mm)";
    let message = error(text, &[]);
    assert!(message.contains("did you mean opening_mm?"), "{message}");
    let caret = message.lines().last().unwrap().find('^').unwrap();
    let line = message.lines().nth(1).unwrap();
    assert!(line[caret..].starts_with("openning_mm"), "{message}");
}

#[test]
fn invalid_formulas_yield_advice() {
    for (text, expected) in [
        ("dz_um = a", "write NAME: TARGET = FORMULA"),
        ("ripple: dzz_um = a*opening_mm", "did you mean dz_um?"),
        ("ripple: dz_um = a*(opening_mm", "is not closed"),
        ("ripple: dz_um = a*opening_mm)", "was not opened"),
        ("ripple: dz_um = a**opening_mm", "a value is missing"),
        ("ripple: dz_um = a opening_mm", "an operator is missing"),
        ("ripple: dz_um = a*opening_mm $", "not allowed here"),
        ("ripple: dz_um = a*1.2.3", "\"1.2.3\" is not a number"),
        ("ripple: dz_um = -a*-opening_mm^2", "write brackets: -(x^a) or (-x)^a"),
        ("ripple: dz_um = a*-sin(opening_mm)^2", "write brackets: -(x^a) or (-x)^a"),
        ("ripple: dz_um = a*(-opening_mm)^2^2", "write brackets: (x^a)^b or x^(a^b)"),
        ("ripple: dz_um = a*opening_mm^-2^2", "write brackets: (x^a)^b or x^(a^b)"),
        ("ripple: dz_um = a*sin(opening_mm*b)", "does not enter linearly"),
        ("ripple: dz_um = a*b*opening_mm", "exactly one coefficient"),
        ("ripple: dz_um = 2*opening_mm", "no coefficient"),
        ("ripple: dz_um = a*height_mm", "is not a covariate"),
        ("hysteresis: dz_um = a*opening_mm", "catalogue"),
        ("ripple: dz_um = a*foo(opening_mm)", "no function"),
        ("warm: dz_um = a*lag(opening_mm)", "write lag(COVARIATE, SECONDS)"),
        ("warm: dz_um = a*lag(opening_mm, 1, 2)", "write lag(COVARIATE, SECONDS)"),
        ("warm: dz_um = a*lag(2*opening_mm, 1)", "write lag(COVARIATE, SECONDS)"),
        ("warm: dz_um = a*lag(opening_mm, 1", "write lag(COVARIATE, SECONDS)"),
        ("warm: dz_um = a*lag(opening_mm, 0)", "neither a positive number of seconds nor"),
        ("warm: dz_um = a*lag(opening_mm, tau)", "--range tau=1..10, or after a semicolon"),
        (
            "warm: dz_um = a*lag(opening_mm, 1)b*time_s",
            "operator is missing after lag(opening_mm, 1)",
        ),
        ("warm: dz_um = a*lag(openning_mm, 1)", "did you mean opening_mm?"),
        ("warm: dz_um = a*lag(b, 1)", "available: fx_n, fz_n,"),
    ] {
        let message = error(text, &[]);
        assert!(message.contains(expected), "{text}: {message}");
    }
    assert!(error("ripple: dz_um = a*opening_mm", &period()).contains("no such name"));
    for (from, valid) in [(-0.5, false), (0.0, false), (0.1, true)] {
        let range = [ParameterRange { name: "tau".to_owned(), from, to: 5.0 }];
        let columns = ["opening_mm".to_owned()];
        let found = Expression::parse("warm: dz_um = a*lag(opening_mm, tau)", &range, &columns);
        let message = found.err().map_or_else(String::new, |error| error.to_string());
        assert!(message.is_empty() == valid, "{from}: {message}");
        assert!(valid || message.contains("positive bounds in seconds"), "{message}");
    }
}

/// Error message of a formula; empty if it is valid.
fn message(formula: &str) -> String {
    let result = Expression::parse(&format!("r: dz_um = {formula}"), &[], &columns());
    result.err().map_or_else(String::new, |error| error.to_string())
}

#[test]
fn length_operators_depth_and_parameters_are_limited() {
    let sum = |terms: usize| format!("a*({})", vec!["opening_mm"; terms].join("+"));
    let nested = |depth: usize| format!("a*{}opening_mm{}", "(".repeat(depth), ")".repeat(depth));
    let parameters = |count: usize| {
        let terms: Vec<String> = (0..count).map(|i| format!("a{i}*opening_mm")).collect();
        terms.join("+")
    };
    let spaces = |length: usize| format!("a*opening_mm{}", " ".repeat(length - 12));
    let start = "r: dz_um = ".len();
    for (valid, invalid, words) in [
        (sum(MAX_FORMULA_OPERATORS), sum(MAX_FORMULA_OPERATORS + 1), "more than 64 operators"),
        (nested(MAX_FORMULA_DEPTH), nested(MAX_FORMULA_DEPTH + 1), "more than 16 brackets"),
        (
            parameters(MAX_FORMULA_PARAMETERS),
            parameters(MAX_FORMULA_PARAMETERS + 1),
            "17 coefficients and ranges, and the limit is 16",
        ),
        (
            spaces(MAX_FORMULA_BYTES - start),
            spaces(MAX_FORMULA_BYTES - start + 1),
            "1001 characters, and the limit is 1000",
        ),
    ] {
        assert_eq!(message(&valid), "", "{words}");
        let message = message(&invalid);
        assert!(message.contains(words) && message.len() < 2500, "{message}");
    }
    // Signs and functions count too.
    assert!(message(&format!("a*{}opening_mm", "-".repeat(64))).contains("more than 64 operators"));
    assert!(message(&"1".repeat(10_000_000)).contains("10000011 characters"));
}

#[test]
fn range_needs_finite_bounds_that_can_be_divided() {
    let text = "ripple: dz_um = a*sin(opening_mm/p)";
    for (from, to, is_valid) in [
        (2.0, 5.0, true),
        (-1e12, 1e12, true),
        (0.0, 1e-9, true),
        (0.0, 1e13, false),
        (0.0, 1e-320, false),
        (1.0, 1.0 + 1e-9, false),
        (f64::NAN, 1.0, false),
        (1.0, f64::NAN, false),
        (0.0, f64::INFINITY, false),
        (5.0, 2.0, false),
    ] {
        let ranges = [ParameterRange { name: "p".to_owned(), from, to }];
        let result = Expression::parse(text, &ranges, &columns());
        assert_eq!(result.is_ok(), is_valid, "{from} {to}");
    }
}

#[test]
fn names_of_constants_are_free_and_values_are_those_of_mathematics() {
    for (formula, expected) in [
        ("e*opening_mm + E*opening_mm^2", 2.0 * 3.0 + 5.0 * 9.0),
        ("e*opening_mm - E*opening_mm^2", 2.0 * 3.0 - 5.0 * 9.0),
        ("-e*(opening_mm)^2 + E*opening_mm^-2", -2.0 * 9.0 + 5.0 / 9.0),
        ("e*cos(opening_mm*2*2) + E*opening_mm*0.5*2", 2.0 * 12_f64.cos() + 5.0 * 3.0),
        ("e*sin(opening_mm*2*3.5/2)*2/4*2 - E*3-E*3", 2.0 * 10.5_f64.sin() - 5.0 * 6.0),
        ("e*1.5e-1*2E1 + E*.5e+1", 2.0 * 3.0 + 5.0 * 5.0),
        ("-(e*opening_mm^2) + E*(-opening_mm)^2", -2.0 * 9.0 + 5.0 * 9.0),
    ] {
        let parsed = Expression::parse(&format!("r: dz_um = {formula}"), &[], &columns());
        let parsed = parsed.unwrap();
        let names: Vec<String> = parsed.parameters().iter().map(|p| p.name.to_string()).collect();
        // In the order of the alphabet, capitals first.
        assert_eq!(names, ["E", "e"], "{formula}");
        let (value, _) = parsed.value(&[5.0, 2.0], &[3.0]);
        assert!((value - expected).abs() < 1e-12, "{formula}: {value}");
    }
}

#[test]
fn lag_is_a_first_order_low_pass() {
    let time_s: Vec<f64> = (0..=400).map(|i| 0.01 * f64::from(i)).collect();
    // A step of 3 mm within the first 10 ms.
    let opening = time_s.iter().map(|t| if *t > 0.0 { 13.0 } else { 10.0 }).collect();
    let excitation = ExcitationSeries {
        covariates: [("opening_mm".to_owned(), opening)].into(),
        time_s,
        ..ExcitationSeries::default()
    };
    let range = |name: &str| ParameterRange { name: name.to_owned(), from: 0.5, to: 2.0 };
    let text = "slow: by_g = a*(opening_mm - lag(opening_mm,tau)) + b*lag( opening_mm , 2.5 )";
    let formula = Expression::parse(text, &[range("tau")], &columns()).unwrap();
    assert_eq!(formula.covariates, ["opening_mm"]);
    assert!(formula.has_memory() && !formula.depends_on_forces_alone());
    // a = 2, b = 0, tau = 0.8 s: after the step 2*3*exp(-t/tau), to the length of the step.
    let values = formula.series(&[2.0, 0.0, 0.8], &excitation).unwrap();
    for (row, expected) in [(80, 2.2073), (160, 0.81201), (400, 0.040428)] {
        assert!((values[row] / expected - 1.0).abs() < 0.01, "{row}: {}", values[row]);
    }
    // b = 1: 10 + 3*(1 - exp(-t/2.5)).
    let values = formula.series(&[0.0, 1.0, 0.8], &excitation).unwrap();
    for (row, expected) in [(0, 10.0), (100, 10.98904), (400, 12.39431)] {
        assert!((values[row] - expected).abs() < 0.005, "{row}: {}", values[row]);
    }
    // What was not recorded has no values.
    assert_eq!(formula.series(&[1.0, 1.0, 1.0], &ExcitationSeries::default()), None);
}

#[test]
fn rate_of_the_opening_is_available_with_the_opening() {
    let text = "drag: bx_g = a*opening_rate_mm_per_s";
    let formula = Expression::parse(text, &[], &columns()).unwrap();
    let time_s: Vec<f64> = (0..50).map(|i| 0.01 * f64::from(i)).collect();
    let excitation = ExcitationSeries {
        covariates: [("opening_mm".to_owned(), time_s.iter().map(|t| 30.0 - 8.0 * t).collect())]
            .into(),
        time_s,
        ..ExcitationSeries::default()
    };
    let values = formula.series(&[0.5], &excitation).unwrap();
    assert!(values.iter().all(|value| (value + 4.0).abs() < 1e-6), "{values:?}");
    let message = Expression::parse(text, &[], &[]).unwrap_err().to_string();
    assert!(message.contains("is not a covariate"), "{message}");
}

#[test]
fn every_target_changes_its_own_quantity() {
    let excitation = ExcitationSeries { time_s: vec![0.0], ..ExcitationSeries::default() };
    let applied = |target: &str| {
        let text = format!("own: {target} = a*(1 + time_s)");
        let formula = Expression::parse(&text, &[], &[]).unwrap();
        let states = vec![PhysicalState::displaced(Vector3::zeros())];
        let mut series = StateSeries::default();
        (series.force_n, series.states) = (vec![[0.0; 2]], states);
        formula.apply(&[2.0], &excitation, &mut series);
        (series.force_n[0], series.states[0])
    };
    assert_eq!(applied("fz_n").0, [0.0, 2.0]);
    assert_eq!(applied("dy_um").1.displacement_mm, Vector3::new(0.0, 2e-3, 0.0));
    assert_eq!(applied("tilt_z_mrad").1.extra_tilt_rad, [0.0, 2e-3]);
    assert_eq!(applied("bz_g").1.external_g, Vector3::new(0.0, 0.0, 2.0));
    assert_eq!(applied("gain_percent").1.gain, Vector3::repeat(1.02));
    assert_eq!(applied("gain_y_percent").1.gain, Vector3::new(1.0, 1.02, 1.0));
    assert_eq!(applied("rotation_x_mrad").1.rotation_rad, Vector3::new(2e-3, 0.0, 0.0));
}

#[test]
fn units_of_coefficients_hold_those_of_their_covariates() {
    let columns = ["opening_mm", "temp_c", "supply_v", "duty_ratio"].map(str::to_owned);
    let units = |formula: &str| {
        let expression = Expression::parse(&format!("f: {formula}"), &[], &columns).unwrap();
        expression.parameters().iter().map(|one| one.unit.to_string()).collect::<Vec<_>>()
    };
    assert_eq!(units("dx_um = a*fx_n*(temp_c-25)"), ["um/(N K)"]);
    assert_eq!(units("dx_um = a*fx_n^2 + b*fx_n*opening_mm"), ["um/N^2", "um/(N mm)"]);
    assert_eq!(units("bx_g = a*sin(2*pi*opening_mm/3) + b"), ["G", "G"]);
    assert_eq!(units("bx_g = a*supply_v/opening_mm"), ["G mm/V"]);
    assert_eq!(units("bx_g = a*temp_c^3 + b*temp_c^2"), ["G/K^3", "G/K^2"]);
    assert_eq!(units("bx_g = a*duty_ratio + b*abs(fz_n)"), ["G", "G/N"]);
    assert_eq!(units("fx_n = a*fx_rate_n_per_s + b*time_s"), ["N/(N/s)", "N/s"]);
}

#[test]
fn period_and_time_constant_have_the_units_of_what_they_divide() {
    let range = ParameterRange { name: "p".to_owned(), from: 2.0, to: 5.0 };
    let unit = |formula: &str| {
        let columns = ["opening_mm".to_owned()];
        let text = format!("f: {formula}");
        let expression = Expression::parse(&text, std::slice::from_ref(&range), &columns).unwrap();
        expression.parameters().last().unwrap().unit.to_string()
    };
    assert_eq!(unit("dx_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)"), "mm");
    assert_eq!(unit("dx_um = a*lag(fx_n, p)"), "s");
    assert_eq!(unit("dx_um = a*tanh(fx_n/p)"), "N");
}

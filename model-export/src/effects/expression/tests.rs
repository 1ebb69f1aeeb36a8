//! Valid formulas, and error messages of invalid ones.

use super::*;

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
        ("ripple: dz_um = a*sin(opening_mm*b)", "does not enter linearly"),
        ("ripple: dz_um = a*b*opening_mm", "exactly one coefficient"),
        ("ripple: dz_um = 2*opening_mm", "no coefficient"),
        ("ripple: dz_um = a*height_mm", "is not a covariate"),
        ("hysteresis: dz_um = a*opening_mm", "catalogue"),
        ("ripple: dz_um = a*foo(opening_mm)", "no function"),
    ] {
        let message = error(text, &[]);
        assert!(message.contains(expected), "{text}: {message}");
    }
    assert!(error("ripple: dz_um = a*opening_mm", &period()).contains("no such name"));
}

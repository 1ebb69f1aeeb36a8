//! Formulas that are understood, and those that are told what to do.

use super::*;

const RIPPLE: &str = "ripple: dz_um = a*sin(2*pi*opening_mm/p) + b*cos(2*pi*opening_mm/p)";

fn columns() -> Vec<String> {
    vec!["opening_mm".to_owned(), "motor_iq_a".to_owned()]
}

fn period() -> Vec<Range> {
    vec![Range {
        name: "p".to_owned(),
        from: 2.0,
        to: 5.0,
    }]
}

fn error(text: &str, ranges: &[Range]) -> String {
    Expression::parse(text, ranges, &columns())
        .unwrap_err()
        .to_string()
}

#[test]
fn coefficients_ranges_and_covariates_are_told_apart() {
    let ripple = Expression::parse(RIPPLE, &period(), &columns()).unwrap();
    let names: Vec<String> = ripple
        .parameters()
        .iter()
        .map(|p| p.name.to_string())
        .collect();
    assert_eq!(names, ["a", "b", "p"]);
    assert_eq!(ripple.covariates, ["opening_mm"]);
    assert_eq!(
        (ripple.name.as_str(), ripple.stage()),
        ("ripple", Stage::Displacement)
    );
    // A quarter of a period into the sine.
    let (value, axis) = ripple.value(&[2.0, 5.0, 4.0], &[1.0]);
    assert!((value - 2.0).abs() < 1e-12 && axis == 2);
}

#[test]
fn an_error_points_at_its_character() {
    let text = "ripple: dz_um = a*sin(2*pi*openning_mm)";
    let shown = error(text, &[]);
    assert!(shown.contains("did you mean opening_mm?"), "{shown}");
    let caret = shown.lines().last().unwrap().find('^').unwrap();
    let line = shown.lines().nth(1).unwrap();
    assert!(line[caret..].starts_with("openning_mm"), "{shown}");
}

#[test]
fn wrong_formulas_are_told_what_to_do() {
    for (text, words) in [
        ("dz_um = a", "write NAME: TARGET = FORMULA"),
        ("ripple: dzz_um = a*opening_mm", "did you mean dz_um?"),
        ("ripple: dz_um = a*(opening_mm", "is not closed"),
        ("ripple: dz_um = a*opening_mm)", "was not opened"),
        ("ripple: dz_um = a**opening_mm", "a value is missing"),
        ("ripple: dz_um = a opening_mm", "an operator is missing"),
        ("ripple: dz_um = a*opening_mm $", "cannot stand here"),
        (
            "ripple: dz_um = a*sin(opening_mm*b)",
            "does not enter linearly",
        ),
        ("ripple: dz_um = a*b*opening_mm", "one coefficient"),
        ("ripple: dz_um = 2*opening_mm", "no coefficient"),
        ("ripple: dz_um = a*height_mm", "is no covariate"),
        ("hysteresis: dz_um = a*opening_mm", "catalogue"),
        ("ripple: dz_um = a*foo(opening_mm)", "no function"),
    ] {
        let shown = error(text, &[]);
        assert!(shown.contains(words), "{text}: {shown}");
    }
    assert!(error("ripple: dz_um = a*opening_mm", &period()).contains("no such name"));
}

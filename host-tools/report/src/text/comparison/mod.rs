//! Text and JSON of a comparison.
//!
//! - [`attribution`]: what the residual follows, and where it is largest.
//! - [`conclusion`]: the verdict in one paragraph, and how the errors were separated from the fit.

pub mod attribution;
pub mod conclusion;

use analysis::compare::{
    AT_FLOOR, Comparison, FieldAxisErrors, ForceAxisErrors, ForceError, floor_g, rms_g,
};
use analysis::numbers;
use analysis::replay::tare::TARE_HARM;
use analysis::statistics::{ErrorStatistics, pooled_rms};
use anstyle::Style;
use serde_json::{Value, json};

use crate::text::terminal::{self, ERROR, GOOD, HEADING, TextTable, WARNING, WIDTH, or_dash};
use crate::text::{findings, force_error, parameters};
use attribution::{attribution_table, worst_json, worst_segments};
use conclusion::{missing_forces, validation, verdict};

pub fn format_report(comparison: &Comparison) -> String {
    let mut page = findings::format_list(&comparison.findings);
    if comparison.axes.is_empty() {
        page += &colored(ERROR, &verdict(comparison));
        return page;
    }
    page += &format_field(comparison);
    page += &format_force(comparison);
    page += &attribution_table(comparison);
    page += &worst_segments(&comparison.worst);
    page += &terminal::paragraph(&format!("Held-out rows: {}.", validation(comparison)));
    if let Some(other) = &comparison.other {
        page += &side_by_side(comparison, other);
    }
    page.push('\n');
    let headline = force_headline(comparison);
    if !headline.is_empty() {
        page += &terminal::paragraph(&headline);
        for sentence in force_origins(comparison) {
            page += &terminal::paragraph(&sentence);
        }
        page += &terminal::paragraph(force_error::TERMS);
    }
    page + &colored(verdict_style(comparison), &verdict(comparison))
}

/// The force error, of the baseline and of the model where there are two; empty without forces.
pub fn force_headline(comparison: &Comparison) -> String {
    let Some(error) = comparison.force() else {
        return String::new();
    };
    let baseline = comparison.other.as_ref().and_then(|other| other.force());
    match baseline {
        Some(baseline) if baseline.rows == error.rows => force_error::change(&baseline, &error),
        Some(baseline) => format!(
            "{} Baseline, on other rows: {}",
            force_error::headline(&error),
            force_error::headline(&baseline)
        ),
        None => force_error::headline(&error),
    }
}

/// What of the force error is not of the device's model.
pub fn force_origins(comparison: &Comparison) -> Vec<String> {
    let error = comparison.force();
    error.map_or_else(Vec::new, |error| force_error::origins(&error, &comparison.origins))
}

fn colored(style: Style, text: &str) -> String {
    terminal::styled(style, text, WIDTH)
}

fn verdict_style(comparison: &Comparison) -> Style {
    if rms_g(&comparison.axes) <= AT_FLOOR * floor_g(&comparison.axes) { GOOD } else { WARNING }
}

/// The field error of each axis.
pub fn field_table(comparison: &Comparison) -> TextTable {
    let unit = comparison.noise.unit.symbol();
    let heads = [
        "field",
        &format!("rms / {unit}"),
        "mean",
        "std",
        "P95",
        "max",
        "% of range",
        &format!("floor / {unit}"),
        "x floor",
        "explainable",
    ];
    let digits = decimals(comparison.axes.iter().map(|axis| axis.floor.total));
    let rows = comparison.axes.iter().map(|axis| {
        let name = format!("s{} {}", axis.sensor, axis.axis.letter());
        error_cells(&name, &axis.error, axis.floor.total, axis.explainable, digits)
    });
    TextTable::new(&heads, 1, rows)
}

fn format_field(comparison: &Comparison) -> String {
    format!(
        "{HEADING}Held-out field residual (measured minus model){HEADING:#}\n{}\n{}\n",
        field_table(comparison),
        floor_sentence(comparison)
    )
}

/// Number of decimals that gives the smallest floor two significant digits.
pub fn decimals(floors: impl Iterator<Item = f64>) -> usize {
    let min = floors.filter(|floor| *floor > 0.0).fold(f64::INFINITY, f64::min);
    numbers::decimals_for(min).max(3)
}

fn error_cells(
    name: &str,
    error: &ErrorStatistics,
    floor: f64,
    explainable: f64,
    digits: usize,
) -> Vec<String> {
    let number = |value: f64| or_dash(value, format!("{value:.digits$}"));
    let (percent, floors) = (100.0 * error.rms / error.span, error.rms / floor);
    vec![
        name.to_owned(),
        number(error.rms),
        number(error.mean),
        number(error.std),
        number(error.p95),
        number(error.greatest),
        or_dash(percent, format!("{percent:.2}")),
        number(floor),
        or_dash(floors, format!("{floors:.2}")),
        number(explainable),
    ]
}

/// Components of the noise floor.
fn floor_sentence(comparison: &Comparison) -> String {
    let axes = &comparison.axes;
    let mean = |of: &dyn Fn(&FieldAxisErrors) -> Option<f64>| {
        let values: Vec<f64> = axes.iter().filter_map(of).collect();
        (!values.is_empty()).then(|| numbers::signal(pooled_rms(values), comparison.noise.unit))
    };
    let mut text = format!(
        "Noise floor: white noise {}, reference noise {}, quantisation {}",
        mean(&|axis| Some(axis.floor.white)).unwrap_or_default(),
        mean(&|axis| Some(axis.floor.reference)).unwrap_or_default(),
        mean(&|axis| Some(axis.floor.quantisation)).unwrap_or_default(),
    );
    text += &match mean(&|axis| axis.floor.slow) {
        Some(slow) => format!("; slow drift at rest {slow}"),
        None => "; slow drift unknown (no rest of 10 s recorded)".to_owned(),
    };
    text += &match mean(&|axis| axis.floor.replicates) {
        Some(scatter) => format!("; scatter of repeated loads {scatter}."),
        None => "; too few repeated loads for their scatter.".to_owned(),
    };
    text += &format!(" {}", comparison.noise.sentence());
    terminal::paragraph(&text)
}

pub fn force_table(comparison: &Comparison) -> TextTable {
    let heads = [
        "force",
        "rmse / N",
        "mean",
        "std",
        "P95",
        "max",
        "% of range",
        "noise / N",
        "x noise",
        "explainable",
        "tared",
    ];
    let rows = comparison.forces.iter().map(|force| {
        let name = format!("s{} F{}", force.sensor, force.axis.letter());
        let mut cells = error_cells(&name, &force.error, force.floor, force.explainable, 3);
        cells.push(force.tared_rms.map_or_else(|| "-".to_owned(), |rms| format!("{rms:.3}")));
        cells
    });
    TextTable::new(&heads, 1, rows)
}

fn format_force(comparison: &Comparison) -> String {
    if let Some(why) = &comparison.no_forces {
        return terminal::paragraph(&format!("No forces: {}.", missing_forces(why))) + "\n";
    }
    format!(
        "{HEADING}Held-out force error of the device code (fixed point){HEADING:#}\n{}\n{}\n",
        force_table(comparison),
        tare_warning(&comparison.forces)
    )
}

/// Warning if taring increases the error.
fn tare_warning(forces: &[ForceAxisErrors]) -> String {
    let harmed = |force: &ForceAxisErrors| {
        force.tared_rms.is_some_and(|tared| tared > TARE_HARM * force.error.rms)
    };
    if forces.iter().any(harmed) {
        terminal::paragraph(
            "Taring increases the error: the tare adds the model error at rest (for example a neighbour's magnet at closed fingers) to every row.",
        )
    } else {
        String::new()
    }
}

/// Two models on the same rows.
fn side_by_side(one: &Comparison, other: &Comparison) -> String {
    let mut table = terminal::table([
        "",
        "excess / N",
        "force / N",
        "noise / N",
        &format!("field / {}", one.noise.unit.symbol()),
        "x floor",
        "residual follows",
        "share",
    ]);
    for model in [one, other] {
        let (rms, floor) = (rms_g(&model.axes), floor_g(&model.axes));
        let first = model.located.iter().find(|located| located.chosen);
        let force = model.force();
        let newtons = |figure: fn(&ForceError) -> f64| {
            force.as_ref().map_or_else(|| "-".to_owned(), |force| format!("{:.3}", figure(force)))
        };
        table.add_row([
            model.model.clone(),
            newtons(ForceError::excess_n),
            newtons(|force| force.rms_n),
            newtons(|force| force.noise_n),
            format!("{rms:.4}"),
            format!("{:.2}", rms / floor),
            first.map_or("none", |located| located.words.as_ref()).to_owned(),
            first.map_or_else(|| "-".to_owned(), |l| format!("{:.0} %", 100.0 * l.share)),
        ]);
    }
    terminal::right_align(&mut table, 1);
    format!(
        "\n{HEADING}Comparison with the baseline{HEADING:#}\n{table}\n{}",
        terminal::paragraph(&format!("{}: {}", other.model, verdict(other)))
    )
}

pub fn to_json(comparison: &Comparison) -> Value {
    let findings = comparison.findings.iter().map(|finding| {
        json!({
            "id": finding.id,
            "column": finding.place.column,
            "file": finding.place.file.display().to_string(),
            "line": finding.place.line,
            "message": findings::message(finding),
            "stops": finding.stops,
            "fix": finding.fix.as_ref().map(findings::fix),
        })
    });
    let mut object = json!({
        "model": comparison.model,
        "campaign": comparison.campaign,
        "findings": findings.collect::<Vec<_>>(),
        "judged": validation(comparison),
        "axes": comparison.axes.iter().map(axis_json).collect::<Vec<_>>(),
        "force": comparison.force(),
        "force_origins": force_origins(comparison),
        "forces": comparison.forces.iter().map(force_json).collect::<Vec<_>>(),
        "where": comparison.located,
        "not_recorded": comparison.not_recorded,
        "worst": comparison.worst.iter().map(worst_json).collect::<Vec<_>>(),
        "correlation_s": comparison.correlation_s,
        "signal_unit": comparison.noise.unit.symbol(),
        "noise": comparison.noise,
        "verdict": verdict(comparison),
    });
    parameters::add_json(&mut object, &comparison.parameters);
    if let Some(other) = &comparison.other {
        object["with"] = to_json(other);
    }
    object
}

fn axis_json(axis: &FieldAxisErrors) -> Value {
    json!({
        "sensor": axis.sensor,
        "axis": axis.axis.letter(),
        "rms_g": axis.error.rms,
        "mean_g": axis.error.mean,
        "std_g": axis.error.std,
        "p95_g": axis.error.p95,
        "max_g": axis.error.greatest,
        "span_g": axis.error.span,
        "floor_g": axis.floor.total,
        "floor": {
            "white_g": axis.floor.white,
            "quantisation_g": axis.floor.quantisation,
            "reference_g": axis.floor.reference,
            "slow_g": axis.floor.slow,
            "replicates_g": axis.floor.replicates,
        },
        "explainable_g": axis.explainable,
    })
}

fn force_json(force: &ForceAxisErrors) -> Value {
    json!({
        "sensor": force.sensor,
        "axis": force.axis.letter(),
        "rmse_n": force.error.rms,
        "mean_n": force.error.mean,
        "std_n": force.error.std,
        "p95_n": force.error.p95,
        "max_n": force.error.greatest,
        "span_n": force.error.span,
        "tared_rmse_n": force.tared_rms,
        "floor_n": force.floor,
        "explainable_n": force.explainable,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis::compare::Validation;

    #[test]
    fn headline_says_where_rows_are_not_held_out() {
        let force = |rms: f64| ForceAxisErrors {
            sensor: 0,
            axis: model_export::recordings::columns::Axis::X,
            error: ErrorStatistics { rms, ..ErrorStatistics::default() },
            recorded_rms: rms,
            reducible_rms: rms,
            flagged: None,
            tared_rms: None,
            floor: 0.4,
            explainable: 0.0,
        };
        let of = |rms: f64, validation: Validation| Comparison {
            forces: vec![force(rms)],
            validation: Some(validation),
            ..Comparison::default()
        };
        let unseen = || of(0.5, Validation::UnseenRecordings);
        let fitted = || of(0.5, Validation::NotHeldOut("no".to_owned()));
        assert!(force_headline(&unseen()).starts_with("Force error (held out: "));
        assert!(force_headline(&fitted()).starts_with("Force error (NOT held out: "));
        let both = Comparison { other: Some(Box::new(fitted())), ..unseen() };
        let headline = force_headline(&both);
        assert!(headline.contains("Baseline, on other rows: Force error (NOT held out: "));
        assert_eq!(force_headline(&Comparison::default()), "");
    }
}

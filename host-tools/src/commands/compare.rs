//! `magpie compare`: residuals of a model on a campaign, and what explains them.

use std::path::PathBuf;

use anstyle::{AnsiColor, Style};
use anyhow::Result;
use serde_json::{Value, json};

use crate::analysis::compare::format::{self, AT_FLOOR};
use crate::analysis::compare::pipeline::compare;
use crate::analysis::compare::{
    Attribution, Bin, Comparison, FieldAxisErrors, ForceAxisErrors, WorstInterval,
};
use crate::analysis::data_quality::{Finding, fix};
use crate::analysis::statistics::ErrorStatistics;
use crate::commands::args::CompareArgs;
use crate::terminal;

/// Evaluate a model on recordings: residuals, noise floor, and what the residuals depend on.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  cargo magpie compare model.toml tests/data/demo -o report.html
  cargo magpie compare model.toml tests/data/demo --baseline better.toml
  cargo magpie compare model.toml tests/data/demo --fix corrected
  cargo magpie compare model.toml tests/data/demo --json | jq '.where[0]'")]
pub struct Args {
    #[command(flatten)]
    common: CompareArgs,
    /// A second model, evaluated on the same rows.
    #[arg(long, alias = "with", value_name = "OTHER")]
    baseline: Option<PathBuf>,
    /// Write corrected copies of the recordings: all setup errors with an unambiguous correction.
    #[arg(long, value_name = "NEW")]
    fix: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &Args) -> Result<()> {
    let common = &args.common;
    let input = &common.input;
    common.check_output()?;
    let comparison = compare(
        &input.model,
        &input.campaign,
        args.baseline.as_deref(),
        input.align.alignment()?,
        input.options(),
    )?;
    terminal::print_result(input.json, || to_json(&comparison), || format_report(&comparison))?;
    common.write_report(&comparison, &[])?;
    if let Some(to) = &args.fix {
        for correction in fix::write(&input.campaign, &comparison.findings, to)? {
            common.print_line(&correction)?;
        }
        common.print_line(&format!("Corrected recordings: {}", to.display()))?;
    }
    Ok(())
}

const GOOD: Style = AnsiColor::Green.on_default().bold();
const WARNING: Style = AnsiColor::Yellow.on_default().bold();
const ERROR: Style = AnsiColor::Red.on_default().bold();
const HEADING: Style = Style::new().bold();

/// A tare that multiplies the error by this factor is reported.
const TARE_HARM: f64 = 1.2;
/// Maximum number of rows for covariates that were not selected.
const UNSELECTED_ROWS: usize = 4;
/// Covariates that explain a smaller share are omitted.
const SHARE_MIN: f64 = 0.005;
/// Maximum length of a sparkline in characters.
const SPARKLINE_LENGTH: usize = 20;

fn format_report(comparison: &Comparison) -> String {
    let mut page = data_findings(&comparison.findings);
    if comparison.axes.is_empty() {
        page += &colored(ERROR, &comparison.verdict);
        return page;
    }
    page += &field_table(comparison);
    page += &force_table(comparison);
    page += &attribution_table(comparison);
    page += &worst_segments(&comparison.worst);
    page += &terminal::paragraph(&format!("Held-out rows: {}.", comparison.validation));
    if let Some(other) = &comparison.other {
        page += &side_by_side(comparison, other);
    }
    page.push('\n');
    page + &colored(verdict_style(comparison), &comparison.verdict)
}

fn colored(style: Style, text: &str) -> String {
    // Line by line, so that a pager that shows one line keeps its color.
    terminal::paragraph(text).lines().map(|line| format!("{style}{line}{style:#}\n")).collect()
}

fn verdict_style(comparison: &Comparison) -> Style {
    if format::rms_g(&comparison.axes) <= AT_FLOOR * format::floor_g(&comparison.axes) {
        GOOD
    } else {
        WARNING
    }
}

/// Data-quality findings as text.
pub fn data_findings(findings: &[Finding]) -> String {
    if findings.is_empty() {
        return "No setup errors were found in these recordings.\n\n".to_owned();
    }
    let stops = findings.iter().any(|finding| finding.stops);
    let (style, advice) = if stops {
        (ERROR, "fix before evaluating the model")
    } else {
        (WARNING, "check before judging the model")
    };
    let mut page =
        colored(style, &format!("Setup errors in the recordings ({}), {advice}:", findings.len()));
    for (i, finding) in findings.iter().enumerate() {
        page += &terminal::paragraph(&format!("  {}. {}: {}", i + 1, finding.id, finding.message));
        page += &terminal::paragraph(&format!("     {}", finding.place));
        if let Some(fix) = &finding.fix {
            page += &terminal::paragraph(&format!("     --fix: {fix}"));
        }
    }
    page + "\n"
}

fn field_table(comparison: &Comparison) -> String {
    let heads = [
        "field",
        "rms / G",
        "mean",
        "std",
        "P95",
        "max",
        "% of span",
        "floor / G",
        "x floor",
        "explainable",
    ];
    let mut table = terminal::table(heads);
    let digits = decimals(comparison.axes.iter().map(|axis| axis.floor.total));
    for axis in &comparison.axes {
        let name = format!("s{} {}", axis.sensor, axis.axis.letter());
        table.add_row(error_cells(&name, &axis.error, axis.floor.total, axis.explainable, digits));
    }
    terminal::right_align(&mut table, 1);
    format!(
        "{HEADING}Held-out field residual (measured minus model){HEADING:#}\n{table}\n{}\n",
        floor_sentence(&comparison.axes)
    )
}

/// Number of decimals that gives the smallest floor two significant digits.
fn decimals(floors: impl Iterator<Item = f64>) -> usize {
    let min = floors.filter(|floor| *floor > 0.0).fold(f64::INFINITY, f64::min);
    terminal::decimals_for(min).max(3)
}

fn error_cells(
    name: &str,
    error: &ErrorStatistics,
    floor: f64,
    explainable: f64,
    digits: usize,
) -> Vec<String> {
    let number = |value: f64| format!("{value:.digits$}");
    vec![
        name.to_owned(),
        number(error.rms),
        number(error.mean),
        number(error.std),
        number(error.p95),
        number(error.greatest),
        format!("{:.2}", 100.0 * error.rms / error.span),
        number(floor),
        if floor > 0.0 { format!("{:.2}", error.rms / floor) } else { "-".to_owned() },
        number(explainable),
    ]
}

/// Components of the noise floor.
fn floor_sentence(axes: &[FieldAxisErrors]) -> String {
    let mean = |of: &dyn Fn(&FieldAxisErrors) -> Option<f64>| {
        let values: Vec<f64> = axes.iter().filter_map(of).collect();
        let squares: f64 = values.iter().map(|value| value * value).sum();
        (!values.is_empty()).then(|| format::field((squares / values.len() as f64).sqrt()))
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
        Some(scatter) => format!("; pure error of replicates {scatter}."),
        None => "; too few replicates for a pure error.".to_owned(),
    };
    terminal::paragraph(&text)
}

fn force_table(comparison: &Comparison) -> String {
    if let Some(why) = &comparison.no_forces {
        return terminal::paragraph(&format!("No forces: {why}.")) + "\n";
    }
    let heads = [
        "force",
        "rmse / N",
        "mean",
        "std",
        "P95",
        "max",
        "% of span",
        "noise / N",
        "x noise",
        "explainable",
        "tared",
    ];
    let mut table = terminal::table(heads);
    for force in &comparison.forces {
        let name = format!("s{} F{}", force.sensor, force.axis.letter());
        let mut cells = error_cells(&name, &force.error, force.floor, force.explainable, 3);
        cells.push(force.tared_rms.map_or_else(|| "-".to_owned(), |rms| format!("{rms:.3}")));
        table.add_row(cells);
    }
    terminal::right_align(&mut table, 1);
    format!(
        "{HEADING}Held-out force error of the device code (fixed point){HEADING:#}\n{table}\n{}\n",
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

fn attribution_table(comparison: &Comparison) -> String {
    let chosen = comparison.located.iter().filter(|l| l.chosen);
    let others = comparison
        .located
        .iter()
        .filter(|l| !l.chosen && l.share >= SHARE_MIN)
        .take(UNSELECTED_ROWS);
    let candidates = comparison.located.len();
    let shown: Vec<&Attribution> = chosen.chain(others).collect();
    if shown.is_empty() {
        return format!(
            "{HEADING}Attribution of the residual{HEADING:#}\nNone of {candidates} covariates explains the residual.\n\n"
        );
    }
    let heads = ["", "residual follows", "share", "from", "mean error by bin", "to", "of", "± G"];
    let mut table = terminal::table(heads);
    for (i, one) in shown.into_iter().enumerate() {
        let ends = one.bins.first().zip(one.bins.last());
        let channel = strongest(one);
        let end = |value: Option<f64>| match value {
            Some(value) if one.bins.len() > 1 => {
                format!("{} {}", format::short(value), one.unit).trim_end().to_owned()
            }
            _ => String::new(),
        };
        table.add_row([
            if one.chosen { format!("{}.", i + 1) } else { String::new() },
            one.words.to_string(),
            format!("{:.1} %", 100.0 * one.share),
            end(ends.map(|(first, _)| first.from)),
            channel.map_or_else(String::new, |channel| sparkline(one, channel)),
            end(ends.map(|(_, last)| last.to)),
            channel.map_or_else(String::new, |(sensor, axis)| {
                format!("s{} {}", one.sensors[sensor], ["x", "y", "z"][axis])
            }),
            channel.map_or_else(String::new, |channel| format::short(max_mean(one, channel))),
        ]);
    }
    let mut page = format!("{HEADING}Attribution of the residual{HEADING:#}\n{table}\n");
    let lines = comparison.located.iter().filter(|l| l.chosen).map(format::follows);
    for line in lines {
        page += &terminal::paragraph(&format!("{line}."));
    }
    page += &terminal::paragraph(&format!(
        "Share: of the squared residual above the floor, on held-out rows, in addition to the previous covariates. Bars: the channel with the largest variation, from -G to +G. Correlation time of the residual: {:.2} s.",
        comparison.correlation_s
    ));
    page + "\n"
}

/// Sensor index and axis with the largest variation of the mean error over the bins.
fn strongest(located: &Attribution) -> Option<(usize, usize)> {
    let sensors = 0..located.sensors.len();
    let channels = sensors.flat_map(|sensor| [0, 1, 2].map(|axis| (sensor, axis)));
    let variation = |channel: &(usize, usize)| {
        let means = means(located, *channel);
        let (low, high) = means
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), m| (low.min(*m), high.max(*m)));
        match located.bins.len() {
            1 => low.abs(),
            _ => high - low,
        }
    };
    channels.max_by(|a, b| variation(a).total_cmp(&variation(b)))
}

fn means(located: &Attribution, (sensor, axis): (usize, usize)) -> Vec<f64> {
    located.bins.iter().filter_map(|bin| Some(bin.mean_g.get(sensor)?[axis])).collect()
}

/// Maximum absolute mean error of any bin.
fn max_mean(located: &Attribution, channel: (usize, usize)) -> f64 {
    means(located, channel).iter().map(|mean| mean.abs()).fold(0.0, f64::max)
}

/// Mean error in each bin, scaled to its maximum magnitude.
fn sparkline(located: &Attribution, channel: (usize, usize)) -> String {
    const BLOCKS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let max = max_mean(located, channel).max(f64::MIN_POSITIVE);
    let block = |mean: &f64| {
        let height = 0.5 * (mean / max + 1.0) * (BLOCKS.len() - 1) as f64;
        BLOCKS.get(height.round() as usize).copied().unwrap_or(' ')
    };
    means(located, channel).iter().take(SPARKLINE_LENGTH).map(block).collect()
}

fn worst_segments(list: &[WorstInterval]) -> String {
    let heads = ["worst segments", "seconds", "rms / G", "max at", "activity"];
    let mut table = terminal::table(heads);
    for one in list {
        table.add_row([
            format!("recording {}", one.recording),
            format!("{:.0} to {:.0}", one.from_s, one.to_s),
            format!("{:.3}", one.rms_g),
            format!("s{}", one.sensor),
            one.doing.clone(),
        ]);
    }
    format!("{table}\n(rms over all channels)\n\n")
}

/// Two models on the same rows.
fn side_by_side(one: &Comparison, other: &Comparison) -> String {
    let mut table =
        terminal::table(["", "field / G", "x floor", "force / N", "first covariate", "share"]);
    for model in [one, other] {
        let (rms, floor) = (format::rms_g(&model.axes), format::floor_g(&model.axes));
        let first = model.located.iter().find(|located| located.chosen);
        let newtons = |forces: &[ForceAxisErrors]| match format::rmse_n(forces) {
            n if n.is_finite() => format!("{n:.3}"),
            _ => "-".to_owned(),
        };
        table.add_row([
            model.model.clone(),
            format!("{rms:.4}"),
            format!("{:.2}", rms / floor),
            newtons(&model.forces),
            first.map_or("none", |located| located.words.as_ref()).to_owned(),
            first.map_or_else(|| "-".to_owned(), |l| format!("{:.0} %", 100.0 * l.share)),
        ]);
    }
    terminal::right_align(&mut table, 1);
    format!(
        "\n{HEADING}Comparison with the baseline{HEADING:#}\n{table}\n{}",
        terminal::paragraph(&format!("{}: {}", other.model, other.verdict))
    )
}

fn to_json(comparison: &Comparison) -> Value {
    let findings = comparison.findings.iter().map(|finding| {
        json!({
            "id": finding.id,
            "column": finding.place.column,
            "file": finding.place.file.display().to_string(),
            "line": finding.place.line,
            "message": finding.message,
            "stops": finding.stops,
            "fix": finding.fix.as_ref().map(ToString::to_string),
        })
    });
    let mut object = json!({
        "model": comparison.model,
        "campaign": comparison.campaign,
        "findings": findings.collect::<Vec<_>>(),
        "judged": comparison.validation,
        "axes": comparison.axes.iter().map(axis_json).collect::<Vec<_>>(),
        "forces": comparison.forces.iter().map(force_json).collect::<Vec<_>>(),
        "where": comparison.located.iter().map(located_json).collect::<Vec<_>>(),
        "worst": comparison.worst.iter().map(worst_json).collect::<Vec<_>>(),
        "correlation_s": comparison.correlation_s,
        "verdict": comparison.verdict,
    });
    if let (Some(other), Some(fields)) = (&comparison.other, object.as_object_mut()) {
        fields.insert("with".to_owned(), to_json(other));
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

fn located_json(located: &Attribution) -> Value {
    json!({
        "covariate": located.covariate,
        "unit": located.unit,
        "share": located.share,
        "alone": located.alone,
        "chosen": located.chosen,
        "sensors": located.sensors,
        "bins": located.bins.iter().map(bin_json).collect::<Vec<_>>(),
    })
}

fn bin_json(bin: &Bin) -> Value {
    json!({
        "from": bin.from,
        "to": bin.to,
        "centre": bin.centre,
        "rows": bin.rows,
        "rms_g": bin.rms_g,
        "share": bin.share,
        "mean_g": bin.mean_g,
        "band_g": bin.band_g,
    })
}

fn worst_json(worst: &WorstInterval) -> Value {
    json!({
        "recording": worst.recording,
        "from_s": worst.from_s,
        "to_s": worst.to_s,
        "sensor": worst.sensor,
        "rms_g": worst.rms_g,
        "doing": worst.doing,
    })
}

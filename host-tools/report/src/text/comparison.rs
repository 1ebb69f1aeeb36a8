//! Text and JSON of a comparison.

use crate::text::diagnosis::below_floor;
use analysis::compare::attribution::MIN_SHARE;
use analysis::compare::{
    AT_FLOOR, Attribution, BELOW_FLOOR, Bin, Comparison, ErrorUnit, FieldAxisErrors,
    ForceAxisErrors, ForceError, MeanCondition, Validation, WorstInterval, floor_g, is_at_floor,
    rms_g,
};
use analysis::data_quality::Finding;
use analysis::notes::MissingForces;
use analysis::numbers::{self, three_digits};
use analysis::replay::tare::TARE_HARM;
use analysis::statistics::{ErrorStatistics, pooled_rms};
use anstyle::Style;
use model_export::fit::cross_validation::{CvSplit, MAX_RECORDING_FOLDS};
use model_export::recordings::columns::SignalUnit;
use serde_json::{Value, json};

use crate::text::terminal::{self, ERROR, GOOD, HEADING, WARNING, WIDTH};
use crate::text::{findings, force_error};

/// Fraction of the explained residual that counts as concentrated.
const CONCENTRATED: f64 = 0.6;
/// Maximum fraction of the rows in a concentrated range.
const MAX_ROWS: f64 = 0.45;

/// Maximum number of rows for covariates that were not selected.
const UNSELECTED_ROWS: usize = 4;
/// Covariates that explain a smaller share are omitted.
const SHARE_MIN: f64 = 0.005;
/// Maximum length of a sparkline in characters.
const SPARKLINE_LENGTH: usize = 20;

/// Result as tables and text.
pub fn format_report(comparison: &Comparison) -> String {
    let mut page = data_findings(&comparison.findings);
    if comparison.axes.is_empty() {
        page += &colored(ERROR, &verdict(comparison));
        return page;
    }
    page += &field_table(comparison);
    page += &force_table(comparison);
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

/// Data-quality findings as text.
pub fn data_findings(findings: &[Finding]) -> String {
    if findings.is_empty() {
        return "No setup errors were found in these recordings.\n\n".to_owned();
    }
    let stops = findings.iter().any(|finding| finding.stops);
    let (style, advice) = if stops {
        (ERROR, "fix before evaluating the model")
    } else {
        (WARNING, "check before evaluating the model")
    };
    let mut page =
        colored(style, &format!("Setup errors in the recordings ({}), {advice}:", findings.len()));
    for (i, finding) in findings.iter().enumerate() {
        page += &terminal::paragraph(&format!(
            "  {}. {}: {}",
            i + 1,
            finding.id,
            findings::message(finding)
        ));
        page += &terminal::paragraph(&format!("     {}", finding.place));
        if let Some(fix) = &finding.fix {
            page += &terminal::paragraph(&format!("     --fix: {}", findings::fix(fix)));
        }
    }
    page + "\n"
}

fn field_table(comparison: &Comparison) -> String {
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
    let mut table = terminal::table(heads);
    let digits = decimals(comparison.axes.iter().map(|axis| axis.floor.total));
    for axis in &comparison.axes {
        let name = format!("s{} {}", axis.sensor, axis.axis.letter());
        table.add_row(error_cells(&name, &axis.error, axis.floor.total, axis.explainable, digits));
    }
    terminal::right_align(&mut table, 1);
    format!(
        "{HEADING}Held-out field residual (measured minus model){HEADING:#}\n{table}\n{}\n",
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

fn force_table(comparison: &Comparison) -> String {
    if let Some(why) = &comparison.no_forces {
        return terminal::paragraph(&format!("No forces: {}.", missing_forces(why))) + "\n";
    }
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
    let not_recorded = not_recorded(comparison).map(|text| terminal::paragraph(&text));
    let not_recorded = not_recorded.unwrap_or_default();
    if shown.is_empty() {
        return format!(
            "{HEADING}Attribution of the residual{HEADING:#}\nNone of {candidates} covariates explains the residual.\n{not_recorded}\n"
        );
    }
    let unit = shown.first().map_or_else(Default::default, |one| one.error_unit);
    let scale = format!("± {}", unit.symbol());
    let heads = ["", "residual follows", "share", "from", "mean error by bin", "to", "of", &scale];
    let mut table = terminal::table(heads);
    for (i, one) in shown.into_iter().enumerate() {
        let ends = one.bins.first().zip(one.bins.last());
        let channel = strongest(one);
        let end = |value: Option<f64>| match value {
            Some(value) if one.bins.len() > 1 => {
                format!("{} {}", numbers::three_digits(value), one.unit).trim_end().to_owned()
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
                format!("s{} {}", one.sensors[sensor], unit.axis_names()[axis])
            }),
            channel
                .map_or_else(String::new, |channel| numbers::three_digits(max_mean(one, channel))),
        ]);
    }
    let mut page = format!("{HEADING}Attribution of the residual{HEADING:#}\n{table}\n");
    let lines = comparison.located.iter().filter(|l| l.chosen).map(follows);
    for line in lines {
        page += &terminal::paragraph(&format!("{line}."));
    }
    page += &terminal::paragraph(&format!(
        "Residual: {}. Share: of the squared residual above the floor, on held-out rows, in addition to the previous covariates. Bars: the channel with the largest variation, to the value in the last column. Correlation time of the residual: {:.2} s.",
        residual_words(unit),
        comparison.correlation_s
    ));
    page + &not_recorded + "\n"
}

/// What a residual is.
pub fn residual_words(unit: ErrorUnit) -> String {
    match unit {
        ErrorUnit::Newton => {
            "error of both forces that the residual of the field causes in the device's inverse, in newtons".to_owned()
        }
        ErrorUnit::Signal(SignalUnit::Gauss) => {
            "measured minus modelled field, in gauss".to_owned()
        }
        ErrorUnit::Signal(SignalUnit::Other(symbol)) => {
            format!("measured minus modelled signal, in {symbol}")
        }
    }
}

/// The covariates on which nothing can be said; `None` if all were recorded.
pub fn not_recorded(comparison: &Comparison) -> Option<String> {
    (!comparison.not_recorded.is_empty()).then(|| {
        format!(
            "Not recorded, so that nothing can be said on a dependence: {}.",
            comparison.not_recorded.join(", ")
        )
    })
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
    located.bins.iter().filter_map(|bin| Some(bin.mean.get(sensor)?[axis])).collect()
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

/// How the errors were separated from the fit, as a clause; empty without an evaluation.
pub fn validation(comparison: &Comparison) -> String {
    match &comparison.validation {
        None => String::new(),
        Some(Validation::UnseenRecordings) => {
            "the model was not fitted to any of these recordings; its parameters are used unchanged"
                .to_owned()
        }
        Some(Validation::NotHeldOut(why)) => format!(
            "NOT held out: the model was fitted to these recordings and could not be fitted again ({why})"
        ),
        Some(Validation::Edited(worse)) => format!(
            "the file's parameters have {worse:.2} times the error of a fit to the same recordings; they are used unchanged"
        ),
        Some(Validation::CrossValidated { split, seen, refitted, all }) => {
            cross_validation(*split, *seen, *refitted, *all)
        }
    }
}

fn cross_validation(split: CvSplit, seen: usize, refitted: usize, all: usize) -> String {
    let how = match split {
        CvSplit::Recordings(count) if count > MAX_RECORDING_FOLDS => {
            "each tenth of the recordings is predicted by a fit to the others"
        }
        CvSplit::Recordings(_) => "each recording is predicted by a fit to the others",
        CvSplit::KFold => {
            "one recording: each sixth is predicted by a fit to the rest; no claim about other recordings"
        }
        CvSplit::Interleaved { block_ms } => &format!(
            "an effect is transient: every sixth block of {} s is predicted by a fit to the rest",
            numbers::decimal(1e-3 * f64::from(block_ms), 3)
        ),
        CvSplit::Blocks { block_ms, .. } => &dependent_blocks(block_ms),
    };
    let some = if refitted < seen {
        format!(
            "; fitted to {refitted} of {seen} recordings, uniformly chosen; the others are predicted by that fit"
        )
    } else {
        String::new()
    };
    let unseen = match all - seen {
        0 => String::new(),
        1 => "; 1 recording outside the fit is predicted by the model's own parameters".to_owned(),
        n => {
            format!("; {n} recordings outside the fit are predicted by the model's own parameters")
        }
    };
    format!("{how}{some}{unseen}")
}

/// What held out means where the recordings are not independent.
pub fn dependent_blocks(block_ms: u32) -> String {
    format!(
        "the recordings are not independent (see the findings): every sixth block of {} s, at the same time in all of them, is predicted by a fit to the rest without a third of a block on both sides; held out are other times of one run, so no claim about other recordings",
        numbers::decimal(1e-3 * f64::from(block_ms), 3)
    )
}

pub fn missing_forces(why: &MissingForces) -> String {
    match why {
        MissingForces::NotInvertible(why) => why.to_string(),
        MissingForces::NotCompensable(why) => why.to_string(),
        MissingForces::NotRepresentable(why) => {
            format!("the device's tables cannot hold them: {why}")
        }
        MissingForces::NoValidRow => {
            "no row has both a valid estimate and the reference forces".to_owned()
        }
    }
}

/// Means of the main covariates in an interval: "Fx 41 N, opening 2 mm".
pub fn conditions(interval: &WorstInterval) -> String {
    let conditions = interval.conditions.iter();
    let text = |MeanCondition { label, mean, unit }: &MeanCondition| {
        format!("{label} {mean:.0} {unit}").trim_start().to_owned()
    };
    conditions.map(text).collect::<Vec<_>>().join(", ")
}

fn worst_json(interval: &WorstInterval) -> Value {
    let mut object = json!(interval);
    object["doing"] = conditions(interval).into();
    object
}

fn worst_segments(list: &[WorstInterval]) -> String {
    let heads = ["worst segments", "seconds", "rms", "max at", "activity"];
    let mut table = terminal::table(heads);
    for one in list {
        table.add_row([
            format!("recording {}", one.recording),
            format!("{:.0} to {:.0}", one.from_s, one.to_s),
            format!("{:.3} {}", one.rms, one.error_unit.symbol()),
            format!("s{}", one.sensor),
            conditions(one),
        ]);
    }
    format!("{table}\n(rms over all channels)\n\n")
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

/// Verdict in one paragraph.
pub fn verdict(comparison: &Comparison) -> String {
    let findings = &comparison.findings;
    if findings.iter().any(|finding| finding.stops) {
        return stopped_verdict(findings);
    }
    let conclusion = conclusion(comparison);
    match caveat(findings) {
        Some(caveat) => format!("{caveat} {conclusion}"),
        None => conclusion,
    }
}

fn conclusion(comparison: &Comparison) -> String {
    let (rms, floor) = (rms_g(&comparison.axes), floor_g(&comparison.axes));
    let span = pooled_rms(comparison.axes.iter().map(|axis| axis.error.span));
    let field = |value| numbers::signal(value, comparison.noise.unit);
    let error = format!("field {} held out ({:.2} % of the range)", field(rms), 100.0 * rms / span);
    if floor <= 0.0 || floor.is_nan() {
        return format!(
            "Inconclusive: the noise of these recordings is unknown, so there is no floor to compare {error} with."
        );
    }
    let worst =
        comparison.axes.iter().map(|axis| axis.error.rms / axis.floor.total).fold(0.0, f64::max);
    if rms < BELOW_FLOOR * floor {
        return below_floor(rms, floor, comparison.noise.unit);
    }
    let chosen: Vec<&Attribution> = comparison.located.iter().filter(|l| l.chosen).collect();
    if comparison.noise.disagreement.is_some() && rms <= AT_FLOOR * floor {
        return format!(
            "Inconclusive: {error}, the floor of {} is uncertain: see the findings.",
            field(floor)
        );
    }
    if is_at_floor(rms / floor, Some(worst)) {
        if let Some(lead) = chosen.first() {
            return format!(
                "Within {:.0} % of the noise floor: {error}, the floor is {}; {:.0} % of the remaining residual {}.",
                100.0 * (rms / floor - 1.0),
                field(floor),
                100.0 * lead.share,
                dependence(&lead.covariate, &lead.words)
            );
        }
        let excess = comparison.force().as_ref().and_then(force_error::larger_excess);
        return match excess {
            None => format!(
                "At the noise floor: {error}, the floor is {}. The field shows no missing effect.",
                field(floor)
            ),
            Some(excess) => {
                format!(
                    "Field at its noise floor: {error}, the floor is {}. {excess}",
                    field(floor)
                )
            }
        };
    }
    let located: f64 = chosen.iter().map(|l| l.share).sum();
    let unexplained = 1.0 - located;
    let lead = match chosen.first() {
        None => "no covariate explains the residual".to_owned(),
        Some(lead) => format!(
            "{}{}",
            follows(lead),
            match chosen.len() {
                1 => String::new(),
                _ => format!(
                    "; with {} it is {:.0} %",
                    chosen[1].words,
                    100.0 * (lead.share + chosen[1].share)
                ),
            }
        ),
    };
    let open = if unexplained >= MIN_SHARE && !chosen.is_empty() {
        format!("; {:.0} % follow no covariate", 100.0 * unexplained)
    } else {
        String::new()
    };
    // At most two lines: the tables have the rest.
    format!(
        "Structure remains: field {} held out, {:.1} times the floor; {lead}{open}.",
        field(rms),
        rms / floor
    )
}

/// Verdict where a setup error stops the comparison.
pub fn stopped_verdict(findings: &[Finding]) -> String {
    let mut stop: Vec<&str> = findings.iter().filter(|f| f.stops).map(|f| f.id).collect();
    stop.dedup();
    let fix = if findings.iter().any(|finding| finding.fix.is_some()) {
        " (--fix NEW writes a copy of the recordings with all unambiguous repairs)"
    } else {
        ""
    };
    format!(
        "Not compared: fix {} first{fix}; until then the errors do not describe the model.",
        stop.join(", ")
    )
}

/// Caveat to the verdict where the data contain setup errors.
fn caveat(findings: &[Finding]) -> Option<String> {
    let mut ids: Vec<&str> = findings.iter().map(|finding| finding.id).collect();
    ids.retain(|id| *id != "constant_covariate");
    ids.dedup();
    (!ids.is_empty()).then(|| {
        format!(
            "The data contain {}; results below include it. Fix the data before evaluating the model.",
            ids.join(", ")
        )
    })
}

/// "follows the opening" or "is a constant of each channel".
pub fn dependence(covariate: &str, words: &str) -> String {
    if covariate == "constant" { format!("is {words}") } else { format!("follows the {words}") }
}

/// "48 % of the residual follows the opening, most of it below 12 mm".
pub fn follows(located: &Attribution) -> String {
    let share = format!(
        "{:.0} % of the residual {}",
        100.0 * located.share,
        dependence(&located.covariate, &located.words)
    );
    if located.covariate == "constant" {
        return format!(
            "{share}: another gripper, a displaced magnet, or a reference that was not zeroed"
        );
    }
    match concentrated(located) {
        Some(place) => format!("{share}, most of it {place}"),
        None => share,
    }
}

/// Range below or above a limit that contains most of the explained residual.
fn concentrated(located: &Attribution) -> Option<String> {
    let all: f64 = located.bins.iter().map(|bin| bin.share).sum();
    let (count, rows) =
        (located.bins.len(), located.bins.iter().map(|bin| bin.rows).sum::<usize>());
    if all <= 0.0 || count < 4 {
        return None;
    }
    let few = |bins: &[Bin]| {
        let share: f64 = bins.iter().map(|bin| bin.share).sum();
        let inside: usize = bins.iter().map(|bin| bin.rows).sum();
        share >= CONCENTRATED * all && (inside as f64) < MAX_ROWS * rows as f64
    };
    let number = |value: f64| match located.unit {
        "" => format!("{value:.0}"),
        unit => format!("{} {unit}", three_digits(value)),
    };
    (1..count).find_map(|k| {
        if few(&located.bins[..k]) {
            return Some(format!("below {}", number(located.bins[k - 1].to)));
        }
        few(&located.bins[count - k..])
            .then(|| format!("above {}", number(located.bins[count - k].from)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn located(shares: [f64; 6]) -> Attribution {
        let bin = |(i, share): (usize, &f64)| Bin {
            from: 4.0 * i as f64,
            to: 4.0 * i as f64 + 4.0,
            rows: 100,
            share: *share,
            ..Bin::default()
        };
        Attribution {
            covariate: "opening_mm".into(),
            words: "opening".into(),
            unit: "mm",
            share: 0.48,
            alone: 0.48,
            chosen: true,
            error_unit: ErrorUnit::Newton,
            sensors: vec![0],
            bins: shares.iter().enumerate().map(bin).collect(),
        }
    }

    #[test]
    fn concentrated_residual_is_reported_with_its_limit() {
        assert_eq!(
            follows(&located([0.3, 0.1, 0.02, 0.02, 0.02, 0.02])),
            "48 % of the residual follows the opening, most of it below 4.00 mm"
        );
        assert_eq!(
            follows(&located([0.0, 0.0, 0.0, 0.01, 0.15, 0.35])),
            "48 % of the residual follows the opening, most of it above 20.0 mm"
        );
    }

    #[test]
    fn uniform_residual_has_no_limit() {
        assert_eq!(follows(&located([0.1; 6])), "48 % of the residual follows the opening");
    }

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

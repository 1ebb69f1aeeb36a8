//! What `magpie compare` shows in the terminal.

use anstyle::{AnsiColor, Style};

use crate::compare::finding::Finding;
use crate::compare::words::{self, AT_FLOOR};
use crate::compare::{AxisFigures, Comparison, Figures, ForceFigures, Located, Worst};
use crate::show;

const GOOD: Style = AnsiColor::Green.on_default().bold();
const DOUBTFUL: Style = AnsiColor::Yellow.on_default().bold();
const BAD: Style = AnsiColor::Red.on_default().bold();
const HEAD: Style = Style::new().bold();

/// A tare that multiplies an error by this is worth a word.
const TARE_HARM: f64 = 1.2;
/// Covariates that are not chosen and yet shown, with the most that they would locate.
const ALSO: usize = 4;
/// Covariates that locate less than this share are not shown.
const SEEN: f64 = 0.005;
/// Widest text of a bar in characters.
const BAR: usize = 20;

/// The page.
pub fn text(comparison: &Comparison) -> String {
    let mut page = findings(&comparison.findings);
    if comparison.axes.is_empty() {
        page += &coloured(BAD, &comparison.verdict);
        return page;
    }
    page += &field(comparison);
    page += &forces(comparison);
    page += &located(comparison);
    page += &worst(&comparison.worst);
    page += &show::paragraph(&format!("Held out: {}.", comparison.judged));
    if let Some(other) = &comparison.other {
        page += &beside(comparison, other);
    }
    page.push('\n');
    page + &coloured(verdict_style(comparison), &comparison.verdict)
}

fn coloured(style: Style, text: &str) -> String {
    // Each line for itself: a reader that shows one line keeps its colour.
    show::paragraph(text)
        .lines()
        .map(|line| format!("{style}{line}{style:#}\n"))
        .collect()
}

fn verdict_style(comparison: &Comparison) -> Style {
    match words::rms_g(&comparison.axes) <= AT_FLOOR * words::floor_g(&comparison.axes) {
        true => GOOD,
        false => DOUBTFUL,
    }
}

/// Mistakes of the rig, before any statistics.
pub fn findings(findings: &[Finding]) -> String {
    if findings.is_empty() {
        return "No mistake of the rig was found in these recordings.\n\n".to_owned();
    }
    let stops = findings.iter().any(|finding| finding.stops);
    let (style, say) = match stops {
        true => (BAD, "to be mended before anything is said of the model"),
        false => (DOUBTFUL, "to be known before the model is blamed"),
    };
    let mut page = coloured(
        style,
        &format!("Found in the recordings ({}), {say}:", findings.len()),
    );
    for (i, finding) in findings.iter().enumerate() {
        page += &show::paragraph(&format!("  {}. {}: {}", i + 1, finding.id, finding.message));
        page += &show::paragraph(&format!("     {}", finding.place));
        if let Some(fix) = &finding.fix {
            page += &show::paragraph(&format!("     --fix would: {fix}"));
        }
    }
    page + "\n"
}

fn field(comparison: &Comparison) -> String {
    let heads = [
        "field",
        "rms / G",
        "mean",
        "std",
        "P95",
        "greatest",
        "% of span",
        "floor / G",
        "x floor",
        "explainable",
    ];
    let mut table = show::table(heads);
    let digits = decimals(comparison.axes.iter().map(|axis| axis.floor.total));
    for axis in &comparison.axes {
        let name = format!("s{} {}", axis.sensor, axis.axis.letter());
        table.add_row(row(
            &name,
            &axis.error,
            axis.floor.total,
            axis.explainable,
            digits,
        ));
    }
    show::right_align(&mut table, 1);
    format!(
        "{HEAD}Field, measured minus modelled, held out{HEAD:#}\n{table}\n{}\n",
        floor(&comparison.axes)
    )
}

/// Decimals that show a floor to two digits.
fn decimals(floors: impl Iterator<Item = f64>) -> usize {
    let least = floors
        .filter(|floor| *floor > 0.0)
        .fold(f64::INFINITY, f64::min);
    show::decimals_for(least).max(3)
}

fn row(name: &str, error: &Figures, floor: f64, explainable: f64, digits: usize) -> Vec<String> {
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
        match floor > 0.0 {
            true => format!("{:.2}", error.rms / floor),
            false => "-".to_owned(),
        },
        number(explainable),
    ]
}

/// Of what the floor consists.
fn floor(axes: &[AxisFigures]) -> String {
    let mean = |of: &dyn Fn(&AxisFigures) -> Option<f64>| {
        let values: Vec<f64> = axes.iter().filter_map(of).collect();
        let squares: f64 = values.iter().map(|value| value * value).sum();
        (!values.is_empty()).then(|| words::field((squares / values.len() as f64).sqrt()))
    };
    let mut text = format!(
        "The floor: white noise {} and the reference's noise {}; steps of the word {}",
        mean(&|axis| Some(axis.floor.white)).unwrap_or_default(),
        mean(&|axis| Some(axis.floor.reference)).unwrap_or_default(),
        mean(&|axis| Some(axis.floor.quantisation)).unwrap_or_default(),
    );
    text += &match mean(&|axis| axis.floor.slow) {
        Some(slow) => format!("; at rest {slow} wander slowly"),
        None => "; slow wander unknown, no rest of 10 s was recorded".to_owned(),
    };
    text += &match mean(&|axis| axis.floor.replicates) {
        Some(scatter) => format!("; visits of one condition scatter by {scatter}."),
        None => "; no condition was met often enough to compare visits.".to_owned(),
    };
    show::paragraph(&text)
}

fn forces(comparison: &Comparison) -> String {
    if let Some(why) = &comparison.no_forces {
        return show::paragraph(&format!("No forces: {why}.")) + "\n";
    }
    let heads = [
        "force",
        "rmse / N",
        "mean",
        "std",
        "P95",
        "greatest",
        "% of span",
        "noise / N",
        "x noise",
        "explainable",
        "tared",
    ];
    let mut table = show::table(heads);
    for force in &comparison.forces {
        let name = format!("s{} F{}", force.sensor, force.axis.letter());
        let mut cells = row(&name, &force.error, force.floor, force.explainable, 3);
        cells.push(
            force
                .tared_rms
                .map_or_else(|| "-".to_owned(), |rms| format!("{rms:.3}")),
        );
        table.add_row(cells);
    }
    show::right_align(&mut table, 1);
    format!(
        "{HEAD}Force through the device's fixed-point code, held out{HEAD:#}\n{table}\n{}\n",
        tare(&comparison.forces)
    )
}

/// Where a tare does harm.
fn tare(forces: &[ForceFigures]) -> String {
    let harmed = |force: &ForceFigures| {
        force
            .tared_rms
            .is_some_and(|tared| tared > TARE_HARM * force.error.rms)
    };
    match forces.iter().any(harmed) {
        true => show::paragraph(
            "A tare makes it worse: what the model errs by at rest (a neighbour's magnet beside closed fingers, say) is then in every row.",
        ),
        false => String::new(),
    }
}

fn located(comparison: &Comparison) -> String {
    let chosen = comparison.located.iter().filter(|l| l.chosen);
    let others = comparison
        .located
        .iter()
        .filter(|l| !l.chosen && l.share >= SEEN)
        .take(ALSO);
    let looked_at = comparison.located.len();
    let shown: Vec<&Located> = chosen.chain(others).collect();
    if shown.is_empty() {
        return format!(
            "{HEAD}Where it fails{HEAD:#}\nNone of {looked_at} covariates locates anything of what is left.\n\n"
        );
    }
    let heads = [
        "",
        "what is left follows",
        "share",
        "from",
        "mean error by bin",
        "to",
        "of",
        "± G",
    ];
    let mut table = show::table(heads);
    for (i, one) in shown.into_iter().enumerate() {
        let ends = one.bins.first().zip(one.bins.last());
        let channel = strongest(one);
        let end = |value: Option<f64>| match value {
            Some(value) if one.bins.len() > 1 => format!("{} {}", words::short(value), one.unit)
                .trim_end()
                .to_owned(),
            _ => String::new(),
        };
        table.add_row([
            match one.chosen {
                true => format!("{}.", i + 1),
                false => String::new(),
            },
            one.words.to_string(),
            format!("{:.1} %", 100.0 * one.share),
            end(ends.map(|(first, _)| first.from)),
            channel.map_or_else(String::new, |channel| sparkline(one, channel)),
            end(ends.map(|(_, last)| last.to)),
            channel.map_or_else(String::new, |(sensor, axis)| {
                format!("s{} {}", one.sensors[sensor], ["x", "y", "z"][axis])
            }),
            channel.map_or_else(String::new, |channel| words::short(reach(one, channel))),
        ]);
    }
    let mut page = format!("{HEAD}Where it fails{HEAD:#}\n{table}\n");
    let lines = comparison
        .located
        .iter()
        .filter(|l| l.chosen)
        .map(words::follows);
    for line in lines {
        page += &show::paragraph(&format!("{line}."));
    }
    page += &show::paragraph(&format!(
        "Shares are of the squared residual above the floor, of rows that took no part; each beyond the ones before it. The bars show the channel in which it is seen best, from -G to +G. The residual is correlated over {:.2} s.",
        comparison.correlation_s
    ));
    page + "\n"
}

/// The sensor (by place) and axis whose mean error varies most over the bins.
fn strongest(located: &Located) -> Option<(usize, usize)> {
    let sensors = 0..located.sensors.len();
    let channels = sensors.flat_map(|sensor| [0, 1, 2].map(|axis| (sensor, axis)));
    let spread = |channel: &(usize, usize)| {
        let means = means(located, *channel);
        let (low, high) = means
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), m| {
                (low.min(*m), high.max(*m))
            });
        match located.bins.len() {
            1 => low.abs(),
            _ => high - low,
        }
    };
    channels.max_by(|a, b| spread(a).total_cmp(&spread(b)))
}

fn means(located: &Located, (sensor, axis): (usize, usize)) -> Vec<f64> {
    located
        .bins
        .iter()
        .filter_map(|bin| Some(bin.mean_g.get(sensor)?[axis]))
        .collect()
}

/// Greatest mean error of any bin, in size.
fn reach(located: &Located, channel: (usize, usize)) -> f64 {
    means(located, channel)
        .iter()
        .map(|mean| mean.abs())
        .fold(0.0, f64::max)
}

/// Mean error in each bin, from its greatest size below zero to the same above.
fn sparkline(located: &Located, channel: (usize, usize)) -> String {
    const BLOCKS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let most = reach(located, channel).max(f64::MIN_POSITIVE);
    let block = |mean: &f64| {
        let height = 0.5 * (mean / most + 1.0) * (BLOCKS.len() - 1) as f64;
        BLOCKS.get(height.round() as usize).copied().unwrap_or(' ')
    };
    means(located, channel)
        .iter()
        .take(BAR)
        .map(block)
        .collect()
}

fn worst(list: &[Worst]) -> String {
    let heads = ["worst stretches", "seconds", "rms / G", "most at", "while"];
    let mut table = show::table(heads);
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

/// Two models side by side.
fn beside(one: &Comparison, other: &Comparison) -> String {
    let mut table = show::table([
        "",
        "field / G",
        "x floor",
        "force / N",
        "first covariate",
        "share",
    ]);
    for model in [one, other] {
        let (rms, floor) = (words::rms_g(&model.axes), words::floor_g(&model.axes));
        let first = model.located.iter().find(|located| located.chosen);
        let newtons = |forces: &[ForceFigures]| match words::rmse_n(forces) {
            n if n.is_finite() => format!("{n:.3}"),
            _ => "-".to_owned(),
        };
        table.add_row([
            model.model.clone(),
            format!("{rms:.4}"),
            format!("{:.2}", rms / floor),
            newtons(&model.forces),
            first
                .map_or("none", |located| located.words.as_ref())
                .to_owned(),
            first.map_or_else(|| "-".to_owned(), |l| format!("{:.0} %", 100.0 * l.share)),
        ]);
    }
    show::right_align(&mut table, 1);
    format!(
        "\n{HEAD}Side by side{HEAD:#}\n{table}\n{}",
        show::paragraph(&format!("{}: {}", other.model, other.verdict))
    )
}

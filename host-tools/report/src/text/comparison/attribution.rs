//! What the residual of a comparison follows, and where it is largest.

use analysis::compare::{Attribution, Bin, Comparison, ErrorUnit, MeanCondition, WorstInterval};
use analysis::numbers::{self, three_digits};
use model_export::recordings::columns::SignalUnit;
use serde_json::{Value, json};

use crate::text::terminal::{self, HEADING};

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

pub(super) fn attribution_table(comparison: &Comparison) -> String {
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

/// "follows the opening" or "is a constant of each channel".
pub fn dependence(covariate: &str, words: &str) -> String {
    if covariate == "constant" { format!("is {words}") } else { format!("follows the {words}") }
}

/// "48 % of the residual follows the opening, most of it below 12 mm".
pub(super) fn follows(located: &Attribution) -> String {
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

/// Means of the main covariates in an interval: "Fx 41 N, opening 2 mm".
pub fn conditions(interval: &WorstInterval) -> String {
    let conditions = interval.conditions.iter();
    let text = |MeanCondition { label, mean, unit }: &MeanCondition| {
        format!("{label} {mean:.0} {unit}").trim_start().to_owned()
    };
    conditions.map(text).collect::<Vec<_>>().join(", ")
}

pub(super) fn worst_json(interval: &WorstInterval) -> Value {
    let mut object = json!(interval);
    object["doing"] = conditions(interval).into();
    object
}

pub(super) fn worst_segments(list: &[WorstInterval]) -> String {
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
}

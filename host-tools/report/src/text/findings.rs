//! Text of setup errors: what was found, the evidence in numbers, and the remedy, in one sentence for each, and their list.

use analysis::data_quality::Finding;
use analysis::data_quality::evidence::{
    ClockOffset, ColumnError, ColumnSet, Evidence, LineSource, Magnitude, RecordingOffset,
    RecordingSet,
};
use analysis::data_quality::fix::{Fix, FixKind};
use analysis::diagnose::recording_differences::explains_all;
use analysis::numbers::{decimal, signal, with_error};
use model_export::fit::recording_differences::DifferenceCause;
use model_export::recordings::dependence::DependenceKind;

use crate::text::terminal::{self, ERROR, WARNING, WIDTH};

/// Recordings that are not independent, with the consequence.
fn dependent(kind: DependenceKind, recordings: &str, share: f64) -> String {
    let percent = percent(share);
    let what = match kind {
        DependenceKind::Copy => format!("{percent} of the rows {recordings} are the same rows"),
        DependenceKind::Overlap => format!(
            "the clocks {recordings} overlap by {percent}: one gripper has one field at a time, so these are rows of one run, or the starts are wrong"
        ),
        DependenceKind::OneRun => format!(
            "forces, covariates and field follow one path of time {recordings} ({percent} of their variance), within the noise: rows of one run in turn, or a programme repeated exactly"
        ),
        DependenceKind::OnePath => format!(
            "forces and covariates follow one path of time {recordings} ({percent} of their variance), the field does not: repeats of one programme. Held out is one of these repeats, so no claim about other loads"
        ),
    };
    let cure = match kind {
        DependenceKind::Copy => "remove the copies",
        DependenceKind::Overlap => "give each recording its rows in one piece, or correct start_s",
        DependenceKind::OneRun => "join the rows of a run, and record others with other loads",
        DependenceKind::OnePath => "record others with other loads and covariates",
    };
    match kind {
        DependenceKind::OnePath => format!("{what}; {cure}"),
        _ => format!(
            "{what}. They do not count as separate recordings: held out are blocks of time with a gap; {cure}"
        ),
    }
}

/// Number of names in a list before "and n more".
const LISTED: usize = 6;

/// All findings with their locations and repairs, or that there are none.
pub fn format_list(findings: &[Finding]) -> String {
    if findings.is_empty() {
        return "No setup errors were found in these recordings.\n\n".to_owned();
    }
    let stops = findings.iter().any(|finding| finding.stops);
    let (style, advice) = if stops {
        (ERROR, "fix before evaluating the model")
    } else {
        (WARNING, "check before evaluating the model")
    };
    let heading = format!("Setup errors in the recordings ({}), {advice}:", findings.len());
    let mut page = terminal::styled(style, &heading, WIDTH);
    for (i, finding) in findings.iter().enumerate() {
        page += &terminal::paragraph(&format!("  {}. {}: {}", i + 1, finding.id, message(finding)));
        page += &terminal::paragraph(&format!("     {}", finding.place));
        if let Some(repair) = finding.fix.as_ref().map(fix) {
            page += &terminal::paragraph(&format!("     --fix: {repair}"));
        }
    }
    page + "\n"
}

/// The finding as a sentence, without its location.
pub fn message(finding: &Finding) -> String {
    match &finding.evidence {
        Evidence::ClockBackwards { falls, before_us, after_us, late, rows, copies, sortable } => {
            let advice = match (sortable, copies) {
                (true, 0) => {
                    "sorting by time fixes it: look for a logger that mixes up its buffers"
                }
                (true, _) => {
                    "some rows are duplicates: sorting by time and removing the duplicates fixes it; look for a logger that sends a buffer twice"
                }
                (false, _) => {
                    "too many rows to sort safely: split the recording here if the clock was reset, or remove the rows with a wrong time"
                }
            };
            let times = counted(*falls, "once", "times");
            format!(
                "the clock runs backwards {times}, first here from {before_us} to {after_us} us, and {late} of {rows} rows are earlier than one before them; {advice}"
            )
        }
        Evidence::DuplicateRows { identical, different } => duplicate_rows(*identical, *different),
        Evidence::ClockUnit { recordings, period_us, duration_s } => {
            let (period, unit, declared) = if *period_us > 1e3 {
                let period = format!("{} s", digits(1e-6 * period_us));
                (period, "milliseconds or microseconds", "a larger unit")
            } else {
                (format!("{} us", digits(*period_us)), "seconds or milliseconds", "a smaller unit")
            };
            format!(
                "rows are {period} apart {}, the recording lasts {} s: it looks as if the clock counted {unit} and was imported as {declared}; correct its unit in the mapping and import again",
                in_recordings(recordings),
                digits(*duration_s),
            )
        }
        Evidence::Wrapped { columns, worst, rows, of, counts, offset } => format!(
            "{} wrapped by {counts} counts: {rows} of {of} values of {worst} are off by {}, the range of an integer, which is no saturation; add {} to them, and correct the driver (two's complement)",
            columns_in(columns),
            digits(offset.abs()),
            digits(*offset),
        ),
        Evidence::ClockGaps { gaps, recordings, lost, from_s, longest_ms, period_ms } => format!(
            "{} in the clock {}, {} of the total time; the longest here, from {} s on: {} ms where rows are {} ms apart. Rows next to a gap are excluded; look for lost transfers or a blocked logger",
            counted(*gaps, "1 gap", "gaps"),
            in_recordings(recordings),
            percent(*lost),
            digits(*from_s),
            digits(*longest_ms),
            digits(*period_ms),
        ),
        Evidence::RepeatedSamples { sensors, recordings, share, by_chance, rate_hz } => {
            let sensors = match sensors {
                None => "every sensor".to_owned(),
                Some(numbers) => list(numbers.iter().map(|number| format!("s{number}"))),
            };
            format!(
                "{} of the rows repeat the previous field of {sensors} {}, where noise alone gives {}: the sensors are read less often than rows are written, about {} times a second. Averages then contain fewer independent samples than rows, and the field is delayed by half the repetition; read the sensors once per row, or write one row per sample",
                percent(*share),
                in_recordings(recordings),
                percent(*by_chance),
                digits(*rate_hz),
            )
        }
        Evidence::CovariateUnit { columns, found, expected, certain, example, magnitude } => {
            let (one, several) =
                if *certain { ("is", "are") } else { ("seems to be", "seem to be") };
            format!(
                "{} {} in {found}, not in {expected}: {example} is {}; convert the column",
                columns_in(columns),
                verb(columns, one, several),
                match magnitude {
                    Magnitude::Maximum(value) => format!("up to {}", digits(*value)),
                    Magnitude::Median(value) => format!("{} in the middle", digits(*value)),
                    Magnitude::VectorLength(value) =>
                        format!("part of a vector whose length is {} in the middle", digits(*value)),
                }
            )
        }
        Evidence::ChannelUnit { columns, noise_ratio, factor } => format!(
            "{} {} {} times the noise of the other field channels, and {} magnitude differs as much from the same axis of other sensors: the unit is another one{}",
            columns_in(columns),
            verb(columns, "has", "have"),
            digits(*noise_ratio),
            verb(columns, "its", "their"),
            match factor {
                Some(factor) => format!(
                    " by a factor of {factor} (1 mT is 10 G, 100 uT are 1 G); convert the column"
                ),
                None => "; check the column's scale".to_owned(),
            }
        ),
        Evidence::StuckThroughout { columns, value, at_limit, in_every_recording } => format!(
            "{} {} {}{} in every row; a working channel shows noise: look for a broken wire, a sensor that was not read, or a column filled by hand{}",
            columns_in(columns),
            verb(columns, "is", "are"),
            value.map_or_else(|| "constant, each at its own value,".to_owned(), digits),
            if *at_limit { ", the end of its range" } else { "" },
            if *in_every_recording { "" } else { ", and exclude that recording" }
        ),
        Evidence::Frozen { columns, from_s, to_s, rows, value, noise } => format!(
            "{} {} constant from {} to {} s, {rows} rows of the same value{}, where noise of {} would change nearly every row; look for a loose connector or a sensor that stopped, and cut out this stretch",
            columns_in(columns),
            verb(columns, "is", "are"),
            digits(*from_s),
            digits(*to_s),
            value.map_or_else(String::new, |value| format!(" ({})", digits(value))),
            digits(*noise),
        ),
        Evidence::Saturated { columns, worst, share } => format!(
            "{} {} the end of its range, most in {worst} with {} of the rows; those rows are excluded: widen the gap or reduce the load",
            columns_in(columns),
            verb(columns, "reaches", "reach"),
            percent(*share),
        ),
        Evidence::Clipped { columns, worst, share, value, at_rest } => {
            let advice = if *at_rest {
                "this is correct where the signal only rests at zero, as on a scale; otherwise forces of one sign are lost: adjust the zero of the amplifier"
            } else {
                "look for a limit in the amplifier, the converter or the logger, or reduce the load"
            };
            format!(
                "{} {} clipped: up to {} of the rows of {worst} are exactly {} and none exceeds it, where noise would scatter them; {advice}. These rows are not excluded automatically",
                columns_in(columns),
                verb(columns, "is", "are"),
                percent(*share),
                digits(*value),
            )
        }
        Evidence::MissingTemperature { sensors, recordings } => {
            let columns = list(sensors.iter().map(|sensor| format!("s{sensor}_temp_c")));
            let (verb, them) = if sensors.len() == 1 { ("is", "it") } else { ("are", "them") };
            format!(
                "{columns} {verb} missing {}, but other sensors have a temperature: effects of temperature cannot be tested at {}; record {them}, or copy the column of a sensor at the same temperature",
                in_recordings(recordings),
                list(sensors.iter().map(|sensor| format!("sensor {sensor}"))),
            )
        }
        Evidence::DependentRecordings { kind, recordings, share } => {
            dependent(*kind, &in_recordings(recordings), *share)
        }
        Evidence::ShuffledRows { recordings } => format!(
            "the order of the rows {} carries no time: successive rows are as far apart as any two, in forces, covariates and field. Effects of time, rate and history cannot be tested, and differences of rows are no estimate of the noise; record or export the rows in the order of their times",
            in_recordings(recordings)
        ),
        Evidence::NoiseDisagreement(one) => format!(
            "the noise is uncertain: in {} it is {} as used, and {} by {}. The residual cannot be compared with such a floor; record a rest of ten seconds, or repeat some loads",
            one.rows,
            signal(one.used_g, one.unit),
            signal(one.other_g, one.unit),
            one.other
        ),
        Evidence::ConstantCovariates { columns, effects } => {
            let effects = match effects.as_slice() {
                [] => "effects that depend on it".to_owned(),
                effects => list(effects),
            };
            format!(
                "no variation above the noise: {} in the whole campaign; {effects} cannot be tested; record while it changes, or remove the column if it was not measured",
                list(columns.iter().map(|(name, mean)| format!("{name} at {}", digits(*mean)))),
            )
        }
        Evidence::Outliers { columns, values, threshold, worst, deviation_g, noise_g } => format!(
            "{}: {} from both neighbours by more than {threshold} times the noise; the largest here, in {worst}, by {} G at a noise of {} G. Look for disturbed transfers, and remove these rows: averaging spreads them",
            columns_in(columns),
            counted(*values, "1 value deviates", "values deviate"),
            digits(*deviation_g),
            digits(*noise_g),
        ),
        Evidence::CoarseSteps { columns, worst, step, in_counts, steps } => format!(
            "{} {} in coarse steps, the coarsest in {worst}: every value is {} {}from the next, {} steps over the span, which adds an error of {} that averaging does not remove; write more digits, or look for bits lost in a driver",
            columns_in(columns),
            verb(columns, "changes", "change"),
            digits(*step),
            if *in_counts { "counts " } else { "" },
            digits(*steps),
            // Standard deviation of a rounding error.
            digits(step / 12_f64.sqrt()),
        ),
        Evidence::SpectralLine { columns, lines_hz, worst, amplitude, unit, source } => format!(
            "a line at {} Hz in {}, up to {} {unit} in {worst}: {}",
            list(lines_hz.iter().map(|hz| digits(*hz))),
            columns_in(columns),
            digits(*amplitude),
            line_advice(*source),
        ),
        Evidence::ColumnErrors {
            columns,
            recordings,
            before_g,
            after_g,
            alternatives,
            is_unit,
        } => {
            format!(
                "{} {}: the model leaves {} G as recorded and {} G with this corrected (RMS); {}",
                column_errors(columns),
                throughout_or_in(recordings),
                digits(*before_g),
                digits(*after_g),
                column_advice(alternatives, finding.fix.is_some(), *is_unit),
            )
        }
        Evidence::ClockOffsets { offsets, share, delay_ms } => {
            clock_offsets(offsets, *share, *delay_ms, finding.fix.is_some())
        }
        Evidence::RecordingDifference {
            cause,
            reference,
            unit,
            offsets,
            equivalent,
            effects,
            floors,
        } => {
            let what = cause.name();
            let offsets = offsets.iter().map(|one| {
                let RecordingOffset { recording, quantity, value, std_error } = one;
                let sign = if *value > 0.0 { "+" } else { "" };
                let offset = with_error(*value, *std_error, 1.0);
                format!("{quantity} by {sign}{offset} {unit} in recording {recording}")
            });
            let or = match equivalent.as_slice() {
                [] => String::new(),
                others => format!(
                    " On these recordings {} {} as much.",
                    list(others.iter().map(|other| other.name())),
                    if others.len() == 1 { "explains" } else { "explain" }
                ),
            };
            format!(
                "{what} differs between the recordings. Against recording {reference}: {}. The residual falls from {:.2} to {:.2} noise floors with it, and {}.{or} {}. `diagnose` {}",
                list(offsets),
                floors[0],
                floors[1],
                match effects.as_slice() {
                    [] => "no effect of the catalogue explains as much".to_owned(),
                    [effect] => format!("{effect} explains as much"),
                    effects => format!("{} explain as much", list(effects)),
                },
                difference_advice(*cause),
                match cause {
                    _ if !effects.is_empty() =>
                        "searches for effects on the recordings as they are",
                    DifferenceCause::MagnetPlace if !explains_all(*floors) =>
                        "searches for effects on the recordings as they are",
                    _ => "searches for effects on the recordings without it",
                }
            )
        }
        Evidence::ClockLag { lag_ms, recordings, sensors, share, delay_ms } => {
            let (direction, cause) = if *lag_ms > 0.0 {
                (
                    "behind",
                    "A viscous lag of the flexures, friction or a filter of the reference looks the same: `diagnose` compares them; if the clocks are the cause, ",
                )
            } else {
                (
                    "ahead of",
                    "A flexure cannot lead its force: the clocks are the cause, or a filter of the reference, which `diagnose` compares; friction and lag shift this estimate: prefer that of clock_skew there, if it differs. If the clocks are the cause, ",
                )
            };
            let (place, remedy) = if recordings.is_all {
                (
                    "in every recording".to_owned(),
                    format!("read the recordings with --delay-ms {delay_ms:.1}"),
                )
            } else {
                (
                    format!("in recording {}", list(&recordings.names)),
                    format!(
                        "add {} to t_us of force.csv there; a delay for the whole campaign would misalign the other recordings",
                        (1e3 * lag_ms).round()
                    ),
                )
            };
            let sensors = match sensors {
                1 => "the only sensor".to_owned(),
                n => format!("all {n} sensors"),
            };
            format!(
                "the field is {:.1} ms {direction} the force {place}, the same at {sensors}: correcting this removes {} of the error above the noise. {cause}{remedy}",
                lag_ms.abs(),
                percent(*share),
            )
        }
    }
}

pub fn fix(fix: &Fix) -> String {
    match fix.kind {
        FixKind::SortRows => "puts the rows in order of time".to_owned(),
        FixKind::RemoveDuplicates => "removes rows that are exact duplicates".to_owned(),
        FixKind::ConvertUnit(from, to) => format!("converts from {from} to {to}"),
        FixKind::ConvertColumns => "converts the columns".to_owned(),
        FixKind::NegateColumns => "negates the columns".to_owned(),
        FixKind::AlignClock => "moves the reference's times to the board's clock".to_owned(),
        FixKind::AlignZeros => {
            "gives the forces of all recordings the zero of the first".to_owned()
        }
        FixKind::Unwrap => "adds the range of the counts to the values that wrapped".to_owned(),
        FixKind::ReorderColumns => "restores the order of the columns".to_owned(),
    }
}

/// What to look for.
const fn difference_advice(cause: DifferenceCause) -> &'static str {
    match cause {
        DifferenceCause::ReferenceZero => {
            "Look for a reference that was set to zero under a load, or a finger that rested on something; a magnet that moved by force / stiffness looks the same. `compare --fix NEW` gives a copy the zero of the first recording"
        }
        DifferenceCause::FieldZero => {
            "Look for a magnet or steel near the gripper, another attitude in the earth's field, or another sensor"
        }
        DifferenceCause::MagnetPlace => {
            "Look for a mounting that was opened, or another gripper, and record each mounting as a campaign of its own"
        }
    }
}

/// Offsets and rates, what aligning them removes, and how to apply them.
fn clock_offsets(
    offsets: &[ClockOffset],
    share: f64,
    delay_ms: Option<f64>,
    is_fixed: bool,
) -> String {
    let one = |offset: &ClockOffset| {
        let mut text = format!("{:+.1}±{:.1} ms", offset.offset_ms, offset.offset_error_ms);
        if offset.rate_ppm != 0.0 {
            text += &format!(" and {:+.0}±{:.0} ppm", offset.rate_ppm, offset.rate_error_ppm);
        }
        text
    };
    let (what, remedy) = match delay_ms {
        Some(delay_ms) => {
            let error_ms =
                1.0 / offsets.iter().map(|of| of.offset_error_ms.powi(-2)).sum::<f64>().sqrt();
            let remedy = format!("read the recordings with --delay-ms {delay_ms:.1}");
            (format!("{delay_ms:+.1}±{error_ms:.1} ms in every recording"), remedy)
        }
        None => {
            let each =
                offsets.iter().map(|of| format!("{} in recording {}", one(of), of.recording));
            (list(each), "apply them to t_us of force.csv".to_owned())
        }
    };
    let remedy = match (is_fixed, delay_ms) {
        (true, Some(_)) => format!("--fix NEW applies it to a copy; or {remedy}"),
        (true, None) => "--fix NEW applies them to a copy".to_owned(),
        (false, _) => format!(
            "a viscous lag of the flexures or a filter of the reference looks the same: `diagnose` compares them; if the clocks are the cause, {remedy}"
        ),
    };
    format!(
        "the clock of the reference differs from the board's; to be added to its times: {what}. The loads show it without a model; aligning them removes {} of the error above the noise. Friction and creep shift this estimate: `diagnose` tests what is left. {remedy}",
        percent(share),
    )
}

fn duplicate_rows(identical: u64, different: u64) -> String {
    let rows = counted(identical + different, "1 row has", "rows have");
    match (identical, different) {
        (_, 0) => format!(
            "{rows} the time of the previous row, first here, and identical cells; remove them and look for a logger that writes a row twice"
        ),
        (0, _) => format!(
            "{rows} the time of the previous row, first here, but different cells, so the correct row is unknown: look for a clock that is too coarse, or for two merged streams"
        ),
        _ => format!(
            "{rows} the time of the previous row, first here: {identical} with identical cells, {different} with different ones, of which the correct row is unknown"
        ),
    }
}

fn line_advice(source: LineSource) -> String {
    match source {
        LineSource::Mains(hz) => format!(
            "mains of {hz} Hz, directly or aliased: look for a ground loop, an unshielded lead or a power supply nearby"
        ),
        LineSource::Rotor(hz) => format!(
            "multiples of the rotor's {} turns per second: the motor's field, or an imbalance; `cargo magpie diagnose` tests motor_leakage",
            digits(hz)
        ),
        LineSource::Unknown => "if the inverter's PWM is near a multiple of the row rate, it aliases to this frequency: shift or synchronise the sampling; otherwise look for a fan, a mechanical resonance or another switching supply".to_owned(),
    }
}

/// Groups columns with the same error.
fn column_errors(columns: &[(String, ColumnError)]) -> String {
    // By their text: factors of several sensors differ in digits that are not shown.
    let mut groups: Vec<(String, &ColumnError, Vec<&str>)> = Vec::new();
    for (column, error) in columns {
        let text = column_error(error, 1);
        match groups.iter_mut().find(|(other, ..)| *other == text) {
            Some((.., names)) if names.contains(&column.as_str()) => {}
            Some((.., names)) => names.push(column),
            None => groups.push((text, error, vec![column])),
        }
    }
    list(
        groups.iter().map(|(_, error, names)| {
            format!("{} {}", list(names), column_error(error, names.len()))
        }),
    )
}

/// The error of this number of columns, with its verb.
fn column_error(error: &ColumnError, columns: usize) -> String {
    let (has, is) = if columns == 1 { ("has", "is") } else { ("have", "are") };
    match error {
        ColumnError::OtherSign => format!("{has} the other sign"),
        ColumnError::RecordedAs { column, negated } => {
            let sign = if *negated { ", with the other sign" } else { "" };
            format!("{is} recorded as {column}{sign}")
        }
        ColumnError::FieldUnit(unit) => format!("{is} in {unit}, not in gauss"),
        ColumnError::FieldFactor { factor, in_counts } => {
            let advice = if *in_counts && columns > 1 {
                " (look at gauss_per_lsb in recording.toml: the sensor's range may be another)"
            } else {
                ""
            };
            format!("{is} {} times the model's field{advice}", digits(*factor))
        }
        ColumnError::ForceUnit(unit) => format!("{is} in {unit}, not in newtons"),
        ColumnError::ForceFactor(factor) => {
            format!("{is} {} times the force that the model needs", digits(*factor))
        }
    }
}

fn column_advice(
    alternatives: &[Vec<(String, ColumnError)>],
    has_fix: bool,
    is_unit: bool,
) -> String {
    if !alternatives.is_empty() {
        return format!(
            "equivalent is that {}: the data cannot decide, so push on one finger by hand and check the signs",
            list(alternatives.iter().map(|columns| column_errors(columns)))
        );
    }
    match (has_fix, is_unit) {
        (true, true) => "convert the column",
        (true, false) => "fix the wiring or the logger, and the recorded columns",
        (false, true) => "determine its unit and convert it",
        (false, false) => "identify the columns on the setup",
    }
    .to_owned()
}

/// Names of the columns and of their recordings.
fn columns_in(columns: &ColumnSet) -> String {
    let of_group = |(names, recordings): &(Vec<String>, RecordingSet)| {
        format!("{} {}", list(names), in_recordings(recordings))
    };
    list(columns.0.iter().map(of_group))
}

fn in_recordings(recordings: &RecordingSet) -> String {
    match (recordings.is_all, recordings.names.len()) {
        (true, 1) => "in the recording".to_owned(),
        (true, _) => "in every recording".to_owned(),
        (false, 1) => format!("in recording {}", recordings.names[0]),
        (false, _) => format!("in recordings {}", list(&recordings.names)),
    }
}

fn throughout_or_in(recordings: &RecordingSet) -> String {
    if recordings.is_all { "throughout".to_owned() } else { in_recordings(recordings) }
}

/// Singular or plural form of a verb.
fn verb(columns: &ColumnSet, one: &'static str, several: &'static str) -> &'static str {
    if columns.is_single() { one } else { several }
}

fn counted(count: u64, one: &str, several: &str) -> String {
    if count == 1 { one.to_owned() } else { format!("{count} {several}") }
}

/// `a, b and c`; long lists are truncated.
fn list(names: impl IntoIterator<Item = impl AsRef<str>>) -> String {
    let names: Vec<_> = names.into_iter().collect();
    let joined = |names: &[_]| names.iter().map(AsRef::as_ref).collect::<Vec<&str>>().join(", ");
    if names.len() > LISTED {
        return format!("{} and {} more", joined(&names[..LISTED - 1]), names.len() - LISTED + 1);
    }
    match names.as_slice() {
        [first @ .., last] if !first.is_empty() => {
            format!("{} and {}", joined(first), last.as_ref())
        }
        names => joined(names),
    }
}

/// Formats a number with three significant digits.
fn digits(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let before = value.abs().log10().floor() as i32;
    if !(-4..6).contains(&before) {
        return format!("{value:.2e}");
    }
    let decimals = usize::try_from(2 - before).unwrap_or(0);
    decimal(value, decimals)
}

/// Formats a share in percent; small positive shares are not rounded to zero.
fn percent(share: f64) -> String {
    if share > 0.0 && share < 1e-4 {
        "less than 0.01 %".to_owned()
    } else {
        format!("{} %", digits(100.0 * share))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_joined_with_and() {
        assert_eq!(list(["a"]), "a");
        assert_eq!(list(["a", "b", "c"]), "a, b and c");
        assert_eq!(list(["a", "b", "c", "d", "e", "f", "g"]), "a, b, c, d, e and 2 more");
    }

    #[test]
    fn numbers_have_three_digits_without_trailing_zeros() {
        assert_eq!(digits(0.012_345), "0.0123");
        assert_eq!(digits(12.0), "12");
        assert_eq!(digits(1234.5), "1234");
        assert_eq!(digits(-0.1), "-0.1");
        assert_eq!(percent(0.5), "50 %");
    }

    #[test]
    fn columns_with_the_same_error_share_a_verb() {
        let other_sign = |column: &str| (column.to_owned(), ColumnError::OtherSign);
        let recorded_as = ColumnError::RecordedAs { column: "s0_z_lsb".to_owned(), negated: true };
        let mut columns = vec![other_sign("s0_y_lsb"), ("s0_x_lsb".to_owned(), recorded_as)];
        assert_eq!(
            column_errors(&columns),
            "s0_y_lsb has the other sign and s0_x_lsb is recorded as s0_z_lsb, with the other sign"
        );
        columns.truncate(1);
        columns.extend([other_sign("s1_y_lsb"), other_sign("s0_y_lsb")]);
        assert_eq!(column_errors(&columns), "s0_y_lsb and s1_y_lsb have the other sign");
    }
}

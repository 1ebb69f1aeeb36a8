//! Periodic disturbances that are not the load.

use crate::data_quality::checks::{Channel, CheckContext, Found, by_table, clock};
use crate::data_quality::evidence::{Evidence, LineSource};
use crate::data_quality::scan::RecordingScan;
use crate::data_quality::scan::column::Quantity;
use crate::data_quality::scan::spectrum::SpectralLine;

/// Mains frequencies in hertz.
const MAINS_HZ: [f64; 2] = [50.0, 60.0];
/// Highest harmonic checked, of mains and of the rotor.
const MULTIPLES: u32 = 6;
/// Relative tolerance of clocks and of the mains frequency.
const EXACT: f64 = 2e-3;
/// Lines below this share of the white noise are ignored.
const MATTERS: f64 = 0.2;
/// Harmonics of the load extend to this multiple of its bandwidth.
const HARMONICS: f64 = 10.0;
/// A line in a force above this share of its span is load.
const LOAD_SHARE: f64 = 0.02;
/// Maximum number of reported lines of unknown source, strongest first.
const MOST: usize = 4;

type ColumnLine<'a> = (Channel<'a>, SpectralLine);

/// Periodic disturbances in fields and forces.
pub fn spectral_lines<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let mut all = Vec::new();
    let columns: Vec<Channel> = context
        .columns()
        .into_iter()
        .filter(|one| !clock::hits(one) && one.table.clock.falls == 0)
        .collect();
    for columns in by_table(columns) {
        let found: Vec<ColumnLine> = columns
            .iter()
            .flat_map(|one| one.column.lines.iter().map(|line| (*one, *line)))
            .filter(|(one, line)| matters(context.recordings, one, line))
            .collect();
        let mut unknown = 0;
        let mains = mains_of(&found);
        for (source, group) in groups(context.recordings, mains, found) {
            unknown += usize::from(source == LineSource::Unknown);
            if unknown <= MOST {
                all.push(disturbance(context, source, &group));
            }
        }
    }
    all
}

/// True where the line is above the noise threshold and not part of the load.
fn matters(recordings: &[RecordingScan], one: &Channel, line: &SpectralLine) -> bool {
    let Some(force) = recordings[one.recording].table("force.csv") else {
        return line.amplitude > MATTERS * one.column.noise();
    };
    let edges = force.columns.iter().map(|column| column.load_edge_hz);
    let load_hz = HARMONICS * edges.fold(0.0, f64::max);
    let is_load = force.columns.iter().any(|column| {
        let same =
            |other: &SpectralLine| (other.hz - line.hz).abs() < 2.0 * other.bin_hz.max(line.bin_hz);
        let large = |other: &SpectralLine| other.amplitude > LOAD_SHARE * column.span();
        column.lines.iter().any(|other| same(other) && large(other))
    });
    line.amplitude > MATTERS * one.column.noise() && line.hz > load_hz && !is_load
}

/// Groups lines by source, strongest source first.
fn groups<'a>(
    recordings: &[RecordingScan],
    mains: [f64; 2],
    found: Vec<ColumnLine<'a>>,
) -> Vec<(LineSource, Vec<ColumnLine<'a>>)> {
    let mut groups: Vec<(LineSource, Vec<ColumnLine>)> = Vec::new();
    for (one, line) in found {
        let source = source(&recordings[one.recording], mains, &one, &line);
        let belongs = |(other, group): &&mut (LineSource, Vec<ColumnLine>)| match source {
            LineSource::Mains(_) => *other == source,
            LineSource::Rotor(_) => matches!(other, LineSource::Rotor(_)),
            LineSource::Unknown => {
                let near = |(_, first): &ColumnLine| (first.hz - line.hz).abs() < 2.0 * line.bin_hz;
                *other == LineSource::Unknown && group.iter().any(near)
            }
        };
        match groups.iter_mut().find(belongs) {
            Some((_, group)) => group.push((one, line)),
            None => groups.push((source, vec![(one, line)])),
        }
    }
    let strength = |group: &[ColumnLine]| {
        let sizes = group.iter().map(|(one, line)| line.amplitude / one.column.noise());
        sizes.fold(0.0, f64::max)
    };
    groups.sort_by(|(_, a), (_, b)| strength(b).total_cmp(&strength(a)));
    groups
}

/// Mains frequencies, first the one that explains more lines: some lines are multiples of both.
fn mains_of(found: &[ColumnLine]) -> [f64; 2] {
    let lines = |mains_hz: f64| {
        let own = found.iter().filter(|found| is_multiple(found, mains_hz));
        own.count()
    };
    let [one, other] = MAINS_HZ;
    if lines(other) > lines(one) { [other, one] } else { [one, other] }
}

fn source(
    recording: &RecordingScan,
    mains: [f64; 2],
    one: &Channel,
    line: &SpectralLine,
) -> LineSource {
    let found = (*one, *line);
    let rotor_hz = recording.table("hall.csv").and_then(|hall| hall.turning.steady_hz());
    match mains.into_iter().find(|hz| is_multiple(&found, *hz)) {
        Some(hz) => LineSource::Mains(hz),
        None => match rotor_hz.filter(|hz| is_multiple(&found, *hz)) {
            Some(hz) => LineSource::Rotor(hz),
            None => LineSource::Unknown,
        },
    }
}

/// True for a line at a multiple of `base_hz`, including aliases at the table's row rate.
fn is_multiple((one, line): &ColumnLine, base_hz: f64) -> bool {
    let rate_hz = 1e6 / one.table.clock.period_us;
    (1..=MULTIPLES).any(|n| {
        let hz = f64::from(n) * base_hz;
        (folded(hz, rate_hz) - line.hz).abs() < 0.5 * line.bin_hz + EXACT * hz
    })
}

/// Alias of a frequency sampled at `rate_hz`.
fn folded(hz: f64, rate_hz: f64) -> f64 {
    (hz - rate_hz * (hz / rate_hz).round()).abs()
}

fn disturbance<'a>(
    context: &CheckContext,
    source: LineSource,
    group: &[ColumnLine<'a>],
) -> Found<'a> {
    let mut seen: Vec<Channel> = group.iter().map(|(one, _)| *one).collect();
    seen.dedup_by(|a, b| a.recording == b.recording && a.column.name == b.column.name);
    let amplitude = |(one, line): &ColumnLine| line.amplitude * one.column.scale;
    let strongest =
        group.iter().max_by(|a, b| amplitude(a).total_cmp(&amplitude(b))).unwrap_or(&group[0]);
    let mut lines: Vec<f64> = group.iter().map(|(_, line)| line.hz).collect();
    lines.sort_by(f64::total_cmp);
    lines.dedup_by(|a, b| (*a - *b).abs() < 2.0 * strongest.1.bin_hz);
    let unit = match strongest.0.column.quantity {
        Quantity::Force => "N",
        _ => "G",
    };
    let evidence = Evidence::SpectralLine {
        columns: context.columns_in(&seen),
        lines_hz: lines,
        worst: strongest.0.column.name.clone(),
        amplitude: amplitude(strongest),
        unit,
        source,
    };
    Found::new(strongest.0.at(2), evidence)
}

#[cfg(test)]
mod tests {
    use super::folded;

    #[test]
    fn frequency_above_nyquist_aliases() {
        assert_eq!(folded(60.0, 100.0), 40.0);
        assert_eq!(folded(250.0, 100.0), 50.0);
        assert_eq!(folded(20_013.0, 1000.0), 13.0);
        assert_eq!(folded(50.0, 1000.0), 50.0);
    }
}

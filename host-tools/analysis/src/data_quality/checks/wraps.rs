//! `wrapped`: integers that a driver took without their sign, or that overflowed, so that values jump by a power of two of counts.

use crate::data_quality::checks::{Channel, CheckContext, Found};
use crate::data_quality::evidence::Evidence;
use crate::data_quality::fix::{Change, Fix, FixKind, Repair};
use crate::data_quality::scan::column::ColumnScan;
use crate::data_quality::scan::{ScannedRow, TolerantReader, finite};
use csv::ByteRecord;

/// Share of the span that a jump must have: what wraps has two ends and nothing between them.
const LEAST_JUMP: f64 = 0.5;
/// Bits of the integers of sensors and converters.
const BITS: std::ops::RangeInclusive<i32> = 8..=24;
/// Maximum deviation of a jump from a power of two of counts: the signal moves from row to row.
const NEAR: f64 = 0.03;
/// Maximum distance of a jump from that power, in root mean squares of the steps between other rows: a signal that wraps
/// moves on as steadily as elsewhere, and the heights of spikes differ.
const STEADY: f64 = 4.0;
/// Ratio of the groups' spans to the distance between them from which the signal itself may have jumped.
const WIDEST: f64 = 0.9;

/// A column with two groups of values.
struct Wrap<'a> {
    channel: Channel<'a>,
    /// Values on the wrong side of it are moved.
    threshold: f64,
    /// To be added to these.
    offset: f64,
    counts: f64,
    rows: u64,
    line: u64,
}

/// Fields whose counts wrapped.
pub fn wrapped<'a>(context: &CheckContext<'a>) -> Vec<Found<'a>> {
    let fields = context.columns().into_iter().filter(|one| one.column.quantity.is_field());
    let wraps: Vec<Wrap> = fields.filter_map(wrap).collect();
    let Some(worst) = wraps.iter().max_by_key(|wrap| wrap.rows) else { return Vec::new() };
    let channels: Vec<Channel> = wraps.iter().map(|wrap| wrap.channel).collect();
    let evidence = Evidence::Wrapped {
        columns: context.columns_in(&channels),
        worst: worst.channel.column.name.clone(),
        rows: worst.rows,
        of: worst.channel.column.rows,
        counts: worst.counts,
        offset: worst.offset,
    };
    let repair = |wrap: &Wrap| Repair {
        file: wrap.channel.table.path.clone(),
        change: Change::Unwrap {
            column: wrap.channel.column.name.clone(),
            threshold: wrap.threshold,
            offset: wrap.offset,
        },
    };
    let fix = Fix { kind: FixKind::Unwrap, repairs: wraps.iter().map(repair).collect() };
    let found = Found::new(worst.channel.at(worst.line), evidence).explaining(&channels);
    vec![found.stopping(Some(fix))]
}

fn wrap(channel: Channel) -> Option<Wrap> {
    let column = channel.column;
    let resolution = column.grid.resolution()?;
    if column.largest_jump < LEAST_JUMP * column.span() {
        return None;
    }
    let bits = (column.largest_jump / resolution).log2().round() as i32;
    let offset = 2_f64.powi(bits) * resolution;
    let is_near = (column.largest_jump / offset - 1.0).abs() < NEAR;
    if !BITS.contains(&bits) || !is_near {
        return None;
    }
    let groups = Groups::read(&channel, 0.5 * (column.extent.0 + column.extent.1))?;
    let is_apart = groups.upper.0 - groups.lower.1 > (1.0 - WIDEST) * offset;
    let widest = (groups.upper.1 - groups.upper.0).max(groups.lower.1 - groups.lower.0);
    if !is_apart || widest > WIDEST * offset {
        return None;
    }
    let furthest = [groups.jumps.0, groups.jumps.1].map(|jump| (jump - offset).abs());
    if furthest.iter().any(|distance| *distance > STEADY * groups.step().max(resolution)) {
        return None;
    }
    let threshold = 0.5 * (groups.upper.0 + groups.lower.1);
    let is_low = groups.is_low_wrong(column);
    Some(Wrap {
        channel,
        threshold,
        offset: if is_low { offset } else { -offset },
        counts: 2_f64.powi(bits),
        rows: groups.rows[usize::from(!is_low)],
        line: groups.lines[usize::from(!is_low)],
    })
}

/// The values below a threshold, and those above.
struct Groups {
    lower: (f64, f64),
    upper: (f64, f64),
    rows: [u64; 2],
    /// Line of the first value of each.
    lines: [u64; 2],
    /// Smallest and largest jump from one to the other.
    jumps: (f64, f64),
    /// Squared steps within each, and their number.
    steps: (f64, u64),
}

impl Groups {
    fn read(channel: &Channel, threshold: f64) -> Option<Self> {
        let none = (f64::INFINITY, f64::NEG_INFINITY);
        let mut groups = Self {
            lower: none,
            upper: none,
            rows: [0; 2],
            lines: [0; 2],
            jumps: none,
            steps: (0.0, 0),
        };
        let mut last: Option<(f64, usize)> = None;
        let mut reader = TolerantReader::open(&channel.table.path)?;
        let mut row = ScannedRow { line: 0, record: ByteRecord::new() };
        while reader.next_into(&mut row) {
            let value = row.record.get(channel.column.index).map_or(f64::NAN, finite);
            if value.is_nan() {
                continue;
            }
            let side = usize::from(value > threshold);
            let extent = if side == 0 { &mut groups.lower } else { &mut groups.upper };
            *extent = (extent.0.min(value), extent.1.max(value));
            if let Some((before, from)) = last.replace((value, side)) {
                let step = (value - before).abs();
                if from == side {
                    groups.steps = (groups.steps.0 + step * step, groups.steps.1 + 1);
                } else {
                    groups.jumps = (groups.jumps.0.min(step), groups.jumps.1.max(step));
                }
            }
            if groups.rows[side] == 0 {
                groups.lines[side] = row.line;
            }
            groups.rows[side] += 1;
        }
        groups.rows.iter().all(|rows| *rows > 0).then_some(groups)
    }

    /// Root mean square of the steps within the groups.
    fn step(&self) -> f64 {
        (self.steps.0 / self.steps.1.max(1) as f64).sqrt()
    }

    /// Whether the lower values are the wrong ones: those beyond the sensor's range, else the rarer.
    fn is_low_wrong(&self, column: &ColumnScan) -> bool {
        let (low, high) = column.limits;
        match (self.lower.0 < low, self.upper.1 > high) {
            (true, false) => true,
            (false, true) => false,
            _ => self.rows[0] < self.rows[1],
        }
    }
}

//! What is kept out of a fit to judge it: one recording after the other, or contiguous sixths of
//! each where there is only one, or where an effect lives in single recordings.

use std::ops::Range;

use super::rows::{Part, SensorRows};

/// Parts into which a recording is cut where none can be left out whole.
const CUTS: usize = 6;

/// Length of a tooth of [`Split::Comb`] in seconds.
const TOOTH_S: f64 = 0.25;

/// Some rows of one recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stretch {
    /// The recording's place in the campaign.
    pub part: usize,
    /// Its rows.
    pub rows: Range<usize>,
}

/// One split into what is fitted and what is judged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fold {
    /// Fitted.
    pub training: Vec<Stretch>,
    /// Judged.
    pub test: Vec<Stretch>,
}

/// How a campaign is split; the same for all its sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Each recording in turn, of this many.
    Recordings(usize),
    /// A contiguous sixth of every recording in turn.
    Sixths,
    /// Every sixth stretch of a quarter of a second in turn: what happened once is seen in part by
    /// every fit.
    Comb,
}

impl Split {
    /// By recordings where there are several, unless something lives within one.
    pub fn of(sensors: &[SensorRows], within_recordings: bool) -> Self {
        let filled = |rows: &SensorRows| rows.parts.iter().filter(|part| !part.is_empty()).count();
        let recordings = sensors.iter().map(filled).max().unwrap_or(0);
        match recordings < 2 {
            _ if within_recordings => Self::Comb,
            true => Self::Sixths,
            false => Self::Recordings(sensors.first().map_or(0, |rows| rows.parts.len())),
        }
    }

    /// Every row is judged once. In sixths, `gap_s` seconds on both sides of a judged stretch are not
    /// fitted either, since rows close in time err together.
    pub fn folds(self, rows: &SensorRows, gap_s: f64) -> Vec<Fold> {
        match self {
            Self::Recordings(count) => (0..count).map(|judged| without(rows, judged)).collect(),
            Self::Sixths => (0..CUTS).map(|cut| sixth(rows, cut, gap_s)).collect(),
            Self::Comb => (0..CUTS).map(|tooth| comb(rows, tooth)).collect(),
        }
    }
}

/// All rows.
pub fn everything(rows: &SensorRows) -> Vec<Stretch> {
    whole(rows).collect()
}

fn whole(rows: &SensorRows) -> impl Iterator<Item = Stretch> {
    let stretch = |(part, rows): (usize, &Part)| Stretch {
        part,
        rows: 0..rows.len(),
    };
    rows.parts.iter().enumerate().map(stretch)
}

fn without(rows: &SensorRows, judged: usize) -> Fold {
    let (test, training) = whole(rows).partition(|stretch| stretch.part == judged);
    Fold { training, test }
}

fn sixth(rows: &SensorRows, cut: usize, gap_s: f64) -> Fold {
    let (mut training, mut test) = (Vec::new(), Vec::new());
    for (i, part) in rows.parts.iter().enumerate() {
        let (Some(first), Some(last)) = (part.time_s.first(), part.time_s.last()) else {
            continue;
        };
        let step = (last - first) / CUTS as f64;
        let before = |time: f64| part.time_s.partition_point(|t| *t < time);
        let from = first + step * cut as f64;
        let to = if cut + 1 == CUTS {
            f64::INFINITY
        } else {
            from + step
        };
        for rows in [0..before(from - gap_s), before(to + gap_s)..part.len()] {
            if !rows.is_empty() {
                training.push(Stretch { part: i, rows });
            }
        }
        test.push(Stretch {
            part: i,
            rows: before(from)..before(to),
        });
    }
    Fold { training, test }
}

fn comb(rows: &SensorRows, tooth: usize) -> Fold {
    let teeth = rows.parts.iter().enumerate().flat_map(|(part, of)| {
        let ranges = stretches(&of.time_s, TOOTH_S).into_iter().enumerate();
        ranges.map(move |(i, rows)| (i % CUTS == tooth, Stretch { part, rows }))
    });
    let (test, training): (Vec<_>, Vec<_>) = teeth.partition(|(judged, _)| *judged);
    let plain = |list: Vec<(bool, Stretch)>| list.into_iter().map(|(_, stretch)| stretch).collect();
    Fold {
        training: plain(training),
        test: plain(test),
    }
}

/// Ranges of rows that each span about `length_s`.
pub fn stretches(time_s: &[f64], length_s: f64) -> Vec<Range<usize>> {
    let (Some(first), Some(last)) = (time_s.first(), time_s.last()) else {
        return Vec::new();
    };
    let count = ((last - first) / length_s).round().max(1.0);
    let step = (last - first) / count;
    let edges: Vec<usize> = (0..count as usize)
        .map(|i| time_s.partition_point(|t| *t < first + step * i as f64))
        .chain([time_s.len()])
        .collect();
    edges
        .windows(2)
        .map(|pair| pair[0]..pair[1])
        .filter(|range| !range.is_empty())
        .collect()
}

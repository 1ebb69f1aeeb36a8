//! What is kept out of a fit to judge it: one recording after the other, or, where there is only
//! one, contiguous sixths of it.

use std::borrow::Cow;
use std::ops::Range;

use super::rows::{Part, SensorRows};

/// Parts into which a single recording is cut.
const SINGLE_CUTS: usize = 6;

/// One split into what is fitted and what is judged.
pub struct Fold<'a> {
    /// Fitted.
    pub training: Vec<Cow<'a, Part>>,
    /// Judged.
    pub test: Vec<Cow<'a, Part>>,
}

/// Every row is judged once. With a single recording, `gap_s` seconds on both sides of the judged
/// stretch are not fitted either, since rows close in time err together.
pub fn folds(rows: &SensorRows, gap_s: f64) -> Vec<Fold<'_>> {
    let filled: Vec<&Part> = rows.parts.iter().filter(|part| !part.is_empty()).collect();
    match filled.as_slice() {
        [single] => single_folds(single, gap_s),
        parts => (0..parts.len())
            .map(|judged| {
                let others = parts.iter().enumerate().filter(|(i, _)| *i != judged);
                Fold {
                    training: others.map(|(_, part)| Cow::Borrowed(*part)).collect(),
                    test: vec![Cow::Borrowed(parts[judged])],
                }
            })
            .collect(),
    }
}

fn single_folds(part: &Part, gap_s: f64) -> Vec<Fold<'_>> {
    let (Some(first), Some(last)) = (part.time_s.first(), part.time_s.last()) else {
        return Vec::new();
    };
    let step = (last - first) / SINGLE_CUTS as f64;
    let before = |time: f64| part.time_s.partition_point(|t| *t < time);
    (0..SINGLE_CUTS)
        .map(|cut| {
            let from = first + step * cut as f64;
            let to = if cut + 1 == SINGLE_CUTS {
                f64::INFINITY
            } else {
                from + step
            };
            let pieces = [0..before(from - gap_s), before(to + gap_s)..part.len()];
            Fold {
                training: pieces
                    .into_iter()
                    .filter(|p| !p.is_empty())
                    .map(|p| Cow::Owned(part.slice(p)))
                    .collect(),
                test: vec![Cow::Owned(part.slice(before(from)..before(to)))],
            }
        })
        .collect()
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

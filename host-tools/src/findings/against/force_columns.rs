//! Columns of forces exchanged, turned, or taken from another place.

use std::collections::BTreeMap;

use model_export::effects::Track;
use model_export::recordings::Recording;
use model_export::recordings::columns::Axis;

use super::case::Case;
use super::hypothesis::{Hypothesis, Source, Tried};

/// A force's column over the rows of a case: as recorded, smooth, and its rate.
struct Column {
    force: Vec<f64>,
    smooth: Vec<f64>,
    rate: Vec<f64>,
}

/// Every single column in place of one of the sensor's forces, both exchanged, and both from another
/// place; each with either sign.
pub fn force_columns(case: &Case, recording: &Recording) -> Vec<Tried> {
    let columns = columns(case, recording);
    let own = case.forces;
    let mut candidates: Vec<Vec<Source>> = Vec::new();
    for source in columns.keys() {
        for sign in [1.0, -1.0] {
            for place in 0..own.len() {
                let mut sources: Vec<Source> = own.iter().map(|force| (*force, 1.0)).collect();
                sources[place] = (*source, sign);
                candidates.push(sources);
            }
        }
    }
    let places: Vec<u32> = columns.keys().map(|(place, _)| *place).collect();
    if own.len() == 2 {
        for place in places {
            for axes in [[Axis::X, Axis::Z], [Axis::Z, Axis::X]] {
                for signs in [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]] {
                    let source = |i: usize| ((place, axes[i]), signs[i]);
                    candidates.push(vec![source(0), source(1)]);
                }
            }
        }
    }
    let mut tried: Vec<Tried> = Vec::new();
    for sources in candidates {
        let cost = cost(&sources, own);
        let known = sources
            .iter()
            .all(|(column, _)| columns.contains_key(column));
        let hypothesis = Hypothesis::Forces(sources.clone());
        let new = tried.iter().all(|other| other.hypothesis != hypothesis);
        if cost > 0 && known && new {
            tried.push(Tried {
                left: case.left_under(&track(case, &columns, &sources)),
                hypothesis,
                cost,
            });
        }
    }
    tried
}

fn cost(sources: &[Source], own: &[(u32, Axis)]) -> usize {
    let pairs = sources.iter().zip(own);
    pairs
        .map(|((column, sign), own)| usize::from(column != own) + usize::from(*sign < 0.0))
        .sum()
}

fn track(case: &Case, columns: &BTreeMap<(u32, Axis), Column>, sources: &[Source]) -> Track {
    let mut track = case.track.clone();
    for ((source, sign), (_, axis)) in sources.iter().zip(case.forces) {
        let Some(column) = columns.get(source) else {
            continue;
        };
        let axis = usize::from(*axis == Axis::Z);
        for row in 0..track.len() {
            track.force_n[row][axis] = sign * column.force[row];
            track.smooth_n[row][axis] = sign * column.smooth[row];
            track.rate_n_per_s[row][axis] = sign * column.rate[row];
        }
    }
    track
}

/// Every column that was measured in all rows of the case.
fn columns(case: &Case, recording: &Recording) -> BTreeMap<(u32, Axis), Column> {
    let indices = case.indices_of_part(recording);
    let mut columns = BTreeMap::new();
    for (key, forces) in &recording.forces {
        let newtons: Vec<f64> = indices.iter().map(|&i| forces.newtons[i]).collect();
        if newtons.len() != case.part.len() || newtons.iter().any(|n| !n.is_finite()) {
            continue;
        }
        let pairs = newtons.iter().map(|n| [*n, 0.0]).collect();
        let track = case.part.track.under(pairs).at(&case.rows);
        let first = |pairs: &[[f64; 2]]| pairs.iter().map(|pair| pair[0]).collect();
        columns.insert(
            *key,
            Column {
                force: first(&track.force_n),
                smooth: first(&track.smooth_n),
                rate: first(&track.rate_n_per_s),
            },
        );
    }
    columns
}

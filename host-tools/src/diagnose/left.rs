//! What a fitted model leaves, and what that follows.

use model_export::effects::{Addition, Series};
use model_export::fit::blocks::correlation_rows;
use model_export::fit::campaign::Prepared;
use model_export::fit::score::floor_squared;
use model_export::recordings::Campaign;
use nalgebra::Vector3;
use rayon::prelude::*;

use super::stage::Stage;
use crate::compare::covariate::{Covariate, all};
use crate::compare::locate::Locator;
use crate::compare::rows::SensorColumns;

/// Shortest block of the bootstrap in seconds.
const SHORTEST_BLOCK_S: f64 = 5.0;
/// Blocks are no longer than leaves this many.
const FEWEST_BLOCKS: f64 = 15.0;

/// What a fitted model leaves, with everything that it may depend on.
pub fn residuals(campaign: &Campaign, prepared: &Prepared, stage: &Stage) -> Vec<SensorColumns> {
    let covariates = campaign.recordings.first().map_or_else(Vec::new, all);
    let mut effects = stage.effects.clone();
    effects.sort_by_key(Addition::stage);
    (0..prepared.rows.len())
        .into_par_iter()
        .map(|s| {
            let (rows, base, fit) = (&prepared.rows[s], &prepared.bases[s], &stage.fit.sensors[s]);
            let mut columns = SensorColumns::new(rows.sensor, &covariates);
            let recordings = rows.parts.len();
            let mut at = fit.base_count;
            let values: Vec<(&Addition, &[f64])> = effects
                .iter()
                .map(|effect| {
                    let from = at;
                    at += effect.parameters(recordings).len();
                    (effect, &fit.values[from..at])
                })
                .collect();
            let [kx, kz] = base.stiffness(&fit.values);
            let linear = base.linear(&fit.values[..fit.base_count]);
            let mut unused = vec![Vector3::zeros(); fit.base_count];
            for (place, part) in rows.parts.iter().enumerate() {
                let states = Series::of(&part.track, [kx, kz], &values).states;
                let (mut left, mut floor) = (Vec::new(), Vec::new());
                for (row, state) in states.iter().enumerate() {
                    let response = linear(state, &mut unused);
                    left.push(part.field_g[row] - response.field_g);
                    let per_newton = [
                        response.per_mm.column(0) / kx,
                        response.per_mm.column(2) / kz,
                    ];
                    floor.push(floor_squared(part, rows.slopes(&per_newton)));
                }
                columns.push(place, &part.track, &left, &floor, 1);
            }
            columns
        })
        .collect()
}

/// Length of a block: three times what the residual remembers.
pub fn block_s(columns: &[SensorColumns]) -> f64 {
    let mut longest = 0.0_f64;
    for sensor in columns {
        for axis in 0..3 {
            let values: Vec<f64> = sensor.residual_g.iter().map(|r| r[axis]).collect();
            let span = sensor.time_s.last().copied().unwrap_or(0.0);
            let rows = sensor
                .recording
                .iter()
                .filter(|r| Some(*r) == sensor.recording.last())
                .count();
            longest = longest.max(correlation_rows(&values) * span / rows.max(1) as f64);
        }
    }
    // Chance needs room.
    let duration: f64 = columns.first().map_or(0.0, |sensor| {
        sensor
            .recording
            .chunk_by(|a, b| a == b)
            .map(<[u32]>::len)
            .sum::<usize>() as f64
            * sensor
                .time_s
                .get(1)
                .map_or(0.01, |second| second - sensor.time_s[0])
    });
    let most = (duration / FEWEST_BLOCKS).max(1.0);
    (3.0 * longest).max(SHORTEST_BLOCK_S).min(most)
}

/// The covariates that what is left follows, with their shares.
pub fn located(columns: &[SensorColumns], block_s: f64) -> Vec<(Covariate, f64)> {
    let ranked = Locator::new(columns, block_s).rank();
    let Some(first) = columns.first() else {
        return Vec::new();
    };
    let chosen = ranked.into_iter().filter(|found| found.chosen);
    chosen
        .map(|found| (first.covariates[found.covariate].of.clone(), found.share))
        .collect()
}

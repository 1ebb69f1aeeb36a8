//! What a fitted model leaves, and what that follows.

use model_export::effects::Addition;
use model_export::fit::campaign::Prepared;
use model_export::fit::problem::SensorProblem;
use model_export::fit::score::floor_squared;
use model_export::recordings::Campaign;
use nalgebra::Vector3;
use rayon::prelude::*;

use super::stage::Stage;
use crate::compare::compute::correlation_s;
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
    residuals_beside(prepared, stage, &covariates)
}

/// What a fitted model leaves, beside these covariates.
pub fn residuals_beside(
    prepared: &Prepared,
    stage: &Stage,
    covariates: &[Covariate],
) -> Vec<SensorColumns> {
    let mut effects = stage.effects.clone();
    effects.sort_by_key(Addition::stage);
    (0..prepared.rows.len())
        .into_par_iter()
        .map(|s| {
            let (rows, base, fit) = (&prepared.rows[s], &prepared.bases[s], &stage.fit.sensors[s]);
            let mut columns = SensorColumns::new(rows.sensor, covariates);
            let problem = SensorProblem::new(rows, base.as_ref(), &effects);
            let departures = problem.departures(&fit.values);
            for (place, part) in rows.parts.iter().enumerate() {
                let linear = problem.linear(place, &departures);
                let errors = part.field_g.iter().zip(&linear.fields);
                let left: Vec<Vector3<f64>> = errors.map(|(b, m)| b - m).collect();
                let slopes = linear.per_newton.iter();
                let floor: Vec<Vector3<f64>> = slopes
                    .map(|per_newton| floor_squared(part, rows.slopes(per_newton)))
                    .collect();
                columns.push(place, &part.track, &left, &floor, 1);
            }
            columns
        })
        .collect()
}

/// Length of a block: three times what the residual remembers.
pub fn block_s(columns: &[SensorColumns]) -> f64 {
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
    (3.0 * correlation_s(columns))
        .max(SHORTEST_BLOCK_S)
        .min(most)
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

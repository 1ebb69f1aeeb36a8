//! Residuals of a fitted model.

use crate::compare::covariates::{Covariate, all_covariates};
use crate::compare::pipeline::correlation_s;
use crate::compare::residual_table::ResidualTable;
use crate::diagnose::fitted_model::FittedModel;
use model_export::effects::EffectTerm;
use model_export::fit::campaign::FitSetup;
use model_export::fit::cross_validation::noise_variance;
use model_export::fit::problem::SensorProblem;
use model_export::recordings::Campaign;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Minimum length of a bootstrap block in seconds.
const MIN_BLOCK_S: f64 = 5.0;
const MIN_BLOCKS: f64 = 15.0;

/// Residuals of a model with all covariates.
pub fn residual_tables(
    campaign: &Campaign,
    prepared: &FitSetup,
    stage: &FittedModel,
) -> Vec<ResidualTable> {
    let covariates = campaign.recordings.first().map_or_else(Vec::new, all_covariates);
    residuals_against(prepared, stage, &covariates)
}

/// Residuals of a model with these covariates.
pub fn residuals_against(
    prepared: &FitSetup,
    stage: &FittedModel,
    covariates: &[Covariate],
) -> Vec<ResidualTable> {
    let mut effects = stage.effects.clone();
    effects.sort_by_key(EffectTerm::stage);
    (0..prepared.rows.len())
        .into_par_iter()
        .map(|s| {
            let (rows, base, fit) = (&prepared.rows[s], &prepared.bases[s], &stage.fit.sensors[s]);
            let mut columns = ResidualTable::new(rows.sensor, covariates);
            let problem = SensorProblem::new(rows, base.as_ref(), &effects);
            let scaled = problem.to_scaled(&fit.values);
            for (place, part) in rows.parts.iter().enumerate() {
                let modelled = problem.predict(place, &scaled);
                let errors = part.field_g.iter().zip(&modelled.fields);
                let left: Vec<Vector3<f64>> = errors.map(|(b, m)| b - m).collect();
                let slopes = modelled.per_newton.iter().enumerate();
                let floor: Vec<Vector3<f64>> = slopes
                    .map(|(row, slopes)| noise_variance(part, Some(row), rows.slopes(slopes)))
                    .collect();
                columns.push(place, &part.track, &left, &floor, 1);
            }
            columns
        })
        .collect()
}

/// Block length in seconds: three correlation times of the residual.
pub fn block_s(columns: &[ResidualTable]) -> f64 {
    let duration: f64 = columns.first().map_or(0.0, |sensor| {
        sensor.recording.chunk_by(|a, b| a == b).map(<[u32]>::len).sum::<usize>() as f64
            * sensor.time_s.get(1).map_or(0.01, |second| second - sensor.time_s[0])
    });
    // Rows without a clock are one second apart, whatever their number.
    (3.0 * correlation_s(columns)).max(MIN_BLOCK_S).min(duration / MIN_BLOCKS)
}

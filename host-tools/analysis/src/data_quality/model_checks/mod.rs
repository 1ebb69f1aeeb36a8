//! Setup errors that a model's prediction reveals: permuted axes, wrong signs, wrong units, and
//! clock offsets.
//!
//! - `case`: one sensor over one recording, subsampled, with its prediction and the names of its columns.
//! - `hypothesis`: candidate errors: permutations, signs and unit factors.
//! - `columns`: selection of the hypothesis that removes the residual, grouped over sensors and recordings.
//! - `description`: the findings as text.
//! - `clock`: offset of the reference's clock.
//!
//! A missing effect leaves a residual of some ten percent. A setup error leaves a residual as large as the
//! signal, and a single permutation removes nearly all of it: only that is reported.

mod case;
mod clock;
mod columns;
mod description;
mod hypothesis;

use model_export::effects::ExcitationSeries;
use model_export::fit::rows::SensorRows;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::data_quality::model_checks::case::{Case, Names};
use crate::data_quality::{Finding, sort};

/// Predicted field in gauss for each row of a track.
pub type Predict<'a> = &'a (dyn Fn(&ExcitationSeries) -> Vec<Vector3<f64>> + Sync);

/// Measured rows of one sensor and its model.
#[derive(Clone, Copy)]
pub struct SensorPrediction<'a> {
    /// Measured rows.
    pub rows: &'a SensorRows,
    /// Model prediction.
    pub predict: Predict<'a>,
}

/// Column and clock errors of a campaign that was read with this alignment, most
/// severe first.
pub fn check_against_model(
    campaign: &Campaign,
    alignment: Alignment,
    sensors: &[SensorPrediction],
) -> Vec<Finding> {
    let cases: Vec<Case> = sensors
        .par_iter()
        .flat_map_iter(|sensor| {
            let parts = sensor.rows.parts.iter().enumerate();
            parts.filter_map(|(recording, part)| Case::new(sensor, recording, part))
        })
        .collect();
    let names = Names::of(campaign);
    let (mut findings, hit) = columns::check_columns(campaign, &names, &cases);
    let sound: Vec<&Case> = cases.iter().filter(|case| !hit.contains(&case.recording)).collect();
    findings.extend(clock::check_clocks(campaign, &names, alignment, &sound));
    sort(&mut findings);
    findings
}

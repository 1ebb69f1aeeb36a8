//! Findings from the recordings beside a model: columns exchanged, turned or in another unit, and
//! clocks that disagree.
//!
//! - `case`: one sensor over one recording, thinned, with what the model says of it.
//! - `names`: how the columns are called, and in which files they are.
//! - `hypothesis`: what may be wrong with the columns. `force_columns` and `scales` make the many
//!   of one sort.
//! - `columns`: the one that mends the residual, told for all sensors and recordings together.
//! - `words`: those findings as sentences.
//! - `clock`: a shift of the reference's clock.
//!
//! A model of the same gripper errs by a tenth where an effect is missing. A mistake of the rig leaves a
//! residual as large as the signal, and one exchange takes nearly all of it away: only that is told.

mod case;
mod clock;
mod columns;
mod force_columns;
mod hypothesis;
mod names;
mod scales;
mod words;

use model_export::effects::Track;
use model_export::fit::rows::SensorRows;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use nalgebra::Vector3;
use rayon::prelude::*;

use self::case::Case;
use self::names::Names;
use super::sort;
use crate::compare::Finding;

/// The model's field in gauss over any track, row by row.
pub type Predict<'a> = &'a (dyn Fn(&Track) -> Vec<Vector3<f64>> + Sync);

/// One sensor beside its model.
#[derive(Clone, Copy)]
pub struct Beside<'a> {
    /// What was measured.
    pub rows: &'a SensorRows,
    /// What the model says.
    pub predict: Predict<'a>,
}

/// What is wrong with the columns and clocks of a campaign that was read with this alignment, the
/// gravest first.
pub fn against(campaign: &Campaign, alignment: Alignment, sensors: &[Beside]) -> Vec<Finding> {
    let cases: Vec<Case> = sensors
        .par_iter()
        .flat_map_iter(|sensor| {
            let parts = sensor.rows.parts.iter().enumerate();
            parts.filter_map(|(recording, part)| Case::new(sensor, recording, part))
        })
        .collect();
    let names = Names::of(campaign);
    let (mut findings, hit) = columns::judge(campaign, &names, &cases);
    let sound: Vec<&Case> = cases
        .iter()
        .filter(|case| !hit.contains(&case.recording))
        .collect();
    findings.extend(clock::judge(campaign, &names, alignment, &sound));
    sort(&mut findings);
    findings
}

//! Drifts of other quantities that explain the same as an effect of time: a magnet that loses strength, a gap that swells and a
//! flexure that softens may leave the same field, and no covariate distinguishes them.

use model_export::effects::{EffectTerm, ParameterScope, Signature};
use model_export::fit::campaign::FitSetup;
use model_export::fit::rows::RecordingRows;

use crate::diagnose::formulas::candidate::columns_at;
use crate::diagnose::formulas::chain_points::ChainPoint;
use crate::diagnose::formulas::rows::{SensorRows, Windows, averaged, of_model, windows};
use crate::diagnose::formulas::scan::{Columns, Scan};
use crate::diagnose::selection::{DISTINGUISHABLE, FittedModel};

/// Quantities of which a value for each recording and a rate explain as much as `effect` does in `model`, by the target of a formula;
/// none for an effect that does not have both. Blocks of time have at least `block_s` seconds.
pub fn equivalent_drifts(
    setup: &FitSetup,
    model: &FittedModel,
    effect: &EffectTerm,
    block_s: f64,
) -> Vec<&'static str> {
    let Some(known) = effect.effect().filter(|known| known.signatures == [Signature::Time]) else {
        return Vec::new();
    };
    let scopes = || known.parameters.iter().map(|parameter| parameter.scope);
    if setup.recordings() < 2 || scopes().all(|scope| scope != ParameterScope::EachLaterRecording) {
        return Vec::new();
    }
    let windows = windows(setup);
    let (mut points, _) = ChainPoint::of(setup);
    // A gain changes the field as the strength of the magnet does, whatever the recordings.
    points.retain(|point| !matches!(point, ChainPoint::Gain | ChainPoint::AxisGain(_)));
    let scan = |without: &[EffectTerm]| {
        Scan::new(of_model(setup, model, without, &points, &windows, block_s))
    };
    let own = scan(&[]).score(&[]).fitted;
    let without = scan(std::slice::from_ref(effect));
    let terms: Vec<Vec<Vec<f64>>> = (0..without.rows.len())
        .map(|sensor| terms(&setup.rows[sensor].parts, &windows[sensor]))
        .collect();
    let is_equal = |point: &&ChainPoint| {
        let of_sensor = |(rows, terms): (&SensorRows, &Vec<Vec<f64>>)| {
            columns_at(rows, terms, &[**point], &points)
        };
        let columns: Columns = without.rows.iter().zip(&terms).map(of_sensor).collect();
        without.score(&columns).fitted <= (1.0 + DISTINGUISHABLE) * own
    };
    points.iter().filter(is_equal).map(|point| point.target().0).collect()
}

/// A constant in each recording but the first, and the time in each recording, over the averaged rows.
fn terms(parts: &[RecordingRows], windows: &[Windows]) -> Vec<Vec<f64>> {
    let over_rows = |value: &dyn Fn(usize, f64) -> f64| -> Vec<f64> {
        let of_part = |(place, (part, windows)): (usize, (&RecordingRows, &Windows))| {
            let values: Vec<f64> =
                part.track.time_s.iter().map(|time_s| value(place, *time_s)).collect();
            averaged(&values, windows)
        };
        parts.iter().zip(windows).enumerate().flat_map(of_part).collect()
    };
    let steps = (1..parts.len())
        .map(|recording| over_rows(&|place, _| if place == recording { 1.0 } else { 0.0 }));
    steps.chain([over_rows(&|_, time_s| time_s)]).collect()
}

//! Drifts of other quantities that explain the same as an effect of time: a magnet that loses strength, a gap that swells and a
//! flexure that softens may leave the same field, and no covariate distinguishes them.

use model_export::effects::{EffectTerm, ParameterKind, ParameterScope, Signature};
use model_export::fit::campaign::FitSetup;
use model_export::fit::effect_size::first_parameter;
use model_export::fit::joint::SensorFit;
use model_export::fit::rows::RecordingRows;

use crate::diagnose::fitted_model::{DISTINGUISHABLE, FittedModel};
use crate::diagnose::formulas::candidate::columns_at;
use crate::diagnose::formulas::chain_points::ChainPoint;
use crate::diagnose::formulas::rows::{SensorRows, Windows, averaged, of_model, windows};
use crate::diagnose::formulas::scan::{Columns, Scan};

/// Quantities of which a value for each recording, a rate, and a step at each instant of `effect` explain as much as `effect` does in
/// `model`, by the target of a formula; none for an effect without these. Blocks of time have at least `block_s` seconds.
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
    let recordings = setup.recordings();
    let parameters = effect.parameters(recordings);
    let is_instant = |place: &usize| parameters[*place].kind == ParameterKind::Instant;
    // All sensors have the same instant.
    let of_first = |sensor: &SensorFit| -> Vec<f64> {
        let first = first_parameter(sensor.base_count, &model.effects, effect, recordings);
        (0..parameters.len()).filter(is_instant).map(|place| sensor.values[first + place]).collect()
    };
    let instants = model.fit.sensors.first().map_or_else(Vec::new, of_first);
    let without = scan(std::slice::from_ref(effect));
    let terms: Vec<Vec<Vec<f64>>> = (0..without.rows.len())
        .map(|sensor| terms(&setup.rows[sensor].parts, &windows[sensor], &instants))
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

/// A constant in each recording but the first, the time in each recording, and a step after each of these instants in its recording,
/// over the averaged rows.
fn terms(parts: &[RecordingRows], windows: &[Windows], instants: &[f64]) -> Vec<Vec<f64>> {
    let over_rows = |value: &dyn Fn(usize, f64) -> f64| -> Vec<f64> {
        let of_part = |(place, (part, windows)): (usize, (&RecordingRows, &Windows))| {
            let values: Vec<f64> =
                part.track.time_s.iter().map(|time_s| value(place, *time_s)).collect();
            averaged(&values, windows)
        };
        parts.iter().zip(windows).enumerate().flat_map(of_part).collect()
    };
    let is_in = |place: usize, recording: usize| if place == recording { 1.0 } else { 0.0 };
    let steps = (1..parts.len()).map(|recording| over_rows(&|place, _| is_in(place, recording)));
    let after = instants.iter().filter_map(|instant_s| {
        let begins = |part: &RecordingRows| part.track.before_s <= *instant_s;
        let recording = parts.iter().rposition(begins)?;
        let own_s = instant_s - parts[recording].track.before_s;
        let after = |place, time_s| is_in(place, recording) * f64::from(u8::from(time_s > own_s));
        Some(over_rows(&after))
    });
    steps.chain([over_rows(&|_, time_s| time_s)]).chain(after).collect()
}

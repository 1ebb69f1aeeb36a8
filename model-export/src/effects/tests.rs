//! Every effect of the catalogue acts as its declaration states, alone and in a chain.

use nalgebra::{Matrix3, Vector3};

use super::*;
use crate::physics::FieldResponse;
use crate::recordings::columns::STATOR_CURRENTS;

const ROWS: usize = 60;

/// Value of a smooth curve of amplitude 1 in this row.
fn wave(row: usize, phase: f64) -> f64 {
    (0.37 * row as f64 + phase).sin()
}

fn excitation() -> ExcitationSeries {
    let column = |phase: f64| -> Vec<f64> { (0..ROWS).map(|row| wave(row, phase)).collect() };
    let pair = |a: f64, b: f64| -> Vec<[f64; 2]> {
        (0..ROWS).map(|row| [100.0 * wave(row, a), 200.0 * wave(row, b)]).collect()
    };
    let names = [
        "opening_mm",
        "roll_rad",
        "pitch_rad",
        "yaw_rad",
        "accel_x_mps2",
        "accel_z_mps2",
        "motor_iq_a",
        STATOR_CURRENTS[0],
        STATOR_CURRENTS[1],
    ];
    let covariates = names.iter().enumerate();
    ExcitationSeries {
        time_s: (0..ROWS).map(|row| 0.1 * row as f64).collect(),
        force_n: pair(0.0, 1.0),
        smooth_n: pair(0.1, 1.1),
        rate_n_per_s: pair(2.0, 3.0),
        cycles: pair(0.5, 0.7).into_iter().map(|pair| pair.map(f64::abs)).collect(),
        temperature_c: column(4.0).into_iter().map(|t| 25.0 + 5.0 * t).collect(),
        covariates: covariates.map(|(i, name)| ((*name).to_owned(), column(i as f64))).collect(),
        recording: 1,
        ..ExcitationSeries::default()
    }
}

/// Derivatives that are all different.
fn responses() -> Vec<FieldResponse> {
    let matrix = |row: usize, phase: f64| {
        Matrix3::from_fn(|i, j| wave(row, phase + 1.3 * i as f64 + 0.7 * j as f64))
    };
    let response = |row: usize| FieldResponse {
        field_g: Vector3::zeros(),
        at_element_g: Vector3::zeros(),
        per_field: matrix(row, 1.0),
        per_mm: matrix(row, 2.0),
        per_tilt: [matrix(row, 3.0).column(0).into(), matrix(row, 3.0).column(1).into()],
        per_strength: matrix(row, 4.0).column(0).into(),
        per_external: matrix(row, 5.0),
        per_gain: matrix(row, 6.0).column(0).into(),
        per_rotation: matrix(row, 7.0),
        per_offset: matrix(row, 8.0),
        per_compression: matrix(row, 9.0).column(0).into(),
    };
    (0..ROWS).map(response).collect()
}

/// Values at typical magnitudes, and the same with one parameter moved.
fn values(effect: &Effect, moved: Option<usize>) -> Vec<f64> {
    let parameters = effect.parameters.iter().flat_map(|parameter| parameter.repeated(2));
    let value = |(place, parameter): (usize, EffectParameter)| {
        let value = match &parameter.kind {
            ParameterKind::Shape { grid } => grid[grid.len() / 2],
            ParameterKind::Instant => 1.0,
            ParameterKind::InitialState => 0.3,
            ParameterKind::Coefficient => parameter.typical,
        };
        if moved == Some(place) { value * 1.1 } else { value }
    };
    parameters.enumerate().map(value).collect()
}

#[test]
fn changes_are_those_of_the_whole_chain() {
    let (excitation, responses, stiffness) = (excitation(), responses(), [2.0, 5.0]);
    let all: Vec<EffectTerm> = CATALOGUE.into_iter().map(EffectTerm::Catalogue).collect();
    let compare = |found: MovedSeries, from: &StateSeries, to: &StateSeries, what: &str| {
        let states = from.states.iter().zip(&to.states).zip(&responses);
        let expected: Vec<Vector3<f64>> =
            states.map(|((from, to), response)| response.change(from, to)).collect();
        let largest = expected.iter().map(|change| change.amax()).fold(0.0, f64::max);
        // In two parts, as a fit does.
        let (first, second) = responses.split_at(ROWS / 3);
        let found = found.changes(0, first).chain(found.changes(first.len(), second));
        let found: Vec<Vector3<f64>> = found.collect();
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found - expected).amax() <= 1e-9 * largest.max(1e-3), "{what}");
        }
        assert_eq!(found.len(), expected.len(), "{what}");
        largest
    };
    for (one, other) in all.iter().flat_map(|one| all.iter().map(move |other| (one, other))) {
        let mut pair = if one == other { vec![one] } else { vec![one, other] };
        pair.sort_by_key(|effect| effect.stage());
        let terms: Vec<Vec<f64>> =
            pair.iter().map(|effect| values(effect.effect().unwrap(), None)).collect();
        let chain: Vec<(&EffectTerm, &[f64])> =
            pair.iter().zip(&terms).map(|(effect, values)| (*effect, &values[..])).collect();
        let from = StateSeries::of(&excitation, stiffness, &chain);
        let effect_chain = EffectChain::new(&excitation, stiffness, chain.clone());
        for (place, (effect, values_here)) in chain.iter().enumerate() {
            let mut largest = 0.0_f64;
            for index in 0..values_here.len() {
                let moved = values(effect.effect().unwrap(), Some(index));
                let mut other = chain.clone();
                other[place].1 = &moved;
                let to = StateSeries::of(&excitation, stiffness, &other);
                let found = effect_chain.moved(place, &moved);
                let what = format!("{} of {:?}", effect.name(), [one.name(), other[0].0.name()]);
                largest = largest.max(compare(found, &from, &to, &what));
            }
            // A backlash of the screw changes the field only through a magnet that depends on the opening.
            assert!(largest > 0.0 || effect.name() == "screw_backlash", "{}", effect.name());
        }
        let to = StateSeries::of(&excitation, [2.1, 4.8], &chain);
        let found = effect_chain.moved_stiffness([2.1, 4.8]);
        assert!(compare(found, &from, &to, one.name()) > 0.0);
    }
}

/// The last row after this effect alone: force, opening and state.
fn last_row(effect: &'static Effect, excitation: &ExcitationSeries) -> String {
    let (term, values) = (EffectTerm::Catalogue(effect), values(effect, None));
    let series = StateSeries::of(excitation, [2.0, 5.0], &[(&term, &values)]);
    format!("{:?}", series.at(&[ROWS - 1]))
}

#[test]
fn declared_memory_is_that_of_the_action() {
    let excitation = excitation();
    // Other rows before the last one.
    let mut other = excitation.clone();
    for pairs in [&mut other.force_n, &mut other.smooth_n, &mut other.rate_n_per_s] {
        pairs[..ROWS - 1].iter_mut().flatten().for_each(|value| *value *= -1.5);
    }
    for column in other.covariates.values_mut().chain([&mut other.temperature_c]) {
        column[..ROWS - 1].iter_mut().for_each(|value| *value *= -1.5);
    }
    for effect in CATALOGUE {
        let has_memory = last_row(effect, &excitation) != last_row(effect, &other);
        let (declared, id) = (effect.has_memory, effect.id);
        assert_eq!(declared, has_memory, "{id}: `has_memory` (left) is not what `apply` does");
    }
}

#[test]
fn effects_declare_the_times_that_they_depend_on() {
    let excitation = excitation();
    let started = ExcitationSeries { start_s: 500.0, ..excitation.clone() };
    let mut slower = excitation.clone();
    slower.time_s.iter_mut().for_each(|time_s| *time_s *= 1.5);
    slower.rate_n_per_s.iter_mut().flatten().for_each(|rate| *rate /= 1.5);
    for effect in CATALOGUE {
        let depends = |other| last_row(effect, &excitation) != last_row(effect, other);
        let (time, id) = (effect.time, effect.id);
        let on_start = time == TimeDependence::Starts || !depends(&started);
        assert!(on_start, "{id}: `apply` depends on `start_s`, and `time` is not `Starts`");
        let on_rows = time != TimeDependence::None || !depends(&slower);
        assert!(on_rows, "{id}: `apply` depends on times or rates, and `time` is `None`");
    }
}

#[test]
fn effects_with_memory_or_times_depend_on_the_order_of_the_rows() {
    // A backlash has a memory, and no signature in common with others; the Earth's field has neither memory nor time.
    for (id, depends) in [("screw_backlash", true), ("viscous_lag", true), ("earth_field", false)] {
        let effect = CATALOGUE.iter().find(|effect| effect.id == id).unwrap();
        assert_eq!(EffectTerm::Catalogue(effect).depends_on_order(), depends, "{id}");
    }
}

#[test]
fn effects_declare_the_columns_that_they_read() {
    let excitation = excitation();
    for effect in CATALOGUE {
        let is_declared = |name: &str| {
            // Computed from the recorded current and angle. The opening is part of every series.
            let is_stator = STATOR_CURRENTS.contains(&name) && effect.needs.contains(&"motor_iq_a");
            is_stator || effect.needs.contains(&name) || name == "opening_mm"
        };
        let mut other = excitation.clone();
        other.covariates.insert("temp_c".to_owned(), std::mem::take(&mut other.temperature_c));
        for (_, column) in other.covariates.iter_mut().filter(|(name, _)| !is_declared(name)) {
            column.iter_mut().for_each(|value| *value *= 1.5);
        }
        other.temperature_c = other.covariates.remove("temp_c").unwrap_or_default();
        let (row, same) = (last_row(effect, &excitation), last_row(effect, &other));
        assert_eq!(row, same, "{}: `needs` has not a column that `apply` reads", effect.id);
    }
}

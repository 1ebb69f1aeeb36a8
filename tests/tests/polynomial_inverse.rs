//! Polynomials of the forces, inverted by the device's code.

use std::sync::Arc;

use firmware::compensation::CompensationState;
use firmware::compensation::auxiliary_inputs::AuxiliaryInputs;
use firmware::estimator::{Validity, estimate};
use firmware::fixed_point::Force;
use firmware::sensors::hall::HallReading;
use model_export::effects::{EffectTerm, Expression};
use model_export::fit::polynomial::Polynomial;
use model_export::inverse::compensation::OwnedCompensation;
use model_export::inverse::model_selection::{SelectedModels, select_models};
use model_export::inverse::static_model::{ForcePolynomial, StaticModel};
use model_export::recordings::columns::Axis;
use nalgebra::{DMatrix, Vector3};

/// Fields of microteslas: the range is 125 G.
const GAUSS_PER_LSB: f64 = 0.007_812_5;
const RANGE_G: f64 = 125.0;
const NOISE_G: f64 = 0.05;

fn model(forces: &[(Axis, (f64, f64))], degree: usize, coefficients_g: &[[f64; 3]]) -> StaticModel {
    let polynomial = Polynomial {
        degree,
        forces: forces.iter().map(|(axis, _)| (5, *axis)).collect(),
        spans_n: forces.iter().map(|(_, span)| *span).collect(),
        coefficients_g: DMatrix::from_fn(coefficients_g.len(), 3, |i, j| coefficients_g[i][j]),
    };
    StaticModel::without_effects(ForcePolynomial::new(polynomial, NOISE_G).unwrap())
}

/// Bx = 20 + 10 x and Bz = 50 + 40 x + 5 P2(x) over the force Fz of 0 to 10 N, with x of -1 to 1.
fn one_force() -> StaticModel {
    let terms = [[20.0, 0.0, 50.0], [10.0, 0.0, 40.0], [0.0, 0.0, 5.0]];
    model(&[(Axis::Z, (0.0, 10.0))], 2, &terms)
}

/// Fx of -10 to 10 N moves x and y, Fz of 0 to 20 N moves z and y, with a product and squares.
fn two_forces() -> StaticModel {
    // 1, z, x, z^2, x z, x^2 as Legendre polynomials.
    let terms = [
        [5.0, 60.0, -10.0],
        [1.0, 12.0, 35.0],
        [30.0, -6.0, 2.0],
        [0.5, 2.0, 3.0],
        [2.0, 1.0, 1.5],
        [-2.0, 3.0, 0.0],
    ];
    model(&[(Axis::X, (-10.0, 10.0)), (Axis::Z, (0.0, 20.0))], 2, &terms)
}

fn tables(model: &StaticModel) -> SelectedModels {
    select_models(std::slice::from_ref(model), &[1], 7, GAUSS_PER_LSB, RANGE_G, None).unwrap()
}

fn reading(field_g: Vector3<f64>) -> Option<HallReading> {
    let field = [0, 1, 2].map(|axis| (field_g[axis] / GAUSS_PER_LSB).round() as i16);
    Some(HallReading { field, temperature: 0 })
}

/// Force and validity by the device's code for a field in gauss.
fn device(chosen: &SelectedModels, field_g: Vector3<f64>) -> ([f64; 2], Validity) {
    let inputs = AuxiliaryInputs::default();
    let mut state = CompensationState::default();
    let found = estimate(&chosen.tables.tables(&[]), 1, reading(field_g), &inputs, &mut state);
    (found.force.map(Force::newtons), found.validity)
}

#[test]
fn field_of_one_force_is_linear_beyond_its_range() {
    let model = one_force();
    for (force_n, [x, z]) in [
        (0.0, [10.0, 15.0]),
        (5.0, [20.0, 47.5]),
        (10.0, [30.0, 95.0]),
        // The slopes at 10 N are 2 and 11 G/N, those at 0 N 2 and 5 G/N.
        (12.0, [34.0, 117.0]),
        (-1.0, [8.0, 10.0]),
    ] {
        let error_g = model.field([99.0, force_n]) - Vector3::new(x, 0.0, z);
        assert!(error_g.norm() < 1e-9, "{force_n} {error_g}");
    }
    let [lateral, longitudinal] = model.per_newton([0.0, 5.0]);
    assert_eq!(lateral, Vector3::zeros());
    assert!((longitudinal - Vector3::new(2.0, 0.0, 8.0)).norm() < 1e-9, "{longitudinal}");
}

#[test]
fn one_force_is_estimated_in_its_range_and_the_other_is_zero() {
    let (model, chosen) = (one_force(), tables(&one_force()));
    for force_n in [0.0, 0.7, 3.3, 5.0, 8.8, 10.0] {
        let ([fx, fz], validity) = device(&chosen, model.field([0.0, force_n]));
        assert_eq!((fx, validity), (0.0, Validity::Valid));
        // The noise of a reading is 0.05 G, and the slope at most 11 G/N.
        assert!((fz - force_n).abs() < 0.01, "{force_n} {fz}");
    }
    let (_, validity) = device(&chosen, Vector3::new(20.0, 0.0, 124.0));
    assert_eq!(validity, Validity::OutsideModel);
    assert_eq!(chosen.surfaces[0].table(1, 0.1, GAUSS_PER_LSB).unwrap().sigma, 0);
}

#[test]
fn two_forces_survive_the_device_within_the_noise() {
    let (model, chosen) = (two_forces(), tables(&two_forces()));
    let loads =
        (-4..=4).flat_map(|x| (0..=8).map(move |z| [2.5 * f64::from(x), 2.5 * f64::from(z)]));
    let (mut squares, mut count) = ([0.0; 2], 0.0);
    for load in loads {
        let (found, validity) = device(&chosen, model.field(load));
        assert_eq!(validity, Validity::Valid, "{load:?}");
        count += 1.0;
        for axis in 0..2 {
            squares[axis] += (found[axis] - load[axis]).powi(2);
        }
    }
    // The slopes at the centre are 3.1 and 3.7 G/N.
    for (axis, slope) in [3.1, 3.7].into_iter().enumerate() {
        let rms_n = f64::sqrt(squares[axis] / count);
        assert!(rms_n < NOISE_G / slope, "{axis} {rms_n}");
    }
    // Fields off the surface have the forces of the nearest point, all axes of equal weight.
    let [gx, gz] = model.per_newton([2.0, 12.0]);
    let off_g = model.field([2.0, 12.0]) + gx.cross(&gz).normalize();
    let ([fx, fz], _) = device(&chosen, off_g);
    assert!((fx - 2.0).abs() < 0.02 && (fz - 12.0).abs() < 0.02, "{fx} {fz}");
}

#[test]
fn formula_over_the_force_of_a_polynomial_is_subtracted() {
    let model = one_force();
    let columns = ["opening_mm".to_owned()];
    let formula = Expression::parse("own: fz_n = a*opening_mm*fz_n", &[], &columns).unwrap();
    let effects = [(EffectTerm::Expression(Arc::new(formula)), vec![0.002])];
    let own = OwnedCompensation::build(1, &model, &effects, GAUSS_PER_LSB).unwrap().unwrap();
    let (chosen, views) = (tables(&model), [own.view()]);
    let with_formula = chosen.tables.tables(&views);
    let inputs = AuxiliaryInputs { opening_um: Some(30_000), ..AuxiliaryInputs::default() };
    let mut state = CompensationState::default();
    // At 30 mm the field of 5 N is that of 5.3 N; the error falls by 0.06 with each tick.
    let mut found = [0.0; 2];
    for _ in 0..5 {
        let reading = reading(model.field([0.0, 5.3]));
        let estimated = estimate(&with_formula, 1, reading, &inputs, &mut state);
        found = estimated.force.map(Force::newtons);
    }
    let [fx, fz] = found;
    assert!(fx == 0.0 && (fz - 5.0).abs() < 0.02, "{fx} {fz}");
}

#[test]
fn field_that_folds_does_not_determine_the_force() {
    assert_eq!(one_force().ambiguous_loads(), None);
    assert_eq!(two_forces().ambiguous_loads(), None);
    // Bz falls and rises again.
    let terms = [[0.0; 3], [0.0, 0.0, 1.0], [0.0, 0.0, 20.0]];
    let folded = model(&[(Axis::Z, (0.0, 10.0))], 2, &terms);
    let [one, other] = folded.ambiguous_loads().unwrap();
    let apart_g = (folded.field(one) - folded.field(other)).norm();
    assert!((one[1] - other[1]).abs() > 0.04 && apart_g < 0.5, "{one:?} {other:?} {apart_g}");
    // Both forces move the field along one line.
    let terms = [[0.0; 3], [10.0, 0.0, 10.0], [20.0, 0.0, 20.0]];
    let line = model(&[(Axis::X, (-1.0, 1.0)), (Axis::Z, (-1.0, 1.0))], 1, &terms);
    assert!(line.ambiguous_loads().is_some());
}

#[test]
fn polynomial_of_no_force_or_of_two_along_one_axis_has_no_inverse() {
    let polynomial = |forces: Vec<(u32, Axis)>| {
        let terms = Polynomial::terms(forces.len(), 1).len();
        let spans_n = vec![(0.0, 1.0); forces.len()];
        Polynomial { degree: 1, forces, spans_n, coefficients_g: DMatrix::repeat(terms, 3, 1.0) }
    };
    for forces in [vec![], vec![(0, Axis::X), (1, Axis::X)], vec![(0, Axis::Y)]] {
        assert_eq!(ForcePolynomial::new(polynomial(forces), 0.1), None);
    }
}

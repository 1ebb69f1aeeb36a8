//! Compensation of simulated effects: forces pass through the forward model with the effect, quantisation to counts
//! and the device code.

use std::collections::BTreeMap;
use std::sync::Arc;

use firmware::compensation::auxiliary_inputs::{Attitude, AuxiliaryInputs, MotorInputs};
use firmware::compensation::{Compensation, CompensationState};
use firmware::config::constants;
use firmware::estimator::estimate;
use firmware::sensors::hall::HallReading;
use model_export::effects::{
    CATALOGUE, DeviceForm, EffectTerm, ExcitationSeries, Expression, FinalState, ForceForm,
    ParameterKind, REFERENCE_C, StateSeries, find,
};
use model_export::inverse::compensation::OwnedCompensation;
use model_export::inverse::device_support::DeviceSupport;
use model_export::inverse::model_selection::{SelectedModels, select_models};
use model_export::inverse::static_model::StaticModel;
use nalgebra::Rotation3;
use tests::nominal;

const GAUSS_PER_LSB: f64 = 0.125;
/// Rows of the synthetic recording, one per tick.
const ROWS: usize = 6000;

/// Six seconds with excitation of all inputs.
fn track() -> ExcitationSeries {
    let time_s: Vec<f64> = (0..ROWS).map(|i| i as f64 * 1e-3).collect();
    let wave = |hertz: f64, size: f64| -> Vec<f64> {
        time_s.iter().map(|t| size * (std::f64::consts::TAU * hertz * t).sin()).collect()
    };
    // Starts unloaded.
    let ramp = |t: f64| (t - 0.3).clamp(0.0, 1.0);
    let (x, z) = (wave(0.6, 180.0), wave(0.43, 150.0));
    let force_n: Vec<[f64; 2]> = time_s
        .iter()
        .zip(x.iter().zip(&z))
        .map(|(t, (x, z))| [ramp(*t) * x, ramp(*t) * z])
        .collect();
    let iq = wave(0.5, 8.0);
    let angle: Vec<f64> = time_s.iter().map(|t| 3.0 * t).collect();
    let turning = |of: fn(f64) -> f64, sign: f64| -> Vec<f64> {
        iq.iter()
            .zip(&angle)
            .map(|(iq, angle)| sign * iq * of(constants::POLE_PAIRS.value * angle))
            .collect()
    };
    let shifted =
        |values: Vec<f64>, by: f64| -> Vec<f64> { values.into_iter().map(|v| v + by).collect() };
    let covariates = [
        ("opening_mm", shifted(wave(0.2, 18.0), 22.0)),
        ("motor_alpha_a", turning(f64::sin, -1.0)),
        ("motor_beta_a", turning(f64::cos, 1.0)),
        ("accel_x_mps2", wave(1.1, 8.0)),
        ("accel_y_mps2", wave(0.9, 5.0)),
        ("accel_z_mps2", shifted(wave(0.7, 6.0), 9.81)),
        ("roll_rad", wave(0.15, 2.0)),
        ("pitch_rad", wave(0.11, 1.0)),
        ("yaw_rad", wave(0.13, 3.0)),
        ("motor_iq_a", iq),
        ("motor_angle_rad", angle),
    ];
    ExcitationSeries {
        cycles: vec![[0.0; 2]; ROWS],
        temperature_c: time_s.iter().map(|t| 20.0 + 2.5 * t).collect(),
        covariates: covariates
            .into_iter()
            .map(|(name, values)| (name.to_owned(), values))
            .collect::<BTreeMap<_, _>>(),
        time_s,
        ..ExcitationSeries::default()
    }
    .with_forces(force_n)
}

fn inputs(track: &ExcitationSeries, row: usize) -> AuxiliaryInputs {
    let of = |name: &str| track.covariates[name][row];
    let milli = |name: &str| (1e3 * of(name)).round() as i32;
    let (sin, cos) = (constants::POLE_PAIRS.value * of("motor_angle_rad")).sin_cos();
    let turn = Rotation3::from_euler_angles(of("roll_rad"), of("pitch_rad"), of("yaw_rad"));
    let entry = |i: usize, j: usize| (turn[(i, j)] * f64::from(1 << Attitude::BITS)).round() as i32;
    AuxiliaryInputs {
        opening_um: Some(milli("opening_mm")),
        motor: Some(MotorInputs {
            iq_ma: milli("motor_iq_a"),
            electrical: [sin, cos].map(|share| (share * 32768.0).round() as i32),
            angle_urad: (1e6 * of("motor_angle_rad").rem_euclid(std::f64::consts::TAU)).round()
                as i32,
        }),
        acceleration: Some(["accel_x_mps2", "accel_y_mps2", "accel_z_mps2"].map(milli)),
        attitude: Some(Attitude { to_world: [0, 1, 2].map(|i| [0, 1, 2].map(|j| entry(i, j))) }),
    }
}

/// Three typical coefficients, the middle of each grid, no initial state.
fn strong_value(kind: &ParameterKind, typical: f64) -> f64 {
    match kind {
        ParameterKind::Coefficient => 3.0 * typical,
        ParameterKind::Shape { grid } => grid[grid.len() / 2],
        ParameterKind::InitialState | ParameterKind::Instant => 0.0,
    }
}

/// An effect with parameters of a few times the typical magnitude.
fn effect_with_values(id: &str) -> (EffectTerm, Vec<f64>) {
    let effect = EffectTerm::Catalogue(find(id).unwrap());
    let values = match id {
        "sensor_temperature" => vec![0.2, -0.15, 0.1, 0.03],
        "motor_leakage" => vec![0.1, -0.05, 0.08, 0.06, 0.1, -0.07, -0.2, 0.15, 0.1],
        "earth_field" => vec![0.3, 0.1, -0.5],
        "neighbour_magnet" => vec![0.3, -4.0, 0.5, 10.0, 1.0, -2.0],
        "magnet_temperature" => vec![-0.12],
        "thermal_gap" => vec![1.5],
        "viscous_lag" => vec![10.0, 5.0],
        "creep" => vec![5.0, 3.0, 1.0, 6.0, 0.5],
        "hysteresis" => {
            vec![8.0, 5.0, 12.0, 38.0, 70.0, 1.0, 2.0, 12.0, 38.0, 70.0, 1.0, 2.0, 0.0, 0.0]
        }
        "hard_stop" => vec![50.0, 40.0, 20.0, 40.0, 110.0, 90.0],
        "fingertip_mass" => vec![0.3],
        _ => effect.parameters(1).iter().map(|p| strong_value(&p.kind, p.typical)).collect(),
    };
    (effect, values)
}

fn formula(text: &str, coefficient: f64) -> (EffectTerm, Vec<f64>) {
    let columns: Vec<String> = track().covariates.into_keys().collect();
    let parsed = Expression::parse(text, &[], &columns).unwrap();
    (EffectTerm::Expression(Arc::new(parsed)), vec![coefficient])
}

fn chosen(rest: &StaticModel) -> SelectedModels {
    select_models(std::slice::from_ref(rest), &[0], 7, GAUSS_PER_LSB, 2000.0, None).unwrap()
}

/// RMS error of both forces in newtons, with and without the effect in the device's model.
fn errors(effect: (EffectTerm, Vec<f64>)) -> (f64, f64) {
    let effects = [effect];
    let with = StaticModel::new(nominal(), &effects, 1, FinalState::ENDED);
    let compensation = OwnedCompensation::build(0, &with, &effects, GAUSS_PER_LSB).unwrap();
    let list: Vec<(&EffectTerm, &[f64])> =
        effects.iter().map(|(effect, values)| (effect, values.as_slice())).collect();
    let track = track();
    let states = StateSeries::of(&track, with.stiffness_n_per_mm(), &list).states;
    let frames = nominal().frames();
    let run = |rest: &StaticModel, compensations: &[Compensation]| {
        let chosen = chosen(rest);
        let tables = chosen.tables.tables(compensations);
        let mut compensation_state = CompensationState::default();
        let mut squares = 0.0;
        for (row, state) in states.iter().enumerate() {
            let counts =
                nominal().field_at(&frames, state).map(|g| (g / GAUSS_PER_LSB).round() as i16);
            let temperature_rise = track.temperature_c[row] - REFERENCE_C;
            let reading = HallReading {
                field: counts.into(),
                temperature: (temperature_rise * constants::TEMPERATURE_SCALE.value).round() as i16,
            };
            let inputs = inputs(&track, row);
            let found = estimate(&tables, 0, Some(reading), &inputs, &mut compensation_state);
            assert!(!found.missing_inputs);
            for (found, truth) in found.force.iter().zip(track.force_n[row]) {
                squares += (found.newtons() - truth).powi(2);
            }
        }
        (squares / (2 * states.len()) as f64).sqrt()
    };
    let views: Vec<Compensation> = compensation.iter().map(OwnedCompensation::view).collect();
    (run(&with, &views), run(&StaticModel::without_effects(nominal()), &[]))
}

#[test]
fn the_device_compensates_each_simulated_effect() {
    // Without any effect the errors are 0.1 to 0.2 N.
    for effect in CATALOGUE {
        let limit_n = match effect.device {
            DeviceForm::Field(_) | DeviceForm::Force(ForceForm::FingertipMass) => 0.25,
            DeviceForm::Force(ForceForm::HardStop) => 0.4,
            DeviceForm::Force(ForceForm::Creep(_) | ForceForm::Hysteresis(_)) => 0.3,
            // The rate is delayed by two low-pass filters.
            DeviceForm::Force(ForceForm::ViscousLag) => 0.6,
            DeviceForm::Tables
            | DeviceForm::Settled
            | DeviceForm::Bench { .. }
            | DeviceForm::Never(_) => continue,
        };
        let id = effect.id;
        let (with, without) = errors(effect_with_values(id));
        assert!(with < limit_n && without > 1.9 * with, "{id}: {with} N with, {without} N without");
    }
}

#[test]
fn an_effect_without_its_input_is_skipped_and_flagged() {
    let effects = [effect_with_values("neighbour_magnet"), effect_with_values("fingertip_mass")];
    let rest = StaticModel::new(nominal(), &effects, 1, FinalState::ENDED);
    let own = OwnedCompensation::build(0, &rest, &effects, GAUSS_PER_LSB).unwrap().unwrap();
    let views = [own.view()];
    let mut chosen = chosen(&rest);
    chosen.tables.sensors[0].parity.sigma = 5;
    let tables = chosen.tables.tables(&views);
    let field = rest.field([40.0, 0.0]).map(|g| (g / GAUSS_PER_LSB).round() as i16);
    let reading = Some(HallReading { field: field.into(), temperature: 0 });
    let mut state = CompensationState::default();
    let incomplete = estimate(&tables, 0, reading, &AuxiliaryInputs::default(), &mut state);
    let [x, _] = incomplete.force.map(|force| force.newtons());
    assert!(incomplete.missing_inputs && (x - 40.0).abs() < 0.5, "{x}");
    assert_eq!(incomplete.parity.sigma, 0, "the residual contains the neighbour's field");
    let complete = estimate(&tables, 0, reading, &inputs(&track(), 0), &mut state);
    assert!(!complete.missing_inputs && complete.parity.sigma == 5);
}

#[test]
fn the_device_compensates_formulas_of_forces_rates_and_lags() {
    for (text, coefficient, limit_n) in [
        // By the tables of the ideal model.
        ("own: gain_percent = a*fz_n", 0.02, 0.25),
        ("own: dx_um = a*fx_n*fz_n", 1.5e-3, 0.25),
        ("own: dy_um = a*abs(fx_n)", 0.2, 0.4),
        ("own: rotation_y_mrad = a*fz_n", 0.2, 0.25),
        // By the compensation.
        ("own: dx_um = a*fx_rate_n_per_s", 0.01, 0.6),
        ("own: bx_g = a*opening_rate_mm_per_s", 0.2, 0.25),
        ("own: gain_x_percent = a*opening_mm*fx_n", 3e-4, 0.25),
        ("own: gain_percent = a*opening_mm*fz_n", 5e-4, 0.25),
        ("own: rotation_y_mrad = a*opening_mm", 0.5, 0.25),
        ("own: rotation_z_mrad = a*opening_mm*fx_n", 1e-3, 0.25),
        ("own: tilt_x_mrad = a*opening_mm*fz_n", 1e-3, 0.5),
        ("own: dy_um = a*opening_mm*fx_n", 0.01, 0.5),
        ("own: fx_n = a*lag(temp_c, 2)", 0.3, 0.25),
        ("own: fz_n = a*lag(fx_n, 0.5)", 0.05, 0.25),
        ("own: fz_n = a*opening_mm*motor_iq_a*fz_n", 5e-5, 0.25),
    ] {
        let (with, without) = errors(formula(text, coefficient));
        assert!(
            with < limit_n && with < 0.5 * without,
            "{text}: {with} N with, {without} N without"
        );
    }
}

#[test]
fn formula_that_the_device_cannot_subtract_is_refused_with_a_reason() {
    let refused = |text: &str, coefficient: f64| {
        let effects = [formula(text, coefficient)];
        let rest = StaticModel::new(nominal(), &effects, 1, FinalState::ENDED);
        OwnedCompensation::build(0, &rest, &effects, GAUSS_PER_LSB).unwrap_err().to_string()
    };
    for (text, coefficient, reason) in [
        // 0.64 N per newton at 64 mm.
        ("own: fx_n = a*opening_mm*fx_n", 0.01, "up to 0.64 N per newton of the forces"),
        ("own: fx_n = a*fx_rate_n_per_s", 0.06, "converges below 0.5 N"),
        ("own: gain_percent = a*opening_mm*fz_n", 0.01, "the device allows 50 %"),
        ("own: bx_g = a*sin(20*opening_mm)*fx_n", 0.01, "it varies too fast"),
        ("own: bx_g = a*motor_angle_rad", 1.0, "modulo one turn"),
        ("own: bx_g = a*lag(motor_angle_rad, 1)", 1.0, "it has no lag"),
        ("own: bx_g = a*time_s", 1.0, "the board does not know time_s"),
        ("own: bx_g = a*roll_rad", 1.0, "use accel_x_mps2"),
        ("own: bx_g = a*fx_n*fz_n*opening_mm*temp_c", 1e-9, "depends on 4 quantities"),
    ] {
        let found = refused(text, coefficient);
        assert!(found.contains(reason), "{text}: {found}");
    }
}

#[test]
fn support_by_the_device_is_known_before_a_fit() {
    let support = |(effect, _): (EffectTerm, Vec<f64>)| DeviceSupport::of(&effect).to_string();
    assert_eq!(support(formula("own: bx_g = a*opening_mm*fz_n", 1.0)), "yes, after homing");
    assert_eq!(
        support(formula("own: bx_g = a*fz_n", 1.0)),
        "yes, by the tables of the ideal model"
    );
    let time = support(formula("own: bx_g = a*time_s", 1.0));
    assert!(time.starts_with("no, because the board does not know time_s"), "{time}");
    assert_eq!(support(effect_with_values("thermal_gap")), "yes");
    assert!(support(effect_with_values("external_magnet")).starts_with("no, because"));
}

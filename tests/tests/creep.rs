//! Fits of creep with one and with two time constants.

use std::path::Path;

use model_export::effects::{EffectTerm, find};
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::joint::SensorFit;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use tempfile::TempDir;
use tests::{RECORDING_TOML, nominal, write_recording};

const SECONDS: usize = 24;
/// Duration of a ramp and period of the load steps.
const RAMP_S: f64 = 0.4;
const HOLD_S: f64 = 2.0;

/// Load steps with ramps, in newtons per millisecond.
fn loads(rng: &mut ChaCha8Rng) -> Vec<f64> {
    let count = (SECONDS as f64 / HOLD_S) as usize;
    let mut levels = vec![0.0];
    levels.extend((1..count).map(|i| match i % 3 {
        0 => 0.0,
        _ => rng.random_range(-150.0..150.0),
    }));
    (0..1000 * SECONDS)
        .map(|ms| {
            let time_s = ms as f64 * 1e-3;
            let i = (time_s / HOLD_S) as usize;
            let before = levels[i.saturating_sub(1)];
            let share = ((time_s - HOLD_S * i as f64) / RAMP_S).min(1.0);
            before + share * (levels[i] - before)
        })
        .collect()
}

/// Force equivalent of the deflection with creep; `parts` are relative amplitudes and time constants in seconds.
fn with_creep(load: &[f64], parts: &[(f64, f64)]) -> Vec<f64> {
    let mut delayed = vec![0.0; parts.len()];
    let deflection = |&load: &f64| {
        let mut sum = load;
        for (delayed, (share, time_s)) in delayed.iter_mut().zip(parts) {
            *delayed += (load - *delayed) * 1e-3 / time_s;
            sum += share * *delayed;
        }
        sum
    };
    load.iter().map(deflection).collect()
}

fn write(folder: &Path, recording: u64, parts: &[(f64, f64)]) {
    let mut rng = ChaCha8Rng::seed_from_u64(recording);
    let load = [loads(&mut rng), loads(&mut rng)];
    let [x, z] = load.each_ref().map(|load| with_creep(load, parts));
    let field_noise = Normal::new(0.0, 0.35).unwrap();
    let force_noise = Normal::new(0.0, 0.15).unwrap();
    let mut hall = "t_us,s0_x_lsb,s0_y_lsb,s0_z_lsb\n".to_owned();
    let mut force = "t_us,f0_x_n,f0_z_n\n".to_owned();
    for ms in 0..x.len() {
        let field = nominal().field([x[ms], z[ms]]);
        let counts = field.map(|g| ((g + field_noise.sample(&mut rng)) / 0.125).round());
        let t_us = 1000 * ms;
        hall += &format!("{t_us},{},{},{}\n", counts.x, counts.y, counts.z);
        if ms % 10 == 0 {
            let [x, z] = [0, 1].map(|axis| load[axis][ms] + force_noise.sample(&mut rng));
            force += &format!("{t_us},{x:.3},{z:.3}\n");
        }
    }
    let folder = folder.join(recording.to_string());
    write_recording(&folder, RECORDING_TOML, &hall, &force);
}

/// Ratios of held-out error and noise floor without and with creep, and the fit with creep.
fn fitted(parts: &[(f64, f64)]) -> ([f64; 2], SensorFit) {
    let folder = TempDir::new().unwrap();
    (1..=3).for_each(|recording| write(folder.path(), recording, parts));
    let campaign = Campaign::read(folder.path(), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    let prepared = FitSetup::cylinder(&campaign).unwrap();
    let options = FitOptions { seed: 1, draws: 40 };
    let fit = |effects: &[EffectTerm]| {
        let split = prepared.split(effects);
        prepared.fit(effects, split, options, |_| ()).unwrap()
    };
    let floor_ratio = |tally: model_export::fit::cross_validation::ErrorSums| {
        tally.mean_square().sqrt() / tally.floor_g()
    };
    let before = fit(&[]);
    let after = fit(&[EffectTerm::Catalogue(find("creep").unwrap())]);
    let ratios = [floor_ratio(before.tally()), floor_ratio(after.tally())];
    (ratios, after.sensors[0].clone())
}

/// A parameter with its standard error.
fn parameter(fit: &SensorFit, name: &str) -> (f64, f64) {
    let slot = fit.parameters.iter().position(|slot| slot.name == name).unwrap();
    (fit.values[slot], fit.std_error(slot))
}

#[test]
fn two_time_constants_of_creep_are_estimated() {
    let ([before, after], fit) = fitted(&[(0.012, 1.2), (0.008, 9.0)]);
    assert!(before > 1.5 && after < 1.02, "{before} {after}");
    for (name, truth, within) in [
        ("creep_x", 2.0, 0.2),
        ("creep_z", 2.0, 0.2),
        ("time1", 1.2, 0.3),
        ("time2", 9.0, 4.0),
        ("weight", 0.008 / 0.012, 0.25),
    ] {
        let (value, error) = parameter(&fit, name);
        assert!((value - truth).abs() < within, "{name}: {value} +- {error}");
    }
}

#[test]
fn creep_with_one_time_constant_has_its_full_magnitude() {
    for time_s in [0.8, 3.0, 15.0] {
        let ([before, after], fit) = fitted(&[(0.02, time_s)]);
        assert!(before > 1.5 && after < 1.02, "{time_s} s: {before} {after}");
        for name in ["creep_x", "creep_z"] {
            let (value, error) = parameter(&fit, name);
            assert!((value - 2.0).abs() < 0.3, "{time_s} s {name}: {value} +- {error}");
        }
    }
}

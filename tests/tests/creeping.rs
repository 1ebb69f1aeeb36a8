//! A flexure that creeps with one time constant, and one with two, both end at the noise floor.

use std::path::Path;

use model_export::effects::{Addition, find};
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;
use model_export::fit::joint::SensorFit;
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use tempfile::TempDir;
use tests::{RECORDING_TOML, nominal, write_recording};

const SECONDS: usize = 24;
/// A load is reached within this time and then held.
const RAMP_S: f64 = 0.4;
const HOLD_S: f64 = 2.0;

/// Loads in newtons every millisecond: from no load to one after the other, and held.
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

/// The load as the flexure shows it: `parts` are shares and time constants in seconds.
fn crept(load: &[f64], parts: &[(f64, f64)]) -> Vec<f64> {
    let mut delayed = vec![0.0; parts.len()];
    let show = |&load: &f64| {
        let mut shown = load;
        for (delayed, (share, time_s)) in delayed.iter_mut().zip(parts) {
            *delayed += (load - *delayed) * 1e-3 / time_s;
            shown += share * *delayed;
        }
        shown
    };
    load.iter().map(show).collect()
}

fn write(folder: &Path, recording: u64, parts: &[(f64, f64)]) {
    let mut rng = ChaCha8Rng::seed_from_u64(recording);
    let load = [loads(&mut rng), loads(&mut rng)];
    let [x, z] = load.each_ref().map(|load| crept(load, parts));
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

/// Held-out error over floor without and with creep, and the fit with it.
fn fitted(parts: &[(f64, f64)]) -> ([f64; 2], SensorFit) {
    let folder = TempDir::new().unwrap();
    (1..=3).for_each(|recording| write(folder.path(), recording, parts));
    let campaign = Campaign::read(folder.path(), Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    let prepared = Prepared::cylinder(&campaign).unwrap();
    let options = Options { seed: 1, draws: 40 };
    let fit = |effects: &[Addition]| {
        let split = prepared.split(effects);
        prepared.fit(effects, split, options, |_| ()).unwrap()
    };
    let over_floor =
        |tally: model_export::fit::score::Tally| tally.mean_square().sqrt() / tally.floor_g();
    let before = fit(&[]);
    let after = fit(&[Addition::Catalogue(find("creep").unwrap())]);
    let ratios = [over_floor(before.tally()), over_floor(after.tally())];
    (ratios, after.sensors[0].clone())
}

/// A parameter of creep with its error bar.
fn of(fit: &SensorFit, name: &str) -> (f64, f64) {
    let slot = fit.slots.iter().position(|slot| slot.name == name).unwrap();
    (fit.values[slot], fit.std_error(slot))
}

#[test]
fn creep_with_two_times_is_fitted_to_the_floor_and_both_times_are_found() {
    let ([before, after], fit) = fitted(&[(0.012, 1.2), (0.008, 9.0)]);
    assert!(before > 1.5 && after < 1.02, "{before} {after}");
    for (name, truth, within) in [
        ("creep_x", 2.0, 0.2),
        ("creep_z", 2.0, 0.2),
        ("time1", 1.2, 0.3),
        ("time2", 9.0, 4.0),
        ("weight", 0.008 / 0.012, 0.25),
    ] {
        let (value, bar) = of(&fit, name);
        assert!((value - truth).abs() < within, "{name}: {value} +- {bar}");
    }
}

#[test]
fn creep_with_one_time_is_fitted_to_the_floor_and_has_its_whole_size() {
    for time_s in [0.8, 3.0, 15.0] {
        let ([before, after], fit) = fitted(&[(0.02, time_s)]);
        assert!(before > 1.5 && after < 1.02, "{time_s} s: {before} {after}");
        for name in ["creep_x", "creep_z"] {
            let (value, bar) = of(&fit, name);
            assert!(
                (value - 2.0).abs() < 0.3,
                "{time_s} s {name}: {value} +- {bar}"
            );
        }
    }
}

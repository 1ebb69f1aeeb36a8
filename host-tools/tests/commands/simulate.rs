//! Simulated campaigns: readable like recorded ones, with the specified effects, reproducible.

use std::fs;
use std::path::{Path, PathBuf};

use model_export::fit::{FitOptions, campaign};
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use serde_json::Value;
use sim::effects::EFFECT_KINDS;

use crate::workdir::{WorkDir, text};

/// Simulates into `name` in a folder; returns the campaign's path and the printed text.
fn simulated(dir: &WorkDir, name: &str, arguments: &[&str]) -> (PathBuf, String) {
    let output = dir.run(&[&["simulate", "-o", name], arguments].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    (dir.path(name), text(&output.stdout) + &text(&output.stderr))
}

fn read(campaign: &Path) -> Campaign {
    read_late(campaign, 0.0)
}

/// Reads a campaign with a delay added to the reference's times.
fn read_late(campaign: &Path, delay_us: f64) -> Campaign {
    Campaign::read(campaign, Alignment { delay_us }, |_| ()).unwrap()
}

/// Held-out error over noise floor, every axis of every sensor.
fn ratios(campaign: &Campaign) -> Vec<f64> {
    let (fits, notices) = campaign::cylinder(campaign, FitOptions::default(), |_| ()).unwrap();
    assert!(notices.is_empty());
    let scores = fits.scores();
    scores.iter().map(|s| s.held_out_rms_g / s.floor_g).collect()
}

/// All files of a folder by relative path.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(at) = folders.pop() {
        for entry in fs::read_dir(at).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                files.push((
                    path.strip_prefix(folder).unwrap().to_path_buf(),
                    fs::read(&path).unwrap(),
                ));
            }
        }
    }
    files.sort();
    files
}

#[test]
fn clean_campaign_fits_to_its_noise_floor() {
    let dir = WorkDir::empty();
    for seed in ["1", "2"] {
        let (path, _) = simulated(&dir, seed, &["--seed", seed]);
        let campaign = read(&path);
        assert_eq!(campaign.notices().count(), 0);
        assert_eq!((campaign.recordings.len(), campaign.sensors().len()), (3, 4));
        for ratio in ratios(&campaign) {
            assert!((0.95..=1.05).contains(&ratio), "seed {seed}: {ratio}");
        }
    }
}

#[test]
fn every_programme_fits_to_its_noise_floor() {
    let dir = WorkDir::empty();
    for programme in ["still", "level", "isothermal", "same-warm-up", "single-sine"] {
        let (path, _) = simulated(&dir, programme, &["--programme", programme, "--sensors", "1"]);
        for ratio in ratios(&read(&path)) {
            assert!((0.9..=1.1).contains(&ratio), "{programme}: {ratio}");
        }
    }
}

#[test]
fn clock_skew_is_removed_by_the_same_delay() {
    let dir = WorkDir::empty();
    let skewed = ["--effect", "clock_skew=7", "--seconds", "15"];
    let (path, _) = simulated(&dir, "skewed", &skewed);
    let worst = |delay_us| ratios(&read_late(&path, delay_us)).into_iter().fold(0.0, f64::max);
    assert!(worst(7000.0) < 1.05 && worst(0.0) > 5.0);
}

#[test]
fn recordings_start_with_half_a_second_unloaded() {
    let dir = WorkDir::empty();
    let (path, _) = simulated(&dir, "one", &["--seconds", "5"]);
    for recording in read(&path).recordings {
        let rows = recording.time_s.iter().filter(|t| **t < 0.49).count();
        for track in recording.forces.values() {
            let largest = track.newtons[..rows].iter().fold(0.0_f64, |l, n| l.max(n.abs()));
            assert!(rows > 40 && largest < 1.0, "{largest}");
            assert!(track.newtons.iter().any(|n| n.abs() > 100.0));
        }
    }
}

#[test]
fn effects_outside_the_catalogue_change_the_data_and_all_combine() {
    let dir = WorkDir::empty();
    let short = ["--seconds", "4", "--sensors", "1", "--recordings", "2"];
    let (clean, _) = simulated(&dir, "clean", &short);
    let (clean, mut all) = (contents(&clean), short.map(str::to_owned).to_vec());
    for kind in EFFECT_KINDS.iter() {
        all.extend(["--effect".to_owned(), kind.id.to_owned()]);
        if !kind.is_in_catalogue {
            let wanted = [&short[..], &["--effect", kind.id]].concat();
            let (path, _) = simulated(&dir, kind.id, &wanted);
            assert_ne!(contents(&path), clean, "{}", kind.id);
        }
    }
    let all: Vec<&str> = all.iter().map(String::as_str).collect();
    let (path, _) = simulated(&dir, "all", &all);
    assert_eq!(read(&path).notices().count(), 0);
}

#[test]
fn campaigns_are_seeded_and_reproducible() {
    let dir = WorkDir::empty();
    let hidden = ["--random-effects", "3", "--seconds", "4", "--noise", "ar1"];
    let of = |name: &str, seed: &str| {
        let (path, _) = simulated(&dir, name, &[&hidden[..], &["--seed", seed]].concat());
        (contents(&path), dir.read(&format!("{name}-truth.toml")))
    };
    let (first, again, other) = (of("a", "5"), of("b", "5"), of("c", "6"));
    assert_eq!(first.0.len(), 9);
    assert!(first == again && first.0 != other.0 && first.1 != other.1);
}

#[test]
fn random_effects_are_named_in_the_truth_only() {
    let dir = WorkDir::empty();
    let arguments = ["--random-effects", "4", "--seconds", "4", "--seed", "9"];
    let (path, stderr) = simulated(&dir, "riddle", &arguments);
    let (_, json) = simulated(&dir, "again", &[&arguments[..], &["--json"]].concat());
    let truth: toml::Table = dir.read("riddle-truth.toml").parse().unwrap();
    let effects = truth["effect"].as_array().unwrap();
    assert!(effects.len() >= 4);
    let described = fs::read_to_string(path.join("1/recording.toml")).unwrap();
    for effect in effects {
        let id = effect["id"].as_str().unwrap();
        assert!(!stderr.contains(id) && !json.contains(id) && !described.contains(id), "{id}");
        let each = effect["each"].as_array().unwrap();
        let sum: f64 = each.iter().map(|size| size.as_float().unwrap()).sum();
        let size = effect["size"].as_float().unwrap();
        assert!((sum / each.len() as f64 - size).abs() < 1e-9 * size.abs().max(1.0), "{id}");
    }
    let names: Vec<PathBuf> = contents(&path).into_iter().map(|(name, _)| name).collect();
    let of_one = ["force.csv.gz", "hall.csv.gz", "recording.toml"];
    let expected = ["1", "2", "3"].iter().flat_map(|n| of_one.map(|file| Path::new(n).join(file)));
    assert_eq!(names, expected.collect::<Vec<_>>());
}

#[test]
fn description_is_independent_of_the_effects() {
    let dir = WorkDir::empty();
    let (clean, _) = simulated(&dir, "clean", &["--seconds", "3"]);
    let wanted = ["--seconds", "3", "--effect", "creep", "--programme", "level", "--seed", "4"];
    let (other, _) = simulated(&dir, "other", &wanted);
    for file in ["1/recording.toml", "2/recording.toml", "3/recording.toml"] {
        assert_eq!(fs::read(clean.join(file)).unwrap(), fs::read(other.join(file)).unwrap());
    }
}

#[test]
fn json_lists_seed_programme_and_effects() {
    let dir = WorkDir::empty();
    let wanted = ["--effect", "hysteresis=1.5:both", "--seconds", "3", "--json"];
    let (_, json) = simulated(&dir, "one", &wanted);
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!((&json["seed"], &json["programme"]), (&1.into(), &"bench".into()));
    let effect = &json["effects"][0];
    assert_eq!((&effect["id"], &effect["size"]), (&"hysteresis".into(), &1.5.into()));
    let truth = dir.read("one-truth.toml");
    assert!(truth.contains("flexures = \"both\""), "{truth}");
}

#[test]
fn unknown_effect_reports_a_suggestion() {
    let stderr = WorkDir::empty().failure("simulate -o nowhere --effect histeresis");
    assert!(stderr.contains("did you mean hysteresis?"), "{stderr}");
    assert!(stderr.contains("screw_ripple"), "{stderr}");
}

#[test]
fn existing_files_and_truth_in_campaign_are_rejected() {
    let dir = WorkDir::empty();
    simulated(&dir, "one", &["--seconds", "3"]);
    for (arguments, words) in [
        ("-o one", "not overwritten"),
        ("-o two --truth one-truth.toml", "not overwritten"),
        ("-o two --truth two/truth.toml", "choose a path outside"),
    ] {
        let message = dir.failure(&format!("simulate {arguments}"));
        assert!(message.contains(words), "{arguments}: {message}");
    }
    assert!(!dir.path("two").exists());
}

#[test]
fn empty_folder_is_used_and_invalid_settings_are_rejected() {
    let dir = WorkDir::empty();
    fs::create_dir(dir.path("empty")).unwrap();
    simulated(&dir, "empty", &["--seconds", "3"]);
    for wrong in ["--seconds=1", "--scatter=NaN", "--field-noise=-1", "--random-effects=99"] {
        let output = dir.run(&["simulate", "-o", "wrong", wrong]);
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
        assert_eq!(text(&output.stderr).lines().count(), 1);
        assert!(!dir.path("wrong").exists());
    }
}

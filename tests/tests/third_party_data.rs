//! Fits of third-party measurements. Skipped with a note if the data are not available.

use std::path::PathBuf;

use model_export::effects::{EffectTerm, find};
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::effect_size::effect_sizes;
use model_export::fit::joint::JointFit;
use model_export::model_file::{ModelFile, Provenance};
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use model_export::recordings::import::import;
use tempfile::TempDir;
use tests::{data, real_data};

/// A short bootstrap: standard errors are not tested.
const OPTIONS: FitOptions = FitOptions { seed: 1, draws: 40 };

/// The campaign and its temporary folder.
fn campaign(mapping: &str, sources: &[PathBuf]) -> (Campaign, TempDir) {
    let folder = TempDir::new().unwrap();
    let target = folder.path().join("campaign");
    import(&data(mapping), sources, &target, |_| ()).unwrap();
    let campaign = Campaign::read(&target, Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    (campaign, folder)
}

fn fit(prepared: &FitSetup, effects: &[EffectTerm]) -> JointFit {
    let split = prepared.split(effects);
    prepared.fit(effects, split, OPTIONS, |_| ()).unwrap()
}

fn rms(fit: &JointFit) -> f64 {
    fit.tally().mean_square().sqrt()
}

#[test]
fn drift_and_hysteresis_reduce_the_lattice_error_with_an_impossible_sign() {
    let Some(folder) = real_data("eflesh_normal") else {
        return;
    };
    let sources = ["run1.csv", "run2.csv", "run3.csv"].map(|name| folder.join(name));
    let (campaign, _folder) = campaign("eflesh_normal.mapping.toml", &sources);
    let prepared = FitSetup::polynomial(&campaign, Some(5), OPTIONS).unwrap();
    let mut effects = Vec::new();
    let mut before = fit(&prepared, &effects);
    let limits = [("field_drift", 0.40..0.44), ("hysteresis", 0.34..0.38)];
    assert!((0.70..0.73).contains(&rms(&before)), "{}", rms(&before));
    for (name, limits) in limits {
        effects.push(EffectTerm::Catalogue(find(name).unwrap()));
        let after = fit(&prepared, &effects);
        assert!(limits.contains(&rms(&after)), "{name}: {}", rms(&after));
        for (old, new) in before.folds().iter().zip(after.folds()) {
            assert!(new.mean_square() < old.mean_square(), "{name}");
        }
        before = after;
    }
    // The field of the lattice lags behind its force with the opposite sign: a diagnosis does not call it friction.
    let sizes = effect_sizes(&before, &effects, campaign.recordings.len());
    assert!(sizes[0].is_possible() && !sizes[1].is_possible(), "{sizes:?}");
    let provenance = Provenance::of(&campaign, 0.0, OPTIONS).unwrap();
    let model = ModelFile::with_effects(&campaign, &prepared, &before, &effects, provenance);
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("model.toml");
    model.write(&path).unwrap();
    let read = ModelFile::read(&path).unwrap();
    let additions = read.effect_terms(&path).unwrap();
    assert_eq!(additions, effects);
    for (effect, addition) in read.effects.iter().zip(&additions) {
        let values = effect.values(addition, 0, campaign.recordings.len());
        assert!(values.is_some(), "{} is incomplete", effect.name);
    }
}

#[test]
fn the_earth_s_field_is_found_in_magnetometer_data() {
    let Some(folder) = real_data("px4_earth_field") else {
        return;
    };
    let sources = [folder.join("sample_mag.csv")];
    let (campaign, _folder) = campaign("px4_earth_field.mapping.toml", &sources);
    let prepared = FitSetup::polynomial(&campaign, None, OPTIONS).unwrap();
    assert_eq!(prepared.polynomials[0].model.degree, 0);
    let before = fit(&prepared, &[]);
    assert!((0.0135..0.0155).contains(&rms(&before)), "{}", rms(&before));
    let effects = [EffectTerm::Catalogue(find("earth_field").unwrap())];
    let after = fit(&prepared, &effects);
    assert!((0.005..0.0080).contains(&rms(&after)), "{}", rms(&after));
    let size = &effect_sizes(&after, &effects, 1)[0];
    assert!((0.42..0.54).contains(&size.value), "{}", size.value);
    assert!(after.sensors[0].offset_confounded);
}

#[test]
fn a_polynomial_without_a_force_is_refused() {
    let Some(folder) = real_data("px4_earth_field") else {
        return;
    };
    let sources = [folder.join("sample_mag.csv")];
    let (campaign, _folder) = campaign("px4_earth_field.mapping.toml", &sources);
    let refused = FitSetup::polynomial(&campaign, Some(2), OPTIONS).err();
    let message = refused.unwrap().to_string();
    assert!(
        message.contains("a polynomial of degree 2 needs a force, and none was recorded"),
        "{message}"
    );
}

//! Effects found in real measurements by others. Without the data each test says so and does nothing.

use std::path::PathBuf;

use model_export::effects::{Addition, find};
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;
use model_export::fit::joint::JointFit;
use model_export::fit::size::sizes;
use model_export::model_file::{ModelFile, Provenance};
use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use model_export::recordings::import::import;
use tempfile::TempDir;
use tests::{data, real_data};

/// Fewer draws of the bootstrap than a person would take: only error bars need them.
const OPTIONS: Options = Options { seed: 1, draws: 40 };

/// The campaign, and the folder that it lies in while it is used.
fn campaign(mapping: &str, sources: &[PathBuf]) -> (Campaign, TempDir) {
    let folder = TempDir::new().unwrap();
    let target = folder.path().join("campaign");
    import(&data(mapping), sources, &target, |_| ()).unwrap();
    let campaign = Campaign::read(&target, Alignment { delay_us: 0.0 }, |_| ()).unwrap();
    (campaign, folder)
}

fn fit(prepared: &Prepared, effects: &[Addition]) -> JointFit {
    let split = prepared.split(effects);
    prepared.fit(effects, split, OPTIONS, |_| ()).unwrap()
}

fn rms(fit: &JointFit) -> f64 {
    fit.tally().mean_square().sqrt()
}

#[test]
fn drift_then_hysteresis_then_creep_each_lower_the_error_of_a_printed_lattice() {
    let Some(folder) = real_data("eflesh_normal") else {
        return;
    };
    let sources = ["run1.csv", "run2.csv", "run3.csv"].map(|name| folder.join(name));
    let (campaign, _kept) = campaign("eflesh_normal.mapping.toml", &sources);
    let prepared = Prepared::polynomial(&campaign, Some(5), OPTIONS).unwrap();
    let mut effects = Vec::new();
    let mut before = fit(&prepared, &effects);
    let limits = [
        ("field_drift", 0.40..0.44),
        ("hysteresis", 0.36..0.40),
        ("creep", 0.33..0.37),
    ];
    assert!((0.70..0.73).contains(&rms(&before)), "{}", rms(&before));
    for (name, limits) in limits {
        let effect = Addition::Catalogue(find(name).unwrap());
        effects.push(effect.beside_polynomial([false, true]));
        let after = fit(&prepared, &effects);
        assert!(limits.contains(&rms(&after)), "{name}: {}", rms(&after));
        for (old, new) in before.folds().iter().zip(after.folds()) {
            assert!(new.mean_square() < old.mean_square(), "{name}");
        }
        before = after;
    }
    let provenance = Provenance::of(&campaign, 0.0, OPTIONS).unwrap();
    let model = ModelFile::with_effects(&campaign, &prepared, &before, &effects, provenance);
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("model.toml");
    model.write(&path).unwrap();
    let read = ModelFile::read(&path).unwrap();
    let additions = read.additions(&path).unwrap();
    assert_eq!(additions, effects);
    for (effect, addition) in read.effects.iter().zip(&additions) {
        let values = effect.values(addition, 0, campaign.recordings.len());
        assert!(values.is_some(), "{} is read back whole", effect.name);
    }
}

#[test]
fn a_magnetometer_that_nothing_pushes_feels_the_earth_s_field() {
    let Some(folder) = real_data("px4_earth_field") else {
        return;
    };
    let sources = [folder.join("sample_mag.csv")];
    let (campaign, _kept) = campaign("px4_earth_field.mapping.toml", &sources);
    let prepared = Prepared::polynomial(&campaign, None, OPTIONS).unwrap();
    assert_eq!(prepared.polynomials[0].model.degree, 0);
    let before = fit(&prepared, &[]);
    assert!((0.0135..0.0155).contains(&rms(&before)), "{}", rms(&before));
    let effects = [Addition::Catalogue(find("earth_field").unwrap())];
    let after = fit(&prepared, &effects);
    assert!((0.005..0.0076).contains(&rms(&after)), "{}", rms(&after));
    let size = &sizes(&after, &effects, 1)[0];
    assert!((0.42..0.54).contains(&size.value), "{}", size.value);
    assert!(after.sensors[0].offset_is_open);
}

#[test]
fn a_degree_without_a_force_is_refused() {
    let Some(folder) = real_data("px4_earth_field") else {
        return;
    };
    let sources = [folder.join("sample_mag.csv")];
    let (campaign, _kept) = campaign("px4_earth_field.mapping.toml", &sources);
    let refused = Prepared::polynomial(&campaign, Some(2), OPTIONS).err();
    let said = refused.unwrap().to_string();
    assert!(
        said.contains("a polynomial of degree 2 needs a force, and none was recorded"),
        "{said}"
    );
}

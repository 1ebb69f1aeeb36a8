//! Every effect of the catalogue is complete: simulated, compensated, diagnosed and documented, or the effect's file
//! states why not.

use std::fs;
use std::path::Path;

use model_export::effects::{
    CATALOGUE, DeviceForm, Effect, EffectStage, EffectTerm, FinalState, ParameterKind, Signature,
    Simulation, find,
};
use model_export::inverse::compensation::OwnedCompensation;
use model_export::inverse::static_model::StaticModel;
use model_export::physics::ForwardModel;
use model_export::recordings::columns::COVARIATES;
use model_export::recordings::description::NominalDesign;
use sim::effects::find_kind;

use crate::workdir::{WorkDir, diagnosis};

/// Resolution of the sensor, any.
const GAUSS_PER_LSB: f64 = 0.125;
/// Recordings of the campaign to which parameters apply.
const RECORDINGS: usize = 2;

#[test]
fn ids_are_unique_and_confusable_ids_exist() {
    for effect in CATALOGUE {
        let id = effect.id;
        assert_eq!(CATALOGUE.iter().filter(|e| e.id == id).count(), 1, "{id} is used twice");
        for (other, when) in effect.confused_with {
            assert!(find(other).is_ok() && *other != id && !when.is_empty(), "{id}: {other}");
        }
        for need in effect.needs {
            assert!(*need == "temp_c" || COVARIATES.contains(need), "{id}: no column {need}");
        }
        let texts =
            [effect.physics, effect.equation, effect.regressors, effect.record, effect.size.unit];
        assert!(texts.iter().all(|text| !text.is_empty()), "{id}: a text is missing");
    }
}

#[test]
fn effects_with_a_common_signature_are_stated_as_confusable() {
    for signature in [Signature::LoadHistory, Signature::Time, Signature::Temperature] {
        let set: Vec<&Effect> =
            CATALOGUE.into_iter().filter(|e| e.signatures.contains(&signature)).collect();
        let linked = |one: &Effect, other: &Effect| {
            let states = |a: &Effect, b: &Effect| a.confused_with.iter().any(|(id, _)| *id == b.id);
            states(one, other) || states(other, one)
        };
        for effect in &set {
            let is_linked = set.iter().any(|other| linked(effect, other));
            assert!(is_linked, "{}: no confusable effect of {signature:?}", effect.id);
        }
    }
}

#[test]
fn every_effect_is_simulated_or_has_a_reason() {
    let dir = WorkDir::empty();
    let simulate = |name: &str, more: &[&str]| {
        let arguments = ["simulate", "--seconds", "4", "--sensors", "1", "--recordings", "2", "-o"];
        let output = dir.run(&[&arguments[..], &[name], more].concat());
        (output.status.success(), dir.path(name))
    };
    let contents = |campaign: &Path, file: &str| {
        ["1", "2"].map(|recording| fs::read(campaign.join(recording).join(file)).unwrap())
    };
    let (_, clean) = simulate("clean", &[]);
    for effect in CATALOGUE {
        let (simulated, path) = simulate(effect.id, &["--effect", effect.id]);
        match effect.simulation {
            Simulation::Magnitude(_) => {
                assert!(simulated, "{} cannot be simulated", effect.id);
                let differs = |file| contents(&path, file) != contents(&clean, file);
                // An error of the reference may leave the field unchanged.
                let changed = differs("hall.csv.gz")
                    || (effect.stage == EffectStage::Reference && differs("force.csv.gz"));
                assert!(changed, "the simulator has no physics for {}", effect.id);
            }
            Simulation::Never(reason) => {
                assert!(!simulated && find_kind(effect.id).is_none() && !reason.is_empty());
            }
        }
    }
}

/// Typical coefficients, the middle of each grid, no initial state.
fn typical_values(effect: &EffectTerm) -> Vec<f64> {
    let value = |kind: &ParameterKind, typical: f64| match kind {
        ParameterKind::Coefficient => typical,
        ParameterKind::Shape { grid } => grid[grid.len() / 2],
        ParameterKind::InitialState | ParameterKind::Instant => 0.0,
    };
    effect.parameters(RECORDINGS).iter().map(|p| value(&p.kind, p.typical)).collect()
}

#[test]
fn every_effect_is_compensated_or_has_a_reason() {
    let nominal = ForwardModel::nominal(&NominalDesign::magpie());
    for effect in CATALOGUE {
        let term = EffectTerm::Catalogue(effect);
        let terms = [(term.clone(), typical_values(&term))];
        let model = StaticModel::new(nominal, &terms, RECORDINGS, FinalState::ENDED);
        let built = OwnedCompensation::build(0, &model, &terms, GAUSS_PER_LSB)
            .unwrap_or_else(|error| panic!("{error}"));
        let count = built.map(|own| {
            let view = own.view();
            (view.field.iter().flatten().count(), view.force.iter().flatten().count())
        });
        let load_n = [120.0, -90.0];
        let in_tables = model.field(load_n) != StaticModel::without_effects(nominal).field(load_n);
        let expected = match effect.device {
            DeviceForm::Field(_) => (Some((1, 0)), false),
            DeviceForm::Force(_) => (Some((0, 1)), false),
            DeviceForm::Tables | DeviceForm::Settled => (None, true),
            DeviceForm::Bench { remedy: reason, .. } | DeviceForm::Never(reason) => {
                assert!(!reason.is_empty(), "{}: no reason", effect.id);
                (None, false)
            }
        };
        assert_eq!((count, in_tables), expected, "{}", effect.id);
    }
}

#[test]
fn every_effect_is_diagnosed_or_has_a_reason() {
    let verdicts = diagnosis("clean")["verdicts"].as_array().unwrap();
    assert_eq!(verdicts.len(), CATALOGUE.len());
    for effect in CATALOGUE {
        let id = effect.id;
        let verdict = verdicts.iter().find(|verdict| verdict["effect"] == id);
        let verdict = verdict.unwrap_or_else(|| panic!("{id} has no verdict"));
        assert!(verdict["reason"].as_str().is_some_and(|reason| !reason.is_empty()), "{id}");
        // The campaign records every covariate. An error of the opening acts through another effect.
        let is_tested = verdict["z_typical"].as_f64().is_some_and(|z| z > 0.0);
        assert!(is_tested || effect.stage == EffectStage::Opening, "{id}: {verdict}");
    }
}

#[test]
fn readme_lists_every_effect() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../model-export/README.md");
    let readme = fs::read_to_string(path).unwrap();
    let row = |effect: &Effect| {
        let needs = match effect.needs {
            [] => "-".to_owned(),
            needs => needs.join(", "),
        };
        let unit = effect.size.unit;
        format!("| `{}` | {unit} | {needs} | {} |\n", effect.id, effect.device.label())
    };
    let table: String = CATALOGUE.map(row).concat();
    let head =
        "| effect | unit of its magnitude | requires | compensated |\n| --- | --- | --- | --- |\n";
    let expected = format!("{head}{table}\n");
    assert!(readme.contains(&expected), "model-export/README.md must contain\n{expected}");
}

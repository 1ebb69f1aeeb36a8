//! A made-up diagnosis with everything in it, for tests of what is shown of it.

use model_export::effects::find;
use model_export::model_file::{EffectModel, FittedValue, SensorEffect};

use analysis::compare::{Bin, ErrorRows, ForceError};
use analysis::diagnose::*;

/// A verdict without numbers.
pub fn verdict_of(effect: &str, kind: VerdictKind, reason: Reason) -> Verdict {
    Verdict {
        effect: effect.to_owned(),
        kind,
        provisional: false,
        reproduces: Vec::new(),
        excess_n: None,
        tied_with: Vec::new(),
        inclusion: f64::NAN,
        gain: 0.0,
        p_adjusted: 1.0,
        value: f64::NAN,
        differs: None,
        std_error: f64::NAN,
        unit: String::new(),
        z_typical: 2.0,
        implausible: None,
        reason,
        record: find(effect).map_or_else(|_| String::new(), |e| e.record.to_owned()),
    }
}

/// A step without forces, at a noise floor of 0.159 G.
pub fn step(added: &[&str], held_out_rms_g: f64) -> StaircaseStep {
    StaircaseStep {
        added: added.iter().map(|&name| name.to_owned()).collect(),
        parameters: 14 + added.len(),
        held_out_rms_g,
        force: None,
        floor_g: 0.159,
    }
}

/// A shape of two sensors over four bins, the last one without rows at the second sensor.
pub fn shape(effects: &[&str], words: &str, unit: &'static str) -> EffectShape {
    let bin = |i: usize| {
        let x = i as f64 - 1.5;
        let second = if i == 3 { f64::NAN } else { 4.0 * x };
        Bin {
            from: x,
            to: x + 1.0,
            centre: x + 0.5,
            rows: 100,
            mean: vec![[x, 0.0, 0.1], [0.0, second, 0.0]],
            band: vec![[(-2.0, 2.0); 3], [(second - 0.3, second + 0.3); 3]],
            ..Bin::default()
        }
    };
    let bins: Vec<Bin> = (0..4).map(bin).collect();
    EffectShape {
        effects: effects.iter().map(|&name| name.to_owned()).collect(),
        covariate: words.to_owned(),
        words: words.to_owned(),
        unit,
        sensors: vec![0, 3],
        taken_g: bins.iter().map(|bin| bin.mean.clone()).collect(),
        load_loop: None,
        bins,
    }
}

/// Found, tied, shadowed, not judgeable for three reasons, absent; something unexplained.
pub fn full() -> Diagnosis {
    let tied = |one: &str, other: &str| Verdict {
        tied_with: vec![other.to_owned()],
        gain: 0.709,
        p_adjusted: 0.002,
        ..verdict_of(one, VerdictKind::Tied, Reason::Equivalent)
    };
    let found = Verdict {
        value: 7.982,
        std_error: 0.010,
        unit: "N".to_owned(),
        gain: 0.994,
        p_adjusted: 0.002,
        ..verdict_of("hysteresis", VerdictKind::Found, Reason::ReducesError)
    };
    let small = |effect: &str, z: f64| Verdict {
        z_typical: z,
        ..verdict_of(effect, VerdictKind::Inconclusive, Reason::HardlyChangesField)
    };
    let shadow = Verdict {
        gain: f64::NAN,
        p_adjusted: f64::NAN,
        ..verdict_of(
            "creep",
            VerdictKind::Shadow,
            Reason::ExplainedBetter(vec!["hysteresis".to_owned()]),
        )
    };
    let stair = |added: &[&str], rms_g: f64| {
        let force = ForceError::of_device(0.6 * rms_g, 0.4, ErrorRows::LeaveRecordingOut);
        StaircaseStep { force: (rms_g > 1.0).then_some(force), ..step(added, rms_g) }
    };
    let pair = ["magnet_temperature", "sensor_temperature"];
    Diagnosis {
        model: "model.toml".to_owned(),
        campaign: "recordings/hidden-b".to_owned(),
        verdicts: vec![
            found,
            tied(pair[0], pair[1]),
            tied(pair[1], pair[0]),
            shadow,
            small("tip_slope", 1.0),
            small("geometric_stiffening", 2.0),
            verdict_of(
                "earth_field",
                VerdictKind::Inconclusive,
                Reason::NotRecorded("roll_rad".to_owned(), Vec::new()),
            ),
            verdict_of("thermal_gap", VerdictKind::Inconclusive, Reason::NeedsGeometry),
            verdict_of("motor_leakage", VerdictKind::Absent, Reason::BelowBound(0.08)),
        ],
        accepted: vec![pair.map(str::to_owned).to_vec(), vec!["hysteresis".to_owned()]],
        unexplained: vec![Unexplained {
            covariate: "motor_angle_rad".to_owned(),
            words: "rotor angle".to_owned(),
            share: 0.84,
        }],
        staircase: vec![stair(&[], 3.823), stair(&pair, 2.061), stair(&["hysteresis"], 0.231)],
        shapes: vec![
            shape(&pair, "temperature", "°C"),
            shape(&["hysteresis"], "direction of lateral loading", ""),
        ],
        next: Suggestion {
            kind: SuggestionKind::ChooseEffect,
            commands: vec![
                "cargo magpie add model.toml 'my <b>' hysteresis -o new.toml".to_owned(),
            ],
        },
        is_complete: true,
        blocks: 18,
        block_s: 5.0,
        seed: 1,
        ..Diagnosis::default()
    }
}

/// A formula that acts at one point of the chain, at two sensors, and at another point explains the same.
pub fn formula() -> DiscoveredFormula {
    let parameter = |value: f64, std_error: f64| FittedValue {
        value,
        std_error,
        unit: "G".to_owned(),
        identifiable: true,
        prior_width: None,
    };
    let sensor = |number: u32, a: f64, b: f64| SensorEffect {
        number,
        parameters: [
            ("a".to_owned(), parameter(a, 2.3e-6)),
            ("b".to_owned(), parameter(b, 0.0121)),
        ]
        .into(),
    };
    DiscoveredFormula {
        name: "formula_1".to_owned(),
        effects: Vec::new(),
        covariates: vec!["fx_n".to_owned(), "opening_mm".to_owned()],
        targets: vec!["by_g"],
        models: vec![EffectModel {
            name: "formula_1".to_owned(),
            expression: Some("formula_1: by_g = a*fx_n*opening_mm + b*fx_n".to_owned()),
            ranges: Vec::new(),
            quantity: "norm of the coefficients".to_owned(),
            value: 0.2,
            std_error: 0.01,
            unit: "G".to_owned(),
            sensors: vec![sensor(0, 1.2044e-3, -0.251), sensor(3, 1.1987e-3, 0.02)],
        }],
        gain: 0.984,
        p_value: 0.001,
        other_targets: Some(vec![vec!["dy_um"], vec!["gain_x_percent", "gain_y_percent"]]),
    }
}

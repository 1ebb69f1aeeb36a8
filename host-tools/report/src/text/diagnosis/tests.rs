use analysis::compare::{ErrorRows, ForceError};
use analysis::diagnose::fitted_model::WorstAxis;
use analysis::diagnose::{
    DiscoveredFormula, DropReason, DroppedStep, Reason, StaircaseStep, Verdict, VerdictKind,
};

use super::formulas::formula_alternatives;
use super::open_questions::{equivalent_sets, inconclusive_groups};
use super::reasons::short_reason;
use super::steps::rising_force;
use super::verdicts::magnitude;
use super::*;
use crate::text::diagnosis_fixture::{formula, full, step, verdict_of};

#[test]
fn equivalent_set_lists_reasons_and_experiments() {
    let tied = |one: &str, other: &str| Verdict {
        tied_with: vec![other.to_owned()],
        ..verdict_of(one, VerdictKind::Tied, Reason::Equivalent)
    };
    let diagnosis = Diagnosis {
        verdicts: vec![
            tied("neighbour_magnet", "motor_leakage"),
            tied("motor_leakage", "neighbour_magnet"),
        ],
        ..Diagnosis::default()
    };
    let ties = equivalent_sets(&diagnosis);
    assert_eq!(ties.len(), 1);
    assert_eq!(ties[0].effects, ["neighbour_magnet", "motor_leakage"]);
    assert_eq!(ties[0].alike, ["neighbour_magnet and motor_leakage: closing requires current"]);
    assert_eq!(ties[0].record.len(), 2);
    assert!(ties[0].record[0].1.starts_with("Open and close over the whole stroke"));
}

#[test]
fn inconclusive_effects_are_grouped_by_reason() {
    let masked = |effect, z_typical| Verdict {
        z_typical,
        ..verdict_of(effect, VerdictKind::Inconclusive, Reason::Masked)
    };
    let unrecorded = Reason::NotRecorded("temp_c".to_owned(), Vec::new());
    let diagnosis = Diagnosis {
        verdicts: vec![
            masked("tip_slope", 1.0),
            verdict_of("thermal_gap", VerdictKind::Inconclusive, unrecorded),
            masked("geometric_stiffening", 2.0),
        ],
        ..Diagnosis::default()
    };
    let groups = inconclusive_groups(&diagnosis);
    assert_eq!(groups.len(), 2);
    assert_eq!(groups[0].effects, ["tip_slope", "geometric_stiffening"]);
    assert_eq!(groups[0].why, "masked by other causes");
    // One recording decides on both.
    assert_eq!(groups[0].record.len(), 1);
    assert_eq!(groups[0].record[0].0, "tip_slope, geometric_stiffening");
    assert_eq!(groups[1].why, "temp_c was not recorded");
}

#[test]
fn provisional_verdict_requests_no_recording() {
    let mut blocked =
        verdict_of("tip_slope", VerdictKind::Inconclusive, Reason::UnexplainedResidual(None));
    blocked.provisional = true;
    let diagnosis = Diagnosis { verdicts: vec![blocked], ..Diagnosis::default() };
    assert_eq!(inconclusive_groups(&diagnosis)[0].record, []);
}

#[test]
fn one_large_unknown_is_one_row_and_missing_columns_come_first() {
    let blocked = |effect: &str, gain: f64| Verdict {
        gain,
        provisional: true,
        ..verdict_of(effect, VerdictKind::Inconclusive, Reason::UnexplainedResidual(None))
    };
    let names = [
        "creep",
        "hysteresis",
        "softening",
        "hard_stop",
        "tip_slope",
        "viscous_lag",
        "earth_field",
    ];
    let mut verdicts = vec![blocked("external_magnet", 0.13)];
    verdicts.extend(names.iter().map(|name| blocked(name, 0.001)));
    let missing = Reason::NotRecorded("opening_mm".to_owned(), Vec::new());
    verdicts.push(verdict_of("neighbour_magnet", VerdictKind::Inconclusive, missing));
    let staircase = vec![step(&[], 0.7)];
    let diagnosis = Diagnosis { verdicts, staircase, ..Diagnosis::default() };
    let page = uncolored(&diagnosis);
    let row = page.lines().find(|line| line.contains("7 others")).unwrap();
    assert!(row.contains("INCONCLUSIVE") && row.contains("much is unexplained"), "{row}");
    assert!(!page.contains("hard_stop") && page.contains("external_magnet"), "{page}");
    assert!(page.contains("8 effects: much more than noise"), "{page}");
    let first = page.find("opening_mm was not recorded: nothing can be said on neighbour_magnet.");
    assert!(first.unwrap() < page.find("verdict").unwrap(), "{page}");
}

#[test]
fn rule_behind_absent_is_stated_where_the_p_value_is_small() {
    let absent = |p_adjusted: f64| {
        short_reason(&Verdict {
            p_adjusted,
            ..verdict_of("creep", VerdictKind::Absent, Reason::BelowBound(0.08))
        })
    };
    assert_eq!(absent(0.4), "< 0.08 of typical");
    assert_eq!(absent(0.002), "not in every fold, < 0.08 of typical");
}

#[test]
fn rising_force_error_is_stated() {
    let step = |added: &str, rms_g: f64, rms_n: f64| StaircaseStep {
        force: Some(ForceError::of_device(rms_n, 0.4, ErrorRows::LeaveRecordingOut)),
        ..step(&[added], rms_g)
    };
    let steps =
        [step("", 3.8, 2.4), step("magnet_temperature", 2.1, 2.6), step("hysteresis", 0.2, 0.5)];
    let note = rising_force(&steps).unwrap();
    assert!(note.starts_with("With magnet_temperature the excess of the forces rises"), "{note}");
    assert_eq!(rising_force(&steps[1..]), None);
}

#[test]
fn formula_is_listed_with_its_line_its_values_and_its_other_targets() {
    let diagnosis = Diagnosis {
        formulas: vec![formula()],
        staircase: vec![step(&[], 0.521), step(&["formula_1"], 1.02 * 0.159)],
        at_floor: true,
        ..Diagnosis::default()
    };
    let page = uncolored(&diagnosis);
    assert!(page.contains("  formula_1: by_g = a*fx_n*opening_mm + b*fx_n\n"), "{page}");
    // In units of a power of ten; no finer than a thousandth of the value.
    for cells in
        [["a / 1e-3 G", "1.204±0.002", "1.199±0.002"], ["b / G", "-0.251±0.012", "0.020±0.012"]]
    {
        let has_all = |line: &&str| cells.iter().all(|cell| line.contains(cell));
        assert!(page.lines().any(|line| has_all(&line)), "{cells:?}: {page}");
    }
    let words = unwrapped(&page);
    assert!(words.contains("by 98.4 % (family-wise p 0.001), to 1.02 times"), "{words}");
    let others = "the same, within 2 %, if it acts on dy_um, or on gain_x_percent and gain_y_percent instead";
    assert!(words.contains(others), "{words}");
    assert!(!words.contains("PARTIAL"), "{words}");
    let unknown = DiscoveredFormula { other_targets: None, ..formula() };
    let expected = "It acts on by_g. Other quantities were not compared.";
    assert_eq!(formula_alternatives(&unknown), expected);
    let partial = Diagnosis { at_floor: false, ..diagnosis };
    assert!(uncolored(&partial).contains("PARTIAL: structure remains"));
    let json = to_json(&partial);
    assert_eq!(json["formulas"][0]["partial"], true);
    assert_eq!(json["formulas"][0]["covariates"], json!(["fx_n", "opening_mm"]));
    assert!((json["formulas"][0]["floors_after"].as_f64().unwrap() - 1.02).abs() < 1e-9);
    let effect = &json["formulas"][0]["effects"][0];
    assert_eq!(effect["expression"], "formula_1: by_g = a*fx_n*opening_mm + b*fx_n");
}

/// The report without colors.
fn uncolored(diagnosis: &Diagnosis) -> String {
    anstream::adapter::strip_str(&format_report(diagnosis)).to_string()
}

fn unwrapped(page: &str) -> String {
    page.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn lines_other_than_commands_fit_in_80_columns() {
    let page = uncolored(&full());
    for line in page.lines().filter(|line| !line.contains("cargo magpie add")) {
        assert!(line.chars().count() <= 80, "{line}");
    }
}

#[test]
fn each_effect_takes_one_table_row() {
    let page = uncolored(&full());
    let table: Vec<&str> = page
        .lines()
        .skip_while(|line| !line.starts_with('─'))
        .skip(1)
        .take_while(|line| !line.starts_with('─'))
        .collect();
    assert_eq!(table.len(), 9, "{table:#?}");
    assert!(table[8].contains("ABSENT") && table[8].contains("< 0.08 of typical"));
}

#[test]
fn sampling_similar_effects_and_equivalent_formulas_are_stated() {
    let mut diagnosis = full();
    diagnosis.rows = [900, 3600];
    let found = &mut diagnosis.verdicts[0];
    let share = |effect: &str, share| (effect.to_owned(), share);
    found.reproduces = vec![share("creep", 0.76), share("clock_skew", 0.3)];
    let equivalent = formula();
    let text = equivalent.models[0].expression.clone().unwrap();
    (found.kind, found.tied_with) = (VerdictKind::Tied, vec![equivalent.name.clone()]);
    diagnosis.equivalent_formulas = vec![equivalent];
    let page = unwrapped(&uncolored(&diagnosis));
    assert!(page.contains("Effects are selected on 25 % of the rows"));
    assert!(page.contains("standard errors are 2.0 times those of all rows then"));
    assert!(page.contains("On these recordings it reproduces the patterns of creep (76 %)."));
    assert!(page.contains("Equivalent on these data: hysteresis, formula_1"));
    assert!(page.contains(&format!("A formula leaves the same error: {text}.")));
    let json = to_json(&diagnosis);
    assert_eq!(json["equivalent_formulas"][0]["name"], "formula_1");
    assert_eq!(json["verdicts"][0]["reproduces"][0]["effect"], "creep");
    assert_eq!(json["rows"]["all"], 3600);
}

#[test]
fn an_axis_above_its_floor_is_named_where_all_together_are_at_it() {
    let mut diagnosis = full();
    let last = diagnosis.staircase.last_mut().unwrap();
    last.held_out_rms_g = 1.1 * last.floor_g;
    diagnosis.is_complete = true;
    diagnosis.worst_axis = Some(WorstAxis { sensor: 2, axis: "y", floors: 1.72 });
    let expected =
        "Structure remains: sensor 2 y has 1.72 times its floor, all axes together 1.10 times";
    assert!(verdict(&diagnosis).contains(expected), "{}", verdict(&diagnosis));
    diagnosis.at_floor = true;
    assert!(verdict(&diagnosis).contains("at the noise floor"), "{}", verdict(&diagnosis));
}

#[test]
fn each_verdict_on_one_recording_requests_two_more() {
    let requests = |recordings: [usize; 2]| {
        let page = uncolored(&Diagnosis { recordings, ..full() });
        let words: Vec<&str> = page.split_whitespace().collect();
        words.join(" ").matches("One recording: no claim about others; record two more.").count()
    };
    // Three accepted effects, and the conclusion.
    assert_eq!(requests([1, 1]), 4);
    assert_eq!(requests([3, 3]), 0);
}

#[test]
fn dropped_steps_are_listed_with_their_reason() {
    let dropped = |step: &str, reason| DroppedStep { step: step.to_owned(), gain: 0.021, reason };
    let mut diagnosis = full();
    assert!(!uncolored(&diagnosis).contains("Dropped"));
    diagnosis.dropped = vec![
        dropped("creep", DropReason::NotOnAllRows),
        dropped("hysteresis", DropReason::Replaced),
    ];
    let page = unwrapped(&uncolored(&diagnosis));
    let expected = "Dropped: creep (gain 2.1 % when it was accepted): it lowers the error of all rows by too little, or not in \
                    every fold. Dropped: hysteresis (gain 2.1 % when it was accepted): formulas leave less, or as much with \
                    fewer terms.";
    assert!(page.contains(expected), "{page}");
    assert_eq!(to_json(&diagnosis)["dropped"][1]["reason"], "replaced");
}

#[test]
fn report_states_accepted_equivalent_and_open_effects() {
    let page = uncolored(&full());
    assert!(page.ends_with("\n  cargo magpie add model.toml 'my <b>' hysteresis -o new.toml\n"));
    let page = unwrapped(&page);
    for part in [
        "hysteresis: 7.982±0.010 N, friction force",
        "typical is 2.5 N Where the finger rubs on a guide",
        "It reduces the held-out squared error by 99.4 %.",
        "Equivalent on these data: magnet_temperature, sensor_temperature",
        "To separate them, record, for magnet_temperature: Warm the gripper by 10 K",
        "To separate them, record, for sensor_temperature: Warm and cool the unloaded",
        "tip_slope, geometric_stiffening: not detectable here. Record: Load each flexure",
        "earth_field: roll_rad was not recorded. Record: Rotate the unloaded",
        "thermal_gap: it acts on the magnet, which a polynomial",
        "UNEXPLAINED: 84 % of the residual follows the rotor angle (motor_angle_rad)",
        "--expr",
    ] {
        assert!(page.contains(part), "{part}: {page}");
    }
    assert!(!page.contains("AT NOISE FLOOR") && !page.contains("A question mark"), "{page}");
    let user_defined = verdict_of("my_own", VerdictKind::Found, Reason::ReducesError);
    assert_eq!(magnitude(&user_defined), "");
    // The mean of sensors that differ describes none of them.
    let skew = verdict_of("clock_skew", VerdictKind::Found, Reason::ReducesError);
    let (value, differs) = (1.03, Some([0.002, 1.941]));
    let skew = Verdict { value, std_error: 0.97, differs, unit: "ms".to_owned(), ..skew };
    assert_eq!(magnitude(&skew), "0.00 to 1.94 ms by sensor, field after force; typical is 5 ms");
}

#[test]
fn report_states_the_noise_floor_and_provisional_verdicts() {
    let mut diagnosis = Diagnosis { at_floor: true, ..full() };
    diagnosis.verdicts[0].provisional = true;
    let page = unwrapped(&uncolored(&diagnosis));
    for part in ["AT NOISE FLOOR with what was found", " FOUND? ", "A question mark: provisional"] {
        assert!(page.contains(part), "{part}: {page}");
    }
    assert!(!page.contains("UNEXPLAINED"));
}

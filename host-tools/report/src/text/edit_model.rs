//! Text and JSON of a model with other effects.

use crate::text::comparison::conclusion::dependent_blocks;
use crate::text::comparison::decimals;
use analysis::compare::{AT_FLOOR, EffectOrigin};
use analysis::diagnose::ConfoundedOffsets;
use analysis::diagnose::fitted_model::MIN_GAIN;
use analysis::edit_model::ModelEdit;
use analysis::numbers;
use analysis::parameters::ParameterTable;
use model_export::effects::EffectTerm;
use model_export::effects::catalogue::CLOCK_SKEW;
use model_export::fit::cross_validation::{CvSplit, ErrorSums};
use model_export::fit::effect_size::EffectSize;
use model_export::fit::joint::JointFit;
use model_export::model_file::EffectModel;
use serde_json::{Value, json};

use crate::text::diagnosis::conclusion::confounded_offsets;
use crate::text::terminal::{self, SENSORS_ACROSS};
use crate::text::{force_error, notes, parameters};

/// A residual above this multiple of the floor may mask an effect.
const MASKING_RESIDUAL: f64 = 1.5;
/// A smaller reduction of the error is doubtful if the magnitude is implausible.
const WEAK_REDUCTION: f64 = 0.05;

pub fn format_report(edit: &ModelEdit) -> String {
    format!(
        "{}\n{}\n{}{}{}",
        effect_table(edit),
        parameter_table(&edit.model.effects, &edit.sizes),
        error_table(edit),
        force_sentence(edit),
        terminal::paragraph(&verdict(edit)) + &clock_sentence(edit),
    )
}

/// What to do about a skew of the reference's clock: a model with it corrects the field, and no force.
fn clock_sentence(edit: &ModelEdit) -> String {
    let mut effects = edit.model.effects.iter().zip(&edit.sizes);
    let Some((_, size)) = effects.find(|(effect, _)| effect.name == CLOCK_SKEW.id) else {
        return String::new();
    };
    terminal::paragraph(&format!(
        "{} is a difference of two clocks, which no device needs to compensate. Align the clocks instead: `cargo magpie fit` with \
         --delay-ms {:.2}, in addition to a delay that was given.",
        CLOCK_SKEW.id, size.value
    ))
}

/// Estimated and typical magnitude of each effect.
fn effect_table(edit: &ModelEdit) -> String {
    if edit.sizes.is_empty() {
        return "The model has no effects.\n".to_owned();
    }
    let mut table =
        terminal::table(["effect", "magnitude", "unit", "of", "typical", "plausible", ""]);
    for (effect, size) in edit.model.effects.iter().zip(&edit.sizes) {
        let scale =
            if size.size.typical.is_finite() { size.size.typical.abs() } else { size.value.abs() };
        let (low, high) = size.size.plausible;
        let number = |value: f64| numbers::decimal_or_dash(value, 3);
        let remark = match (
            size.is_possible(),
            size.is_plausible(),
            size.value.abs() < 2.0 * size.std_error && size.extremes.is_none(),
        ) {
            (_, _, true) => "not significant (2 standard errors)",
            (false, ..) => "impossible: a proxy for another effect",
            (true, false, _) => "implausible",
            (true, true, _) => "",
        };
        table.add_row([
            effect.name.clone(),
            match size.differs() {
                Some(differs) => format!("{} by sensor", numbers::between(differs)),
                None => numbers::with_error(size.value, size.std_error, scale),
            },
            size.unit.to_string(),
            effect.quantity.clone(),
            number(size.size.typical),
            if low.is_finite() {
                format!("{} to {}", number(low), number(high))
            } else {
                "-".to_owned()
            },
            remark.to_owned(),
        ]);
    }
    format!("Effects over all sensors ± one standard deviation\n{table}\n")
}

/// Parameters of every effect and sensor, without initial states: those do not describe the gripper.
fn parameter_table(effects: &[EffectModel], sizes: &[EffectSize]) -> String {
    let mut text = String::new();
    let mut is_any_impossible = false;
    let Some(first) = effects.first() else {
        return text;
    };
    let numbers: Vec<u32> = first.sensors.iter().map(|sensor| sensor.number).collect();
    for numbers in numbers.chunks(SENSORS_ACROSS) {
        let heads = numbers.iter().map(|number| format!("sensor {number}"));
        let mut table = terminal::table(["parameter".to_owned()].into_iter().chain(heads));
        for (effect, size) in effects.iter().zip(sizes) {
            let sensors =
                || effect.sensors.iter().filter(|sensor| numbers.contains(&sensor.number));
            let Some(first) = sensors().next() else {
                continue;
            };
            table.add_row([effect.name.clone()]);
            for (name, value) in
                first.parameters.iter().filter(|(name, _)| !name.starts_with("begin"))
            {
                let shown = sensors().map(|sensor| match sensor.parameters.get(name) {
                    Some(value) => {
                        let is_impossible =
                            !size.allows_coefficient(value.value, value.std_error, &value.unit);
                        is_any_impossible |= is_impossible && value.identifiable;
                        let mark = match (value.identifiable, is_impossible) {
                            (false, _) => "?",
                            (true, true) => "!",
                            (true, false) => "",
                        };
                        numbers::with_error(value.value, value.std_error, value.value.abs()) + mark
                    }
                    None => String::new(),
                });
                let words = [format!("  {name} {}", value.unit)];
                table.add_row(words.into_iter().chain(shown).collect::<Vec<_>>());
            }
        }
        terminal::right_align(&mut table, 1);
        text += &format!("{table}\n");
    }
    if is_any_impossible {
        text += "!: physically impossible by more than two standard errors: a part of another effect.\n";
    }
    text + "Errors of parameters are from blocks of time alone. ?: not identifiable from these recordings.\n"
}

fn signal_unit(edit: &ModelEdit) -> &'static str {
    edit.campaign.signal_unit().symbol()
}

fn digits(edit: &ModelEdit) -> usize {
    let scores = edit.after.1.sensors.iter().flat_map(|sensor| &sensor.scores);
    decimals(scores.map(|score| score.floor_g)).max(4)
}

/// Held-out error of each axis before and after.
fn error_table(edit: &ModelEdit) -> String {
    let unit = signal_unit(edit);
    let digits = digits(edit);
    let mut table = terminal::table([
        "sensor",
        "axis",
        &format!("before {unit}"),
        &format!("after {unit}"),
        &format!("floor {unit}"),
        "after / floor",
        "% of range",
    ]);
    let (before, after) = (&edit.before.1, &edit.after.1);
    let scores =
        |fit: &JointFit| fit.sensors.iter().flat_map(|s| s.scores.clone()).collect::<Vec<_>>();
    for (old, new) in scores(before).iter().zip(&scores(after)) {
        table.add_row([
            new.sensor.to_string(),
            new.axis.letter().to_owned(),
            format!("{:.digits$}", old.held_out_rms_g),
            format!("{:.digits$}", new.held_out_rms_g),
            format!("{:.digits$}", new.floor_g),
            format!("{:.3}", new.held_out_rms_g / new.floor_g),
            format!("{:.3}", 100.0 * new.held_out_rms_g / new.span_g),
        ]);
    }
    terminal::right_align(&mut table, 2);
    let how = match after.split {
        CvSplit::Recordings(_) => "cross-validated by recording".to_owned(),
        CvSplit::KFold if edit.campaign.recordings.len() == 1 => {
            "cross-validated on sixths of the only recording: no claim beyond it".to_owned()
        }
        CvSplit::Interleaved { block_ms } => format!(
            "cross-validated on interleaved blocks of {} s: an effect is transient within recordings",
            numbers::decimal(1e-3 * f64::from(block_ms), 3)
        ),
        CvSplit::Blocks { block_ms, .. } => {
            format!("cross-validated; {}", dependent_blocks(block_ms))
        }
        CvSplit::KFold => {
            "cross-validated on sixths of every recording: an effect is specific to recordings"
                .to_owned()
        }
    };
    format!("Held-out field error, {how}\n{table}\n{}", summary(edit))
}

/// Total error before and after.
fn summary(edit: &ModelEdit) -> String {
    let (old, new) = (edit.before.1.tally(), edit.after.1.tally());
    let (improved, folds) = improved_folds(edit);
    let (unit, digits) = (signal_unit(edit), digits(edit));
    terminal::paragraph(&format!(
        "Field, all channels: {:.digits$} {unit} → {:.digits$} {unit}, floor {:.digits$} {unit}. Lower in {} of {} folds.",
        old.mean_square().sqrt(),
        new.mean_square().sqrt(),
        new.floor_g(),
        improved,
        folds,
    ))
}

/// What of the force error is not of the device's model.
fn force_origins(edit: &ModelEdit) -> Vec<String> {
    let origins = EffectOrigin::of(&edit.model.effects);
    edit.force.map_or_else(Vec::new, |[_, after]| force_error::origins(&after, &origins))
}

/// The force error before and after, and whether the device compensates the effects.
fn force_sentence(edit: &ModelEdit) -> String {
    let device = edit.device.iter().map(notes::device_support);
    let lines = edit.force.iter().map(|[before, after]| force_error::change(before, after));
    let lines = lines.chain(force_origins(edit)).chain(device);
    lines.map(|line| terminal::paragraph(&line)).collect()
}

/// Number of folds with a lower error after the edit, and of all folds.
fn improved_folds(edit: &ModelEdit) -> (usize, usize) {
    let (old, new) = (edit.before.1.folds(), edit.after.1.folds());
    let improved = old.iter().zip(&new).filter(|(old, new)| new.mean_square() < old.mean_square());
    (improved.count(), new.len())
}

/// Change of the error, and what these recordings leave unidentifiable.
fn verdict(edit: &ModelEdit) -> String {
    let confounded = ConfoundedOffsets::of(&edit.campaign, &edit.after.1);
    let sentences = [Some(gain(edit)), confounded.as_ref().map(confounded_offsets)];
    sentences.into_iter().flatten().collect::<Vec<_>>().join(" ")
}

fn gain(edit: &ModelEdit) -> String {
    let rms = |tally: ErrorSums| tally.mean_square().sqrt();
    let (old, new) = (rms(edit.before.1.tally()), rms(edit.after.1.tally()));
    let floor = edit.after.1.tally().floor_g();
    let reduction = 1.0 - new / old;
    let adding = edit.after.0.len() >= edit.before.0.len();
    let names = |fit: &[EffectTerm], other: &[EffectTerm]| {
        let names: Vec<&str> =
            fit.iter().filter(|e| !other.contains(e)).map(|e| e.name()).collect();
        names.join(" and ")
    };
    if !adding {
        let removed = names(&edit.before.0, &edit.after.0);
        return if (new / old).powi(2) > 1.0 + MIN_GAIN {
            format!("Without {removed} the error is {:.1} % higher.", -100.0 * reduction)
        } else {
            format!(
                "Without {removed} the error is not higher: these recordings do not require it."
            )
        };
    }
    let added = names(&edit.after.0, &edit.before.0);
    if 1.0 - (new / old).powi(2) <= MIN_GAIN {
        let reason = if new > MASKING_RESIDUAL * floor {
            format!("The residual, {:.1} times the floor, may mask {added}", new / floor)
        } else {
            format!("{added} is not significant in these recordings")
        };
        return format!(
            "Nothing gained: the held-out error changes by {:+.2} %. {reason}.",
            -100.0 * reduction
        );
    }
    let (improved, folds) = improved_folds(edit);
    let is_significant = |size: &EffectSize| size.value.abs() >= 2.0 * size.std_error;
    let is_new = |effect: &EffectTerm| !edit.before.0.contains(effect);
    let pairs = edit.after.0.iter().zip(&edit.sizes);
    let doubts: Vec<String> = pairs
        .filter(|(effect, size)| is_new(effect) && !(is_significant(size) && size.is_plausible()))
        .map(|(effect, size)| match (is_significant(size), size.is_possible()) {
            (false, _) => format!("the magnitude of {} is not significant", effect.name()),
            (true, true) => format!("the magnitude of {} is implausible", effect.name()),
            (true, false) => format!("the magnitude of {} is impossible", effect.name()),
        })
        .collect();
    if improved < folds || (!doubts.is_empty() && reduction < WEAK_REDUCTION) {
        let doubts: String = doubts.iter().map(|doubt| format!("; {doubt}")).collect();
        return format!(
            "Doubtful: with {added} the error decreases by {:.1} %, in {improved} of {folds} folds{doubts}. Another effect may be missing.",
            100.0 * reduction
        );
    }
    let ratio = new / floor;
    let remainder = if ratio <= AT_FLOOR {
        format!("to the noise floor ({ratio:.2} times the floor)")
    } else {
        format!("but is still {ratio:.1} times the floor: another effect is missing")
    };
    let force = edit.force.filter(|_| ratio <= AT_FLOOR);
    let force = force.and_then(|[_, after]| force_error::larger_excess(&after));
    let force = force.map_or_else(String::new, |excess| format!(" {excess}"));
    format!(
        "With {added} the error of the field decreases by {:.1} % {remainder}.{force}",
        100.0 * reduction
    )
}

pub fn to_json(edit: &ModelEdit) -> Value {
    let side = |fit: &JointFit| {
        let tally = fit.tally();
        json!({
            "held_out_rms_g": tally.mean_square().sqrt(),
            "parts_rms_g": fit.folds().iter().map(|fold| fold.mean_square().sqrt()).collect::<Vec<_>>(),
            "axes": fit.sensors.iter().flat_map(|s| &s.scores).map(|score| json!({
                "sensor": score.sensor, "axis": score.axis.letter(),
                "held_out_rms_g": score.held_out_rms_g, "floor_g": score.floor_g, "span_g": score.span_g,
            })).collect::<Vec<_>>(),
        })
    };
    let effects = edit.model.effects.iter().zip(&edit.sizes).map(|(effect, size)| {
        json!({
            "effect": effect.name, "value": effect.value, "std_error": effect.std_error, "unit": effect.unit,
            "means": effect.quantity, "plausible": size.is_plausible(), "possible": size.is_possible(),
            "differs": size.differs(),
            "sensors": effect.sensors,
        })
    });
    let mut object = json!({
        "before": side(&edit.before.1),
        "after": side(&edit.after.1),
        "floor_g": edit.after.1.tally().floor_g(),
        "effects": effects.collect::<Vec<_>>(),
        "force": edit.force.map(|[before, after]| json!({ "before": before, "after": after })),
        "force_origins": force_origins(edit),
        "device": edit.device,
        "uncompensated": edit.uncompensated.iter().map(notes::uncompensated).collect::<Vec<_>>(),
        "verdict": verdict(edit),
        "notices": notes::texts(&edit.notes),
    });
    parameters::add_json(&mut object, &ParameterTable::of(&edit.model));
    object
}

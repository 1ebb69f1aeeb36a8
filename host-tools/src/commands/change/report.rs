//! What `magpie add` and `magpie drop` show.

use model_export::effects::Addition;
use model_export::fit::folds::Split;
use model_export::fit::joint::JointFit;
use model_export::fit::score::Tally;
use model_export::fit::size::EffectSize;
use model_export::model_file::EffectModel;
use model_export::recordings::attitude::ANGLES;
use serde_json::{Value, json};

use super::Change;
use crate::show;

/// A change of the held-out error below this share is none.
const NO_CHANGE: f64 = 0.005;
/// While more than this many times the floor is left, an effect may be there and not be seen.
const HIDDEN: f64 = 1.5;
/// A fall below this share proves little where the size is odd.
const LITTLE: f64 = 0.05;
/// Held-out error up to this factor of the floor counts as being at it.
const AT_FLOOR: f64 = 1.15;
/// Sensors side by side in one table.
const SENSORS_ACROSS: usize = 4;

/// The page.
pub fn text(change: &Change) -> String {
    format!(
        "{}\n{}\n{}{}{}",
        effects(change),
        parameters(&change.model.effects),
        errors(change),
        device(change).unwrap_or_default(),
        show::paragraph(&verdict(change)),
    )
}

/// Each effect's size beside what is typical.
pub fn effects(change: &Change) -> String {
    if change.sizes.is_empty() {
        return "No effects are left beside the base.\n".to_owned();
    }
    let mut table = show::table(["effect", "size", "unit", "what", "typical", "plausible", ""]);
    for (effect, size) in change.model.effects.iter().zip(&change.sizes) {
        let scale = if size.size.typical.is_finite() {
            size.size.typical.abs()
        } else {
            size.value.abs()
        };
        let (low, high) = size.size.plausible;
        let number = |value: f64| {
            if value.is_finite() {
                show::plain(value, 3)
            } else {
                "-".to_owned()
            }
        };
        let remark = match (
            size.is_possible(),
            size.is_plausible(),
            size.value.abs() < 2.0 * size.std_error,
        ) {
            (_, _, true) => "within two error bars of none",
            (false, ..) => "not possible: it stands for something else",
            (true, false, _) => "unusual",
            (true, true, _) => "",
        };
        table.add_row([
            effect.name.clone(),
            show::with_error(size.value, size.std_error, scale),
            size.size.unit.to_owned(),
            effect.means.clone(),
            number(size.size.typical),
            if low.is_finite() {
                format!("{} to {}", number(low), number(high))
            } else {
                "-".to_owned()
            },
            remark.to_owned(),
        ]);
    }
    format!("Effects, each over all sensors ± one standard deviation\n{table}\n")
}

/// Every parameter of every effect.
fn parameters(effects: &[EffectModel]) -> String {
    let mut text = String::new();
    let Some(first) = effects.first() else {
        return text;
    };
    let numbers: Vec<u32> = first.sensors.iter().map(|sensor| sensor.number).collect();
    for numbers in numbers.chunks(SENSORS_ACROSS) {
        let heads = numbers.iter().map(|number| format!("sensor {number}"));
        let mut table = show::table(["parameter".to_owned()].into_iter().chain(heads));
        for effect in effects {
            let sensors = || {
                effect
                    .sensors
                    .iter()
                    .filter(|sensor| numbers.contains(&sensor.number))
            };
            let Some(first) = sensors().next() else {
                continue;
            };
            table.add_row([effect.name.clone()]);
            for (name, value) in first
                .parameters
                .iter()
                .filter(|(name, _)| !is_beginning(name))
            {
                let shown = sensors().map(|sensor| match sensor.parameters.get(name) {
                    Some(value) => {
                        let mark = if value.identifiable { "" } else { "?" };
                        show::with_error(value.value, value.std_error, value.value.abs()) + mark
                    }
                    None => String::new(),
                });
                let words = [format!("  {name} {}", value.unit)];
                table.add_row(words.into_iter().chain(shown).collect::<Vec<_>>());
            }
        }
        show::right_align(&mut table, 1);
        text += &format!("{table}\n");
    }
    text + "?: not told by these recordings.\n"
}

/// Where a memory began tells nothing about the gripper: that stays in the file.
fn is_beginning(name: &str) -> bool {
    name.starts_with("begin")
}

/// The error of each axis before and after.
fn errors(change: &Change) -> String {
    let mut table = show::table([
        "sensor",
        "axis",
        "before G",
        "after G",
        "floor G",
        "after / floor",
        "share of range",
    ]);
    let (before, after) = (&change.before.1, &change.after.1);
    let scores = |fit: &JointFit| {
        fit.sensors
            .iter()
            .flat_map(|s| s.scores.clone())
            .collect::<Vec<_>>()
    };
    for (old, new) in scores(before).iter().zip(&scores(after)) {
        table.add_row([
            new.sensor.to_string(),
            new.axis.letter().to_owned(),
            format!("{:.4}", old.held_out_rms_g),
            format!("{:.4}", new.held_out_rms_g),
            format!("{:.4}", new.floor_g),
            format!("{:.3}", new.held_out_rms_g / new.floor_g),
            format!("{:.3} %", 100.0 * new.held_out_rms_g / new.span_g),
        ]);
    }
    show::right_align(&mut table, 2);
    let how = match after.split {
        Split::Recordings(_) => "on each recording in turn, kept out of the fit",
        Split::Sixths if change.campaign.recordings.len() == 1 => {
            "on sixths kept out in turn; one recording: no claim beyond it"
        }
        Split::Comb => {
            "on every sixth quarter of a second in turn, since an effect happens within single recordings"
        }
        Split::Sixths => {
            "on sixths of every recording in turn, since an effect lives within single recordings"
        }
    };
    format!("Held-out field error, {how}\n{table}\n{}", summary(change))
}

/// The error over everything, before and after.
pub fn summary(change: &Change) -> String {
    let (old, new) = (change.before.1.tally(), change.after.1.tally());
    let wins = wins(change);
    let newtons = match (old.rmse_n(), new.rmse_n()) {
        (Some(old), Some(new)) => format!(" ({old:.3} N -> {new:.3} N, taken for forces)"),
        _ => String::new(),
    };
    show::paragraph(&format!(
        "Together: {:.4} G -> {:.4} G{newtons}, floor {:.4} G. Lower in {} of {} parts kept out.",
        old.mean_square().sqrt(),
        new.mean_square().sqrt(),
        new.floor_g(),
        wins.0,
        wins.1,
    ))
}

/// The forces by the device's own code.
fn device(change: &Change) -> Option<String> {
    let device = change.device.as_ref()?;
    let how = if device.held_out {
        "both models fitted anew without it"
    } else {
        "which both models were fitted to"
    };
    let left: String = device
        .left
        .iter()
        .map(|line| show::paragraph(&format!("  {line}")))
        .collect();
    let told = format!(
        "Through the device's fixed-point code, recording {}, {how}: {:.3} N -> {:.3} N RMSE.",
        device.recording, device.before_rmse_n, device.after_rmse_n
    );
    Some(show::paragraph(&told) + &left)
}

/// Parts kept out in which the error fell, and parts.
fn wins(change: &Change) -> (usize, usize) {
    let (old, new) = (change.before.1.folds(), change.after.1.folds());
    let fell = old
        .iter()
        .zip(&new)
        .filter(|(old, new)| new.mean_square() < old.mean_square());
    (fell.count(), new.len())
}

/// What the change did, in words, and what these recordings do not tell.
pub fn verdict(change: &Change) -> String {
    let words = [Some(gain(change)), confusion(change)];
    words.into_iter().flatten().collect::<Vec<_>>().join(" ")
}

/// Offset and Earth's field, where they cannot be told apart.
fn confusion(change: &Change) -> Option<String> {
    let sensors: Vec<String> = (change.after.1.sensors.iter())
        .filter(|fit| fit.offset_is_open)
        .map(|fit| fit.sensor.to_string())
        .collect();
    if sensors.is_empty() {
        return None;
    }
    let turned = ANGLES.map(|name| {
        let values = || (change.campaign.recordings.iter()).filter_map(|r| r.covariates.get(name));
        let low = values().flatten().copied().fold(f64::INFINITY, f64::min);
        let high = values()
            .flatten()
            .copied()
            .fold(f64::NEG_INFINITY, f64::max);
        (high - low).to_degrees()
    });
    Some(format!(
        "The offset of sensor {} and the Earth's field cannot be told apart in these recordings (roll moved by {:.0}, pitch by {:.0}, yaw by {:.0} degrees): the offset is kept near zero, as far as a plausible one goes. Turn the gripper further, at least 90 degrees about two axes.",
        sensors.join(", "),
        turned[0],
        turned[1],
        turned[2],
    ))
}

/// What the change did to the error.
fn gain(change: &Change) -> String {
    let rms = |tally: Tally| tally.mean_square().sqrt();
    let (old, new) = (rms(change.before.1.tally()), rms(change.after.1.tally()));
    let floor = change.after.1.tally().floor_g();
    let fall = 1.0 - new / old;
    let adding = change.after.0.len() >= change.before.0.len();
    let names = |fit: &[Addition], other: &[Addition]| {
        let names: Vec<&str> = fit
            .iter()
            .filter(|e| !other.contains(e))
            .map(|e| e.name())
            .collect();
        names.join(" and ")
    };
    if !adding {
        let dropped = names(&change.before.0, &change.after.0);
        return match -fall > NO_CHANGE {
            true => format!(
                "Without {dropped} the error is {:.1} % higher.",
                -100.0 * fall
            ),
            false => format!(
                "Without {dropped} the error is no higher: these recordings do not need it."
            ),
        };
    }
    let added = names(&change.after.0, &change.before.0);
    if fall <= NO_CHANGE {
        let shown = match floor {
            floor if new > HIDDEN * floor => format!(
                "What else is left, {:.1} times the floor, may hide {added}",
                new / floor
            ),
            _ => format!("These recordings do not show {added}"),
        };
        return format!(
            "Nothing gained: on what was kept out the error changes by {:+.2} %. {shown}.",
            -100.0 * fall
        );
    }
    let (lower, parts) = wins(change);
    let told = |size: &EffectSize| size.value.abs() >= 2.0 * size.std_error;
    let is_new = |effect: &Addition| !change.before.0.contains(effect);
    let pairs = change.after.0.iter().zip(&change.sizes);
    let doubts: Vec<String> = pairs
        .filter(|(effect, size)| is_new(effect) && !(told(size) && size.is_plausible()))
        .map(|(effect, size)| match (told(size), size.is_possible()) {
            (false, _) => format!("the size of {} cannot be told from none", effect.name()),
            (true, true) => format!("the size of {} is unusual", effect.name()),
            (true, false) => format!("the size of {} is not possible", effect.name()),
        })
        .collect();
    if lower < parts || (!doubts.is_empty() && fall < LITTLE) {
        let doubts: String = doubts.iter().map(|doubt| format!("; {doubt}")).collect();
        return format!(
            "Doubtful: with {added} the error falls by {:.1} %, in {lower} of {parts} parts kept out{doubts}. Something else may be missing.",
            100.0 * fall
        );
    }
    let times = new / floor;
    let rest = match times <= AT_FLOOR {
        true => format!("and is at the noise floor ({times:.2} times it)"),
        false => format!("and is still {times:.1} times the floor: something else is missing"),
    };
    format!(
        "With {added} the error falls by {:.1} % {rest}.",
        100.0 * fall
    )
}

/// The object of `--json`.
pub fn json(change: &Change) -> Value {
    let side = |fit: &JointFit| {
        let tally = fit.tally();
        json!({
            "held_out_rms_g": tally.mean_square().sqrt(), "rmse_n": tally.rmse_n(),
            "parts_rms_g": fit.folds().iter().map(|fold| fold.mean_square().sqrt()).collect::<Vec<_>>(),
            "axes": fit.sensors.iter().flat_map(|s| &s.scores).map(|score| json!({
                "sensor": score.sensor, "axis": score.axis.letter(),
                "held_out_rms_g": score.held_out_rms_g, "floor_g": score.floor_g, "span_g": score.span_g,
            })).collect::<Vec<_>>(),
        })
    };
    let effects = change.model.effects.iter().zip(&change.sizes).map(|(effect, size)| {
        json!({
            "effect": effect.name, "value": effect.value, "std_error": effect.std_error, "unit": effect.unit,
            "means": effect.means, "plausible": size.is_plausible(), "possible": size.is_possible(),
            "sensors": effect.sensors,
        })
    });
    json!({
        "before": side(&change.before.1),
        "after": side(&change.after.1),
        "floor_g": change.after.1.tally().floor_g(),
        "effects": effects.collect::<Vec<_>>(),
        "device": change.device,
        "verdict": verdict(change),
        "notices": change.notices,
    })
}

//! What `magpie fit` shows: tables for people, one object for machines.

use model_export::fit::parameters::{PARAMETERS, tolerances, values};
use model_export::fit::polynomial::PolynomialFit;
use model_export::fit::score::pooled_rms;
use model_export::fit::{Fits, Options};
use model_export::model_file::{Base, Held, HeldOut, ModelFile, SensorModel};
use model_export::physics::ForwardModel;
use model_export::recordings::{Campaign, Notice};
use serde_json::{Value, json};

use crate::show;

/// Held-out error up to this factor of the floor counts as being at it.
const AT_FLOOR: f64 = 1.15;

/// A parameter this many tolerances from nominal is marked: the unit or the design may be wrong.
const FAR: f64 = 3.0;

/// Sensors side by side in one table.
const SENSORS_ACROSS: usize = 4;

/// The whole page.
pub fn text(campaign: &Campaign, model: &ModelFile, fits: &Fits) -> String {
    let provenance = &model.provenance;
    let base = match fits {
        Fits::Cylinder(..) => parameters(model) + &held(model),
        Fits::Polynomial(fits) => degrees(fits),
    };
    format!(
        "{}: {} recordings, {:.1} s, {} rows; the field is averaged over ±{:.2} ms around each\n\
         reference row (delay {} ms).\n\n{base}\n{}{}\n\
         Error bars: block bootstrap, {} draws, seed {}, blocks of {} s.\n",
        provenance.campaign,
        campaign.recordings.len(),
        campaign.duration_s(),
        provenance.rows,
        provenance.half_window_ms,
        provenance.delay_ms,
        scores(campaign, model),
        verdict(model),
        Options::default().draws,
        provenance.seed,
        show::plain(longest_block_s(fits), 1),
    )
}

/// The longest block among the sensors: how long their residuals remember.
fn longest_block_s(fits: &Fits) -> f64 {
    let lengths: Vec<f64> = match fits {
        Fits::Cylinder(_, fit) => fit.sensors.iter().map(|fit| fit.block_s).collect(),
        Fits::Polynomial(fits) => fits.iter().map(|fit| fit.block_s).collect(),
    };
    lengths.into_iter().fold(0.0, f64::max)
}

/// Every parameter of every sensor.
pub fn parameters(model: &ModelFile) -> String {
    let Some(design) = &model.design else {
        return String::new();
    };
    let nominal = ForwardModel::nominal(design);
    let (nominals, tolerances) = (values(&nominal), tolerances(&nominal));
    let mut text = "Fitted parameters ± one standard deviation, beside the nominal design and the tolerance (assumed\n\
                    manufacturing scatter). ?: not told to half a tolerance. !: over 3 tolerances off, check design.\n"
        .to_owned();
    for sensors in model.sensors.chunks(SENSORS_ACROSS) {
        let numbers = sensors
            .iter()
            .map(|sensor| format!("sensor {}", sensor.number));
        let words = ["parameter", "nominal", "tol."].map(String::from);
        let mut table = show::table(words.into_iter().chain(numbers));
        for (i, parameter) in PARAMETERS.iter().enumerate() {
            let fitted = sensors.iter().map(|sensor| {
                let value = sensor.parameters.get(parameter.name);
                value.map_or_else(String::new, |value| {
                    let shown = show::with_error(value.value, value.std_error, tolerances[i]);
                    let far = (value.value - nominals[i]).abs() > FAR * tolerances[i];
                    shown
                        + match (value.identifiable, far) {
                            (false, _) => "?",
                            (true, true) => "!",
                            (true, false) => "",
                        }
                })
            });
            let words = [
                format!("{} {}", parameter.name, parameter.unit),
                show::plain(nominals[i], 3),
                show::plain(tolerances[i], 3),
            ];
            table.add_row(words.into_iter().chain(fitted).collect::<Vec<_>>());
        }
        show::right_align(&mut table, 1);
        text += &format!("{table}\n");
    }
    text
}

/// The combinations of parameters that were held at nominal.
fn held(model: &ModelFile) -> String {
    let mut text = String::new();
    if model.sensors.iter().any(|sensor| !sensor.held.is_empty()) {
        text += "Combinations that cannot be told apart, held at nominal while their members move (shares in\n\
                 tolerances; in brackets to how many tolerances the data alone know each):\n";
    }
    for sensor in model
        .sensors
        .iter()
        .filter(|sensor| !sensor.held.is_empty())
    {
        let held: Vec<String> = sensor.held.iter().map(combination).collect();
        // Two fit in a line.
        let lines: Vec<String> = held.chunks(2).map(|pair| pair.join("; ")).collect();
        text += &format!(
            "  sensor {}: {}\n",
            sensor.number,
            lines.join("\n            ")
        );
    }
    text
}

fn combination(held: &Held) -> String {
    let mut shares: Vec<_> = held.shares.iter().collect();
    shares.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
    let shares: Vec<String> = shares
        .iter()
        .map(|(name, share)| format!("{share:+.2} {name}"))
        .collect();
    let known = match held.known_within {
        little if little < 100.0 => format!("{little:.1}"),
        _ => "not at all".to_owned(),
    };
    format!("{} ({known})", shares.join(" "))
}

fn degrees(fits: &[PolynomialFit]) -> String {
    let Some(first) = fits.first() else {
        return String::new();
    };
    let tried = first
        .tried
        .iter()
        .map(|(degree, _)| format!("degree {degree}"));
    let words = ["sensor", "forces", "taken"].map(String::from);
    let mut table = show::table(words.into_iter().chain(tried));
    for fit in fits {
        let forces: Vec<String> = fit
            .model
            .forces
            .iter()
            .map(|(place, axis)| format!("f{place}_{}", axis.letter()))
            .collect();
        let words = [
            fit.sensor.to_string(),
            forces.join(", "),
            fit.model.degree.to_string(),
        ];
        let errors = fit.tried.iter().map(|(_, rms)| format!("{rms:.4}"));
        table.add_row(words.into_iter().chain(errors).collect::<Vec<_>>());
    }
    show::right_align(&mut table, 2);
    format!("Held-out error in G by degree of the polynomial\n{table}\n")
}

/// Held-out error of every axis.
pub fn scores(campaign: &Campaign, model: &ModelFile) -> String {
    let how = match campaign.recordings.len() {
        1 => "on sixths kept out in turn; one recording: no claim beyond it",
        _ => "on each recording in turn, kept out of the fit",
    };
    let mut table = show::table([
        "sensor",
        "axis",
        "error G",
        "floor G",
        "error / floor",
        "explainable G",
        "share of range",
    ]);
    for (sensor, axis) in axes(model) {
        table.add_row([
            sensor.number.to_string(),
            axis.axis.clone(),
            format!("{:.4}", axis.rms_g),
            format!("{:.4}", axis.floor_g),
            format!("{:.3}", axis.rms_g / axis.floor_g),
            format!("{:.4}", axis.explainable_g()),
            format!("{:.3} %", 100.0 * axis.rms_g / axis.span_g),
        ]);
    }
    show::right_align(&mut table, 2);
    format!(
        "Held-out field error, {how}\n{table}\n\
         Root mean square over all {} channels: {:.4} G. Floor: the sensor's white noise after averaging and\n\
         the reference's noise through dB/dF, added in squares. Explainable: what error has beyond its floor,\n\
         in squares. Range: of the field in this campaign.\n",
        axes(model).count(),
        pooled_rms(axes(model).map(|(_, axis)| axis.rms_g)),
    )
}

fn axes(model: &ModelFile) -> impl Iterator<Item = (&SensorModel, &HeldOut)> {
    model
        .sensors
        .iter()
        .flat_map(|sensor| sensor.held_out.iter().map(move |axis| (sensor, axis)))
}

/// One line in words.
pub fn verdict(model: &ModelFile) -> String {
    let above = |axis: &HeldOut| axis.rms_g / axis.floor_g;
    let worst = axes(model).max_by(|a, b| above(a.1).total_cmp(&above(b.1)));
    let Some((sensor, axis)) = worst.filter(|(_, axis)| above(axis) > AT_FLOOR) else {
        let percent = 100.0 * (AT_FLOOR - 1.0);
        return format!(
            "At the noise floor: within {percent:.0} % of what noise alone would leave, on every axis."
        );
    };
    let where_ = format!(
        "Worst is sensor {} {}, {:.1} times its floor.",
        sensor.number,
        axis.axis,
        above(axis)
    );
    if axis.fitted_rms_g <= AT_FLOOR * axis.floor_g {
        return format!(
            "Too little data: at the floor where it was fitted, above it where it was not.\n{where_}"
        );
    }
    let why = match model.base {
        Base::Cylinder => "the base physics lacks an effect, or the two clocks disagree.",
        Base::Polynomial => {
            "the degree is too low, or the field depends on more than these forces."
        }
    };
    format!("Structure remains: {why}\n{where_}")
}

/// The object of `--json`.
pub fn json(model: &ModelFile, notices: &[Notice]) -> Value {
    let scores = axes(model).map(|(sensor, axis)| {
        json!({
            "sensor": sensor.number, "axis": axis.axis,
            "held_out_rms_g": axis.rms_g, "floor_g": axis.floor_g, "span_g": axis.span_g,
        })
    });
    let held = model.sensors.iter().flat_map(|sensor| {
        sensor.held.iter().map(|held| {
            // JSON has no infinity: null says that the data know nothing of it.
            let known_within = held.known_within.is_finite().then_some(held.known_within);
            json!({ "sensor": sensor.number, "shares": held.shares, "known_within": known_within })
        })
    });
    json!({
        "axes": scores.collect::<Vec<_>>(),
        "held_out_rms_g": pooled_rms(axes(model).map(|(_, axis)| axis.rms_g)),
        "parameters": model.sensors.iter().flat_map(parameters_json).collect::<Vec<_>>(),
        "held": held.collect::<Vec<_>>(),
        "verdict": verdict(model),
        "provenance": model.provenance,
        "notices": notices.iter().map(ToString::to_string).collect::<Vec<_>>(),
    })
}

fn parameters_json(sensor: &SensorModel) -> Vec<Value> {
    let number = sensor.number;
    let mut parameters = Vec::new();
    for (name, p) in &sensor.parameters {
        parameters.push(json!({
            "sensor": number, "name": name, "value": p.value, "std_error": p.std_error,
            "unit": p.unit, "identifiable": p.identifiable,
        }));
    }
    if let Some(table) = &sensor.polynomial {
        let rows = table
            .terms
            .iter()
            .zip(&table.coefficients_g)
            .zip(&table.std_errors_g);
        for ((term, values), errors) in rows {
            let powers = table.forces.iter().zip(term);
            let powers: Vec<String> = powers.map(|(force, n)| format!("P{n}({force})")).collect();
            for ((axis, value), error) in ["x", "y", "z"].iter().zip(values).zip(errors) {
                parameters.push(json!({
                    "sensor": number, "name": format!("{axis}: {}", powers.join(" ")),
                    "value": value, "std_error": error, "unit": "G", "identifiable": true,
                }));
            }
        }
    }
    parameters
}

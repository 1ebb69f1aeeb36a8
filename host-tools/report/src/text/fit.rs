//! Text and JSON of a fit.

use crate::text::comparison::conclusion::below_floor;
use crate::text::comparison::decimals;
use analysis::compare::{AT_FLOOR, BELOW_FLOOR, is_at_floor};
use analysis::fit::CampaignFit;
use analysis::noise_floor::NoiseSummary;
use analysis::numbers;
use analysis::parameters::ParameterTable;
use analysis::statistics::pooled_rms;
use model_export::fit::polynomial::PolynomialFit;
use model_export::fit::{CampaignFits, FitOptions};
use model_export::model_file::{BaseKind, HeldOutError, ModelFile, SensorModel};
use model_export::recordings::Campaign;
use model_export::recordings::columns::SignalUnit;
use model_export::recordings::dependence::block_folds;
use serde_json::{Value, json};

use crate::text::{force_error, notes, parameters, terminal};

pub fn format_report(fit: &CampaignFit) -> String {
    let CampaignFit { campaign, fits, model, force, .. } = fit;
    let provenance = &model.provenance;
    let base = match fits {
        CampaignFits::Cylinder(..) => parameters::format_report(&ParameterTable::of(model)),
        CampaignFits::Polynomial(fits) => degree_table(fits, campaign.signal_unit()),
    };
    format!(
        "{}: {} recordings, {:.1} s, {} rows; the field is averaged over ±{:.2} ms around each\n\
         reference row (delay {} ms).\n\n{base}\n{}{}{}\n\
         Error bars: block bootstrap, {} draws, seed {}, blocks of {} s.\n",
        provenance.campaign,
        campaign.recordings.len(),
        campaign.duration_s(),
        provenance.rows,
        provenance.half_window_ms,
        provenance.delay_ms,
        error_table(campaign, model),
        force.as_ref().map_or_else(String::new, |error| {
            terminal::paragraph(&force_error::headline(error))
                + &terminal::paragraph(force_error::TERMS)
        }),
        verdict(model, campaign.signal_unit()),
        FitOptions::default().draws,
        provenance.seed,
        numbers::decimal(longest_block_s(fits), 1),
    )
}

/// Maximum bootstrap block length over the sensors: the correlation time of their residuals.
fn longest_block_s(fits: &CampaignFits) -> f64 {
    let lengths: Vec<f64> = match fits {
        CampaignFits::Cylinder(_, fit) => fit.sensors.iter().map(|fit| fit.block_s).collect(),
        CampaignFits::Polynomial(fits) => fits.iter().map(|fit| fit.block_s).collect(),
    };
    lengths.into_iter().fold(0.0, f64::max)
}

fn degree_table(fits: &[PolynomialFit], unit: SignalUnit) -> String {
    let Some(first) = fits.first() else {
        return String::new();
    };
    let tried = first.tried.iter().map(|(degree, _)| format!("degree {degree}"));
    let headers = ["sensor", "forces", "degree"].map(String::from);
    let mut table = terminal::table(headers.into_iter().chain(tried));
    for fit in fits {
        let forces: Vec<String> = fit
            .model
            .forces
            .iter()
            .map(|(place, axis)| format!("f{place}_{}", axis.letter()))
            .collect();
        let digits = decimals(fit.tried.iter().map(|(_, rms)| *rms)).max(4);
        let labels = [fit.sensor.to_string(), forces.join(", "), fit.model.degree.to_string()];
        let errors = fit.tried.iter().map(|(_, rms)| format!("{rms:.digits$}"));
        table.add_row(labels.into_iter().chain(errors).collect::<Vec<_>>());
    }
    terminal::right_align(&mut table, 2);
    let compared = match first.tried.len() {
        0 | 1 => "",
        _ => ", without what is linear in the covariates",
    };
    format!(
        "Held-out error in {} by degree of the polynomial{compared};\nall sensors have the degree that one of them needs\n{table}\n",
        unit.symbol()
    )
}

/// Table of the held-out error of every axis.
pub fn error_table(campaign: &Campaign, model: &ModelFile) -> String {
    let how = match campaign.recordings.len() {
        1 => "cross-validated on sixths of the only recording: no claim beyond it",
        _ if block_folds(campaign).is_some() => {
            "cross-validated on blocks of time: the recordings are not independent, see the notes"
        }
        _ => "cross-validated by recording",
    };
    let noise = NoiseSummary::of(campaign.recordings.iter().map(|recording| &recording.noise));
    let unit = noise.unit.symbol();
    let digits = decimals(axes(model).map(|(_, axis)| axis.floor_g)).max(4);
    let mut table = terminal::table([
        "sensor",
        "axis",
        &format!("error {unit}"),
        &format!("floor {unit}"),
        "error / floor",
        &format!("explainable {unit}"),
        "% of range",
    ]);
    for (sensor, axis) in axes(model) {
        table.add_row([
            sensor.number.to_string(),
            axis.axis.clone(),
            format!("{:.digits$}", axis.rms_g),
            format!("{:.digits$}", axis.floor_g),
            format!("{:.3}", axis.rms_g / axis.floor_g),
            format!("{:.digits$}", axis.explainable_g()),
            format!("{:.3}", 100.0 * axis.rms_g / axis.span_g),
        ]);
    }
    terminal::right_align(&mut table, 2);
    format!(
        "Held-out field error, {how}\n{table}\n\
         RMS over all {} channels: {:.digits$} {unit}. Floor: white noise of the averaged sensor and of the reference\n\
         (through dB/dF), root sum of squares. Explainable: error above the floor, root difference of\n\
         squares. Range: of the field in this campaign.\n{}",
        axes(model).count(),
        pooled_rms(axes(model).map(|(_, axis)| axis.rms_g)),
        terminal::paragraph(&noise.sentence())
    )
}

fn axes(model: &ModelFile) -> impl Iterator<Item = (&SensorModel, &HeldOutError)> {
    model.sensors.iter().flat_map(|sensor| sensor.held_out.iter().map(move |axis| (sensor, axis)))
}

/// Error relative to the range of the field from which a polynomial has nothing to do with the forces.
const GROSS: f64 = 0.1;

/// Verdict on the held-out error.
pub fn verdict(model: &ModelFile, unit: SignalUnit) -> String {
    let ratio = |axis: &HeldOutError| axis.rms_g / axis.floor_g;
    let worst = axes(model).max_by(|a, b| ratio(a.1).total_cmp(&ratio(b.1)));
    let rms_g = pooled_rms(axes(model).map(|(_, axis)| axis.rms_g));
    let floor_g = pooled_rms(axes(model).map(|(_, axis)| axis.floor_g));
    let is_open = !is_at_floor(rms_g / floor_g, worst.map(|(_, axis)| ratio(axis)));
    let Some((sensor, axis)) = worst.filter(|_| is_open) else {
        if rms_g < BELOW_FLOOR * floor_g {
            return below_floor(rms_g, floor_g, unit);
        }
        let percent = 100.0 * (AT_FLOOR - 1.0);
        return format!("At the noise floor: the error is within {percent:.0} % of its floor.");
    };
    let worst = format!(
        "Maximum: sensor {} {}, {:.1} times its floor.",
        sensor.number,
        axis.axis,
        ratio(axis)
    );
    if axis.fitted_rms_g <= AT_FLOOR * axis.floor_g {
        return format!(
            "Too little data: at the floor on fitted rows, above it on held-out rows.\n{worst}"
        );
    }
    let why = match model.base {
        BaseKind::Cylinder => "an effect is missing from the model, or the clocks are misaligned.",
        BaseKind::Polynomial if axis.rms_g > GROSS * axis.span_g => {
            "the degree is too low, the field depends on further inputs, or the setup is wrong (exchanged sensors, units, clocks)."
        }
        BaseKind::Polynomial => "the degree is too low, or the field depends on further inputs.",
    };
    format!("Structure remains: {why}\n{worst}")
}

pub fn to_json(fit: &CampaignFit) -> Value {
    let model = &fit.model;
    let axis_errors = axes(model).map(|(sensor, axis)| {
        json!({
            "sensor": sensor.number, "axis": axis.axis,
            "held_out_rms_g": axis.rms_g, "floor_g": axis.floor_g, "span_g": axis.span_g,
        })
    });
    let unit = fit.campaign.signal_unit().symbol();
    let mut object = json!({
        "axes": axis_errors.collect::<Vec<_>>(),
        "force": fit.force,
        "held_out_rms_g": pooled_rms(axes(model).map(|(_, axis)| axis.rms_g)),
        "signal_unit": unit,
        "verdict": verdict(model, fit.campaign.signal_unit()),
        "provenance": model.provenance,
        "notices": notes::texts(&fit.notes),
    });
    parameters::add_json(&mut object, &ParameterTable::of(model));
    if let Some(estimates) = object["parameters"].as_array_mut() {
        estimates.extend(model.sensors.iter().flat_map(|sensor| coefficients_json(sensor, unit)));
    }
    object
}

/// Coefficients of a polynomial, which have no design.
fn coefficients_json(sensor: &SensorModel, unit: &str) -> Vec<Value> {
    let number = sensor.number;
    let mut parameters = Vec::new();
    if let Some(table) = &sensor.polynomial {
        let rows = table.terms.iter().zip(&table.coefficients_g).zip(&table.std_errors_g);
        for ((term, values), errors) in rows {
            let powers = table.forces.iter().zip(term);
            let powers: Vec<String> = powers.map(|(force, n)| format!("P{n}({force})")).collect();
            for ((axis, value), error) in ["x", "y", "z"].iter().zip(values).zip(errors) {
                parameters.push(json!({
                    "sensor": number, "name": format!("{axis}: {}", powers.join(" ")),
                    "value": value, "std_error": error, "unit": unit, "identifiable": true,
                }));
            }
        }
    }
    parameters
}

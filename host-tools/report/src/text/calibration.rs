//! Text and JSON of the coverage and calibration of predicted standard deviations.

use analysis::calibration::{BLOCK_S, Coverage, SEED};
use analysis::network_calibration::NetworkCalibration;
use serde_json::{Value, json};

/// The coverage of 1, 2 and 3 sigma, each with its interval: `68.1 % (66.0 to 70.2)`.
pub fn coverage_percent(coverage: &Coverage) -> [String; 3] {
    [0, 1, 2].map(|place| {
        let [lower, upper] = coverage.interval[place].map(|share| 100.0 * share);
        format!("{:.1} % ({lower:.1} to {upper:.1})", 100.0 * coverage.within[place])
    })
}

pub fn coverage_json(coverage: &Coverage) -> Value {
    let [one, two, three] = coverage.within;
    json!({
        "1": one, "2": two, "3": three, "interval_95": coverage.interval, "rows": coverage.rows,
        "blocks": coverage.blocks, "block_s": BLOCK_S, "seed": SEED, "curve": coverage.curve,
        "sigma_n": coverage.sigma_n, "rmse_n": coverage.rmse_n,
    })
}

/// The calibration of the networks as text; empty without predictions.
pub fn calibration_sentence(calibration: &NetworkCalibration) -> String {
    let (Some(before), Some(after)) = (&calibration.before, &calibration.after) else {
        return String::new();
    };
    let factors = calibration.factors.iter().flat_map(|(_, factors)| factors);
    let (min, max) = factors.fold((f64::INFINITY, 0.0_f64), |(a, b), f| (a.min(*f), b.max(*f)));
    let [one, two, three] = coverage_percent(after);
    let [before_one, before_two, _] = coverage_percent(before);
    format!(
        "Calibration multiplies sigma by {min:.2} to {max:.2}. Cross-validated coverage (blocks of 5 s) after the \
         tare over all forces, 1, 2 and 3 sigma: {one}, {two}, {three} (Gaussian: 68.3, 95.4, 99.7 %; 95 % intervals by \
         block bootstrap, 1000 draws); uncalibrated {before_one}, {before_two}. "
    )
}

pub fn calibration_json(calibration: &NetworkCalibration) -> Value {
    let factors = calibration.factors.iter();
    let factors = factors.map(|(sensor, [x, z])| json!({ "sensor": sensor, "x": x, "z": z }));
    json!({
        "coverage": calibration.after.as_ref().map(coverage_json),
        "before": calibration.before.as_ref().map(coverage_json),
        "factors": factors.collect::<Vec<_>>(),
    })
}

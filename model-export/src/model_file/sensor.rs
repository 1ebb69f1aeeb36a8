//! Model of one sensor: parameters with standard errors, or polynomial coefficients.

use std::collections::BTreeMap;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::effects::{EffectTerm, FinalState};
use crate::fit::AxisScore;
use crate::fit::identifiability::Unidentifiable;
use crate::fit::joint::SensorFit;
use crate::fit::polynomial::{Polynomial, PolynomialFit};
use crate::fit::rows::{ForcePair, own_forces, pair};
use crate::input::MAX_POLYNOMIAL_TERMS;
use crate::physics::SensorOrientation;
use crate::recordings::columns::{Axis, ForceColumn, force_column, force_column_name};
use crate::recordings::units::round_significant;

/// Model of one sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorModel {
    /// Index of the sensor.
    pub number: u32,
    /// Orientation of the sensor; nominal where it is absent. All else is in the gripper's axes.
    #[serde(default, skip_serializing_if = "SensorOrientation::is_nominal")]
    pub orientation: SensorOrientation,
    /// Held-out error of each axis.
    pub held_out: Vec<HeldOutError>,
    /// With the cylinder base: RMS of the residual that no force explains on held-out recordings in gauss;
    /// scale of the device's detection of magnetic disturbances.
    #[serde(rename = "beside_forces_g", default, skip_serializing_if = "Option::is_none")]
    pub parity_residual_g: Option<f64>,
    /// With the cylinder base: all parameters by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, FittedValue>,
    /// With the cylinder base: unidentifiable combinations, fixed at their nominal values.
    #[serde(rename = "held", default, skip_serializing_if = "Vec::is_empty")]
    pub unidentifiable: Vec<UnidentifiableCombination>,
    /// Variance inflation of the data by autocorrelated or structured residuals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise_inflation: Option<f64>,
    /// Correlations of the estimates, those of effects included.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub correlation: Option<CorrelationTable>,
    /// With the cylinder base: forces that the campaign did not measure or did not excite. They are assumed to be zero, and their
    /// stiffness is nominal.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub assumed_zero: Vec<Axis>,
    /// With the polynomial base: its coefficients.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub polynomial: Option<PolynomialTable>,
    /// With an effect that changes the gripper permanently: the end of the campaign.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub final_state: Option<FinalState>,
}

/// Held-out error of one axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeldOutError {
    /// `x`, `y` or `z`.
    pub axis: String,
    /// RMS of measured minus modelled field on held-out recordings.
    pub rms_g: f64,
    /// RMS of measured minus modelled field on the fitted recordings.
    pub fitted_rms_g: f64,
    /// Noise floor: error of a perfect model.
    pub floor_g: f64,
    /// Peak-to-peak field in the campaign.
    pub span_g: f64,
}

/// A fitted value with its standard error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FittedValue {
    /// Estimate.
    pub value: f64,
    /// Standard error.
    pub std_error: f64,
    /// Unit of both.
    pub unit: String,
    /// Whether the data determine it to half its prior width.
    pub identifiable: bool,
    /// Prior width of a parameter of an effect; that of a base parameter is its manufacturing tolerance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prior_width: Option<f64>,
}

/// A combination of parameters that the data do not determine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnidentifiableCombination {
    /// Weights of the parameters in prior widths; those of an effect as `effect.parameter`.
    pub shares: BTreeMap<String, f64>,
    /// Standard error from the data alone in prior widths.
    #[serde(rename = "known_within")]
    pub sigma_tolerances: f64,
}

/// Correlations of the estimates of one sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CorrelationTable {
    /// Parameters, those of an effect as `effect.parameter`. Without coefficients of polynomials, parameters of single recordings, and
    /// those that are shared by all sensors or preset: their covariance with the others is not estimated.
    pub names: Vec<String>,
    /// Below the diagonal, row by row from the second parameter.
    pub rows: Vec<Vec<f64>>,
}

impl CorrelationTable {
    /// Of a fit with these effects, from the parameter `first`; `None` for fewer than two parameters.
    pub(super) fn of(
        fit: &SensorFit,
        effects: &[EffectTerm],
        first: usize,
        recordings: usize,
    ) -> Option<Self> {
        let is_estimated = |index: usize| {
            let parameter = &fit.parameters[index];
            let is_own = parameter.recording.is_none() && !parameter.is_state && !parameter.shared;
            is_own && parameter.preset_sigma.is_none() && fit.std_error(index) > 0.0
        };
        let (indices, names): (Vec<usize>, Vec<String>) = full_names(fit, effects, recordings)
            .into_iter()
            .enumerate()
            .filter(|(index, _)| *index >= first && is_estimated(*index))
            .unzip();
        let correlation = |i: usize, j: usize| {
            let scale = fit.std_error(i) * fit.std_error(j);
            digits((fit.covariance[(i, j)] / scale).clamp(-1.0, 1.0))
        };
        let row = |(count, &i): (usize, &usize)| {
            indices[..count].iter().map(|&j| correlation(i, j)).collect::<Vec<f64>>()
        };
        let rows = indices.iter().enumerate().skip(1).map(row).collect();
        (names.len() > 1).then_some(Self { names, rows })
    }

    /// Whether there is a value from -1 to 1 for each pair of names.
    pub(super) fn is_complete(&self) -> bool {
        let lengths = self.rows.iter().map(Vec::len);
        lengths.eq(1..self.names.len())
            && self.rows.iter().flatten().all(|value| (-1.0..=1.0).contains(value))
    }

    /// Correlation of two parameters, by their places in [`CorrelationTable::names`].
    pub fn between(&self, i: usize, j: usize) -> f64 {
        let (low, high) = (i.min(j), i.max(j));
        if low == high { 1.0 } else { self.rows[high - 1][low] }
    }
}

/// Names of all parameters of a fit; those of an effect as `effect.parameter`.
fn full_names(fit: &SensorFit, effects: &[EffectTerm], recordings: usize) -> Vec<String> {
    let mut effects: Vec<&EffectTerm> = effects.iter().collect();
    effects.sort_by_key(|effect| effect.stage());
    let of_effects = effects.into_iter().flat_map(|effect| {
        let parameters = effect.parameters(recordings).into_iter();
        parameters.map(move |parameter| format!("{}.{}", effect.name(), parameter.name))
    });
    let base = fit.parameters[..fit.base_count].iter().map(|parameter| parameter.name.clone());
    base.chain(of_effects).collect()
}

/// Coefficients of a polynomial of the forces.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolynomialTable {
    /// Total degree.
    pub degree: usize,
    /// Input columns of `force.csv`.
    pub forces: Vec<String>,
    /// Range of each force in newtons, scaled to -1 to 1.
    pub spans_n: Vec<(f64, f64)>,
    /// Legendre degrees of each term, one for each force.
    pub terms: Vec<Vec<usize>>,
    /// Coefficients of each term in gauss: x, y, z.
    pub coefficients_g: Vec<[f64; 3]>,
    /// Standard errors of the coefficients in gauss.
    pub std_errors_g: Vec<[f64; 3]>,
}

impl SensorModel {
    /// The entry of a sensor with the values and the standard errors of a fit with these effects.
    pub(super) fn of_cylinder(fit: &SensorFit, effects: &[EffectTerm], recordings: usize) -> Self {
        let value = |i: usize| FittedValue {
            value: digits(fit.values[i]),
            std_error: digits(fit.std_error(i)),
            unit: fit.parameters[i].unit.clone(),
            identifiable: fit.identifiable[i],
            prior_width: None,
        };
        let names = full_names(fit, effects, recordings);
        let share = |&(index, weight): &(usize, f64)| (names[index].clone(), digits(weight));
        let combination = |held: &Unidentifiable| UnidentifiableCombination {
            shares: held.shares.iter().map(share).collect(),
            sigma_tolerances: digits(held.uncertainty),
        };
        Self {
            number: fit.sensor,
            orientation: fit.orientation,
            held_out: fit.scores.iter().map(HeldOutError::of).collect(),
            parity_residual_g: fit.tally().parity_residual_g().map(digits),
            parameters: (0..fit.base_count)
                .map(|i| (fit.parameters[i].name.clone(), value(i)))
                .collect(),
            unidentifiable: fit.unidentifiable.iter().map(combination).collect(),
            noise_inflation: Some(digits(fit.inflation)),
            correlation: CorrelationTable::of(fit, effects, 0, recordings),
            assumed_zero: own_forces(fit.sensor)
                .into_iter()
                .filter(|force| !fit.forces.contains(force))
                .map(|(_, axis)| axis)
                .collect(),
            polynomial: None,
            final_state: None,
        }
    }

    pub(super) fn of_polynomial_with_effects(
        start: &PolynomialFit,
        fit: &SensorFit,
        effects: &[EffectTerm],
        recordings: usize,
    ) -> Self {
        let mut entry = Self::of_polynomial(start);
        entry.correlation = CorrelationTable::of(fit, effects, fit.base_count, recordings);
        entry.held_out = fit.scores.iter().map(HeldOutError::of).collect();
        if let Some(table) = &mut entry.polynomial {
            let row = |i: usize, of: &dyn Fn(usize) -> f64| {
                [0, 1, 2].map(|axis| digits(of(3 * i + axis)))
            };
            let terms = table.terms.len();
            table.coefficients_g = (0..terms).map(|i| row(i, &|slot| fit.values[slot])).collect();
            table.std_errors_g = (0..terms).map(|i| row(i, &|slot| fit.std_error(slot))).collect();
        }
        entry
    }

    pub(super) fn of_polynomial(fit: &PolynomialFit) -> Self {
        let rows = |matrix: &DMatrix<f64>| {
            matrix
                .row_iter()
                .map(|row| [digits(row[0]), digits(row[1]), digits(row[2])])
                .collect::<Vec<_>>()
        };
        let model = &fit.model;
        Self {
            number: fit.sensor,
            orientation: SensorOrientation::default(),
            held_out: fit.scores.iter().map(HeldOutError::of).collect(),
            parity_residual_g: None,
            parameters: BTreeMap::new(),
            unidentifiable: Vec::new(),
            noise_inflation: None,
            correlation: None,
            assumed_zero: Vec::new(),
            polynomial: Some(PolynomialTable {
                degree: model.degree,
                forces: model.forces.iter().map(|force| force_column_name(*force)).collect(),
                spans_n: model.spans_n.clone(),
                terms: Polynomial::terms(model.forces.len(), model.degree),
                coefficients_g: rows(&model.coefficients_g),
                std_errors_g: rows(&fit.std_error_g),
            }),
            final_state: None,
        }
    }

    /// Forces that the model was fitted to; of the cylinder base those at the sensor's own place.
    pub fn forces(&self) -> Vec<(u32, Axis)> {
        match self.polynomial() {
            Some(polynomial) => polynomial.forces,
            None => {
                let own = own_forces(self.number).into_iter();
                own.filter(|(_, axis)| !self.assumed_zero.contains(axis)).collect()
            }
        }
    }

    /// The lateral and the longitudinal one of [`SensorModel::forces`].
    pub(crate) fn force_pair(&self) -> ForcePair {
        pair(&self.forces())
    }

    /// The polynomial; `None` if absent or inconsistent with its degree.
    pub fn polynomial(&self) -> Option<Polynomial> {
        let table = self.polynomial.as_ref()?;
        let force = |name: &String| match force_column(name) {
            Ok(ForceColumn::Force { sensor, axis }) => Some((sensor, axis)),
            _ => None,
        };
        let forces: Vec<(u32, Axis)> = table.forces.iter().map(force).collect::<Option<_>>()?;
        if Polynomial::term_count(forces.len(), table.degree) != Some(table.terms.len())
            || table.terms.len() > MAX_POLYNOMIAL_TERMS
        {
            return None;
        }
        let terms = Polynomial::terms(forces.len(), table.degree);
        let finite = table.coefficients_g.iter().flatten().all(|value| value.is_finite());
        let consistent = terms == table.terms
            && table.coefficients_g.len() == terms.len()
            && table.spans_n.len() == forces.len()
            && table.spans_n.iter().all(|(from, to)| (to - from).is_finite() && from < to);
        (finite && consistent).then(|| Polynomial {
            degree: table.degree,
            forces,
            spans_n: table.spans_n.clone(),
            coefficients_g: DMatrix::from_fn(terms.len(), 3, |i, j| table.coefficients_g[i][j]),
        })
    }
}

impl HeldOutError {
    /// Held-out error in excess of the noise floor (root of the difference of squares) in gauss.
    pub fn explainable_g(&self) -> f64 {
        (self.rms_g.powi(2) - self.floor_g.powi(2)).max(0.0).sqrt()
    }

    fn of(score: &AxisScore) -> Self {
        Self {
            axis: score.axis.letter().to_owned(),
            rms_g: digits(score.held_out_rms_g),
            fitted_rms_g: digits(score.fitted_rms_g),
            floor_g: digits(score.floor_g),
            span_g: digits(score.span_g),
        }
    }
}

/// Rounds to ten digits: far below any standard error, and independent of the processor's last bits.
pub(super) fn digits(value: f64) -> f64 {
    round_significant(value, 10)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::EffectParameter;
    use crate::fit::parameters::FreeParameter;

    #[test]
    fn correlation_is_covariance_over_both_standard_errors() {
        let parameter = |name: &'static str| FreeParameter {
            name: name.to_owned(),
            ..FreeParameter::of(&EffectParameter::shape("time", "s", &[0.5, 1.0, 2.0]))
        };
        let mut parameters = ["gap", "pooled", "remanence"].map(parameter).to_vec();
        parameters[1].shared = true;
        let fit = SensorFit {
            sensor: 0,
            forces: Vec::new(),
            orientation: SensorOrientation::default(),
            base_count: 3,
            offset_confounded: false,
            values: vec![1.5, 0.0, 1.2],
            covariance: DMatrix::from_row_slice(
                3,
                3,
                &[4.0, 0.0, -3.0, 0.0, 1.0, 0.0, -3.0, 0.0, 9.0],
            ),
            prior_errors: vec![0.0; 3],
            identifiable: vec![true; 3],
            unidentifiable: Vec::new(),
            scores: Vec::new(),
            folds: Vec::new(),
            fold_values: Vec::new(),
            block_s: 1.0,
            correlation_s: 0.1,
            inflation: 1.0,
            starts_nominal: true,
            parameters,
        };
        // -3 / (2 * 3); the pooled parameter is left out.
        let table = CorrelationTable::of(&fit, &[], 0, 1).unwrap();
        let known = CorrelationTable {
            names: ["gap", "remanence"].map(str::to_owned).to_vec(),
            rows: vec![vec![-0.5]],
        };
        assert_eq!(table, known);
        assert_eq!(
            [table.between(0, 1), table.between(1, 0), table.between(1, 1)],
            [-0.5, -0.5, 1.0]
        );
        assert!(table.is_complete() && CorrelationTable::of(&fit, &[], 2, 1).is_none());
        for rows in [vec![], vec![vec![]], vec![vec![1.5]], vec![vec![0.5], vec![0.5, 0.5]]] {
            assert!(!CorrelationTable { rows, ..known.clone() }.is_complete());
        }
    }
}

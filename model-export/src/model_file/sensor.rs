//! Model of one sensor: parameters with standard errors, or polynomial coefficients.

use std::collections::BTreeMap;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::effects::FinalState;
use crate::fit::AxisScore;
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
    /// Whether the data determine it to half a manufacturing tolerance.
    pub identifiable: bool,
}

/// A combination of parameters that the data do not determine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnidentifiableCombination {
    /// Coefficients of the parameters in units of their tolerances.
    pub shares: BTreeMap<String, f64>,
    /// Standard error from the data alone in units of tolerance.
    #[serde(rename = "known_within")]
    pub sigma_tolerances: f64,
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
    /// The entry of a sensor with these values and the standard errors of the fit.
    pub(super) fn of_cylinder(fit: &SensorFit, values: &[f64]) -> Self {
        let value = |i: usize| FittedValue {
            value: digits(values[i]),
            std_error: digits(fit.std_error(i)),
            unit: fit.parameters[i].unit.clone(),
            identifiable: fit.identifiable[i],
        };
        let combination =
            |held: &crate::fit::identifiability::Unidentifiable| UnidentifiableCombination {
                shares: held
                    .shares
                    .iter()
                    .map(|(name, coefficient)| (name.clone(), digits(*coefficient)))
                    .collect(),
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
            assumed_zero: own_forces(fit.sensor)
                .into_iter()
                .filter(|force| !fit.forces.contains(force))
                .map(|(_, axis)| axis)
                .collect(),
            polynomial: None,
            final_state: None,
        }
    }

    pub(super) fn of_polynomial_with_effects(start: &PolynomialFit, fit: &SensorFit) -> Self {
        let mut entry = Self::of_polynomial(start);
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

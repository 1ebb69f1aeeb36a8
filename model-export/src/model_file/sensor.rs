//! The model of one sensor, number by number.

use std::collections::BTreeMap;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::digits;
use crate::fit::AxisScore;
use crate::fit::joint::SensorFit;
use crate::fit::polynomial::{Polynomial, PolynomialFit};
use crate::recordings::columns::{Axis, ForceColumn, force_column};

/// The model of one sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensorModel {
    /// Number of the sensor.
    pub number: u32,
    /// Held-out error beside the floor, each axis.
    pub held_out: Vec<HeldOut>,
    /// With the cylinder base: root mean square of what no forces explain of a row on recordings kept
    /// out of the fit, in gauss. By it the device tells a foreign magnet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub beside_forces_g: Option<f64>,
    /// With the cylinder base: every parameter.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, Value>,
    /// With the cylinder base: combinations held at nominal.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub held: Vec<Held>,
    /// With the polynomial base: the polynomial.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub polynomial: Option<PolynomialTable>,
}

/// Held-out error of one axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// `x`, `y` or `z`.
    pub axis: String,
    /// Root mean square of measured minus modelled field on recordings kept out of the fit.
    pub rms_g: f64,
    /// The same on the recordings that were fitted.
    pub fitted_rms_g: f64,
    /// What a perfect model would leave.
    pub floor_g: f64,
    /// Peak-to-peak field in the campaign.
    pub span_g: f64,
}

/// A fitted number.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Value {
    /// The number.
    pub value: f64,
    /// One standard deviation.
    pub std_error: f64,
    /// Unit.
    pub unit: String,
    /// Whether the data tell it, to half a manufacturing tolerance.
    pub identifiable: bool,
}

/// A combination of parameters held at nominal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Held {
    /// Shares of the parameters in it, in tolerances.
    pub shares: BTreeMap<String, f64>,
    /// How well the data alone know it, in tolerances.
    pub known_within: f64,
}

/// A polynomial of the forces.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PolynomialTable {
    /// Total degree.
    pub degree: usize,
    /// Columns of `force.csv` that it takes.
    pub forces: Vec<String>,
    /// Range of each force in newtons that is scaled to -1 to 1.
    pub spans_n: Vec<(f64, f64)>,
    /// Degrees of the Legendre polynomials of each term.
    pub terms: Vec<Vec<usize>>,
    /// Coefficients of each term in gauss: x, y, z.
    pub coefficients_g: Vec<[f64; 3]>,
    /// Their standard deviations in gauss.
    pub std_errors_g: Vec<[f64; 3]>,
}

impl SensorModel {
    /// The entry of one sensor with these values, its error bars those of the fit.
    pub(super) fn of_cylinder(fit: &SensorFit, values: &[f64]) -> Self {
        let value = |i: usize| Value {
            value: digits(values[i]),
            std_error: digits(fit.std_error(i)),
            unit: fit.slots[i].unit.clone(),
            identifiable: fit.identifiable[i],
        };
        let held = |held: &crate::fit::space::Held| Held {
            shares: held
                .shares
                .iter()
                .map(|(name, share)| (name.clone(), digits(*share)))
                .collect(),
            known_within: digits(held.known_within),
        };
        Self {
            number: fit.sensor,
            held_out: fit.scores.iter().map(HeldOut::of).collect(),
            beside_forces_g: fit.tally().beside_g().map(digits),
            parameters: (0..fit.base_count)
                .map(|i| (fit.slots[i].name.clone(), value(i)))
                .collect(),
            held: fit.held.iter().map(held).collect(),
            polynomial: None,
        }
    }

    pub(super) fn of_polynomial_with_effects(start: &PolynomialFit, fit: &SensorFit) -> Self {
        let mut entry = Self::of_polynomial(start);
        entry.held_out = fit.scores.iter().map(HeldOut::of).collect();
        if let Some(table) = &mut entry.polynomial {
            let row = |i: usize, of: &dyn Fn(usize) -> f64| {
                [0, 1, 2].map(|axis| digits(of(3 * i + axis)))
            };
            let terms = table.terms.len();
            table.coefficients_g = (0..terms)
                .map(|i| row(i, &|slot| fit.values[slot]))
                .collect();
            table.std_errors_g = (0..terms)
                .map(|i| row(i, &|slot| fit.std_error(slot)))
                .collect();
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
            held_out: fit.scores.iter().map(HeldOut::of).collect(),
            beside_forces_g: None,
            parameters: BTreeMap::new(),
            held: Vec::new(),
            polynomial: Some(PolynomialTable {
                degree: model.degree,
                forces: model
                    .forces
                    .iter()
                    .map(|(place, axis)| format!("f{place}_{}_n", axis.letter()))
                    .collect(),
                spans_n: model.spans_n.clone(),
                terms: Polynomial::terms(model.forces.len(), model.degree),
                coefficients_g: rows(&model.coefficients_g),
                std_errors_g: rows(&fit.std_error_g),
            }),
        }
    }

    /// The polynomial; `None` where there is none or the table does not fit its degree.
    pub fn polynomial(&self) -> Option<Polynomial> {
        let table = self.polynomial.as_ref()?;
        let force = |name: &String| match force_column(name) {
            Ok(ForceColumn::Force { place, axis }) => Some((place, axis)),
            _ => None,
        };
        let forces: Vec<(u32, Axis)> = table.forces.iter().map(force).collect::<Option<_>>()?;
        let terms = Polynomial::terms(forces.len(), table.degree);
        let finite = table
            .coefficients_g
            .iter()
            .flatten()
            .all(|value| value.is_finite());
        let fits = terms == table.terms
            && table.coefficients_g.len() == terms.len()
            && table.spans_n.len() == forces.len();
        (finite && fits).then(|| Polynomial {
            degree: table.degree,
            forces,
            spans_n: table.spans_n.clone(),
            coefficients_g: DMatrix::from_fn(terms.len(), 3, |i, j| table.coefficients_g[i][j]),
        })
    }
}

impl HeldOut {
    /// The part of the error that a better model could remove, in gauss.
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

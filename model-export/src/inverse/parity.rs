//! Surface of a sensor's possible fields, as the device's polynomial ([`firmware::estimator::parity`]).

use firmware::estimator::parity::max_sum;
use firmware::fixed_point::Field;
use firmware::model::formats::{
    COORDINATE_LIMIT, PARITY_ARGUMENT_BITS, PARITY_DEGREE, PARITY_SIGMA_BITS, PARITY_TERM_BITS,
    PARITY_TERMS, Parity,
};
use nalgebra::{DMatrix, DVector, Vector3};

use crate::fit::cross_validation::off_plane_residual;
use crate::inverse::quantise::TableOverflow;
use crate::inverse::static_model::{DesignBox, StaticModel};

/// Lattice of loads for the fit, and its range relative to the box.
const LOADS: usize = 33;
const OVERRANGE: f64 = 1.05;

/// Minimum standard deviation in gauss, about that of the counts' rounding.
const MIN_SPREAD_G: f64 = 0.04;

/// Surface of the fields of a sensor, in floating point.
#[derive(Clone, Debug, PartialEq)]
pub struct ParitySurface {
    /// Axis that is predicted from the other two: the one least sensitive to forces.
    pub axis: usize,
    /// Coefficients in gauss, in the device's order; arguments are coordinates of the box.
    pub terms_g: [f64; PARITY_TERMS],
    /// Root mean square residual of the polynomial over the box, in gauss.
    pub fit_rms_g: f64,
    design: DesignBox,
}

impl ParitySurface {
    /// Fits the polynomial over the design box. The fields of one force are a curve: there is no surface, and all terms are zero.
    pub fn of(model: &StaticModel, design: &DesignBox) -> Self {
        let rest = model.per_newton(design.region.centre_n);
        let axis = off_plane_residual(&rest, Vector3::zeros()).map_or(1, |(axis, _)| axis);
        let fields: Vec<Vector3<f64>> =
            design.region.scaled(OVERRANGE).lattice(LOADS).map(|load| model.field(load)).collect();
        let mut own = Self { axis, terms_g: [0.0; PARITY_TERMS], fit_rms_g: 0.0, design: *design };
        if design.region.single().is_some() {
            return own;
        }
        let rows = fields.iter().flat_map(|field| own.powers(field));
        let regressors = DMatrix::from_row_iterator(fields.len(), PARITY_TERMS, rows);
        let seen = DVector::from_iterator(fields.len(), fields.iter().map(|field| field[axis]));
        let found = regressors.clone().svd(true, true).solve(&seen, 1e-10);
        if let Ok(terms) = found {
            own.terms_g = std::array::from_fn(|i| terms[i]);
            let errors = regressors * terms - seen;
            own.fit_rms_g = (errors.norm_squared() / fields.len() as f64).sqrt();
        }
        own
    }

    /// Residual of a field from the surface along the predicted axis, in gauss.
    pub fn residual(&self, field_g: &Vector3<f64>) -> f64 {
        let terms = self.powers(field_g).into_iter().zip(self.terms_g);
        field_g[self.axis] - terms.map(|(power, term)| power * term).sum::<f64>()
    }

    /// u^i v^j in the device's order.
    fn powers(&self, field_g: &Vector3<f64>) -> Vec<f64> {
        let at = self.design.coordinates(field_g);
        let [u, v] = match self.axis {
            0 => [at.y, at.z],
            1 => [at.x, at.z],
            _ => [at.x, at.y],
        };
        let row = |i: usize| (0..=PARITY_DEGREE - i).rev().map(move |j| (i, j));
        let both = (0..=PARITY_DEGREE).rev().flat_map(row);
        both.map(|(i, j)| u.powi(i as i32) * v.powi(j as i32)).collect()
    }

    /// The device's table; `spread_g` is the standard deviation of the residual in the fit. Without a surface its sigma is zero, by
    /// which the device knows no disturbance.
    pub fn table(
        &self,
        sensor: u32,
        spread_g: f64,
        gauss_per_lsb: f64,
    ) -> Result<Parity, TableOverflow> {
        let units = f64::from(1_u32 << Field::BITS) / gauss_per_lsb;
        let fit = |row: &str, value: f64| {
            if value.round().abs() <= f64::from(i32::MAX) {
                Ok(value.round() as i32)
            } else {
                Err(TableOverflow {
                    sensor,
                    row: row.to_owned(),
                    value,
                    format: "32 bits".to_owned(),
                    advice: "the fields of this model are not on a smooth surface: check its parameters",
                })
            }
        };
        // Rescales coordinates to the device's arguments.
        let scale = f64::from(1_u32 << PARITY_ARGUMENT_BITS) / f64::from(COORDINATE_LIMIT);
        let one = units * f64::from(1_u32 << PARITY_TERM_BITS);
        let powers = (0..=PARITY_DEGREE)
            .rev()
            .flat_map(|i| (0..=PARITY_DEGREE - i).map(move |j| PARITY_DEGREE - j));
        let mut terms = [0; PARITY_TERMS];
        for ((place, term), power) in terms.iter_mut().zip(self.terms_g).zip(powers) {
            let value = term * one * scale.powi(power as i32);
            *place = fit("a term of the parity", value)?;
        }
        fit("the parity's polynomial", max_sum(&terms))?;
        let spread_g = spread_g.hypot(self.fit_rms_g).max(MIN_SPREAD_G);
        let is_surface = self.design.region.single().is_none();
        let spread_g = if is_surface { spread_g } else { 0.0 };
        let spread = spread_g * units * f64::from(1_u32 << PARITY_SIGMA_BITS);
        Ok(Parity { axis: self.axis as u8, terms, sigma: fit("sigma of the parity", spread)? })
    }
}

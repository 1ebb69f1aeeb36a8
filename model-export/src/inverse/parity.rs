//! The surface on which a sensor's fields lie, as the device's polynomial ([`firmware::model::parity`]).

use firmware::model::parity::{
    ARGUMENT_BITS, DEGREE, Parity, SPREAD_BITS, TERM_BITS, TERMS, greatest_sum,
};
use firmware::model::table::COORDINATE_LIMIT;
use firmware::units::Field;
use nalgebra::{DMatrix, DVector, Vector3};

use super::at_rest::AtRest;
use super::design_box::{DesignBox, lattice};
use super::quantise::Overflow;

/// Loads along each axis that it is fitted to, and how far beyond the box they go.
const LOADS: usize = 33;
const BEYOND: f64 = 1.05;

/// No spread is taken to be less, in gauss: about that of the counts' rounding.
const LEAST_SPREAD_G: f64 = 0.04;

/// Where the fields of a sensor lie, in floating point.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    /// The axis that the other two foretell: the one that the forces move least.
    pub axis: usize,
    /// Coefficients in gauss, in the device's order; arguments are coordinates of the box.
    pub terms_g: [f64; TERMS],
    /// Root mean square that the polynomial leaves over the box, in gauss.
    pub left_g: f64,
    design: DesignBox,
}

/// The axis that stands most across the plane of both forces' fields, and how far a residual lies beside
/// that plane along it. `None` where the forces move the field along one line only.
pub fn beside(per_newton: &[Vector3<f64>], residual: Vector3<f64>) -> Option<(usize, f64)> {
    let [gx, gz] = per_newton else {
        return None;
    };
    let across = gx.cross(gz);
    let axis = across.iamax();
    (across[axis] != 0.0).then(|| (axis, across.dot(&residual) / across[axis]))
}

impl Surface {
    /// Fits the polynomial to the fields of a box of loads.
    pub fn of(model: &AtRest, design: &DesignBox) -> Self {
        let rest = model.per_newton([0.0; 2]);
        let axis = beside(&rest, Vector3::zeros()).map_or(1, |(axis, _)| axis);
        let fields: Vec<Vector3<f64>> = lattice(design.force_n.map(|f| f * BEYOND), LOADS)
            .map(|load| model.field(load))
            .collect();
        let mut own = Self {
            axis,
            terms_g: [0.0; TERMS],
            left_g: 0.0,
            design: *design,
        };
        let rows = fields.iter().flat_map(|field| own.powers(field));
        let regressors = DMatrix::from_row_iterator(fields.len(), TERMS, rows);
        let seen = DVector::from_iterator(fields.len(), fields.iter().map(|field| field[axis]));
        let found = regressors.clone().svd(true, true).solve(&seen, 1e-10);
        if let Ok(terms) = found {
            own.terms_g = std::array::from_fn(|i| terms[i]);
            let left = regressors * terms - seen;
            own.left_g = (left.norm_squared() / fields.len() as f64).sqrt();
        }
        own
    }

    /// How far a field in gauss lies beside the surface, along the axis.
    pub fn departure(&self, field_g: &Vector3<f64>) -> f64 {
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
        let row = |i: usize| (0..=DEGREE - i).rev().map(move |j| (i, j));
        let both = (0..=DEGREE).rev().flat_map(row);
        both.map(|(i, j)| u.powi(i as i32) * v.powi(j as i32))
            .collect()
    }

    /// The device's table; `spread_g` is what a fit leaves beside the surface.
    pub fn table(
        &self,
        sensor: u32,
        spread_g: f64,
        gauss_per_lsb: f64,
    ) -> Result<Parity, Overflow> {
        let units = f64::from(1_u32 << Field::BITS) / gauss_per_lsb;
        let fit = |row: &str, value: f64| match value.round().abs() <= f64::from(i32::MAX) {
            true => Ok(value.round() as i32),
            false => Err(Overflow {
                sensor,
                row: row.to_owned(),
                value,
                format: "32 bits".to_owned(),
                advice: "the fields of this model lie on no smooth surface: check its parameters",
            }),
        };
        // The device's arguments are the same coordinates on another scale.
        let scale = f64::from(1_u32 << ARGUMENT_BITS) / f64::from(COORDINATE_LIMIT);
        let one = units * f64::from(1_u32 << TERM_BITS);
        let powers = (0..=DEGREE)
            .rev()
            .flat_map(|i| (0..=DEGREE - i).map(move |j| DEGREE - j));
        let mut terms = [0; TERMS];
        for ((place, term), power) in terms.iter_mut().zip(self.terms_g).zip(powers) {
            let value = term * one * scale.powi(power as i32);
            *place = fit("a term of the parity", value)?;
        }
        fit("the parity's polynomial", greatest_sum(&terms))?;
        let spread_g = spread_g.hypot(self.left_g).max(LEAST_SPREAD_G);
        let spread = spread_g * units * f64::from(1_u32 << SPREAD_BITS);
        Ok(Parity {
            axis: self.axis as u8,
            terms,
            spread: fit("spread of the parity", spread)?,
        })
    }
}

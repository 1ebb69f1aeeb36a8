//! Parity residual: a redundancy check of three field axes against two forces.
//!
//! Whatever the forces, friction, creep or cross coupling, a finger's magnet moves in one plane, so its field is on a
//! surface. The device predicts one axis from the other two by a polynomial fitted by the exporter. The residual is due
//! to foreign fields, temperature or noise. A disturbance within the surface is indistinguishable from a force.

use crate::fixed_point::Field;
use crate::model::formats::{
    COORDINATE_LIMIT, PARITY_ARGUMENT_BITS, PARITY_DEGREE, PARITY_TERM_BITS, PARITY_TERMS,
    SensorTable,
};

/// Residual of the predicted axis with its standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ParityResidual {
    /// Measured minus predicted field.
    pub residual: Field,
    /// Standard deviation in the fit, with [`crate::model::formats::PARITY_SIGMA_BITS`] additional fractional bits; 0 where it is
    /// unknown: without a polynomial, or before homing with an effect of the opening.
    pub sigma: i32,
}

/// Residual of a field with these scaled coordinates.
pub fn residual(sensor: &SensorTable, field: [Field; 3], coordinates: [i16; 3]) -> Field {
    let parity = &sensor.parity;
    let [Field(bx), Field(by), Field(bz)] = field;
    let [x, y, z] = coordinates;
    let (measured, u, v) = match parity.axis {
        0 => (bx, y, z),
        1 => (by, x, z),
        _ => (bz, x, y),
    };
    let predicted = polynomial(&parity.terms, u, v);
    Field(measured.saturating_sub(predicted))
}

/// Horner's rule, in the unit of [`Field`]. The exporter ensures by [`max_sum`] that no sum exceeds 32 bits; with other
/// tables sums wrap.
fn polynomial(terms: &[i32; PARITY_TERMS], u: i16, v: i16) -> i32 {
    // Rows of constant lengths, which the compiler unrolls: fewer instructions than a loop over the degree.
    let rows: [i32; PARITY_DEGREE + 1] = [
        row::<1>(terms, v),
        row::<2>(terms, v),
        row::<3>(terms, v),
        row::<4>(terms, v),
        row::<5>(terms, v),
        row::<6>(terms, v),
        row::<7>(terms, v),
    ];
    let sum = rows.iter().fold(0, |sum, row| times(sum, u).wrapping_add(*row));
    sum.wrapping_add(1 << (PARITY_TERM_BITS - 1)) >> PARITY_TERM_BITS
}

/// Factor of one power of u: the polynomial in v with this number of terms.
fn row<const LENGTH: usize>(terms: &[i32; PARITY_TERMS], v: i16) -> i32 {
    let terms = terms.iter().skip(LENGTH * (LENGTH - 1) / 2).take(LENGTH);
    terms.fold(0, |sum, term| times(sum, v).wrapping_add(*term))
}

fn times(sum: i32, by: i16) -> i32 {
    ((i64::from(sum) * i64::from(by)) >> PARITY_ARGUMENT_BITS) as i32
}

/// Upper bound of all sums in the polynomial: the sum of absolute terms at the maximum arguments, plus rounding.
pub fn max_sum(terms: &[i32; PARITY_TERMS]) -> f64 {
    let limit = f64::from(COORDINATE_LIMIT) / f64::from(1_u32 << PARITY_ARGUMENT_BITS);
    let mut terms = terms.iter().map(|term| f64::from(*term).abs());
    let rounding = f64::from(1_u32 << PARITY_TERM_BITS);
    (0..=PARITY_DEGREE).fold(rounding, |sum, degree| {
        let row = terms.by_ref().take(degree + 1);
        sum * limit + row.fold(0.0, |row, term| row * limit + term)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terms_are_ordered_by_descending_powers() {
        let one = 1 << PARITY_TERM_BITS;
        let half = 1 << (PARITY_ARGUMENT_BITS - 1);
        // The last term is the constant, the one before is v; the last of the previous row is u.
        let mut terms = [0; PARITY_TERMS];
        (terms[PARITY_TERMS - 1], terms[PARITY_TERMS - 2]) = (100 * one, 40 * one);
        terms[PARITY_TERMS - 2 - PARITY_DEGREE] = 8 * one;
        assert_eq!(polynomial(&terms, 0, 0), 100);
        assert_eq!(polynomial(&terms, 0, half), 120);
        assert_eq!(polynomial(&terms, half, half), 124);
        // The first term is u^6.
        terms = [0; PARITY_TERMS];
        terms[0] = 64 * one;
        assert_eq!(polynomial(&terms, half, 0), 1);
    }

    #[test]
    fn terms_within_the_bound_do_not_wrap() {
        let limit = i64::from(COORDINATE_LIMIT);
        // 1 + 2 s + 3 s^2 .. 7 s^6 at s = sqrt 2 is 131.1.
        let size = (f64::from(i32::MAX) / 131.2) as i32;
        let signs = |u: i64, v: i64| {
            let powers = (0..=PARITY_DEGREE)
                .flat_map(|row| (0..=row).map(move |j| (PARITY_DEGREE - row, row - j)));
            let sign = |(i, j)| u.signum().pow(i as u32) * v.signum().pow(j as u32);
            let mut terms = powers.map(|powers| size * sign(powers) as i32);
            [(); PARITY_TERMS].map(|()| terms.next().unwrap())
        };
        for (u, v) in [(limit, limit), (-limit, limit), (-limit, -limit)] {
            let terms = signs(u, v);
            let bound = max_sum(&terms);
            assert!(bound < f64::from(i32::MAX) && bound > 0.99 * f64::from(i32::MAX), "{bound}");
            let sum = f64::from(polynomial(&terms, u as i16, v as i16) << PARITY_TERM_BITS);
            assert!((sum / bound - 1.0).abs() < 1e-3, "{sum} {bound}");
        }
    }
}

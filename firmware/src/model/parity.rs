//! Parity: three axes of a field against two forces.
//!
//! Whatever its forces, and whatever friction, creep or coupling make of them, a finger's magnet moves
//! in one plane, and its field lies on one surface. Two axes foretell the third, here by a polynomial
//! that the exporter fits to that surface; what is measured beside it is a field from elsewhere, heat,
//! or noise. A field that lies in the surface is not seen: it is a force as far as the sensor can tell.

use super::ideal::coordinate;
use super::table::SensorTable;
use crate::fixed::clamped;
use crate::units::Field;

/// Greatest sum of a term's powers.
pub const DEGREE: usize = 6;
/// Terms of the polynomial.
pub const TERMS: usize = (DEGREE + 1) * (DEGREE + 2) / 2;
/// Fractional bits of the polynomial's arguments: the scaled coordinates of [`super::ideal`].
pub const ARGUMENT_BITS: u32 = 13;
/// Fractional bits of a term, over the unit of [`Field`].
pub const TERM_BITS: u32 = 8;
/// Fractional bits of [`Parity::spread`], over the unit of [`Field`].
pub const SPREAD_BITS: u32 = 8;

/// The surface on which a sensor's fields lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parity {
    /// The axis that the other two, u and v in their order, foretell.
    pub axis: u8,
    /// Coefficients of u^i v^j: from the highest i down, for each from the highest j down.
    pub terms: [i32; TERMS],
    /// One standard deviation of what a fit leaves beside the surface, with [`SPREAD_BITS`].
    pub spread: i32,
}

impl Parity {
    /// No surface is known: nothing is concluded from where a field lies.
    pub const NONE: Self = Self {
        axis: 1,
        terms: [0; TERMS],
        spread: 0,
    };
}

/// How far a field lies beside the surface of its sensor, along the axis that is foretold.
pub fn departure(sensor: &SensorTable, field: [Field; 3]) -> Field {
    let parity = &sensor.parity;
    let [x, y, z] = field;
    let [sx, sy, sz] = sensor.scale;
    let (measured, (su, u), (sv, v)) = match parity.axis {
        0 => (x, (sy, y), (sz, z)),
        1 => (y, (sx, x), (sz, z)),
        _ => (z, (sx, x), (sy, y)),
    };
    let [u, v] = [coordinate(su, u).0, coordinate(sv, v).0].map(i64::from);
    let foretold = polynomial(&parity.terms, u, v);
    Field(clamped(i64::from(measured.0) - foretold))
}

/// The polynomial by Horner's rule, in the unit of [`Field`]. Arguments stay below 1.42: 28 terms of 32
/// bits, multiplied by that at most twelve times, stay below 2^43, and a product below 2^57.
fn polynomial(terms: &[i32; TERMS], u: i64, v: i64) -> i64 {
    let mut terms = terms.iter().map(|&term| i64::from(term));
    let mut sum = 0;
    for most in 0..=DEGREE {
        let row = terms.by_ref().take(most + 1);
        let row = row.fold(0, |row, term| ((row * v) >> ARGUMENT_BITS) + term);
        sum = ((sum * u) >> ARGUMENT_BITS) + row;
    }
    (sum + (1 << (TERM_BITS - 1))) >> TERM_BITS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_terms_stand_from_the_highest_power_down() {
        let one = 1 << TERM_BITS;
        let half = 1 << (ARGUMENT_BITS - 1);
        // The last term is the constant; before it v, and the last of the row before is u.
        let mut terms = [0; TERMS];
        (terms[TERMS - 1], terms[TERMS - 2]) = (100 * one, 40 * one);
        terms[TERMS - 2 - DEGREE] = 8 * one;
        assert_eq!(polynomial(&terms, 0, 0), 100);
        assert_eq!(polynomial(&terms, 0, half), 120);
        assert_eq!(polynomial(&terms, half, half), 124);
        // The first is u^6: 64 of it are one at a half.
        terms = [0; TERMS];
        terms[0] = 64 * one;
        assert_eq!(polynomial(&terms, half, 0), 1);
    }

    #[test]
    fn the_greatest_terms_at_the_greatest_arguments_do_not_overflow() {
        let most = i64::from(super::super::table::COORDINATE_LIMIT);
        for (u, v) in [(most, most), (-most, most), (-most, -most)] {
            let sum = polynomial(&[i32::MIN; TERMS], u, v);
            assert!(sum.unsigned_abs() < 1 << 35, "{sum}");
        }
    }
}

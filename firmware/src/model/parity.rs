//! Parity: three axes of a field against two forces.
//!
//! Whatever its forces, and whatever friction, creep or coupling make of them, a finger's magnet moves
//! in one plane, and its field lies on one surface. Two axes foretell the third, here by a polynomial
//! that the exporter fits to that surface; what is measured beside it is a field from elsewhere, heat,
//! or noise. A field that lies in the surface is not seen: it is a force as far as the sensor can tell.

use super::table::{COORDINATE_LIMIT, SensorTable};
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

/// How far a field, whose scaled coordinates are `at`, lies beside the surface of its sensor, along the axis that
/// is foretold.
pub fn departure(sensor: &SensorTable, field: [Field; 3], at: [i16; 3]) -> Field {
    let parity = &sensor.parity;
    let [Field(bx), Field(by), Field(bz)] = field;
    let [x, y, z] = at;
    let (measured, u, v) = match parity.axis {
        0 => (bx, y, z),
        1 => (by, x, z),
        _ => (bz, x, y),
    };
    let foretold = polynomial(&parity.terms, u, v);
    Field(measured.saturating_sub(foretold))
}

/// The polynomial by Horner's rule, in the unit of [`Field`]. The exporter sees to it that no sum leaves 32 bits
/// ([`greatest_sum`]); of a table that is not its own, sums wrap.
fn polynomial(terms: &[i32; TERMS], u: i16, v: i16) -> i32 {
    let times = |sum: i32, by: i16| ((i64::from(sum) * i64::from(by)) >> ARGUMENT_BITS) as i32;
    let mut terms = terms.iter();
    let mut sum = 0;
    for most in 0..=DEGREE {
        let row = terms.by_ref().take(most + 1);
        let row = row.fold(0, |row, term| times(row, v).wrapping_add(*term));
        sum = times(sum, u).wrapping_add(row);
    }
    sum.wrapping_add(1 << (TERM_BITS - 1)) >> TERM_BITS
}

/// A bound of all sums in the polynomial: that of the terms' sizes at the greatest arguments, and what rounding adds.
pub fn greatest_sum(terms: &[i32; TERMS]) -> f64 {
    let greatest = f64::from(COORDINATE_LIMIT) / f64::from(1_u32 << ARGUMENT_BITS);
    let mut terms = terms.iter().map(|term| f64::from(*term).abs());
    let rounded = f64::from(1_u32 << TERM_BITS);
    (0..=DEGREE).fold(rounded, |sum, most| {
        let row = terms.by_ref().take(most + 1);
        sum * greatest + row.fold(0.0, |row, term| row * greatest + term)
    })
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
    fn terms_within_the_bound_do_not_wrap_at_the_greatest_arguments() {
        let most = i64::from(COORDINATE_LIMIT);
        // 1 + 2 s + 3 s^2 .. 7 s^6 at s = sqrt 2 is 131.1.
        let size = (f64::from(i32::MAX) / 131.2) as i32;
        let signs = |u: i64, v: i64| {
            let powers =
                (0..=DEGREE).flat_map(|row| (0..=row).map(move |j| (DEGREE - row, row - j)));
            let sign = |(i, j)| u.signum().pow(i as u32) * v.signum().pow(j as u32);
            let mut terms = powers.map(|powers| size * sign(powers) as i32);
            [(); TERMS].map(|()| terms.next().unwrap())
        };
        for (u, v) in [(most, most), (-most, most), (-most, -most)] {
            let terms = signs(u, v);
            let bound = greatest_sum(&terms);
            assert!(
                bound < f64::from(i32::MAX) && bound > 0.99 * f64::from(i32::MAX),
                "{bound}"
            );
            let sum = f64::from(polynomial(&terms, u as i16, v as i16) << TERM_BITS);
            assert!((sum / bound - 1.0).abs() < 1e-3, "{sum} {bound}");
        }
    }
}

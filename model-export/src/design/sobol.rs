//! Sobol's sequence: points that fill a box evenly, without gaps and without chance.
//!
//! Direction numbers of Joe and Kuo (SIAM J. Sci. Comput. 30, 2008; new-joe-kuo-6.21201), in Gray's order.

/// Dimensions at most.
pub const DIMENSIONS: usize = 8;

/// Bits of a coordinate.
const BITS: usize = 32;

/// Of the dimensions after the first: degree of the primitive polynomial, its inner coefficients, and the
/// first direction numbers.
const POLYNOMIALS: [(usize, u32, &[u32]); DIMENSIONS - 1] = [
    (1, 0, &[1]),
    (2, 1, &[1, 3]),
    (3, 1, &[1, 3, 1]),
    (3, 2, &[1, 1, 1]),
    (4, 1, &[1, 1, 3, 3]),
    (4, 4, &[1, 3, 5, 13]),
    (5, 2, &[1, 1, 5, 5, 17]),
];

/// The point of that number in the unit box, from the middle on: the corner of zeros is left out.
pub fn point(number: u32) -> [f64; DIMENSIONS] {
    // Half of the last bit keeps a coordinate off both ends.
    let half = 0.5 * 2.0_f64.powi(-(BITS as i32));
    coordinates(number + 1).map(|bits| f64::from(bits) * 2.0 * half + half)
}

fn coordinates(number: u32) -> [u32; DIMENSIONS] {
    let gray = number ^ (number >> 1);
    std::array::from_fn(|dimension| {
        let directions = directions(dimension);
        let set = (0..BITS).filter(|bit| gray >> bit & 1 == 1);
        set.fold(0, |sum, bit| sum ^ directions[bit])
    })
}

fn directions(dimension: usize) -> [u32; BITS] {
    let mut directions = std::array::from_fn(|bit| 1 << (BITS - 1 - bit));
    let Some((degree, inner, first)) = dimension.checked_sub(1).map(|i| POLYNOMIALS[i]) else {
        return directions;
    };
    for bit in 0..BITS {
        directions[bit] = match first.get(bit) {
            Some(number) => number << (BITS - 1 - bit),
            None => {
                let before = directions[bit - degree];
                let terms = (1..degree).filter(|k| inner >> (degree - 1 - k) & 1 == 1);
                let inner = terms.fold(0, |sum, k| sum ^ directions[bit - k]);
                before ^ (before >> degree) ^ inner
            }
        };
    }
    directions
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_points_are_the_published_ones() {
        let begins = |number: u32| {
            let all = point(number);
            [0, 1, 2].map(|i| (all[i] * 1024.0).round() / 1024.0)
        };
        assert_eq!(begins(0), [0.5, 0.5, 0.5]);
        assert_eq!(begins(1), [0.75, 0.25, 0.25]);
        assert_eq!(begins(2), [0.25, 0.75, 0.75]);
        assert_eq!(begins(3), [0.375, 0.375, 0.625]);
    }

    #[test]
    fn every_slice_of_every_dimension_holds_its_share() {
        // Of any 2^k numbers that begin at a multiple of it, each of 2^k slices holds one.
        for dimension in 0..DIMENSIONS {
            let mut slices: Vec<u32> = (1023..2047)
                .map(|number| (point(number)[dimension] * 1024.0) as u32)
                .collect();
            slices.sort_unstable();
            assert!(
                slices
                    .iter()
                    .enumerate()
                    .all(|(i, slice)| *slice == i as u32)
            );
        }
    }

    #[test]
    fn two_dimensions_together_leave_no_square_empty() {
        for other in 1..DIMENSIONS {
            let mut filled = [false; 64];
            for number in 0..1024 {
                let all = point(number);
                filled[(all[0] * 8.0) as usize * 8 + (all[other] * 8.0) as usize] = true;
            }
            assert!(filled.into_iter().all(|square| square), "{other}");
        }
    }
}

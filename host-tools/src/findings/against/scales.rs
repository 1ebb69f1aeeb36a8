//! Columns in another unit.

use model_export::effects::Track;
use model_export::recordings::columns::Axis;
use nalgebra::Vector3;

use super::case::{Case, mean_square};
use super::hypothesis::{Hypothesis, Tried};

/// A gain within this factor of 1 may be a magnet, a spring or an amplifier.
pub const A_UNIT: f64 = 3.0;
/// A factor this near to that of a unit, as a share, is that unit.
const NAMED_WITHIN: f64 = 0.05;
/// Factors that are tried for forces: powers of ten, from and to, and steps in each.
const DECADES: (i32, i32) = (-4, 4);
/// See [`DECADES`].
const STEPS: i32 = 4;
/// Halvings of a step as the best factor is refined: to a ten-thousandth of a decade.
const REFINEMENTS: usize = 12;

/// Units in which a field is written by mistake, with gauss in one of them.
const OF_FIELD: [(&str, f64); 5] = [
    ("mT", 10.0),
    ("uT", 0.01),
    ("mG", 1e-3),
    ("T", 1e4),
    ("nT", 1e-5),
];
/// Units in which a force is written by mistake, with newtons in one of them.
const OF_FORCE: [(&str, f64); 5] = [
    ("kgf", 9.806_65),
    ("gf", 9.806_65e-3),
    ("mN", 1e-3),
    ("kN", 1e3),
    ("lbf", 4.448_222),
];

/// Name and exact factor of a field's unit.
pub fn field_unit(factor: f64) -> Option<(&'static str, f64)> {
    named(&OF_FIELD, factor)
}

/// Name and exact factor of a force's unit.
pub fn force_unit(factor: f64) -> Option<(&'static str, f64)> {
    named(&OF_FORCE, factor)
}

fn named(units: &[(&'static str, f64)], factor: f64) -> Option<(&'static str, f64)> {
    let near = |(_, exact): &&(&str, f64)| (factor / exact - 1.0).abs() < NAMED_WITHIN;
    units.iter().find(near).copied()
}

/// True for a factor that no magnet, spring or amplifier explains.
fn is_a_unit(factor: f64) -> bool {
    factor.is_finite() && (factor > A_UNIT || (factor > 0.0 && factor < 1.0 / A_UNIT))
}

/// The field times the factor that suits the model best.
pub fn field(case: &Case) -> Option<Tried> {
    let pairs = || case.measured.iter().zip(&case.modelled);
    let both: f64 = pairs()
        .map(|(measured, modelled)| measured.dot(modelled))
        .sum();
    let own: f64 = pairs().map(|(measured, _)| measured.norm_squared()).sum();
    let factor = both / own;
    let scaled: Vec<Vector3<f64>> = case.measured.iter().map(|field| field * factor).collect();
    is_a_unit(factor).then(|| Tried {
        hypothesis: Hypothesis::FieldUnit(factor),
        left: mean_square(&scaled, &case.modelled),
        cost: 1,
    })
}

/// The forces times the factor that suits the model best: both, and each alone.
pub fn forces(case: &Case) -> Vec<Tried> {
    let has = |wanted| case.forces.iter().any(|(_, axis)| *axis == wanted);
    let alone = [[true, false], [false, true], [true, true]];
    let recorded = [has(Axis::X), has(Axis::Z)];
    alone
        .into_iter()
        .filter(|which| (0..2).all(|axis| recorded[axis] || !which[axis]))
        .filter_map(|which| {
            let factors = |factor: f64| which.map(|scaled| if scaled { factor } else { 1.0 });
            let left = |decade: f64| {
                let factor = 10_f64.powf(decade);
                case.left_under(&scaled(&case.track, factors(factor)))
            };
            let (decade, left) = least(left);
            let factor = 10_f64.powf(decade);
            is_a_unit(factor).then(|| Tried {
                hypothesis: Hypothesis::ForceUnit(factors(factor)),
                left,
                cost: which.iter().filter(|scaled| **scaled).count(),
            })
        })
        .collect()
}

/// Where the function of the decade is least, and its value there.
fn least(of: impl Fn(f64) -> f64) -> (f64, f64) {
    let mut step = 1.0 / f64::from(STEPS);
    let mut best = (DECADES.0 * STEPS..=DECADES.1 * STEPS)
        .map(|i| f64::from(i) * step)
        .map(|decade| (decade, of(decade)))
        .fold((0.0, f64::INFINITY), |best, next| {
            if next.1 < best.1 { next } else { best }
        });
    for _ in 0..REFINEMENTS {
        step *= 0.5;
        for decade in [best.0 - step, best.0 + step] {
            let left = of(decade);
            if left < best.1 {
                best = (decade, left);
            }
        }
    }
    best
}

fn scaled(track: &Track, factors: [f64; 2]) -> Track {
    let times = |pairs: &[[f64; 2]]| -> Vec<[f64; 2]> {
        let pair = |[x, z]: &[f64; 2]| [factors[0] * x, factors[1] * z];
        pairs.iter().map(pair).collect()
    };
    Track {
        force_n: times(&track.force_n),
        smooth_n: times(&track.smooth_n),
        rate_n_per_s: times(&track.rate_n_per_s),
        ..track.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_named_within_five_percent() {
        assert_eq!(force_unit(9.5).map(|(name, _)| name), Some("kgf"));
        assert_eq!(force_unit(9.2), None);
        assert_eq!(field_unit(0.0102).map(|(name, _)| name), Some("uT"));
        assert_eq!(field_unit(1.0), None);
    }

    #[test]
    fn the_best_factor_is_found_to_a_tenth_of_a_percent() {
        let (decade, _) = least(|decade| (decade - 0.991_52).powi(2));
        assert!((decade - 0.991_52).abs() < 4e-4, "{decade}");
    }
}

//! Design optimisation: minimum error for a required force, and maximum force range.

use crate::design::design_file::SensorDesign;
use crate::design::evaluation::DesignEvaluation;
use crate::design::interference::InterferenceSources;
use crate::design::sweep::{Candidate, DesignSpace, SIZES, interference_n, shifts, sweep};
use crate::recordings::description::MagnetShape;

/// Increments of available sizes in mm, in the order of [`SIZES`].
const STEPS_MM: [f64; SIZES.len()] = [0.5, 0.5, 0.05, 0.05, 0.5, 0.5];

/// Number of start designs from a sweep.
const MAX_STARTS: usize = 6;

/// Maximum iterations of a search.
const MAX_ROUNDS: u32 = 200;

/// Optimisation result.
#[derive(Clone, Debug)]
pub struct OptimisedDesign {
    /// The design.
    pub design: SensorDesign,
    /// Evaluation.
    pub evaluation: DesignEvaluation,
    /// Error of a reading by noise and interference, in N.
    pub error_n: f64,
    /// Number of feasible designs of the sweep, and of all.
    pub feasible: (usize, usize),
    /// Sizes at a bound of the space; true for the lower one.
    pub edges: Vec<(&'static str, bool)>,
}

/// Error by noise and interference in N of a design for `force_n`; infinite where it is infeasible.
pub fn error_n(design: &SensorDesign, force_n: f64, sources: &InterferenceSources) -> f64 {
    let evaluation = DesignEvaluation::of(design);
    if !evaluation.covers_range(force_n) {
        return f64::INFINITY;
    }
    let noise_n = evaluation.least_sensitive_axis().noise_n;
    noise_n.hypot(interference_n(&shifts(design, force_n, sources)))
}

/// Design with the minimum error for `force_n` on both axes: coordinate descent in available sizes from the
/// best of `count` samples; `None` where none is feasible.
pub fn optimise(
    base: &SensorDesign,
    space: &DesignSpace,
    force_n: f64,
    count: u32,
    sources: &InterferenceSources,
    done: impl Fn() + Sync,
) -> Option<OptimisedDesign> {
    let base = SensorDesign { force_range_n: force_n, ..base.clone() };
    let candidates = sweep(&base, space, count, sources, done);
    let mut feasible: Vec<&Candidate> =
        candidates.iter().filter(|one| one.works() && one.range_n >= force_n).collect();
    let rough = |one: &Candidate| one.noise_n.hypot(one.interference_n * force_n / one.range_n);
    feasible.sort_by(|a, b| rough(a).total_cmp(&rough(b)));
    let cost = |design: &SensorDesign| error_n(design, force_n, sources);
    let search = Search { base: &base, space, cost: &cost };
    let ends = feasible.iter().take(MAX_STARTS).map(|one| search.downhill(one));
    let (sizes, material, error_n) = ends.flatten().min_by(|(.., a), (.., b)| a.total_cmp(b))?;
    let mut design = space.sized(&base, sizes, &material);
    // States the stiffness of both axes for fits.
    let stiffness = [0, 1]
        .map(|axis| crate::recordings::units::round_significant(design.beam_n_per_mm(axis), 6));
    [design.stiffness_x_n_per_mm, design.stiffness_z_n_per_mm] = stiffness.map(Some);
    Some(OptimisedDesign {
        evaluation: DesignEvaluation::of(&design),
        design,
        error_n,
        feasible: (feasible.len(), candidates.len()),
        edges: search.edges(sizes),
    })
}

/// Design with the maximum force range: coordinate descent in available sizes from the best of `candidates`, which are designs of
/// `space`; `None` where none works.
pub fn widest_range(
    base: &SensorDesign,
    space: &DesignSpace,
    candidates: &[Candidate],
    sources: &InterferenceSources,
) -> Option<Candidate> {
    let mut starts: Vec<&Candidate> = candidates.iter().filter(|one| one.works()).collect();
    starts.sort_by(|a, b| b.range_n.total_cmp(&a.range_n));
    let cost = |design: &SensorDesign| match DesignEvaluation::of(design).range_n() {
        range_n if range_n > 0.0 => -range_n,
        _ => f64::INFINITY,
    };
    let search = Search { base, space, cost: &cost };
    let ends = starts.into_iter().take(MAX_STARTS).map(|one| search.downhill(one));
    let (sizes, material, _) = ends.flatten().min_by(|(.., a), (.., b)| a.total_cmp(b))?;
    Some(Candidate::of(space.sized(base, sizes, &material), sources))
}

/// Sizes, material and cost.
type Found = ([f64; SIZES.len()], String, f64);

struct Search<'a> {
    base: &'a SensorDesign,
    space: &'a DesignSpace,
    /// Infinite where a design is infeasible.
    cost: &'a dyn Fn(&SensorDesign) -> f64,
}

impl Search<'_> {
    fn cost(&self, sizes: [f64; SIZES.len()], material: &str) -> f64 {
        (self.cost)(&self.space.sized(self.base, sizes, material))
    }

    /// Coordinate descent from a candidate; `None` where rounded sizes are infeasible.
    fn downhill(&self, start: &Candidate) -> Option<Found> {
        let beam = &start.design.flexure_x;
        let MagnetShape::Cylinder { diameter_mm, length_mm } = start.design.magnet.shape else {
            return None;
        };
        let exact = [
            beam.length_mm,
            beam.width_mm,
            beam.thickness_mm,
            start.design.gap_mm,
            diameter_mm,
            length_mm,
        ];
        let material = beam.material.clone();
        let mut sizes = std::array::from_fn(|i| self.within(i, exact[i]));
        let mut cost = self.cost(sizes, &material);
        for _ in 0..MAX_ROUNDS {
            let tries = (0..SIZES.len()).flat_map(|i| [-8.0, -1.0, 1.0, 8.0].map(|by| (i, by)));
            let better = tries
                .map(|(i, by)| {
                    let mut sizes = sizes;
                    sizes[i] = self.within(i, sizes[i] + by * STEPS_MM[i]);
                    (sizes, self.cost(sizes, &material))
                })
                .min_by(|(_, a), (_, b)| a.total_cmp(b));
            match better {
                Some((tried, lower)) if lower < cost => (sizes, cost) = (tried, lower),
                _ => break,
            }
        }
        cost.is_finite().then_some((sizes, material, cost))
    }

    /// Nearest available size within the space.
    fn within(&self, i: usize, size_mm: f64) -> f64 {
        let [min, max] = self.space.sizes_mm[i];
        let step = STEPS_MM[i];
        // Removes digits due to binary rounding.
        let made = crate::recordings::units::round_significant((size_mm / step).round() * step, 9);
        made.clamp(min, max)
    }

    fn edges(&self, sizes: [f64; SIZES.len()]) -> Vec<(&'static str, bool)> {
        let all = SIZES.into_iter().zip(sizes).zip(self.space.sizes_mm);
        all.filter_map(|((name, size), [min, max])| match size {
            size if size <= min => Some((name, true)),
            size if size >= max => Some((name, false)),
            _ => None,
        })
        .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picked(force_n: f64) -> Option<OptimisedDesign> {
        let sources = InterferenceSources::assumed(1, 8);
        optimise(&SensorDesign::magpie(), &DesignSpace::default(), force_n, 400, &sources, || {})
    }

    #[test]
    fn optimum_meets_its_force_and_beats_magpie() {
        let found = picked(250.0).unwrap();
        assert!(found.evaluation.covers_range(250.0));
        let own = error_n(&SensorDesign::magpie(), 250.0, &InterferenceSources::assumed(1, 8));
        assert!(found.error_n < own, "{} {own}", found.error_n);
        let (feasible, all) = found.feasible;
        assert!(feasible > 0 && feasible < all && all == 400);
    }

    #[test]
    fn error_grows_with_the_required_force() {
        let [small, great] = [20.0, 400.0].map(|force_n| picked(force_n).unwrap());
        assert!(small.error_n < great.error_n);
    }

    #[test]
    fn a_million_newtons_are_infeasible() {
        assert!(picked(1e6).is_none());
    }
}

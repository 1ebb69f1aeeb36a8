//! A design for a force: the one that tells it best, of those that bear it.

use super::design::Design;
use super::interference::Surroundings;
use super::judge::Judged;
use super::sweep::{Candidate, SIZES, Space, interfering_n, shifts, sweep};
use crate::recordings::description::Shape;

/// Sizes are made or sold in steps of so many mm, in the order of [`SIZES`].
const STEPS_MM: [f64; SIZES.len()] = [0.5, 0.5, 0.05, 0.05, 0.5, 0.5];

/// Designs of a sweep from which the search goes on.
const STARTS: usize = 6;

/// Rounds of a search at most.
const ROUNDS: u32 = 200;

/// A proposal.
#[derive(Clone, Debug)]
pub struct Picked {
    /// The design.
    pub design: Design,
    /// What it measures.
    pub judged: Judged,
    /// What a reading of it may be off by, noise and what interferes, in N.
    pub error_n: f64,
    /// Designs of the sweep that bear the force, of all.
    pub bearing: (usize, usize),
    /// Sizes of the space that the design lies on the edge of, and whether it is the lower one.
    pub edges: Vec<(&'static str, bool)>,
}

/// Noise and what interferes in N, of a design that is asked for `force_n`; infinite where it does not
/// bear it.
pub fn error_n(design: &Design, force_n: f64, around: &Surroundings) -> f64 {
    let judged = Judged::of(design);
    if !judged.reaches(force_n) {
        return f64::INFINITY;
    }
    let noise_n = judged.blunter().noise_n;
    noise_n.hypot(interfering_n(&shifts(design, force_n, around)))
}

/// The design of the space with the least error that bears `force_n` on both axes: the best of `count`
/// evenly spread ones, then downhill in steps that can be made; `None` where none bears it.
pub fn pick(
    base: &Design,
    space: &Space,
    force_n: f64,
    count: u32,
    around: &Surroundings,
    done: impl Fn() + Sync,
) -> Option<Picked> {
    let base = Design {
        force_range_n: force_n,
        ..base.clone()
    };
    let candidates = sweep(&base, space, count, around, done);
    let mut bearing: Vec<&Candidate> = candidates
        .iter()
        .filter(|one| one.works() && one.range_n >= force_n)
        .collect();
    let rough = |one: &Candidate| {
        one.noise_n
            .hypot(one.interference_n * force_n / one.range_n)
    };
    bearing.sort_by(|a, b| rough(a).total_cmp(&rough(b)));
    let search = Search {
        base: &base,
        space,
        force_n,
        around,
    };
    let ends = bearing.iter().take(STARTS).map(|one| search.downhill(one));
    let (sizes, material, error_n) = ends.flatten().min_by(|(.., a), (.., b)| a.total_cmp(b))?;
    let mut design = space.sized(&base, sizes, &material);
    // The file says what the axes have, for the fit that reads it.
    let stiffness = [0, 1].map(|axis| crate::quantity::rounded(design.beam_n_per_mm(axis), 6));
    [design.stiffness_x_n_per_mm, design.stiffness_z_n_per_mm] = stiffness.map(Some);
    Some(Picked {
        judged: Judged::of(&design),
        design,
        error_n,
        bearing: (bearing.len(), candidates.len()),
        edges: search.edges(sizes),
    })
}

/// Sizes, material and error.
type Found = ([f64; SIZES.len()], String, f64);

struct Search<'a> {
    base: &'a Design,
    space: &'a Space,
    force_n: f64,
    around: &'a Surroundings,
}

impl Search<'_> {
    fn error_n(&self, sizes: [f64; SIZES.len()], material: &str) -> f64 {
        let design = self.space.sized(self.base, sizes, material);
        error_n(&design, self.force_n, self.around)
    }

    /// Downhill from a candidate, one size at a time; `None` where rounding its sizes lost it.
    fn downhill(&self, start: &Candidate) -> Option<Found> {
        let beam = &start.design.flexure_x;
        let Shape::Cylinder {
            diameter_mm,
            length_mm,
        } = start.design.magnet.shape
        else {
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
        let mut error_n = self.error_n(sizes, &material);
        for _ in 0..ROUNDS {
            let tries = (0..SIZES.len()).flat_map(|i| [-8.0, -1.0, 1.0, 8.0].map(|by| (i, by)));
            let better = tries
                .map(|(i, by)| {
                    let mut sizes = sizes;
                    sizes[i] = self.within(i, sizes[i] + by * STEPS_MM[i]);
                    (sizes, self.error_n(sizes, &material))
                })
                .min_by(|(_, a), (_, b)| a.total_cmp(b));
            match better {
                Some((tried, error)) if error < error_n => (sizes, error_n) = (tried, error),
                _ => break,
            }
        }
        error_n.is_finite().then_some((sizes, material, error_n))
    }

    /// A size that can be made, within the space.
    fn within(&self, i: usize, size_mm: f64) -> f64 {
        let [least, most] = self.space.sizes_mm[i];
        let step = STEPS_MM[i];
        // Digits that the steps do not have would only come from binary.
        let made = crate::quantity::rounded((size_mm / step).round() * step, 9);
        made.clamp(least, most)
    }

    fn edges(&self, sizes: [f64; SIZES.len()]) -> Vec<(&'static str, bool)> {
        let all = SIZES.into_iter().zip(sizes).zip(self.space.sizes_mm);
        all.filter_map(|((name, size), [least, most])| match size {
            size if size <= least => Some((name, true)),
            size if size >= most => Some((name, false)),
            _ => None,
        })
        .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picked(force_n: f64) -> Option<Picked> {
        let around = Surroundings::assumed(1, 8);
        pick(
            &Design::magpie(),
            &Space::default(),
            force_n,
            400,
            &around,
            || {},
        )
    }

    #[test]
    fn a_proposal_bears_its_force_and_is_better_than_the_gripper_s_own_design() {
        let found = picked(250.0).unwrap();
        assert!(found.judged.reaches(250.0));
        let own = error_n(&Design::magpie(), 250.0, &Surroundings::assumed(1, 8));
        assert!(found.error_n < own, "{} {own}", found.error_n);
        let (bearing, all) = found.bearing;
        assert!(bearing > 0 && bearing < all && all == 400);
    }

    #[test]
    fn a_greater_force_is_told_less_well() {
        let [small, great] = [20.0, 400.0].map(|force_n| picked(force_n).unwrap());
        assert!(small.error_n < great.error_n);
    }

    #[test]
    fn nothing_bears_a_million_newtons() {
        assert!(picked(1e6).is_none());
    }
}

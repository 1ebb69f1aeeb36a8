//! Many designs at once: a space of beams, magnets, gaps and materials, sampled evenly or on a grid, and judged.

use rayon::prelude::*;

use super::beam::Support;
use super::design::{Design, Flexure};
use super::interference::{self, Scatter, Sensed, Shift, Surroundings};
use super::judge::Judged;
use super::limits::Cause;
use super::material::MATERIALS;
use super::points::{Points, Sample};
use super::{pareto, sobol};
use crate::physics::ForwardModel;
use crate::recordings::description::Shape;

/// Designs of a sweep.
pub const COUNT: u32 = 10_000;

/// Of a space's sizes: the name, as options and tables have it, and the unit is mm.
pub const SIZES: [&str; 6] = ["length", "width", "thickness", "gap", "diameter", "height"];

/// The shift that stands in a reading at rest, and that a tare takes off.
const AT_REST: &str = "misalignment";

/// Where designs are looked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Space {
    /// Least and greatest of each of [`SIZES`] in mm: beam's length, width and thickness, gap, magnet's
    /// diameter and length. Between them sizes are spread evenly by their logarithm.
    pub sizes_mm: [[f64; 2]; SIZES.len()],
    /// Materials, by their names.
    pub materials: Vec<String>,
    /// How both beams are held.
    pub support: Support,
    /// Which of its designs are looked at.
    pub sample: Sample,
}

impl Default for Space {
    /// What fits into a finger: cantilevers of every material, magnets that are sold.
    fn default() -> Self {
        Self {
            sizes_mm: [
                [10.0, 60.0],
                [5.0, 20.0],
                [1.0, 8.0],
                [1.0, 4.0],
                [1.0, 8.0],
                [1.0, 8.0],
            ],
            materials: MATERIALS.map(|material| material.name.to_owned()).to_vec(),
            support: Support::ClampedFree,
            sample: Sample::Sobol,
        }
    }
}

impl Space {
    /// Where a sweep of `count` designs looks; on a grid there are about so many.
    pub fn points(&self, count: u32) -> Points {
        // Coordinates that the space does not use.
        let mut fixed = [Some(1); sobol::DIMENSIONS];
        for (fixed, [least, most]) in fixed.iter_mut().zip(self.sizes_mm) {
            *fixed = (least == most).then_some(1);
        }
        fixed[SIZES.len()] = Some(self.materials.len() as u32);
        Points::of(self.sample, count, fixed)
    }

    /// The design of a point in the unit box; what the space does not hold is that of `base`. Both axes
    /// have the same beam, and no mount but the beam is soft.
    pub fn design(&self, base: &Design, point: &[f64; sobol::DIMENSIONS]) -> Design {
        let size = |i: usize| {
            let [least, most] = self.sizes_mm[i];
            least * (most / least).powf(point[i])
        };
        let count = self.materials.len();
        let material = ((point[SIZES.len()] * count as f64) as usize).min(count.saturating_sub(1));
        let sizes = std::array::from_fn(size);
        self.sized(base, sizes, &self.materials[material])
    }

    /// The design of these sizes.
    pub fn sized(&self, base: &Design, sizes_mm: [f64; SIZES.len()], material: &str) -> Design {
        let [
            length_mm,
            width_mm,
            thickness_mm,
            gap_mm,
            diameter_mm,
            height_mm,
        ] = sizes_mm;
        let flexure = Flexure {
            support: self.support,
            material: material.to_owned(),
            length_mm,
            width_mm,
            thickness_mm,
        };
        let mut design = Design {
            gap_mm,
            stiffness_x_n_per_mm: None,
            stiffness_z_n_per_mm: None,
            flexure_x: flexure.clone(),
            flexure_z: flexure,
            ..base.clone()
        };
        design.magnet.shape = Shape::Cylinder {
            diameter_mm,
            length_mm: height_mm,
        };
        design.magnet.body_axis = None;
        design
    }
}

/// A design of a sweep, and what became of it.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The design.
    pub design: Design,
    /// Force that both axes measure, either sign, in N.
    pub range_n: f64,
    /// What ends it.
    pub cause: Cause,
    /// Field for each newton at rest, the blunter axis, in G/N.
    pub g_per_n: f64,
    /// Everything that interferes, root of the sum of squares, in N; see [`interfering_n`].
    pub interference_n: f64,
    /// Noise of one reading in N.
    pub noise_n: f64,
}

impl Candidate {
    /// A design judged, at the force that it measures.
    pub fn of(design: Design, around: &Surroundings) -> Self {
        let judged = Judged::of(&design);
        let blunt = judged.blunter();
        let range_n = judged.range_n();
        let (_, cause) = judged.shorter().limits.binding();
        let interference_n = match range_n > 0.0 {
            true => interfering_n(&shifts(&design, range_n, around)),
            false => f64::INFINITY,
        };
        Self {
            range_n,
            cause,
            g_per_n: blunt.g_per_n,
            noise_n: blunt.noise_n,
            interference_n,
            design,
        }
    }

    /// Whether it measures anything.
    pub fn works(&self) -> bool {
        self.range_n > 0.0 && self.interference_n.is_finite() && self.g_per_n > 0.0
    }
}

/// What interferes with a design that measures up to `force_n`.
pub fn shifts(design: &Design, force_n: f64, around: &Surroundings) -> Vec<Shift> {
    let mut nominal = design.nominal();
    nominal.force_range_n = Some(force_n);
    let tolerances = design.tolerances;
    let sensed = Sensed {
        model: ForwardModel::nominal(&nominal),
        resolution_g: design.sensor.gauss_per_lsb,
        // A tolerance is two standard deviations.
        scatter: Scatter {
            offset_mm: 0.5 * tolerances.offset_mm,
            gap_mm: 0.5 * tolerances.gap_mm,
            tilt_rad: 0.5 * tolerances.tilt_deg.to_radians(),
            remanence: 0.5 * tolerances.remanence,
        },
    };
    interference::of(&sensed, around)
}

/// Root of the sum of squares in N of what is left after a tare: a constant field is taken off by it.
pub fn interfering_n(shifts: &[Shift]) -> f64 {
    let left = shifts.iter().filter(|shift| shift.name != AT_REST);
    left.map(|shift| shift.newtons * shift.newtons)
        .sum::<f64>()
        .sqrt()
}

/// Judges `count` designs of a space ([`Space::points`]), in parallel; `done` is called after each.
pub fn sweep(
    base: &Design,
    space: &Space,
    count: u32,
    around: &Surroundings,
    done: impl Fn() + Sync,
) -> Vec<Candidate> {
    let points = space.points(count);
    let judge = |number: u32| {
        let candidate = Candidate::of(space.design(base, &points.at(number)), around);
        done();
        candidate
    };
    (0..points.count()).into_par_iter().map(judge).collect()
}

/// Places of those that no other beats in range, sensitivity and interference, the greatest range first.
pub fn front(candidates: &[Candidate]) -> Vec<usize> {
    let goals: Vec<[f64; 3]> = candidates
        .iter()
        .map(|one| match one.works() {
            true => [one.range_n, one.g_per_n, -one.interference_n],
            false => [f64::NAN; 3],
        })
        .collect();
    pareto::front(&goals)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn around() -> Surroundings {
        Surroundings::assumed(1, 8)
    }

    #[test]
    fn sizes_stay_in_their_ranges_and_reach_both_ends() {
        let (base, space) = (Design::magpie(), Space::default());
        let mut seen = [[f64::INFINITY, 0.0_f64]; SIZES.len()];
        for number in 0..1000 {
            let design = space.design(&base, &sobol::point(number));
            let Shape::Cylinder {
                diameter_mm,
                length_mm,
            } = design.magnet.shape
            else {
                panic!("{:?}", design.magnet);
            };
            let beam = &design.flexure_x;
            let sizes = [
                beam.length_mm,
                beam.width_mm,
                beam.thickness_mm,
                design.gap_mm,
                diameter_mm,
                length_mm,
            ];
            for (seen, size) in seen.iter_mut().zip(sizes) {
                *seen = [seen[0].min(size), seen[1].max(size)];
            }
        }
        for ([low, high], [least, most]) in seen.into_iter().zip(space.sizes_mm) {
            assert!(low >= least && low < 1.01 * least, "{low} {least}");
            assert!(high <= most && high > 0.99 * most, "{high} {most}");
        }
    }

    #[test]
    fn a_grid_takes_every_material_with_every_size_and_leaves_alone_what_is_fixed() {
        let mut space = Space {
            sample: Sample::Grid,
            ..Space::default()
        };
        space.sizes_mm[3] = [1.5, 1.5];
        let designs = sweep(&Design::magpie(), &space, 384, &around(), || {});
        // Three values of two sizes, two of three others, six materials.
        assert_eq!(designs.len(), 3 * 3 * 2 * 2 * 2 * 6);
        assert!(designs.iter().all(|one| one.design.gap_mm == 1.5));
        for material in &space.materials {
            let of = designs
                .iter()
                .filter(|one| one.design.flexure_x.material == *material);
            let mut lengths: Vec<f64> = of.map(|one| one.design.flexure_x.length_mm).collect();
            assert_eq!(lengths.len(), 72, "{material}");
            lengths.sort_by(f64::total_cmp);
            assert!((lengths[0] - 10.0).abs() < 1e-9 && (lengths[71] - 60.0).abs() < 1e-9);
        }
    }

    #[test]
    fn a_sweep_is_the_same_whatever_it_runs_on_and_judges_every_design() {
        let (base, space) = (Design::magpie(), Space::default());
        let one = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        let run = || sweep(&base, &space, 64, &around(), || {});
        let (alone, together) = (one.install(run), run());
        assert_eq!(alone.len(), 64);
        for (a, b) in alone.iter().zip(&together) {
            assert_eq!((a.range_n, a.g_per_n), (b.range_n, b.g_per_n));
        }
        let front = front(&together);
        assert!(!front.is_empty() && front.len() < 40);
        assert!(
            front
                .windows(2)
                .all(|pair| together[pair[0]].range_n >= together[pair[1]].range_n)
        );
    }

    #[test]
    fn interference_left_after_a_tare_does_not_count_what_the_tare_takes_off() {
        let shifts = shifts(&Design::magpie(), 250.0, &around());
        let all: f64 = shifts.iter().map(|shift| shift.newtons.powi(2)).sum();
        let left = interfering_n(&shifts);
        assert!(left > 0.0 && left < all.sqrt());
        assert!(shifts.iter().any(|shift| shift.name == AT_REST));
    }
}

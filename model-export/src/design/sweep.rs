//! Design sweep: many designs of a space of beams, magnets, gaps and materials, evaluated in parallel, and
//! their Pareto front.

use crate::design::beam::Support;
use crate::design::design_file::{Flexure, SensorDesign};
use crate::design::evaluation::{DesignEvaluation, RangeLimit};
use crate::design::interference::{
    self, FieldShift, InterferenceSources, MountingScatter, SensorUnderTest,
};
use crate::design::material::MATERIALS;
use crate::design::sampling::{self, SamplePoints, SamplingMethod};
use crate::physics::ForwardModel;
use crate::recordings::description::MagnetShape;
use rayon::prelude::*;

/// Default number of designs.
pub const DEFAULT_COUNT: u32 = 10_000;

/// Names of the sizes in options and tables; in mm.
pub const SIZES: [&str; 6] = ["length", "width", "thickness", "gap", "diameter", "height"];

/// Shift at rest, which a tare removes.
const REMOVED_BY_TARE: &str = "misalignment";

/// Design space.
#[derive(Clone, Debug, PartialEq)]
pub struct DesignSpace {
    /// Minimum and maximum of each of [`SIZES`] in mm: beam length, width and thickness, gap, magnet diameter
    /// and length. Sizes are distributed logarithmically.
    pub sizes_mm: [[f64; 2]; SIZES.len()],
    /// Names of materials.
    pub materials: Vec<String>,
    /// Boundary conditions of both beams.
    pub support: Support,
    /// Sampling method.
    pub sample: SamplingMethod,
}

impl Default for DesignSpace {
    /// Sizes that fit a finger: cantilevers of every material, commercial magnets.
    fn default() -> Self {
        Self {
            sizes_mm: [[10.0, 60.0], [5.0, 20.0], [1.0, 8.0], [1.0, 4.0], [1.0, 8.0], [1.0, 8.0]],
            materials: MATERIALS.map(|material| material.name.to_owned()).to_vec(),
            support: Support::ClampedFree,
            sample: SamplingMethod::Sobol,
        }
    }
}

impl DesignSpace {
    /// Sample points for about `count` designs.
    pub fn points(&self, count: u32) -> SamplePoints {
        // Unused coordinates have one value.
        let mut fixed = [Some(1); sampling::DIMENSIONS];
        for (fixed, [min, max]) in fixed.iter_mut().zip(self.sizes_mm) {
            *fixed = (min == max).then_some(1);
        }
        fixed[SIZES.len()] = Some(self.materials.len() as u32);
        SamplePoints::of(self.sample, count, fixed)
    }

    /// Design of a point in the unit box; other properties are those of `base`. Both axes have the same beam
    /// and a rigid mount.
    pub fn design(&self, base: &SensorDesign, point: &[f64; sampling::DIMENSIONS]) -> SensorDesign {
        let size = |i: usize| {
            let [min, max] = self.sizes_mm[i];
            min * (max / min).powf(point[i])
        };
        let count = self.materials.len();
        let material = ((point[SIZES.len()] * count as f64) as usize).min(count.saturating_sub(1));
        let sizes = std::array::from_fn(size);
        self.sized(base, sizes, &self.materials[material])
    }

    /// Design of these sizes.
    pub(crate) fn sized(
        &self,
        base: &SensorDesign,
        sizes_mm: [f64; SIZES.len()],
        material: &str,
    ) -> SensorDesign {
        let [length_mm, width_mm, thickness_mm, gap_mm, diameter_mm, height_mm] = sizes_mm;
        let flexure = Flexure {
            support: self.support,
            material: material.to_owned(),
            length_mm,
            width_mm,
            thickness_mm,
        };
        let mut design = SensorDesign {
            gap_mm,
            stiffness_x_n_per_mm: None,
            stiffness_z_n_per_mm: None,
            flexure_x: flexure.clone(),
            flexure_z: flexure,
            ..base.clone()
        };
        design.magnet.shape = MagnetShape::Cylinder { diameter_mm, length_mm: height_mm };
        design.magnet.body_axis = None;
        design
    }
}

/// An evaluated design of a sweep.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The design.
    pub design: SensorDesign,
    /// Force that both axes measure, either sign, in N.
    pub range_n: f64,
    /// Cause of the end of the range.
    pub cause: RangeLimit,
    /// Sensitivity at rest of the less sensitive axis, in G/N.
    pub g_per_n: f64,
    /// Total interference in N; see [`interference_n`].
    pub interference_n: f64,
    /// Noise of one reading in N.
    pub noise_n: f64,
}

impl Candidate {
    /// Evaluates a design at its own range.
    pub fn of(design: SensorDesign, sources: &InterferenceSources) -> Self {
        let evaluation = DesignEvaluation::of(&design);
        let blunt = evaluation.least_sensitive_axis();
        let range_n = evaluation.range_n();
        let (_, cause) = evaluation.limiting_axis().limits.binding();
        let interference_n = if range_n > 0.0 {
            interference_n(&shifts(&design, range_n, sources))
        } else {
            f64::INFINITY
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

/// Interference of a design with the range `force_n`.
pub fn shifts(
    design: &SensorDesign,
    force_n: f64,
    sources: &InterferenceSources,
) -> Vec<FieldShift> {
    let mut nominal = design.nominal();
    nominal.force_range_n = Some(force_n);
    let tolerances = design.tolerances;
    let sensed = SensorUnderTest {
        model: ForwardModel::nominal(&nominal),
        resolution_g: design.sensor.gauss_per_lsb,
        // A tolerance is two standard deviations.
        scatter: MountingScatter {
            offset_mm: 0.5 * tolerances.offset_mm,
            gap_mm: 0.5 * tolerances.gap_mm,
            tilt_rad: 0.5 * tolerances.tilt_deg.to_radians(),
            remanence: 0.5 * tolerances.remanence,
        },
    };
    interference::field_shifts(&sensed, sources)
}

/// Root sum of squares of the interference in N after a tare.
pub fn interference_n(shifts: &[FieldShift]) -> f64 {
    let left = shifts.iter().filter(|shift| shift.name != REMOVED_BY_TARE);
    left.map(|shift| shift.newtons * shift.newtons).sum::<f64>().sqrt()
}

/// Evaluates `count` designs of a space ([`DesignSpace::points`]) in parallel; `done` is called after each.
pub fn sweep(
    base: &SensorDesign,
    space: &DesignSpace,
    count: u32,
    sources: &InterferenceSources,
    done: impl Fn() + Sync,
) -> Vec<Candidate> {
    let points = space.points(count);
    let evaluate = |number: u32| {
        let candidate = Candidate::of(space.design(base, &points.at(number)), sources);
        done();
        candidate
    };
    (0..points.count()).into_par_iter().map(evaluate).collect()
}

/// Indices of the Pareto front in range, sensitivity and interference, by descending range.
pub fn pareto_front(candidates: &[Candidate]) -> Vec<usize> {
    let goals: Vec<[f64; 3]> = candidates
        .iter()
        .map(|one| {
            if one.works() {
                [one.range_n, one.g_per_n, -one.interference_n]
            } else {
                [f64::NAN; 3]
            }
        })
        .collect();
    non_dominated(&goals)
}

/// Indices of non-dominated points. All goals are maximised.
pub(crate) fn non_dominated<const N: usize>(goals: &[[f64; N]]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..goals.len()).collect();
    order.retain(|i| goals[*i].iter().all(|goal| goal.is_finite()));
    // Sorted: later points cannot dominate, except equals in the first goal.
    order.sort_by(|a, b| {
        let pairs = goals[*b].iter().zip(&goals[*a]);
        pairs.fold(std::cmp::Ordering::Equal, |order, (b, a)| order.then(b.total_cmp(a)))
    });
    let mut front: Vec<usize> = Vec::new();
    for candidate in order {
        if !front.iter().any(|one| beats(&goals[*one], &goals[candidate])) {
            front.push(candidate);
        }
    }
    front
}

fn beats<const N: usize>(one: &[f64; N], other: &[f64; N]) -> bool {
    one.iter().zip(other).all(|(a, b)| a >= b) && one != other
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sources() -> InterferenceSources {
        InterferenceSources::assumed(1, 8)
    }

    #[test]
    fn sweep_sizes_span_their_ranges() {
        let (base, space) = (SensorDesign::magpie(), DesignSpace::default());
        let mut seen = [[f64::INFINITY, 0.0_f64]; SIZES.len()];
        for number in 0..1000 {
            let design = space.design(&base, &sampling::sobol_point(number));
            let MagnetShape::Cylinder { diameter_mm, length_mm } = design.magnet.shape else {
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
        for ([low, high], [min, max]) in seen.into_iter().zip(space.sizes_mm) {
            assert!(low >= min && low < 1.01 * min, "{low} {min}");
            assert!(high <= max && high > 0.99 * max, "{high} {max}");
        }
    }

    #[test]
    fn grid_combines_materials_and_sizes_and_keeps_fixed_ones() {
        let mut space = DesignSpace { sample: SamplingMethod::Grid, ..DesignSpace::default() };
        space.sizes_mm[3] = [1.5, 1.5];
        let designs = sweep(&SensorDesign::magpie(), &space, 384, &sources(), || {});
        // Three values of two sizes, two of three others, six materials.
        assert_eq!(designs.len(), 3 * 3 * 2 * 2 * 2 * 6);
        assert!(designs.iter().all(|one| one.design.gap_mm == 1.5));
        for material in &space.materials {
            let of = designs.iter().filter(|one| one.design.flexure_x.material == *material);
            let mut lengths: Vec<f64> = of.map(|one| one.design.flexure_x.length_mm).collect();
            assert_eq!(lengths.len(), 72, "{material}");
            lengths.sort_by(f64::total_cmp);
            assert!((lengths[0] - 10.0).abs() < 1e-9 && (lengths[71] - 60.0).abs() < 1e-9);
        }
    }

    #[test]
    fn sweep_is_equal_on_any_thread_count() {
        let (base, space) = (SensorDesign::magpie(), DesignSpace::default());
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let run = || sweep(&base, &space, 64, &sources(), || {});
        let (alone, together) = (one.install(run), run());
        assert_eq!(alone.len(), 64);
        for (a, b) in alone.iter().zip(&together) {
            assert_eq!((a.range_n, a.g_per_n), (b.range_n, b.g_per_n));
        }
        let front = pareto_front(&together);
        assert!(!front.is_empty() && front.len() < 40);
        assert!(
            front.windows(2).all(|pair| together[pair[0]].range_n >= together[pair[1]].range_n)
        );
    }

    #[test]
    fn interference_excludes_what_a_tare_removes() {
        let shifts = shifts(&SensorDesign::magpie(), 250.0, &sources());
        let all: f64 = shifts.iter().map(|shift| shift.newtons.powi(2)).sum();
        let left = interference_n(&shifts);
        assert!(left > 0.0 && left < all.sqrt());
        assert!(shifts.iter().any(|shift| shift.name == REMOVED_BY_TARE));
    }

    #[test]
    fn front_has_only_non_dominated_points() {
        let goals = [[1.0, 5.0], [2.0, 4.0], [2.0, 3.0], [0.5, 5.0], [3.0, 1.0], [f64::NAN, 9.0]];
        let mut found = non_dominated(&goals);
        found.sort_unstable();
        assert_eq!(found, [0, 1, 4]);
    }

    proptest! {
        #[test]
        fn every_point_is_on_the_front_or_dominated_by_it(
            goals in prop::collection::vec([0..6_u8, 0..6, 0..6], 1..80),
        ) {
            let goals: Vec<[f64; 3]> = goals.iter().map(|goal| goal.map(f64::from)).collect();
            let found = non_dominated(&goals);
            for (i, goal) in goals.iter().enumerate() {
                let beaten = goals.iter().any(|other| beats(other, goal));
                prop_assert_eq!(found.contains(&i), !beaten);
                let by_front = found.iter().any(|one| beats(&goals[*one], goal));
                prop_assert_eq!(by_front, beaten);
            }
        }
    }
}

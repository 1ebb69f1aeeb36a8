//! Gaussian radial basis functions on a linear part, in floating point, and the samples that they are fitted
//! to.
//!
//! F = bias + slope s + sum w_k exp(-gamma |s - c_k|^2), with s the field scaled to -1 to 1 over the box. The
//! linear part carries most of the force; the functions add the curvature, which limits their weights and
//! rounding errors.

use crate::fit::tall_products::{columns, gram, products};
use crate::inverse::static_model::{DesignBox, ForceRegion, StaticModel};
use crate::physics::sensor::force_per_field;
use nalgebra::{DMatrix, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use wide::f64x4;

/// Functions that are evaluated together.
const LANES: usize = 4;

/// Maximum number of centres along each axis.
pub(crate) const MAX_CENTRES_ACROSS: usize = 8;

/// Hyperparameters of a model.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GrbfShape {
    /// Centres are the fields of a lattice of this many loads along each axis ([`StaticModel::centre_fields`]); none: linear.
    pub centres_across: usize,
    /// Width: exp(-gamma d^2) over coordinates of -1 to 1.
    pub gamma: f64,
    /// Ridge penalty on the squared weights, relative to the mean square of the functions.
    pub ridge: f64,
}

/// The inverse model of one sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Grbf {
    /// Box that defines the coordinates.
    pub design: DesignBox,
    /// Width.
    pub gamma: f64,
    /// Coordinates of the centres.
    pub centres: Vec<Vector3<f64>>,
    /// Weights in newtons for each centre and axis.
    pub weights_n: Vec<[f64; 2]>,
    /// Force at the centre of the box in newtons.
    pub bias_n: [f64; 2],
    /// Force per unit coordinate in newtons, each axis of the force.
    pub slope_n: [Vector3<f64>; 2],
}

impl Grbf {
    /// Fits a model of `shape`; `round` rounds centres to representable coordinates. `None` where the samples
    /// do not determine it.
    pub fn fit(
        model: &StaticModel,
        design: &DesignBox,
        shape: GrbfShape,
        samples: &[FieldSample],
        round: impl Fn(Vector3<f64>) -> Vector3<f64>,
    ) -> Option<Self> {
        Self::fit_ridges(model, design, shape, &[shape.ridge], samples, round).pop()?
    }

    /// Fits one model for each penalty with common normal equations.
    pub(crate) fn fit_ridges(
        model: &StaticModel,
        design: &DesignBox,
        shape: GrbfShape,
        ridges: &[f64],
        samples: &[FieldSample],
        round: impl Fn(Vector3<f64>) -> Vector3<f64>,
    ) -> Vec<Option<Self>> {
        let centres: Vec<Vector3<f64>> = match shape.centres_across {
            0 => Vec::new(),
            n => {
                let fields = model.centre_fields(n).into_iter();
                fields.map(|field| round(design.coordinates(&field))).collect()
            }
        };
        let unsolved = Self {
            design: *design,
            gamma: shape.gamma,
            centres,
            weights_n: Vec::new(),
            bias_n: [0.0; 2],
            slope_n: [Vector3::zeros(); 2],
        };
        let width = 4 + unsolved.centres.len();
        let regressors = unsolved.regressors(samples);
        let forces = DMatrix::from_fn(samples.len(), 2, |row, axis| samples[row].force_n[axis]);
        let regressors = columns(&regressors, 0..samples.len());
        let normal = gram(&regressors);
        let right = products(&regressors, &columns(&forces, 0..samples.len()));
        let solve = |ridge: &f64| {
            let mut normal = normal.clone();
            for i in 0..width {
                // The linear part has a tiny penalty for conditioning.
                let share = if i < 4 { 1e-12 } else { *ridge };
                normal[(i, i)] += share * samples.len() as f64;
            }
            Some(unsolved.clone().solved(&normal.cholesky()?.solve(&right)))
        };
        ridges.iter().map(solve).collect()
    }

    fn solved(mut self, solution: &DMatrix<f64>) -> Self {
        self.bias_n = [solution[(0, 0)], solution[(0, 1)]];
        self.slope_n = [0, 1].map(|axis| Vector3::from_fn(|i, _| solution[(1 + i, axis)]));
        self.weights_n =
            (4..solution.nrows()).map(|i| [solution[(i, 0)], solution[(i, 1)]]).collect();
        self
    }

    /// Linear part and functions at the samples: a row for each.
    fn regressors(&self, samples: &[FieldSample]) -> DMatrix<f64> {
        let coordinates: Vec<Vector3<f64>> =
            samples.iter().map(|sample| self.design.coordinates(&sample.field_g)).collect();
        DMatrix::from_fn(samples.len(), 4 + self.centres.len(), |row, column| {
            let s = coordinates[row];
            match column.checked_sub(4) {
                Some(centre) => libm::exp(-self.gamma * (s - self.centres[centre]).norm_squared()),
                None if column == 0 => 1.0,
                None => s[column - 1],
            }
        })
    }

    /// The same model with its functions in groups that are evaluated together.
    pub fn lanes(&self) -> GrbfLanes {
        let group = |(centres, weights): (&[Vector3<f64>], &[[f64; 2]])| {
            // Lanes without a centre have no weight.
            let mut group = LaneGroup::default();
            for (lane, (centre, weight)) in centres.iter().zip(weights).enumerate() {
                for axis in 0..3 {
                    group.centres[axis].as_array_mut()[lane] = centre[axis];
                }
                for (lanes, weight) in group.weights_n.iter_mut().zip(weight) {
                    lanes.as_array_mut()[lane] = *weight;
                }
            }
            group
        };
        let groups = self.centres.chunks(LANES).zip(self.weights_n.chunks(LANES));
        GrbfLanes {
            design: self.design,
            gamma: self.gamma,
            groups: groups.map(group).collect(),
            bias_n: self.bias_n,
            slope_n: self.slope_n,
        }
    }
}

/// Centres and weights of functions that are evaluated together.
#[derive(Clone, Copy, Debug, Default)]
struct LaneGroup {
    centres: [f64x4; 3],
    weights_n: [f64x4; 2],
}

/// A [`Grbf`] for evaluation, four functions at a time.
#[derive(Clone, Debug)]
pub struct GrbfLanes {
    design: DesignBox,
    gamma: f64,
    groups: Vec<LaneGroup>,
    bias_n: [f64; 2],
    slope_n: [Vector3<f64>; 2],
}

impl GrbfLanes {
    /// Forces in newtons at a field in gauss.
    pub fn force(&self, field_g: &Vector3<f64>) -> [f64; 2] {
        let s = self.design.coordinates(field_g);
        let at = [s.x, s.y, s.z].map(f64x4::splat);
        let factor = f64x4::splat(-self.gamma);
        let mut sums = [f64x4::ZERO; 2];
        for group in &self.groups {
            let [x, y, z] = [0, 1, 2].map(|axis| at[axis] - group.centres[axis]);
            let values = ((x * x + y * y + z * z) * factor).exp();
            sums[0] += values * group.weights_n[0];
            sums[1] += values * group.weights_n[1];
        }
        [0, 1].map(|axis| self.bias_n[axis] + self.slope_n[axis].dot(&s) + sums[axis].reduce_add())
    }
}

/// Root mean square and maximum error of each force axis, in newtons.
pub fn force_errors(
    samples: &[FieldSample],
    force: impl Fn(&Vector3<f64>) -> [f64; 2],
) -> ([f64; 2], [f64; 2]) {
    let mut squares = [0.0_f64; 2];
    let mut worst = [0.0_f64; 2];
    for sample in samples {
        let found = force(&sample.field_g);
        for axis in 0..2 {
            let error = found[axis] - sample.force_n[axis];
            squares[axis] += error * error;
            worst[axis] = worst[axis].max(error.abs());
        }
    }
    let count = samples.len().max(1) as f64;
    ([0, 1].map(|axis| (squares[axis] / count).sqrt()), worst)
}

/// Range of training loads relative to the box, to avoid edge errors.
const OVERRANGE: f64 = 1.08;

/// A field and its forces. Without noise all fields of a sensor are on a surface, and an inverse of three axes
/// would be undefined off it. So samples are also offset from it ([`StaticModel::off_surface`]), with the forces of the nearest
/// point on the surface. The gap axis of a magnet has a low weight in that distance: temperature, a changed gap and a
/// neighbouring magnet act on it first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldSample {
    /// Gauss.
    pub field_g: Vector3<f64>,
    /// Newtons, lateral and longitudinal.
    pub force_n: [f64; 2],
}

/// Training samples: a lattice of loads, on the surface and offset to both sides.
pub fn training_samples(model: &StaticModel, design: &DesignBox) -> Vec<FieldSample> {
    let at = |load: [f64; 2]| {
        let offsets = model.off_surface(load);
        let before = offsets.clone().into_iter().map(|offset| -offset);
        let all = before.chain([Vector3::zeros()]).chain(offsets);
        all.map(move |offset| sample(model, load, offset))
    };
    design.region.scaled(OVERRANGE).lattice(25).flat_map(at).collect()
}

/// Held-out samples: random loads in the box, with random offsets.
pub(crate) fn held_out_samples(
    model: &StaticModel,
    design: &DesignBox,
    count: usize,
    seed: u64,
) -> Vec<FieldSample> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count)
        .map(|_| {
            let load = design.region.at([(); 2].map(|()| rng.random_range(-1.0..=1.0)));
            let offsets = model.off_surface(load).into_iter();
            let offset = offsets.map(|offset| offset * rng.random_range(-1.0..=1.0)).sum();
            sample(model, load, offset)
        })
        .collect()
}

fn sample(model: &StaticModel, load_n: [f64; 2], offset_g: Vector3<f64>) -> FieldSample {
    let field_g = model.field(load_n) + offset_g;
    let is_nearest = model.has_normal_offsets();
    let force_n = if is_nearest { load_n } else { nearest_forces(model, &field_g, load_n) };
    FieldSample { field_g, force_n }
}

/// Step of the force from which on the nearest one is found.
const CONVERGED_N: f64 = 1e-9;

/// Forces whose field is nearest to `field_g`, from a close start (Gauss-Newton).
pub fn nearest_forces(model: &StaticModel, field_g: &Vector3<f64>, start_n: [f64; 2]) -> [f64; 2] {
    let mut force = Vector2::from(start_n);
    for _ in 0..6 {
        let (at_g, per_newton) = model.linearised(force.into());
        let Some(inverse) = force_per_field(&per_newton, model.weights()) else {
            break;
        };
        let step = inverse * (field_g - at_g);
        force += step;
        // The next step would be of rounding errors; without noise the first one is.
        if step.norm() < CONVERGED_N {
            break;
        }
    }
    force.into()
}

/// Errors of an inverse over a lattice of loads.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorMap {
    /// Lateral and longitudinal loads in newtons.
    pub loads_n: [Vec<f64>; 2],
    /// Norm of the error in newtons; a row for each longitudinal load, a column for each lateral one.
    pub errors_n: Vec<Vec<f64>>,
}

impl ErrorMap {
    /// Evaluates `inverse` on `across` by `across` loads of a region of two forces.
    pub fn of(
        model: &StaticModel,
        region: ForceRegion,
        across: usize,
        inverse: impl Fn(&Vector3<f64>) -> [f64; 2],
    ) -> Self {
        let error = |load: [f64; 2]| {
            let found = inverse(&model.field(load));
            (found[0] - load[0]).hypot(found[1] - load[1])
        };
        let errors: Vec<f64> = region.lattice(across).map(error).collect();
        Self {
            loads_n: [0, 1].map(|axis| {
                let of_axis = region.lattice(across).map(|load| load[axis]);
                of_axis.step_by(if axis == 0 { 1 } else { across }).take(across).collect()
            }),
            errors_n: errors.chunks(across).map(<[f64]>::to_vec).collect(),
        }
    }

    /// Maximum error.
    pub fn worst_n(&self) -> f64 {
        self.errors_n.iter().flatten().copied().fold(0.0, f64::max)
    }
}

//! Selection of centres, width and ridge by held-out error of the device's own arithmetic.
//!
//! All sensors have the same hyperparameters, since they share the exponential table and the computing time.
//! Models that the device cannot represent are no candidates.

use std::ops::RangeInclusive;

use rayon::prelude::*;

use crate::inverse::grbf::{
    FieldSample, Grbf, GrbfShape, MAX_CENTRES_ACROSS, force_errors, held_out_samples,
    training_samples,
};
use crate::inverse::parity::ParitySurface;
use crate::inverse::quantise::{TableOverflow, TableSet, representable};
use crate::inverse::static_model::{DesignBox, LINE_CENTRES, StaticModel};

/// Seed of the validation samples.
const SELECTION_SEED: u64 = 11;
/// Seed of the test samples.
const TEST_SEED: u64 = 12;
/// Number of validation and test samples.
const SAMPLES: usize = 1500;

/// Target error over both forces, relative to the noise of one reading; below it fewer centres are preferred.
const TARGET_ERROR: f64 = 1.0 / 3.0;

/// Maximum root mean square rounding error of either force, relative to the noise of one reading.
const MAX_ROUNDING: f64 = 0.07;

/// Candidate numbers of centres along each axis, ascending.
const CENTRES_ACROSS: RangeInclusive<usize> = 4..=MAX_CENTRES_ACROSS;
/// Candidate widths in spacings of the centres.
const WIDTHS: [f64; 5] = [1.0, 1.4, 2.0, 2.8, 4.0];
/// Candidate ridge penalties.
const RIDGES: [f64; 6] = [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8];

/// The linear part alone.
const LINEAR: GrbfShape = GrbfShape { centres_across: 0, gamma: 1.0, ridge: 0.0 };

/// Selected models.
#[derive(Clone, Debug)]
pub struct SelectedModels {
    /// Selected hyperparameters.
    pub shape: GrbfShape,
    /// Forward models, one for each sensor.
    pub forward: Vec<StaticModel>,
    /// Inverse models in floating point, one for each sensor.
    pub models: Vec<Grbf>,
    /// Tables for the device.
    pub tables: TableSet,
    /// Linear models for comparison.
    pub linear: Vec<Grbf>,
    /// Surfaces of the fields, one for each sensor.
    pub surfaces: Vec<ParitySurface>,
    /// Field per count, in gauss.
    pub gauss_per_lsb: f64,
}

/// Errors of one sensor's inverse over the box in newtons, for Fx and Fz: root mean square and maximum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseErrors {
    /// Floating point against the forward model.
    pub model: ([f64; 2], [f64; 2]),
    /// Fixed point against floating point.
    pub fixed: ([f64; 2], [f64; 2]),
    /// Linear model against the forward model.
    pub linear: ([f64; 2], [f64; 2]),
}

struct SensorData<'a> {
    model: &'a StaticModel,
    /// Index of the first sensor with this model.
    index: usize,
    design: DesignBox,
    training: Vec<FieldSample>,
}

/// The sensors to invert, as the device reads them.
struct InverseProblem<'a> {
    models: &'a [StaticModel],
    numbers: &'a [u32],
    id: u16,
    gauss_per_lsb: f64,
    range_gauss: f64,
    /// Sensors that differ: those of a nominal design do not.
    sensors: Vec<SensorData<'a>>,
    /// For each sensor its place among these.
    places: Vec<usize>,
}

/// Fits the inverse models of all sensors with common hyperparameters: `shape`, or the selected ones where none is given or the
/// device cannot represent it.
///
/// # Errors
/// A table cannot be represented.
pub fn select_models(
    models: &[StaticModel],
    numbers: &[u32],
    id: u16,
    gauss_per_lsb: f64,
    range_gauss: f64,
    shape: Option<GrbfShape>,
) -> Result<SelectedModels, TableOverflow> {
    let mut distinct: Vec<(usize, &StaticModel)> = Vec::new();
    let place = |sensor: (usize, _)| {
        let known = distinct.iter().position(|(_, model)| *model == sensor.1);
        known.unwrap_or_else(|| {
            distinct.push(sensor);
            distinct.len() - 1
        })
    };
    let places = models.iter().enumerate().map(place).collect();
    let sensors: Vec<SensorData> = distinct
        .into_par_iter()
        .map(|(index, model)| {
            let (_, design) = DesignBox::of(model).device_scale(gauss_per_lsb);
            SensorData { model, index, design, training: training_samples(model, &design) }
        })
        .collect();
    let problem =
        InverseProblem { models, numbers, id, gauss_per_lsb, range_gauss, sensors, places };
    let is_representable = |shape: &GrbfShape| {
        problem.fit(*shape).is_some_and(|models| problem.tables(&models).is_ok())
    };
    let shape = shape.filter(is_representable).or_else(|| problem.select_shape()).unwrap_or(LINEAR);
    let (Some(chosen), Some(linear)) = (problem.fit(shape), problem.fit(LINEAR)) else {
        return Err(TableOverflow {
            sensor: 0,
            row: "every row".to_owned(),
            value: f64::NAN,
            format: "any shape".to_owned(),
            advice: "the field of this model does not determine the forces: check its parameters",
        });
    };
    Ok(SelectedModels {
        shape,
        surfaces: problem.of_each(
            problem
                .sensors
                .par_iter()
                .map(|sensor| ParitySurface::of(sensor.model, &sensor.design))
                .collect(),
        ),
        forward: models.to_vec(),
        tables: problem.tables(&chosen)?,
        models: chosen,
        linear,
        gauss_per_lsb,
    })
}

impl InverseProblem<'_> {
    fn fit(&self, shape: GrbfShape) -> Option<Vec<Grbf>> {
        let fit = |s: &SensorData| Grbf::fit(s.model, &s.design, shape, &s.training, representable);
        Some(self.of_each(self.sensors.iter().map(fit).collect::<Option<_>>()?))
    }

    /// What belongs to each sensor, from what belongs to those that differ.
    fn of_each<T: Clone>(&self, distinct: Vec<T>) -> Vec<T> {
        self.places.iter().map(|place| distinct[*place].clone()).collect()
    }

    fn tables(&self, models: &[Grbf]) -> Result<TableSet, TableOverflow> {
        TableSet::build(self.id, models, self.numbers, self.gauss_per_lsb, self.range_gauss)
    }

    /// The smallest shape that reaches the target error, or the best; `None` if the device can represent none.
    fn select_shape(&self) -> Option<GrbfShape> {
        let validation: Vec<Vec<FieldSample>> = self
            .sensors
            .par_iter()
            .map(|sensor| held_out_samples(sensor.model, &sensor.design, SAMPLES, SELECTION_SEED))
            .collect();
        let noise_n = noise_n(self.models);
        // Error of a candidate over all sensors, and whether its rounding is small; `None` where the device cannot represent it.
        let evaluate = |models: &[Grbf]| -> Option<(f64, bool)> {
            let mut is_rounded_well = true;
            let tables = self.tables(models).ok()?;
            let mut worst = 0.0_f64;
            for (sensor, validation) in self.sensors.iter().zip(&validation) {
                let fixed = |field: &_| tables.force(sensor.index, field, self.gauss_per_lsb);
                let float = float_samples(&models[sensor.index], &validation[..SAMPLES / 5]);
                let (rounding, _) = force_errors(&float, fixed);
                is_rounded_well &= rounding.iter().all(|rms| *rms <= MAX_ROUNDING * noise_n);
                let (rms, _) = force_errors(validation, fixed);
                worst = worst.max(rms[0].hypot(rms[1]));
            }
            Some((worst, is_rounded_well))
        };
        let candidates = |shape: GrbfShape| -> Vec<Candidate> {
            let fit = |s: &SensorData| {
                Grbf::fit_ridges(s.model, &s.design, shape, &RIDGES, &s.training, representable)
            };
            let fitted: Vec<Vec<Option<Grbf>>> = self.sensors.iter().map(fit).collect();
            let candidate = |(i, ridge): (usize, &f64)| {
                let models: Vec<Grbf> =
                    fitted.iter().map(|of| of[i].clone()).collect::<Option<_>>()?;
                let models = self.of_each(models);
                let shape = GrbfShape { ridge: *ridge, ..shape };
                let (error_n, is_rounded_well) = evaluate(&models)?;
                Some(Candidate { shape, error_n, is_rounded_well })
            };
            RIDGES.iter().enumerate().filter_map(candidate).collect()
        };
        let is_line = self.sensors.iter().all(|sensor| sensor.design.region.single().is_some());
        let is_enough =
            |one: &&Candidate| one.is_rounded_well && one.error_n <= TARGET_ERROR * noise_n;
        let mut tried: Vec<Candidate> = Vec::new();
        for centres_across in CENTRES_ACROSS {
            let shapes = widths(centres_across, is_line).into_par_iter();
            tried.par_extend(shapes.flat_map_iter(candidates));
            // More centres would not be selected.
            if tried.iter().any(|one| is_enough(&one)) {
                break;
            }
        }
        let smallest = tried.iter().filter(is_enough).min_by(|a, b| {
            (a.shape.centres_across, a.error_n)
                .partial_cmp(&(b.shape.centres_across, b.error_n))
                .unwrap_or(std::cmp::Ordering::Equal)
        });
        // The error contains that of rounding.
        let best = tried.iter().min_by(|a, b| a.error_n.total_cmp(&b.error_n));
        smallest.or(best).map(|one| one.shape)
    }
}

impl SelectedModels {
    /// Errors of each sensor on test samples.
    pub fn errors(&self) -> Vec<InverseErrors> {
        let gauss_per_lsb = self.gauss_per_lsb;
        let of_sensor = |(i, forward): (usize, &StaticModel)| {
            let samples = held_out_samples(forward, &self.models[i].design, SAMPLES, TEST_SEED);
            let float = float_samples(&self.models[i], &samples);
            let [model, linear] = [&self.models[i], &self.linear[i]].map(Grbf::lanes);
            InverseErrors {
                model: force_errors(&samples, |field| model.force(field)),
                fixed: force_errors(&float, |field| self.tables.force(i, field, gauss_per_lsb)),
                linear: force_errors(&samples, |field| linear.force(field)),
            }
        };
        self.forward.par_iter().enumerate().map(of_sensor).collect()
    }
}

/// Noise of one reading over the forces, in newtons, root mean square over the sensors.
fn noise_n(models: &[StaticModel]) -> f64 {
    let square = |model: &StaticModel| {
        let region = model.region();
        let per_newton = model.per_newton(region.centre_n);
        let noise_n = |axis: usize| model.noise_g() / per_newton[axis].norm();
        region.inputs().map(|axis| noise_n(axis).powi(2)).sum::<f64>()
    };
    let sum: f64 = models.iter().map(square).sum();
    (sum / models.len().max(1) as f64).sqrt()
}

/// The same fields with the forces of the floating point model.
fn float_samples(model: &Grbf, samples: &[FieldSample]) -> Vec<FieldSample> {
    let model = model.lanes();
    let force =
        |sample: &FieldSample| FieldSample { force_n: model.force(&sample.field_g), ..*sample };
    samples.iter().map(force).collect()
}

/// An evaluated shape.
struct Candidate {
    shape: GrbfShape,
    /// Held-out error of the device's arithmetic in newtons.
    error_n: f64,
    /// Whether the rounding errors are below [`MAX_ROUNDING`].
    is_rounded_well: bool,
}

/// Candidates with one number of centres on a lattice or on a line; the ridge is open.
fn widths(centres_across: usize, is_line: bool) -> Vec<GrbfShape> {
    let across = if is_line { LINE_CENTRES * centres_across } else { centres_across };
    let spacing = 2.0 / (across - 1) as f64;
    let shape = |width: &f64| {
        let sigma = width * spacing;
        GrbfShape { centres_across, gamma: 0.5 / (sigma * sigma), ridge: f64::NAN }
    };
    WIDTHS.iter().map(shape).collect()
}

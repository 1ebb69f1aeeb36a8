//! Selection of centres, width and ridge by held-out error of the device's own arithmetic.
//!
//! All sensors have the same hyperparameters, since they share the exponential table and the computing time.
//! Models that the device cannot represent are no candidates.

use std::ops::RangeInclusive;

use firmware::config::constants;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::inverse::grbf::{
    FieldSample, Grbf, GrbfShape, MAX_CENTRES_ACROSS, force_errors, held_out_samples,
    training_samples,
};
use crate::inverse::parity::ParitySurface;
use crate::inverse::quantise::{TableOverflow, TableSet, representable};
use crate::inverse::static_model::{DesignBox, StaticModel};

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
        // Error of a candidate over all sensors; `None` where the device cannot represent it.
        let evaluate = |models: &[Grbf]| -> Option<f64> {
            let tables = self.tables(models).ok()?;
            let mut worst = 0.0_f64;
            for (sensor, validation) in self.sensors.iter().zip(&validation) {
                let fixed = |field: &_| tables.force(sensor.index, field, self.gauss_per_lsb);
                let float = float_samples(&models[sensor.index], &validation[..SAMPLES / 5]);
                let (rounding, _) = force_errors(&float, fixed);
                if rounding.iter().any(|rms| *rms > MAX_ROUNDING * noise_n) {
                    return None;
                }
                let (rms, _) = force_errors(validation, fixed);
                worst = worst.max(rms[0].hypot(rms[1]));
            }
            Some(worst)
        };
        let candidates = |shape: GrbfShape| -> Vec<(GrbfShape, f64)> {
            let fit = |s: &SensorData| {
                Grbf::fit_ridges(s.model, &s.design, shape, &RIDGES, &s.training, representable)
            };
            let fitted: Vec<Vec<Option<Grbf>>> = self.sensors.iter().map(fit).collect();
            let candidate = |(i, ridge): (usize, &f64)| {
                let models: Vec<Grbf> =
                    fitted.iter().map(|of| of[i].clone()).collect::<Option<_>>()?;
                let models = self.of_each(models);
                let shape = GrbfShape { ridge: *ridge, ..shape };
                Some((shape, evaluate(&models)?))
            };
            RIDGES.iter().enumerate().filter_map(candidate).collect()
        };
        let mut tried: Vec<(GrbfShape, f64)> = Vec::new();
        for centres_across in CENTRES_ACROSS {
            tried.par_extend(widths(centres_across).into_par_iter().flat_map_iter(candidates));
            // More centres would not be selected.
            if tried.iter().any(|(_, error)| *error <= TARGET_ERROR * noise_n) {
                break;
            }
        }
        let best = tried.iter().min_by(|a, b| a.1.total_cmp(&b.1));
        let enough = tried.iter().filter(|(_, error)| *error <= TARGET_ERROR * noise_n);
        let smallest = enough.min_by(|a, b| {
            (a.0.centres_across, a.1)
                .partial_cmp(&(b.0.centres_across, b.1))
                .unwrap_or(std::cmp::Ordering::Equal)
        });
        smallest.or(best).map(|(shape, _)| *shape)
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

/// Noise of one reading over both forces, in newtons, root mean square over the sensors.
fn noise_n(models: &[StaticModel]) -> f64 {
    let square = |model: &StaticModel| {
        let noise_n = |derivative: Vector3<f64>| constants::SENSOR_NOISE.value / derivative.norm();
        let squares = model.per_newton([0.0; 2]).map(|one| noise_n(one).powi(2));
        squares.iter().sum::<f64>()
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

/// Candidates with one number of centres; the ridge is open.
fn widths(centres_across: usize) -> Vec<GrbfShape> {
    let spacing = 2.0 / (centres_across - 1) as f64;
    let shape = |width: &f64| {
        let sigma = width * spacing;
        GrbfShape { centres_across, gamma: 0.5 / (sigma * sigma), ridge: f64::NAN }
    };
    WIDTHS.iter().map(shape).collect()
}

//! Centres, width and ridge chosen by held-out error, through the device's own arithmetic.
//!
//! All sensors share one shape, since they share the table of the exponential and the time that the
//! device has. A shape that the device cannot represent is not a candidate.

use firmware::params;
use nalgebra::Vector3;
use rayon::prelude::*;

use super::at_rest::AtRest;
use super::design_box::DesignBox;
use super::grbf::{Grbf, Shape, errors};
use super::parity::Surface;
use super::quantise::{Overflow, TableSet, representable};
use super::samples::{Sample, held_out, training};

/// Seed of the samples by which shapes are chosen.
const CHOOSING_SEED: u64 = 11;
/// Seed of the samples that judge the choice: never those it was made by.
const JUDGING_SEED: u64 = 12;
/// Samples of each.
const SAMPLES: usize = 1500;

/// Error over both forces that counts as good enough, in shares of the noise of one reading. Beyond it
/// fewer centres are preferred.
const GOOD_ENOUGH: f64 = 1.0 / 3.0;

/// Error by rounding to the device's integers, the greater of both forces, root mean square, that is put
/// up with, in shares of the noise of one reading.
const MOST_ROUNDING: f64 = 0.07;

/// Centres along each axis that are tried, the fewest first.
const CENTRES_ACROSS: [usize; 5] = [4, 5, 6, 7, 8];
/// Widths that are tried, in spacings of the centres.
const WIDTHS: [f64; 5] = [1.0, 1.4, 2.0, 2.8, 4.0];
/// Penalties that are tried.
const RIDGES: [f64; 6] = [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8];

/// The chosen models and what they cost.
#[derive(Clone, Debug)]
pub struct Chosen {
    /// What was chosen.
    pub shape: Shape,
    /// What was inverted, one for each sensor.
    pub forward: Vec<AtRest>,
    /// In floating point, one for each sensor.
    pub models: Vec<Grbf>,
    /// For the device.
    pub tables: TableSet,
    /// Each sensor's errors on samples that the choice did not see.
    pub errors: Vec<SensorErrors>,
    /// The linear models beside them.
    pub linear: Vec<Grbf>,
    /// Where the fields lie, one for each sensor.
    pub surfaces: Vec<Surface>,
}

/// Errors of one sensor's inverse over the box, in newtons: for Fx and Fz.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorErrors {
    /// Floating point against the forward model: root mean square, greatest.
    pub model: ([f64; 2], [f64; 2]),
    /// Fixed against floating point: root mean square, greatest.
    pub fixed: ([f64; 2], [f64; 2]),
    /// The linear model against the forward model: root mean square, greatest.
    pub linear: ([f64; 2], [f64; 2]),
}

struct Sensor<'a> {
    model: &'a AtRest,
    design: DesignBox,
    training: Vec<Sample>,
    choosing: Vec<Sample>,
}

/// Chooses one shape for all sensors and fits their models.
pub fn choose(
    models: &[AtRest],
    numbers: &[u32],
    id: u16,
    gauss_per_lsb: f64,
    range_gauss: f64,
) -> Result<Chosen, Overflow> {
    let sensors: Vec<Sensor> = models
        .par_iter()
        .map(|model| {
            let (_, design) = DesignBox::of(model).device_scale(gauss_per_lsb);
            Sensor {
                model,
                design,
                training: training(model, &design),
                choosing: held_out(model, &design, SAMPLES, CHOOSING_SEED),
            }
        })
        .collect();
    let fit_all = |shape: Shape| -> Option<Vec<Grbf>> {
        let fit = |s: &Sensor| Grbf::fit(s.model, &s.design, shape, &s.training, representable);
        sensors.iter().map(fit).collect()
    };
    let noise_n = noise_n(models);
    let build = |models: &[Grbf]| TableSet::build(id, models, numbers, gauss_per_lsb, range_gauss);
    // The error of one candidate on all sensors; `None` where the device cannot represent it.
    let judge = |models: &[Grbf]| -> Option<f64> {
        let tables = build(models).ok()?;
        let mut worst = 0.0_f64;
        for (i, (sensor, model)) in sensors.iter().zip(models).enumerate() {
            let fixed = |field: &_| tables.force(i, field, gauss_per_lsb);
            let float = in_float(model, &sensor.choosing[..SAMPLES / 5]);
            let (rounding, _) = errors(&float, fixed);
            if rounding.iter().any(|rms| *rms > MOST_ROUNDING * noise_n) {
                return None;
            }
            let (rms, _) = errors(&sensor.choosing, fixed);
            worst = worst.max(rms[0].hypot(rms[1]));
        }
        Some(worst)
    };
    let of_width = |shape: Shape| -> Vec<(Shape, f64)> {
        let fit = |s: &Sensor| {
            Grbf::fit_ridges(
                s.model,
                &s.design,
                shape,
                &RIDGES,
                &s.training,
                representable,
            )
        };
        let fitted: Vec<Vec<Option<Grbf>>> = sensors.iter().map(fit).collect();
        let candidate = |(i, ridge): (usize, &f64)| {
            let models: Vec<Grbf> = fitted
                .iter()
                .map(|of| of[i].clone())
                .collect::<Option<_>>()?;
            let shape = Shape {
                ridge: *ridge,
                ..shape
            };
            Some((shape, judge(&models)?))
        };
        RIDGES.iter().enumerate().filter_map(candidate).collect()
    };
    let mut tried: Vec<(Shape, f64)> = Vec::new();
    for centres_across in CENTRES_ACROSS {
        tried.par_extend(
            widths(centres_across)
                .into_par_iter()
                .flat_map_iter(of_width),
        );
        // More centres would not be taken.
        if tried
            .iter()
            .any(|(_, error)| *error <= GOOD_ENOUGH * noise_n)
        {
            break;
        }
    }
    let best = tried.iter().min_by(|a, b| a.1.total_cmp(&b.1)).copied();
    let enough = tried
        .iter()
        .filter(|(_, error)| *error <= GOOD_ENOUGH * noise_n);
    let fewest = enough.min_by(|a, b| {
        (a.0.centres_across, a.1)
            .partial_cmp(&(b.0.centres_across, b.1))
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    let linear_shape = Shape {
        centres_across: 0,
        gamma: 1.0,
        ridge: 0.0,
    };
    let (shape, _) = fewest.copied().or(best).unwrap_or((linear_shape, f64::NAN));
    let (Some(chosen), Some(linear)) = (fit_all(shape), fit_all(linear_shape)) else {
        return Err(Overflow {
            sensor: 0,
            row: "every row".to_owned(),
            value: f64::NAN,
            format: "any shape".to_owned(),
            advice: "the field of this model does not determine the forces: check its parameters",
        });
    };
    let tables = build(&chosen)?;
    let judged = sensors.par_iter().enumerate().map(|(i, sensor)| {
        let samples = held_out(sensor.model, &sensor.design, SAMPLES, JUDGING_SEED);
        let float = in_float(&chosen[i], &samples);
        SensorErrors {
            model: errors(&samples, |field| chosen[i].force(field)),
            fixed: errors(&float, |field| tables.force(i, field, gauss_per_lsb)),
            linear: errors(&samples, |field| linear[i].force(field)),
        }
    });
    Ok(Chosen {
        shape,
        errors: judged.collect(),
        surfaces: sensors
            .par_iter()
            .map(|sensor| Surface::of(sensor.model, &sensor.design))
            .collect(),
        forward: models.to_vec(),
        models: chosen,
        tables,
        linear,
    })
}

/// What the noise of one reading is over both forces, in newtons, root mean square over the sensors.
fn noise_n(models: &[AtRest]) -> f64 {
    let square = |model: &AtRest| {
        let noise_n = |answer: Vector3<f64>| params::SENSOR_NOISE.value / answer.norm();
        let squares = model.per_newton([0.0; 2]).map(|one| noise_n(one).powi(2));
        squares.iter().sum::<f64>()
    };
    let sum: f64 = models.iter().map(square).sum();
    (sum / models.len().max(1) as f64).sqrt()
}

/// The same fields with the forces that the model in floating point gives.
fn in_float(model: &Grbf, samples: &[Sample]) -> Vec<Sample> {
    let force = |sample: &Sample| Sample {
        force_n: model.force(&sample.field_g),
        ..*sample
    };
    samples.iter().map(force).collect()
}

/// The shapes of one number of centres, their penalty left open.
fn widths(centres_across: usize) -> Vec<Shape> {
    let spacing = 2.0 / (centres_across - 1) as f64;
    let shape = |width: &f64| {
        let sigma = width * spacing;
        Shape {
            centres_across,
            gamma: 0.5 / (sigma * sigma),
            ridge: f64::NAN,
        }
    };
    WIDTHS.iter().map(shape).collect()
}

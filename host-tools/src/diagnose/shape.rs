//! What an effect takes away, over the covariate that it shows against: the residual before it was
//! added, and in the same bins what its step removed of it. Where the effect is right, the second is
//! the shape of the first.

use model_export::fit::campaign::Prepared;
use model_export::recordings::Campaign;
use nalgebra::Vector3;

use super::left::{block_s, residuals_beside};
use super::select::{Selection, Step};
use super::stage::Stage;
use crate::compare::Bin;
use crate::compare::bands::Bands;
use crate::compare::binning::Binning;
use crate::compare::covariate::{Covariate, all};
use crate::compare::rows::SensorColumns;

/// One step of the selection over one covariate.
#[derive(Clone, Debug, Default)]
pub struct Shape {
    /// The effect, and those that it is tied with.
    pub effects: Vec<String>,
    /// The covariate, as in the recordings.
    pub covariate: String,
    /// In words.
    pub words: String,
    /// Its unit; empty for a number without one.
    pub unit: &'static str,
    /// Numbers of the sensors, in the order of each bin's means.
    pub sensors: Vec<u32>,
    /// The residual before the step, with its bands.
    pub bins: Vec<Bin>,
    /// Mean of what the step removed: each bin, each sensor, each axis, in gauss; NaN without rows.
    pub taken_g: Vec<Vec<[f64; 3]>>,
}

impl Shape {
    /// Sensor (by place) and axis over whose bins the residual varies most.
    pub fn strongest(&self) -> Option<(usize, usize)> {
        let sensors = 0..self.sensors.len();
        let channels = sensors.flat_map(|sensor| [0, 1, 2].map(|axis| (sensor, axis)));
        let spread = |(sensor, axis): (usize, usize)| {
            let mean = |bin: &Bin| Some(bin.mean_g.get(sensor)?[axis]);
            let means: Vec<f64> = self.bins.iter().filter_map(mean).collect();
            variance(&means, &self.rows())
        };
        channels.max_by(|a, b| spread(*a).total_cmp(&spread(*b)))
    }

    fn rows(&self) -> Vec<f64> {
        self.bins.iter().map(|bin| bin.rows as f64).collect()
    }

    /// How much of what was removed varies over the bins, all channels together, in gauss squared.
    fn follows(&self) -> f64 {
        let sensors = 0..self.sensors.len();
        let channels = sensors.flat_map(|sensor| [0, 1, 2].map(|axis| (sensor, axis)));
        let of_channel = |(sensor, axis): (usize, usize)| {
            let mean = |bin: &Vec<[f64; 3]>| bin[sensor][axis];
            let means: Vec<f64> = self.taken_g.iter().map(mean).collect();
            variance(&means, &self.rows())
        };
        channels.map(of_channel).sum()
    }
}

/// Variance of those means that are numbers, each with the weight of its rows.
fn variance(means: &[f64], rows: &[f64]) -> f64 {
    let pairs = || means.iter().zip(rows).filter(|(mean, _)| mean.is_finite());
    let count: f64 = pairs().map(|(_, rows)| rows).sum::<f64>().max(1.0);
    let middle = pairs().map(|(mean, rows)| mean * rows).sum::<f64>() / count;
    pairs()
        .map(|(mean, rows)| rows * (mean - middle).powi(2))
        .sum::<f64>()
        / count
}

/// The shape of every step, each over that of its covariates which it follows most; a step of which
/// none was recorded or moves has no shape.
pub fn shapes(
    campaign: &Campaign,
    prepared: &Prepared,
    selection: &Selection,
    seed: u64,
) -> Vec<Shape> {
    let Some(first) = campaign.recordings.first() else {
        return Vec::new();
    };
    let known = all(first);
    let stages = selection.stages.windows(2);
    stages
        .zip(&selection.steps)
        .filter_map(|(stages, step)| shape(prepared, &known, stages, step, seed))
        .collect()
}

fn shape(
    prepared: &Prepared,
    known: &[Covariate],
    stages: &[Stage],
    step: &Step,
    seed: u64,
) -> Option<Shape> {
    let names = step.chosen.shows_against();
    let of_name = |name: &String| known.iter().find(|c| c.name == name.as_str()).cloned();
    let covariates: Vec<Covariate> = names.iter().filter_map(of_name).collect();
    let before = residuals_beside(prepared, stages.first()?, &covariates);
    let after = residuals_beside(prepared, stages.last()?, &[]);
    let bands = Bands::new(&before, block_s(&before), seed);
    let all = std::iter::once(&step.chosen).chain(&step.tied);
    let effects: Vec<String> = all.map(|effect| effect.name().to_owned()).collect();
    let over = |(i, covariate): (usize, &Covariate)| {
        let values: Vec<&[f32]> = before
            .iter()
            .map(|sensor| sensor.covariates[i].values.as_slice())
            .collect();
        let binning = Binning::of(&values)?;
        Some(Shape {
            effects: effects.clone(),
            covariate: covariate.name.to_string(),
            words: covariate.words.to_string(),
            unit: covariate.unit,
            sensors: before.iter().map(|sensor| sensor.sensor).collect(),
            bins: bands.bins(&before, &binning),
            taken_g: taken(&before, &after, &binning),
        })
    };
    let drawn = covariates.iter().enumerate().filter_map(over);
    drawn.max_by(|a, b| a.follows().total_cmp(&b.follows()))
}

/// Means of the difference of two residuals of the same rows: each bin, each sensor, each axis.
fn taken(
    before: &[SensorColumns],
    after: &[SensorColumns],
    binning: &Binning,
) -> Vec<Vec<[f64; 3]>> {
    let mut means = vec![Vec::new(); binning.count()];
    for ((before, after), of) in before.iter().zip(after).zip(&binning.of) {
        let mut sums = vec![(Vector3::zeros(), 0.0); binning.count()];
        let rows = before.residual_g.iter().zip(&after.residual_g);
        for ((before, after), bin) in rows.zip(of) {
            if let Some((sum, rows)) = sums.get_mut(usize::from(*bin)) {
                *sum += before - after;
                *rows += 1.0;
            }
        }
        for (bin, (sum, rows)) in means.iter_mut().zip(sums) {
            bin.push((sum / rows).into());
        }
    }
    means
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::covariate::known;
    use model_export::effects::CATALOGUE;
    use model_export::recordings::columns::STATOR_CURRENTS;

    fn sensor(number: u32, residual: [f64; 4]) -> SensorColumns {
        let mut sensor = SensorColumns::new(number, &[]);
        sensor.residual_g = residual.map(|x| Vector3::new(x, 0.0, -x)).to_vec();
        sensor
    }

    #[test]
    fn what_was_removed_is_the_mean_of_the_difference_in_each_bin() {
        let binning = Binning {
            ranges: vec![(0.0, 1.0), (2.0, 3.0)],
            centres: vec![0.5, 2.5],
            of: vec![vec![0, 0, 1, Binning::NONE]],
        };
        let (before, after) = (
            sensor(0, [5.0, 7.0, 1.0, 90.0]),
            sensor(0, [1.0, 1.0, 4.0, 0.0]),
        );
        assert_eq!(
            taken(&[before], &[after], &binning),
            [[[5.0, 0.0, -5.0]], [[-3.0, 0.0, 3.0]]]
        );
    }

    #[test]
    fn the_strongest_channel_is_the_one_that_varies_not_the_one_that_is_large() {
        let bin = |x: f64| Bin {
            rows: 10,
            mean_g: vec![[50.0, 0.0, 0.0], [0.0, x, 2.0 * x]],
            ..Bin::default()
        };
        let shape = Shape {
            sensors: vec![0, 3],
            bins: vec![bin(-1.0), bin(0.0), bin(1.0)],
            ..Shape::default()
        };
        assert_eq!(shape.strongest(), Some((1, 2)));
    }

    #[test]
    fn every_effect_shows_against_a_covariate_that_is_known() {
        let known = known();
        for effect in CATALOGUE {
            assert!(!effect.shows_against.is_empty(), "{}", effect.id);
            for name in effect.shows_against {
                assert!(known.iter().any(|c| c.name == *name), "{name}");
            }
        }
        let leakage = model_export::effects::find("motor_leakage").unwrap();
        assert!(leakage.shows_against.contains(&STATOR_CURRENTS[0]));
    }
}

//! What each step of the selection removed of the residual, over the covariate that it follows.

use crate::compare::Bin;
use crate::compare::attribution::Binning;
use crate::compare::bootstrap_bands::BlockBootstrap;
use crate::compare::covariates::{Covariate, all_covariates, standard_covariates};
use crate::compare::residual_table::{CovariateColumn, ResidualTable};
use crate::diagnose::fitted_model::FittedModel;
use crate::diagnose::formulas::discovered::DiscoveredFormula;
use crate::diagnose::residuals::{block_s, residuals_against};
use crate::diagnose::selection::{AcceptedStep, Selection};
use model_export::effects::{Signature, find};
use model_export::fit::campaign::FitSetup;
use model_export::recordings::Campaign;
use model_export::recordings::columns::Axis;
use nalgebra::Vector3;

/// One step of the selection over one covariate.
#[derive(Clone, Debug, Default)]
pub struct EffectShape {
    /// The effect, and those that it is tied with.
    pub effects: Vec<String>,
    /// The covariate, as in the recordings.
    pub covariate: String,
    pub words: String,
    /// Its unit; empty for a number without one.
    pub unit: &'static str,
    /// Numbers of the sensors, in the order of each bin's means.
    pub sensors: Vec<u32>,
    /// The residual before the step, with its bands.
    pub bins: Vec<Bin>,
    /// Mean residual removed by the step, by bin, sensor and axis, in gauss; NaN without rows.
    pub taken_g: MeansByBin,
    /// The hysteresis loop of an effect of the history of the load.
    pub load_loop: Option<LoadLoop>,
}

/// Mean field in gauss by bin, sensor and axis; NaN without rows.
type MeansByBin = Vec<Vec<[f64; 3]>>;

/// Covariates of the loops.
const LOOP: [&str; 4] = ["fx_n", "loading_x", "fz_n", "loading_z"];

/// Residual over a force, apart for rising and falling force.
#[derive(Clone, Debug, Default)]
pub struct LoadLoop {
    /// The force, in words.
    pub words: String,
    /// Centres of the bins in newtons.
    pub force_n: Vec<f64>,
    /// Residual before the step, with rising and with falling force.
    pub before_g: [MeansByBin; 2],
    /// What the step removed of it.
    pub taken_g: [MeansByBin; 2],
}

impl LoadLoop {
    /// Over one of the two forces; `None` where it does not vary.
    fn new(before: &[ResidualTable], removed: &[Vec<Vector3<f64>>], axis: Axis) -> Option<Self> {
        let letter = axis.letter();
        let columns = |name: String| -> Option<Vec<&CovariateColumn>> {
            before.iter().map(|table| table.column(&name)).collect()
        };
        let forces = columns(format!("f{letter}_n"))?;
        let directions = columns(format!("loading_{letter}"))?;
        let values: Vec<&[f32]> = forces.iter().map(|force| force.values.as_slice()).collect();
        let binning = Binning::of(&values)?;
        let residual: Vec<Vec<Vector3<f64>>> =
            before.iter().map(|table| table.residual.clone()).collect();
        let branches = [1.0, -1.0].map(|sign| {
            let mut branch = binning.clone();
            for (bins, directions) in branch.of.iter_mut().zip(&directions) {
                let pairs = bins.iter_mut().zip(&directions.values);
                pairs.filter(|(_, own)| **own != sign).for_each(|(bin, _)| *bin = Binning::NONE);
            }
            branch
        });
        Some(Self {
            words: forces.first()?.of.words.to_string(),
            before_g: branches.each_ref().map(|branch| means_by_bin(&residual, branch)),
            taken_g: branches.each_ref().map(|branch| means_by_bin(removed, branch)),
            force_n: binning.centres,
        })
    }

    /// Sensor (by place) and axis of the widest loop, and the mean square of its width in gauss squared.
    pub fn widest(&self) -> Option<((usize, usize), f64)> {
        let sensors = self.before_g.iter().flatten().map(Vec::len).max().unwrap_or(0);
        let channels = (0..sensors).flat_map(|sensor| [0, 1, 2].map(|axis| (sensor, axis)));
        let width = |(sensor, axis): (usize, usize)| {
            let [rising, falling] = &self.before_g;
            let pairs = rising.iter().zip(falling);
            let apart = pairs.filter_map(|(rising, falling)| {
                Some(rising.get(sensor)?[axis] - falling.get(sensor)?[axis])
            });
            let squares: Vec<f64> = apart.filter(|g| g.is_finite()).map(|g| g * g).collect();
            squares.iter().sum::<f64>() / squares.len().max(1) as f64
        };
        channels.map(|channel| (channel, width(channel))).max_by(|a, b| a.1.total_cmp(&b.1))
    }
}

impl EffectShape {
    /// Sensor (by place) and axis over whose bins the residual varies most.
    pub fn strongest(&self) -> Option<(usize, usize)> {
        let sensors = 0..self.sensors.len();
        let channels = sensors.flat_map(|sensor| [0, 1, 2].map(|axis| (sensor, axis)));
        let spread = |(sensor, axis): (usize, usize)| {
            let mean = |bin: &Bin| Some(bin.mean.get(sensor)?[axis]);
            let means: Vec<f64> = self.bins.iter().filter_map(mean).collect();
            variance(&means, &self.rows())
        };
        channels.max_by(|a, b| spread(*a).total_cmp(&spread(*b)))
    }

    fn rows(&self) -> Vec<f64> {
        self.bins.iter().map(|bin| bin.rows as f64).collect()
    }

    /// Variance of the removed residual over the bins, all channels, in gauss squared.
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
    pairs().map(|(mean, rows)| rows * (mean - middle).powi(2)).sum::<f64>() / count
}

/// Shape of every step and every formula over the covariate on which it depends most; those without a varying covariate are
/// skipped.
pub fn shapes(
    campaign: &Campaign,
    prepared: &FitSetup,
    selection: &Selection,
    formulas: &[DiscoveredFormula],
    seed: u64,
) -> Vec<EffectShape> {
    let Some(first) = campaign.recordings.first() else {
        return Vec::new();
    };
    let known = all_covariates(first);
    let find = |name: &String| known.iter().find(|own| own.name == name.as_str()).cloned();
    let of_step = |step: &AcceptedStep| {
        let all = std::iter::once(&step.chosen).chain(&step.tied);
        let names = all.map(|effect| effect.name().to_owned()).collect();
        (names, step.chosen.plot_against().iter().filter_map(find).collect::<Vec<Covariate>>())
    };
    let of_formula = |formula: &DiscoveredFormula| {
        let alone = |name: &String| {
            find(name).unwrap_or_else(|| Covariate::product(std::slice::from_ref(name)))
        };
        let mut over: Vec<Covariate> = formula.covariates.iter().map(alone).collect();
        if formula.covariates.len() > 1 {
            over.push(Covariate::product(&formula.covariates));
        }
        (vec![formula.name.clone()], over)
    };
    let added = selection.steps.iter().map(of_step).chain(formulas.iter().map(of_formula));
    let stages = selection.stages.windows(2);
    stages
        .zip(added)
        .filter_map(|(stages, (effects, over))| shape(prepared, stages, &effects, &over, seed))
        .collect()
}

fn shape(
    prepared: &FitSetup,
    stages: &[FittedModel],
    effects: &[String],
    covariates: &[Covariate],
    seed: u64,
) -> Option<EffectShape> {
    let is_of_load = effects
        .first()
        .and_then(|name| find(name).ok())
        .is_some_and(|effect| effect.signatures.contains(&Signature::LoadHistory));
    let of_loop =
        standard_covariates().iter().filter(|own| is_of_load && LOOP.contains(&&*own.name));
    let all: Vec<Covariate> = covariates.iter().chain(of_loop).cloned().collect();
    let before = residuals_against(prepared, stages.first()?, &all);
    let after = residuals_against(prepared, stages.last()?, &[]);
    let bands = BlockBootstrap::new(&before, block_s(&before), seed);
    let removed = removed(&before, &after);
    let loops = [Axis::X, Axis::Z].map(|axis| LoadLoop::new(&before, &removed, axis));
    let loops = loops.into_iter().flatten().filter(|_| is_of_load);
    let width = |one: &LoadLoop| one.widest().map_or(0.0, |(_, width)| width);
    let load_loop = loops.max_by(|a, b| width(a).total_cmp(&width(b)));
    let over = |(i, covariate): (usize, &Covariate)| {
        let values: Vec<&[f32]> =
            before.iter().map(|sensor| sensor.covariates[i].values.as_slice()).collect();
        let binning = Binning::of(&values)?;
        Some(EffectShape {
            effects: effects.to_vec(),
            covariate: covariate.name.to_string(),
            words: covariate.words.to_string(),
            unit: covariate.unit,
            sensors: before.iter().map(|sensor| sensor.sensor).collect(),
            bins: bands.bins(&before, &binning),
            taken_g: means_by_bin(&removed, &binning),
            load_loop: load_loop.clone(),
        })
    };
    let drawn = covariates.iter().enumerate().filter_map(over);
    drawn.max_by(|a, b| a.follows().total_cmp(&b.follows()))
}

/// Differences of two residuals of the same rows, by sensor.
fn removed(before: &[ResidualTable], after: &[ResidualTable]) -> Vec<Vec<Vector3<f64>>> {
    let difference = |(before, after): (&ResidualTable, &ResidualTable)| {
        let rows = before.residual.iter().zip(&after.residual);
        rows.map(|(before, after)| before - after).collect()
    };
    before.iter().zip(after).map(difference).collect()
}

/// Means of values by row of each sensor.
fn means_by_bin(sensors: &[Vec<Vector3<f64>>], binning: &Binning) -> MeansByBin {
    let mut means = vec![Vec::new(); binning.count()];
    for (rows, of) in sensors.iter().zip(&binning.of) {
        let mut sums = vec![(Vector3::zeros(), 0.0); binning.count()];
        for (value, bin) in rows.iter().zip(of) {
            if let Some((sum, rows)) = sums.get_mut(usize::from(*bin)) {
                *sum += value;
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
    use model_export::effects::CATALOGUE;
    use model_export::recordings::columns::STATOR_CURRENTS;

    fn sensor(number: u32, residual: [f64; 4]) -> ResidualTable {
        let mut sensor = ResidualTable::new(number, &[]);
        sensor.residual = residual.map(|x| Vector3::new(x, 0.0, -x)).to_vec();
        sensor
    }

    #[test]
    fn removed_residual_is_the_mean_difference_by_bin() {
        let binning = Binning {
            ranges: vec![(0.0, 1.0), (2.0, 3.0)],
            centres: vec![0.5, 2.5],
            of: vec![vec![0, 0, 1, Binning::NONE]],
        };
        let (before, after) = (sensor(0, [5.0, 7.0, 1.0, 90.0]), sensor(0, [1.0, 1.0, 4.0, 0.0]));
        let removed = removed(&[before], &[after]);
        assert_eq!(means_by_bin(&removed, &binning), [[[5.0, 0.0, -5.0]], [[-3.0, 0.0, 3.0]]]);
    }

    #[test]
    fn loop_separates_rising_from_falling_force() {
        let covariates: Vec<Covariate> = standard_covariates()
            .iter()
            .filter(|covariate| ["fx_n", "loading_x"].contains(&&*covariate.name))
            .cloned()
            .collect();
        let mut before = ResidualTable::new(0, &covariates);
        // Up and down between -10 and 10 N; 2 G more on the way down.
        for row in 0..400 {
            let (rising, place) = (row < 200, row % 200);
            let force = if rising { place as f32 - 100.0 } else { 100.0 - place as f32 } / 10.0;
            before.time_s.push(0.01 * f64::from(row));
            before.residual.push(Vector3::new(0.0, if rising { 1.0 } else { 3.0 }, 0.0));
            for column in &mut before.covariates {
                let is_force = column.of.name == "fx_n";
                column.values.push(if is_force {
                    force
                } else if rising {
                    1.0
                } else {
                    -1.0
                });
            }
        }
        let removed = [before.residual.clone()];
        let found = LoadLoop::new(&[before.clone()], &removed, Axis::X).unwrap();
        assert_eq!(found.widest(), Some(((0, 1), 4.0)));
        assert!(found.before_g[0].iter().all(|bin| bin[0] == [0.0, 1.0, 0.0]));
        assert!(found.taken_g[1].iter().all(|bin| bin[0] == [0.0, 3.0, 0.0]));
        // Its covariates have no longitudinal force.
        assert!(LoadLoop::new(&[before], &removed, Axis::Z).is_none());
    }

    #[test]
    fn strongest_channel_has_the_largest_variance() {
        let bin = |x: f64| Bin {
            rows: 10,
            mean: vec![[50.0, 0.0, 0.0], [0.0, x, 2.0 * x]],
            ..Bin::default()
        };
        let shape = EffectShape {
            sensors: vec![0, 3],
            bins: vec![bin(-1.0), bin(0.0), bin(1.0)],
            ..EffectShape::default()
        };
        assert_eq!(shape.strongest(), Some((1, 2)));
    }

    #[test]
    fn every_effect_depends_on_a_standard_covariate() {
        let known = standard_covariates();
        for effect in CATALOGUE {
            assert!(!effect.plot_against.is_empty(), "{}", effect.id);
            for name in effect.plot_against {
                assert!(known.iter().any(|c| c.name == *name), "{name}");
            }
        }
        let leakage = model_export::effects::find("motor_leakage").unwrap();
        assert!(leakage.plot_against.contains(&STATOR_CURRENTS[0]));
    }
}

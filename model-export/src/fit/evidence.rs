//! What speaks for an effect that a fitted model has not, before anything is fitted anew.
//!
//! Around a fitted model the field answers to every number in a straight line. A candidate is
//! regressed together with everything that is fitted already (Frisch and Waugh 1933), so that it gets
//! no credit for what the others could absorb; it is judged on what was left out; and what it explains
//! is held against what it would explain had whole stretches of the residual the other sign (Wu's wild
//! bootstrap, by blocks).

mod sensor;

use nalgebra::{DMatrix, DVector, Vector3};
use rayon::prelude::*;

use self::sensor::Sensor;
use super::campaign::Prepared;
use super::folds::{Fold, Split};
use super::ground::Ground;
use super::joint::JointFit;
use super::problem::SensorProblem;
use super::start::{Seeker, seek_beside};
use crate::effects::{Addition, SizeOf};
use crate::physics::Response;

/// Rows of a recording that take part.
const ROWS: usize = 1500;
/// Knots of a curve that is free in time, over each recording.
const KNOTS: usize = 12;

/// A fitted model with the straight lines around it.
pub struct Around<'a> {
    prepared: &'a Prepared,
    effects: Vec<Addition>,
    values: Vec<Vec<f64>>,
    /// One for each sensor.
    sensors: Vec<Sensor>,
    /// Number of blocks of time.
    pub blocks: usize,
    recordings: usize,
}

/// What a candidate would explain.
pub struct Evidence {
    /// Squared residual of each part left out, weighted: without the candidate, with it.
    pub folds: Vec<(f64, f64)>,
    /// Sum of squares explained, each number's worth of noise being one, over all sensors.
    pub explained: f64,
    /// Numbers that it takes.
    pub count: usize,
    /// How many error bars its typical size is from nothing.
    pub z_typical: f64,
    /// The same were noise all that is left.
    pub z_in_noise: f64,
    /// The same were nothing else fitted either.
    pub z_alone: f64,
    /// The most that it may be, in typical sizes: its estimate and two error bars.
    pub bound: f64,
    /// Answers that no fixed column stands in for, one for each sensor.
    apart: Vec<DMatrix<f64>>,
    /// Inverse of their products.
    inverse: Vec<DMatrix<f64>>,
}

impl Evidence {
    /// Share of the squared residual left out that the candidate takes away.
    pub fn gain(&self) -> f64 {
        let (without, with) = self
            .folds
            .iter()
            .fold((0.0, 0.0), |(a, b), f| (a + f.0, b + f.1));
        1.0 - with / without
    }

    /// Parts left out in which the error falls.
    pub fn wins(&self) -> usize {
        self.folds
            .iter()
            .filter(|(without, with)| with < without)
            .count()
    }
}

impl<'a> Around<'a> {
    /// Around `fit` with `effects`; blocks of `block_s` seconds.
    pub fn new(prepared: &'a Prepared, effects: &[Addition], fit: &JointFit, block_s: f64) -> Self {
        let mut effects = effects.to_vec();
        effects.sort_by_key(Addition::stage);
        let recordings = prepared.rows.first().map_or(0, |rows| rows.parts.len());
        let values: Vec<Vec<f64>> = fit
            .sensors
            .iter()
            .map(|sensor| sensor.values.clone())
            .collect();
        let (firsts, blocks) = first_blocks(prepared, block_s);
        let sensors = (0..prepared.rows.len())
            .into_par_iter()
            .map(|s| {
                let rows = &prepared.rows[s];
                let problem = SensorProblem::new(rows, prepared.bases[s].as_ref(), &effects);
                let fixed: Vec<usize> = (0..problem.slots.len()).collect();
                let ground = Ground::new(&problem, &values[s], &fixed, ROWS);
                let place = |(part, row): (usize, usize)| {
                    let time_s = rows.parts[part].track.time_s[row];
                    firsts[part] + (time_s / block_s) as usize
                };
                let parts = [
                    Split::of(&prepared.rows, false),
                    Split::of(&prepared.rows, true),
                ]
                .map(|split| part_of(&split.folds(rows, 0.0), &ground));
                let block = ground.places().map(place).collect();
                Sensor::new(ground, block, parts)
            })
            .collect();
        Self {
            prepared,
            effects,
            values,
            sensors,
            blocks,
            recordings,
        }
    }

    /// What speaks for `candidate`; `None` where the field does not answer to it at all.
    pub fn evidence(&self, candidate: &Addition) -> Option<Evidence> {
        let mut effects = self.effects.clone();
        effects.push(candidate.clone());
        effects.sort_by_key(Addition::stage);
        let place = effects.iter().position(|effect| effect == candidate)?;
        let mut seekers: Vec<Seeker> = (0..self.sensors.len())
            .into_par_iter()
            .map(|s| {
                let rows = &self.prepared.rows[s];
                let problem = SensorProblem::new(rows, self.prepared.bases[s].as_ref(), &effects);
                let values = self.spread(&problem, place, &self.values[s]);
                Seeker::upon(self.sensors[s].coarse.clone(), problem, values)
            })
            .collect();
        seek_beside(&mut seekers, place);
        let answers: Vec<DMatrix<f64>> = seekers
            .into_par_iter()
            .zip(&self.sensors)
            .map(|(seeker, sensor)| seeker.moved_to(sensor.ground.clone()).answers(place))
            .collect();
        let within = usize::from(candidate.lives_in_one_recording());
        let count = answers.first()?.ncols();
        let judged: Vec<_> = self
            .sensors
            .par_iter()
            .zip(&answers)
            .map(|(sensor, answers)| sensor.judge(answers, within))
            .collect();
        let mut folds: Vec<(f64, f64)> = Vec::new();
        for (_, _, own) in &judged {
            folds.resize(folds.len().max(own.len()), (0.0, 0.0));
            folds.iter_mut().zip(own).for_each(|(sum, own)| {
                sum.0 += own.0;
                sum.1 += own.1;
            });
        }
        folds.retain(|(without, _)| *without > 0.0);
        let (apart, inverse): (Vec<_>, Vec<_>) = judged
            .into_iter()
            .map(|(apart, inverse, _)| (apart, inverse))
            .unzip();
        let mut evidence = Evidence {
            folds,
            explained: 0.0,
            count,
            z_typical: 0.0,
            z_in_noise: 0.0,
            z_alone: 0.0,
            bound: f64::INFINITY,
            apart,
            inverse,
        };
        let signs = vec![1.0; self.blocks];
        evidence.explained = self.explained(&evidence, &self.scores(&evidence, None), &signs);
        self.typical(&mut evidence, candidate, &answers);
        Some(evidence)
    }

    /// How many error bars of white noise a change of the measurement stands out of what the model could
    /// absorb: `change` of a sensor's place, a recording and a row is that of the field in gauss and of the
    /// reference's forces in newtons.
    pub fn stands_out(
        &self,
        change: impl Fn(usize, usize, usize) -> (Vector3<f64>, [f64; 2]),
    ) -> f64 {
        let mut squares = 0.0;
        for (s, sensor) in self.sensors.iter().enumerate() {
            let rows = &self.prepared.rows[s];
            let base = self.prepared.bases[s].as_ref();
            let weights = SensorProblem::new(rows, base, &self.effects).weights;
            let [kx, kz] = base.stiffness(&self.values[s]);
            let of_row = |(part, row, response): (usize, usize, &Response)| {
                let (field, [fx, fz]) = change(s, part, row);
                let moved = Vector3::new(fx / kx, 0.0, fz / kz);
                <[f64; 3]>::from((field - response.per_mm * moved).component_mul(&weights))
            };
            let entries: Vec<f64> = sensor.ground.responses().flat_map(of_row).collect();
            let all: usize = rows.parts.iter().map(|part| part.len()).sum();
            let stand_for = 3.0 * all as f64 / entries.len().max(1) as f64;
            let apart = sensor.apart(&DMatrix::from_vec(entries.len(), 1, entries));
            squares += stand_for * apart.norm_squared();
        }
        squares.sqrt()
    }

    /// Share of the squared residual left out, in teeth of every recording, that a curve free in time
    /// takes away: one for each axis, sensor and recording.
    ///
    /// What happens at an instant or from one recording to the next can only be judged within
    /// recordings, where any slow noise is foretold by the rows beside: there an effect says something
    /// only if it explains about as much as a curve that knows no physics.
    pub fn free_in_time(&self) -> f64 {
        let judged = self.sensors.par_iter().enumerate().map(|(s, sensor)| {
            let columns = sensor.ground.hats(&self.prepared.rows[s], KNOTS);
            let folds = sensor.left_out(&columns, 1);
            folds
                .iter()
                .fold((0.0, 0.0), |(a, b), f| (a + f.0, b + f.1))
        });
        let (without, with) = judged.reduce(|| (0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        1.0 - with / without
    }

    /// Values of a model with one effect more than was fitted.
    fn spread(&self, problem: &SensorProblem, place: usize, values: &[f64]) -> Vec<f64> {
        let own = problem.ranges()[place].clone();
        let mut all: Vec<f64> = problem.slots.iter().map(|slot| slot.start).collect();
        let others = (0..all.len()).filter(|slot| !own.contains(slot));
        for (slot, value) in others.zip(values) {
            all[slot] = *value;
        }
        all
    }

    /// Products of a candidate's answers with the residual (or what `beside` leaves of it), block by
    /// block, for each sensor.
    fn scores(&self, evidence: &Evidence, beside: Option<&Evidence>) -> Vec<Vec<DVector<f64>>> {
        let one = |s: usize| {
            let sensor = &self.sensors[s];
            let mut left = sensor.left();
            if let Some(best) = beside {
                let apart = &best.apart[s];
                let coefficients = &best.inverse[s] * apart.tr_mul(&left);
                left -= apart * coefficients;
            }
            let apart = &evidence.apart[s];
            let mut scores = vec![DVector::zeros(apart.ncols()); self.blocks];
            for (row, &block) in sensor.block.iter().enumerate() {
                for entry in 3 * row..3 * row + 3 {
                    for (j, score) in scores[block].iter_mut().enumerate() {
                        *score += apart[(entry, j)] * left[entry];
                    }
                }
            }
            scores
        };
        (0..self.sensors.len()).into_par_iter().map(one).collect()
    }

    /// What a candidate explains where blocks have these signs.
    fn explained(&self, evidence: &Evidence, scores: &[Vec<DVector<f64>>], signs: &[f64]) -> f64 {
        let mut sum = 0.0;
        for (scores, inverse) in scores.iter().zip(&evidence.inverse) {
            let mut score = DVector::zeros(evidence.count);
            for (of_block, sign) in scores.iter().zip(signs) {
                score.axpy(*sign, of_block, 1.0);
            }
            sum += score.dot(&(inverse * &score));
        }
        sum
    }

    /// What each candidate would explain of the residual that `best` leaves, under each draw of signs.
    pub fn drawn(&self, evidence: &Evidence, best: &Evidence, draws: &[Vec<f64>]) -> Vec<f64> {
        let scores = self.scores(evidence, Some(best));
        let draw = |signs: &Vec<f64>| self.explained(evidence, &scores, signs);
        draws.par_iter().map(draw).collect()
    }

    /// How far the typical size stands out: of what the residual shows by blocks, of noise, and of noise
    /// with nothing else fitted; and the most that the candidate may be in typical sizes.
    fn typical(&self, evidence: &mut Evidence, candidate: &Addition, answers: &[DMatrix<f64>]) {
        let parameters = candidate.parameters(self.recordings);
        let typical: Vec<f64> = parameters
            .iter()
            .filter(|parameter| parameter.is_coefficient())
            .map(|parameter| parameter.typical)
            .collect();
        let (mut singles, mut bound) = (Vec::new(), 0.0_f64);
        let (mut in_noise, mut alone) = (Vec::new(), Vec::new());
        for j in 0..evidence.count {
            if typical.get(j).is_none_or(|typical| typical.is_nan()) {
                continue;
            }
            let (mut norm, mut by_block) = (0.0, vec![0.0; self.blocks]);
            for (sensor, apart) in self.sensors.iter().zip(&evidence.apart) {
                // Columns are by departure, and a typical size is a tenth of one.
                let column = apart.column(j) * 0.1;
                let left = sensor.left();
                norm += column.norm_squared();
                for (row, &block) in sensor.block.iter().enumerate() {
                    for entry in 3 * row..3 * row + 3 {
                        by_block[block] += column[entry] * left[entry];
                    }
                }
            }
            let norm = norm.sqrt();
            let squares: f64 = answers.iter().map(|a| a.column(j).norm_squared()).sum();
            in_noise.push(norm);
            alone.push(0.1 * squares.sqrt());
            let spread = by_block
                .iter()
                .map(|score| score * score)
                .sum::<f64>()
                .sqrt();
            if norm > 0.0 {
                // No residual is quieter than white noise of the floor's size.
                let z = norm / (spread / norm).max(1.0);
                let estimate = by_block.iter().sum::<f64>() / (norm * norm);
                bound = bound.max(estimate.abs() + 2.0 / z);
                singles.push(z);
            }
        }
        let together = |singles: &[f64]| match candidate.size().of {
            SizeOf::Norm => {
                let squares: f64 = singles.iter().map(|z| z * z).sum();
                (squares / singles.len().max(1) as f64).sqrt()
            }
            _ => singles.iter().copied().fold(0.0, f64::max),
        };
        evidence.z_typical = together(&singles);
        evidence.z_in_noise = together(&in_noise);
        evidence.z_alone = together(&alone);
        evidence.bound = bound;
    }
}

/// Number of the first block of each recording, and of all.
fn first_blocks(prepared: &Prepared, block_s: f64) -> (Vec<usize>, usize) {
    let recordings = prepared.rows.first().map_or(0, |rows| rows.parts.len());
    let (mut firsts, mut next) = (Vec::new(), 0);
    for recording in 0..recordings {
        let last = prepared
            .rows
            .iter()
            .filter_map(|rows| rows.parts[recording].track.time_s.last());
        let blocks = last
            .map(|time| (time / block_s) as usize + 1)
            .max()
            .unwrap_or(0);
        firsts.push(next);
        next += blocks;
    }
    (firsts, next)
}

/// The part in which each row is left out.
fn part_of(folds: &[Fold], ground: &Ground) -> Vec<usize> {
    let find = |(part, row): (usize, usize)| {
        let holds = |fold: &Fold| {
            fold.test
                .iter()
                .any(|stretch| stretch.part == part && stretch.rows.contains(&row))
        };
        folds.iter().position(holds).unwrap_or(0)
    };
    ground.places().map(find).collect()
}

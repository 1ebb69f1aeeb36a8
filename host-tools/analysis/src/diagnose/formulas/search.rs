//! Search for the formulas that explain what a model leaves.

use anyhow::Result;
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::recordings::Campaign;
use model_export::recordings::columns::STATOR_CURRENTS;
use model_export::stop;
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;
use std::collections::BTreeSet;

use crate::diagnose::candidates::varying_covariates;
use crate::diagnose::fitted_model::{FittedModel, MIN_KEPT, NEAR};
use crate::diagnose::formulas::candidate::{COEFFICIENTS, Candidate, columns_at};
use crate::diagnose::formulas::chain_points::ChainPoint;
use crate::diagnose::formulas::dictionary::{Dictionary, RankedCandidate};
use crate::diagnose::formulas::discovered::DiscoveredFormula;
use crate::diagnose::formulas::harmonics::{self, TURN};
use crate::diagnose::formulas::rows::{self, SensorRows, Windows};
use crate::diagnose::formulas::scan::{self, Scan, Score, TermScan};
use crate::diagnose::observer::Observer;

const MAX_FORMULAS: usize = 4;
/// Squared error relative to the noise below which nothing is searched.
const AT_NOISE: f64 = 1.03;
/// Points of the chain within this fraction in the linearised model are fitted fully.
const NEAR_LINEAR: f64 = 0.2;
/// Minimum reduction of the held-out squared error.
const MIN_FORMULA_GAIN: f64 = 0.004;
/// Maximum family-wise p-value.
const MAX_P: f64 = 0.01;
/// Minimum fraction of the excess over the noise that all formulas explain together. Noise that wanders as slowly as a covariate
/// is correlated with it without a cause, and signs of blocks do not show that.
const MIN_EXPLAINED: f64 = 0.5;
/// Candidates of each class of complexity and number of columns that are scored exactly.
const EXACT: usize = 8;
/// Candidates whose nonlinear parameters are refined.
const REFINED: usize = 5;
/// Minimum reduction of the held-out squared error by nonlinear parameters that differ between sensors.
const OWN_GAIN: f64 = 0.1;
/// Points of the chain that are fitted fully.
const FINALISTS: usize = 4;
/// Fraction of the remaining work that a step takes.
pub(super) const STEP: f64 = 0.25;

/// Result of a search.
#[derive(Clone, Debug)]
pub struct Discovery {
    /// The formulas in the order of their acceptance.
    pub formulas: Vec<DiscoveredFormula>,
    /// The models with the first, the first two, ... of them.
    pub stages: Vec<FittedModel>,
}

impl Discovery {
    /// Whether the last of its models leaves noise only.
    pub fn is_at_floor(&self) -> bool {
        self.stages.last().is_some_and(FittedModel::is_at_floor)
    }
}

/// Whether a model explains most of what another leaves above the noise.
pub fn explains_most(model: &FittedModel, other: &FittedModel) -> bool {
    let excess =
        |model: &FittedModel| (model.mean_square() - model.fit.tally().floor_g().powi(2)).max(0.0);
    excess(model) <= (1.0 - MIN_EXPLAINED) * excess(other)
}

/// An accepted candidate.
#[derive(Clone)]
struct Accepted {
    candidate: Candidate,
    gain: f64,
    p_value: f64,
    /// Other points of the chain that explain as much; `None` where they were not compared.
    others: Option<Vec<Vec<ChainPoint>>>,
}

/// Where a search is: the formulas so far, with the model in which their nonlinear parameters are numbers, and with that in which
/// they are fitted.
struct Step<'a> {
    start: &'a FittedModel,
    accepted: &'a [Accepted],
    model: &'a FittedModel,
    free: &'a FittedModel,
}

/// Whether a formula is added.
enum Attempt {
    /// With the models of [`Step`] after it.
    Accepted(Accepted, Box<FittedModel>, Box<FittedModel>),
    /// Its nonlinear parameters, fitted without a fold, raise the error there.
    Overfitted,
    Rejected,
}

/// Share of the square of another sensor's force that the forces on the own one may explain in a linear regression; with more, its
/// effect is that of an own force.
const MAX_SHARED: f64 = 0.9;

/// Forces that act on one sensor, where they differ from those on the others.
fn independent_forces_of_others(setup: &FitSetup) -> Vec<String> {
    let tracks = || setup.rows.iter().map(|rows| rows.parts.iter().map(|part| &part.track));
    let names = tracks().flatten().flat_map(|track| track.forces_of_others.keys());
    let names: BTreeSet<&String> = names.collect();
    let is_independent = |name: &&String| {
        tracks().any(|parts| {
            let (mut normal, mut moments, mut square) = (Matrix2::zeros(), Vector2::zeros(), 0.0);
            for track in parts {
                let Some(values) = track.forces_of_others.get(*name) else { return false };
                for (own, value) in track.force_n.iter().zip(values) {
                    let own = Vector2::from(*own);
                    normal += own * own.transpose();
                    moments += own * *value;
                    square += value * value;
                }
            }
            let explained = normal
                .pseudo_inverse(f64::EPSILON * normal.trace())
                .map_or(square, |inverse| moments.dot(&(inverse * moments)));
            explained < MAX_SHARED * square
        })
    };
    names.into_iter().filter(is_independent).cloned().collect()
}

/// Search on one campaign.
pub struct FormulaSearch<'a> {
    setup: &'a FitSetup,
    options: FitOptions,
    points: Vec<ChainPoint>,
    windows: Vec<Vec<Windows>>,
    block_s: f64,
    dictionary: Dictionary,
}

impl<'a> FormulaSearch<'a> {
    /// Over the covariates that vary; of the rotor's turn the harmonics in the residual of `last`. `block_s`: length in
    /// seconds of the blocks of residuals that are independent.
    pub fn new(
        campaign: &Campaign,
        (setup, last): (&'a FitSetup, &FittedModel),
        block_s: f64,
        options: FitOptions,
    ) -> Self {
        let (points, axes) = ChainPoint::of(setup);
        let covariates: Vec<String> = varying_covariates(campaign, axes)
            .into_iter()
            .filter(|name| !STATOR_CURRENTS.contains(&name.as_str()))
            .chain(independent_forces_of_others(setup))
            .collect();
        let windows = rows::windows(setup);
        let harmonics = match covariates.iter().any(|name| name == TURN) {
            true => harmonics::of_residual(setup, last, &windows),
            false => Vec::new(),
        };
        let dictionary = Dictionary::new(setup, &covariates, &harmonics, &windows);
        Self { setup, options, points, windows, block_s, dictionary }
    }

    /// Number of terms.
    pub fn size(&self) -> usize {
        self.dictionary.values().first().map_or(0, nalgebra::DMatrix::nrows)
    }

    /// Searches from the model `start`; `None` where nothing is found.
    ///
    /// # Errors
    /// A fit fails.
    pub fn run(&self, start: &FittedModel, observer: &Observer) -> Result<Option<Discovery>> {
        let mut accepted: Vec<Accepted> = Vec::new();
        let mut model = start.clone();
        // With the nonlinear parameters fitted in every fold.
        let mut free = start.clone();
        while accepted.len() < MAX_FORMULAS && self.size() > 0 && !observer.is_stopped() {
            observer.stage(&format!("searching formulas, step {}", accepted.len() + 1), STEP);
            let scan = self.scan(&model);
            let before = scan.score(&[]);
            if before.held_out() < AT_NOISE * scan.entries() as f64 {
                break;
            }
            let terms = TermScan::new(&scan, self.dictionary.values());
            let step = Step { start, accepted: &accepted, model: &model, free: &free };
            let any = self.next(&step, (&terms, &scan, &before), false)?;
            // Nonlinear parameters of one fold may not hold in another.
            let found = match any {
                Attempt::Overfitted => self.next(&step, (&terms, &scan, &before), true)?,
                other => other,
            };
            let Attempt::Accepted(new, next, next_free) = found else { break };
            accepted.push(new);
            (model, free) = (*next, *next_free);
        }
        if accepted.is_empty() || !explains_most(&model, start) {
            return Ok(None);
        }
        // Where structure remains, the formulas are approximations, and so are their points of the chain.
        if model.is_at_floor() && !observer.is_stopped() {
            observer.stage("deciding where the formulas act", STEP);
            self.drop_needless(start, &mut model, &mut accepted)?;
            for place in 0..accepted.len() {
                self.decide_points(start, &mut model, &mut accepted, place)?;
            }
        }
        let mut discovery = Discovery { formulas: Vec::new(), stages: Vec::new() };
        let mut effects = start.effects.clone();
        for (number, accepted) in accepted.into_iter().enumerate() {
            let name = self.name(start, number);
            let own = accepted.candidate.effects(&name, true)?;
            effects.extend(own.iter().cloned());
            let split = self.setup.split(&effects);
            // Without nonlinear parameters nothing changes.
            let stage = if model.effects == effects && model.fit.split == split {
                model.clone()
            } else {
                FittedModel::new(self.setup, effects.clone(), split, self.options)?
            };
            discovery.stages.push(stage);
            discovery.formulas.push(DiscoveredFormula {
                name,
                effects: own,
                models: Vec::new(),
                covariates: accepted.candidate.covariates(),
                targets: accepted.candidate.targets(),
                gain: accepted.gain,
                p_value: accepted.p_value,
                other_targets: accepted.others.map(|others| {
                    let targets = |points: &Vec<ChainPoint>| {
                        points.iter().map(|point| point.target().0).collect()
                    };
                    others.iter().map(targets).collect()
                }),
            });
        }
        Ok(Some(discovery))
    }

    /// The best candidate, if it lowers the held-out error in every fold significantly.
    fn next(
        &self,
        step: &Step,
        (terms, scan, before): (&TermScan, &Scan, &Score),
        is_linear: bool,
    ) -> Result<Attempt> {
        let Some((candidate, score)) = self.best(terms, scan, before, is_linear) else {
            return Ok(Attempt::Rejected);
        };
        let gain = 1.0 - score.held_out() / before.held_out();
        let improves = score.folds.iter().zip(&before.folds).all(|(new, old)| new < old);
        if gain < MIN_FORMULA_GAIN || !improves {
            return Ok(Attempt::Rejected);
        }
        let p_value = terms.p_value(&self.columns(scan, &candidate), self.options.seed);
        if p_value >= MAX_P {
            return Ok(Attempt::Rejected);
        }
        let new = Accepted { candidate, gain, p_value, others: None };
        let mut all = step.accepted.to_vec();
        all.push(new.clone());
        let Ok(next) = self.fitted(step.start, &all) else {
            return Ok(Attempt::Rejected);
        };
        if next.gain(step.model) < MIN_FORMULA_GAIN || !next.improves(step.model) {
            return Ok(Attempt::Rejected);
        }
        if all.iter().all(|one| one.candidate.nonlinear().is_empty()) {
            return Ok(Attempt::Accepted(new, Box::new(next.clone()), Box::new(next)));
        }
        let effects = self.effects(step.start, &all, true)?;
        let split = self.setup.split(&effects);
        let free = FittedModel::new(self.setup, effects, split, self.options)?;
        if new.candidate.nonlinear().is_empty() || free.improves_all_folds(step.free) {
            Ok(Attempt::Accepted(new, Box::new(next), Box::new(free)))
        } else {
            Ok(Attempt::Overfitted)
        }
    }

    /// Name of the formula with this index, which no effect of the model has.
    fn name(&self, start: &FittedModel, number: usize) -> String {
        let taken = |name: &str| start.effects.iter().any(|effect| effect.name().starts_with(name));
        let names = (number + 1..).map(|number| format!("formula_{number}"));
        let mut free = names.filter(|name| !taken(name));
        free.next().unwrap_or_default()
    }

    fn scan(&self, model: &FittedModel) -> Scan {
        self.scan_without(model, &[])
    }

    /// The model linearised, without the columns of some of its formulas.
    fn scan_without(&self, model: &FittedModel, without: &[EffectTerm]) -> Scan {
        let (points, windows) = (&self.points, &self.windows);
        Scan::new(rows::of_model(self.setup, model, without, points, windows, self.block_s))
    }

    fn columns(&self, scan: &Scan, candidate: &Candidate) -> scan::Columns {
        candidate.columns(self.setup, scan, &self.points, &self.windows)
    }

    /// The model with these formulas.
    fn fitted(&self, start: &FittedModel, accepted: &[Accepted]) -> Result<FittedModel> {
        let effects = self.effects(start, accepted, false)?;
        let split = self.setup.split(&effects);
        FittedModel::new(self.setup, effects, split, self.options)
    }

    /// Effects of the initial model and of the formulas, see [`Candidate::effects`].
    fn effects(
        &self,
        start: &FittedModel,
        accepted: &[Accepted],
        has_ranges: bool,
    ) -> Result<Vec<EffectTerm>> {
        let mut effects = start.effects.clone();
        for (number, accepted) in accepted.iter().enumerate() {
            effects.extend(accepted.candidate.effects(&self.name(start, number), has_ranges)?);
        }
        Ok(effects)
    }

    /// The simplest candidate within 2 % of the least remaining squared error, with its score; `is_linear`: without nonlinear
    /// parameters.
    fn best(
        &self,
        terms: &TermScan,
        scan: &Scan,
        before: &Score,
        is_linear: bool,
    ) -> Option<(Candidate, Score)> {
        let gains = terms.gains();
        let ranked = self.dictionary.ranked(&gains, &self.points, EXACT);
        let mut scored: Vec<(Candidate, Score)> = ranked
            .into_par_iter()
            .filter(|ranked| !is_linear || ranked.candidate.nonlinear().is_empty())
            .map(|RankedCandidate { candidate, terms }| {
                stop::check();
                let of_sensor = |(sensor, rows): (usize, &SensorRows)| {
                    let values = self.dictionary.values_of(sensor, &terms);
                    columns_at(rows, &values, &candidate.points, &self.points)
                };
                let columns: scan::Columns = scan.rows.iter().enumerate().map(of_sensor).collect();
                (candidate, scan.score(&columns))
            })
            .collect();
        scored.sort_by(|a, b| a.1.held_out().total_cmp(&b.1.held_out()));
        let refined: Vec<(Candidate, Score)> = scored
            .iter()
            .take(REFINED)
            .flat_map(|(candidate, _)| {
                let refined = self.refined_by_sensor(scan, self.refined(scan, candidate));
                let extended = self.extended(scan, &refined.0, refined.1.held_out());
                let series = self.with_harmonics(scan, &refined.0, refined.1.held_out());
                extended.into_iter().chain(series).chain([refined])
            })
            .collect();
        scored.extend(refined);
        let least = scored.iter().map(|(_, score)| score.held_out()).fold(f64::INFINITY, f64::min);
        if !least.is_finite() || least >= before.held_out() {
            return None;
        }
        let is_near = |(_, score): &&(Candidate, Score)| score.held_out() <= (1.0 + NEAR) * least;
        let order = |a: &&(Candidate, Score), b: &&(Candidate, Score)| {
            let complexity = a.0.complexity().total_cmp(&b.0.complexity());
            complexity.then(a.1.held_out().total_cmp(&b.1.held_out()))
        };
        scored.iter().filter(is_near).min_by(order).cloned()
    }

    /// The candidate with its nonlinear parameters at the least squared error on the fitted rows.
    fn refined(&self, scan: &Scan, candidate: &Candidate) -> (Candidate, Score) {
        let score = |candidate: &Candidate| scan.score(&self.columns(scan, candidate));
        let best = minimise(candidate, |candidate| score(candidate).fitted, MIN_DESCENT);
        let score = score(&best);
        (best, score)
    }

    /// With nonlinear parameters that differ between sensors, where that removes clearly more.
    fn refined_by_sensor(&self, scan: &Scan, shared: (Candidate, Score)) -> (Candidate, Score) {
        if shared.0.nonlinear().is_empty() || scan.rows.len() < 2 {
            return shared;
        }
        let of_sensor = |sensor: usize| {
            let fitted = |candidate: &Candidate| {
                let (points, windows) = (&self.points, &self.windows);
                let columns = candidate.columns_of(sensor, self.setup, scan, points, windows);
                scan.score_of(sensor, Some(&columns)).fitted
            };
            let best = minimise(&shared.0, fitted, 0.0);
            best.nonlinear().iter().map(|parameter| parameter.value).collect()
        };
        let own = (0..scan.rows.len()).into_par_iter().map(of_sensor).collect();
        let candidate = Candidate { own, ..shared.0.clone() };
        let score = scan.score(&self.columns(scan, &candidate));
        let is_better = score.held_out() < (1.0 - OWN_GAIN) * shared.1.held_out();
        if is_better { (candidate, score) } else { shared }
    }

    /// The best of the candidate's extensions, where the remaining squared error falls by more than 2 %.
    fn extended(
        &self,
        scan: &Scan,
        candidate: &Candidate,
        held_out: f64,
    ) -> Option<(Candidate, Score)> {
        let scored = candidate.extensions().into_iter().map(|extended| {
            let score = scan.score(&self.columns(scan, &extended));
            (extended, score)
        });
        let best = scored.min_by(|a, b| a.1.held_out().total_cmp(&b.1.held_out()))?;
        (best.1.held_out() < (1.0 - NEAR) * held_out).then_some(best)
    }

    /// Harmonics of an angle with further ones, each of which reduces the remaining squared error by more than 2 %.
    fn with_harmonics(
        &self,
        scan: &Scan,
        candidate: &Candidate,
        held_out: f64,
    ) -> Option<(Candidate, Score)> {
        let mut found: Option<(Candidate, Score)> = None;
        loop {
            let (current, least) = match &found {
                Some((current, score)) => (current, score.held_out()),
                None => (candidate, held_out),
            };
            if current.terms.len() + 2 > COEFFICIENTS.len() {
                return found;
            }
            let extended = self.dictionary.further_harmonics(current).into_par_iter().map(|pair| {
                let terms = current.terms.iter().cloned().chain(pair).collect();
                let extended = Candidate { terms, ..current.clone() };
                let score = scan.score(&self.columns(scan, &extended));
                (extended, score)
            });
            let best = extended.min_by(|a, b| a.1.held_out().total_cmp(&b.1.held_out()));
            match best.filter(|(_, score)| score.held_out() < (1.0 - NEAR) * least) {
                Some(best) => found = Some(best),
                None => return found,
            }
        }
    }

    /// Drops formulas without which the squared error is hardly larger.
    fn drop_needless(
        &self,
        start: &FittedModel,
        model: &mut FittedModel,
        accepted: &mut Vec<Accepted>,
    ) -> Result<()> {
        let mut place = 0;
        while accepted.len() > 1 && place < accepted.len() {
            let mut fewer = accepted.clone();
            fewer.remove(place);
            let without = self.fitted(start, &fewer)?;
            if without.mean_square() < (1.0 + MIN_KEPT) * model.mean_square() {
                (*accepted, *model) = (fewer, without);
            } else {
                place += 1;
            }
        }
        Ok(())
    }

    /// Decides at which points of the chain a formula acts: by the whole model linearised with the formula at its present point,
    /// and by full fits where other points are near. `model` has the formulas, before and after.
    fn decide_points(
        &self,
        start: &FittedModel,
        model: &mut FittedModel,
        accepted: &mut [Accepted],
        place: usize,
    ) -> Result<()> {
        let fit = |candidate: &Candidate| {
            let mut all = accepted.to_vec();
            all[place].candidate = candidate.clone();
            let effects = self.effects(start, &all, false)?;
            FittedModel::without_validation(self.setup, effects, self.options)
        };
        let current = accepted[place].candidate.clone();
        if !current.own.is_empty() {
            // Not linear in its parameters: the point of the search stays.
            return Ok(());
        }
        let own = current.effects(&self.name(start, place), false)?;
        let scan = self.scan_without(model, &own);
        let mut options: Vec<Vec<ChainPoint>> =
            self.points.iter().map(|point| vec![*point]).collect();
        options.extend(ChainPoint::vectors(&self.points));
        if !options.contains(&current.points) {
            options.push(current.points.clone());
        }
        let mut scored: Vec<(Candidate, f64)> = options
            .into_par_iter()
            .map(|points| {
                let candidate = Candidate { points, ..current.clone() };
                let score = scan.score(&self.columns(&scan, &candidate)).fitted;
                (candidate, score)
            })
            .collect();
        scored.sort_by(|a, b| a.1.total_cmp(&b.1));
        let least = scored.first().map_or(0.0, |(_, score)| *score);
        let is_current = |candidate: &Candidate| candidate.points == current.points;
        let near = scored.into_iter().filter(|(candidate, score)| {
            *score < (1.0 + NEAR_LINEAR) * least || is_current(candidate)
        });
        let mut finalists: Vec<(Candidate, f64)> = near
            .enumerate()
            .filter(|(rank, (candidate, _))| *rank < FINALISTS || is_current(candidate))
            .filter_map(|(_, (candidate, _))| {
                let score = |model: &FittedModel| self.scan(model).score(&[]).fitted;
                let score = if is_current(&candidate) {
                    score(model)
                } else {
                    score(&fit(&candidate).ok()?)
                };
                Some((candidate, score))
            })
            .collect();
        finalists.sort_by(|a, b| a.1.total_cmp(&b.1));
        let Some(least) = finalists.first().map(|(_, score)| *score) else {
            return Ok(());
        };
        let near = || finalists.iter().filter(|(_, score)| *score <= (1.0 + NEAR) * least);
        let order = |a: &&(Candidate, f64), b: &&(Candidate, f64)| {
            let columns = a.0.points.len().cmp(&b.0.points.len());
            columns.then(a.1.total_cmp(&b.1))
        };
        let Some(chosen) = near().min_by(order) else {
            return Ok(());
        };
        let others = near().filter(|(other, _)| other.points != chosen.0.points);
        accepted[place].others = Some(others.map(|(other, _)| other.points.clone()).collect());
        let chosen = chosen.0.clone();
        if chosen != current {
            accepted[place].candidate = chosen;
            *model = self.fitted(start, accepted)?;
        }
        Ok(())
    }
}

/// Reduction of the squared error by a pass over the nonlinear parameters, from which another one follows.
const MIN_DESCENT: f64 = 0.01;

/// Coordinate descent over the nonlinear parameters: two passes, the second one unless the first reduces the error by less than the
/// fraction `min_descent`.
fn minimise(
    candidate: &Candidate,
    error: impl Fn(&Candidate) -> f64,
    min_descent: f64,
) -> Candidate {
    let mut best = candidate.clone();
    let mut least = error(&best);
    for _ in 0..2 {
        let start = least;
        for parameter in 0..best.nonlinear().len() {
            let bounds = best.nonlinear()[parameter];
            let at = |value: f64| error(&best.with_nonlinear(parameter, value));
            let Some(found) = minimum(bounds.from, bounds.to, at) else { continue };
            let moved = best.with_nonlinear(parameter, found);
            let new = error(&moved);
            if new < least {
                (best, least) = (moved, new);
            }
        }
        if least > (1.0 - min_descent) * start {
            break;
        }
    }
    best
}

/// Place of the minimum of a function between two bounds: a grid, then a golden-section search.
fn minimum(from: f64, to: f64, value: impl Fn(f64) -> f64) -> Option<f64> {
    const GRID: usize = 7;
    const STEPS: usize = 12;
    let grid: Vec<f64> =
        (0..GRID).map(|i| from + (to - from) * i as f64 / (GRID - 1) as f64).collect();
    let values: Vec<f64> = grid.iter().map(|at| value(*at)).collect();
    let best = (0..GRID).min_by(|a, b| values[*a].total_cmp(&values[*b]))?;
    let (mut low, mut high) = (grid[best.saturating_sub(1)], grid[(best + 1).min(GRID - 1)]);
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    let inner = |low: f64, high: f64| (high - golden * (high - low), low + golden * (high - low));
    let (mut left, mut right) = inner(low, high);
    let (mut at_left, mut at_right) = (value(left), value(right));
    for _ in 0..STEPS {
        if at_left < at_right {
            (high, right, at_right) = (right, left, at_left);
            left = inner(low, high).0;
            at_left = value(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = inner(low, high).1;
            at_right = value(right);
        }
    }
    let (at, least) = if at_left < at_right { (left, at_left) } else { (right, at_right) };
    Some(if least < values[best] { at } else { grid[best] })
}

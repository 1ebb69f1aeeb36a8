//! One step of the forward selection: full fits of the significant candidates. The one with the largest reduction
//! of the cross-validated error is added; candidates close to it are provisionally equivalent.

use crate::diagnose::candidates::{LEVEL, REPLACES, ScreenedEffect};
use crate::diagnose::fitted_model::{DISTINGUISHABLE, FittedModel, MIN_GAIN, MIN_KEPT};
use crate::diagnose::selection::{AcceptedStep, ImplausibleFit, SMALL, Selection};
use anyhow::Result;
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::score_test::ScoreTest;
use rayon::prelude::*;
use std::borrow::Cow;

/// Maximum number of candidates fitted per step, the best by the linearised score test.
const MAX_FITTED: usize = 5;
/// Maximum number of candidates fitted where none lowers the error of the linearised model.
const MAX_UNDETERMINED: usize = 3;
/// Maximum number of candidates that are fitted in pairs.
const MAX_IN_PAIRS: usize = 7;
/// Pairs that are fitted at all, the best by the linearised score test.
const PAIRS_FITTED: usize = 8;
/// Rows of each recording on which they are fitted first.
const PAIR_ROWS: usize = 150;
/// The best of them, which are fitted to the rows of the selection.
const PAIRS_ON_SAMPLE: usize = 4;
/// Minimum gain of a fitted candidate relative to the best.
const MIN_RELATIVE_GAIN: f64 = 0.5;
/// Candidates within this fraction of the best gain are provisionally equivalent.
const NEAR: f64 = 0.05;
/// Minimum relative gain of an equivalent effect where the recordings hardly distinguish the two.
const COLLINEAR_GAIN: f64 = 0.5;
/// Minimum gain of a transient effect relative to everything that is not noise: with less, it imitates something in time, and
/// its many coefficients take long to fit.
const MIN_OF_EXCESS: f64 = 0.2;
/// Another form of an accepted effect that reduces the error by less than this fraction of its reduction is its remainder.
const MAX_REMAINDER: f64 = 0.2;

struct FittedCandidate<'a> {
    screened: &'a ScreenedEffect,
    stage: FittedModel,
    /// Relative reduction of the cross-validated squared error.
    gain: f64,
    /// Reduction in gauss squared.
    reduction: f64,
    /// Whether it lowers the error ([`FittedModel::improves`]).
    is_improvement: bool,
    /// Whether its magnitude is plausible.
    is_plausible: bool,
}

impl FittedCandidate<'_> {
    fn is_cause(&self) -> bool {
        self.is_improvement && self.is_plausible
    }
}

/// The best candidate, its provisional equivalents, and the rest.
struct Ranking<'a> {
    best: FittedCandidate<'a>,
    tied: Vec<EffectTerm>,
    shadows: Vec<EffectTerm>,
}

/// The best significant candidate with its model; `None` where no candidate improves the error with a plausible magnitude. Those
/// that do so with an implausible one are added to `implausible`.
///
/// Transient effects are cross-validated within recordings, which is easier, so they are ranked separately. Of the
/// two best candidates, the better one within recordings is added.
///
/// # Errors
/// The model cannot be fitted.
pub fn best_candidate(
    prepared: &FitSetup,
    stage: &FittedModel,
    selection: &Selection,
    options: FitOptions,
    implausible: &mut Vec<ImplausibleFit>,
) -> Result<Option<(AcceptedStep, FittedModel)>> {
    let excess = 1.0 - stage.floors().powi(-2);
    let candidates = candidates_to_fit(&selection.last, excess);
    let (within, ordinary): (Vec<_>, Vec<_>) =
        candidates.into_iter().partition(|screened| screened.candidate.is_transient());
    let ordinary = CandidateFit::new(prepared, stage, &ordinary, options)?.rank(
        &ordinary,
        selection,
        implausible,
    );
    let transient = CandidateFit::new(prepared, stage, &within, options)?;
    let within = transient.rank(&within, selection, implausible);
    let outcome = match (ordinary, within) {
        (Some(ordinary), Some(within)) => transient.better_of(ordinary, within, selection),
        (one, other) => match one.or(other) {
            Some(outcome) => outcome,
            None => return Ok(None),
        },
    };
    let best = outcome.best;
    let step = AcceptedStep {
        tied: outcome.tied,
        shadows: outcome.shadows,
        gain: best.gain,
        reduction: best.reduction,
        ..AcceptedStep::new(best.screened, &best.stage, stage)
    };
    let own = prepared.split(&best.stage.effects);
    Ok(Some((step, best.stage.with_split(prepared, own, options))))
}

/// Two candidates that lower the error in every fold together, where none does alone: what one explains is hidden by the other.
/// Returns both steps with their models; the first is the one that explains more by itself.
///
/// # Errors
/// The model cannot be fitted.
pub fn best_pair<'s>(
    prepared: &FitSetup,
    stage: &FittedModel,
    selection: &'s Selection,
    options: FitOptions,
) -> Result<Option<[(AcceptedStep, FittedModel); 2]>> {
    // What the other one hides may make one of them insignificant.
    let testable = |s: &&ScreenedEffect| {
        let improves = s.evidence.wins() == s.evidence.folds.len() && s.evidence.gain() > MIN_GAIN;
        !s.candidate.is_transient() && (improves || s.p_explained < LEVEL)
    };
    let mut contenders: Vec<&'s ScreenedEffect> = selection.last.iter().filter(testable).collect();
    // The held-out error of one alone says little here: by what they explain of the fitted rows.
    contenders.sort_by(|a, b| b.evidence.explained.total_cmp(&a.evidence.explained));
    contenders.truncate(MAX_IN_PAIRS);
    let around = ScoreTest::new(prepared, &stage.effects, &stage.fit, selection.block_s);
    let mut pairs: Vec<(f64, [&'s ScreenedEffect; 2])> = contenders
        .iter()
        .enumerate()
        .flat_map(|(i, one)| contenders[i + 1..].iter().map(move |other| [*one, *other]))
        .map(|pair| {
            let [one, other] = pair;
            (around.explained_together(&one.evidence, &other.evidence), pair)
        })
        .collect();
    pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
    let pairs = pairs.into_iter().take(PAIRS_FITTED).map(|(_, pair)| pair).collect();
    let with = |added: &[&ScreenedEffect]| -> Vec<EffectTerm> {
        let added = added.iter().map(|screened| screened.candidate.clone());
        stage.effects.iter().cloned().chain(added).collect()
    };
    let best = |pairs: Vec<[&'s ScreenedEffect; 2]>, setup: &FitSetup, count: usize| {
        let mut fits: Vec<(f64, [&'s ScreenedEffect; 2])> = pairs
            .into_par_iter()
            .filter_map(|pair| {
                let fit = FittedModel::without_validation(setup, with(&pair), options).ok()?;
                Some((fit.fitted_mean_square(), pair))
            })
            .collect();
        fits.sort_by(|a, b| a.0.total_cmp(&b.0));
        fits.into_iter().take(count).map(|(_, pair)| pair).collect::<Vec<_>>()
    };
    let finalists = best(pairs, &prepared.sampled(PAIR_ROWS), PAIRS_ON_SAMPLE);
    let Some(pair) = best(finalists, prepared, 1).pop() else {
        return Ok(None);
    };
    let recordings = prepared.recordings();
    let validated = |effects: Vec<EffectTerm>| {
        let split = prepared.split(&effects);
        FittedModel::new(prepared, effects, split, options)
    };
    let both = validated(with(&pair))?;
    let is_plausible = pair.iter().all(|one| both.is_plausible(&one.candidate, recordings));
    if !is_plausible
        || both.gain(stage) <= MIN_KEPT
        || !both.improves(stage)
        || !both.is_possible(recordings)
    {
        return Ok(None);
    }
    let alone = [validated(with(&pair[..1]))?, validated(with(&pair[1..]))?];
    // Each is needed next to the other one.
    if alone.iter().any(|one| !both.is_distinguishably_better(one) || !both.is_relevant(one)) {
        return Ok(None);
    }
    let [one, other] = alone;
    let [first, second] = pair;
    let (first, second, middle) = match one.mean_square() <= other.mean_square() {
        true => (first, second, one),
        false => (second, first, other),
    };
    let one = AcceptedStep::new(first, &middle, stage);
    let other = AcceptedStep { is_of_pair: true, ..AcceptedStep::new(second, &both, &middle) };
    Ok(Some([(one, middle), (other, both)]))
}

/// Fits of candidates with the same cross-validation.
struct CandidateFit<'a> {
    prepared: &'a FitSetup,
    before: Cow<'a, FittedModel>,
    options: FitOptions,
}

impl<'a> CandidateFit<'a> {
    /// The model without the candidates, with their cross-validation.
    fn new(
        prepared: &'a FitSetup,
        stage: &'a FittedModel,
        candidates: &[&ScreenedEffect],
        options: FitOptions,
    ) -> Result<Self> {
        let added = candidates.iter().map(|screened| &screened.candidate);
        let everything: Vec<EffectTerm> = stage.effects.iter().chain(added).cloned().collect();
        let split = prepared.split(&everything);
        let before = if split == stage.fit.split {
            Cow::Borrowed(stage)
        } else {
            Cow::Owned(FittedModel::new(prepared, stage.effects.clone(), split, options)?)
        };
        Ok(Self { prepared, before, options })
    }

    /// The model with one more effect; `None` where it cannot be fitted or has an impossible magnitude.
    fn fitted<'s>(&self, screened: &'s ScreenedEffect) -> Option<FittedCandidate<'s>> {
        let before = &self.before;
        let mut effects = before.effects.clone();
        effects.push(screened.candidate.clone());
        let stage =
            FittedModel::new(self.prepared, effects, before.fit.split, self.options).ok()?;
        let recordings = self.prepared.recordings();
        stage.is_possible(recordings).then(|| FittedCandidate {
            screened,
            gain: stage.gain(before),
            reduction: before.mean_square() - stage.mean_square(),
            is_improvement: stage.improves(before),
            is_plausible: stage.is_plausible(&screened.candidate, recordings),
            stage,
        })
    }

    /// Ranks the candidates; `None` where none improves the error.
    fn rank<'s>(
        &self,
        contenders: &[&'s ScreenedEffect],
        selection: &Selection,
        implausible: &mut Vec<ImplausibleFit>,
    ) -> Option<Ranking<'s>> {
        let fitted = contenders.par_iter().filter_map(|&screened| self.fitted(screened));
        let mut ranked: Vec<FittedCandidate> = fitted.collect();
        ranked.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        for one in ranked.iter().filter(|one| one.is_improvement && !one.is_plausible) {
            self.note_implausible(one, implausible);
        }
        let best = ranked.remove(winner(&ranked, selection)?);
        let is_near = |other: &FittedCandidate| {
            let near = equivalent_gain(best.screened, other.screened, selection);
            let is_alike = can_replace(other.screened, best.screened)
                || can_replace(best.screened, other.screened);
            let is_equal =
                other.stage.mean_square() <= (1.0 + DISTINGUISHABLE) * best.stage.mean_square();
            other.gain >= near * best.gain || (is_alike && is_equal)
        };
        let (tied, shadows) = ranked.into_iter().partition::<Vec<_>, _>(is_near);
        let plain = |list: Vec<FittedCandidate>| -> Vec<EffectTerm> {
            let candidates = list.into_iter().map(|c| c.screened.candidate.clone());
            candidates.collect()
        };
        Some(Ranking { tied: plain(tied), shadows: plain(shadows), best })
    }

    fn note_implausible(&self, one: &FittedCandidate, implausible: &mut Vec<ImplausibleFit>) {
        let effect = &one.screened.candidate;
        implausible.retain(|other| other.effect != *effect);
        if let Some(size) = one.stage.size_of(effect, self.prepared.recordings()) {
            implausible.push(ImplausibleFit { effect: effect.clone(), size, gain: one.gain });
        }
    }

    /// The better of `other`, with another cross-validation, and `own`, the ranking of these candidates.
    fn better_of<'s>(
        &self,
        other: Ranking<'s>,
        own: Ranking<'s>,
        selection: &Selection,
    ) -> Ranking<'s> {
        let Some(rival) = self.fitted(other.best.screened).filter(FittedCandidate::is_cause) else {
            return own;
        };
        let (high, low) = (rival.gain.max(own.best.gain), rival.gain.min(own.best.gain));
        let tied = low >= equivalent_gain(own.best.screened, rival.screened, selection) * high;
        let (mut first, second) =
            if rival.gain > own.best.gain { (other, own) } else { (own, other) };
        // Equivalents of the second are as far from the first as the second.
        let near = if tied { &mut first.tied } else { &mut first.shadows };
        near.push(second.best.screened.candidate.clone());
        near.extend(second.tied);
        first.shadows.extend(second.shadows);
        first
    }
}

/// Index of the best candidate that improves the error with a plausible magnitude and is not the remainder of an earlier step; `None`
/// where such a remainder or an implausible effect explains much more.
fn winner(ranked: &[FittedCandidate], selection: &Selection) -> Option<usize> {
    // The remainder of a larger effect is explained by other forms of it.
    let is_remainder = |candidate: &FittedCandidate| {
        let is_larger = |step: &AcceptedStep| candidate.reduction < MAX_REMAINDER * step.reduction;
        selection.forms(candidate.screened).any(is_larger)
    };
    let first = ranked.iter().find(|c| c.is_improvement)?;
    let is_cause = |c: &FittedCandidate| c.is_cause() && !is_remainder(c);
    let place = ranked.iter().position(is_cause)?;
    (ranked[place].gain >= SMALL * first.gain).then_some(place)
}

/// Minimum relative gain of a candidate that is equivalent to a better one.
fn equivalent_gain(one: &ScreenedEffect, other: &ScreenedEffect, selection: &Selection) -> f64 {
    let collinearity = &selection.collinearity;
    if collinearity.hides_the_difference(&one.candidate, &other.candidate) {
        COLLINEAR_GAIN
    } else {
        1.0 - NEAR
    }
}

/// Candidates to fit: those that lower the held-out error, sorted by the gain of the score test, and those that can replace the best. `excess` is
/// the fraction of the squared error that is not noise.
fn candidates_to_fit(screened: &[ScreenedEffect], excess: f64) -> Vec<&ScreenedEffect> {
    let within = |s: &ScreenedEffect| s.candidate.is_transient();
    // Full fits of all rows decide on an effect that is too small for the sample, or that one fold hides: there the linearised model
    // is far from a solution where much is missing. They are no test of a transient one: it is held out within recordings, where slow
    // noise predicts its neighbours.
    let is_tried = |s: &&ScreenedEffect| match within(s) {
        true => s.is_significant(),
        false => s.lowers_error() || s.p_adjusted < LEVEL,
    };
    let significant: Vec<&ScreenedEffect> = screened.iter().filter(is_tried).collect();
    let ordinary = significant.iter().find(|s| !within(s)).map_or(0.0, |s| s.evidence.gain());
    // A transient effect must be as good as the others.
    let is_fitted = |s: &&ScreenedEffect| {
        let least = match within(s) {
            true => ordinary.max(MIN_OF_EXCESS * excess) * (1.0 - NEAR),
            false => MIN_RELATIVE_GAIN * ordinary,
        };
        s.evidence.gain() >= least
    };
    let mut fitted: Vec<&ScreenedEffect> =
        significant.into_iter().filter(is_fitted).take(MAX_FITTED).collect();
    // With more coefficients, an effect that can do the same may not be significant by itself.
    if let Some(best) = fitted.iter().copied().find(|s| !within(s)) {
        let is_new = |s: &&ScreenedEffect| !fitted.iter().any(|own| std::ptr::eq(*own, *s));
        let others = screened.iter().filter(|s| !within(s) && can_replace(s, best));
        let others: Vec<&ScreenedEffect> = others.filter(is_new).collect();
        fitted.extend(others);
    }
    if fitted.is_empty() && !screened.iter().any(ScreenedEffect::lowers_error) {
        // What resembles a parameter of the model (the Earth's field its offset, of a gripper that hardly turns) predicts no other
        // rows in the linearised model, in which every direction is free. A fit keeps the directions that its rows do not determine.
        fitted = screened.iter().filter(|s| s.p_explained < LEVEL && !within(s)).collect();
        fitted.sort_by(|a, b| b.evidence.explained.total_cmp(&a.evidence.explained));
        fitted.truncate(MAX_UNDETERMINED);
    }
    fitted
}

/// Whether an effect reproduces nearly everything that `other` does to the fields.
fn can_replace(effect: &ScreenedEffect, other: &ScreenedEffect) -> bool {
    effect.evidence.reproduced_share(&other.evidence) >= REPLACES
}

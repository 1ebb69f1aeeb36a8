//! Forward selection: the effect that lowers the error left out most, fitted anew with everything else;
//! what explains the same as well is tied with it; then again, until nothing more is told from chance.

use anyhow::Result;
use model_export::effects::Addition;
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;
use model_export::fit::evidence::Around;
use model_export::recordings::Campaign;
use rayon::prelude::*;

use super::left::{block_s, located, residuals};
use super::screening::{LEAST_GAIN, Screened, screen};
use super::stage::Stage;
use crate::compare::covariate::Covariate;

/// Steps at the most.
const MOST_STEPS: usize = 6;
/// Candidates that are fitted in each step: the best by the straight lines, which order others well.
const CONTENDERS: usize = 5;
/// Share of the best candidate's gain below which another is no contender.
const CONTENDS: f64 = 0.3;
/// While this many times the floor is left, something large is missing and names are provisional.
pub const COMPLETE: f64 = 1.5;
/// What takes away all but this share of what the best contender does is tied with it at first.
const NEAR: f64 = 0.05;
/// Two effects are told apart where the better leaves less in every part left out, and less by this
/// share over all.
const TOLD: f64 = 0.002;
/// Where a covariate locates this share of what is left, and the best effect takes away less than
/// [`SMALL`] of it, the effect is not named: it would be a stand-in for part of something else.
const LOCATED: f64 = 0.3;
/// See [`LOCATED`].
const SMALL: f64 = 0.5;

/// A step that was accepted.
pub struct Step {
    /// The effect that is in the model from here on.
    pub chosen: Addition,
    /// Those that explain the same as well.
    pub tied: Vec<Addition>,
    /// Those that explain part of the same, and nothing beside it.
    pub shadows: Vec<Addition>,
    /// Share of the squared error left out that it took away.
    pub gain: f64,
    /// Probability of as much by chance.
    pub p_adjusted: f64,
    /// Typical size in error bars when it was judged.
    pub z_typical: f64,
}

/// What the selection ends with.
pub struct Selection {
    /// Accepted steps.
    pub steps: Vec<Step>,
    /// The models from the first to the last.
    pub stages: Vec<Stage>,
    /// Every candidate around the last model.
    pub last: Vec<Screened>,
    /// Covariates that what is left follows, with their shares of it.
    pub located: Vec<(Covariate, f64)>,
    /// Length of the blocks in seconds, and how many.
    pub block_s: f64,
    /// See `block_s`.
    pub blocks: usize,
}

/// Runs the selection from a model with the effects `present`.
pub fn select(
    campaign: &Campaign,
    prepared: &Prepared,
    present: &[Addition],
    candidates: &[Addition],
    options: Options,
    said: &dyn Fn(&str),
) -> Result<Selection> {
    let mut selection = Selection {
        steps: Vec::new(),
        stages: vec![Stage::new(
            prepared,
            present.to_vec(),
            prepared.split(present),
            options,
        )?],
        last: Vec::new(),
        located: Vec::new(),
        block_s: 0.0,
        blocks: 0,
    };
    loop {
        let stage = &selection.stages[selection.stages.len() - 1];
        let left: Vec<Addition> = candidates
            .iter()
            .filter(|c| !stage.effects.contains(c))
            .cloned()
            .collect();
        said("screening candidates");
        let columns = residuals(campaign, prepared, stage);
        selection.block_s = block_s(&columns);
        let around = Around::new(prepared, &stage.effects, &stage.fit, selection.block_s);
        selection.blocks = around.blocks;
        selection.last = screen(&around, &left, options.seed);
        selection.located = located(&columns, selection.block_s);
        if selection.steps.len() >= MOST_STEPS {
            break;
        }
        let Some((step, next)) = contest(prepared, stage, &selection, options, said)? else {
            break;
        };
        if let Some((_, share)) = selection.located.first() {
            let excess = 1.0 - stage.floors().powi(-2);
            if *share > LOCATED && stage.floors() > COMPLETE && step.gain < SMALL * share * excess {
                break;
            }
        }
        selection.steps.push(step);
        selection.stages.push(next);
    }
    retell(prepared, &mut selection, options, said)?;
    Ok(selection)
}

/// The candidates that are worth a fit of their own, the best by the straight lines first.
fn contenders(screened: &[Screened]) -> Vec<&Screened> {
    let significant: Vec<&Screened> = screened.iter().filter(|s| s.is_significant()).collect();
    let within = |s: &Screened| s.candidate.lives_in_one_recording();
    let ordinary = significant
        .iter()
        .find(|s| !within(s))
        .map_or(0.0, |s| s.evidence.gain());
    // What lives within recordings is judged within them, which is easier: it must do better.
    let contends = |s: &&Screened| match within(s) {
        true => s.evidence.gain() > ordinary,
        false => s.evidence.gain() >= CONTENDS * ordinary,
    };
    significant
        .into_iter()
        .filter(contends)
        .take(CONTENDERS)
        .collect()
}

/// The best of the significant candidates after fitting each anew, with what is tied with it.
fn contest(
    prepared: &Prepared,
    stage: &Stage,
    selection: &Selection,
    options: Options,
    said: &dyn Fn(&str),
) -> Result<Option<(Step, Stage)>> {
    let contenders = contenders(&selection.last);
    if contenders.is_empty() {
        return Ok(None);
    }
    said("fitting contenders");
    let recordings = prepared.rows.first().map_or(0, |rows| rows.parts.len());
    let with = |screened: &Screened| {
        let mut effects = stage.effects.clone();
        effects.push(screened.candidate.clone());
        effects
    };
    let mut quick: Vec<(&Screened, Stage)> = contenders
        .par_iter()
        .filter_map(|screened| Some((*screened, Stage::quick(prepared, with(screened)).ok()?)))
        .filter(|(_, stage)| stage.is_possible(recordings))
        .collect();
    quick.sort_by(|a, b| {
        a.1.fitted_mean_square()
            .total_cmp(&b.1.fitted_mean_square())
    });
    let Some((best, first)) = quick.first() else {
        return Ok(None);
    };
    let split = prepared.split(&first.effects);
    let winner = Stage::new(prepared, first.effects.clone(), split, options)?;
    let before = match split == stage.fit.split {
        true => None,
        false => Some(Stage::new(prepared, stage.effects.clone(), split, options)?),
    };
    let before = before.as_ref().unwrap_or(stage);
    let gain = 1.0 - winner.mean_square() / before.mean_square();
    if gain <= LEAST_GAIN || !winner.wins(before) {
        return Ok(None);
    }
    // What comes close is tied until the end, when nothing larger stands in the way of telling.
    let near = |other: &Stage| {
        let (old, won) = (stage.fitted_mean_square(), first.fitted_mean_square());
        other.fitted_mean_square() - won <= NEAR * (old - won)
    };
    let others = || quick[1..].iter();
    let named = |keep: bool| -> Vec<Addition> {
        let of = others().filter(|(_, other)| near(other) == keep);
        of.map(|(screened, _)| screened.candidate.clone()).collect()
    };
    let step = Step {
        chosen: best.candidate.clone(),
        tied: named(true),
        shadows: named(false),
        gain,
        p_adjusted: best.p_adjusted,
        z_typical: best.evidence.z_typical,
    };
    Ok(Some((step, winner)))
}

/// Tells the members of tied sets apart in the last model, where nothing larger hides the difference: a
/// tie remains where another member leaves as little in some part left out, or hardly more in all.
fn retell(
    prepared: &Prepared,
    selection: &mut Selection,
    options: Options,
    said: &dyn Fn(&str),
) -> Result<()> {
    let recordings = prepared.rows.first().map_or(0, |rows| rows.parts.len());
    for i in 0..selection.steps.len() {
        if selection.steps[i].tied.is_empty() {
            continue;
        }
        said("telling ties apart");
        let step = &selection.steps[i];
        let Some(last) = selection.stages.last() else {
            return Ok(());
        };
        let instead = |other: &Addition| {
            let swap = |effect: &Addition| match effect == &step.chosen {
                true => other.clone(),
                false => effect.clone(),
            };
            last.effects.iter().map(swap).collect::<Vec<_>>()
        };
        let mut others: Vec<(Addition, Stage)> = Vec::new();
        for other in &step.tied {
            let split = last.fit.split;
            if let Ok(stage) = Stage::new(prepared, instead(other), split, options)
                && stage.is_possible(recordings)
            {
                others.push((other.clone(), stage));
            }
        }
        others.sort_by(|a, b| a.1.mean_square().total_cmp(&b.1.mean_square()));
        // The best of all stands for the set.
        let better = others
            .first()
            .is_some_and(|(_, s)| s.mean_square() < last.mean_square());
        let chosen = step.chosen.clone();
        let (stands, stage) = match better {
            true => others.remove(0),
            false => (
                chosen.clone(),
                Stage {
                    effects: last.effects.clone(),
                    fit: last.fit.clone(),
                },
            ),
        };
        if better {
            let old = Stage {
                effects: last.effects.clone(),
                fit: last.fit.clone(),
            };
            others.push((chosen, old));
        }
        let told = |other: &Stage| {
            stage.wins(other) && other.mean_square() > (1.0 + TOLD) * stage.mean_square()
        };
        let (apart, tied): (Vec<_>, Vec<_>) = others.into_iter().partition(|(_, s)| told(s));
        let plain = |list: Vec<(Addition, Stage)>| list.into_iter().map(|(a, _)| a);
        let step = &mut selection.steps[i];
        step.chosen = stands;
        step.tied = plain(tied).collect();
        step.shadows.extend(plain(apart));
        if let Some(last) = selection.stages.last_mut() {
            *last = stage;
        }
    }
    Ok(())
}

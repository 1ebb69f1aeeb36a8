//! The significant candidates of one step, each fitted anew with everything else: the one that lowers
//! the error left out most is added, and what comes close is tied with it for now.

use anyhow::Result;
use model_export::effects::Addition;
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;
use model_export::fit::evidence::Around;
use rayon::prelude::*;

use super::kin::are_kin;
use super::screening::{LEAST_GAIN, Screened};
use super::select::{SMALL, Selection, Step};
use super::stage::Stage;

/// Candidates that are fitted in each step: the best by the straight lines, which order others well.
const CONTENDERS: usize = 5;
/// Share of the best candidate's gain below which another is no contender.
const CONTENDS: f64 = 0.5;
/// What takes away all but this share of what the best contender does is tied with it at first.
const NEAR: f64 = 0.05;
/// Where the recordings hide the difference of two effects, they are tied if the other takes this share of
/// what the better one takes: the rest is only a matter of form.
const SAME_BUT_FORM: f64 = 0.5;
/// What happens within recordings explains at least this share of what a curve free in time does.
const AS_GOOD: f64 = 0.8;
/// What takes less than this share of what an accepted kin took is that one's own form.
const REMAINDER: f64 = 0.2;

/// A candidate that was fitted.
struct Contender<'a> {
    screened: &'a Screened,
    stage: Stage,
    /// Share of the squared error left out that it takes away.
    gain: f64,
    /// The same in gauss squared.
    taken: f64,
    /// Whether the error falls in every part left out.
    wins: bool,
    /// Whether it has a size that the effect is known for.
    usual: bool,
}

/// Place of the best contender that wins and is no remainder of an earlier step; none where something
/// that may have no name explains far more.
fn winner(ranked: &[Contender], steps: &[Step]) -> Option<usize> {
    // What is left of a larger effect looks like its kin, or takes a size that no effect has.
    let is_remainder = |contender: &Contender| {
        steps.iter().any(|step| {
            let related = are_kin(&step.chosen, &contender.screened.candidate) || !contender.usual;
            related && contender.taken < REMAINDER * step.taken
        })
    };
    let wins = |c: &Contender| c.wins && c.gain > LEAST_GAIN;
    let first = ranked.iter().find(|c| wins(c))?;
    let place = ranked.iter().position(|c| wins(c) && !is_remainder(c))?;
    (ranked[place].gain >= SMALL * first.gain).then_some(place)
}

/// The best of the significant candidates with the model that holds it; `None` where none is left.
pub fn contest<'a>(
    prepared: &Prepared,
    stage: &Stage,
    around: &Around,
    selection: &'a Selection,
    options: Options,
) -> Result<Option<(Step, Stage)>> {
    let contenders = contenders(&selection.last, || around.free_in_time());
    if contenders.is_empty() {
        return Ok(None);
    }
    let with = |screened: &Screened| {
        let mut effects = stage.effects.clone();
        effects.push(screened.candidate.clone());
        effects
    };
    // What lives within recordings is judged within them, which is easier: then all are.
    let everything: Vec<Addition> = contenders.iter().flat_map(|&s| with(s)).collect();
    let split = prepared.split(&everything);
    let judged;
    let before = match split == stage.fit.split {
        true => stage,
        false => {
            judged = Stage::new(prepared, stage.effects.clone(), split, options)?;
            &judged
        }
    };
    let recordings = prepared.rows.first().map_or(0, |rows| rows.parts.len());
    let fitted = |screened: &'a Screened| {
        // A candidate that cannot be fitted here explains nothing here.
        let stage = Stage::new(prepared, with(screened), split, options).ok()?;
        stage.is_possible(recordings).then(|| Contender {
            screened,
            gain: stage.gain(before),
            taken: before.mean_square() - stage.mean_square(),
            wins: stage.wins(before),
            usual: stage.newest_is_usual(recordings),
            stage,
        })
    };
    let mut ranked: Vec<Contender> = contenders
        .par_iter()
        .filter_map(|&screened| fitted(screened))
        .collect();
    ranked.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    let Some(place) = winner(&ranked, &selection.steps) else {
        return Ok(None);
    };
    let best = ranked.remove(place);
    let (tied, shadows) = ranked.into_iter().partition::<Vec<_>, _>(|other| {
        let (one, another) = (&best.screened.candidate, &other.screened.candidate);
        let hidden = selection.excitation.hides_the_difference(one, another);
        let near = if hidden { SAME_BUT_FORM } else { 1.0 - NEAR };
        other.gain >= near * best.gain
    });
    let plain = |list: Vec<Contender>| -> Vec<Addition> {
        list.into_iter()
            .map(|c| c.screened.candidate.clone())
            .collect()
    };
    let step = Step {
        chosen: best.screened.candidate.clone(),
        tied: plain(tied),
        shadows: plain(shadows),
        gain: best.gain,
        taken: best.taken,
        p_adjusted: best.screened.p_adjusted,
        z_typical: best.screened.evidence.z_typical,
    };
    let own = prepared.split(&best.stage.effects);
    Ok(Some((step, best.stage.judged_by(prepared, own, options))))
}

/// The candidates that are worth a fit of their own, the best by the straight lines first.
fn contenders(screened: &[Screened], free_in_time: impl FnOnce() -> f64) -> Vec<&Screened> {
    let significant: Vec<&Screened> = screened.iter().filter(|s| s.is_significant()).collect();
    let within = |s: &Screened| s.candidate.lives_in_one_recording();
    let ordinary = significant
        .iter()
        .find(|s| !within(s))
        .map_or(0.0, |s| s.evidence.gain());
    // What lives within recordings is judged within them, which is easier: it must do as well as the
    // others, and about as well as any curve could.
    let free = match significant.iter().any(|s| within(s)) {
        true => free_in_time(),
        false => 0.0,
    };
    let contends = |s: &&Screened| match within(s) {
        true => s.evidence.gain() >= (1.0 - NEAR) * ordinary && s.evidence.gain() >= AS_GOOD * free,
        false => s.evidence.gain() >= CONTENDS * ordinary,
    };
    significant
        .into_iter()
        .filter(contends)
        .take(CONTENDERS)
        .collect()
}

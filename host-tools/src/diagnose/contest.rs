//! The significant candidates of one step, each fitted anew with everything else: the one that lowers
//! the error left out most is added, and what comes close is tied with it for now.

use std::borrow::Cow;

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

impl Contender<'_> {
    fn is_better(&self) -> bool {
        self.wins && self.gain > LEAST_GAIN
    }
}

/// The best of a contest, and who comes how near.
struct Outcome<'a> {
    best: Contender<'a>,
    tied: Vec<Addition>,
    shadows: Vec<Addition>,
}

/// The best of the significant candidates with the model that holds it; `None` where none is left.
///
/// What lives within recordings is judged within them, which is easier, so it has a contest of its own;
/// of the two winners the one that does better within recordings is added.
pub fn contest(
    prepared: &Prepared,
    stage: &Stage,
    around: &Around,
    selection: &Selection,
    options: Options,
) -> Result<Option<(Step, Stage)>> {
    let contenders = contenders(&selection.last, || around.free_in_time());
    let (within, ordinary): (Vec<_>, Vec<_>) = contenders
        .into_iter()
        .partition(|screened| screened.candidate.lives_in_one_recording());
    let ordinary =
        Contest::before(prepared, stage, &ordinary, options)?.outcome(&ordinary, selection);
    let contest = Contest::before(prepared, stage, &within, options)?;
    let within = contest.outcome(&within, selection);
    let outcome = match (ordinary, within) {
        (Some(ordinary), Some(within)) => contest.decide(ordinary, within, selection),
        (one, other) => match one.or(other) {
            Some(outcome) => outcome,
            None => return Ok(None),
        },
    };
    let best = outcome.best;
    let step = Step {
        chosen: best.screened.candidate.clone(),
        tied: outcome.tied,
        shadows: outcome.shadows,
        gain: best.gain,
        taken: best.taken,
        p_adjusted: best.screened.p_adjusted,
        z_typical: best.screened.evidence.z_typical,
    };
    let own = prepared.split(&best.stage.effects);
    Ok(Some((step, best.stage.judged_by(prepared, own, options))))
}

/// A contest of candidates that are judged in one way.
struct Contest<'a> {
    prepared: &'a Prepared,
    before: Cow<'a, Stage>,
    options: Options,
}

impl<'a> Contest<'a> {
    /// The model without any of the contenders, judged as they will be.
    fn before(
        prepared: &'a Prepared,
        stage: &'a Stage,
        contenders: &[&Screened],
        options: Options,
    ) -> Result<Self> {
        let added = contenders.iter().map(|screened| &screened.candidate);
        let everything: Vec<Addition> = stage.effects.iter().chain(added).cloned().collect();
        let split = prepared.split(&everything);
        let before = match split == stage.fit.split {
            true => Cow::Borrowed(stage),
            false => Cow::Owned(Stage::new(prepared, stage.effects.clone(), split, options)?),
        };
        Ok(Self {
            prepared,
            before,
            options,
        })
    }

    /// The model with one more effect; `None` where it cannot be fitted or takes a size that it cannot have:
    /// then it explains nothing here.
    fn fitted<'s>(&self, screened: &'s Screened) -> Option<Contender<'s>> {
        let before = &self.before;
        let mut effects = before.effects.clone();
        effects.push(screened.candidate.clone());
        let stage = Stage::new(self.prepared, effects, before.fit.split, self.options).ok()?;
        let recordings = self
            .prepared
            .rows
            .first()
            .map_or(0, |rows| rows.parts.len());
        stage.is_possible(recordings).then(|| Contender {
            screened,
            gain: stage.gain(before),
            taken: before.mean_square() - stage.mean_square(),
            wins: stage.wins(before),
            usual: stage.newest_is_usual(recordings),
            stage,
        })
    }

    /// Who is best, and who is near; `None` where nobody is better than nothing.
    fn outcome<'s>(
        &self,
        contenders: &[&'s Screened],
        selection: &Selection,
    ) -> Option<Outcome<'s>> {
        let fitted = contenders
            .par_iter()
            .filter_map(|&screened| self.fitted(screened));
        let mut ranked: Vec<Contender> = fitted.collect();
        ranked.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        let best = ranked.remove(winner(&ranked, &selection.steps)?);
        let is_near = |other: &Contender| {
            let near = nearness(best.screened, other.screened, selection);
            other.gain >= near * best.gain
        };
        let (tied, shadows) = ranked.into_iter().partition::<Vec<_>, _>(is_near);
        let plain = |list: Vec<Contender>| -> Vec<Addition> {
            let candidates = list.into_iter().map(|c| c.screened.candidate.clone());
            candidates.collect()
        };
        Some(Outcome {
            tied: plain(tied),
            shadows: plain(shadows),
            best,
        })
    }

    /// The better of `other`, judged in another way, and `own`, the outcome of this contest.
    fn decide<'s>(
        &self,
        other: Outcome<'s>,
        own: Outcome<'s>,
        selection: &Selection,
    ) -> Outcome<'s> {
        let Some(rival) = self
            .fitted(other.best.screened)
            .filter(Contender::is_better)
        else {
            return own;
        };
        let (high, low) = (rival.gain.max(own.best.gain), rival.gain.min(own.best.gain));
        let tied = low >= nearness(own.best.screened, rival.screened, selection) * high;
        let (mut first, second) = match rival.gain > own.best.gain {
            true => (other, own),
            false => (own, other),
        };
        // Who was near the second is as far from the first as the second is.
        let near = match tied {
            true => &mut first.tied,
            false => &mut first.shadows,
        };
        near.push(second.best.screened.candidate.clone());
        near.extend(second.tied);
        first.shadows.extend(second.shadows);
        first
    }
}

/// Place of the best contender that is better than nothing and no remainder of an earlier step; none
/// where something that may have no name explains far more.
fn winner(ranked: &[Contender], steps: &[Step]) -> Option<usize> {
    // What is left of a larger effect looks like its kin, or takes a size that no effect has.
    let is_remainder = |contender: &Contender| {
        steps.iter().any(|step| {
            let related = are_kin(&step.chosen, &contender.screened.candidate) || !contender.usual;
            related && contender.taken < REMAINDER * step.taken
        })
    };
    let first = ranked.iter().find(|c| c.is_better())?;
    let place = ranked
        .iter()
        .position(|c| c.is_better() && !is_remainder(c))?;
    (ranked[place].gain >= SMALL * first.gain).then_some(place)
}

/// Share of the gain of the better of two that the other must have to be tied with it.
fn nearness(one: &Screened, other: &Screened, selection: &Selection) -> f64 {
    let excitation = &selection.excitation;
    match excitation.hides_the_difference(&one.candidate, &other.candidate) {
        true => SAME_BUT_FORM,
        false => 1.0 - NEAR,
    }
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

//! The significant candidates of one step, each fitted anew with everything else: the one that lowers
//! the error left out most is added, and what comes close is tied with it for now.

use anyhow::Result;
use model_export::effects::Addition;
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;
use model_export::fit::folds::Split;
use rayon::prelude::*;

use super::screening::{LEAST_GAIN, Screened};
use super::select::Step;
use super::stage::Stage;

/// Candidates that are fitted in each step: the best by the straight lines, which order others well.
const CONTENDERS: usize = 5;
/// Share of the best candidate's gain below which another is no contender.
const CONTENDS: f64 = 0.3;
/// What takes away all but this share of what the best contender does is tied with it at first.
const NEAR: f64 = 0.05;

/// A candidate that was fitted.
struct Contender<'a> {
    screened: &'a Screened,
    stage: Stage,
    /// Share of the squared error left out that it takes away.
    gain: f64,
    /// Whether the error falls in every part left out.
    wins: bool,
}

/// The best of the significant candidates with the model that holds it; `None` where none is left.
pub fn contest(
    prepared: &Prepared,
    stage: &Stage,
    screened: &[Screened],
    options: Options,
) -> Result<Option<(Step, Stage)>> {
    let contenders = contenders(screened);
    let with = |screened: &Screened| {
        let mut effects = stage.effects.clone();
        effects.push(screened.candidate.clone());
        effects
    };
    let mut before: Vec<Stage> = Vec::new();
    for screened in &contenders {
        let split = prepared.split(&with(screened));
        if split != stage.fit.split && before.iter().all(|other| other.fit.split != split) {
            before.push(Stage::new(prepared, stage.effects.clone(), split, options)?);
        }
    }
    let judged_like = |split: Split| {
        let other = before.iter().find(|other| other.fit.split == split);
        other.unwrap_or(stage)
    };
    let recordings = prepared.rows.first().map_or(0, |rows| rows.parts.len());
    let fitted = |screened: &&'_ Screened| {
        let effects = with(screened);
        let split = prepared.split(&effects);
        // A candidate that cannot be fitted here explains nothing here.
        let stage = Stage::new(prepared, effects, split, options).ok()?;
        let before = judged_like(split);
        stage
            .is_possible(recordings)
            .then(|| (stage.gain(before), stage.wins(before), stage))
    };
    let mut ranked: Vec<Contender> = contenders
        .par_iter()
        .filter_map(|screened| {
            let (gain, wins, stage) = fitted(screened)?;
            Some(Contender {
                screened,
                stage,
                gain,
                wins,
            })
        })
        .collect();
    ranked.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    let Some(place) = ranked.iter().position(|c| c.wins && c.gain > LEAST_GAIN) else {
        return Ok(None);
    };
    let best = ranked.remove(place);
    let (tied, shadows) = ranked
        .into_iter()
        .partition::<Vec<_>, _>(|other| other.gain >= (1.0 - NEAR) * best.gain);
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
        p_adjusted: best.screened.p_adjusted,
        z_typical: best.screened.evidence.z_typical,
    };
    Ok(Some((step, best.stage)))
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

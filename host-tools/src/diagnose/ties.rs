//! Two effects that explain the same, told apart in the last model, where nothing larger hides the
//! difference.
//!
//! Each stands in for the other: the last model is fitted with the one and with the other. Neither adds
//! anything beside the other (or a later step would have accepted it), so where one of the two models
//! leaves clearly less, its effect explains all that the other does and more, and the other is its
//! shadow; where both leave the same, nobody can say which it is.

use model_export::effects::Addition;
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;
use rayon::prelude::*;

use super::select::Selection;
use super::stage::Stage;

/// Two effects are told apart where the better leaves less in every part left out, and less by this
/// share over all. (A shift and a derivative carry the reference's noise on differently: 0.25 % of the
/// squared error between a skewed clock and a filter of 4 ms.)
const TOLD: f64 = 0.005;

/// Judges every tied set again. The best of a set stands for it in the last model.
pub fn retell(prepared: &Prepared, selection: &mut Selection, options: Options) {
    for place in 0..selection.steps.len() {
        if !selection.steps[place].tied.is_empty() {
            retell_one(prepared, selection, place, options);
        }
    }
}

fn retell_one(prepared: &Prepared, selection: &mut Selection, place: usize, options: Options) {
    let recordings = prepared.rows.first().map_or(0, |rows| rows.parts.len());
    let excitation = selection.excitation;
    let (Some(last), step) = (selection.stages.pop(), &mut selection.steps[place]) else {
        return;
    };
    // What was accepted for itself later is no stand-in.
    step.tied.retain(|tied| !last.effects.contains(tied));
    // What lives within recordings cannot be judged by leaving them out: then none of the set is.
    let split = prepared.split(&[&last.effects[..], &step.tied].concat());
    let instead = |other: &Addition| {
        let mut effects = last.effects.clone();
        for effect in effects.iter_mut().filter(|effect| **effect == step.chosen) {
            *effect = other.clone();
        }
        let stage = Stage::new(prepared, effects, split, options).ok()?;
        let possible = stage.is_possible(recordings);
        possible.then(|| (other.clone(), stage))
    };
    let mut set: Vec<(Addition, Stage)> = step.tied.par_iter().filter_map(instead).collect();
    let last = last.judged_by(prepared, split, options);
    set.push((step.chosen.clone(), last));
    set.sort_by(|a, b| a.1.mean_square().total_cmp(&b.1.mean_square()));
    let (stands, best) = set.remove(0);
    let told = |(effect, other): &(Addition, Stage)| {
        let hidden = excitation.hides_the_difference(&stands, effect);
        let clearly = other.mean_square() > (1.0 + TOLD) * best.mean_square();
        !hidden && clearly && best.wins(other)
    };
    let (apart, tied): (Vec<_>, Vec<_>) = set.into_iter().partition(told);
    let plain = |list: Vec<(Addition, Stage)>| list.into_iter().map(|(effect, _)| effect);
    step.chosen = stands;
    step.tied = plain(tied).collect();
    step.shadows.extend(plain(apart));
    let own = prepared.split(&best.effects);
    selection
        .stages
        .push(best.judged_by(prepared, own, options));
}

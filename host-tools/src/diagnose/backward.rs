//! The backward pass: what a later step made needless is dropped.

use anyhow::Result;
use model_export::effects::Addition;
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;

use super::screening::LEAST_GAIN;
use super::select::Selection;
use super::stage::Stage;

/// Drops every step but the last without which the last model is as good. The staircase keeps its
/// stairs up to the first that is dropped, and is climbed anew from there.
pub fn prune(prepared: &Prepared, selection: &mut Selection, options: Options) -> Result<()> {
    let mut place = 0;
    while place + 1 < selection.steps.len() {
        let Some(last) = selection.stages.last() else {
            return Ok(());
        };
        let chosen = &selection.steps[place].chosen;
        let without = |stage: &Stage| -> Vec<Addition> {
            let kept = stage.effects.iter().filter(|effect| *effect != chosen);
            kept.cloned().collect()
        };
        if Stage::unjudged(prepared, without(last), options)?.is_far_behind(last) {
            place += 1;
            continue;
        }
        let split = last.fit.split;
        let simpler = Stage::new(prepared, without(last), split, options)?;
        if last.gain(&simpler) > LEAST_GAIN && last.wins(&simpler) {
            place += 1;
            continue;
        }
        let mut stages = Vec::new();
        for stage in &selection.stages[place + 2..selection.stages.len() - 1] {
            stages.push(Stage::new(prepared, without(stage), split, options)?);
        }
        stages.push(simpler);
        selection.stages.truncate(place + 1);
        selection.stages.extend(stages);
        selection.steps.remove(place);
    }
    Ok(())
}

//! Forward selection: the effect that lowers the error left out most, fitted anew with everything else;
//! what explains the same as well is tied with it; then again, until nothing more is told from chance.

use anyhow::Result;
use model_export::effects::Addition;
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;
use model_export::fit::evidence::Around;
use model_export::recordings::Campaign;

use super::backward::prune;
use super::contest::contest;
use super::excitation::Excitation;
use super::left::{block_s, located, residuals};
use super::screening::{Screened, screen};
use super::stage::Stage;
use super::ties::retell;
use crate::compare::covariate::Covariate;
use crate::compare::words::AT_FLOOR;

/// Steps at the most.
const MOST_STEPS: usize = 6;
/// While this many times the floor is left, something large is missing and names are provisional.
const COMPLETE: f64 = 1.5;
/// So they are while more than this share of what they explain is left beside noise: who explains a part
/// may stand in for what explains it all.
const MOST_LEFT: f64 = 0.4;
/// Where a covariate locates this share of what is left, and the best effect takes away less than
/// [`SMALL`] of it, the effect is not named: it would be a stand-in for part of something else.
const LOCATED: f64 = 0.3;
/// What takes away less than this share of what something nameless does gets no name.
pub const SMALL: f64 = 0.5;

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
    /// The same in gauss squared.
    pub taken: f64,
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
    /// What the recordings' programme makes alike.
    pub excitation: Excitation,
    /// Length of the blocks in seconds, and how many.
    pub block_s: f64,
    /// See `block_s`.
    pub blocks: usize,
}

impl Selection {
    /// Whether so little is left that the names stand.
    pub fn is_complete(&self) -> bool {
        let floors: Vec<f64> = self.stages.iter().map(Stage::floors).collect();
        let (Some(first), Some(last)) = (floors.first(), floors.last()) else {
            return true;
        };
        let explained = first.powi(2) - last.powi(2);
        let beside_noise = last.powi(2) - 1.0;
        let stands = self.steps.is_empty() || beside_noise <= MOST_LEFT * explained;
        *last <= AT_FLOOR || (*last <= COMPLETE && stands)
    }
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
        excitation: Excitation::of(prepared),
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
        said("fitting contenders");
        let Some((step, next)) = contest(prepared, stage, &around, &selection, options)? else {
            break;
        };
        if let Some((_, share)) = selection.located.first() {
            let excess = 1.0 - stage.floors().powi(-2);
            if *share > LOCATED && step.gain < SMALL * share * excess {
                break;
            }
        }
        selection.steps.push(step);
        selection.stages.push(next);
    }
    said("telling ties apart");
    retell(prepared, &mut selection, options);
    said("looking back");
    prune(prepared, &mut selection, options)?;
    level(prepared, &mut selection.stages, options)?;
    Ok(selection)
}

/// Judges every stage in the way of the last, so that the staircase compares like with like.
fn level(prepared: &Prepared, stages: &mut [Stage], options: Options) -> Result<()> {
    let Some(split) = stages.last().map(|last| last.fit.split) else {
        return Ok(());
    };
    for stage in stages.iter_mut().filter(|stage| stage.fit.split != split) {
        *stage = Stage::new(prepared, stage.effects.clone(), split, options)?;
    }
    Ok(())
}

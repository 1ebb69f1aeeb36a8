//! State of the forward selection: the fitted models and the accepted steps.

use crate::compare::attribution::Attributor;
use crate::compare::covariates::Covariate;
use crate::compare::residual_table::ResidualTable;
use crate::compare::{AT_FLOOR, ForceError};
use crate::diagnose::candidates::{LEVEL, ScreenedEffect, screen};
use crate::diagnose::confusable_effects::{Collinearity, Similarity};
use crate::diagnose::fitted_model::{FittedModel, MIN_GAIN, MIN_KEPT};
use crate::diagnose::formulas::discovered::DiscoveredFormula;
use crate::diagnose::residuals::{block_s, residual_tables};
use anyhow::Result;
use model_export::effects::EffectTerm;
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::effect_size::EffectSize;
use model_export::fit::score_test::ScoreTest;
use model_export::recordings::Campaign;
use serde::Serialize;

/// Maximum residual of a complete selection in noise floors; above it names are provisional.
const COMPLETE: f64 = 1.5;
/// Maximum remaining structure of a complete selection, relative to the explained part.
const MAX_REMAINING: f64 = 0.4;
/// Minimum gain of other forms of an accepted effect, relative to that of a candidate that is only one of them.
const FORM: f64 = 0.8;
/// Minimum gain of a named effect relative to an unnamed cause.
pub const SMALL: f64 = 0.5;

pub struct AcceptedStep {
    /// The effect added to the model.
    pub chosen: EffectTerm,
    /// Equivalent effects.
    pub tied: Vec<EffectTerm>,
    /// Effects that explain part of the same and nothing else.
    pub shadows: Vec<EffectTerm>,
    /// Relative reduction of the cross-validated squared error.
    pub gain: f64,
    /// Reduction in gauss squared.
    pub reduction: f64,
    /// Adjusted p-value; NaN where it is only significant in a full fit or next to another effect.
    pub p_adjusted: f64,
    /// Share of the resamples of blocks in which the linearised model includes it.
    pub inclusion: f64,
    /// Typical magnitude in standard errors at this step.
    pub z_typical: f64,
    /// Whether it was added together with the step before, and neither lowers the error alone.
    pub is_of_pair: bool,
    /// Relative reduction of the last model's held-out squared residual by other forms of the effect.
    pub form_gain: f64,
}

impl AcceptedStep {
    /// Of a candidate in `model` that `before` did not have; nothing is equivalent to it.
    pub fn new(screened: &ScreenedEffect, model: &FittedModel, before: &FittedModel) -> Self {
        let is_significant_alone = screened.p_adjusted < LEVEL;
        Self {
            chosen: screened.candidate.clone(),
            tied: Vec::new(),
            shadows: Vec::new(),
            gain: model.gain(before),
            reduction: before.mean_square() - model.mean_square(),
            p_adjusted: if is_significant_alone { screened.p_adjusted } else { f64::NAN },
            inclusion: screened.inclusion,
            z_typical: screened.evidence.z_typical,
            is_of_pair: false,
            form_gain: 0.0,
        }
    }

    pub fn dropped(&self, reason: DropReason) -> DroppedStep {
        DroppedStep { step: self.chosen.name().to_owned(), gain: self.gain, reason }
    }
}

/// The effects with `new` in place of `old`.
pub fn replaced(effects: &[EffectTerm], old: &EffectTerm, new: &EffectTerm) -> Vec<EffectTerm> {
    effects.iter().map(|effect| if effect == old { new } else { effect }).cloned().collect()
}

/// A fit of an effect that lowers the error in every fold, with a magnitude that the effect cannot have or that is not determined.
pub struct ImplausibleFit {
    pub effect: EffectTerm,
    /// Its magnitude in the fit.
    pub size: EffectSize,
    /// Relative reduction of the cross-validated squared error.
    pub gain: f64,
}

/// Why an accepted step was dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DropReason {
    /// Next to the later steps the error does not rise without it.
    Needless,
    /// Formulas from the initial model leave less, or as much with fewer terms.
    Replaced,
    /// It lowers the error of all rows by too little, or not in every fold.
    NotOnAllRows,
    /// Its magnitude is smaller than two of its standard errors next to the others.
    Undetermined,
    /// The error of the field is at the floor without it, and that of the forces hardly rises.
    IrrelevantForces,
}

/// A step that was accepted and dropped again.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DroppedStep {
    /// The effect, or the targets and formulas of a formula.
    pub step: String,
    /// Reduction of the held-out squared error by which it was accepted, as a fraction.
    pub gain: f64,
    /// Why it was dropped.
    pub reason: DropReason,
}

impl DroppedStep {
    /// A formula, by its text.
    pub fn of_formula(formula: &DiscoveredFormula, reason: DropReason) -> Self {
        let texts = formula.effects.iter().map(|effect| match effect {
            EffectTerm::Expression(expression) => expression.text.clone(),
            EffectTerm::Catalogue(effect) => effect.id.to_owned(),
        });
        Self { step: texts.collect::<Vec<_>>().join(" and "), gain: formula.gain, reason }
    }
}

pub struct Selection {
    pub steps: Vec<AcceptedStep>,
    /// Fits that lower the error with an implausible magnitude, the last of each effect.
    pub implausible: Vec<ImplausibleFit>,
    /// Steps accepted on the sample that reduce the error of all rows by nothing.
    pub unconfirmed: Vec<AcceptedStep>,
    /// Steps and formulas that were dropped.
    pub dropped: Vec<DroppedStep>,
    /// Models from the first to the last step.
    pub stages: Vec<FittedModel>,
    /// Score tests of all candidates on the last model.
    pub last: Vec<ScreenedEffect>,
    /// Covariates that explain the residual, with their shares.
    pub attributed: Vec<(Covariate, f64)>,
    /// Collinear covariates of the recordings.
    pub collinearity: Collinearity,
    /// How similar the effects are on the recordings, in the first screening.
    pub similarity: Similarity,
    /// Length of the bootstrap blocks in seconds.
    pub block_s: f64,
    /// Number of bootstrap blocks.
    pub blocks: usize,
}

impl Selection {
    /// Screens the candidates that the last model does not contain, and locates its residual.
    pub fn screen_last(
        &mut self,
        campaign: &Campaign,
        prepared: &FitSetup,
        candidates: &[EffectTerm],
        options: FitOptions,
    ) {
        let Some(stage) = self.stages.last() else { return };
        let remaining: Vec<EffectTerm> =
            candidates.iter().filter(|c| !stage.effects.contains(c)).cloned().collect();
        let columns = residual_tables(campaign, prepared, stage);
        let block_s = block_s(&columns);
        let around = ScoreTest::new(prepared, &stage.effects, &stage.fit, block_s);
        self.block_s = block_s;
        self.blocks = around.blocks;
        self.last = screen(&around, &remaining, options.seed);
        for step in &mut self.steps {
            step.form_gain = around.form_gain(&step.chosen);
        }
        self.attributed = attributed_covariates(&columns, block_s);
    }

    /// Whether the residual is small enough for final verdicts.
    pub fn is_complete(&self) -> bool {
        let floors: Vec<f64> = self.stages.iter().map(FittedModel::floors).collect();
        let (Some(first), Some(last)) = (floors.first(), floors.last()) else {
            return true;
        };
        let explained = first.powi(2) - last.powi(2);
        let structure = last.powi(2) - 1.0;
        let is_explained = self.steps.is_empty() || structure <= MAX_REMAINING * explained;
        *last <= AT_FLOOR || (*last <= COMPLETE && is_explained)
    }

    /// Fits every model again, to the rows of `setup`, as any other command fits it: the errors are those of the models that `add`
    /// writes.
    ///
    /// # Errors
    /// A fit fails.
    pub fn refit(&mut self, setup: &FitSetup, options: FitOptions) -> Result<()> {
        for stage in &mut self.stages {
            // A model without effects has no shapes to keep.
            let near = Some(&stage.fit).filter(|_| !stage.effects.is_empty());
            let how = (stage.fit.split, options);
            stage.fit = setup.fit_near(near, &stage.effects, how, |_| ())?;
        }
        Ok(())
    }

    /// After a refit: removes the last formulas and steps that do not reduce the error of all rows in every fold, formulas by
    /// [`MIN_KEPT`], or that leave one as large as without any, and sets the gains of the others to those on all rows. An earlier
    /// step may raise the error that a later one then lowers. Of the two effects of a pair the gain is that of both.
    pub fn confirm(&mut self, formulas: &mut Vec<DiscoveredFormula>) {
        self.confirm_last(formulas);
        while formulas.is_empty()
            && self.steps.last().is_some_and(|step| step.is_of_pair)
            && let [.., before, _, last] = self.stages.as_slice()
            && last.gain(before) <= MIN_KEPT
        {
            for _ in 0..2 {
                self.stages.pop();
                self.drop_last_step();
            }
            self.confirm_last(formulas);
        }
        let gains: Vec<f64> = self.stages.windows(2).map(|pair| pair[1].gain(&pair[0])).collect();
        let of_steps = self.steps.iter_mut().map(|step| &mut step.gain);
        let of_formulas = formulas.iter_mut().map(|formula| &mut formula.gain);
        of_steps.chain(of_formulas).zip(gains).for_each(|(gain, of_all_rows)| *gain = of_all_rows);
    }

    fn drop_last_step(&mut self) {
        let last = self.steps.pop();
        self.dropped.extend(last.as_ref().map(|step| step.dropped(DropReason::NotOnAllRows)));
        self.unconfirmed.extend(last);
    }

    fn confirm_last(&mut self, formulas: &mut Vec<DiscoveredFormula>) {
        while let [.., before, last] = self.stages.as_slice()
            && (last.gain(before) <= if formulas.is_empty() { MIN_GAIN } else { MIN_KEPT }
                || !last.improves_all_folds(before)
                || last.gain(&self.stages[0]) <= MIN_GAIN)
        {
            self.stages.pop();
            match formulas.pop() {
                Some(formula) => {
                    self.dropped.push(DroppedStep::of_formula(&formula, DropReason::NotOnAllRows));
                }
                None => self.drop_last_step(),
            }
        }
    }

    /// Removes the last formulas that lower the squared force error by less than [`MIN_KEPT`] next to others, where the error of the
    /// field was at the floor without them. `forces` are the errors of the models.
    pub fn drop_irrelevant(
        &mut self,
        formulas: &mut Vec<DiscoveredFormula>,
        forces: &mut Vec<Option<ForceError>>,
    ) {
        while self.steps.len() + formulas.len() > 1
            && !formulas.is_empty()
            && let [.., before, _] = self.stages.as_slice()
            && let [.., Some(without), Some(with)] = forces.as_slice()
            && before.is_at_floor()
            && with.reducible_rms_n.powi(2) > (1.0 - MIN_KEPT) * without.reducible_rms_n.powi(2)
        {
            self.stages.pop();
            forces.pop();
            let last = formulas.pop();
            let dropped =
                last.map(|one| DroppedStep::of_formula(&one, DropReason::IrrelevantForces));
            self.dropped.extend(dropped);
        }
    }

    /// Puts `other` in the place of the effect of a step, and fits the models from this step on again; returns the former effect.
    ///
    /// # Errors
    /// A fit fails.
    pub fn exchange(
        &mut self,
        place: usize,
        other: &EffectTerm,
        setup: &FitSetup,
        options: FitOptions,
    ) -> Result<EffectTerm> {
        let chosen = std::mem::replace(&mut self.steps[place].chosen, other.clone());
        for stage in &mut self.stages[place + 1..] {
            let effects = replaced(&stage.effects, &chosen, other);
            let split = setup.split(&effects);
            *stage = FittedModel::new(setup, effects, split, options)?;
        }
        Ok(chosen)
    }

    /// Removes a step; `last` is the last model without it, those between are fitted again.
    ///
    /// # Errors
    /// A fit fails.
    pub fn remove(
        &mut self,
        place: usize,
        last: FittedModel,
        reason: DropReason,
        (setup, options): (&FitSetup, FitOptions),
    ) -> Result<()> {
        let removed = std::slice::from_ref(&self.steps[place].chosen);
        self.stages = self.stages_without((place, removed), last, setup, options)?;
        let step = self.steps.remove(place);
        self.dropped.push(step.dropped(reason));
        Ok(())
    }

    /// The models without the step of this index, which added `removed`: `last` is the last of them, those between are fitted again.
    ///
    /// # Errors
    /// A fit fails.
    pub fn stages_without(
        &self,
        (place, removed): (usize, &[EffectTerm]),
        last: FittedModel,
        setup: &FitSetup,
        options: FitOptions,
    ) -> Result<Vec<FittedModel>> {
        let (mut stages, later) = (self.stages[..=place].to_vec(), &self.stages[place + 1..]);
        if let [_, between @ .., _] = later {
            for stage in between {
                let effects = stage.effects.iter().filter(|effect| !removed.contains(effect));
                stages.push(FittedModel::new(
                    setup,
                    effects.cloned().collect(),
                    last.fit.split,
                    options,
                )?);
            }
            stages.push(last);
        }
        Ok(stages)
    }

    /// The steps of which `candidate` explains only another form: other forms explain nearly as much of the residual, or the two
    /// effects are similar.
    pub fn forms(&self, candidate: &ScreenedEffect) -> impl Iterator<Item = &AcceptedStep> {
        self.steps.iter().filter(|step| {
            step.form_gain >= FORM * candidate.evidence.gain()
                || self.similarity.are_similar(&step.chosen, &candidate.candidate)
        })
    }
}

/// Selected covariates of the residual with their shares.
fn attributed_covariates(columns: &[ResidualTable], block_s: f64) -> Vec<(Covariate, f64)> {
    let ranked = Attributor::new(columns, block_s).rank();
    let Some(first) = columns.first() else {
        return Vec::new();
    };
    let chosen = ranked.into_iter().filter(|found| found.chosen);
    // An estimate of a share by held-out errors may exceed all of it.
    let share = |share: f64| share.min(1.0);
    chosen.map(|one| (first.covariates[one.covariate].of.clone(), share(one.share))).collect()
}

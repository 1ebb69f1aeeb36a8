//! State of the forward selection: the fitted models and the accepted steps.

use crate::compare::covariates::Covariate;
use crate::compare::{self, AT_FLOOR, ForceError};
use crate::diagnose::DiscoveredFormula;
use crate::diagnose::candidates::{MIN_GAIN, ScreenedEffect};
use crate::diagnose::confusable_effects::{Collinearity, Similarity};
use crate::diagnose::formulas::MIN_KEPT;
use anyhow::Result;
use model_export::effects::{EffectTerm, ParameterKind};
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::cross_validation::CvSplit;
use model_export::fit::effect_size::{EffectSize, effect_sizes, first_parameter};
use model_export::fit::joint::JointFit;
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
        Self {
            chosen: screened.candidate.clone(),
            tied: Vec::new(),
            shadows: Vec::new(),
            gain: model.gain(before),
            reduction: before.mean_square() - model.mean_square(),
            p_adjusted: screened.p_of_acceptance(),
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
    /// [`MIN_KEPT`], or that leave one as large as without any, and sets the gains of the others to those on all rows. An earlier step may raise the error
    /// that a later one then lowers. Of the two effects of a pair the gain is that of both.
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

/// Minimum relative difference of the squared errors of two distinguishable effects. (A shift and a derivative
/// propagate the reference's noise differently: 0.25 % between clock skew and a filter of 4 ms.)
pub const DISTINGUISHABLE: f64 = 0.005;

/// Maximum excess of the squared error on the fitted rows of a comparable model, as a fraction.
const MAX_EXCESS: f64 = 0.1;

/// Minimum share of the excess over the noise that a step removes. Less is statistical significance without relevance.
const MIN_RELEVANT: f64 = 0.05;

/// Minimum plausible magnitude relative to the typical one: a smaller one is what another effect leaves (0.13 ms of a filter, of
/// typically 4 ms, next to a creep).
const MIN_MAGNITUDE: f64 = 0.1;

/// Factor by which the shape of an event may be beyond the values at which it was searched.
const NEAR_SEARCHED: f64 = 2.0;

/// Maximum standard error of a transient effect, relative to its magnitude or the typical one: it is flexible in
/// time, so its magnitude must be determined.
const MAX_RELATIVE_ERROR: f64 = 10.0;

/// The axis with the largest error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WorstAxis {
    pub sensor: u32,
    /// `x`, `y` or `z`.
    pub axis: &'static str,
    /// Its error in its noise floors.
    pub floors: f64,
}

/// A model while effects are added to it.
#[derive(Clone, Debug)]
pub struct FittedModel {
    /// Effects of the model.
    pub effects: Vec<EffectTerm>,
    /// Fit of the model.
    pub fit: JointFit,
}

impl FittedModel {
    /// Fits a model and cross-validates it.
    ///
    /// # Errors
    /// The fit fails.
    pub fn new(
        prepared: &FitSetup,
        effects: Vec<EffectTerm>,
        split: CvSplit,
        options: FitOptions,
    ) -> Result<Self> {
        let fit = prepared.fit(&effects, split, options, |_| ())?;
        Ok(Self { effects, fit })
    }

    /// The same model with another cross-validation, where that is possible.
    pub fn with_split(self, prepared: &FitSetup, split: CvSplit, options: FitOptions) -> Self {
        if self.fit.split == split {
            return self;
        }
        Self::new(prepared, self.effects.clone(), split, options).unwrap_or(self)
    }

    /// The same model fitted to the rows of `setup`, of which its own are a sample, and cross-validated.
    ///
    /// # Errors
    /// The fit fails.
    pub fn on(&self, setup: &FitSetup, split: CvSplit, options: FitOptions) -> Result<Self> {
        let fit = setup.refit(&self.fit, &self.effects, split, options)?;
        Ok(Self { effects: self.effects.clone(), fit })
    }

    /// Fits a model without cross-validation.
    ///
    /// # Errors
    /// The fit fails.
    pub fn without_validation(
        prepared: &FitSetup,
        effects: Vec<EffectTerm>,
        options: FitOptions,
    ) -> Result<Self> {
        Self::new(prepared, effects, CvSplit::Recordings(0), options)
    }

    /// Whether its error on the fitted rows is so much larger than that of `other` that cross-validation is not needed.
    pub fn is_clearly_worse(&self, other: &Self) -> bool {
        other.is_better_fit(MAX_EXCESS, self)
    }

    /// Whether its error on the fitted rows is lower than that of `other` by more than this fraction.
    pub fn is_better_fit(&self, fraction: f64, other: &Self) -> bool {
        other.fitted_mean_square() > (1.0 + fraction) * self.fitted_mean_square()
    }

    /// Mean square over all channels on the fitted rows, in gauss squared.
    pub fn fitted_mean_square(&self) -> f64 {
        self.fit.fitted_mean_square()
    }

    /// Cross-validated mean square over all channels, in gauss squared.
    pub fn mean_square(&self) -> f64 {
        self.fit.tally().mean_square()
    }

    /// Cross-validated error relative to the noise floor.
    pub fn floors(&self) -> f64 {
        self.mean_square().sqrt() / self.fit.tally().floor_g()
    }

    /// The axis with the largest cross-validated error relative to its noise floor.
    pub fn worst_axis(&self) -> Option<WorstAxis> {
        let scores = self.fit.sensors.iter().flat_map(|sensor| &sensor.scores);
        let axes = scores.map(|score| WorstAxis {
            sensor: score.sensor,
            axis: score.axis.letter(),
            floors: score.held_out_rms_g / score.floor_g,
        });
        axes.filter(|axis| axis.floors.is_finite()).max_by(|a, b| a.floors.total_cmp(&b.floors))
    }

    /// Whether the cross-validated error is that of noise ([`compare::is_at_floor`]).
    pub fn is_at_floor(&self) -> bool {
        compare::is_at_floor(self.floors(), self.worst_axis().map(|axis| axis.floors))
    }

    /// Reduction of the cross-validated squared error relative to `before`.
    pub fn gain(&self, before: &Self) -> f64 {
        1.0 - self.mean_square() / before.mean_square()
    }

    /// Whether the error is lower than that of `before` in every fold.
    pub fn improves_all_folds(&self, before: &Self) -> bool {
        let pairs = self.fit.folds().into_iter().zip(before.fit.folds());
        pairs
            .filter(|(_, old)| old.rows() > 0)
            .all(|(new, old)| new.mean_square() < old.mean_square())
    }

    /// Whether its error is distinguishably lower than that of `other`, and distinguishably higher in no fold (recordings may differ in
    /// what they tell apart); on the fitted rows too, since a model with more parameters loses on held-out rows even where it
    /// contains the better one.
    pub fn is_distinguishably_better(&self, other: &Self) -> bool {
        self.is_better_fit(DISTINGUISHABLE, other)
            && other.mean_square() > (1.0 + DISTINGUISHABLE) * self.mean_square()
            && self.is_worse_in_no_fold(other)
    }

    fn is_worse_in_no_fold(&self, other: &Self) -> bool {
        let pairs = self.fit.folds().into_iter().zip(other.fit.folds());
        pairs
            .filter(|(_, old)| old.rows() > 0)
            .all(|(new, old)| new.mean_square() <= (1.0 + DISTINGUISHABLE) * old.mean_square())
    }

    /// Whether the error is lower than that of `before`, in every fold and by a relevant share.
    pub fn improves(&self, before: &Self) -> bool {
        self.improves_all_folds(before) && self.gain(before) > MIN_GAIN && self.is_relevant(before)
    }

    /// Whether it removes a relevant share of what `before` leaves beyond the noise.
    pub fn is_relevant(&self, before: &Self) -> bool {
        let excess = before.mean_square() - before.fit.tally().floor_g().powi(2);
        before.mean_square() - self.mean_square() >= MIN_RELEVANT * excess
    }

    /// Magnitude of one of its effects.
    pub fn size_of(&self, effect: &EffectTerm, recordings: usize) -> Option<EffectSize> {
        let place = self.effects.iter().position(|own| own == effect)?;
        effect_sizes(&self.fit, &self.effects, recordings).into_iter().nth(place)
    }

    /// Whether one of its effects has a plausible magnitude, neither tiny nor within its own error. A duration beyond those searched
    /// is no event.
    pub fn is_plausible(&self, effect: &EffectTerm, recordings: usize) -> bool {
        self.size_of(effect, recordings).is_none_or(|size| {
            let tiny = size.largest < MIN_MAGNITUDE * size.size.typical.abs();
            let is_determined = match effect.is_event() {
                true => self.has_searched_shapes(effect, recordings),
                false => size.is_determined(),
            };
            let is_vague = size.data_error
                > MAX_RELATIVE_ERROR * size.size.typical.abs().max(size.value.abs());
            size.is_plausible() && is_determined && !tiny && !is_vague
        })
    }

    /// Whether the shapes of one of its effects are near the values at which they were searched.
    fn has_searched_shapes(&self, effect: &EffectTerm, recordings: usize) -> bool {
        let parameters = effect.parameters(recordings);
        parameters.iter().enumerate().all(|(index, parameter)| {
            let ParameterKind::Shape { grid } = &parameter.kind else { return true };
            let (Some(low), Some(high)) = (grid.first(), grid.last()) else { return true };
            let near = low / NEAR_SEARCHED..=high * NEAR_SEARCHED;
            self.fit.sensors.iter().all(|sensor| {
                let first = first_parameter(sensor.base_count, &self.effects, effect, recordings);
                near.contains(&sensor.values[first + index])
            })
        })
    }

    /// Number of parameters at one sensor.
    pub fn parameters(&self) -> usize {
        self.fit.sensors.first().map_or(0, |sensor| sensor.parameters.len())
    }

    /// Whether every effect has a physically possible magnitude.
    pub fn is_possible(&self, recordings: usize) -> bool {
        effect_sizes(&self.fit, &self.effects, recordings).iter().zip(&self.effects).all(
            |(size, effect)| {
                let max_error = MAX_RELATIVE_ERROR * size.value.abs().max(size.size.typical.abs());
                let is_determined = !effect.is_transient() || size.data_error <= max_error;
                size.is_possible() && is_determined
            },
        )
    }
}

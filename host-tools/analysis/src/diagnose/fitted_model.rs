//! A fitted model with some effects, and how two of them compare.

use crate::compare;
use anyhow::Result;
use model_export::effects::{EffectTerm, ParameterKind};
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::cross_validation::CvSplit;
use model_export::fit::effect_size::{EffectSize, effect_sizes, first_parameter};
use model_export::fit::joint::JointFit;
use serde::Serialize;

/// Minimum reduction of the cross-validated squared error by an effect.
pub const MIN_GAIN: f64 = 0.001;
/// An effect or a formula that reduces the squared error by less next to all others is dropped at the end.
pub const MIN_KEPT: f64 = 0.01;
/// Candidates, and points of the chain, within this fraction of the least remaining squared error are equivalent; those with the fewest
/// coefficients are taken.
pub const NEAR: f64 = 0.02;
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

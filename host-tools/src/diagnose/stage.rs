//! A model on the way: its effects and its fit.

use anyhow::Result;
use model_export::effects::Addition;
use model_export::fit::Options;
use model_export::fit::campaign::Prepared;
use model_export::fit::folds::Split;
use model_export::fit::joint::JointFit;
use model_export::fit::size::sizes;

/// A model that leaves this many times another's squared error where both were fitted is no rival.
const FAR: f64 = 1.1;

/// An effect of less than this share of its typical size is hardly that effect.
const TINY: f64 = 0.03;

/// What happens within recordings can take any form in time: it must tell its size, with an error bar below
/// this many times the size or the typical one.
const UNKNOWN: f64 = 10.0;

/// A model while effects are added to it.
#[derive(Clone)]
pub struct Stage {
    /// All effects.
    pub effects: Vec<Addition>,
    /// Its fit.
    pub fit: JointFit,
}

impl Stage {
    /// Fitted and judged on what is left out.
    pub fn new(
        prepared: &Prepared,
        effects: Vec<Addition>,
        split: Split,
        options: Options,
    ) -> Result<Self> {
        let fit = prepared.fit(&effects, split, options, |_| ())?;
        Ok(Self { effects, fit })
    }

    /// The same model, judged in another way where that is possible.
    pub fn judged_by(self, prepared: &Prepared, split: Split, options: Options) -> Self {
        if self.fit.split == split {
            return self;
        }
        Self::new(prepared, self.effects.clone(), split, options).unwrap_or(self)
    }

    /// Fitted and not judged.
    pub fn unjudged(prepared: &Prepared, effects: Vec<Addition>, options: Options) -> Result<Self> {
        Self::new(prepared, effects, Split::Recordings(0), options)
    }

    /// Whether it leaves so much more of what was fitted than `other` that nothing left out need be asked.
    pub fn is_far_behind(&self, other: &Self) -> bool {
        self.fitted_mean_square() > FAR * other.fitted_mean_square()
    }

    /// Mean square over all channels on what was fitted, in gauss squared.
    fn fitted_mean_square(&self) -> f64 {
        let scores = || self.fit.sensors.iter().flat_map(|sensor| &sensor.scores);
        let squares: f64 = scores().map(|score| score.fitted_rms_g.powi(2)).sum();
        squares / scores().count().max(1) as f64
    }

    /// Held-out mean square over all channels, in gauss squared.
    pub fn mean_square(&self) -> f64 {
        self.fit.tally().mean_square()
    }

    /// Held-out error beside the floor.
    pub fn floors(&self) -> f64 {
        self.mean_square().sqrt() / self.fit.tally().floor_g()
    }

    /// Share of the squared error left out that it takes away from `before`.
    pub fn gain(&self, before: &Self) -> f64 {
        1.0 - self.mean_square() / before.mean_square()
    }

    /// Whether every part left out is judged better than by `before`.
    pub fn wins(&self, before: &Self) -> bool {
        let pairs = self.fit.folds().into_iter().zip(before.fit.folds());
        pairs
            .filter(|(_, old)| old.rows() > 0)
            .all(|(new, old)| new.mean_square() < old.mean_square())
    }

    /// Whether the effect that was added last has a size that it is known for.
    pub fn newest_is_usual(&self, recordings: usize) -> bool {
        let newest = sizes(&self.fit, &self.effects, recordings).pop();
        newest.is_none_or(|size| {
            let tiny = size.value.abs() < TINY * size.size.typical;
            size.is_plausible() && !tiny
        })
    }

    /// Whether every effect has a size that physics allows.
    pub fn is_possible(&self, recordings: usize) -> bool {
        sizes(&self.fit, &self.effects, recordings)
            .iter()
            .zip(&self.effects)
            .all(|(size, effect)| {
                let known = UNKNOWN * size.value.abs().max(size.size.typical);
                let told = !effect.lives_in_one_recording() || size.std_error <= known;
                size.is_possible() && told
            })
    }
}

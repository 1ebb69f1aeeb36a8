//! A formula that was found, with the model in which it explains the residual.

use model_export::effects::EffectTerm;
use model_export::model_file::EffectModel;

use crate::diagnose::fitted_model::FittedModel;

#[derive(Clone, Debug)]
pub struct DiscoveredFormula {
    pub name: String,
    /// Effects of the model: one for each point of the chain at which it acts.
    pub effects: Vec<EffectTerm>,
    /// Covariates, by column name.
    pub covariates: Vec<String>,
    /// Quantities that it changes.
    pub targets: Vec<&'static str>,
    /// Its effects with the values of each sensor, in the last model.
    pub models: Vec<EffectModel>,
    /// Reduction of the held-out squared error when it was added, as a fraction.
    pub gain: f64,
    /// Family-wise p-value.
    pub p_value: f64,
    /// Quantities that the same function can change with an error within 2 %; `None` where no others were compared.
    pub other_targets: Option<Vec<Vec<&'static str>>>,
}

impl DiscoveredFormula {
    /// Sets its effects with the values of each sensor in this model.
    pub fn set_models(&mut self, model: &FittedModel, recordings: usize) {
        let models = EffectModel::all_of(&model.fit, &model.effects, recordings);
        let is_own =
            |model: &EffectModel| self.effects.iter().any(|effect| effect.name() == model.name);
        self.models = models.into_iter().filter(is_own).collect();
    }
}

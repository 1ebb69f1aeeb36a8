//! Prediction of the field of one sensor from a model file.

use nalgebra::Vector3;

use crate::effects::{
    EffectParameter, EffectTerm, ExcitationSeries, ParameterKind, ParameterScope, StateSeries,
};
use crate::fit::base_model::{BaseModel, CylinderBase, PolynomialBase};
use crate::fit::parameters::{self, PARAMETERS};
use crate::fit::polynomial::Polynomial;
use crate::fit::rows::RecordingRows;
use crate::model_file::{BaseKind as BaseName, EffectModel, ModelFile};
use crate::physics::PhysicalState;
use crate::recordings::columns::Axis;

/// Forward model of one sensor with its effects.
pub struct Predictor {
    base: PredictorBase,
    effects: Vec<(EffectTerm, Vec<f64>)>,
}

/// Base model of a [`Predictor`].
enum PredictorBase {
    /// Field from the state of the sensor.
    FromState { base: Box<dyn BaseModel + Send>, values: Vec<f64> },
    /// Field from any number of forces.
    FromForces(Polynomial),
}

/// Predicted field and its sensitivity to the forces.
#[derive(Clone, Debug, Default)]
pub struct FieldPrediction {
    /// Field in gauss.
    pub field_g: Vec<Vector3<f64>>,
    /// dB/dF in G/N: for each row one vector per force.
    pub per_newton: Vec<Vec<Vector3<f64>>>,
}

impl ModelFile {
    /// Predictor of sensor `number`; `None` if the sensor or a value is missing.
    pub fn predictor(&self, number: u32, terms: &[EffectTerm]) -> Option<Predictor> {
        let recordings = self.provenance.recordings.len();
        let mut effects = Vec::new();
        for term in terms {
            let entry = self.effects.iter().find(|e| e.name == term.name())?;
            effects
                .push((term.clone(), entry.values_with_new_recording(term, number, recordings)?));
        }
        effects.sort_by_key(|(effect, _)| effect.stage());
        let sensor = self.sensors.iter().find(|sensor| sensor.number == number)?;
        let base = match self.base {
            BaseName::Cylinder => {
                let nominal = self.nominal(number)?;
                let value = |name: &str| Some(sensor.parameters.get(name)?.value);
                PredictorBase::FromState {
                    base: Box::new(CylinderBase { nominal }),
                    values: PARAMETERS
                        .iter()
                        .take(parameters::COUNT)
                        .map(|parameter| value(parameter.name))
                        .collect::<Option<_>>()?,
                }
            }
            BaseName::Polynomial => {
                let polynomial = sensor.polynomial()?;
                match PolynomialBase::new(polynomial.clone(), 1.0) {
                    Some(base) => PredictorBase::FromState {
                        values: base.parameters().iter().map(|slot| slot.start).collect(),
                        base: Box::new(base),
                    },
                    None => PredictorBase::FromForces(polynomial),
                }
            }
        };
        Some(Predictor { base, effects })
    }
}

impl EffectModel {
    /// Values at one sensor for the fitted recordings and one additional recording, in which memories start
    /// unloaded and values of each recording continue from the last one.
    fn values_with_new_recording(
        &self,
        term: &EffectTerm,
        number: u32,
        recordings: usize,
    ) -> Option<Vec<f64>> {
        let sensor = self.sensors.iter().find(|sensor| sensor.number == number)?;
        let mut last = 0.0;
        let parameters = term.parameters(recordings + 1);
        let value = |parameter: &EffectParameter| {
            let value = match sensor.parameters.get(parameter.name.as_ref()) {
                Some(found) => found.value,
                None if parameter.scope == ParameterScope::Campaign => return None,
                None if matches!(parameter.kind, ParameterKind::InitialState) => 0.0,
                None => last,
            };
            last = value;
            Some(value)
        };
        parameters.iter().map(value).collect()
    }
}

impl Predictor {
    /// Field in gauss over an excitation; `None` if the base needs more forces than it contains.
    pub fn fields(&self, excitation: &ExcitationSeries) -> Option<Vec<Vector3<f64>>> {
        let PredictorBase::FromState { base, values } = &self.base else {
            return None;
        };
        Some(base.fields(values, &self.states(excitation, base.stiffness(values))))
    }

    /// Field and sensitivities over the rows of a recording.
    pub fn over(&self, part: &RecordingRows, forces: &[(u32, Axis)]) -> FieldPrediction {
        let mut prediction = FieldPrediction::default();
        match &self.base {
            PredictorBase::FromForces(polynomial) => {
                let basis = polynomial.basis();
                for force in &part.force_n {
                    let at = basis.linearise(force);
                    let slopes = at.per_newton.iter().map(|slopes| polynomial.combine(slopes));
                    prediction.field_g.push(polynomial.combine(&at.values));
                    prediction.per_newton.push(slopes.collect());
                }
            }
            PredictorBase::FromState { base, values } => {
                let [kx, kz] = base.stiffness(values);
                let states = self.states(&part.track, [kx, kz]);
                for response in base.responses(values, &states) {
                    let slope = |axis| match axis {
                        Axis::Z => response.per_mm.column(2) / kz,
                        _ => response.per_mm.column(0) / kx,
                    };
                    prediction.field_g.push(response.field_g);
                    prediction
                        .per_newton
                        .push(forces.iter().map(|(_, axis)| slope(*axis)).collect());
                }
            }
        }
        prediction
    }

    fn states(&self, excitation: &ExcitationSeries, stiffness: [f64; 2]) -> Vec<PhysicalState> {
        let effects: Vec<(&EffectTerm, &[f64])> =
            self.effects.iter().map(|(effect, values)| (effect, values.as_slice())).collect();
        StateSeries::of(excitation, stiffness, &effects).states
    }
}

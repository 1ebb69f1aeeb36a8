//! Prediction of the field of one sensor from a model file.

use nalgebra::Vector3;

use crate::effects::{
    EffectParameter, EffectTerm, ErrorOrigin, ExcitationSeries, GripperState, ParameterKind,
    ParameterScope, StateSeries,
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
    /// Reading without a magnet in gauss.
    bias_g: Vector3<f64>,
    /// State of the device's tables.
    tables: Option<GripperState>,
}

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
    /// Weights of the field axes in the inversion to forces; zero where the device has no inverse.
    pub weights: Vector3<f64>,
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
        let at = self.table_state(number).row([0.0; 2], recordings);
        let tables = GripperState::over(&at, &effects).and_then(|states| states.first().copied());
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
        let bias_g = self.forward(number).map_or_else(Vector3::zeros, |forward| forward.bias_g);
        Some(Predictor { base, effects, bias_g, tables })
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

/// What separates a recorded row from the conditions of the device's tables.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowCorrection {
    /// Error of the reference forces along x and z in newtons, to subtract.
    pub reference_n: [f64; 2],
    /// Gain and offset in gauss that convert the reading to the state of the tables.
    pub reading: (f64, Vector3<f64>),
    /// Factor along x and z that converts a force from the state of the tables to that of the row.
    pub force: [f64; 2],
    /// Field in gauss that no model of the device compensates, to subtract from the reading first.
    pub irreducible_g: Vector3<f64>,
}

impl Predictor {
    /// Corrections of the rows of an excitation; `None` where no effect has another origin than the gripper in the state of
    /// its tables. With `new_recording`, a recording that the model was not fitted to: it has the state of the tables.
    pub fn corrections(
        &self,
        excitation: &ExcitationSeries,
        new_recording: bool,
    ) -> Option<Vec<RowCorrection>> {
        let has = |origin: fn(ErrorOrigin) -> bool| {
            self.effects.iter().any(|(effect, _)| origin(effect.error_origin()))
        };
        if !has(|origin| origin != ErrorOrigin::Compensated) {
            return None;
        }
        let reference = has(|origin| origin == ErrorOrigin::Reference)
            .then(|| self.series(excitation, [1.0; 2], |origin| origin == ErrorOrigin::Reference));
        let states = GripperState::over(excitation, &self.effects).filter(|_| !new_recording);
        let irreducible =
            self.irreducible_field(excitation).filter(|_| has(ErrorOrigin::is_irreducible));
        let correction = |row: usize| {
            let recorded = excitation.force_n.get(row).copied().unwrap_or_default();
            let corrected = reference.as_ref().and_then(|series| series.force_n.get(row).copied());
            let corrected = corrected.unwrap_or(recorded);
            let state = states.as_ref().and_then(|states| states.get(row)).zip(self.tables);
            let reading = state.map(|(state, tables)| state.conversion(&tables, self.bias_g));
            let force = state.map(|(state, tables)| {
                [0, 1].map(|axis| tables.compliance[axis] / state.compliance[axis])
            });
            RowCorrection {
                reference_n: [0, 1].map(|axis| recorded[axis] - corrected[axis]),
                reading: reading.unwrap_or((1.0, Vector3::zeros())),
                force: force.unwrap_or([1.0; 2]),
                irreducible_g: irreducible
                    .as_ref()
                    .and_then(|fields| fields.get(row).copied())
                    .unwrap_or_default(),
            }
        };
        Some((0..excitation.len()).map(correction).collect())
    }

    /// Field in gauss of the effects that no model of the device compensates.
    fn irreducible_field(&self, excitation: &ExcitationSeries) -> Option<Vec<Vector3<f64>>> {
        let PredictorBase::FromState { base, values } = &self.base else {
            return None;
        };
        let stiffness = base.stiffness(values);
        let field = |series: StateSeries| base.fields(values, &series.states);
        let all = field(self.series(excitation, stiffness, |_| true));
        let without = field(self.series(excitation, stiffness, |origin| !origin.is_irreducible()));
        Some(all.iter().zip(&without).map(|(all, without)| all - without).collect())
    }

    /// The series with the effects of these origins.
    fn series(
        &self,
        excitation: &ExcitationSeries,
        stiffness: [f64; 2],
        is_included: impl Fn(ErrorOrigin) -> bool,
    ) -> StateSeries {
        let effects = self.effects.iter().filter(|(effect, _)| is_included(effect.error_origin()));
        let effects: Vec<(&EffectTerm, &[f64])> =
            effects.map(|(effect, values)| (effect, values.as_slice())).collect();
        StateSeries::of(excitation, stiffness, &effects)
    }

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
                prediction.weights = base.inverse_weights();
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
        self.series(excitation, stiffness, |_| true).states
    }
}

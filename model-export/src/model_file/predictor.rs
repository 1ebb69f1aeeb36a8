//! A model file as it stands, asked for the field of one sensor.

use nalgebra::Vector3;

use super::{Base as BaseName, EffectModel, ModelFile};
use crate::effects::{Addition, Kind, Of, Parameter, Series, Track};
use crate::fit::base::{Base, CylinderBase, PolynomialBase};
use crate::fit::parameters::{self, PARAMETERS};
use crate::fit::polynomial::Polynomial;
use crate::fit::rows::Part;
use crate::physics::{ForwardModel, State};
use crate::recordings::columns::Axis;

/// What a model says of one sensor.
pub struct Predictor {
    field: Field,
    effects: Vec<(Addition, Vec<f64>)>,
    /// Recordings that the model was fitted to.
    recordings: usize,
}

/// What the field is computed from.
enum Field {
    /// A state of magnet and sensor.
    State {
        base: Box<dyn Base + Send>,
        values: Vec<f64>,
    },
    /// Any number of forces.
    Forces(Polynomial),
}

/// The field over some rows, and its answer to the forces.
#[derive(Clone, Debug, Default)]
pub struct Predicted {
    /// Gauss.
    pub field_g: Vec<Vector3<f64>>,
    /// dB/dF in G/N, one for each force of the rows.
    pub per_newton: Vec<Vec<Vector3<f64>>>,
}

impl ModelFile {
    /// What the file says of sensor `number`; `None` where it does not know it.
    pub fn predictor(&self, number: u32, additions: &[Addition]) -> Option<Predictor> {
        let recordings = self.provenance.recordings.len();
        let mut effects = Vec::new();
        for addition in additions {
            let entry = self.effects.iter().find(|e| e.name == addition.name())?;
            effects.push((
                addition.clone(),
                entry.with_unseen(addition, number, recordings)?,
            ));
        }
        effects.sort_by_key(|(effect, _)| effect.stage());
        let sensor = self.sensors.iter().find(|sensor| sensor.number == number)?;
        let field = match self.base {
            BaseName::Cylinder => {
                let nominal = ForwardModel::nominal(self.design.as_ref()?);
                let value = |name: &str| Some(sensor.parameters.get(name)?.value);
                Field::State {
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
                    Some(base) => Field::State {
                        values: base.slots().iter().map(|slot| slot.start).collect(),
                        base: Box::new(base),
                    },
                    None => Field::Forces(polynomial),
                }
            }
        };
        Some(Predictor {
            field,
            effects,
            recordings,
        })
    }
}

impl EffectModel {
    /// Values at one sensor for the recordings that were fitted, and for one more that was not: there
    /// memories begin unloaded, and what changes from recording to recording stays as it was in the end.
    fn with_unseen(&self, addition: &Addition, number: u32, recordings: usize) -> Option<Vec<f64>> {
        let known = self.sensors.iter().find(|sensor| sensor.number == number)?;
        let mut last = 0.0;
        let values = addition.parameters(recordings + 1);
        let value = |parameter: &Parameter| {
            let value = match known.parameters.get(parameter.name.as_ref()) {
                Some(found) => found.value,
                None if parameter.of == Of::Campaign => return None,
                None if matches!(parameter.kind, Kind::Beginning) => 0.0,
                None => last,
            };
            last = value;
            Some(value)
        };
        values.iter().map(value).collect()
    }
}

impl Predictor {
    /// What a track's `recording` must be where the model was not fitted to it; else its place among
    /// those that the model was fitted to.
    pub fn unseen(&self) -> usize {
        self.recordings
    }

    /// The field in gauss over a track; `None` where the base needs more forces than a track holds.
    pub fn fields(&self, track: &Track) -> Option<Vec<Vector3<f64>>> {
        let Field::State { base, values } = &self.field else {
            return None;
        };
        let field = base.field(values);
        Some(
            self.states(track, base.stiffness(values))
                .iter()
                .map(field)
                .collect(),
        )
    }

    /// The field and its slopes over the rows of a recording.
    pub fn over(&self, part: &Part, forces: &[(u32, Axis)]) -> Predicted {
        let mut predicted = Predicted::default();
        match &self.field {
            Field::Forces(polynomial) => {
                for force in &part.force_n {
                    predicted.field_g.push(polynomial.field(force));
                    predicted.per_newton.push(polynomial.per_newton(force));
                }
            }
            Field::State { base, values } => {
                let [kx, kz] = base.stiffness(values);
                let at = base.linear(values);
                let mut columns = vec![Vector3::zeros(); values.len()];
                for state in self.states(&part.track, [kx, kz]) {
                    let response = at(&state, &mut columns);
                    let slope = |axis| match axis {
                        Axis::Z => response.per_mm.column(2) / kz,
                        _ => response.per_mm.column(0) / kx,
                    };
                    predicted.field_g.push(response.field_g);
                    predicted
                        .per_newton
                        .push(forces.iter().map(|(_, axis)| slope(*axis)).collect());
                }
            }
        }
        predicted
    }

    fn states(&self, track: &Track, stiffness: [f64; 2]) -> Vec<State> {
        let effects: Vec<(&Addition, &[f64])> = self
            .effects
            .iter()
            .map(|(effect, values)| (effect, values.as_slice()))
            .collect();
        Series::of(track, stiffness, &effects).states
    }
}

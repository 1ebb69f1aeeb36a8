//! What may be wrong with the columns of one sensor.

use model_export::recordings::Recording;
use model_export::recordings::columns::Axis;
use nalgebra::Vector3;

use super::case::{Case, mean_square};

/// Columns of the field exchanged or turned: axis i is `sign[i]` times what stands in column `from[i]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turned {
    /// Columns, 0 to 2.
    pub from: [usize; 3],
    /// 1 or -1.
    pub sign: [f64; 3],
}

/// What a force really is: a column, and its sign.
pub type Source = ((u32, Axis), f64);

/// One thing that may be wrong.
#[derive(Clone, Debug, PartialEq)]
pub enum Hypothesis {
    /// The field's columns.
    Axes(Turned),
    /// The field is that of another sensor.
    OfSensor(u32),
    /// The forces' columns: what stands for each force of the sensor, in their order.
    Forces(Vec<Source>),
    /// The field's unit: what was recorded times this is gauss.
    FieldUnit(f64),
    /// The forces' unit: what was recorded times this is newtons, lateral and longitudinal; 1 where a
    /// column is as it should be.
    ForceUnit([f64; 2]),
}

/// A hypothesis with what it leaves.
#[derive(Clone, Debug)]
pub struct Tried {
    /// What was tried.
    pub hypothesis: Hypothesis,
    /// Mean square of what it leaves in gauss squared (in the model's gauss).
    pub left: f64,
    /// How many columns it touches: of two that do as well, the simpler is meant.
    pub cost: usize,
}

/// Every arrangement of the three axes but the recorded one.
pub fn axes(case: &Case) -> Vec<Tried> {
    const ORDERS: [[usize; 3]; 6] = [
        [0, 1, 2],
        [0, 2, 1],
        [1, 0, 2],
        [1, 2, 0],
        [2, 0, 1],
        [2, 1, 0],
    ];
    let mut tried = Vec::new();
    for from in ORDERS {
        for signs in 0..8 {
            let sign = [0, 1, 2].map(|axis| if signs >> axis & 1 == 1 { -1.0 } else { 1.0 });
            let turned = Turned { from, sign };
            let cost = (0..3)
                .map(|i| usize::from(from[i] != i) + usize::from(sign[i] < 0.0))
                .sum();
            if cost > 0 {
                tried.push(Tried {
                    left: mean_square(&turned.applied(&case.measured), &case.modelled),
                    hypothesis: Hypothesis::Axes(turned),
                    cost,
                });
            }
        }
    }
    tried
}

/// The field of every other sensor in place of its own.
pub fn of_sensors(case: &Case, recording: &Recording) -> Vec<Tried> {
    let indices = case.indices(recording);
    let others = recording
        .sensors
        .iter()
        .filter(|(sensor, _)| **sensor != case.sensor);
    others
        .map(|(sensor, track)| {
            let at = |i: &usize| {
                track
                    .field_g
                    .get(*i)
                    .copied()
                    .map_or_else(nan, Vector3::from)
            };
            let fields: Vec<Vector3<f64>> = indices.iter().map(at).collect();
            Tried {
                hypothesis: Hypothesis::OfSensor(*sensor),
                left: mean_square(&fields, &case.modelled),
                cost: 1,
            }
        })
        .collect()
}

fn nan() -> Vector3<f64> {
    Vector3::repeat(f64::NAN)
}

impl Turned {
    fn applied(&self, fields: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let turn = |field: &Vector3<f64>| {
            Vector3::from_fn(|axis, _| self.sign[axis] * field[self.from[axis]])
        };
        fields.iter().map(turn).collect()
    }
}

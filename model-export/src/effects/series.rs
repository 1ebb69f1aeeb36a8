//! From the reference's forces to the state of a sensor, row by row, with the effects of a model.

use nalgebra::Vector3;

use super::Addition;
use super::track::{Track, pick};
use crate::physics::State;

/// Where in the chain from force to field an effect acts. Effects are applied in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// What the reference shows is not what acts: its clock, its filter, its zero.
    Reference,
    /// More forces act on the flexures than the reference sees.
    Load,
    /// The flexures do not answer like springs.
    Flexure,
    /// The magnet moves by more than the flexures' deflection.
    Displacement,
    /// The magnet itself changes.
    Magnet,
    /// The opening is not what the motor's angle says.
    Opening,
    /// Fields of other sources.
    Outside,
    /// The sensor itself.
    Sensor,
}

impl Stage {
    /// True where the effect only means something with a base that knows magnet and flexures.
    pub fn needs_geometry(self) -> bool {
        matches!(self, Self::Displacement | Self::Magnet)
    }
}

/// A sensor's state, row by row, while effects are applied.
#[derive(Clone, Debug)]
pub struct Series {
    /// Force on each flexure in newtons, and later what a plain spring would need to deflect as much.
    pub force_n: Vec<[f64; 2]>,
    /// Opening between the fingertips in mm; empty where it was not recorded.
    pub opening_mm: Vec<f64>,
    /// The state; displacements are set from the forces before [`Stage::Displacement`].
    pub states: Vec<State>,
}

impl Series {
    /// The states over `track` with flexures of this stiffness in N/mm, under `effects`, in the order
    /// of their stages, each with its values.
    pub fn of(
        track: &Track,
        stiffness_n_per_mm: [f64; 2],
        effects: &[(&Addition, &[f64])],
    ) -> Self {
        let mut series = Self {
            force_n: track.force_n.clone(),
            opening_mm: track
                .covariates
                .get("opening_mm")
                .cloned()
                .unwrap_or_default(),
            states: Vec::new(),
        };
        let (on_force, on_state): (Vec<_>, Vec<_>) = effects
            .iter()
            .partition(|(effect, _)| effect.stage() <= Stage::Flexure);
        for (effect, values) in on_force {
            effect.apply(values, track, &mut series);
        }
        let [kx, kz] = stiffness_n_per_mm;
        let displaced = |[x, z]: &[f64; 2]| State::displaced(Vector3::new(x / kx, 0.0, z / kz));
        series.states = series.force_n.iter().map(displaced).collect();
        for (effect, values) in on_state {
            effect.apply(values, track, &mut series);
        }
        series
    }

    /// Only these rows of it, in this order.
    pub fn at(&self, rows: &[usize]) -> Self {
        Self {
            force_n: pick(&self.force_n, rows),
            opening_mm: pick(&self.opening_mm, rows),
            states: pick(&self.states, rows),
        }
    }

    /// Adds `term(row)` to the force of one axis (0 lateral, 1 longitudinal).
    pub fn add_force(&mut self, axis: usize, term: impl Fn(usize) -> f64) {
        for (row, force) in self.force_n.iter_mut().enumerate() {
            force[axis] += term(row);
        }
    }
}

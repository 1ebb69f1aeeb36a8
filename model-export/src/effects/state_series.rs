//! From reference forces to the states of a sensor, row by row, with the effects of a model.

use nalgebra::Vector3;

use crate::effects::EffectTerm;
use crate::effects::excitation::{ExcitationSeries, select_rows};
use crate::physics::PhysicalState;

/// Position of an effect in the chain from force to field. Effects are applied in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum EffectStage {
    /// Errors of the reference: clock, filter, zero.
    Reference,
    /// Forces on the flexures that the reference does not measure.
    Load,
    /// Non-elastic response of the flexures.
    Flexure,
    /// Displacement of the magnet in addition to the flexures' deflection.
    Displacement,
    /// Changes of the magnet.
    Magnet,
    /// Errors of the opening computed from the motor's angle.
    Opening,
    /// External fields.
    Outside,
    /// Errors of the Hall sensor.
    Sensor,
}

impl EffectStage {
    /// True where the effect requires a base with geometry.
    pub fn needs_geometry(self) -> bool {
        matches!(self, Self::Displacement | Self::Magnet)
    }
}

/// States of a sensor, row by row, while effects are applied.
#[derive(Clone, Debug)]
pub struct StateSeries {
    /// Force on each flexure in newtons; after [`EffectStage::Flexure`] the equivalent elastic force.
    pub force_n: Vec<[f64; 2]>,
    /// Opening between the fingertips in mm; empty if not recorded.
    pub opening_mm: Vec<f64>,
    /// States; displacements are computed from the forces before [`EffectStage::Displacement`].
    pub states: Vec<PhysicalState>,
}

impl StateSeries {
    /// The states over an excitation with this stiffness in N/mm; `effects` in the order of their stages, each
    /// with its values.
    pub fn of(
        excitation: &ExcitationSeries,
        stiffness_n_per_mm: [f64; 2],
        effects: &[(&EffectTerm, &[f64])],
    ) -> Self {
        let mut series = Self {
            force_n: excitation.force_n.clone(),
            opening_mm: excitation.covariates.get("opening_mm").cloned().unwrap_or_default(),
            states: Vec::new(),
        };
        let (on_force, on_state): (Vec<_>, Vec<_>) =
            effects.iter().partition(|(effect, _)| effect.stage() <= EffectStage::Flexure);
        for (effect, values) in on_force {
            effect.apply(values, excitation, &mut series);
        }
        let [kx, kz] = stiffness_n_per_mm;
        let displaced =
            |[x, z]: &[f64; 2]| PhysicalState::displaced(Vector3::new(x / kx, 0.0, z / kz));
        series.states = series.force_n.iter().map(displaced).collect();
        for (effect, values) in on_state {
            effect.apply(values, excitation, &mut series);
        }
        series
    }

    /// The selected rows, in this order.
    pub fn at(&self, rows: &[usize]) -> Self {
        Self {
            force_n: select_rows(&self.force_n, rows),
            opening_mm: select_rows(&self.opening_mm, rows),
            states: select_rows(&self.states, rows),
        }
    }

    /// Adds `term(row)` to the force of one axis (0 lateral, 1 longitudinal).
    pub fn add_force(&mut self, axis: usize, term: impl Fn(usize) -> f64) {
        for (row, force) in self.force_n.iter_mut().enumerate() {
            force[axis] += term(row);
        }
    }
}

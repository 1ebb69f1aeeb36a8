//! Stages of the chain from force to field, and the states of a sensor, row by row, while effects are applied.

use nalgebra::Vector3;

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
    /// Stages of effects that change the force on the flexures.
    pub const FORCES: &'static [Self] = &[Self::Reference, Self::Load, Self::Flexure];
    /// Stages of effects that change the displacement, which follows from the force.
    pub const DISPLACEMENTS: &'static [Self] =
        &[Self::Reference, Self::Load, Self::Flexure, Self::Displacement];

    /// True where it changes the force on the flexures.
    pub fn acts_on_force(self) -> bool {
        self <= Self::Flexure
    }

    /// True where the effect requires a base with geometry.
    pub fn needs_geometry(self) -> bool {
        matches!(self, Self::Displacement | Self::Magnet)
    }
}

/// States of a sensor, row by row, while effects are applied.
#[derive(Clone, Debug, Default)]
pub struct StateSeries {
    /// Force on each flexure in newtons; after [`EffectStage::Flexure`] the equivalent elastic force.
    pub force_n: Vec<[f64; 2]>,
    /// Opening between the fingertips in mm; empty if not recorded.
    pub opening_mm: Vec<f64>,
    /// States; displacements are computed from the forces before [`EffectStage::Displacement`].
    pub states: Vec<PhysicalState>,
}

impl StateSeries {
    /// The recorded forces and opening, without states.
    pub(super) fn unloaded(excitation: &ExcitationSeries) -> Self {
        Self {
            force_n: excitation.force_n.clone(),
            opening_mm: excitation.covariates.get("opening_mm").cloned().unwrap_or_default(),
            states: Vec::new(),
        }
    }

    /// With the states that follow from the forces, where it has none.
    pub(super) fn displaced(mut self, [kx, kz]: [f64; 2]) -> Self {
        if self.states.is_empty() {
            let displaced =
                |[x, z]: &[f64; 2]| PhysicalState::displaced(Vector3::new(x / kx, 0.0, z / kz));
            self.states = self.force_n.iter().map(displaced).collect();
        }
        self
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

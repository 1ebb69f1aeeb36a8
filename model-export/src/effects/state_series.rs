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
    /// Share of the reference's noise that effects have added to each force, for each window of the smoothing.
    noise_gains: [Vec<f64>; 2],
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
            noise_gains: Default::default(),
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
            noise_gains: self.noise_gains.clone(),
            opening_mm: select_rows(&self.opening_mm, rows),
            states: select_rows(&self.states, rows),
        }
    }

    /// Force of one axis after the effects applied so far, without the reference's noise: in newtons, and its rate in N/s.
    pub(crate) fn history(
        &self,
        excitation: &ExcitationSeries,
        axis: usize,
    ) -> (Vec<f64>, Vec<f64>) {
        let column = |of: &[[f64; 2]]| -> Vec<f64> { of.iter().map(|pair| pair[axis]).collect() };
        let (mut force, mut rates) =
            (column(&excitation.smooth_n), column(&excitation.rate_n_per_s));
        if self.force_n == excitation.force_n {
            return (force, rates);
        }
        let added: Vec<f64> = (0..force.len())
            .map(|row| {
                let added_n = self.force_n[row][axis] - excitation.force_n[row][axis];
                let noise_n = excitation.force_n[row][axis] - force[row];
                added_n - excitation.at_window(&self.noise_gains[axis], row, axis) * noise_n
            })
            .collect();
        let last = added.len().saturating_sub(1);
        for (row, (force, rate)) in force.iter_mut().zip(&mut rates).enumerate() {
            *force += added[row];
            let (from, to) = (row.saturating_sub(1), (row + 1).min(last));
            let interval_s = excitation.time_s[to] - excitation.time_s[from];
            if interval_s > 0.0 {
                *rate += (added[to] - added[from]) / interval_s;
            }
        }
        (force, rates)
    }

    /// Replaces the force of one axis by a linear operator of its history, given times, values and rates.
    ///
    /// A shift or filter reduces the contribution of a row's own noise. Added to the reading, it would average the
    /// reference's noise and reduce the residual without physical cause; that part is subtracted.
    pub(crate) fn apply_operator(
        &mut self,
        excitation: &ExcitationSeries,
        axis: usize,
        operator: impl Fn(&[f64], &[f64], &[f64]) -> Vec<f64>,
    ) {
        let (before, rates) = self.history(excitation, axis);
        let after = operator(&excitation.time_s, &before, &rates);
        let gains = excitation.smoother.noise_gains(&operator);
        let noise = |row: usize| {
            let noise_n = excitation.force_n[row][axis] - excitation.smooth_n[row][axis];
            excitation.at_window(&gains, row, axis) * noise_n
        };
        self.add_force(axis, |row| after[row] - before[row] - noise(row));
        self.noise_gains[axis].resize(gains.len(), 0.0);
        self.noise_gains[axis].iter_mut().zip(gains).for_each(|(sum, gain)| *sum -= gain);
    }

    /// Adds `term(row)` to the force of one axis (0 lateral, 1 longitudinal).
    pub fn add_force(&mut self, axis: usize, term: impl Fn(usize) -> f64) {
        for (row, force) in self.force_n.iter_mut().enumerate() {
            force[axis] += term(row);
        }
    }
}

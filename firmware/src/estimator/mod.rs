//! Estimation of the contact forces: compensation, ideal model, recurrent networks, disturbance detection. Estimation of the
//! gripper's tilt, an input of the compensation.

pub mod attitude;
pub mod disturbance;
mod estimate;
pub mod finger_symmetry;
pub mod gru;
pub mod ideal;
pub mod network_monitor;
pub mod parity;
pub mod tare;

pub use crate::estimator::estimate::{Estimate, Validity};

use crate::compensation::auxiliary_inputs::AuxiliaryInputs;
use crate::compensation::{Compensated, Compensation, CompensationState};
use crate::config::limits::DetectionLimits;
use crate::estimator::disturbance::DisturbanceDetector;
use crate::estimator::network_monitor::NetworkMonitor;
use crate::estimator::parity::ParityResidual;
use crate::fixed_point::{Field, Force};
use crate::model::formats::Tables;
use crate::sensors::hall::{HallFrame, HallReading, SENSORS};

/// Estimates the forces at sensor `number` by compensation and ideal model; `state` belongs to that sensor.
pub fn estimate(
    tables: &Tables,
    number: usize,
    reading: Option<HallReading>,
    inputs: &AuxiliaryInputs,
    state: &mut CompensationState,
) -> Estimate {
    let (Some(table), Some(reading)) = (tables.sensor(number), reading) else {
        return Estimate::MISSING;
    };
    let measured = reading.field.map(Field::from_counts);
    let saturated = reading
        .field
        .iter()
        .any(|counts| counts.unsigned_abs() >= table.limit_counts.unsigned_abs());
    let effects = tables.compensation(number);
    let field = match effects {
        Some(effects) => effects.compensate_field(measured, reading.temperature, inputs, state),
        None => Compensated { value: measured, missing_inputs: false },
    };
    let ideal = ideal::evaluate(tables, table, field.value);
    let force = match effects {
        Some(effects) => effects.compensate_force(ideal.force, inputs, state),
        None => Compensated { value: ideal.force, missing_inputs: false },
    };
    let missing_inputs = field.missing_inputs || force.missing_inputs;
    // Before homing the residual contains the field of the opposing finger's magnet, which changes with every motion.
    let has_parity = !field.missing_inputs || inputs.opening_um.is_some();
    Estimate {
        force: force.value,
        sigma: None,
        network_force: [Force(0); 2],
        network_sigma: None,
        validity: match (saturated, ideal.in_range) {
            (true, _) => Validity::Saturated,
            (false, false) => Validity::OutsideModel,
            (false, true) if missing_inputs => Validity::MissingInputs,
            (false, true) => Validity::Valid,
        },
        field: field.value,
        uncompensated: ideal.force,
        missing_inputs,
        parity: ParityResidual {
            residual: parity::residual(table, field.value, ideal.coordinates),
            sigma: if has_parity { table.parity.sigma } else { 0 },
        },
        disturbed: false,
    }
}

/// Estimates the forces at every sensor of a frame by [`estimate`].
///
/// Not inlined: the check of the image starts at this function to prove that no panic is reachable.
#[inline(never)]
pub fn estimate_all(
    tables: &Tables,
    frame: &HallFrame,
    inputs: &AuxiliaryInputs,
    states: &mut [CompensationState; SENSORS],
) -> [Estimate; SENSORS] {
    // In place: a map of the array copies each estimate several times.
    let mut estimates = [Estimate::MISSING; SENSORS];
    let sensors = estimates.iter_mut().zip(frame.readings).zip(states).enumerate();
    for (number, ((estimated, reading), state)) in sensors {
        *estimated = estimate(tables, number, reading, inputs, state);
    }
    estimates
}

/// Recurrent networks with their states.
pub trait NetworkBank {
    /// Steps the networks and merges their predictions into the estimates of the frame.
    fn apply(&mut self, estimates: &mut [Estimate; SENSORS]);
}

impl<N: NetworkBank> NetworkBank for Option<N> {
    fn apply(&mut self, estimates: &mut [Estimate; SENSORS]) {
        if let Some(networks) = self {
            networks.apply(estimates);
        }
    }
}

/// The whole chain from frames to forces, with its state.
#[derive(Clone, Debug)]
pub struct Estimator<'t, N> {
    tables: &'t Tables<'t>,
    states: [CompensationState; SENSORS],
    networks: N,
    detector: DisturbanceDetector,
    monitor: NetworkMonitor,
}

impl<'t, N: NetworkBank> Estimator<'t, N> {
    /// Estimator in its initial state, with the gripper's limits.
    pub fn new(tables: &'t Tables<'t>, networks: N) -> Self {
        Self {
            tables,
            states: [CompensationState::default(); SENSORS],
            networks,
            detector: DisturbanceDetector::default(),
            monitor: NetworkMonitor::new(&DetectionLimits::GRIPPER),
        }
    }

    /// Replaces the limits.
    pub const fn within(mut self, limits: &DetectionLimits) -> Self {
        self.monitor = NetworkMonitor::new(limits);
        self
    }

    /// Estimates the forces of the next frame.
    pub fn update(&mut self, frame: &HallFrame, inputs: &AuxiliaryInputs) -> [Estimate; SENSORS] {
        let mut estimates = estimate_all(self.tables, frame, inputs, &mut self.states);
        let ideal = estimates;
        self.networks.apply(&mut estimates);
        self.detector.update(&ideal, &mut estimates);
        self.monitor.update(&ideal, &mut estimates);
        for (estimate, ideal) in estimates.iter_mut().zip(&ideal) {
            let forces = estimate.network_force.iter_mut().zip(estimate.force).zip(ideal.force);
            for ((added, force), ideal) in forces {
                *added = Force(force.0.saturating_sub(ideal.0));
            }
        }
        estimates
    }

    /// Force that friction may leave at rest at every sensor ([`tare`]).
    pub fn friction_deadband(&self) -> [[Force; 2]; SENSORS] {
        let mut number = 0;
        [(); SENSORS].map(|()| {
            let compensation = self.tables.compensation(number);
            number += 1;
            compensation.map_or([Force(0); 2], Compensation::friction_deadband)
        })
    }

    /// Whether the fingertips' weight and inertia are compensated.
    pub fn compensates_fingertip_mass(&self) -> bool {
        let mut compensations = self.tables.compensations.iter();
        compensations.any(Compensation::compensates_fingertip_mass)
    }

    /// The networks with their states.
    pub fn networks(&mut self) -> &mut N {
        &mut self.networks
    }

    /// Whether a sensor's network is rejected for its deviation from the ideal model.
    pub fn network_diverged(&self, sensor: usize) -> bool {
        self.monitor.network_diverged(sensor)
    }

    /// The detector of external magnets.
    pub fn detector(&self) -> &DisturbanceDetector {
        &self.detector
    }
}

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
use crate::sensors::hall::{FIRST_SENSORS, HallFrame, HallReading, SENSORS};

/// Estimates the forces at sensor `number` by compensation and ideal model; `state` belongs to that sensor.
#[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.estimate"))]
#[allow(unsafe_code)] // The place of the code alone: core-coupled memory, where no instruction waits for the flash.
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
    let measured = table.axes.apply(reading.field.map(Field::from_counts));
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

/// Estimates the forces at these sensors of a frame by [`estimate`]; other estimates stay unchanged.
///
/// Not inlined: the check of the image starts at this function to prove that no panic is reachable.
#[inline(never)]
#[cfg_attr(target_os = "none", unsafe(link_section = ".ccm.estimate"))]
#[allow(unsafe_code)] // As of `estimate`.
pub fn estimate_all(
    tables: &Tables,
    frame: &HallFrame,
    inputs: &AuxiliaryInputs,
    states: &mut [CompensationState; SENSORS],
    sensors: [bool; SENSORS],
    estimates: &mut [Estimate; SENSORS],
) {
    // In place: a map of the array copies each estimate several times.
    let places = estimates.iter_mut().zip(frame.readings).zip(states).enumerate();
    for ((number, ((estimated, reading), state)), is_estimated) in places.zip(sensors) {
        if is_estimated {
            *estimated = estimate(tables, number, reading, inputs, state);
        }
    }
}

/// Recurrent networks with their states.
pub trait NetworkBank {
    /// Steps the networks and merges their predictions into the estimates of the frame.
    fn apply(&mut self, estimates: &mut [Estimate; SENSORS]);

    /// Does what of the next step needs no estimate, for the networks that depend on these sensors alone.
    fn prepare(&mut self, _sensors: [bool; SENSORS]) {}

    /// Steps the networks ahead of [`Self::apply`] that depend on these sensors alone, in place of those stepped ahead before.
    /// Does what of the step of the others needs no estimate.
    fn step_ahead(&mut self, _estimates: &[Estimate; SENSORS], _sensors: [bool; SENSORS]) {}
}

impl<N: NetworkBank> NetworkBank for Option<N> {
    fn prepare(&mut self, sensors: [bool; SENSORS]) {
        if let Some(networks) = self {
            networks.prepare(sensors);
        }
    }

    fn apply(&mut self, estimates: &mut [Estimate; SENSORS]) {
        if let Some(networks) = self {
            networks.apply(estimates);
        }
    }

    fn step_ahead(&mut self, estimates: &[Estimate; SENSORS], sensors: [bool; SENSORS]) {
        if let Some(networks) = self {
            networks.step_ahead(estimates, sensors);
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
    /// Estimates of the ideal model.
    ideal: [Estimate; SENSORS],
    /// Time of the frame whose first readings are estimated, and of the last frame.
    first_us: Option<u32>,
    last_us: Option<u32>,
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
            ideal: [Estimate::MISSING; SENSORS],
            first_us: None,
            last_us: None,
        }
    }

    /// Replaces the limits.
    pub const fn within(mut self, limits: &DetectionLimits) -> Self {
        self.monitor = NetworkMonitor::new(limits);
        self
    }

    /// Does what of the next [`Self::update_first`] needs no reading.
    pub fn prepare_first(&mut self) {
        self.networks.prepare(FIRST_SENSORS);
    }

    /// Does what [`Self::update`] does with the first readings of a frame ([`FIRST_SENSORS`]), ahead of the others. The inputs
    /// must be the same.
    pub fn update_first(&mut self, frame: &HallFrame, inputs: &AuxiliaryInputs) {
        // Of a late frame that is already complete.
        if self.last_us == Some(frame.time_us) {
            return;
        }
        self.first_us = Some(frame.time_us);
        let (states, ideal) = (&mut self.states, &mut self.ideal);
        estimate_all(self.tables, frame, inputs, states, FIRST_SENSORS, ideal);
        self.networks.step_ahead(&self.ideal, FIRST_SENSORS);
    }

    /// Estimates the forces of the next frame.
    pub fn update(&mut self, frame: &HallFrame, inputs: &AuxiliaryInputs) -> [Estimate; SENSORS] {
        self.last_us = Some(frame.time_us);
        let sensors = if self.first_us.take() == self.last_us {
            FIRST_SENSORS.map(|is_first| !is_first)
        } else {
            self.networks.step_ahead(&self.ideal, [false; SENSORS]);
            [true; SENSORS]
        };
        let (states, ideal) = (&mut self.states, &mut self.ideal);
        estimate_all(self.tables, frame, inputs, states, sensors, ideal);
        let ideal = &self.ideal;
        let mut estimates = *ideal;
        self.networks.apply(&mut estimates);
        self.detector.update(ideal, &mut estimates);
        self.monitor.update(ideal, &mut estimates);
        for (estimate, ideal) in estimates.iter_mut().zip(ideal) {
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

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;
    use crate::compensation::lookup_table::{
        ALONG_BITS, Covariate, FILTERS, ForceMap, LookupAxis, LookupTable, VALUE_BITS,
    };
    use crate::compensation::{ForceEffect, MAX_EFFECTS};
    use crate::estimator::gru::GruBank;
    use crate::model::axis_map::AxisMap;
    use crate::model::formats::{
        AxisScale, GAIN_BITS, Linear, Parity, SLOPE_BITS, SensorTable, padded,
    };
    use crate::model::tables::{NETWORKS, TABLES};

    fn frame(tick: u32) -> HallFrame {
        let readings = [0, 1, 2, 3].map(|sensor| {
            let wave = ((tick * 7 + sensor * 31) % 97) as i16;
            let field = [2000 + wave, wave - 300, 900 - wave];
            (tick != 100 + sensor).then_some(HallReading { field, temperature: 8 })
        });
        HallFrame { time_us: 1000 * tick, readings }
    }

    /// Forces along x of a sensor whose elastic force is 10 N in every tick, in force units.
    fn forces(compensation: Compensation, ticks: usize) -> Vec<i32> {
        let axis = AxisScale { offset: 0, gain: 1 << GAIN_BITS };
        let slope = 1 << SLOPE_BITS;
        let sensor = SensorTable {
            number: 0,
            axes: AxisMap::NOMINAL,
            scale: [axis; 3],
            limit_counts: 16_000,
            linear: Linear { bias: [0; 2], slope: [[slope, 0, 0], [0, 0, slope]] },
            pairs: padded([]),
            used_pairs: 0,
            shift: [0; 2],
            parity: Parity::NONE,
        };
        let tables = Tables { sensors: &[sensor], compensations: &[compensation], ..TABLES };
        let reading = Some(HallReading { field: [640, 0, 0], temperature: 0 });
        let mut state = CompensationState::default();
        let inputs = AuxiliaryInputs::default();
        let ticks = 0..ticks;
        ticks.map(|_| estimate(&tables, 0, reading, &inputs, &mut state).force[0].0).collect()
    }

    #[test]
    fn effect_of_a_fifth_of_the_force_is_removed_within_six_ticks() {
        // 0.2 F from -100 to 100 N: the force is 10 N / 1.2.
        let side =
            LookupAxis { covariate: Covariate::Force(0), from: -102_400, step: 204_800, knots: 2 };
        let table = LookupTable {
            sides: [Some(side), None, None],
            values: &[-1 << VALUE_BITS, 1 << VALUE_BITS],
        };
        let mut force = [None; MAX_EFFECTS];
        force[0] = Some(ForceEffect::Map(ForceMap { table, along: [20_480 << ALONG_BITS, 0] }));
        let field = [None; MAX_EFFECTS];
        let found = forces(Compensation { number: 0, filters: [None; FILTERS], field, force }, 6);
        // Without the effect first; then the error is a fifth of that before, of the other sign.
        for (found, expected) in found.iter().zip([10_240, 8192, 8602, 8520, 8536, 8533]) {
            assert!((found - expected).abs() <= 4, "{found} {expected}");
        }
    }

    #[test]
    fn estimates_of_turned_sensors_are_those_of_the_nominal_ones() {
        let inputs = AuxiliaryInputs { opening_um: Some(40_000), ..AuxiliaryInputs::default() };
        for axes in (0..0o1000).map(AxisMap).filter(|map| map.is_rotation()) {
            let turn = |reading: HallReading| {
                let mut field = [0; 3];
                for ((axis, is_negated), counts) in axes.axes().into_iter().zip(reading.field) {
                    field[usize::from(axis)] = if is_negated { -counts } else { counts };
                }
                HallReading { field, ..reading }
            };
            let turned = |table: &SensorTable| SensorTable { axes, ..*table };
            let sensors: Vec<SensorTable> = TABLES.sensors.iter().map(turned).collect();
            let tables = Tables { sensors: &sensors, ..TABLES };
            let [mut nominal, mut other] = [&TABLES, &tables]
                .map(|tables| Estimator::new(tables, GruBank::<_, _, _, SENSORS>::new(&NETWORKS)));
            for tick in 1..200 {
                let frame = frame(tick);
                let readings = frame.readings.map(|reading| reading.map(turn));
                let turned = HallFrame { readings, ..frame };
                let expected = nominal.update(&frame, &inputs);
                assert_eq!(other.update(&turned, &inputs), expected, "{axes:?} {tick}");
            }
        }
    }

    #[test]
    fn estimates_are_the_same_with_first_readings_ahead() {
        let inputs = AuxiliaryInputs { opening_um: Some(40_000), ..AuxiliaryInputs::default() };
        let mut whole = Estimator::new(&TABLES, GruBank::<_, _, _, SENSORS>::new(&NETWORKS));
        let mut ahead = whole.clone();
        let mut by_networks = 0;
        for tick in 1..10_500 {
            let frame = frame(tick);
            let expected = whole.update(&frame, &inputs);
            let [first, _, third, _] = frame.readings;
            let first = HallFrame { readings: [first, None, third, None], ..frame };
            if !tick.is_multiple_of(3) {
                ahead.prepare_first();
            }
            // Sometimes they are not taken in time, and then too late.
            if !tick.is_multiple_of(5) {
                ahead.update_first(&first, &inputs);
            }
            assert_eq!(ahead.update(&frame, &inputs), expected, "{tick}");
            if tick.is_multiple_of(5) {
                ahead.update_first(&first, &inputs);
            }
            // A network that deviates too far is replaced.
            let mut sensors = expected.iter().enumerate();
            by_networks += u32::from(sensors.any(|(sensor, estimate)| {
                estimate.network_sigma.is_some() || whole.network_diverged(sensor)
            }));
        }
        // Their warm-up takes up to 10,000 steps.
        assert!(by_networks > 1000, "{by_networks}");
    }
}

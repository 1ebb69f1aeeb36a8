//! Estimates the forces of each frame, and checks sensors and forces for faults.

use core::sync::atomic::Ordering;

use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::clock::{Clock, Timed};
use crate::compensation::auxiliary_inputs::AuxiliaryInputs;
use crate::compensation::covariates::Covariates;
use crate::config::constants::TICK_US;
use crate::config::limits::DetectionLimits;
use crate::estimator::finger_symmetry::FingerSymmetry;
use crate::estimator::tare::{FallbackTare, TareCollector, TareProgress};
use crate::estimator::{Estimate, Estimator, NetworkBank, Validity};
use crate::fixed_point::Force;
use crate::motor::{MotorState, MotorStatus, Trip};
use crate::parameters::Parameters;
use crate::protocol::serial::Tick;
use crate::sensors::hall::liveness::{MonitoredReading, SensorCondition};
use crate::sensors::hall::{HallReading, SENSORS};
use crate::system::faults::{Fault, FaultSet};
use crate::system::task_watchdog::TaskId;
use crate::tasks::covariates::CovariateSamples;
use crate::tasks::{FaultReporter, GripInputs, SharedState};

/// Ticks between samples for the supervision of temperatures, where no forces are sent.
const SAMPLE_TICKS: u32 = 50;
/// Age of the motor's status in microseconds beyond which it has tripped; it is reported each millisecond.
const MAX_MOTOR_AGE_US: u64 = 5_000;

/// Forces of one tick.
#[derive(Clone, Copy, Debug)]
pub struct ForceSample {
    /// Number of the tick since boot.
    pub tick: u32,
    /// When it began, in microseconds since boot.
    pub begun_us: u64,
    /// The forces.
    pub estimates: [Estimate; SENSORS],
    /// The readings that they were estimated from.
    pub readings: [Option<HallReading>; SENSORS],
}

/// Inputs of the compensation in a tick.
struct TickInputs {
    /// When it began, in microseconds since boot.
    begun_us: u64,
    covariates: Covariates,
    auxiliary: AuxiliaryInputs,
}

impl TickInputs {
    fn of(samples: &CovariateSamples, begun_us: u64) -> Self {
        let covariates = samples.at(begun_us);
        let pole_pairs = samples.motor.map_or(0, |motor| motor.value.pole_pairs);
        Self { begun_us, covariates, auxiliary: covariates.inputs(pole_pairs) }
    }
}

/// Estimates the forces of every sensed frame, those of the first readings while the others are read, and calls `grip` with
/// them. `motor` returns the state of the motor, if it is new.
pub async fn estimate<N: NetworkBank, C: Clock, M: RawMutex>(
    estimator: &mut Estimator<'_, N>,
    mut motor: impl FnMut() -> Option<Timed<MotorStatus>>,
    mut grip: impl FnMut(&GripInputs),
    limits: &DetectionLimits,
    clock: &C,
    shared: &SharedState<M>,
) -> ! {
    let mut diagnostics = SensorDiagnostics::new(limits);
    let mut taring = Taring::new(estimator.friction_deadband());
    let bears_mass = !estimator.compensates_fingertip_mass();
    let mut tick = 0_u32;
    let mut last_us = None;
    let mut samples = CovariateSamples::default();
    // No tick begins at zero.
    let mut inputs = TickInputs::of(&samples, 0);
    estimator.prepare_first();
    loop {
        // A late frame goes before the first readings of the next.
        let next = select(shared.sensed.wait(), shared.first_readings.wait()).await;
        let woken_us = clock.now_us();
        if let Some(status) = motor() {
            samples.motor = Some(status);
        }
        let begun_us = match &next {
            Either::First(sensed) => sensed.begun_us,
            Either::Second(first) => first.begun_us,
        };
        if inputs.begun_us != begun_us {
            samples.inertial = shared.inertial.get();
            samples.host = shared.host_motion.get();
            inputs = TickInputs::of(&samples, begun_us);
        }
        let TickInputs { covariates, auxiliary, .. } = &inputs;
        let sensed = match next {
            Either::First(sensed) => sensed,
            Either::Second(first) => {
                estimator.update_first(&first.frame, auxiliary);
                continue;
            }
        };
        shared.progress.check_in(TaskId::Estimate);
        let mut motor = samples.motor.map(|motor| motor.value).unwrap_or_default();
        if samples
            .motor
            .is_some_and(|motor| motor.time_us.saturating_add(MAX_MOTOR_AGE_US) < sensed.begun_us)
        {
            // Its loops have stopped.
            motor.state = MotorState::Tripped(Trip::CommandTimeout);
        }
        let frame = sensed.frame();
        let mut estimates = estimator.update(&frame, auxiliary);
        let done_us = clock.now_us();
        let counts = &shared.counts;
        for (worst, spent_us) in [
            (&counts.worst_tick_us, done_us.saturating_sub(sensed.begun_us)),
            (&counts.worst_estimate_us, done_us.saturating_sub(woken_us)),
        ] {
            worst.fetch_max(spent_us as u32, Ordering::Relaxed);
        }
        // The tick number follows the time, also when frames were lost.
        let ticks = last_us.replace(sensed.begun_us).map_or(0, |last_us| {
            (sensed.begun_us.saturating_sub(last_us) + TICK_US / 2) as u32 / TICK_US as u32
        });
        tick = tick.wrapping_add(ticks);
        let diverged = [0, 1, 2, 3].map(|sensor| estimator.network_diverged(sensor));
        taring.update(&mut estimates, diverged, shared);
        // After the tare: with the tables of the nominal design the untared forces of both fingers differ.
        diagnostics.update(&sensed.watched, &estimates, shared);
        diagnostics.update_networks(diverged, shared);
        grip(&GripInputs {
            estimates: &estimates,
            motor,
            acceleration: auxiliary.acceleration.filter(|_| bears_mass),
        });
        if shared.ticks.try_send(Tick::of(&frame, &estimates, *covariates)).is_err() {
            shared.counts.packets_unsent.fetch_add(1, Ordering::Relaxed);
        }
        // Copying every sample to a task that sends one of ten takes 2 % of the core's time. Thread mode runs the
        // task that is woken last first.
        let is_due = |period: u32| tick.is_multiple_of(period);
        if shared.parameter(Parameters::force_period).is_some_and(is_due) || is_due(SAMPLE_TICKS) {
            shared.force_sample.signal(ForceSample {
                tick,
                begun_us: sensed.begun_us,
                estimates,
                readings: frame.readings,
            });
        }
        // Here and not before the first readings, because nothing wakes this task then; last, because others wait for the rest.
        estimator.prepare_first();
    }
}

/// Subtracts the tare, and averages a new one on request.
struct Taring {
    /// See [`Estimator::friction_deadband`].
    deadband: [[Force; 2]; SENSORS],
    running: Option<TareCollector>,
    fallback: FallbackTare,
}

impl Taring {
    fn new(deadband: [[Force; 2]; SENSORS]) -> Self {
        Self { deadband, running: None, fallback: FallbackTare::default() }
    }

    fn update<M: RawMutex>(
        &mut self,
        estimates: &mut [Estimate; SENSORS],
        diverged: [bool; SENSORS],
        shared: &SharedState<M>,
    ) {
        if shared.tare_request.try_take().is_some() {
            self.running = Some(TareCollector::new(self.deadband));
        }
        if let Some(running) = &mut self.running {
            let step = running.update(estimates);
            if let TareProgress::Done(tare) = step {
                self.fallback = running.fallback(tare);
            }
            if step != TareProgress::Collecting {
                self.running = None;
                shared.tare_result.signal(step);
            }
        }
        let tare = shared.parameter(Parameters::tare);
        tare.apply(estimates);
        for (sensor, (estimate, is_replaced)) in estimates.iter_mut().zip(diverged).enumerate() {
            if is_replaced {
                self.fallback.apply(sensor, &tare, estimate);
            }
        }
    }
}

/// Fault detection of sensors and forces.
struct SensorDiagnostics {
    faults: FaultSet,
    balance: FingerSymmetry,
    /// Ticks in a row with the field outside the range of the sensor, and of the model.
    outside: [[u8; 2]; SENSORS],
    /// Thresholds of [`Self::outside`].
    outside_ticks: [u8; 2],
}

impl SensorDiagnostics {
    fn new(limits: &DetectionLimits) -> Self {
        Self {
            faults: FaultSet::default(),
            balance: FingerSymmetry::new(limits),
            outside: [[0; 2]; SENSORS],
            outside_ticks: [limits.saturated_ticks, limits.outside_ticks],
        }
    }

    fn update_networks<M: RawMutex>(&mut self, diverged: [bool; SENSORS], shared: &SharedState<M>) {
        for (sensor, network_diverged) in (0_u8..).zip(diverged) {
            let fault = (Fault::NetworkDiverged, sensor);
            shared.update_fault(
                FaultReporter::Estimate,
                &mut self.faults,
                fault,
                network_diverged,
                0,
            );
        }
    }

    fn update<M: RawMutex>(
        &mut self,
        watched: &[MonitoredReading; SENSORS],
        estimates: &[Estimate; SENSORS],
        shared: &SharedState<M>,
    ) {
        let mut ok = 0;
        let sensors = watched.iter().zip(estimates).zip(&mut self.outside);
        for (sensor, ((watched, estimate), outside)) in (0_u8..).zip(sensors) {
            let age = u32::from(watched.age);
            let lost = watched.condition == SensorCondition::Lost;
            let frozen = watched.condition == SensorCondition::Frozen;
            let invalid = [Validity::Saturated, Validity::OutsideModel];
            for (ticks, validity) in outside.iter_mut().zip(invalid) {
                *ticks = if estimate.validity == validity { ticks.saturating_add(1) } else { 0 };
            }
            let ([saturated, beyond], [saturated_ticks, outside_ticks]) =
                (*outside, self.outside_ticks);
            ok |= u32::from(!lost && !frozen) << sensor;
            for (fault, active) in [
                (Fault::SensorLost, lost),
                (Fault::SensorFrozen, frozen),
                (Fault::SensorSaturated, saturated >= saturated_ticks),
                (Fault::OutsideModel, beyond >= outside_ticks),
            ] {
                shared.update_fault(
                    FaultReporter::Estimate,
                    &mut self.faults,
                    (fault, sensor),
                    active,
                    age,
                );
            }
        }
        shared.counts.sensors_ok.store(ok, Ordering::Relaxed);
        let difference = self.balance.update(estimates);
        let detail = difference.map_or(0, |force| force.0.unsigned_abs());
        let disturbed = estimates.iter().any(|estimate| estimate.disturbed);
        for (fault, active, detail) in
            [(Fault::Unbalanced, difference.is_some(), detail), (Fault::Disturbed, disturbed, 0)]
        {
            shared.update_fault(
                FaultReporter::Estimate,
                &mut self.faults,
                (fault, 0),
                active,
                detail,
            );
        }
    }
}

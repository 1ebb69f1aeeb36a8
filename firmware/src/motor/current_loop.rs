//! Current loop, 20 kHz: from samples to bridge commands, with the motor's state and its fast protections.

use crate::math::{Direction, greater};
use crate::motor::commissioning::{self, Commissioning, CommissioningInputs, CommissioningStep};
use crate::motor::current_sense::{self, CurrentOffsets, OffsetMeasurement};
use crate::motor::diagnostics::{ElectricalSample, SensorMonitor};
use crate::motor::encoder::AngleTracker;
use crate::motor::foc::{self, AlphaBeta, CurrentController, Dq, VoltageOutput, Windings};
use crate::motor::power_stage::{BridgeCommand, MotorSamples};
use crate::motor::settings::{IdentifiedMotor, MotorLimits, Settings};
use crate::motor::spin_test::{SpinStep, SpinTest};
use crate::motor::state::{MotorState, Trip};
use crate::motor::tick_exchange::{
    CurrentLoopAction, CurrentLoopCommand, CurrentLoopReport, StateChange,
};
use crate::motor::timing::{MOTION_PERIODS, PERIOD_S};

/// Dead time of the loop: from sampling in the middle of a period to the middle of the next.
const DELAY_S: f32 = PERIOD_S;
/// Bus voltage in volts below which the gate drivers do not work.
const MIN_BUS_V: f32 = 8.0;
/// Periods without a command of the motion loop before a trip: three of its ticks.
const MAX_MISSED_PERIODS: u8 = 3 * MOTION_PERIODS;

/// The current loop.
#[derive(Clone, Copy, Debug)]
pub struct CurrentLoop {
    pub(super) settings: Settings,
    pub(super) windings: Windings,
    pub(super) state: MotorState,
    pub(super) action: CurrentLoopAction,
    offsets: CurrentOffsets,
    offset_measurement: OffsetMeasurement,
    /// In progress, or to begin after the offset measurement.
    commissioning: Option<Commissioning>,
    /// The second part of commissioning, in progress.
    spin_test: Option<SpinTest>,
    identification: Option<IdentifiedMotor>,
    tracker: AngleTracker,
    currents: CurrentController,
    rotor: Direction,
    measured: Dq,
    /// Currents one period before.
    previous: Dq,
    output: VoltageOutput,
    /// Voltage applied between the two measurements.
    applied: Dq,
    sensors: SensorMonitor,
    bus_v: f32,
    is_shorted: bool,
    is_reset: bool,
    is_angle_lost: bool,
    /// After a trip: the bridges are off for good, not only shorted.
    is_stage_off: bool,
    /// Periods since the last command of the motion loop.
    missed_periods: u8,
}

impl CurrentLoop {
    /// A disarmed motor.
    pub fn new(settings: Settings) -> Self {
        Self {
            windings: Windings::of(&settings.machine),
            settings,
            state: MotorState::Disarmed,
            action: CurrentLoopAction::Off,
            offsets: CurrentOffsets::NOMINAL,
            offset_measurement: OffsetMeasurement::default(),
            commissioning: None,
            spin_test: None,
            identification: None,
            tracker: AngleTracker::default(),
            currents: CurrentController::default(),
            rotor: Direction::default(),
            measured: Dq::default(),
            previous: Dq::default(),
            output: VoltageOutput::default(),
            applied: Dq::default(),
            sensors: SensorMonitor::default(),
            bus_v: 0.0,
            is_shorted: false,
            is_reset: false,
            is_angle_lost: false,
            is_stage_off: false,
            missed_periods: 0,
        }
    }

    /// Applies a command of the motion loop.
    pub fn apply(&mut self, command: CurrentLoopCommand) {
        self.missed_periods = 0;
        match command.change {
            None => {}
            Some(StateChange::Arm) => self.arm(None),
            Some(StateChange::Commission) => self.arm(Some(Commissioning::default())),
            Some(StateChange::Disarm) => self.disarm(),
            Some(StateChange::Trip(trip)) => {
                self.trip(trip);
            }
        }
        self.action = match self.state {
            MotorState::Armed => command.action,
            _ => CurrentLoopAction::Off,
        };
    }

    /// The report for the motion loop; clears its events.
    pub fn take_report(&mut self) -> CurrentLoopReport {
        let report = self.report();
        self.push_report(|_| Ok::<(), ()>(()));
        report
    }

    /// Passes the report for the motion loop to `push`; clears its events if that was successful.
    pub fn push_report<E>(&mut self, push: impl FnOnce(CurrentLoopReport) -> Result<(), E>) {
        if push(self.report()).is_ok() {
            self.is_reset = false;
            self.is_angle_lost = false;
        }
    }

    pub(super) fn report(&self) -> CurrentLoopReport {
        CurrentLoopReport {
            state: self.state,
            rotor: self.tracker,
            current: self.measured,
            previous: self.previous,
            voltage: self.applied,
            is_limited: self.output.is_limited,
            bus_v: self.bus_v,
            is_shorted: self.is_shorted,
            is_reset: self.is_reset,
            is_angle_lost: self.is_angle_lost,
        }
    }

    /// A new result of commissioning, for [`super::MotionLoop::apply_identification`].
    pub fn take_identification(&mut self) -> Option<IdentifiedMotor> {
        self.identification.take()
    }

    /// Reports that the power stage switched itself off through its break input.
    pub fn trip_power_stage(&mut self) {
        self.trip(Trip::PowerStage);
    }

    /// Bridge command for the next period from the samples of this one. To be called every period.
    pub fn tick(&mut self, samples: &MotorSamples) -> BridgeCommand {
        self.missed_periods = self.missed_periods.saturating_add(1);
        self.bus_v = current_sense::bus_v(samples);
        let tracked = self.tracker.update(samples.angle, &self.settings);
        self.is_angle_lost |= tracked.is_err();
        let phases = self.swapped(self.offsets.amperes(samples));
        let checked = match self.state {
            MotorState::Tripped(_) => return self.supervise_brake(samples, phases),
            MotorState::Arming => return self.measure_offsets(samples),
            MotorState::Disarmed | MotorState::CommissioningFailed(_) => Ok(()),
            MotorState::Armed | MotorState::Commissioning => tracked
                .map_err(|_| Trip::Encoder)
                .and(self.check(samples, phases))
                .and(self.check_sensors(samples, phases)),
        };
        let current = AlphaBeta::from_phases(phases);
        let drive = match (checked, self.state) {
            (Err(trip), _) => Drive::Command(self.trip(trip)),
            (_, MotorState::Armed) => self.control(current),
            (_, MotorState::Commissioning) => self.commission(phases, current),
            _ => {
                self.update_measured(current);
                Drive::Command(BridgeCommand::Off)
            }
        };
        match drive {
            Drive::Command(command) => command,
            Drive::Follow(setpoint) => self.follow(setpoint, phases),
        }
    }

    fn arm(&mut self, commissioning: Option<Commissioning>) {
        if let MotorState::Disarmed | MotorState::CommissioningFailed(_) = self.state {
            self.state = MotorState::Arming;
            self.offset_measurement = OffsetMeasurement::default();
            self.commissioning = commissioning;
            if !self.settings.is_sound() {
                self.trip(Trip::NotANumber);
            }
        }
    }

    fn disarm(&mut self) {
        self.state = MotorState::Disarmed;
        (self.commissioning, self.spin_test) = (None, None);
        self.reset_controllers();
    }

    /// Trips. A further cause does not replace the first, but can still switch the bridges off.
    fn trip(&mut self, trip: Trip) -> BridgeCommand {
        if !matches!(self.state, MotorState::Tripped(_)) {
            self.state = MotorState::Tripped(trip);
            self.is_stage_off = false;
            (self.commissioning, self.spin_test) = (None, None);
            self.reset_controllers();
        }
        self.is_stage_off |= trip.drive() == BridgeCommand::Off;
        if self.is_stage_off { BridgeCommand::Off } else { BridgeCommand::Brake }
    }

    /// Shorted windings carry current: it is still limited.
    fn supervise_brake(&mut self, samples: &MotorSamples, phases: [f32; 3]) -> BridgeCommand {
        match (self.state, check_currents(samples, phases, &self.settings.limits)) {
            // The low sides need their gate drivers.
            (MotorState::Tripped(_), Ok(())) if self.bus_v < MIN_BUS_V => BridgeCommand::Off,
            (_, Err(trip)) | (MotorState::Tripped(trip), Ok(())) => self.trip(trip),
            _ => BridgeCommand::Off,
        }
    }

    fn reset_controllers(&mut self) {
        self.currents = CurrentController::default();
        self.output = VoltageOutput::default();
        self.is_reset = true;
    }

    /// Exchanges phases V and W where they are swapped; its own inverse. Commissioning measures the wiring anew.
    fn swapped(&self, [u, v, w]: [f32; 3]) -> [f32; 3] {
        let is_unknown =
            matches!(self.state, MotorState::Commissioning) && self.spin_test.is_none();
        if self.settings.wiring.is_swapped && !is_unknown { [u, w, v] } else { [u, v, w] }
    }

    /// Checks limits while the bridges may be on.
    fn check(&self, samples: &MotorSamples, phases: [f32; 3]) -> Result<(), Trip> {
        let limits = &self.settings.limits;
        let speed = self.tracker.speed();
        if !speed.is_finite() {
            return Err(Trip::NotANumber);
        }
        check_currents(samples, phases, limits)?;
        if self.missed_periods > MAX_MISSED_PERIODS {
            return Err(Trip::CommandTimeout);
        }
        if speed.abs() > limits.trip_speed {
            return Err(Trip::OverSpeed);
        }
        Ok(())
    }

    /// Checks the sensors for plausibility while armed; commissioning has its own checks.
    fn check_sensors(&mut self, samples: &MotorSamples, phases: [f32; 3]) -> Result<(), Trip> {
        match self.state {
            MotorState::Armed => self.sensors.update(samples, phases, &self.settings.limits),
            _ => Ok(()),
        }
    }

    fn measure_offsets(&mut self, samples: &MotorSamples) -> BridgeCommand {
        match self.offset_measurement.update(samples) {
            None => BridgeCommand::Off,
            Some(Err(_)) => self.trip(Trip::CurrentSense),
            Some(Ok(_)) if !self.tracker.is_known() => self.trip(Trip::Encoder),
            Some(Ok(offsets)) => {
                self.offsets = offsets;
                self.reset_controllers();
                self.state = match self.commissioning {
                    Some(_) => MotorState::Commissioning,
                    None => MotorState::Armed,
                };
                BridgeCommand::Off
            }
        }
    }

    /// Stores the currents in rotor axes.
    #[inline(always)] // A call costs as much as it saves.
    fn update_measured(&mut self, current: AlphaBeta) {
        self.rotor = Direction::of(self.tracker.electrical(&self.settings));
        self.previous = self.measured;
        self.measured = current.to_rotor(self.rotor);
        self.applied = self.output.voltage;
    }

    fn control(&mut self, current: AlphaBeta) -> Drive {
        self.update_measured(current);
        let limits = &self.settings.limits;
        let [_, full_v] = limits.dissipation_v;
        self.is_shorted =
            self.bus_v > limits.overvoltage_v || (self.is_shorted && self.bus_v > full_v);
        let command = match self.action {
            CurrentLoopAction::Off => BridgeCommand::Off,
            _ if self.bus_v < MIN_BUS_V => BridgeCommand::Off,
            _ if self.is_shorted => BridgeCommand::Brake,
            CurrentLoopAction::Brake => BridgeCommand::Brake,
            CurrentLoopAction::Follow(setpoint) => return Drive::Follow(setpoint),
        };
        self.reset_controllers();
        Drive::Command(command)
    }

    fn follow(&mut self, setpoint: Dq, phases: [f32; 3]) -> BridgeCommand {
        let speed = self.tracker.speed() * f32::from(self.settings.machine.pole_pairs);
        self.output = self.currents.update(
            &self.windings,
            setpoint,
            self.measured,
            speed,
            foc::max_v(self.bus_v),
        );
        let voltage = self.output.voltage.to_stator(self.rotor.rotated(speed * DELAY_S));
        self.modulate(voltage, phases)
    }

    fn commission(&mut self, phases: [f32; 3], current: AlphaBeta) -> Drive {
        self.update_measured(current);
        let max_a = commissioning::max_a(self.settings.limits.peak_a);
        if let Some(spin_test) = &mut self.spin_test {
            let machine = &self.settings.machine;
            let speed = self.tracker.speed();
            let sample = ElectricalSample {
                measured: self.measured,
                previous: self.previous,
                setpoint: Dq::default(),
                voltage: self.applied,
                max_v: 0.0,
                speed: speed * f32::from(machine.pole_pairs),
            };
            return match spin_test.tick(speed, &sample, machine) {
                SpinStep::Drive(q) => Drive::Follow(Dq { d: 0.0, q }),
                SpinStep::Ended(result) => {
                    self.disarm();
                    match result {
                        Ok(identified) => {
                            self.identification = Some(identified);
                            self.apply_identification(&identified);
                        }
                        Err(error) => self.state = MotorState::CommissioningFailed(error),
                    }
                    Drive::Command(BridgeCommand::Off)
                }
            };
        }
        let Some(commissioning) = &mut self.commissioning else {
            return Drive::Command(self.trip(Trip::NotANumber));
        };
        let inputs = CommissioningInputs {
            current,
            angle: self.tracker.angle(),
            max_v: foc::max_v(self.bus_v),
            max_a,
        };
        match commissioning.tick(&inputs) {
            CommissioningStep::Drive(voltage) => {
                return Drive::Command(self.modulate(voltage, phases));
            }
            CommissioningStep::Ended(Ok(windings)) => {
                self.reset_controllers();
                self.apply_identification(&windings);
                self.spin_test = Some(SpinTest::new(windings, max_a));
            }
            CommissioningStep::Ended(Err(error)) => {
                self.disarm();
                self.state = MotorState::CommissioningFailed(error);
            }
        }
        Drive::Command(BridgeCommand::Off)
    }

    fn apply_identification(&mut self, identified: &IdentifiedMotor) {
        self.settings.apply_identification(identified);
        self.windings = Windings::of(&self.settings.machine);
    }

    /// Duty cycles for a voltage; trips where it is not finite.
    #[inline(always)] // As a function of its own it would not be in the memory of the interrupt.
    fn modulate(&mut self, voltage: AlphaBeta, phases: [f32; 3]) -> BridgeCommand {
        let duties = foc::compensate_dead_time(foc::duties(voltage, self.bus_v), phases);
        let [u, v, w] = duties;
        if (u + v + w).is_finite() {
            BridgeCommand::Duty(self.swapped(duties))
        } else {
            self.trip(Trip::NotANumber)
        }
    }
}

/// What a period ends with.
enum Drive {
    Command(BridgeCommand),
    /// The current controllers follow a set-point. They have one caller: else they would not be in the memory of the interrupt.
    Follow(Dq),
}

/// Checks the phase currents.
#[inline(always)] // As a function of its own it would not be in the memory of the interrupt.
fn check_currents(
    samples: &MotorSamples,
    phases: [f32; 3],
    limits: &MotorLimits,
) -> Result<(), Trip> {
    let [u, v, w] = phases;
    if !(u + v + w).is_finite() {
        return Err(Trip::NotANumber);
    }
    let max_a = greater(u.abs(), greater(v.abs(), w.abs()));
    if current_sense::is_saturated(samples) || max_a > limits.trip_a {
        return Err(Trip::OverCurrent);
    }
    Ok(())
}

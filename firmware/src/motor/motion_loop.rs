//! Motion loop, 4 kHz: motor commands, position and speed control, current limits.

use core::f32::consts::TAU;

use crate::config::constants;
use crate::math::{greater, lesser, within};
use crate::motor::brake_energy;
use crate::motor::diagnostics::{ElectricalSample, RunawayMonitor, SupplyMonitor, VoltageMonitor};
use crate::motor::encoder::RotorPosition;
use crate::motor::foc::{self, Dq, PiController, PiGains};
use crate::motor::limits::{
    ActiveLimits, CurrentBounds, Limit, OperatingPoint, Temperatures, WindingHeat,
};
use crate::motor::screw::Backlash;
use crate::motor::settings::{IdentifiedMotor, MotorParameters, Settings};
use crate::motor::state::{MotorCommand, MotorState, MotorStatus, Setpoint, Trip};
use crate::motor::tick_exchange::{
    CurrentLoopAction, CurrentLoopCommand, CurrentLoopReport, StateChange,
};
use crate::motor::timing::MOTION_HZ;
use crate::motor::trajectory::Trajectory;

/// Timeout of a current or speed set-point in ticks: 5 ms, five times its period. A position set-point has none, as
/// its motion ends by itself.
const SETPOINT_TIMEOUT_TICKS: u8 = 20;
/// Crossover of the speed loop relative to the corner of its integrator.
const CORNER: f32 = 5.0;
/// Share of an increase of the speed that [`SetpointFilter`] does not delay.
const WEIGHT: f32 = constants::SPEED_SETPOINT_WEIGHT.value as f32;

/// Reference of the opening.
#[derive(Clone, Copy, Debug)]
struct Home {
    rotor: RotorPosition,
    opening_mm: f32,
    backlash: Backlash,
}

/// The motion loop.
#[derive(Clone, Copy, Debug)]
pub struct MotionLoop {
    pub(super) settings: Settings,
    speed_gains: PiGains,
    report: CurrentLoopReport,
    setpoint: Setpoint,
    /// Ticks since the last set-point.
    setpoint_age: u8,
    home: Option<Home>,
    pub(super) speed: SpeedController,
    speed_filter: SetpointFilter,
    position: Option<PositionController>,
    heat: WindingHeat,
    temperatures: Temperatures,
    bounds: CurrentBounds,
    pub(super) current_setpoint: Dq,
    opening_mm: Option<f32>,
    active_limits: ActiveLimits,
    identification: Option<IdentifiedMotor>,
    voltages: VoltageMonitor,
    runaway: RunawayMonitor,
    supply: SupplyMonitor,
}

impl MotionLoop {
    /// Without a set-point.
    pub fn new(settings: Settings) -> Self {
        Self {
            speed_gains: speed_gains(&settings.machine),
            settings,
            report: CurrentLoopReport::default(),
            setpoint: Setpoint::Off,
            setpoint_age: 0,
            home: None,
            speed: SpeedController::default(),
            speed_filter: SetpointFilter::default(),
            position: None,
            heat: WindingHeat::default(),
            temperatures: Temperatures::default(),
            bounds: CurrentBounds::default(),
            current_setpoint: Dq::default(),
            opening_mm: None,
            active_limits: ActiveLimits::default(),
            identification: None,
            voltages: VoltageMonitor::default(),
            runaway: RunawayMonitor::default(),
            supply: SupplyMonitor::default(),
        }
    }

    /// Handles a command from the next tick on. Returns what the current loop can carry out at once. Set-points are
    /// ignored unless the motor is armed.
    pub fn handle_command(&mut self, command: MotorCommand) -> Option<CurrentLoopCommand> {
        let change = match command {
            MotorCommand::Arm => Some(StateChange::Arm),
            MotorCommand::Commission => Some(StateChange::Commission),
            MotorCommand::Disarm => {
                self.setpoint = Setpoint::Off;
                Some(StateChange::Disarm)
            }
            MotorCommand::Setpoint(setpoint) => {
                self.set_setpoint(setpoint).err().map(StateChange::Trip)
            }
            MotorCommand::SetOpening { opening_mm } => {
                self.set_opening(opening_mm);
                return None;
            }
            MotorCommand::Temperatures(temperatures) => {
                self.temperatures = temperatures;
                return None;
            }
        };
        let action = match self.setpoint {
            Setpoint::Brake => Some(CurrentLoopAction::Brake),
            Setpoint::Off => Some(CurrentLoopAction::Off),
            Setpoint::Current { .. } | Setpoint::Speed { .. } | Setpoint::Position { .. } => None,
        };
        (change.is_some() || action.is_some())
            .then_some(CurrentLoopCommand { change, action: action.unwrap_or_default() })
    }

    /// One tick, with the latest report of the current loop.
    pub fn tick(&mut self, report: CurrentLoopReport) -> CurrentLoopCommand {
        const SECONDS: f32 = 1.0 / MOTION_HZ as f32;
        self.update_report(report);
        let limits = self.settings.limits;
        self.heat.add(&limits, report.current.squared(), SECONDS);
        let rotor_mm = self.rotor_mm();
        let screw = &self.settings.screw;
        self.opening_mm = rotor_mm.and_then(|rotor_mm| {
            let home = self.home.as_mut()?;
            Some(home.backlash.opening_mm(screw, rotor_mm))
        });
        self.active_limits = ActiveLimits::default();
        let controlled = match report.state {
            MotorState::Armed => self.check().and_then(|()| self.control(rotor_mm)),
            _ => Ok(CurrentLoopAction::Off),
        };
        match controlled {
            Ok(action) => CurrentLoopCommand { change: None, action },
            Err(trip) => CurrentLoopCommand {
                change: Some(StateChange::Trip(trip)),
                action: CurrentLoopAction::Off,
            },
        }
    }

    /// Takes over the result of commissioning.
    pub fn apply_identification(&mut self, identified: IdentifiedMotor) {
        self.identification = Some(identified);
        self.settings.apply_identification(&identified);
        self.speed_gains = speed_gains(&self.settings.machine);
    }

    /// Result of the last commissioning, to be stored.
    pub const fn identification(&self) -> Option<IdentifiedMotor> {
        self.identification
    }

    /// Status as of the last report.
    pub fn status(&self) -> MotorStatus {
        self.status_from(&self.report)
    }

    pub(super) fn status_from(&self, report: &CurrentLoopReport) -> MotorStatus {
        let mut limits = self.bounds.reasons.and(self.active_limits);
        limits.set(Limit::Voltage, report.is_limited);
        MotorStatus {
            state: report.state,
            opening_mm: self.opening_mm,
            setpoint_mm: self.position.map(|position| position.setpoint_mm()),
            closing_mm_s: self.settings.screw.closing_mm_s(report.rotor.speed()),
            rotor_rad: report.rotor.position().since(RotorPosition::default()),
            speed: report.rotor.speed(),
            turn: report.rotor.is_known().then(|| report.rotor.angle()),
            pole_pairs: self.settings.machine.pole_pairs,
            current: report.current,
            current_setpoint: self.current_setpoint,
            voltage: report.voltage,
            bus_v: report.bus_v,
            supply: self.supply.state_at(report.bus_v, &self.settings.limits),
            is_hot: self.bounds.is_hot,
            limits,
            identification: self.identification,
        }
    }

    fn update_report(&mut self, report: CurrentLoopReport) {
        if report.is_angle_lost {
            self.home = None;
            self.position = None;
        }
        if report.is_reset {
            self.speed = SpeedController::default();
            self.current_setpoint = Dq::default();
            self.voltages = VoltageMonitor::default();
            self.runaway = RunawayMonitor::default();
        }
        if report.state != MotorState::Armed {
            self.setpoint = Setpoint::Off;
            self.position = None;
        }
        self.report = report;
    }

    fn set_setpoint(&mut self, setpoint: Setpoint) -> Result<(), Trip> {
        if self.report.state != MotorState::Armed {
            return Ok(());
        }
        if !setpoint.is_finite() {
            return Err(Trip::NotANumber);
        }
        if let Setpoint::Current { .. } | Setpoint::Off | Setpoint::Brake = self.setpoint {
            // Bumpless transfer.
            self.speed = SpeedController::start(self.current_setpoint.q);
        }
        let is_speed = |setpoint| matches!(setpoint, Setpoint::Speed { .. });
        if is_speed(setpoint) && !is_speed(self.setpoint) {
            self.speed_filter = SetpointFilter { lagged: self.report.rotor.speed() };
        }
        match (setpoint, self.position) {
            (Setpoint::Position { .. }, None) => self.start_position(),
            (Setpoint::Position { .. }, Some(_)) => {}
            _ => self.position = None,
        }
        self.setpoint = setpoint;
        self.setpoint_age = 0;
        Ok(())
    }

    /// Sets the present opening, with the closing flanks of the screws in contact.
    fn set_opening(&mut self, opening_mm: f32) {
        self.home = opening_mm.is_finite().then(|| Home {
            rotor: self.report.rotor.position(),
            opening_mm,
            backlash: Backlash::new(opening_mm),
        });
        self.position = None;
        if let Setpoint::Position { .. } = self.setpoint {
            self.start_position();
        }
    }

    /// Rotor position as an opening, without backlash.
    pub(super) fn rotor_mm(&self) -> Option<f32> {
        let home = self.home?;
        let turned = self.report.rotor.position().since(home.rotor);
        Some(home.opening_mm - turned * self.settings.screw.ratio_mm)
    }

    fn start_position(&mut self) {
        let opening_mm_s = -self.settings.screw.closing_mm_s(self.report.rotor.speed());
        let start = |opening_mm| PositionController::start(opening_mm, opening_mm_s);
        self.position = self.rotor_mm().map(start);
    }

    /// Checks currents and voltages for plausibility.
    fn check(&mut self) -> Result<(), Trip> {
        let report = &self.report;
        let (machine, limits) = (&self.settings.machine, &self.settings.limits);
        self.supply.update(report.bus_v, limits);
        if report.is_reset {
            return Ok(());
        }
        let sample = ElectricalSample {
            measured: report.current,
            previous: report.previous,
            setpoint: self.current_setpoint,
            voltage: report.voltage,
            max_v: foc::max_v(report.bus_v),
            speed: report.rotor.speed() * f32::from(machine.pole_pairs),
        };
        self.voltages.update(&sample, machine, limits)
    }

    fn update_bounds(&mut self) {
        let point = OperatingPoint {
            speed: self.report.rotor.speed(),
            bus_v: self.report.bus_v,
            heat: self.heat,
            temperatures: self.temperatures,
            speed_gain: self.speed_gains.proportional,
        };
        let mut bounds = CurrentBounds::compute(&self.settings, &point);
        let max_a = self.setpoint.max_a();
        bounds.low_a = within(bounds.low_a, -max_a, max_a);
        bounds.high_a = within(bounds.high_a, -max_a, max_a);
        self.bounds = bounds;
    }

    fn control(&mut self, rotor_mm: Option<f32>) -> Result<CurrentLoopAction, Trip> {
        self.update_bounds();
        self.setpoint_age = self.setpoint_age.saturating_add(1);
        if let Setpoint::Current { .. } | Setpoint::Speed { .. } = self.setpoint
            && self.setpoint_age > SETPOINT_TIMEOUT_TICKS
        {
            return Err(Trip::CommandTimeout);
        }
        let speed = self.report.rotor.speed();
        let (q, is_limited) = match self.setpoint {
            Setpoint::Off => return Ok(CurrentLoopAction::Off),
            Setpoint::Brake => return Ok(CurrentLoopAction::Brake),
            Setpoint::Current { closing_a } => {
                let limited = within(closing_a, self.bounds.low_a, self.bounds.high_a);
                (limited, limited != closing_a)
            }
            Setpoint::Speed { closing_mm_s, .. } => {
                self.control_speed(closing_mm_s, rotor_mm, speed)?
            }
            Setpoint::Position { opening_mm, speed_mm_s, .. } => {
                self.control_position(opening_mm, speed_mm_s, rotor_mm, speed)?
            }
        };
        self.active_limits.set(Limit::Current, is_limited);
        let (bus_v, amplitude_a) = (self.report.bus_v, self.bounds.amplitude_a);
        let (setpoint, is_dissipating) =
            brake_energy::dissipate(&self.settings, q, speed, bus_v, amplitude_a);
        self.active_limits.set(Limit::Regeneration, is_dissipating || self.report.is_shorted);
        // The current loop trips where it is not finite.
        self.current_setpoint = setpoint;
        Ok(CurrentLoopAction::Follow(setpoint))
    }

    /// Speed control, slowed down near the ends of the stroke and limited while the opening is unknown.
    fn control_speed(
        &mut self,
        closing_mm_s: f32,
        rotor_mm: Option<f32>,
        speed: f32,
    ) -> Result<(f32, bool), Trip> {
        let limits = &self.settings.limits;
        let [closed, open] = limits.ends_mm;
        let (min_mm_s, max_mm_s, limit) = match rotor_mm {
            Some(mm) => {
                let to_end = |travel: f32| PositionController::GAIN * greater(travel, 0.0);
                (-to_end(open - mm), to_end(mm - closed), Limit::EndStop)
            }
            None => (-limits.homing_mm_s, limits.homing_mm_s, Limit::NotHomed),
        };
        let limited = within(closing_mm_s, min_mm_s, max_mm_s);
        self.active_limits.set(limit, limited != closing_mm_s);
        let screw = &self.settings.screw;
        let setpoint = within(screw.rotor_speed(limited), -limits.speed, limits.speed);
        let feed_forward_a = feed_forward_a(&self.settings.machine, setpoint, 0.0);
        let filtered = self.speed_filter.update(setpoint);
        self.follow_speed([filtered, speed], feed_forward_a)
    }

    /// Position control within the stroke; while the opening is unknown, the rotor is held at zero speed.
    fn control_position(
        &mut self,
        opening_mm: f32,
        speed_mm_s: f32,
        rotor_mm: Option<f32>,
        speed: f32,
    ) -> Result<(f32, bool), Trip> {
        let (Some(position), Some(rotor_mm)) = (&mut self.position, rotor_mm) else {
            self.active_limits.set(Limit::NotHomed, true);
            return self.follow_speed([0.0, speed], 0.0);
        };
        let [_, open] = self.settings.limits.ends_mm;
        let target = within(opening_mm, 0.0, open);
        self.active_limits.set(Limit::EndStop, target != opening_mm);
        let output = position.update(&self.settings, target, speed_mm_s, rotor_mm);
        let limit = self.settings.limits.speed;
        let setpoint = within(output.speed, -limit, limit);
        self.follow_speed([setpoint, speed], output.feed_forward_a)
    }

    /// Speed controller for a set-point and a measured speed in rad/s; trips on a runaway.
    fn follow_speed(&mut self, speeds: [f32; 2], feed_forward_a: f32) -> Result<(f32, bool), Trip> {
        let limits = &self.settings.limits;
        self.runaway.update(speeds, self.current_setpoint.q, limits)?;
        Ok(self.speed.update(&self.speed_gains, speeds, feed_forward_a, &self.bounds))
    }
}

/// Gains of the speed controller for a crossover of [`constants::SPEED_BANDWIDTH`].
pub fn speed_gains(machine: &MotorParameters) -> PiGains {
    let crossover = TAU * constants::SPEED_BANDWIDTH.value as f32;
    let gain = crossover * machine.inertia_kg_m2 / machine.torque_nm_a;
    PiGains::of(gain, crossover / CORNER, 1.0 / MOTION_HZ as f32)
}

/// Feed-forward current in amperes for inertia and friction.
pub fn feed_forward_a(machine: &MotorParameters, speed: f32, acceleration: f32) -> f32 {
    // Dry friction rises linearly up to 1 rad/s, to avoid a step at standstill.
    let friction = machine.dry_nm * within(speed, -1.0, 1.0) + machine.viscous_nm_s * speed;
    (machine.inertia_kg_m2 * acceleration + friction) / machine.torque_nm_a
}

/// Speed controller: rotor speed by the q current.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpeedController {
    pi: PiController,
}

impl SpeedController {
    /// Starts with a present q current in amperes.
    pub const fn start(current_a: f32) -> Self {
        Self { pi: PiController { sum: current_a } }
    }

    /// The q current in amperes for a set-point and a measured speed in rad/s, and whether it is limited.
    pub fn update(
        &mut self,
        gains: &PiGains,
        [setpoint, measured]: [f32; 2],
        feed_forward_a: f32,
        bounds: &CurrentBounds,
    ) -> (f32, bool) {
        let error = setpoint - measured;
        let unlimited = self.pi.output(gains, error) + feed_forward_a;
        let limited = within(unlimited, bounds.low_a, bounds.high_a);
        self.pi.integrate(gains, error, limited - unlimited);
        (limited, limited != unlimited)
    }
}

/// Filter of a speed set-point, (1 + [`WEIGHT`] T s) / (1 + T s) with the time constant T of the integrator: without
/// it the zero of the speed controller and the lags of current loop and angle tracker make a step overshoot by half.
/// A decrease of the speed is not delayed.
#[derive(Clone, Copy, Debug, Default)]
struct SetpointFilter {
    /// State of the lag in rad/s.
    lagged: f32,
}

impl SetpointFilter {
    /// Share of the lag's error that a tick removes.
    const SHARE: f32 = TAU * constants::SPEED_BANDWIDTH.value as f32 / CORNER / MOTION_HZ as f32;

    /// One tick with a set-point in rad/s.
    fn update(&mut self, setpoint: f32) -> f32 {
        let lagged = within(self.lagged, lesser(setpoint, 0.0), greater(setpoint, 0.0));
        self.lagged = lagged + Self::SHARE * (setpoint - lagged);
        WEIGHT * setpoint + (1.0 - WEIGHT) * self.lagged
    }
}

/// Output of the position controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedSetpoint {
    /// Rotor speed in rad/s, closing positive.
    pub speed: f32,
    /// Feed-forward current in amperes.
    pub feed_forward_a: f32,
}

/// Proportional position controller on a trajectory.
#[derive(Clone, Copy, Debug)]
pub struct PositionController {
    trajectory: Trajectory,
}

impl PositionController {
    /// Speed per position error in 1/s.
    pub const GAIN: f32 = TAU * constants::POSITION_BANDWIDTH.value as f32;

    /// Starts at the present opening in millimetres and its speed in mm/s.
    pub fn start(opening_mm: f32, opening_mm_s: f32) -> Self {
        Self { trajectory: Trajectory::start(opening_mm, opening_mm_s) }
    }

    /// One tick towards a target; `opening_mm` is the rotor position as an opening.
    pub fn update(
        &mut self,
        settings: &Settings,
        target_mm: f32,
        speed_mm_s: f32,
        opening_mm: f32,
    ) -> SpeedSetpoint {
        let (limits, screw) = (&settings.limits, &settings.screw);
        let max_mm_s = within(speed_mm_s, 0.0, screw.closing_mm_s(limits.speed));
        self.trajectory.tick(target_mm, max_mm_s);
        let error_mm = self.trajectory.position_mm() - opening_mm;
        let opening_mm_s = self.trajectory.speed_mm_s() + Self::GAIN * error_mm;
        let radians = -screw.rotor_speed(1.0);
        let speed = radians * self.trajectory.speed_mm_s();
        let acceleration = radians * self.trajectory.acceleration_mm_s2();
        SpeedSetpoint {
            speed: radians * opening_mm_s,
            feed_forward_a: feed_forward_a(&settings.machine, speed, acceleration),
        }
    }

    /// Present opening on the trajectory in millimetres.
    pub fn setpoint_mm(&self) -> f32 {
        self.trajectory.position_mm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_increases_of_the_speed_are_filtered() {
        let mut filter = SetpointFilter::default();
        // Half at once, and 63 % of the other half after 5.3 ms.
        let first = filter.update(100.0);
        assert!((first - (50.0 + 50.0 * SetpointFilter::SHARE)).abs() < 1e-3, "{first}");
        let after = (1..21).fold(first, |_, _| filter.update(100.0));
        assert!((after - 81.6).abs() < 1.0, "{after}");
        for _ in 0..1000 {
            filter.update(100.0);
        }
        assert!((filter.update(100.0) - 100.0).abs() < 1e-2);
        assert_eq!(filter.update(40.0), 40.0);
        assert_eq!(filter.update(0.0), 0.0);
        filter.update(80.0);
        let reversed = filter.update(-80.0);
        assert!((reversed + 40.0 + 40.0 * SetpointFilter::SHARE).abs() < 1e-3, "{reversed}");
    }
}

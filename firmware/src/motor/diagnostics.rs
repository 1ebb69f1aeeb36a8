//! Plausibility checks: [`SensorMonitor`] in every PWM period, [`VoltageMonitor`], [`RunawayMonitor`] and
//! [`SupplyMonitor`] in every tick of the motion loop.
//!
//! | defect | symptom |
//! | --- | --- |
//! | current sensor | the phase currents do not sum to zero |
//! | open phase, half bridge that does not switch | the currents do not follow although the voltage suffices |
//! | stuck rotor sensor | its counts have no noise |
//! | rotor sensor slipped on its shaft | the induced voltage has the wrong phase |
//! | wrong commutation | the rotor accelerates against the braking current |

use crate::math::greater;
use crate::motor::foc::Dq;
use crate::motor::power_stage::MotorSamples;
use crate::motor::settings::{MotorLimits, MotorParameters};
use crate::motor::state::{SupplyState, Trip};
use crate::motor::timing::{MOTION_PERIODS, PERIOD_S};

/// Filter coefficient of the voltage residual per tick: a time constant of half a millisecond.
const FILTER: f32 = 0.41;
/// Periods of driving before the voltage residual is checked.
const SETTLING_PERIODS: u16 = 20;
/// PWM periods of a tick.
const PERIODS: u16 = MOTION_PERIODS as u16;
/// Fraction of the available voltage up to which currents must follow.
const VOLTAGE_FRACTION: f32 = 0.7;

/// Checks the sum of the phase currents and the noise of the rotor sensor.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorMonitor {
    sum_periods: u16,
    counts: Option<u16>,
    repeated_periods: u16,
}

impl SensorMonitor {
    /// Adds the samples of one period and its phase currents in amperes.
    ///
    /// # Errors
    /// The samples are implausible.
    pub fn update(
        &mut self,
        samples: &MotorSamples,
        [u, v, w]: [f32; 3],
        limits: &MotorLimits,
    ) -> Result<(), Trip> {
        let sum_a = (u + v + w).abs();
        count(&mut self.sum_periods, sum_a > limits.sum_a, 1);
        let counts = samples.angle.ok();
        let is_repeated = counts.is_some() && counts == self.counts;
        count(&mut self.repeated_periods, is_repeated, 1);
        self.counts = counts;
        if self.sum_periods >= limits.sum_periods {
            Err(Trip::CurrentSense)
        } else if limits.stuck_periods.is_some_and(|stuck| self.repeated_periods >= stuck) {
            Err(Trip::Encoder)
        } else {
            Ok(())
        }
    }
}

/// Checks currents and voltages against the model of the windings.
#[derive(Clone, Copy, Debug, Default)]
pub struct VoltageMonitor {
    driven_periods: u16,
    /// Low-pass filtered voltage residual.
    residual: Dq,
    residual_periods: u16,
    tracking_periods: u16,
}

/// Electrical quantities of one tick.
#[derive(Clone, Copy, Debug)]
pub struct ElectricalSample {
    /// Measured currents in amperes.
    pub measured: Dq,
    /// Measured currents one period before.
    pub previous: Dq,
    /// Set-points of the currents.
    pub setpoint: Dq,
    /// Voltage in volts applied between the two measurements.
    pub voltage: Dq,
    /// Maximum voltage that the bus allows.
    pub max_v: f32,
    /// Electrical speed in rad/s.
    pub speed: f32,
}

impl VoltageMonitor {
    /// Adds one tick of driving.
    ///
    /// # Errors
    /// Currents and voltages contradict the model.
    pub fn update(
        &mut self,
        sample: &ElectricalSample,
        machine: &MotorParameters,
        limits: &MotorLimits,
    ) -> Result<(), Trip> {
        count(&mut self.driven_periods, true, PERIODS);
        let induced_v = sample.speed * machine.flux_wb();
        let residual = voltage_residual(sample, machine, induced_v);
        self.residual.d += FILTER * (residual.d - self.residual.d);
        self.residual.q += FILTER * (residual.q - self.residual.q);
        let bound_v = limits.unexplained_v + limits.unexplained * induced_v.abs();
        let is_unexplained = self.residual.squared() > bound_v * bound_v;
        let has_settled = self.driven_periods > SETTLING_PERIODS;
        count(&mut self.residual_periods, is_unexplained && has_settled, PERIODS);
        let error = Dq {
            d: sample.setpoint.d - sample.measured.d,
            q: sample.setpoint.q - sample.measured.q,
        };
        let setpoint_a = greater(sample.setpoint.q.abs(), sample.setpoint.d.abs());
        let rotation_v = induced_v.abs() + sample.speed.abs() * machine.inductance_h * setpoint_a;
        let needed_v = machine.resistance_ohm * setpoint_a + rotation_v;
        let is_off = error.squared() > limits.tracking_error_a * limits.tracking_error_a;
        let can_follow = needed_v < VOLTAGE_FRACTION * sample.max_v;
        count(&mut self.tracking_periods, is_off && can_follow, PERIODS);
        if self.residual_periods >= limits.unexplained_periods {
            Err(Trip::Encoder)
        } else if self.tracking_periods >= limits.tracking_error_periods {
            Err(Trip::CurrentSense)
        } else {
            Ok(())
        }
    }
}

/// Applied voltage minus resistive, inductive and induced voltage.
pub(super) fn voltage_residual(
    sample: &ElectricalSample,
    machine: &MotorParameters,
    induced_v: f32,
) -> Dq {
    let ElectricalSample { measured, previous, voltage, .. } = sample;
    let resistance = machine.resistance_ohm;
    let rate = machine.inductance_h / PERIOD_S;
    let coupling = sample.speed * machine.inductance_h;
    Dq {
        d: voltage.d - resistance * measured.d - rate * (measured.d - previous.d)
            + coupling * measured.q,
        q: voltage.q
            - resistance * measured.q
            - rate * (measured.q - previous.q)
            - coupling * measured.d
            - induced_v,
    }
}

/// Adds to a counter of consecutive periods in which a condition is true.
fn count(periods: &mut u16, condition: bool, more: u16) {
    *periods = if condition { periods.saturating_add(more) } else { 0 };
}

/// Detects a rotor that accelerates against its braking current.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunawayMonitor {
    ticks: u8,
    /// Speed at the beginning in rad/s.
    first_speed: f32,
}

impl RunawayMonitor {
    /// Adds one tick: set-point and measured speed in rad/s, and the set-point of the q current in amperes.
    ///
    /// # Errors
    /// The rotor is too fast and does not decelerate despite the braking current.
    pub fn update(
        &mut self,
        [setpoint, speed]: [f32; 2],
        q: f32,
        limits: &MotorLimits,
    ) -> Result<(), Trip> {
        let excess = speed - setpoint;
        let is_braked = excess * q < 0.0 && q.abs() > limits.runaway_a;
        // A rotor slower than its set-point only lags; at rest the sign of the speed is noise.
        let is_fast = excess.abs() > limits.runaway && speed.abs() > limits.runaway;
        let is_away = is_fast && excess * speed > 0.0;
        if !(is_braked && is_away) {
            self.ticks = 0;
            return Ok(());
        }
        if self.ticks == 0 {
            self.first_speed = speed.abs();
        }
        self.ticks = self.ticks.saturating_add(1);
        let is_due = u16::from(self.ticks) * u16::from(MOTION_PERIODS) > limits.runaway_periods;
        if is_due && speed.abs() >= self.first_speed {
            return Err(Trip::Runaway);
        }
        Ok(())
    }
}

/// Holds an abnormal supply state long enough for a reader with a period of 1 ms.
#[derive(Clone, Copy, Debug, Default)]
pub struct SupplyMonitor {
    state: SupplyState,
    ticks: u8,
}

impl SupplyMonitor {
    const HOLD_TICKS: u8 = 12;

    /// Adds the bus voltage of one tick in volts.
    pub fn update(&mut self, bus_v: f32, limits: &MotorLimits) {
        match SupplyState::of(bus_v, limits) {
            SupplyState::Sound => {
                self.ticks = self.ticks.saturating_sub(1);
                if self.ticks == 0 {
                    self.state = SupplyState::Sound;
                }
            }
            abnormal @ (SupplyState::Low | SupplyState::High) => {
                (self.state, self.ticks) = (abnormal, Self::HOLD_TICKS);
            }
        }
    }

    /// State at a bus voltage, or the held one.
    pub fn state_at(&self, bus_v: f32, limits: &MotorLimits) -> SupplyState {
        match SupplyState::of(bus_v, limits) {
            SupplyState::Sound => self.state,
            abnormal => abnormal,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::screw::Screw;
    use crate::motor::settings::Settings;

    const LIMITS: MotorLimits = MotorLimits::GRIPPER;

    fn samples(angle: u16) -> MotorSamples {
        MotorSamples { phases: [2048; 3], bus: 1600, angle: Ok(angle) }
    }

    #[test]
    fn nonzero_current_sum_trips_after_ten_periods() {
        let trips = |sum: f32, periods| {
            let mut monitor = SensorMonitor::default();
            (0..periods).any(|period| {
                monitor.update(&samples(period), [sum, 3.0, -3.0], &LIMITS)
                    == Err(Trip::CurrentSense)
            })
        };
        assert!(trips(0.81, 10) && !trips(0.81, 9) && !trips(0.79, 1000));
        assert!(trips(-0.81, 10));
    }

    #[test]
    fn constant_angle_counts_trip_after_36_periods() {
        let trips = |repeats: u16| {
            let mut monitor = SensorMonitor::default();
            (0..=repeats)
                .any(|_| monitor.update(&samples(7), [0.0; 3], &LIMITS) == Err(Trip::Encoder))
        };
        assert!(trips(36) && !trips(35));
        let mut monitor = SensorMonitor::default();
        assert!((0..1000).all(|period| {
            let counts = if period % 30 == 0 { 8 } else { 7 };
            monitor.update(&samples(counts), [0.0; 3], &LIMITS).is_ok()
        }));
    }

    /// Constant speed and current, with a sensor offset in electrical radians.
    fn turning(speed: f32, q: f32, off: f32) -> ElectricalSample {
        let machine = Settings::assumed(Screw::A).machine;
        let induced_v = speed * machine.flux_wb();
        ElectricalSample {
            measured: Dq { d: 0.0, q },
            previous: Dq { d: 0.0, q },
            setpoint: Dq { d: 0.0, q },
            voltage: Dq {
                d: -speed * machine.inductance_h * q - induced_v * off.sin(),
                q: machine.resistance_ohm * q + induced_v * off.cos(),
            },
            max_v: 13.0,
            speed,
        }
    }

    fn check(sample: &ElectricalSample, periods: u16) -> Result<(), Trip> {
        let machine = Settings::assumed(Screw::A).machine;
        let mut monitor = VoltageMonitor::default();
        (0..periods / PERIODS).try_for_each(|_| monitor.update(sample, &machine, &LIMITS))
    }

    #[test]
    fn voltage_residual_trips_the_encoder() {
        // 114 rad/s and 7 pole pairs: 7.6 V; an offset of a sixth of a turn gives 7.6 V, the bound is 2.5 + 1.9 V.
        let sixth = core::f32::consts::FRAC_PI_3;
        assert_eq!(check(&turning(798.0, 9.0, 0.0), 1000), Ok(()));
        assert_eq!(check(&turning(798.0, 9.0, sixth), 41), Err(Trip::Encoder));
        assert_eq!(check(&turning(798.0, 9.0, sixth), 39), Ok(()));
        // 30 degrees: 3.9 V.
        assert_eq!(check(&turning(798.0, 9.0, 0.5 * sixth), 1000), Ok(()));
        // A fifth more resistance and flux.
        let mut warm = turning(798.0, 9.0, 0.0);
        warm.voltage.q *= 1.2;
        assert_eq!(check(&warm, 1000), Ok(()));
    }

    #[test]
    fn current_error_trips_unless_voltage_is_short() {
        let mut open = turning(0.0, 0.0, 0.0);
        open.setpoint.q = 1.6;
        assert_eq!(check(&open, 90), Err(Trip::CurrentSense));
        assert_eq!(check(&open, 89), Ok(()));
        open.setpoint.q = 1.4;
        assert_eq!(check(&open, 1000), Ok(()));
        let mut fast = turning(1200.0, 0.0, 0.0);
        fast.setpoint.q = 5.0;
        assert_eq!(check(&fast, 1000), Ok(()));
    }

    #[test]
    fn runaway_trips_only_without_deceleration() {
        let trips = |slower: f32, q: f32| {
            let mut runaway = RunawayMonitor::default();
            (0..20_u16).position(|tick| {
                let speed = 60.0 - slower * f32::from(tick);
                runaway.update([0.0, speed], q, &LIMITS).is_err()
            })
        };
        assert_eq!(trips(0.0, -9.6), Some(7));
        assert_eq!(trips(-3.0, -9.6), Some(7));
        assert_eq!(trips(0.5, -9.6), None);
        // The set-point falls faster than the rotor brakes.
        let mut runaway = RunawayMonitor::default();
        assert!((0..20_u16).map(f32::from).all(|tick| {
            let speeds = [50.0 - 4.0 * tick, 62.0 - 0.5 * tick];
            runaway.update(speeds, -9.6, &LIMITS).is_ok()
        }));
        // The rotor is blocked, with speed noise.
        let mut runaway = RunawayMonitor::default();
        assert!((0..20).all(|_| runaway.update([29.0, -0.4], 9.6, &LIMITS).is_ok()));
        // Driven, or braked by too little current.
        assert_eq!((trips(0.0, 9.6), trips(0.0, -4.9)), (None, None));
    }

    #[test]
    fn abnormal_supply_state_is_held_for_three_milliseconds() {
        let mut monitor = SupplyMonitor::default();
        for (volts, expected) in
            [(15.9, SupplyState::Low), (24.0, SupplyState::Low), (32.1, SupplyState::High)]
        {
            monitor.update(volts, &LIMITS);
            assert_eq!(monitor.state_at(24.0, &LIMITS), expected, "{volts}");
        }
        (0..11).for_each(|_| monitor.update(24.0, &LIMITS));
        assert_eq!(monitor.state_at(24.0, &LIMITS), SupplyState::High);
        monitor.update(24.0, &LIMITS);
        assert_eq!(monitor.state_at(24.0, &LIMITS), SupplyState::Sound);
        assert_eq!(monitor.state_at(15.9, &LIMITS), SupplyState::Low);
    }
}

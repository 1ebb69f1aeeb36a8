//! Limits of the current at an operating point, and the codes of the active ones. An active limit is no fault.

use crate::math::{greater, lesser, share, within};
use crate::motor::settings::{MotorLimits, Settings};

/// A limit; the number is its code. Fault codes ([`crate::system::faults`]) begin at 100.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Limit {
    /// Current limit of motor or set-point.
    Current = 1,
    /// Voltage of the bus.
    Voltage = 2,
    /// Power of the supply.
    Power = 3,
    /// Temperature of motor or power stage.
    Temperature = 4,
    /// Rotor speed.
    Speed = 5,
    /// I2t limit of the windings.
    Heat = 6,
    /// Braking energy: the windings dissipate it, or braking is reduced.
    Regeneration = 7,
    /// Undervoltage of the bus.
    BusLow = 8,
    /// End of the stroke.
    EndStop = 9,
    /// The opening is unknown: no position control, and low speed.
    NotHomed = 10,
}

/// Set of active limits, one bit per code.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ActiveLimits(pub u16);

impl ActiveLimits {
    /// Sets or clears a limit.
    pub fn set(&mut self, limit: Limit, active: bool) {
        let bit = 1 << limit as u8;
        self.0 = (self.0 & !bit) | if active { bit } else { 0 };
    }

    /// Whether a limit is active.
    pub const fn has(self, limit: Limit) -> bool {
        self.0 & (1 << limit as u8) != 0
    }

    /// Union.
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// I2t model of the windings: heat above the continuous rating.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WindingHeat {
    /// In A^2 s.
    used: f32,
}

impl WindingHeat {
    /// Fraction of the capacity above which the limit falls from peak to rated current.
    const FALLS: f32 = 0.8;

    /// Adds the heat of a squared current amplitude over some seconds.
    pub fn add(&mut self, limits: &MotorLimits, squared_a: f32, seconds: f32) {
        let more = (squared_a - limits.rated_a * limits.rated_a) * seconds;
        self.used = within(self.used + more, 0.0, Self::capacity(limits));
    }

    /// Current limit in amperes.
    pub fn limit_a(&self, limits: &MotorLimits) -> f32 {
        let capacity = Self::capacity(limits);
        let falls = share(self.used, Self::FALLS * capacity, capacity);
        limits.peak_a - falls * (limits.peak_a - limits.rated_a)
    }

    fn capacity(limits: &MotorLimits) -> f32 {
        (limits.peak_a * limits.peak_a - limits.rated_a * limits.rated_a) * limits.peak_s
    }
}

/// Temperatures in degrees Celsius; none where not measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Temperatures {
    /// Of the windings.
    pub motor: Option<f32>,
    /// Of the power stage.
    pub stage: Option<f32>,
}

/// Operating point for which the current limits are computed.
#[derive(Clone, Copy, Debug)]
pub struct OperatingPoint {
    /// Rotor speed in rad/s, closing positive.
    pub speed: f32,
    /// Bus voltage in volts.
    pub bus_v: f32,
    /// I2t state of the windings.
    pub heat: WindingHeat,
    /// Temperatures.
    pub temperatures: Temperatures,
    /// Proportional gain of the speed limit in amperes per rad/s.
    pub speed_gain: f32,
}

/// Limits of the q current in amperes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CurrentBounds {
    /// Minimum.
    pub low_a: f32,
    /// Maximum.
    pub high_a: f32,
    /// Maximum amplitude of both axes.
    pub amplitude_a: f32,
    /// What limits the current below the motor's peak.
    pub reasons: ActiveLimits,
    /// Motor or power stage is too hot for any current.
    pub is_hot: bool,
}

impl CurrentBounds {
    /// Limits at an operating point.
    pub fn compute(settings: &Settings, point: &OperatingPoint) -> Self {
        let limits = &settings.limits;
        let mut reasons = ActiveLimits::default();
        let heat_a = point.heat.limit_a(limits);
        reasons.set(Limit::Heat, heat_a < limits.peak_a);
        let derating = temperature_factor(limits, point.temperatures);
        reasons.set(Limit::Temperature, derating < 1.0);
        let amplitude_a = lesser(heat_a, derating * limits.peak_a);
        let drive_a = Self::drive_a(settings, point, amplitude_a, &mut reasons);
        // Supply limits apply to acceleration, not to braking.
        let (mut low_a, mut high_a) =
            if point.speed >= 0.0 { (-amplitude_a, drive_a) } else { (-drive_a, amplitude_a) };
        let max_speed_a = point.speed_gain * (limits.speed - point.speed);
        let min_speed_a = -point.speed_gain * (limits.speed + point.speed);
        high_a = greater(lesser(high_a, max_speed_a), -amplitude_a);
        low_a = lesser(greater(low_a, min_speed_a), amplitude_a);
        let margin_a = point.speed_gain * (limits.speed - point.speed.abs());
        reasons.set(Limit::Speed, margin_a < amplitude_a);
        Self { low_a, high_a, amplitude_a, reasons, is_hot: derating <= 0.0 }
    }

    /// Maximum accelerating current from undervoltage and from the supply's power, after the copper losses of the
    /// full amplitude.
    fn drive_a(
        settings: &Settings,
        point: &OperatingPoint,
        amplitude_a: f32,
        reasons: &mut ActiveLimits,
    ) -> f32 {
        let (limits, machine) = (&settings.limits, &settings.machine);
        let [none_v, full_v] = limits.undervoltage_v;
        let bus = share(point.bus_v, none_v, full_v);
        reasons.set(Limit::BusLow, bus < 1.0);
        let watts_per_a =
            machine.torque_nm_a * point.speed.abs() + 1.5 * machine.resistance_ohm * amplitude_a;
        let power_a = limits.power_w / watts_per_a;
        reasons.set(Limit::Power, power_a < amplitude_a);
        lesser(power_a, bus * amplitude_a)
    }
}

/// De-rating factor of the warmer of motor and power stage; 0 is too hot. NaN counts as too hot.
fn temperature_factor(limits: &MotorLimits, temperatures: Temperatures) -> f32 {
    let factor = |measured: Option<f32>, [begin, end]: [f32; 2]| match measured {
        None => 1.0,
        Some(degrees) if degrees < end => share(degrees, end, begin),
        Some(_) => 0.0,
    };
    lesser(factor(temperatures.motor, limits.motor_c), factor(temperatures.stage, limits.stage_c))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::screw::Screw;

    /// An operating point without any limit.
    fn unlimited() -> OperatingPoint {
        OperatingPoint {
            speed: 0.0,
            bus_v: 24.0,
            heat: WindingHeat::default(),
            temperatures: Temperatures::default(),
            speed_gain: 0.565,
        }
    }

    fn bounds_at(point: &OperatingPoint) -> CurrentBounds {
        CurrentBounds::compute(&Settings::assumed(Screw::A), point)
    }

    fn has(bounds: &CurrentBounds, only: Limit) -> bool {
        let mut expected = ActiveLimits::default();
        expected.set(only, true);
        bounds.reasons == expected
    }

    #[test]
    fn unlimited_operating_point_allows_peak_current() {
        let bounds = bounds_at(&unlimited());
        assert_eq!([bounds.low_a, bounds.high_a, bounds.amplitude_a], [-9.6, 9.6, 9.6]);
        assert_eq!(bounds.reasons, ActiveLimits::default());
    }

    #[test]
    fn winding_heat_reduces_peak_to_rated_and_recovers() {
        let limits = MotorLimits::GRIPPER;
        let mut heat = WindingHeat::default();
        // Four fifths of three seconds at peak current, then de-rating.
        heat.add(&limits, limits.peak_a * limits.peak_a, 2.39);
        assert_eq!(heat.limit_a(&limits), limits.peak_a);
        for _ in 0..8000 {
            let current = heat.limit_a(&limits);
            heat.add(&limits, current * current, 0.001);
        }
        let bounds = bounds_at(&OperatingPoint { heat, ..unlimited() });
        assert!(has(&bounds, Limit::Heat) && bounds.high_a < 5.82);
        heat.add(&limits, limits.rated_a * limits.rated_a, 100.0);
        assert!(heat.limit_a(&limits) < 5.82);
        heat.add(&limits, 0.0, 10.0);
        assert_eq!(heat.limit_a(&limits), limits.peak_a);
    }

    #[test]
    fn winding_heat_derates_linearly() {
        let limits = MotorLimits::GRIPPER;
        let mut heat = WindingHeat::default();
        // Nine tenths of three seconds at 9.6 A: (9.6 + 5.8) / 2.
        heat.add(&limits, 9.6 * 9.6, 2.7);
        assert!((heat.limit_a(&limits) - 7.7).abs() < 1e-3);
        // The same heat at 7 A takes (92.16 - 33.64) / (49 - 33.64) times as long.
        let mut heat = WindingHeat::default();
        heat.add(&limits, 7.0 * 7.0, 2.7 * 3.809_9);
        assert!((heat.limit_a(&limits) - 7.7).abs() < 1e-3);
    }

    #[test]
    fn temperature_derates_and_nan_is_too_hot() {
        let at = |motor, stage| {
            let temperatures = Temperatures { motor, stage };
            let bounds = bounds_at(&OperatingPoint { temperatures, ..unlimited() });
            (bounds.high_a, has(&bounds, Limit::Temperature))
        };
        assert_eq!(at(Some(80.0), Some(90.0)), (9.6, false));
        let (half, is_only_reason) = at(Some(90.0), Some(20.0));
        assert!((half - 4.8).abs() < 1e-4 && is_only_reason);
        let (half, _) = at(None, Some(100.0));
        assert!((half - 4.8).abs() < 1e-4);
        assert_eq!(at(Some(100.0), None).0, 0.0);
        let hot = |degrees| {
            let temperatures = Temperatures { motor: Some(degrees), stage: None };
            bounds_at(&OperatingPoint { temperatures, ..unlimited() }).is_hot
        };
        assert_eq!([99.9, 100.0, f32::NAN].map(hot), [false, true, true]);
        assert_eq!(at(Some(f32::NAN), None).0, 0.0);
    }

    #[test]
    fn above_the_speed_limit_only_braking_is_allowed() {
        let limit = MotorLimits::GRIPPER.speed;
        let fast = |speed| bounds_at(&OperatingPoint { speed, ..unlimited() });
        let bounds = fast(limit);
        assert!(bounds.high_a.abs() < 1e-3 && bounds.low_a == -9.6);
        assert!(fast(limit + 4.0).high_a < -1.9);
        let bounds = fast(-limit - 4.0);
        assert!(bounds.low_a > 1.9 && bounds.high_a == 9.6);
        assert!(bounds.reasons.has(Limit::Speed));
    }

    #[test]
    fn speed_limit_is_active_once_it_reduces_current() {
        // 125.4 rad/s less 9.6 A over 0.565 A s: 108.4 rad/s.
        let is_active =
            |speed| bounds_at(&OperatingPoint { speed, ..unlimited() }).reasons.has(Limit::Speed);
        assert_eq!([108.0, 109.0, -108.0, -109.0].map(is_active), [false, true, false, true]);
    }

    #[test]
    fn power_limit_accounts_for_copper_and_motion() {
        // 150 W over 0.1 N m/A times 100 rad/s and 1.5 times 0.4 ohm times 9.6 A.
        let bounds = bounds_at(&OperatingPoint { speed: 100.0, ..unlimited() });
        assert!((bounds.high_a - 9.517_8).abs() < 1e-3, "{}", bounds.high_a);
        assert!(has(&bounds, Limit::Power));
    }

    #[test]
    fn electrical_power_stays_within_the_supply() {
        let machine = Settings::assumed(Screw::A).machine;
        for speed in [0.0_f32, 57.0, 114.0, -114.0] {
            let bounds = bounds_at(&OperatingPoint { speed, ..unlimited() });
            let amperes = if speed < 0.0 { -bounds.low_a } else { bounds.high_a };
            let power = machine.torque_nm_a * amperes * speed.abs()
                + 1.5 * machine.resistance_ohm * amperes * amperes;
            assert!(power <= MotorLimits::GRIPPER.power_w, "{speed}: {power} W");
            // Required: 350 N at full speed.
            assert!(amperes > 5.8, "{speed}: {amperes} A");
        }
    }

    #[test]
    fn undervoltage_reduces_driving_not_braking() {
        let low = bounds_at(&OperatingPoint { bus_v: 17.5, speed: 1.0, ..unlimited() });
        assert!((low.high_a - 4.8).abs() < 1e-4 && low.low_a == -9.6);
        assert!(has(&low, Limit::BusLow));
        let none = bounds_at(&OperatingPoint { bus_v: 15.0, ..unlimited() });
        assert_eq!(none.high_a, 0.0);
    }

    #[test]
    fn limit_codes_and_bits() {
        assert_eq!(Limit::Current as u8, 1);
        assert_eq!(Limit::NotHomed as u8, 10);
        let mut active = ActiveLimits::default();
        active.set(Limit::EndStop, true);
        active.set(Limit::Heat, true);
        active.set(Limit::Heat, false);
        assert_eq!(active, ActiveLimits(1 << 9));
        assert_eq!(ActiveLimits(0b110).and(ActiveLimits(0b011)), ActiveLimits(0b111));
    }
}

//! Bounds of what the motor may do, and which of them are active. That one is active is no fault.

use super::number::{greater, lesser, share, within};
use super::settings::Settings;
use crate::params;

/// A bound; the number is its code. Faults have others ([`crate::status`]), from 100 on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Limit {
    /// More current was asked for than the motor or the set-point allows.
    Current = 1,
    /// The bus has not the voltage that was asked for.
    Voltage = 2,
    /// More power would be taken from the bus than its supply gives.
    Power = 3,
    /// Motor or power stage is warm: less current.
    Temperature = 4,
    /// The rotor would turn too fast.
    Speed = 5,
    /// The windings have been above their rating for long.
    Heat = 6,
    /// Braking would lift the bus voltage: the windings burn what comes back, or less is braked.
    Regeneration = 7,
    /// The bus voltage is low: less current.
    BusLow = 8,
    /// The fingers are near the end of their way.
    EndStop = 9,
    /// The opening is not known: no place can be asked for, and the fingers move slowly.
    NotHomed = 10,
}

/// The bounds that are active.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Active(pub u16);

impl Active {
    /// Notes whether a bound is active.
    pub fn set(&mut self, limit: Limit, active: bool) {
        let bit = 1 << limit as u8;
        self.0 = (self.0 & !bit) | if active { bit } else { 0 };
    }

    /// Whether a bound is active.
    pub const fn has(self, limit: Limit) -> bool {
        self.0 & (1 << limit as u8) != 0
    }

    /// The bounds of both.
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// The bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Current that the motor bears for ever, in amperes.
    pub rated_a: f32,
    /// Current that it bears for [`Self::peak_s`].
    pub peak_a: f32,
    /// Seconds of peak current, from cold.
    pub peak_s: f32,
    /// A phase's current in amperes at which the power stage is switched off.
    pub trip_a: f32,
    /// Power from the bus in watts.
    pub power_w: f32,
    /// Speed of the rotor in rad/s.
    pub speed: f32,
    /// Speed of the rotor in rad/s at which it is braked, whatever is asked.
    pub trip_speed: f32,
    /// Temperature of the motor in degrees Celsius: from here on less current, and none.
    pub motor_c: [f32; 2],
    /// The same of the power stage.
    pub stage_c: [f32; 2],
    /// Bus voltage in volts under which there is none and from which on there is all current.
    pub low_v: [f32; 2],
    /// Bus voltage in volts from which on the windings burn what comes back, and at which all of it.
    pub burn_v: [f32; 2],
    /// Bus voltage in volts at which braking ends on the shorted windings, whatever is asked.
    pub high_v: f32,
    /// Sum of the phases' currents in amperes that is not to be believed, and for how many periods.
    pub sum_a: f32,
    /// See [`Self::sum_a`].
    pub sum_periods: u16,
    /// Periods in a row in which the rotor's counts repeat. A living sensor's flicker: with noise of 0.9 counts
    /// they repeat three times in ten, 36 times in a row once in 10^19.
    pub stuck_periods: u16,
    /// Volts that neither resistance nor inductance nor magnets explain, this share of the magnets' on top.
    pub beside_v: f32,
    /// See [`Self::beside_v`].
    pub beside: f32,
    /// Periods of it.
    pub beside_periods: u16,
    /// Amperes by which a current does not follow, and for how many periods.
    pub unfollowed_a: f32,
    /// See [`Self::unfollowed_a`].
    pub unfollowed_periods: u16,
    /// Speed in rad/s, and so much beyond the one that is asked for, at which a current of [`Self::runaway_a`] should
    /// brake.
    pub runaway: f32,
    /// In amperes: more torque than any load has.
    pub runaway_a: f32,
    /// Periods in which it becomes no slower.
    pub runaway_periods: u16,
    /// The opening's ends in millimetres: a little beyond closed, for flexures that give way, and open.
    pub ends_mm: [f32; 2],
    /// Speed of the fingers in mm/s while the opening is not known.
    pub homing_mm_s: f32,
}

impl Limits {
    /// What the gripper runs with.
    pub const GRIPPER: Self = Self {
        rated_a: (params::RATED_TORQUE.value / params::TORQUE_CONSTANT.value) as f32,
        peak_a: (params::PEAK_TORQUE.value / params::TORQUE_CONSTANT.value) as f32,
        peak_s: params::PEAK_TIME.value as f32,
        trip_a: params::CURRENT_TRIP.value as f32,
        power_w: params::POWER_GREATEST.value as f32,
        speed: (1.1 * params::RATED_SPEED.value) as f32,
        trip_speed: (1.5 * params::RATED_SPEED.value) as f32,
        motor_c: [80.0, params::MOTOR_HOT.value as f32],
        stage_c: [90.0, params::STAGE_HOT.value as f32],
        low_v: [16.0, 19.0],
        burn_v: [26.5, 28.5],
        high_v: params::BUS_GREATEST.value as f32,
        sum_a: 0.8,
        sum_periods: 10,
        stuck_periods: 36,
        beside_v: 2.5,
        beside: 0.25,
        beside_periods: 20,
        unfollowed_a: 1.5,
        unfollowed_periods: 90,
        runaway: 20.0,
        runaway_a: 5.0,
        runaway_periods: 36,
        ends_mm: [-2.0, params::STROKE.value as f32],
        homing_mm_s: 5.0,
    };
}

/// The windings' heat above what they bear for ever: how much of the peak's time is used up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Heat {
    /// Square amperes times seconds.
    used: f32,
}

impl Heat {
    /// Share of the heat from which on the current falls to the rated one.
    const FALLS: f32 = 0.8;

    /// Adds the heat of some time with a current, given as the square of its amplitude.
    pub fn add(&mut self, limits: &Limits, squared_a: f32, seconds: f32) {
        let more = (squared_a - limits.rated_a * limits.rated_a) * seconds;
        self.used = within(self.used + more, 0.0, Self::room(limits));
    }

    /// The current in amperes that it leaves.
    pub fn allows_a(&self, limits: &Limits) -> f32 {
        let room = Self::room(limits);
        let falls = share(self.used, Self::FALLS * room, room);
        limits.peak_a - falls * (limits.peak_a - limits.rated_a)
    }

    fn room(limits: &Limits) -> f32 {
        (limits.peak_a * limits.peak_a - limits.rated_a * limits.rated_a) * limits.peak_s
    }
}

/// Temperatures in degrees Celsius; none where nothing measures it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Temperatures {
    /// Of the motor's windings.
    pub motor: Option<f32>,
    /// Of the power stage.
    pub stage: Option<f32>,
}

/// What is known where the bounds of the current are drawn.
#[derive(Clone, Copy, Debug)]
pub struct Around {
    /// Speed of the rotor in rad/s, closing positive.
    pub speed: f32,
    /// Bus voltage.
    pub bus_v: f32,
    /// What the windings have borne.
    pub heat: Heat,
    /// Temperatures.
    pub temperatures: Temperatures,
    /// Amperes for one rad/s beyond the bound of the speed.
    pub speed_gain: f32,
}

/// Bounds of the current along q.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bounds {
    /// The least, in amperes.
    pub low_a: f32,
    /// The greatest.
    pub high_a: f32,
    /// The greatest amplitude of both axes together.
    pub amplitude_a: f32,
    /// What draws them closer than the motor's peak.
    pub reasons: Active,
    /// Motor or power stage is too hot for any current.
    pub is_hot: bool,
}

impl Bounds {
    /// Draws them.
    pub fn draw(settings: &Settings, around: &Around) -> Self {
        let limits = &settings.limits;
        let mut reasons = Active::default();
        let by_heat = around.heat.allows_a(limits);
        reasons.set(Limit::Heat, by_heat < limits.peak_a);
        let cool = coolness(limits, around.temperatures);
        reasons.set(Limit::Temperature, cool < 1.0);
        let amplitude_a = lesser(by_heat, cool * limits.peak_a);
        let drive = Self::drive_a(settings, around, amplitude_a, &mut reasons);
        // Against the motion it brakes; what drives it on is bounded more.
        let (mut low_a, mut high_a) = match around.speed >= 0.0 {
            true => (-amplitude_a, drive),
            false => (-drive, amplitude_a),
        };
        let faster = around.speed_gain * (limits.speed - around.speed);
        let slower = -around.speed_gain * (limits.speed + around.speed);
        high_a = greater(lesser(high_a, faster), -amplitude_a);
        low_a = lesser(greater(low_a, slower), amplitude_a);
        let near = around.speed_gain * (limits.speed - around.speed.abs());
        reasons.set(Limit::Speed, near < amplitude_a);
        Self {
            low_a,
            high_a,
            amplitude_a,
            reasons,
            is_hot: cool <= 0.0,
        }
    }

    /// Greatest current that drives the rotor on: the supply's power, of which the copper of the whole
    /// amplitude is taken off first, and its voltage.
    fn drive_a(
        settings: &Settings,
        around: &Around,
        amplitude_a: f32,
        reasons: &mut Active,
    ) -> f32 {
        let (limits, machine) = (&settings.limits, &settings.machine);
        let [none, all] = limits.low_v;
        let bus = share(around.bus_v, none, all);
        reasons.set(Limit::BusLow, bus < 1.0);
        let for_each =
            machine.torque_nm_a * around.speed.abs() + 1.5 * machine.resistance_ohm * amplitude_a;
        let by_power = limits.power_w / for_each;
        reasons.set(Limit::Power, by_power < amplitude_a);
        lesser(by_power, bus * amplitude_a)
    }
}

/// Share of the current that the warmer of motor and power stage leaves; none of it is too hot. What is no number is too warm.
fn coolness(limits: &Limits, temperatures: Temperatures) -> f32 {
    let left = |told: Option<f32>, [falls, none]: [f32; 2]| match told {
        None => 1.0,
        Some(degrees) if degrees < none => share(degrees, none, falls),
        Some(_) => 0.0,
    };
    lesser(
        left(temperatures.motor, limits.motor_c),
        left(temperatures.stage, limits.stage_c),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::screw::Screw;

    /// Nothing that draws a bound closer.
    fn free() -> Around {
        Around {
            speed: 0.0,
            bus_v: 24.0,
            heat: Heat::default(),
            temperatures: Temperatures::default(),
            speed_gain: 0.565,
        }
    }

    fn drawn(around: &Around) -> Bounds {
        Bounds::draw(&Settings::assumed(Screw::A), around)
    }

    fn has(bounds: &Bounds, only: Limit) -> bool {
        let mut expected = Active::default();
        expected.set(only, true);
        bounds.reasons == expected
    }

    #[test]
    fn nothing_else_leaves_the_peak() {
        let bounds = drawn(&free());
        assert_eq!(
            [bounds.low_a, bounds.high_a, bounds.amplitude_a],
            [-9.6, 9.6, 9.6]
        );
        assert_eq!(bounds.reasons, Active::default());
    }

    #[test]
    fn peak_current_falls_to_the_rated_one_after_its_seconds_and_comes_back_in_rest() {
        let limits = Limits::GRIPPER;
        let mut heat = Heat::default();
        // Four fifths of three seconds at the peak, then the fall.
        heat.add(&limits, limits.peak_a * limits.peak_a, 2.39);
        assert_eq!(heat.allows_a(&limits), limits.peak_a);
        for _ in 0..8000 {
            let current = heat.allows_a(&limits);
            heat.add(&limits, current * current, 0.001);
        }
        let bounds = drawn(&Around { heat, ..free() });
        assert!(has(&bounds, Limit::Heat) && bounds.high_a < 5.82);
        heat.add(&limits, limits.rated_a * limits.rated_a, 100.0);
        assert!(heat.allows_a(&limits) < 5.82);
        heat.add(&limits, 0.0, 10.0);
        assert_eq!(heat.allows_a(&limits), limits.peak_a);
    }

    #[test]
    fn half_way_through_the_fall_half_the_surplus_is_left() {
        let limits = Limits::GRIPPER;
        let mut heat = Heat::default();
        // Nine tenths of three seconds at 9.6 A: (9.6 + 5.8) / 2.
        heat.add(&limits, 9.6 * 9.6, 2.7);
        assert!((heat.allows_a(&limits) - 7.7).abs() < 1e-3);
        // As much heat by 7 A takes (92.16 - 33.64) / (49 - 33.64) times as long.
        let mut heat = Heat::default();
        heat.add(&limits, 7.0 * 7.0, 2.7 * 3.809_9);
        assert!((heat.allows_a(&limits) - 7.7).abs() < 1e-3);
    }

    #[test]
    fn a_warm_motor_or_stage_leaves_less_and_what_is_no_temperature_leaves_nothing() {
        let at = |motor, stage| {
            let temperatures = Temperatures { motor, stage };
            let bounds = drawn(&Around {
                temperatures,
                ..free()
            });
            (bounds.high_a, has(&bounds, Limit::Temperature))
        };
        assert_eq!(at(Some(80.0), Some(90.0)), (9.6, false));
        let (half, told) = at(Some(90.0), Some(20.0));
        assert!((half - 4.8).abs() < 1e-4 && told);
        let (half, _) = at(None, Some(100.0));
        assert!((half - 4.8).abs() < 1e-4);
        assert_eq!(at(Some(100.0), None).0, 0.0);
        let hot = |degrees| {
            let temperatures = Temperatures {
                motor: Some(degrees),
                stage: None,
            };
            drawn(&Around {
                temperatures,
                ..free()
            })
            .is_hot
        };
        assert_eq!([99.9, 100.0, f32::NAN].map(hot), [false, true, true]);
        assert_eq!(at(Some(f32::NAN), None).0, 0.0);
    }

    #[test]
    fn beyond_the_speed_the_motor_brakes_and_does_not_drive() {
        let limit = Limits::GRIPPER.speed;
        let fast = |speed| drawn(&Around { speed, ..free() });
        let bounds = fast(limit);
        assert!(bounds.high_a.abs() < 1e-3 && bounds.low_a == -9.6);
        assert!(fast(limit + 4.0).high_a < -1.9);
        let bounds = fast(-limit - 4.0);
        assert!(bounds.low_a > 1.9 && bounds.high_a == 9.6);
        assert!(bounds.reasons.has(Limit::Speed));
    }

    #[test]
    fn the_speed_s_bound_is_told_from_where_it_takes_current() {
        // 125.4 rad/s less 9.6 A over 0.565 A s: 108.4 rad/s.
        let told = |speed| drawn(&Around { speed, ..free() }).reasons.has(Limit::Speed);
        assert_eq!(
            [108.0, 109.0, -108.0, -109.0].map(told),
            [false, true, false, true]
        );
    }

    #[test]
    fn the_supply_s_power_leaves_what_copper_and_motion_take() {
        // 150 W over 0.1 N m/A times 100 rad/s and 1.5 times 0.4 ohm times 9.6 A.
        let bounds = drawn(&Around {
            speed: 100.0,
            ..free()
        });
        assert!((bounds.high_a - 9.517_8).abs() < 1e-3, "{}", bounds.high_a);
        assert!(has(&bounds, Limit::Power));
    }

    #[test]
    fn closed_fingers_may_go_on_for_two_millimetres() {
        assert_eq!(Limits::GRIPPER.ends_mm, [-2.0, 80.0]);
    }

    #[test]
    fn the_supply_gives_its_power_and_no_more() {
        let machine = Settings::assumed(Screw::A).machine;
        for speed in [0.0_f32, 57.0, 114.0, -114.0] {
            let bounds = drawn(&Around { speed, ..free() });
            let amperes = if speed < 0.0 {
                -bounds.low_a
            } else {
                bounds.high_a
            };
            let power = machine.torque_nm_a * amperes * speed.abs()
                + 1.5 * machine.resistance_ohm * amperes * amperes;
            assert!(power <= Limits::GRIPPER.power_w, "{speed}: {power} W");
            // 350 N at full speed is asked for.
            assert!(amperes > 5.8, "{speed}: {amperes} A");
        }
    }

    #[test]
    fn a_low_bus_drives_less_and_brakes_as_before() {
        let low = drawn(&Around {
            bus_v: 17.5,
            speed: 1.0,
            ..free()
        });
        assert!((low.high_a - 4.8).abs() < 1e-4 && low.low_a == -9.6);
        assert!(has(&low, Limit::BusLow));
        let none = drawn(&Around {
            bus_v: 15.0,
            ..free()
        });
        assert_eq!(none.high_a, 0.0);
    }

    #[test]
    fn the_codes_of_limits_are_no_faults() {
        assert_eq!(Limit::Current as u8, 1);
        assert_eq!(Limit::NotHomed as u8, 10);
        let mut active = Active::default();
        active.set(Limit::EndStop, true);
        active.set(Limit::Heat, true);
        active.set(Limit::Heat, false);
        assert_eq!(active, Active(1 << 9));
        assert_eq!(Active(0b110).and(Active(0b011)), Active(0b111));
    }
}

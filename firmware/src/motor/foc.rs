//! Field-oriented control: Clarke and Park transforms, PI current controllers in rotor axes, space-vector modulation
//! with dead-time compensation.
//!
//! The transforms preserve amplitudes; power is therefore 1.5 times the product of voltage and current. The current
//! controllers cancel the pole of the windings, which leaves an integrator and a delay of one period; the coupling of
//! the axes and the induced voltage are fed forward.

use core::f32::consts::TAU;

use crate::config::constants;
use crate::math::{Direction, greater, inverse_sqrt, lesser, within};
use crate::motor::settings::MotorParameters;
use crate::motor::timing::PERIOD_S;

const SQRT_3: f32 = 1.732_050_8;

/// Modulation limit: maximum duty cycle, and maximum phase-to-phase voltage relative to the bus. In the rest of the
/// period all low sides are on and the currents are sampled.
pub const MODULATION: f32 = constants::MODULATION.value as f32;
/// Dead time as a fraction of the period.
const DEAD: f32 = (constants::DEAD_TIME.value * 1e-9 * constants::PWM_RATE.value * 1e3) as f32;
/// Current in amperes below which the dead-time compensation falls linearly, because ripple and noise hide the sign.
const SIGN_A: f32 = 0.4;

/// Stator axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AlphaBeta {
    /// Along phase U.
    pub alpha: f32,
    /// A quarter of an electrical turn ahead.
    pub beta: f32,
}

/// Rotor axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Dq {
    /// Direct axis, along the magnets: no torque.
    pub d: f32,
    /// Quadrature axis: torque, closing positive.
    pub q: f32,
}

impl AlphaBeta {
    /// Clarke transform of the phases U, V, W; their common mode cancels.
    pub fn from_phases([u, v, w]: [f32; 3]) -> Self {
        Self { alpha: (2.0 * u - v - w) * (1.0 / 3.0), beta: (v - w) * (1.0 / SQRT_3) }
    }

    /// Inverse Clarke transform; the phases sum to zero.
    pub fn phases(self) -> [f32; 3] {
        let (half, side) = (0.5 * self.alpha, 0.5 * SQRT_3 * self.beta);
        [self.alpha, side - half, -side - half]
    }

    /// Park transform at an electrical angle.
    pub fn to_rotor(self, angle: Direction) -> Dq {
        Dq {
            d: self.alpha * angle.cos + self.beta * angle.sin,
            q: self.beta * angle.cos - self.alpha * angle.sin,
        }
    }
}

impl Dq {
    /// Inverse Park transform.
    pub fn to_stator(self, angle: Direction) -> AlphaBeta {
        AlphaBeta {
            alpha: self.d * angle.cos - self.q * angle.sin,
            beta: self.d * angle.sin + self.q * angle.cos,
        }
    }

    /// Square of the amplitude.
    pub fn squared(self) -> f32 {
        self.d * self.d + self.q * self.q
    }

    /// Electrical power in watts of this voltage with a current.
    pub fn power_w(self, current: Self) -> f32 {
        1.5 * (self.d * current.d + self.q * current.q)
    }
}

/// Maximum phase amplitude in volts available in every direction: the circle inside the voltage hexagon.
pub fn max_v(bus_v: f32) -> f32 {
    const INVERSE_SQRT_3: f32 = 0.577_350_3;
    MODULATION * INVERSE_SQRT_3 * bus_v
}

/// Space-vector modulation: duty cycles of U, V, W for a voltage in volts. Voltages outside the hexagon give duty
/// cycles out of range, which [`compensate_dead_time`] clamps; zero bus voltage gives NaN.
pub fn duties(voltage: AlphaBeta, bus_v: f32) -> [f32; 3] {
    let [u, v, w] = voltage.phases();
    let middle = 0.5 * (greater(u, greater(v, w)) + lesser(u, lesser(v, w)));
    let scale = 1.0 / bus_v;
    let duty = |phase| 0.5 * MODULATION + scale * (phase - middle);
    [duty(u), duty(v), duty(w)]
}

/// Compensates the dead time, during which the sign of the current determines the voltage, and clamps the duty
/// cycles.
pub fn compensate_dead_time(duties: [f32; 3], currents: [f32; 3]) -> [f32; 3] {
    let [a, b, c] = duties;
    let [i, j, k] = currents;
    let compensated = |duty: f32, current: f32| {
        let sign = within(current * (1.0 / SIGN_A), -1.0, 1.0);
        within(duty + DEAD * sign, 0.0, MODULATION)
    };
    [compensated(a, i), compensated(b, j), compensated(c, k)]
}

/// Coefficients of a PI controller for one sampling period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PiGains {
    /// Output per unit of error.
    pub proportional: f32,
    /// Increment of the integrator per unit of error and period.
    pub integral: f32,
    /// Anti-windup: decrement of the integrator per unit of saturation and period.
    pub back: f32,
}

impl PiGains {
    /// From proportional gain, corner of the integrator in rad/s, and period in seconds. The anti-windup has the
    /// time constant of the corner.
    pub const fn of(proportional: f32, corner: f32, period_s: f32) -> Self {
        Self { proportional, integral: proportional * corner * period_s, back: corner * period_s }
    }
}

/// PI controller with anti-windup by back-calculation, in two steps around the saturation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PiController {
    /// Integrator, in the unit of the output.
    pub sum: f32,
}

impl PiController {
    /// Unsaturated output.
    pub fn output(&self, gains: &PiGains, error: f32) -> f32 {
        gains.proportional * error + self.sum
    }

    /// Updates the integrator; `excess` is the saturated output minus the unsaturated one.
    pub fn integrate(&mut self, gains: &PiGains, error: f32, excess: f32) {
        self.sum += gains.integral * error + gains.back * excess;
    }
}

/// Model of the windings for the current controllers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Windings {
    gains: PiGains,
    inductance_h: f32,
    flux_wb: f32,
}

impl Windings {
    /// From resistance, inductance and flux; the crossover is [`constants::CURRENT_BANDWIDTH`].
    pub fn of(machine: &MotorParameters) -> Self {
        let crossover = TAU * constants::CURRENT_BANDWIDTH.value as f32;
        let corner = machine.resistance_ohm / machine.inductance_h;
        Self {
            gains: PiGains::of(crossover * machine.inductance_h, corner, PERIOD_S),
            inductance_h: machine.inductance_h,
            flux_wb: machine.flux_wb(),
        }
    }
}

/// Current controllers of both axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CurrentController {
    d: PiController,
    q: PiController,
}

/// Output of [`CurrentController`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VoltageOutput {
    /// Volts.
    pub voltage: Dq,
    /// The voltage was limited to the circle of [`max_v`].
    pub is_limited: bool,
}

impl CurrentController {
    /// Voltage for the next period. `speed` is electrical, in rad/s.
    pub fn update(
        &mut self,
        windings: &Windings,
        setpoint: Dq,
        measured: Dq,
        speed: f32,
        max_v: f32,
    ) -> VoltageOutput {
        let gains = &windings.gains;
        let error = Dq { d: setpoint.d - measured.d, q: setpoint.q - measured.q };
        let coupling = speed * windings.inductance_h;
        let unlimited = Dq {
            d: self.d.output(gains, error.d) - coupling * measured.q,
            q: self.q.output(gains, error.q) + coupling * measured.d + speed * windings.flux_wb,
        };
        let squared = unlimited.squared();
        let is_limited = squared > max_v * max_v;
        let scale = if is_limited { max_v * inverse_sqrt(squared) } else { 1.0 };
        let voltage = Dq { d: scale * unlimited.d, q: scale * unlimited.q };
        self.d.integrate(gains, error.d, voltage.d - unlimited.d);
        self.q.integrate(gains, error.q, voltage.q - unlimited.q);
        VoltageOutput { voltage, is_limited }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// An exact direction, independent of the library's sine.
    fn direction(radians: f64) -> Direction {
        Direction { sin: radians.sin() as f32, cos: radians.cos() as f32 }
    }

    #[test]
    fn transforms_of_known_currents() {
        // One ampere into U, back through V and W.
        let one = AlphaBeta::from_phases([1.0, -0.5, -0.5]);
        assert_eq!(one, AlphaBeta { alpha: 1.0, beta: 0.0 });
        // Into V, back through W.
        let two = AlphaBeta::from_phases([0.0, 3.0, -3.0]);
        assert!(two.alpha == 0.0 && (two.beta - 3.464_101_6).abs() < 1e-6, "{two:?}");
        // The rotor a quarter turn ahead of U: a current along U is against the torque.
        let seen = one.to_rotor(Direction { sin: 1.0, cos: 0.0 });
        assert_eq!(seen, Dq { d: 0.0, q: -1.0 });
        // The rotor at 30 degrees.
        let seen = one.to_rotor(direction(std::f64::consts::FRAC_PI_6));
        assert!((seen.d - 0.866_025_4).abs() < 1e-6 && (seen.q + 0.5).abs() < 1e-6);
    }

    #[test]
    fn common_mode_cancels() {
        let with = AlphaBeta::from_phases([3.0, 1.5, 1.5]);
        assert_eq!(with, AlphaBeta { alpha: 1.0, beta: 0.0 });
    }

    proptest! {
        #[test]
        fn park_transform_preserves_power(
            v in prop::array::uniform2(-14_f32..14.0),
            i in prop::array::uniform2(-10_f32..10.0),
            angle in 0_f64..6.3,
        ) {
            let volts = AlphaBeta { alpha: v[0], beta: v[1] };
            let amperes = AlphaBeta { alpha: i[0], beta: i[1] };
            let sum: f32 = volts.phases().iter().zip(amperes.phases()).map(|(v, i)| v * i).sum();
            let angle = direction(angle);
            let turning = volts.to_rotor(angle).power_w(amperes.to_rotor(angle));
            prop_assert!((sum - turning).abs() < 1e-3, "{} {}", sum, turning);
        }

        #[test]
        fn transforms_round_trip(
            v in prop::array::uniform2(-14_f32..14.0),
            angle in 0_f64..6.3,
        ) {
            let volts = AlphaBeta { alpha: v[0], beta: v[1] };
            let back = volts.to_rotor(direction(angle)).to_stator(direction(angle));
            let phases = AlphaBeta::from_phases(back.phases());
            prop_assert!((phases.alpha - v[0]).abs() + (phases.beta - v[1]).abs() < 1e-4);
        }
    }

    #[test]
    fn duty_cycles_of_known_voltages() {
        // Zero voltage.
        let none = duties(AlphaBeta::default(), 24.0);
        assert_eq!(none, [0.465; 3]);
        // 12 V along U: phases 12, -6, -6; their middle 3; (9, -9, -9) of 24.
        let along = duties(AlphaBeta { alpha: 12.0, beta: 0.0 }, 24.0);
        for (duty, expected) in along.into_iter().zip([0.84, 0.09, 0.09]) {
            assert!((duty - expected).abs() < 1e-6, "{along:?}");
        }
        // 10 V along beta: phases 0, 8.66, -8.66; their middle 0.
        let across = duties(AlphaBeta { alpha: 0.0, beta: 10.0 }, 24.0);
        for (duty, expected) in across.into_iter().zip([0.465, 0.825_843_9, 0.104_156_1]) {
            assert!((duty - expected).abs() < 1e-6, "{across:?}");
        }
    }

    #[test]
    fn dead_time_compensation_is_one_percent_of_the_period() {
        let compensated = compensate_dead_time([0.5, 0.5, 0.5], [3.0, -3.0, 0.2]);
        for (duty, expected) in compensated.into_iter().zip([0.51, 0.49, 0.505]) {
            assert!((duty - expected).abs() < 1e-6, "{compensated:?}");
        }
    }

    #[test]
    fn zero_bus_voltage_or_nan_gives_nan() {
        let volts = AlphaBeta { alpha: 1.0, beta: f32::NAN };
        assert!(duties(volts, 24.0).iter().any(|duty| duty.is_nan()));
        assert!(duties(AlphaBeta::default(), 0.0).iter().any(|duty| duty.is_nan()));
    }

    proptest! {
        #[test]
        fn modulation_gives_the_requested_line_voltages(
            share in 0_f32..1.0, angle in 0_f64..6.3, bus in 10_f32..40.0,
        ) {
            let amplitude = 0.999_99 * share * max_v(bus);
            let requested = AlphaBeta { alpha: amplitude * angle.cos() as f32, beta: amplitude * angle.sin() as f32 };
            let duty = duties(requested, bus);
            let [u, v, w] = requested.phases();
            let lines = [u - v, v - w, w - u];
            let modulated = [duty[0] - duty[1], duty[1] - duty[2], duty[2] - duty[0]];
            for (line, modulated) in lines.into_iter().zip(modulated) {
                prop_assert!((line - modulated * bus).abs() < 2e-5 * bus);
            }
        }

        #[test]
        fn duty_cycles_stay_in_range_for_any_voltage(
            alpha in -1e9_f32..1e9, beta in -1e9_f32..1e9, bus in 0.1_f32..60.0,
            currents in prop::array::uniform3(-30_f32..30.0),
        ) {
            let clamped = compensate_dead_time(duties(AlphaBeta { alpha, beta }, bus), currents);
            for duty in clamped {
                prop_assert!((0.0..=MODULATION).contains(&duty), "{}", duty);
            }
        }
    }

    #[test]
    fn constant_error_integrates_to_a_ramp() {
        let gains = PiGains::of(2.0, 100.0, 0.001);
        let mut pi = PiController::default();
        for period in 0..50 {
            let output = pi.output(&gains, 3.0);
            let expected = 2.0 * 3.0 + period as f32 * 2.0 * 100.0 * 0.001 * 3.0;
            assert!((output - expected).abs() < 1e-4, "{period}: {output}");
            pi.integrate(&gains, 3.0, 0.0);
        }
    }

    #[test]
    fn saturated_integrator_settles_and_recovers_at_once() {
        let gains = PiGains::of(2.0, 100.0, 0.001);
        let mut pi = PiController::default();
        let limited = |output: f32| output.min(10.0);
        for _ in 0..1000 {
            let output = pi.output(&gains, 3.0);
            pi.integrate(&gains, 3.0, limited(output) - output);
        }
        // integral * error = back * excess: 0.6 of 0.1 is 6 beyond the limit.
        assert!((pi.output(&gains, 3.0) - 16.0).abs() < 1e-3);
        assert!(pi.output(&gains, -0.1) < 10.0);
    }
}

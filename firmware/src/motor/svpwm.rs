//! A voltage as duties of three half bridges: space vectors by the middle of the three phases, the dead time
//! given back.

use super::number::{greater, lesser, within};
use super::transform::AlphaBeta;
use crate::params;

/// Greatest share of the period with the high side on, and so the greatest voltage between two phases in
/// shares of the bus: what is left of the period, all low sides on, is for the measurement of the currents.
pub const MODULATION: f32 = params::MODULATION.value as f32;
/// Share of a period that the dead time takes from the phase into which current flows.
const DEAD: f32 = (params::DEAD_TIME.value * 1e-9 * params::PWM_RATE.value * 1e3) as f32;
/// Currents below this, in amperes, are too near zero to tell their sign in a period with ripple and noise:
/// what is given back falls with them.
const SIGN_A: f32 = 0.4;

/// The greatest amplitude of a phase in volts that can be had in every direction: the circle inside the
/// hexagon.
pub fn greatest_v(bus_v: f32) -> f32 {
    const INVERSE_SQRT_3: f32 = 0.577_350_3;
    MODULATION * INVERSE_SQRT_3 * bus_v
}

/// Duties of U, V, W for a voltage in volts. What lies outside the hexagon leaves their range, and
/// [`with_dead_time`] cuts it there. A bus without voltage gives no numbers.
pub fn duties(voltage: AlphaBeta, bus_v: f32) -> [f32; 3] {
    let [u, v, w] = voltage.phases();
    let middle = 0.5 * (greater(u, greater(v, w)) + lesser(u, lesser(v, w)));
    let scale = 1.0 / bus_v;
    let duty = |phase| 0.5 * MODULATION + scale * (phase - middle);
    [duty(u), duty(v), duty(w)]
}

/// Gives back what the dead time takes: while both switches of a half bridge are off, its current chooses the
/// rail.
pub fn with_dead_time(duties: [f32; 3], currents: [f32; 3]) -> [f32; 3] {
    let [a, b, c] = duties;
    let [i, j, k] = currents;
    let given = |duty: f32, current: f32| {
        let sign = within(current * (1.0 / SIGN_A), -1.0, 1.0);
        within(duty + DEAD * sign, 0.0, MODULATION)
    };
    [given(a, i), given(b, j), given(c, k)]
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn known_voltages_have_known_duties() {
        // Nothing: all alike.
        let none = duties(AlphaBeta::default(), 24.0);
        assert_eq!(none, [0.475; 3]);
        // 12 V along U: phases 12, -6, -6; their middle 3; (9, -9, -9) of 24.
        let along = duties(
            AlphaBeta {
                alpha: 12.0,
                beta: 0.0,
            },
            24.0,
        );
        for (duty, expected) in along.into_iter().zip([0.85, 0.1, 0.1]) {
            assert!((duty - expected).abs() < 1e-6, "{along:?}");
        }
        // 10 V along beta: phases 0, 8.66, -8.66; their middle 0.
        let across = duties(
            AlphaBeta {
                alpha: 0.0,
                beta: 10.0,
            },
            24.0,
        );
        for (duty, expected) in across.into_iter().zip([0.475, 0.835_843_9, 0.114_156_1]) {
            assert!((duty - expected).abs() < 1e-6, "{across:?}");
        }
    }

    #[test]
    fn the_dead_time_of_500_ns_at_20_khz_is_a_hundredth_of_the_period() {
        let given = with_dead_time([0.5, 0.5, 0.5], [3.0, -3.0, 0.2]);
        for (duty, expected) in given.into_iter().zip([0.51, 0.49, 0.505]) {
            assert!((duty - expected).abs() < 1e-6, "{given:?}");
        }
    }

    #[test]
    fn a_bus_without_voltage_is_not_hidden() {
        let volts = AlphaBeta {
            alpha: 1.0,
            beta: f32::NAN,
        };
        assert!(duties(volts, 24.0).iter().any(|duty| duty.is_nan()));
        assert!(
            duties(AlphaBeta::default(), 0.0)
                .iter()
                .any(|duty| duty.is_nan())
        );
    }

    proptest! {
        #[test]
        fn inside_the_circle_the_lines_have_what_was_asked(
            share in 0_f32..1.0, angle in 0_f64..6.3, bus in 10_f32..40.0,
        ) {
            let size = 0.999_99 * share * greatest_v(bus);
            let asked = AlphaBeta { alpha: size * angle.cos() as f32, beta: size * angle.sin() as f32 };
            let told = duties(asked, bus);
            let [u, v, w] = asked.phases();
            let lines = [u - v, v - w, w - u];
            let had = [told[0] - told[1], told[1] - told[2], told[2] - told[0]];
            for (line, had) in lines.into_iter().zip(had) {
                prop_assert!((line - had * bus).abs() < 2e-5 * bus);
            }
        }

        #[test]
        fn duties_stay_in_their_range_whatever_is_asked(
            alpha in -1e9_f32..1e9, beta in -1e9_f32..1e9, bus in 0.1_f32..60.0,
            currents in prop::array::uniform3(-30_f32..30.0),
        ) {
            let told = with_dead_time(duties(AlphaBeta { alpha, beta }, bus), currents);
            for duty in told {
                prop_assert!((0.0..=MODULATION).contains(&duty), "{}", duty);
            }
        }
    }
}

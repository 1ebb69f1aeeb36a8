//! Braking gives power back, and the supply takes none: above a bus voltage the windings burn it, by a current
//! that makes no torque; what even that cannot burn is not braked.

use super::number::{greater, share, sqrt, within};
use super::settings::Settings;
use super::transform::Dq;

/// More than computed is burnt at the upper voltage: so much of the resistance may be missing.
const MORE: f32 = 1.3;

/// The currents for a current along q that was asked for, and whether they were changed.
pub fn burning(
    settings: &Settings,
    q: f32,
    speed: f32,
    bus_v: f32,
    amplitude_a: f32,
) -> (Dq, bool) {
    let [from, all] = settings.limits.burn_v;
    let burns = share(bus_v, from, all);
    let unchanged = Dq { d: 0.0, q };
    if q * speed >= 0.0 || burns <= 0.0 {
        return (unchanged, false);
    }
    // Copper burns 1.5 R i^2, braking gives K q speed.
    let copper = 1.5 * settings.machine.resistance_ohm;
    let gives = settings.machine.torque_nm_a * speed.abs();
    let amplitude = amplitude_a * amplitude_a;
    let most = copper * amplitude / (MORE * gives);
    let bound = most + (1.0 - burns) * greater(amplitude_a - most, 0.0);
    let q = within(q, -bound, bound);
    let needed = within(MORE * gives * q.abs() / copper, 0.0, amplitude);
    let d = -sqrt(burns * (needed - q * q));
    (Dq { d, q }, d != 0.0 || q != unchanged.q)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::screw::Screw;

    /// Power that comes back, in watts, for braking at a speed with what is decided.
    fn back_w(settings: &Settings, current: Dq, speed: f32) -> f32 {
        let machine = &settings.machine;
        -machine.torque_nm_a * current.q * speed - 1.5 * machine.resistance_ohm * current.squared()
    }

    #[test]
    fn at_the_upper_voltage_no_power_comes_back_and_the_motor_still_brakes() {
        let settings = Settings::assumed(Screw::A);
        for speed in [10.0_f32, 57.0, 114.0, 170.0, -114.0] {
            for q in [0.5_f32, 3.0, 5.8, 9.6] {
                let (current, _) = burning(&settings, -q * speed.signum(), speed, 28.5, 9.6);
                assert!(
                    back_w(&settings, current, speed) <= 1e-3,
                    "{speed} {q} {current:?}"
                );
                assert!(current.squared() <= 9.6 * 9.6 * 1.001);
                // 55.3 W of copper at 9.6 A against 1.3 * 0.1 N m/A * speed.
                let least = (55.296 / (0.13 * speed.abs())).min(q);
                assert!(current.q.abs() >= least * 0.999, "{speed} {q} {current:?}");
            }
        }
    }

    #[test]
    fn below_the_lower_voltage_and_while_driving_nothing_changes() {
        let settings = Settings::assumed(Screw::A);
        let same = |q| (Dq { d: 0.0, q }, false);
        assert_eq!(burning(&settings, -9.6, 114.0, 26.5, 9.6), same(-9.6));
        assert_eq!(burning(&settings, 9.6, 114.0, 40.0, 9.6), same(9.6));
        assert_eq!(burning(&settings, -9.6, 0.0, 40.0, 9.6), same(-9.6));
    }
}

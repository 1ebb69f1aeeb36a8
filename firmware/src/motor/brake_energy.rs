//! Dissipation of braking energy. The supply takes no energy back: above a bus voltage the windings dissipate it by a
//! d current, which makes no torque; braking is reduced where that is not enough.

use crate::math::{greater, share, sqrt, within};
use crate::motor::foc::Dq;
use crate::motor::settings::Settings;

/// Safety factor on the dissipation at the upper voltage, for a resistance below its nominal value.
const MARGIN: f32 = 1.3;

/// Current set-points for a q current at a rotor speed and bus voltage, and whether they differ from it.
pub fn dissipate(
    settings: &Settings,
    q: f32,
    speed: f32,
    bus_v: f32,
    amplitude_a: f32,
) -> (Dq, bool) {
    let [begin_v, full_v] = settings.limits.dissipation_v;
    let dissipated = share(bus_v, begin_v, full_v);
    let unchanged = Dq { d: 0.0, q };
    if q * speed >= 0.0 || dissipated <= 0.0 {
        return (unchanged, false);
    }
    // Copper losses are 1.5 R i^2, braking power is K q speed.
    let copper = 1.5 * settings.machine.resistance_ohm;
    let watts_per_a = settings.machine.torque_nm_a * speed.abs();
    let amplitude = amplitude_a * amplitude_a;
    let max_a = copper * amplitude / (MARGIN * watts_per_a);
    let bound = max_a + (1.0 - dissipated) * greater(amplitude_a - max_a, 0.0);
    let q = within(q, -bound, bound);
    let needed = within(MARGIN * watts_per_a * q.abs() / copper, 0.0, amplitude);
    let d = -sqrt(dissipated * (needed - q * q));
    (Dq { d, q }, d != 0.0 || q != unchanged.q)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::screw::Screw;

    /// Power returned to the bus in watts.
    fn returned_w(settings: &Settings, current: Dq, speed: f32) -> f32 {
        let machine = &settings.machine;
        -machine.torque_nm_a * current.q * speed - 1.5 * machine.resistance_ohm * current.squared()
    }

    #[test]
    fn full_dissipation_returns_no_power_and_still_brakes() {
        let settings = Settings::assumed(Screw::A);
        for speed in [10.0_f32, 57.0, 114.0, 170.0, -114.0] {
            for q in [0.5_f32, 3.0, 5.8, 9.6] {
                let (current, _) = dissipate(&settings, -q * speed.signum(), speed, 28.5, 9.6);
                assert!(returned_w(&settings, current, speed) <= 1e-3, "{speed} {q} {current:?}");
                assert!(current.squared() <= 9.6 * 9.6 * 1.001);
                // 55.3 W of copper at 9.6 A against 1.3 * 0.1 N m/A * speed.
                let min_a = (55.296 / (0.13 * speed.abs())).min(q);
                assert!(current.q.abs() >= min_a * 0.999, "{speed} {q} {current:?}");
            }
        }
    }

    #[test]
    fn low_voltage_or_driving_leaves_the_current_unchanged() {
        let settings = Settings::assumed(Screw::A);
        let same = |q| (Dq { d: 0.0, q }, false);
        assert_eq!(dissipate(&settings, -9.6, 114.0, 26.5, 9.6), same(-9.6));
        assert_eq!(dissipate(&settings, 9.6, 114.0, 40.0, 9.6), same(9.6));
        assert_eq!(dissipate(&settings, -9.6, 0.0, 40.0, 9.6), same(-9.6));
    }
}

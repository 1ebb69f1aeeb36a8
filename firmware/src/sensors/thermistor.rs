//! Thermistors (NTC) between the converter's input and ground, with a pull-up to its reference.

use crate::config::constants;
use crate::math::ln;

/// Full scale of the converter in counts.
const FULL_SCALE: f32 = 4095.0;
/// Counts at which the thermistor is shorted, or not connected.
const SHORTED: u16 = 40;
const OPEN: u16 = 4055;
/// Zero of the Celsius scale in kelvin.
const ZERO_K: f32 = 273.15;
const REFERENCE_K: f32 = ZERO_K + 25.0;

/// Temperature in degrees Celsius at a converter's counts of 12 bits; `None` if the thermistor is open or shorted. By the
/// two-parameter equation 1 / T = 1 / T25 + ln(R / R25) / B.
pub fn celsius(counts: u16) -> Option<f32> {
    const RATIO: f32 =
        (constants::THERMISTOR_PULL_UP.value / constants::THERMISTOR_RESISTANCE.value) as f32;
    const B_K: f32 = constants::THERMISTOR_B.value as f32;
    if !(SHORTED..=OPEN).contains(&counts) {
        return None;
    }
    let counts = f32::from(counts);
    let relative = RATIO * counts / (FULL_SCALE - counts);
    let inverse_k = 1.0 / REFERENCE_K + ln(relative) / B_K;
    Some(1.0 / inverse_k - ZERO_K)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn temperature_follows_the_two_parameter_equation() {
        // 10 kOhm, B = 3435 K, pull-up 10 kOhm; by hand from R = 10 kOhm exp(3435 (1/T - 1/298.15)).
        for (degrees, ohm) in
            [(-20.0, 77_522.5), (0.0, 28_704.3), (25.0, 10_000.0), (60.0, 2980.9), (100.0, 987.0)]
        {
            let counts = (4095.0 * ohm / (ohm + 10_000.0_f64)).round() as u16;
            let found = celsius(counts).unwrap();
            assert!((f64::from(found) - degrees).abs() < 0.1, "{degrees}: {found}");
        }
    }

    #[test]
    fn open_and_shorted_thermistors_have_no_temperature() {
        assert_eq!([0, 39, 4056, 4095].map(celsius), [None; 4]);
    }
}

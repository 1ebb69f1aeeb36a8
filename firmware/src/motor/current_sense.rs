//! Phase currents and bus voltage from converter counts, and measurement of the amplifiers' offsets.

use crate::config::constants;
use crate::motor::power_stage::MotorSamples;

/// Amperes per count.
const AMPERES: f32 = (constants::CURRENT_SCALE.value * 1e-3) as f32;
/// Volts per count.
const VOLTS: f32 = (constants::BUS_SCALE.value * 1e-3) as f32;
/// Nominal count at zero current.
const MIDDLE: f32 = 2048.0;
/// Maximum count of the converter.
const FULL: u16 = 4095;
/// Periods averaged for the offsets: 25.6 ms, and a twentieth of the noise of a sample.
const PERIODS: u32 = 512;
/// Maximum offset in counts: 0.8 A.
const MAX_OFFSET: f32 = 64.0;
/// Maximum standard deviation in counts, 0.2 A: above it a current flows or an amplifier is broken.
const MAX_SIGMA: f32 = 16.0;

/// Bus voltage in volts.
pub fn bus_v(samples: &MotorSamples) -> f32 {
    f32::from(samples.bus) * VOLTS
}

/// Whether a phase current is at the end of its measuring range.
pub fn is_saturated(samples: &MotorSamples) -> bool {
    let [u, v, w] = samples.phases;
    let is_saturated = |count: u16| count == 0 || count >= FULL;
    is_saturated(u) || is_saturated(v) || is_saturated(w)
}

/// Counts at zero current of each phase.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurrentOffsets([f32; 3]);

impl CurrentOffsets {
    /// Before the measurement.
    pub const NOMINAL: Self = Self([MIDDLE; 3]);

    /// Phase currents in amperes.
    pub fn amperes(&self, samples: &MotorSamples) -> [f32; 3] {
        let [a, b, c] = samples.phases;
        let [x, y, z] = self.0;
        let amperes = |count: u16, offset: f32| (f32::from(count) - offset) * AMPERES;
        [amperes(a, x), amperes(b, y), amperes(c, z)]
    }
}

/// Why the offset measurement failed; phases are 0 to 2 for U to W.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OffsetError {
    /// The offset is too large.
    TooLarge {
        /// The phase.
        phase: u8,
    },
    /// The current is not constant.
    Moving {
        /// The phase.
        phase: u8,
    },
}

/// Measurement of the offsets, while all bridges are off.
#[derive(Clone, Copy, Debug, Default)]
pub struct OffsetMeasurement {
    periods: u32,
    sums: [u32; 3],
    squares: [u32; 3],
}

impl OffsetMeasurement {
    /// Adds one period; the result at the end.
    pub fn update(
        &mut self,
        samples: &MotorSamples,
    ) -> Option<Result<CurrentOffsets, OffsetError>> {
        for (count, (sum, square)) in
            samples.phases.iter().zip(self.sums.iter_mut().zip(&mut self.squares))
        {
            let count = u32::from(*count);
            *sum = sum.saturating_add(count);
            *square = square.saturating_add(count.saturating_mul(count) / 16);
        }
        self.periods = self.periods.saturating_add(1);
        (self.periods >= PERIODS).then(|| self.result())
    }

    fn result(&self) -> Result<CurrentOffsets, OffsetError> {
        const SHARE: f32 = 1.0 / PERIODS as f32;
        let mut means = [MIDDLE; 3];
        let sums = self.sums.iter().zip(&self.squares);
        for (phase, (mean, (sum, squares))) in (0_u8..).zip(means.iter_mut().zip(sums)) {
            *mean = *sum as f32 * SHARE;
            let variance = *squares as f32 * (16.0 * SHARE) - *mean * *mean;
            if (*mean - MIDDLE).abs() > MAX_OFFSET {
                return Err(OffsetError::TooLarge { phase });
            }
            if variance > MAX_SIGMA * MAX_SIGMA {
                return Err(OffsetError::Moving { phase });
            }
        }
        Ok(CurrentOffsets(means))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(phases: [u16; 3]) -> MotorSamples {
        MotorSamples { phases, bus: 1600, angle: Ok(0) }
    }

    /// Result for counts that alternate around `middle` by `ripple`.
    fn measured(middle: [u16; 3], ripple: u16) -> Result<CurrentOffsets, OffsetError> {
        let mut measurement = OffsetMeasurement::default();
        for period in 0..PERIODS {
            let phases = middle.map(|middle| match period % 2 {
                0 => middle + ripple,
                _ => middle - ripple,
            });
            if let Some(result) = measurement.update(&samples(phases)) {
                assert_eq!(period + 1, PERIODS);
                return result;
            }
        }
        panic!("no end");
    }

    #[test]
    fn counts_convert_to_amperes_and_volts() {
        let offsets = measured([2050, 2040, 2048], 3).unwrap();
        let amperes = offsets.amperes(&samples([2050 + 80, 2040 - 160, 2048]));
        assert_eq!(amperes, [1.0, -2.0, 0.0]);
        assert_eq!(bus_v(&samples([2048; 3])), 24.0);
        assert!(is_saturated(&samples([2048, 0, 2048])) && is_saturated(&samples([4095, 1, 1])));
        assert!(!is_saturated(&samples([1, 4094, 2048])));
    }

    #[test]
    fn large_offset_or_varying_current_is_an_error() {
        assert!(measured([2048 + 64, 2048 - 64, 2048], 0).is_ok());
        let large = Err(OffsetError::TooLarge { phase: 1 });
        assert_eq!(measured([2048, 2048 + 65, 2048], 0), large);
        assert!(measured([2048; 3], 15).is_ok());
        assert_eq!(measured([2048; 3], 17), Err(OffsetError::Moving { phase: 0 }));
    }
}

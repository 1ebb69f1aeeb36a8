//! From counts to amperes and volts, and the amplifiers' offsets, taken while no current can flow.

use super::stage::Sensed;
use crate::params;

/// Amperes of a count.
const AMPERES: f32 = (params::CURRENT_SCALE.value * 1e-3) as f32;
/// Volts of a count.
const VOLTS: f32 = (params::BUS_SCALE.value * 1e-3) as f32;
/// Counts of no current, nominal.
const MIDDLE: f32 = 2048.0;
/// The converter's greatest count.
const FULL: u16 = 4095;
/// Periods of which the offsets are the mean: 25.6 ms, and a twentieth of a sample's noise.
const PERIODS: u32 = 512;
/// Greatest offset in counts: 0.8 A.
const GREATEST: f32 = 64.0;
/// Greatest standard deviation in counts, 0.2 A: beyond it a current flows or an amplifier is broken.
const SPREAD: f32 = 16.0;

/// Bus voltage in volts.
pub fn bus_v(sensed: &Sensed) -> f32 {
    f32::from(sensed.bus) * VOLTS
}

/// Whether a current is beyond what its converter can tell.
pub fn is_at_end(sensed: &Sensed) -> bool {
    let [u, v, w] = sensed.phases;
    let is_at_end = |count: u16| count == 0 || count >= FULL;
    is_at_end(u) || is_at_end(v) || is_at_end(w)
}

/// Counts of no current, each phase.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offsets([f32; 3]);

impl Offsets {
    /// Before they are taken.
    pub const NOMINAL: Self = Self([MIDDLE; 3]);

    /// Currents of the phases in amperes.
    pub fn amperes(&self, sensed: &Sensed) -> [f32; 3] {
        let [a, b, c] = sensed.phases;
        let [x, y, z] = self.0;
        let amperes = |count: u16, offset: f32| (f32::from(count) - offset) * AMPERES;
        [amperes(a, x), amperes(b, y), amperes(c, z)]
    }
}

/// Why there are no offsets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// This phase's amplifier is too far from its middle.
    TooLarge {
        /// 0 to 2 for U to W.
        phase: u8,
    },
    /// This phase's current is not at rest.
    Moving {
        /// 0 to 2 for U to W.
        phase: u8,
    },
}

/// Takes the offsets, while all switches are off.
#[derive(Clone, Copy, Debug, Default)]
pub struct Zeroing {
    periods: u32,
    sums: [u32; 3],
    squares: [u32; 3],
}

impl Zeroing {
    /// Takes a period; the offsets at the end.
    pub fn take(&mut self, sensed: &Sensed) -> Option<Result<Offsets, Refusal>> {
        for (count, (sum, square)) in sensed
            .phases
            .iter()
            .zip(self.sums.iter_mut().zip(&mut self.squares))
        {
            let count = u32::from(*count);
            *sum = sum.saturating_add(count);
            *square = square.saturating_add(count.saturating_mul(count) / 16);
        }
        self.periods = self.periods.saturating_add(1);
        (self.periods >= PERIODS).then(|| self.close())
    }

    fn close(&self) -> Result<Offsets, Refusal> {
        const SHARE: f32 = 1.0 / PERIODS as f32;
        let mut means = [MIDDLE; 3];
        let sums = self.sums.iter().zip(&self.squares);
        for (phase, (mean, (sum, squares))) in (0_u8..).zip(means.iter_mut().zip(sums)) {
            *mean = *sum as f32 * SHARE;
            let variance = *squares as f32 * (16.0 * SHARE) - *mean * *mean;
            if (*mean - MIDDLE).abs() > GREATEST {
                return Err(Refusal::TooLarge { phase });
            }
            if variance > SPREAD * SPREAD {
                return Err(Refusal::Moving { phase });
            }
        }
        Ok(Offsets(means))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensed(phases: [u16; 3]) -> Sensed {
        Sensed {
            phases,
            bus: 1600,
            angle: Ok(0),
        }
    }

    /// The end of a zeroing over counts that alternate about `middle` by `spread`.
    fn zeroed(middle: [u16; 3], spread: u16) -> Result<Offsets, Refusal> {
        let mut zeroing = Zeroing::default();
        for period in 0..PERIODS {
            let phases = middle.map(|middle| match period % 2 {
                0 => middle + spread,
                _ => middle - spread,
            });
            if let Some(end) = zeroing.take(&sensed(phases)) {
                assert_eq!(period + 1, PERIODS);
                return end;
            }
        }
        panic!("no end");
    }

    #[test]
    fn counts_become_amperes_and_volts() {
        let offsets = zeroed([2050, 2040, 2048], 3).unwrap();
        let told = offsets.amperes(&sensed([2050 + 80, 2040 - 160, 2048]));
        assert_eq!(told, [1.0, -2.0, 0.0]);
        assert_eq!(bus_v(&sensed([2048; 3])), 24.0);
        assert!(is_at_end(&sensed([2048, 0, 2048])) && is_at_end(&sensed([4095, 1, 1])));
        assert!(!is_at_end(&sensed([1, 4094, 2048])));
    }

    #[test]
    fn an_amplifier_that_is_far_off_and_a_current_that_flows_are_refused() {
        assert!(zeroed([2048 + 64, 2048 - 64, 2048], 0).is_ok());
        let large = Err(Refusal::TooLarge { phase: 1 });
        assert_eq!(zeroed([2048, 2048 + 65, 2048], 0), large);
        assert!(zeroed([2048; 3], 15).is_ok());
        assert_eq!(zeroed([2048; 3], 17), Err(Refusal::Moving { phase: 0 }));
    }
}

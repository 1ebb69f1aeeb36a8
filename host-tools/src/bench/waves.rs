//! Sums of sines: motion that is smooth, bounded and never quite repeats.

use std::f64::consts::TAU;

use rand_chacha::ChaCha8Rng;

use super::draw::between;

/// A sum of sines.
#[derive(Clone, Debug, PartialEq)]
pub struct Waves {
    parts: Vec<Wave>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Wave {
    amplitude: f64,
    frequency_hz: f64,
    phase: f64,
}

impl Waves {
    /// `count` sines between two frequencies, evenly spread, whose amplitudes (the slower, the
    /// larger) add up to `peak`.
    pub fn draw(rng: &mut ChaCha8Rng, count: u32, hz: [f64; 2], peak: f64) -> Self {
        let width = (hz[1] - hz[0]) / f64::from(count);
        let mut parts: Vec<Wave> = (0..count)
            .map(|i| {
                let least = hz[0] + f64::from(i) * width;
                let frequency_hz = between(rng, least, least + width);
                Wave {
                    amplitude: between(rng, 0.7, 1.3) / frequency_hz,
                    frequency_hz,
                    phase: between(rng, 0.0, TAU),
                }
            })
            .collect();
        let total: f64 = parts.iter().map(|part| part.amplitude).sum();
        for part in &mut parts {
            part.amplitude *= peak / total;
        }
        Self { parts }
    }

    /// One sine.
    pub fn one(amplitude: f64, frequency_hz: f64, phase: f64) -> Self {
        Self {
            parts: vec![Wave {
                amplitude,
                frequency_hz,
                phase,
            }],
        }
    }

    /// Value at a time in seconds.
    pub fn at(&self, time_s: f64) -> f64 {
        let sine =
            |part: &Wave| part.amplitude * libm::sin(TAU * part.frequency_hz * time_s + part.phase);
        self.parts.iter().map(sine).sum()
    }
}

/// From 0 to 1 between two times, with no jump in speed.
pub fn rise(time_s: f64, from_s: f64, to_s: f64) -> f64 {
    let share = ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
    share * share * (3.0 - 2.0 * share)
}

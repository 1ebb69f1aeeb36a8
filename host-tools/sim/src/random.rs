//! Reproducible random streams of the simulator.
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, UnitSphere};
use std::f64::consts::TAU;

/// Purpose of a random stream. The order is part of the streams' definition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    RandomEffects,
    Sizes,
    TimeConstants,
    Scatter,
    Loads,
    Strokes,
    Motor,
    Attitude,
    Temperature,
    Clocks,
    FieldNoise,
    ReferenceNoise,
    Covariates,
    Neighbour,
    Leakage,
    Earth,
    SensorTemperature,
    FieldDrift,
    ExternalMagnet,
    Uncatalogued,
    Drive,
    DriveNoise,
    Fingertips,
    Inertial,
    FaultInjection,
}

/// Stream of a purpose; `part` is the number of a sensor or recording, 0 for the whole campaign.
pub fn stream(seed: u64, purpose: Purpose, part: u32) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream((purpose as u64) << 32 | u64::from(part));
    rng
}

/// Uniform between two numbers.
pub fn uniform(rng: &mut ChaCha8Rng, min: f64, max: f64) -> f64 {
    min + (max - min) * rng.random::<f64>()
}

/// Normal with standard deviation 1.
pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Each component normal with standard deviation 1.
pub fn normal_vector(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng))
}

/// Isotropic unit vector.
pub fn unit_vector(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from(UnitSphere.sample(rng))
}

/// Plus or minus one.
pub fn sign(rng: &mut ChaCha8Rng) -> f64 {
    if rng.random::<bool>() { 1.0 } else { -1.0 }
}

/// A sum of sines: smooth, bounded, aperiodic.
#[derive(Clone, Debug, PartialEq)]
pub struct SineSum {
    sines: Vec<Sine>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Sine {
    amplitude: f64,
    frequency_hz: f64,
    phase: f64,
}

impl SineSum {
    /// Draws `count` sines, spread evenly between two frequencies, with amplitudes inversely proportional to frequency
    /// that add up to `peak`.
    pub fn draw(rng: &mut ChaCha8Rng, count: u32, hz: [f64; 2], peak: f64) -> Self {
        let width = (hz[1] - hz[0]) / f64::from(count);
        let mut sines: Vec<Sine> = (0..count)
            .map(|i| {
                let min = hz[0] + f64::from(i) * width;
                let frequency_hz = uniform(rng, min, min + width);
                Sine {
                    amplitude: uniform(rng, 0.7, 1.3) / frequency_hz,
                    frequency_hz,
                    phase: uniform(rng, 0.0, TAU),
                }
            })
            .collect();
        let total: f64 = sines.iter().map(|sine| sine.amplitude).sum();
        for sine in &mut sines {
            sine.amplitude *= peak / total;
        }
        Self { sines }
    }

    /// A single sine.
    pub fn one(amplitude: f64, frequency_hz: f64, phase: f64) -> Self {
        Self { sines: vec![Sine { amplitude, frequency_hz, phase }] }
    }

    /// Value at a time in seconds.
    pub fn at(&self, time_s: f64) -> f64 {
        let sine =
            |wave: &Sine| wave.amplitude * libm::sin(TAU * wave.frequency_hz * time_s + wave.phase);
        self.sines.iter().map(sine).sum()
    }
}

/// Rises from 0 to 1 between two times with continuous speed.
pub fn smoothstep(time_s: f64, from_s: f64, to_s: f64) -> f64 {
    let x = ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

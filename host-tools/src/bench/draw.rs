//! Random numbers: one stream for each purpose, so that one more effect changes no other draw.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, UnitSphere};

/// What a stream of random numbers is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // The names are what they are for.
pub enum Purpose {
    Hiding,
    Sizes,
    TimeConstants,
    Scatter,
    Loads,
    Strokes,
    Motor,
    Attitude,
    Warmth,
    Clocks,
    FieldNoise,
    ReferenceNoise,
    Covariates,
    Neighbour,
    Leakage,
    Earth,
    SensorTemperature,
    FieldDrift,
    ForeignMagnet,
    Uncatalogued,
    Drive,
    DriveNoise,
    Fingertips,
    Inertial,
}

/// The stream of a purpose; `part` is the number of a sensor or recording, 0 for the whole campaign.
pub fn stream(seed: u64, purpose: Purpose, part: u32) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream((purpose as u64) << 32 | u64::from(part));
    rng
}

/// Uniform between two numbers.
pub fn between(rng: &mut ChaCha8Rng, least: f64, most: f64) -> f64 {
    least + (most - least) * rng.random::<f64>()
}

/// Normal with standard deviation 1.
pub fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// Each component normal with standard deviation 1.
pub fn normals(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng))
}

/// A unit vector in any direction.
pub fn direction(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from(UnitSphere.sample(rng))
}

/// Plus or minus one.
pub fn sign(rng: &mut ChaCha8Rng) -> f64 {
    if rng.random::<bool>() { 1.0 } else { -1.0 }
}

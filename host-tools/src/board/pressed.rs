//! A world that presses on the fingers as somebody says, felt through the forward model of a fitted
//! gripper, with the sensors' noise.

use firmware::frame::SENSORS;
use firmware::hall::Reading;
use firmware::hall::a31301::FIELD_LIMITS;
use firmware::params::SENSE_RATE;
use model_export::model_file::ModelFile;
use model_export::physics::ForwardModel;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::world::{Moment, World};
use crate::bench::element::NOISE_G;

/// Forces at each sensor, lateral and longitudinal, in newtons.
pub type Forces = [[f64; 2]; SENSORS];

/// The world.
pub struct Pressed {
    forward: [Option<ForwardModel>; SENSORS],
    gauss_per_lsb: f64,
    forces_n: Box<dyn FnMut(f64) -> Forces>,
    noise: Normal<f64>,
    rng: ChaCha8Rng,
    /// Milliseconds so far.
    taken: u64,
}

impl Pressed {
    /// Presses with `forces_n` of the time in seconds.
    pub fn new(
        model: &ModelFile,
        seed: u64,
        forces_n: impl FnMut(f64) -> Forces + 'static,
    ) -> Self {
        let numbers = [0, 1, 2, 3];
        Self {
            forward: numbers.map(|number| model.forward(number)),
            gauss_per_lsb: model.sensor_scale.gauss_per_lsb,
            forces_n: Box::new(forces_n),
            // A spread that is a number and not negative is always one.
            noise: Normal::new(0.0, NOISE_G).unwrap_or_else(|_| unreachable!()),
            rng: ChaCha8Rng::seed_from_u64(seed),
            taken: 0,
        }
    }
}

impl World for Pressed {
    fn next(&mut self) -> Option<Moment> {
        let forces_n = (self.forces_n)(self.taken as f64 / SENSE_RATE.value);
        self.taken += 1;
        let mut moment = Moment::default();
        let places = moment.readings.iter_mut().zip(&self.forward).zip(forces_n);
        for ((place, forward), force_n) in places {
            // A sensor that the model leaves out is on its bus all the same.
            let field_g = forward
                .as_ref()
                .map_or_else(Vector3::zeros, |forward| forward.field(force_n));
            let (least, greatest) = FIELD_LIMITS;
            let field = [0, 1, 2].map(|axis| {
                let seen_g = field_g[axis] + self.noise.sample(&mut self.rng);
                let counts = (seen_g / self.gauss_per_lsb).round();
                counts.clamp(f64::from(least), f64::from(greatest)) as i16
            });
            *place = Some(Reading {
                field,
                temperature: 0,
            });
        }
        Some(moment)
    }
}

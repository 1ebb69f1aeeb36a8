//! Worlds of a simulated board: what its sensors measure each millisecond, and the motor's interface.

use crate::drivetrain::fingertips::SensorForces;
use crate::drivetrain::sensors::{InertialRegisters, ROOM_C, imu_registers, thermistor_counts};
use crate::hall_sensor::NOISE_G;
use device_run::channel_map::field_counts;
use device_run::{RecordedRows, ReplayModels};
use firmware::clock::Timed;
use firmware::config::constants::{SENSE_RATE, TICK_US};
use firmware::motor::{MotorCommand, MotorStatus};
use firmware::sensors::hall::{HallReading, SENSORS};
use firmware::tasks::FIRST_TICK_US;
use model_export::error::DataError;
use model_export::inverse::build::DeviceModel;
use model_export::model_file::ModelFile;
use model_export::physics::{ForwardModel, SensorOrientation};
use model_export::recordings::stream::RawStream;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// Measured quantities of one millisecond.
#[derive(Clone, Copy, Debug, Default)]
pub struct WorldSample {
    /// Sensor registers; none where the gripper lacks the sensor.
    pub readings: [Option<HallReading>; SENSORS],
    /// Output registers of the inertial sensor: rate, then acceleration; none where the gripper lacks it.
    pub inertial: Option<InertialRegisters>,
}

/// A sequence of samples.
pub trait World {
    /// The next millisecond; none at the end.
    fn next(&mut self) -> Option<WorldSample>;
}

/// Motor control and drivetrain behind the board's motor interface.
pub trait SimulatedMotor {
    /// The newest status at this time, with the time at which it was taken.
    fn status(&mut self, time_us: u64) -> Timed<MotorStatus>;

    /// Queues an order at this time; fails while the previous one is pending.
    ///
    /// # Errors
    /// The order itself.
    fn order(&mut self, time_us: u64, order: MotorCommand) -> Result<(), MotorCommand>;

    /// Counts of the thermistors of motor and power stage.
    fn thermistors(&mut self) -> [u16; 2];

    /// Switches the outputs off and restarts at this time.
    fn restart(&mut self, time_us: u64);
}

/// A missing motor: default status, orders are ignored.
pub struct NoMotor;

impl SimulatedMotor for NoMotor {
    fn status(&mut self, time_us: u64) -> Timed<MotorStatus> {
        Timed { time_us, value: MotorStatus::default() }
    }

    fn order(&mut self, _: u64, _: MotorCommand) -> Result<(), MotorCommand> {
        Ok(())
    }

    fn thermistors(&mut self) -> [u16; 2] {
        [thermistor_counts(ROOM_C); 2]
    }

    fn restart(&mut self, _: u64) {}
}

/// Start of the first millisecond before the first sensor tick, so that no tick is near a boundary.
const MARGIN_US: u64 = 100;

/// A world on the board's clock: its first sample is that of the first sensor tick,
/// [`FIRST_TICK_US`] after the first transfer on a sensor bus.
pub struct WorldClock {
    world: Box<dyn World>,
    sample: WorldSample,
    /// Start of the first millisecond, once known.
    begins_us: Option<u64>,
    /// Samples so far.
    samples: u64,
    ended: bool,
}

impl WorldClock {
    /// Takes the first sample on the first call of [`Self::at`].
    pub fn new(world: Box<dyn World>) -> Self {
        let mut now = Self {
            world,
            sample: WorldSample::default(),
            begins_us: None,
            samples: 0,
            ended: false,
        };
        now.at(0);
        now
    }

    /// A copy in its present state, which goes on with a copy of its world.
    pub fn copy(&self, world: Box<dyn World>) -> Self {
        Self { world, ..*self }
    }

    /// Sample at the time of a sensor transfer.
    pub fn at_transfer(&mut self, time_us: u64) -> &WorldSample {
        self.begins_us.get_or_insert(time_us + FIRST_TICK_US - MARGIN_US);
        self.at(time_us)
    }

    /// Sample at this time; the last one after the end.
    pub fn at(&mut self, time_us: u64) -> &WorldSample {
        let begins_us = self.begins_us.unwrap_or(u64::MAX);
        let place = time_us.saturating_sub(begins_us) / TICK_US;
        while self.samples <= place && !self.ended {
            match self.world.next() {
                Some(sample) => {
                    self.sample = sample;
                    self.samples += 1;
                }
                None => self.ended = true,
            }
        }
        &self.sample
    }

    /// Start of the first millisecond; none before the first transfer.
    pub fn begins_us(&self) -> Option<u64> {
        self.begins_us
    }

    /// Whether the world has ended.
    pub fn ended(&self) -> bool {
        self.ended
    }
}

/// Known forces on a fitted gripper: fields of its forward model, with sensor noise.
pub struct PressedWorld {
    /// Model and orientation of each sensor.
    sensors: [Option<(ForwardModel, SensorOrientation)>; SENSORS],
    gauss_per_lsb: f64,
    forces_n: Box<dyn FnMut(f64) -> SensorForces>,
    noise: Normal<f64>,
    rng: ChaCha8Rng,
    /// Samples so far.
    samples: u64,
}

impl PressedWorld {
    /// Applies `forces_n` as a function of time in seconds.
    pub fn new(
        model: &ModelFile,
        seed: u64,
        forces_n: impl FnMut(f64) -> SensorForces + 'static,
    ) -> Self {
        let numbers = [0, 1, 2, 3];
        Self {
            sensors: numbers
                .map(|number| Some((model.forward(number)?, model.mounting(number)?.orientation))),
            gauss_per_lsb: model.sensor_scale.gauss_per_lsb,
            forces_n: Box::new(forces_n),
            // A finite positive deviation is valid.
            noise: Normal::new(0.0, NOISE_G).unwrap_or_else(|_| unreachable!()),
            rng: ChaCha8Rng::seed_from_u64(seed),
            samples: 0,
        }
    }
}

impl World for PressedWorld {
    fn next(&mut self) -> Option<WorldSample> {
        let forces_n = (self.forces_n)(self.samples as f64 / SENSE_RATE.value);
        self.samples += 1;
        let mut sample = WorldSample::default();
        let places = sample.readings.iter_mut().zip(&self.sensors).zip(forces_n);
        for ((place, sensor), force_n) in places {
            // A sensor outside the model is on its bus with zero field.
            let field_g = sensor.as_ref().map_or_else(Vector3::zeros, |(forward, orientation)| {
                orientation.to_sensor(forward.field(force_n))
            });
            let field = [0, 1, 2].map(|axis| {
                let noisy_g = field_g[axis] + self.noise.sample(&mut self.rng);
                field_counts(noisy_g, self.gauss_per_lsb)
            });
            *place = Some(HallReading { field, temperature: 0 });
        }
        Some(sample)
    }
}

/// A recording, replayed at the board's rate whatever its clock: the registers of Hall sensors and inertial sensor. It has
/// no motor: opening, current and rotor angle are unknown to the board.
pub struct RecordedWorld {
    rows: RecordedRows,
    /// Read error; the world ends there.
    pub problem: Option<DataError>,
}

impl RecordedWorld {
    /// Replays a recording for a model.
    pub fn new(stream: RawStream, built: &DeviceModel) -> Self {
        Self { rows: ReplayModels::of(built).rows(stream), problem: None }
    }
}

impl World for RecordedWorld {
    fn next(&mut self) -> Option<WorldSample> {
        match self.rows.next()? {
            Ok(row) => {
                // A recording has no angular rate; without yaw the device does not need the tilt.
                let acceleration = row.covariates.acceleration.map(|sample| sample.mm_s2);
                Some(WorldSample {
                    readings: row.readings,
                    inertial: acceleration
                        .map(|mm_s2| imu_registers(mm_s2.map(|a| 1e-3 * f64::from(a)), [0.0; 3])),
                })
            }
            Err(problem) => {
                self.problem = Some(problem);
                None
            }
        }
    }
}

//! A world in which the drive closes the fingers: what the board's sensors feel meanwhile.

use std::cell::RefCell;
use std::rc::Rc;

use firmware::params::{PWM_RATE, SENSE_RATE};
use nalgebra::Vector3;

use super::Rig;
use crate::bench::attitude::GRAVITY;
use crate::bench::stroke::Drive;
use crate::board::world::{Moment, World};
use crate::plant::PERIOD_S;
use crate::plant::hall::{Fingertips, shared};
use crate::plant::impact::{FOOT_KG, Impact};
use crate::plant::imu::Inertial;

/// Periods of the pulses in one tick of sensing.
const PERIODS: usize = (1e3 * PWM_RATE.value / SENSE_RATE.value) as usize;
/// Periods from one step of the fingertips to the next.
const FINE: usize = 5;

/// The world. Whoever shares its rig commands the motor and puts objects between the fingers.
pub struct Driven {
    rig: Rc<RefCell<Rig>>,
    tips: Fingertips,
    inertial: Inertial,
    /// Where an object is met: a share of half the distance of a finger's sensors, towards the first.
    pub towards_first: f64,
    /// Steps on the ground, on the rig's time.
    pub impacts: Vec<Impact>,
}

impl Driven {
    /// A level gripper at rest.
    pub fn new(rig: Rc<RefCell<Rig>>, tips: Fingertips, seed: u64) -> Self {
        Self {
            rig,
            tips,
            inertial: Inertial::new(seed),
            towards_first: 0.0,
            impacts: Vec::new(),
        }
    }

    fn ground_n(&self, time_s: f64) -> f64 {
        self.impacts
            .iter()
            .map(|impact| impact.force_n(time_s))
            .sum()
    }
}

impl World for Driven {
    fn next(&mut self) -> Option<Moment> {
        let rig = self.rig.clone();
        let mut rig = rig.borrow_mut();
        let mut felt = Vector3::new(0.0, 0.0, GRAVITY);
        for _ in 0..PERIODS / FINE {
            (0..FINE).for_each(|_| rig.period());
            let ground_n = self.ground_n(rig.plant.time_s());
            felt.z = GRAVITY + ground_n / FOOT_KG;
            let forces_n = shared(rig.plant.grip_n(), self.towards_first, ground_n);
            self.tips.press(&forces_n, felt, FINE as f64 * PERIOD_S);
        }
        let drive = Drive {
            opening_mm: 1e3 * rig.plant.opening_m(),
            angle_rad: rig.plant.train.angle_rad,
            current_a: rig.plant.direct_quadrature_a()[1],
        };
        let readings = self.tips.look(&drive, rig.plant.time_s());
        let motion = self.inertial.look(felt.into(), [0.0; 3]);
        let mut around = rig.motor.telling().surroundings();
        around.acceleration = Some(motion.acceleration);
        Some(Moment { readings, around })
    }
}

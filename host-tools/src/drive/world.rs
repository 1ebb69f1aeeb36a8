//! The gripper at a board's lines: motor, fingers, inertial sensor, in the board's virtual time. What goes wrong
//! is done to what is sensed, never told to the firmware.

use std::cell::RefCell;
use std::rc::Rc;

use firmware::loops::FIRST_TICK_US;
use firmware::motor::plausible::Supply;
use firmware::motor::stage::{Drive, Sensed};
use firmware::motor::{Order, State, Telling, Trip, as5047};
use firmware::params::{PWM_RATE, TICK_US};
use nalgebra::Vector3;
use sim_board::Time;
use sim_board::devices::{Drivetrain, SpiDevice};

use super::Rig;
use crate::bench::attitude::GRAVITY;
use crate::bench::stroke;
use crate::board::world::{Moment, Motor, World};
use crate::plant::PERIOD_S;
use crate::plant::hall::{Fingertips, shared};
use crate::plant::impact::{FOOT_KG, Impact};
use crate::plant::imu::Inertial;
use crate::plant::train::Train;

/// A period of the pulses in microseconds.
const PERIOD_US: u64 = (1e3 / PWM_RATE.value) as u64;
/// Periods from one telling of the motor to the next, as on the board.
const TELLS: u64 = TICK_US / PERIOD_US;
/// Periods from one step of the fingertips to the next.
const FINE: u64 = 5;

/// What goes wrong where the motor's interrupt senses.
#[derive(Default)]
pub struct Wrong {
    /// Done to each answer of the rotor's sensor on its way.
    pub frame: Option<Box<dyn FnMut(u16) -> u16>>,
    /// Done to the converters' counts: phases U, V, W, then the bus.
    pub counts: Option<Counts>,
    /// The rotor is held, whatever the torque.
    pub is_jammed: bool,
}

/// Makes other counts of counts.
pub type Counts = Box<dyn FnMut([u16; 4]) -> [u16; 4]>;

impl Wrong {
    fn spoil(&mut self, sensed: &mut Sensed) {
        if let (Some(frame), Ok(angle)) = (&mut self.frame, sensed.angle) {
            sensed.angle = as5047::angle(frame(as5047::answer(angle)));
        }
        if let Some(counts) = &mut self.counts {
            let [u, v, w] = sensed.phases;
            let [u, v, w, bus] = counts([u, v, w, sensed.bus]);
            (sensed.phases, sensed.bus) = ([u, v, w], bus);
        }
    }
}

/// The gripper. Whoever shares it puts objects between the fingers and lets things go wrong.
pub struct Gripper {
    /// Plant and motor.
    pub rig: Rig,
    /// What goes wrong.
    pub wrong: Wrong,
    /// Where an object is met: a share of half the distance of a finger's sensors, towards the first.
    pub towards_first: f64,
    /// Steps on the ground, on the plant's time.
    pub impacts: Vec<Impact>,
    /// Greatest true force between the fingertips in newtons, since somebody set it back.
    pub peak_n: f64,
    /// When the motor did what it was ordered last, in microseconds.
    pub obeyed_us: u64,
    /// When the motor first tripped, in microseconds, and on what.
    pub tripped: Option<(u64, Trip)>,
    /// When it first found its supply out of bounds.
    pub out_us: Option<u64>,
    tips: Fingertips,
    inertial: Inertial,
    felt: Vector3<f64>,
    periods: u64,
    /// The half period that comes next is the second of its period.
    is_second_half: bool,
    /// Periods after a whole millisecond at which the motor tells: its clock is not that of sensing.
    tells_at: u64,
    ordered: Option<Order>,
    told: Telling,
    moments: u64,
    /// The emulated chip's timer moves it on, not its own rig.
    is_driven_by_chip: bool,
}

impl Gripper {
    /// A level gripper at rest; the seed is that of its noise.
    pub fn new(rig: Rig, tips: Fingertips, seed: u64) -> Self {
        Self {
            rig,
            wrong: Wrong::default(),
            towards_first: 0.0,
            impacts: Vec::new(),
            peak_n: 0.0,
            obeyed_us: 0,
            tripped: None,
            out_us: None,
            tips,
            inertial: Inertial::new(seed),
            felt: Vector3::new(0.0, 0.0, GRAVITY),
            periods: 0,
            is_second_half: false,
            tells_at: seed % TELLS,
            ordered: None,
            told: Telling::default(),
            moments: 0,
            is_driven_by_chip: false,
        }
    }

    /// From now on an emulated chip drives it: [`Self::half_period`] alone moves it on.
    pub fn connect_chip(&mut self) {
        self.is_driven_by_chip = true;
    }

    /// Goes on until this time under its own rig's drive.
    pub fn advance(&mut self, time_us: u64) {
        if self.is_driven_by_chip {
            return;
        }
        while (self.periods + 1) * PERIOD_US <= time_us {
            self.period();
        }
    }

    fn period(&mut self) {
        self.periods += 1;
        if let Some(order) = self.ordered.take() {
            self.rig.motor.obey(order);
            self.obeyed_us = self.periods * PERIOD_US;
        }
        let wrong = &mut self.wrong;
        let before = self.rig.plant.train;
        self.rig.period_with(|sensed| wrong.spoil(sensed));
        if wrong.is_jammed {
            self.rig.plant.train = Train {
                speed_rad_s: 0.0,
                travel_m_s: 0.0,
                ..before
            };
        }
        self.notice();
        if self.periods % TELLS == self.tells_at {
            self.told = self.rig.motor.telling();
        }
        self.press();
    }

    /// What the fingertips feel at the end of a period.
    fn press(&mut self) {
        let grip_n = self.rig.plant.grip_n();
        self.peak_n = self.peak_n.max(grip_n);
        if self.periods.is_multiple_of(FINE) {
            let ground_n = self.ground_n(self.rig.plant.time_s());
            self.felt.z = GRAVITY + ground_n / FOOT_KG;
            let forces_n = shared(grip_n, self.towards_first, ground_n);
            self.tips
                .press(&forces_n, self.felt, FINE as f64 * PERIOD_S);
        }
    }

    /// Half a period of the pulses under the drive of somebody else than this rig: the emulated chip.
    pub fn half_period(&mut self, drive: Drive) {
        let before = self.rig.plant.train;
        self.rig.plant.half_period(drive);
        if self.wrong.is_jammed {
            self.rig.plant.train = Train {
                speed_rad_s: 0.0,
                travel_m_s: 0.0,
                ..before
            };
        }
        self.is_second_half = !self.is_second_half;
        if !self.is_second_half {
            self.periods += 1;
            self.press();
        }
    }

    /// Counts of the converters: phases U, V, W, bus voltage.
    pub fn convert(&mut self) -> [u16; 4] {
        let ([u, v, w], bus) = self.rig.plant.convert();
        let converted = [u, v, w, bus];
        match &mut self.wrong.counts {
            Some(counts) => counts(converted),
            None => converted,
        }
    }

    /// The rotor sensor's answer.
    pub fn answer(&mut self) -> u16 {
        let answer = as5047::answer(self.rig.plant.angle());
        match &mut self.wrong.frame {
            Some(frame) => frame(answer),
            None => answer,
        }
    }

    /// Notes when the motor found something by itself, to a period of the pulses.
    fn notice(&mut self) {
        let telling = self.rig.motor.telling();
        let now_us = self.periods * PERIOD_US;
        if let State::Tripped(trip) = telling.state {
            self.tripped = self.tripped.or(Some((now_us, trip)));
        }
        if telling.state == State::Armed && telling.supply != Supply::Sound {
            self.out_us = self.out_us.or(Some(now_us));
        }
    }

    fn ground_n(&self, time_s: f64) -> f64 {
        self.impacts
            .iter()
            .map(|impact| impact.force_n(time_s))
            .sum()
    }

    fn look(&mut self) -> Moment {
        let plant = &self.rig.plant;
        let drive = stroke::Drive {
            opening_mm: 1e3 * plant.opening_m(),
            angle_rad: plant.train.angle_rad,
            current_a: plant.direct_quadrature_a()[1],
        };
        let readings = self.tips.look(&drive, plant.time_s());
        let motion = self.inertial.look(self.felt.into(), [0.0; 3]);
        let mut around = self.told.surroundings();
        around.acceleration = Some(motion.acceleration);
        Moment { readings, around }
    }
}

/// A gripper that is shared.
pub type Shared = Rc<RefCell<Gripper>>;

/// What a board's sensors feel of it, once in each tick, at its beginning.
pub struct Senses(pub Shared);

impl World for Senses {
    fn next(&mut self) -> Option<Moment> {
        let mut gripper = self.0.borrow_mut();
        let begins_us = FIRST_TICK_US + gripper.moments * TICK_US;
        gripper.moments += 1;
        gripper.advance(begins_us);
        Some(gripper.look())
    }
}

/// Its half bridges and converters at the pins of an emulated chip.
pub struct Bridges(pub Shared);

impl Drivetrain for Bridges {
    fn half_period(&mut self, _: Time, duties: Option<[f64; 3]>) {
        let drive = match duties {
            None => Drive::Off,
            Some([0.0, 0.0, 0.0]) => Drive::Brake,
            Some(duties) => Drive::Duty(duties.map(|duty| duty as f32)),
        };
        self.0.borrow_mut().half_period(drive);
    }

    fn sample(&mut self) -> [u16; 4] {
        self.0.borrow_mut().convert()
    }
}

/// Its rotor sensor, an AS5047P: a frame holds the answer to the frame before, measured as that ended.
pub struct RotorSensor {
    gripper: Shared,
    command: u16,
    answer: u16,
}

impl RotorSensor {
    /// No frame has come yet.
    pub fn new(gripper: Shared) -> Self {
        Self {
            gripper,
            command: 0,
            answer: 0,
        }
    }
}

impl SpiDevice for RotorSensor {
    fn select(&mut self, _: Time, is_selected: bool) {
        if !is_selected && self.command == as5047::READ_ANGLE {
            self.answer = self.gripper.borrow_mut().answer();
        }
    }

    fn transfer(&mut self, _: Time, frame: u16) -> u16 {
        self.command = frame;
        self.answer
    }
}

/// Its motor at the board's lines.
pub struct Coupled(pub Shared);

impl Motor for Coupled {
    fn telling(&mut self, time_us: u64) -> Telling {
        let mut gripper = self.0.borrow_mut();
        gripper.advance(time_us);
        gripper.told
    }

    fn order(&mut self, time_us: u64, order: Order) -> Result<(), Order> {
        let mut gripper = self.0.borrow_mut();
        gripper.advance(time_us);
        match gripper.ordered {
            Some(_) => Err(order),
            None => {
                gripper.ordered = Some(order);
                Ok(())
            }
        }
    }

    fn restart(&mut self, time_us: u64) {
        let mut gripper = self.0.borrow_mut();
        gripper.advance(time_us);
        gripper.rig.restart();
        (gripper.ordered, gripper.told) = (None, Telling::default());
    }
}

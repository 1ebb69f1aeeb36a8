//! The simulated gripper at a board's connections: motor, fingertips, inertial sensor, in the board's time. Faults
//! are injected into the sensed quantities and never reported to the firmware.

use crate::board::world::{SimulatedMotor, World, WorldSample};
use crate::closed_loop::bench_programme::BenchProgramme;
use crate::closed_loop::motor_rig::MotorRig;
use crate::drivetrain::PERIOD_S;
use crate::drivetrain::fingertips::{
    AmbientConditions, FOOT_KG, Fingertips, Impact, distribute_forces,
};
use crate::drivetrain::mechanics::DriveTrain;
use crate::drivetrain::sensors::{ROOM_C, SimulatedImu, chip_counts, thermistor_counts};
use crate::motion::{self, GRAVITY};
use emulator::Time;
use emulator::devices::{Drivetrain, SpiDevice};
use firmware::clock::Timed;
use firmware::config::constants::{PWM_RATE, TICK_US};
use firmware::motor::power_stage::{BridgeCommand, MotorSamples};
use firmware::motor::state::SupplyState;
use firmware::motor::{MotorCommand, MotorState, MotorStatus, Trip, as5047};
use firmware::tasks::FIRST_TICK_US;
use nalgebra::Vector3;
use std::cell::RefCell;
use std::rc::Rc;

/// PWM period in microseconds.
const PERIOD_US: u64 = (1e3 / PWM_RATE.value) as u64;
/// PWM periods between status updates of the motor, as on the board.
const STATUS_PERIODS: u64 = TICK_US / PERIOD_US;
/// PWM periods between steps of the fingertips.
const FINGERTIP_PERIODS: u64 = 5;

/// Errors injected into the sensors of the motor control.
#[derive(Default)]
pub struct SensingErrors {
    /// Modifies each frame of the rotor sensor.
    pub frame: Option<Box<dyn FnMut(u16) -> u16>>,
    /// Modifies each command to the rotor sensor; of an emulated chip only.
    pub command: Option<Box<dyn FnMut(u16) -> u16>>,
    /// Modifies the ADC counts: phases U, V, W, bus.
    pub counts: Option<CountsTransform>,
    /// The rotor is locked.
    pub is_jammed: bool,
    /// The rotor sensor has no magnet: its angle is arbitrary.
    pub has_no_magnet: bool,
}

/// Maps ADC counts to modified counts.
pub type CountsTransform = Box<dyn FnMut([u16; 4]) -> [u16; 4]>;

impl SensingErrors {
    /// Samples of a PWM period with the errors.
    fn modify(&mut self, sensed: &mut MotorSamples) {
        if let (Some(frame), Ok(angle)) = (&mut self.frame, sensed.angle) {
            sensed.angle = as5047::angle(frame(as5047::answer(angle)));
        }
        let [u, v, w, bus] = self.convert((sensed.phases, sensed.bus));
        (sensed.phases, sensed.bus) = ([u, v, w], bus);
    }

    /// Counts of the converters with the errors.
    fn convert(&mut self, ([u, v, w], bus): ([u16; 3], u16)) -> [u16; 4] {
        let converted = [u, v, w, bus];
        self.counts.as_mut().map_or(converted, |counts| counts(converted))
    }

    /// Drivetrain after a step from `before`: where it is jammed, without motion.
    fn jam(&self, train: &mut DriveTrain, before: DriveTrain) {
        if self.is_jammed {
            *train = DriveTrain { speed_rad_s: 0.0, travel_m_s: 0.0, ..before };
        }
    }
}

/// The gripper, shared between board and test.
pub struct SimulatedGripper {
    /// Drivetrain and motor control.
    pub rig: MotorRig,
    /// Injected errors.
    pub errors: SensingErrors,
    /// Contact point of an object: a share of half the sensors' distance, towards the first sensor.
    pub towards_first: f64,
    /// Landings, on the plant's time.
    pub impacts: Vec<Impact>,
    /// Forces that press the fingers outwards, as an object between them would, in newtons.
    pub pressed_n: [f64; 2],
    /// Test bench that loads the fingertips and moves the gripper.
    pub bench: Option<Rc<BenchProgramme>>,
    /// Ambient conditions without a bench.
    pub ambient: AmbientConditions,
    /// Specific force at rest without a bench in m/s^2, gripper axes.
    pub gravity: Vector3<f64>,
    /// Peak true grip force in newtons, since its last reset.
    pub peak_n: f64,
    /// Peak force of something around the fingers in newtons, since its last reset.
    pub outward_peak_n: f64,
    /// Time at which the motor executed the last order, in microseconds.
    pub last_order_us: u64,
    /// Time of the motor's first trip in microseconds, and its cause.
    pub tripped: Option<(u64, Trip)>,
    /// Time at which the motor first found its supply out of range.
    pub out_us: Option<u64>,
    /// Temperatures of motor and power stage in degrees Celsius.
    pub temperatures_c: [f64; 2],
    tips: Fingertips,
    inertial: SimulatedImu,
    specific_force: Vector3<f64>,
    periods: u64,
    /// The next half period is the second of its period.
    is_second_half: bool,
    /// Phase of the motor's status updates in PWM periods: its clock is not that of the sensors.
    status_phase: u64,
    pending_order: Option<MotorCommand>,
    status: Timed<MotorStatus>,
    samples: u64,
    rotor: RotorLine,
    /// The timer of an emulated chip advances it, not its own rig.
    is_driven_by_chip: bool,
}

impl SimulatedGripper {
    /// A level gripper at rest; `seed` is that of its noise.
    pub fn new(rig: MotorRig, tips: Fingertips, seed: u64) -> Self {
        Self {
            rig,
            errors: SensingErrors::default(),
            towards_first: 0.0,
            impacts: Vec::new(),
            pressed_n: [0.0; 2],
            bench: None,
            ambient: AmbientConditions::default(),
            gravity: Vector3::new(0.0, 0.0, GRAVITY),
            peak_n: 0.0,
            outward_peak_n: 0.0,
            last_order_us: 0,
            tripped: None,
            out_us: None,
            temperatures_c: [ROOM_C; 2],
            tips,
            inertial: SimulatedImu::new(seed),
            specific_force: Vector3::new(0.0, 0.0, GRAVITY),
            periods: 0,
            is_second_half: false,
            status_phase: seed % STATUS_PERIODS,
            pending_order: None,
            status: Timed::default(),
            samples: 0,
            rotor: RotorLine::default(),
            is_driven_by_chip: false,
        }
    }

    /// A copy in its present state, without the injected errors.
    pub fn copy(&self) -> Self {
        Self {
            rig: self.rig.clone(),
            errors: SensingErrors::default(),
            towards_first: self.towards_first,
            impacts: self.impacts.clone(),
            pressed_n: self.pressed_n,
            bench: self.bench.clone(),
            ambient: self.ambient,
            gravity: self.gravity,
            peak_n: self.peak_n,
            outward_peak_n: self.outward_peak_n,
            last_order_us: self.last_order_us,
            tripped: self.tripped,
            out_us: self.out_us,
            temperatures_c: self.temperatures_c,
            tips: self.tips.clone(),
            inertial: self.inertial.clone(),
            specific_force: self.specific_force,
            periods: self.periods,
            is_second_half: self.is_second_half,
            status_phase: self.status_phase,
            pending_order: self.pending_order,
            status: self.status,
            samples: self.samples,
            rotor: self.rotor,
            is_driven_by_chip: self.is_driven_by_chip,
        }
    }

    /// Pause of the unloaded fingertips, in seconds that nothing else experiences.
    pub fn pause_fingertips(&mut self, seconds: f64) {
        self.tips.pause(seconds);
    }

    /// Connects an emulated chip: only [`Self::half_period`] advances the gripper.
    pub fn connect_chip(&mut self) {
        self.is_driven_by_chip = true;
    }

    /// Advances to a time with its own motor control.
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
        if let Some(order) = self.pending_order.take() {
            self.rig.motor.handle_command(order);
            self.last_order_us = self.periods * PERIOD_US;
        }
        let errors = &mut self.errors;
        let before = self.rig.plant.train;
        self.rig.period_with(|sensed| errors.modify(sensed));
        errors.jam(&mut self.rig.plant.train, before);
        self.record_detections();
        if self.periods % STATUS_PERIODS == self.status_phase {
            let time_us = self.periods * PERIOD_US;
            self.status = Timed { time_us, value: self.rig.motor.status() };
        }
        self.step_fingertips();
    }

    /// Advances the fingertips at the end of a period.
    fn step_fingertips(&mut self) {
        let grip_n = self.rig.plant.grip_n();
        self.peak_n = self.peak_n.max(grip_n);
        self.outward_peak_n = self.outward_peak_n.max(-grip_n);
        if self.periods.is_multiple_of(FINGERTIP_PERIODS) {
            let time_s = self.rig.plant.time_s();
            let ground_n = self.ground_n(time_s);
            let mut forces_n = distribute_forces(grip_n, self.towards_first, ground_n);
            let (first, second) = forces_n.split_at_mut(2);
            let [outwards_n, opposite_n] = self.pressed_n;
            first.iter_mut().for_each(|[lateral_n, _]| *lateral_n += 0.5 * outwards_n);
            second.iter_mut().for_each(|[lateral_n, _]| *lateral_n -= 0.5 * opposite_n);
            self.specific_force = self.gravity;
            if let Some(bench) = &self.bench {
                for (sensor, force_n) in forces_n.iter_mut().enumerate() {
                    let load_n = bench.load_n(sensor, time_s);
                    *force_n = [force_n[0] + load_n[0], force_n[1] + load_n[1]];
                }
                self.specific_force = bench.orientation(time_s).specific_force;
            }
            self.specific_force.z += ground_n / FOOT_KG;
            self.tips.step(&forces_n, self.specific_force, FINGERTIP_PERIODS as f64 * PERIOD_S);
        }
    }

    /// Half a PWM period driven by the emulated chip.
    pub fn half_period(&mut self, drive: BridgeCommand) {
        let before = self.rig.plant.train;
        self.rig.plant.half_period(drive);
        self.errors.jam(&mut self.rig.plant.train, before);
        self.is_second_half = !self.is_second_half;
        if !self.is_second_half {
            self.periods += 1;
            self.step_fingertips();
        }
    }

    /// Counts of the converters: phases U, V, W, bus voltage.
    pub fn convert(&mut self) -> [u16; 4] {
        self.errors.convert(self.rig.plant.convert())
    }

    /// Records when the motor detected a fault, to a PWM period.
    fn record_detections(&mut self) {
        let telling = self.rig.motor.status();
        let now_us = self.periods * PERIOD_US;
        if let MotorState::Tripped(trip) = telling.state {
            self.tripped = self.tripped.or(Some((now_us, trip)));
        }
        if telling.state == MotorState::Armed && telling.supply != SupplyState::Sound {
            self.out_us = self.out_us.or(Some(now_us));
        }
    }

    fn ground_n(&self, time_s: f64) -> f64 {
        self.impacts.iter().map(|impact| impact.force_n(time_s)).sum()
    }

    fn sample(&mut self) -> WorldSample {
        let plant = &self.rig.plant;
        let drive = motion::MotionState {
            opening_mm: 1e3 * plant.opening_m(),
            angle_rad: plant.train.angle_rad,
            current_a: plant.direct_quadrature_a()[1],
        };
        let time_s = plant.time_s();
        let (ambient, rate_deg_s) = match &self.bench {
            Some(bench) => (bench.ambient(time_s), bench.rate_deg_s(time_s)),
            None => (self.ambient, [0.0; 3]),
        };
        let readings = self.tips.sample(&drive, &ambient, time_s);
        let inertial = Some(self.inertial.sample(self.specific_force.into(), rate_deg_s));
        WorldSample { readings, inertial }
    }
}

/// A shared gripper.
pub type SharedGripper = Rc<RefCell<SimulatedGripper>>;

/// The gripper as the world of a board's sensors, sampled at the start of each tick.
pub struct GripperWorld(pub SharedGripper);

impl World for GripperWorld {
    fn next(&mut self) -> Option<WorldSample> {
        let mut gripper = self.0.borrow_mut();
        let begins_us = FIRST_TICK_US + gripper.samples * TICK_US;
        gripper.samples += 1;
        gripper.advance(begins_us);
        Some(gripper.sample())
    }
}

/// Its half bridges and converters at the pins of an emulated chip.
pub struct PowerStagePins(pub SharedGripper);

impl Drivetrain for PowerStagePins {
    fn half_period(&mut self, _: Time, duties: Option<[f64; 3]>) {
        let drive = match duties {
            None => BridgeCommand::Off,
            Some([0.0, 0.0, 0.0]) => BridgeCommand::Brake,
            Some(duties) => BridgeCommand::Duty(duties.map(|duty| duty as f32)),
        };
        self.0.borrow_mut().half_period(drive);
    }

    fn sample(&mut self) -> [u16; 4] {
        self.0.borrow_mut().convert()
    }

    fn temperatures(&mut self) -> [u16; 3] {
        let [motor, stage] = self.0.borrow().temperatures_c.map(thermistor_counts);
        [chip_counts(ROOM_C), motor, stage]
    }
}

/// Its rotor sensor, an AS5047P (datasheet, tables 12 to 22): each frame returns the answer to the previous one. After an
/// invalid command every answer has the error flag, until the error register is read.
pub struct RotorSensor(pub SharedGripper);

/// What it remembers from frame to frame.
#[derive(Clone, Copy, Debug, Default)]
struct RotorLine {
    command: u16,
    answer: u16,
    /// Bits of the error register, ERRFL.
    errors: u16,
}

/// Bits of ERRFL: a register that does not exist, wrong parity of a command.
const INVALID_COMMAND: u16 = 1 << 1;
const PARITY_ERROR: u16 = 1 << 2;
/// Of a command: read, and its address. Of an answer: error flag. Of both: even parity.
const READ: u16 = 1 << 14;
const ADDRESS: u16 = 0x3FFF;
const ERROR_FLAG: u16 = 1 << 14;
const PARITY: u16 = 1 << 15;
/// Registers NOP, ERRFL, DIAAGC, ANGLECOM; the sensor has more.
const NO_OPERATION: u16 = 0x0000;
const ERROR_REGISTER: u16 = 0x0001;
const DIAGNOSIS_REGISTER: u16 = 0x3FFC;
const ANGLE_REGISTER: u16 = 0x3FFF;
/// Of DIAAGC: MAGL; and the gain for a usual field.
const MAGNET_WEAK: u16 = 1 << 11;
const USUAL_GAIN: u16 = 110;

impl RotorSensor {
    /// Executes the last command: its answer is that of the next frame.
    fn execute(&mut self) {
        let gripper = &mut *self.0.borrow_mut();
        let RotorLine { command, errors, .. } = &mut gripper.rotor;
        let command = gripper.errors.command.as_mut().map_or(*command, |change| change(*command));
        if command.count_ones() % 2 == 1 {
            *errors |= PARITY_ERROR;
        } else if command & READ == 0 && command != NO_OPERATION {
            *errors |= INVALID_COMMAND;
        }
        let flag = if *errors == 0 { 0 } else { ERROR_FLAG };
        let data = match command & ADDRESS {
            ANGLE_REGISTER if gripper.errors.has_no_magnet => {
                gripper.rig.plant.angle().wrapping_mul(0x2F35)
            }
            ANGLE_REGISTER => gripper.rig.plant.angle(),
            DIAGNOSIS_REGISTER if gripper.errors.has_no_magnet => {
                as5047::diagnosis::READY | MAGNET_WEAK | as5047::diagnosis::GAIN
            }
            DIAGNOSIS_REGISTER => as5047::diagnosis::READY | USUAL_GAIN,
            // Reading it clears it.
            ERROR_REGISTER => std::mem::take(errors),
            NO_OPERATION => 0,
            _ => {
                *errors |= INVALID_COMMAND;
                0
            }
        };
        let word = data & as5047::DATA | flag;
        let answer = if word.count_ones() % 2 == 1 { word | PARITY } else { word };
        let frame = &mut gripper.errors.frame;
        gripper.rotor.answer = frame.as_mut().map_or(answer, |frame| frame(answer));
    }
}

impl SpiDevice for RotorSensor {
    fn select(&mut self, _: Time, is_selected: bool) {
        if !is_selected {
            self.execute();
        }
    }

    fn transfer(&mut self, _: Time, frame: u16) -> u16 {
        let rotor = &mut self.0.borrow_mut().rotor;
        rotor.command = frame;
        rotor.answer
    }
}

/// Its motor as seen by the board.
pub struct GripperMotor(pub SharedGripper);

impl SimulatedMotor for GripperMotor {
    fn status(&mut self, time_us: u64) -> Timed<MotorStatus> {
        let mut gripper = self.0.borrow_mut();
        gripper.advance(time_us);
        gripper.status
    }

    fn order(&mut self, time_us: u64, order: MotorCommand) -> Result<(), MotorCommand> {
        let mut gripper = self.0.borrow_mut();
        gripper.advance(time_us);
        match gripper.pending_order {
            Some(_) => Err(order),
            None => {
                gripper.pending_order = Some(order);
                Ok(())
            }
        }
    }

    fn thermistors(&mut self) -> [u16; 2] {
        self.0.borrow().temperatures_c.map(thermistor_counts)
    }

    fn restart(&mut self, time_us: u64) {
        let mut gripper = self.0.borrow_mut();
        gripper.advance(time_us);
        gripper.rig.restart();
        (gripper.pending_order, gripper.status) = (None, Timed::default());
    }
}

//! Force on something soft, such as a hand or an arm, between or around the fingers, outside of a commanded grip.

use crate::closed_loop::grasp_rig::contact_object;
use crate::closed_loop::{ClosedLoop, ClosedLoopSetup};
use crate::drivetrain::parameters::Lead;
use crate::faults::injection::InjectedFault;
use crate::faults::operating_state::{HAND_N_PER_MM, motion};
use crate::random::{Purpose, stream};
use firmware::config::constants;
use firmware::grip::commands::{flag, mode};
use firmware::grip::states::PowerState;
use firmware::motor::calibration::CalibrationKind;
use firmware::protocol::messages::Command;
use firmware::protocol::session::op;
use model_export::inverse::quantise::TableSet;
use rand::RngExt;

/// Maximum error of both fingers' forces by a wrong tare, in N.
const OFFSET_N: f64 = 8.0;
/// Distances of the hand in mm, and speeds of moves in mm/s.
const DISTANCES_MM: [f64; 2] = [2.0, 20.0];
const SPEEDS_MM_S: [f64; 2] = [5.0, 58.0];
/// Stiffness of a rigid part in N/mm: the motor's calibration moves the fingers too little to press on a hand.
const RIGID: f64 = constants::CONTACT_STIFFNESS.value;
/// Time between repeated commands in s.
const REPEAT_S: f64 = 0.5;

/// A motion that meets an obstacle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObstructedMotion {
    /// A move closes on a hand.
    Move,
    /// Moves that begin in contact, eight times.
    RepeatedMove,
    /// A move whose host does not believe the forces, eight times.
    UncalibratedMove,
    /// Homing closes on a hand, twice.
    Home,
    /// Homing opens inside of something soft.
    HomeInside,
    /// The fingers open inside of something soft, four times.
    Release,
    /// The same without any sensor.
    ReleaseWithoutSensors,
    /// The motor is calibrated with the fingers on a rigid part.
    CalibrateMotor,
    /// The screw is calibrated on a hand instead of a part.
    CalibrateScrew,
}

impl ObstructedMotion {
    /// All motions.
    pub const ALL: [Self; 9] = [
        Self::Move,
        Self::RepeatedMove,
        Self::UncalibratedMove,
        Self::Home,
        Self::HomeInside,
        Self::Release,
        Self::ReleaseWithoutSensors,
        Self::CalibrateMotor,
        Self::CalibrateScrew,
    ];

    /// Description.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Move => "MOVE closes on a hand",
            Self::RepeatedMove => "MOVE begins on a hand, 8 times",
            Self::UncalibratedMove => "MOVE without believed forces closes on a hand, 8 times",
            Self::Home => "HOME closes on a hand, twice",
            Self::HomeInside => "HOME opens inside of a soft ring",
            Self::Release => "RELEASE inside of a soft ring, 4 times",
            Self::ReleaseWithoutSensors => "RELEASE inside of a soft ring, no sensor, 4 times",
            Self::CalibrateMotor => "motor calibration, fingers on a rigid part",
            Self::CalibrateScrew => "screw calibration on a hand",
        }
    }

    /// Switches its protection off.
    pub const fn disable(self) -> fn(&mut ClosedLoopSetup) {
        match self {
            Self::Move => |setup| (setup.grasp.contact_n, setup.grasp.move_n) = (1e6, 1e6),
            Self::RepeatedMove | Self::CalibrateMotor => |setup| setup.grasp.move_n = 1e6,
            Self::UncalibratedMove => |setup| setup.grasp.uncalibrated_a = 9.6,
            Self::Home => |setup| setup.grasp.home_n = 1e6,
            Self::HomeInside | Self::Release => |setup| setup.grasp.outward_n = 1e6,
            Self::ReleaseWithoutSensors => |setup| setup.grasp.blind_rise_a = 1e6,
            Self::CalibrateScrew => |setup| setup.grasp.part_n_per_mm = 0.0,
        }
    }

    const fn opens(self) -> bool {
        matches!(self, Self::HomeInside | Self::Release | Self::ReleaseWithoutSensors)
    }
}

/// A random gripper and obstacle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactCase {
    /// Motion.
    pub motion: ObstructedMotion,
    /// Screw.
    pub lead: Lead,
    /// Error of both fingers' forces in N.
    pub offset_n: f64,
    /// Contact point along the fingers ([`ClosedLoopSetup::towards_first`]).
    pub towards_first: f64,
    /// Distance of the obstacle in mm.
    pub distance_mm: f64,
    /// Commanded speed in mm/s.
    pub speed_mm_s: f64,
    /// Seed of the gripper and its noise.
    pub seed: u64,
}

impl ContactCase {
    /// Draws a case; the screws alternate.
    pub fn draw(motion: ObstructedMotion, seed: u64) -> Self {
        let mut rng = stream(seed, Purpose::FaultInjection, motion as u32);
        let mut between = |[from, to]: [f64; 2]| rng.random_range(from..=to);
        Self {
            motion,
            lead: Lead::BOTH[seed as usize % 2],
            offset_n: between([-OFFSET_N, OFFSET_N]),
            towards_first: between([-0.8, 0.8]),
            distance_mm: between(DISTANCES_MM),
            speed_mm_s: between(SPEEDS_MM_S),
            seed,
        }
    }

    /// Peak true force on the obstacle in N; none where the motion did not begin.
    pub fn run(&self, tables: &TableSet, change: Option<fn(&mut ClosedLoopSetup)>) -> Option<f64> {
        let mut setup = ClosedLoopSetup {
            opening_mm: match self.motion {
                ObstructedMotion::HomeInside => 3.0,
                motion if motion.opens() => 30.0,
                _ => 50.0,
            },
            is_homed: !matches!(self.motion, ObstructedMotion::Home | ObstructedMotion::HomeInside),
            offset_n: self.offset_n,
            towards_first: self.towards_first,
            ..ClosedLoopSetup::scattered(self.lead, self.seed)
        };
        if let Some(change) = change {
            change(&mut setup);
        }
        let mut cell = ClosedLoop::new(&setup, tables);
        let is_enabled = match self.motion {
            ObstructedMotion::CalibrateMotor | ObstructedMotion::CalibrateScrew => {
                cell.is_ready_within(1.0)
            }
            _ => cell.enable(),
        };
        if !is_enabled {
            return None;
        }
        cell.run(0.3);
        self.place_obstacle(&cell, &setup);
        self.drive(&mut cell)?;
        let gripper = cell.gripper.borrow();
        Some(if self.motion.opens() { gripper.outward_peak_n } else { gripper.peak_n })
    }

    fn place_obstacle(&self, cell: &ClosedLoop, setup: &ClosedLoopSetup) {
        let plant = &mut cell.gripper.borrow_mut().rig.plant;
        let opening_mm = 1e3 * plant.opening_m();
        let (distance_mm, stiffness) = match self.motion {
            ObstructedMotion::CalibrateMotor => (0.0, RIGID),
            // Farther than the closed fingers.
            ObstructedMotion::HomeInside => (15.0 + self.distance_mm, HAND_N_PER_MM),
            _ => (self.distance_mm, HAND_N_PER_MM),
        };
        let object = |width_mm| contact_object(&setup.plant, width_mm, stiffness);
        if self.motion.opens() {
            plant.set_outer_object(Some(&object(opening_mm + distance_mm)));
        } else {
            plant.set_object(Some(&object(opening_mm - distance_mm)));
        }
    }

    fn drive(&self, cell: &mut ClosedLoop) -> Option<()> {
        let closing_s = self.distance_mm / 5.0;
        match self.motion {
            ObstructedMotion::Move => self.repeat(cell, mode::MOVE, 1, self.reach_s()),
            ObstructedMotion::RepeatedMove | ObstructedMotion::UncalibratedMove => {
                self.repeat(cell, mode::MOVE, 8, self.reach_s());
            }
            ObstructedMotion::Home => self.repeat(cell, mode::HOME, 2, closing_s + 1.0),
            ObstructedMotion::HomeInside => self.repeat(cell, mode::HOME, 1, 4.0),
            ObstructedMotion::Release => self.repeat(cell, mode::RELEASE, 4, self.reach_s()),
            ObstructedMotion::ReleaseWithoutSensors => {
                InjectedFault::AllSensorsGone.inject(cell, 0);
                cell.run(0.3);
                self.repeat(cell, mode::RELEASE, 4, self.distance_mm / 5.0 + 0.5);
            }
            ObstructedMotion::CalibrateMotor => calibrate(cell, CalibrationKind::Motor, 4.0)?,
            ObstructedMotion::CalibrateScrew => {
                calibrate(cell, CalibrationKind::Screw, closing_s + 3.0)?
            }
        }
        Some(())
    }

    /// Time to the obstacle in s, and some more.
    fn reach_s(&self) -> f64 {
        self.distance_mm / self.speed_mm_s + REPEAT_S
    }

    fn repeat(&self, cell: &mut ClosedLoop, mode: u8, times: u8, first_s: f64) {
        let target_mm = if self.motion.opens() { 75.0 } else { 2.0 };
        for round in 0..times {
            let again = if round % 2 == 0 { 0 } else { flag::AGAIN };
            let is_uncalibrated = self.motion == ObstructedMotion::UncalibratedMove;
            let flags = again | if is_uncalibrated { flag::UNCALIBRATED } else { 0 };
            let command = match mode {
                mode::HOME => Command { mode, ..Command::default() },
                mode => motion(mode, target_mm, self.speed_mm_s),
            };
            cell.host.order(Command { flags, ..command });
            cell.run(if round == 0 { first_s } else { REPEAT_S });
        }
    }
}

fn calibrate(cell: &mut ClosedLoop, kind: CalibrationKind, seconds: f64) -> Option<()> {
    cell.host.service(op::MEASURE, kind as u32);
    cell.until(0.2, |cell| cell.state() == PowerState::Calibrating as u8)?;
    cell.until(seconds, |cell| cell.state() != PowerState::Calibrating as u8);
    cell.run(0.1);
    Some(())
}

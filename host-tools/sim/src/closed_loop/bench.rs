//! A gripper with hidden effects on a test bench, controlled by the image in an emulated chip.
//!
//! The bench presses on every fingertip in turn with its rest, changes the temperatures, and an arm moves the gripper. The
//! board sees sensor registers, bus frames and nothing else: opening, motor current and rotor angle come from its own
//! encoder and current sensors, acceleration and tilt from its inertial sensor. A host homes the gripper, moves it while
//! it is unloaded, and sends the yaw.
//!
//! The effects are those of [`crate::campaign`]; here they act on a board that runs.

use std::cell::RefCell;
use std::rc::Rc;

use anyhow::{Result, bail};
use emulator::{Image, Time};
use firmware::compensation::covariates::AttitudeSample;
use firmware::grip::commands::{flag, mode};
use firmware::grip::states::TaskState;
use firmware::protocol::messages::{Command, HostAttitude, Message};
use firmware::protocol::serial::{Packet, PacketDecoder};
use firmware::protocol::session::{UNLOADED, op, status};
use firmware::sensors::hall::SENSORS;
use firmware::system::faults::Fault;
use rand_chacha::ChaCha8Rng;

use crate::closed_loop::ClosedLoop;
use crate::closed_loop::bench_programme::{
    BenchProgramme, BenchSetup, HOMING_S, LOADED_S, PERIOD_S,
};
use crate::closed_loop::coupling::{GripperWorld, SimulatedGripper};
use crate::closed_loop::emulated_board::{ChipConditions, EmulatedBoard};
use crate::closed_loop::motor_rig::MotorRig;
use crate::drivetrain::fingertips::Fingertips;
use crate::drivetrain::parameters::{Lead, PlantParameters};
use crate::effects::Effects;
use crate::random::{Purpose, stream, uniform};

/// Time until the tables have been checked after a boot, in seconds.
const START_S: f64 = 0.4;
/// Pause of the fingertips between recordings, as in a simulated campaign.
const PAUSE_S: f64 = 600.0;
/// Openings that the host commands, in millimetres; small ones are more frequent, because there the fields change most.
const OPENING_MM: [f64; 2] = [0.5, 35.0];
/// Largest distance from a commanded opening at which it is reached, in millimetres.
const REACHED_MM: f64 = 0.3;
/// Opening at power-on, in millimetres.
const START_MM: f64 = 3.0;
/// Time until a motion that did not begin or was stopped is commanded again, in microseconds: the state arrives with the next
/// heartbeat.
const RETRY_US: u64 = 100_000;
/// Period of the yaw in milliseconds.
const YAW_MS: u64 = 40;

/// Task of the host within a period of the programme.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum HostTask {
    /// Nothing to do until the next period.
    Waiting,
    /// Clears faults and enables.
    Enabling,
    /// Moves to an opening.
    Moving,
}

/// A gripper on the bench, and the host that controls it.
pub struct EmulatedBench {
    /// Board, gripper and host.
    pub cell: ClosedLoop<EmulatedBoard>,
    programme: Rc<BenchProgramme>,
    decoder: PacketDecoder,
    task: HostTask,
    /// Opening of the last move command in millimetres, and the number of its period.
    target: (f64, u64),
    /// Openings.
    rng: ChaCha8Rng,
    toggled: bool,
    /// Time of the last command in microseconds.
    ordered_us: u64,
    /// Motions that the host commanded and that reached their target.
    moves: [u32; 2],
}

impl EmulatedBench {
    /// Powers a board on with an image.
    ///
    /// # Errors
    /// An effect is given twice, or the chip does not start.
    pub fn power_on(image: Image, conditions: ChipConditions, setup: &BenchSetup) -> Result<Self> {
        let effects = Effects::new(&setup.effects, setup.seed, SENSORS as u32, setup.scatter)?;
        let programme = Rc::new(BenchProgramme::new(setup, &effects));
        let max_n = |sensor| {
            let excitations = programme.excitations.iter();
            let loads = excitations.map(|excitation| excitation.max_load(sensor as usize));
            loads.fold([0.0_f64; 2], |[x, z], [other_x, other_z]| [x.max(other_x), z.max(other_z)])
        };
        let tips =
            Fingertips::with_effects(setup.seed, setup.scatter, &setup.mountings, &effects, max_n);
        let rig = MotorRig::new(Lead::A, PlantParameters::nominal(Lead::A), START_MM, setup.seed);
        let mut gripper = SimulatedGripper::new(rig, tips, setup.excitation_seed);
        gripper.bench = Some(programme.clone());
        let gripper = Rc::new(RefCell::new(gripper));
        let world = Box::new(GripperWorld(gripper.clone()));
        let board = EmulatedBoard::start(image, conditions, world, gripper.clone())?;
        Ok(Self {
            cell: ClosedLoop::from_board(board, gripper),
            programme,
            decoder: PacketDecoder::default(),
            task: HostTask::Waiting,
            target: (START_MM, 0),
            rng: stream(setup.excitation_seed, Purpose::Strokes, 0),
            toggled: false,
            ordered_us: 0,
            moves: [0; 2],
        })
    }

    /// Time of the plant in seconds.
    pub fn time_s(&self) -> f64 {
        self.cell.gripper.borrow().rig.plant.time_s()
    }

    /// Programme of the bench.
    pub fn programme(&self) -> &BenchProgramme {
        &self.programme
    }

    /// Waits until the board has started.
    ///
    /// # Errors
    /// The board cannot continue.
    pub fn start(&mut self) -> Result<()> {
        let end_s = self.time_s() + START_S;
        while self.time_s() < end_s {
            self.tick()?;
        }
        Ok(())
    }

    /// Homes the unloaded gripper, after a tare if its tables are not fitted to it.
    ///
    /// # Errors
    /// The board refuses a command, or homing fails.
    pub fn home(&mut self, needs_tare: bool) -> Result<()> {
        self.start()?;
        if needs_tare {
            self.tare()?;
        }
        if !self.cell.enable() {
            bail!("not enabled: {}", self.report());
        }
        self.order(mode::HOME);
        self.wait_until("not homed", |bench| bench.cell.is_in(TaskState::Idle))?;
        self.target.0 = OPENING_MM[1];
        self.order(mode::MOVE);
        self.wait_until("not moved", Self::has_arrived)?;
        self.disable();
        Ok(())
    }

    fn has_arrived(&self) -> bool {
        let opening_mm = 1e3 * self.cell.gripper.borrow().rig.plant.opening_m();
        self.cell.is_in(TaskState::Idle) && (opening_mm - self.target.0).abs() < REACHED_MM
    }

    /// Waits for a condition until the first recording begins.
    fn wait_until(&mut self, problem: &str, condition: impl Fn(&Self) -> bool) -> Result<()> {
        while !condition(self) {
            self.tick()?;
            if self.time_s() > HOMING_S {
                bail!("{problem}: {}", self.report());
            }
        }
        Ok(())
    }

    /// Defines the present forces as zero.
    fn tare(&mut self) -> Result<()> {
        let replies = self.cell.host.received.replies.len();
        // With the tables of another gripper the unloaded fingers may seem to press.
        self.cell.host.service(op::TARE, UNLOADED);
        for _ in 0..3000 {
            self.tick()?;
            let replies = self.cell.host.received.replies.get(replies..).unwrap_or_default();
            if let Some((_, reply)) = replies.iter().find(|(_, reply)| reply.op == op::TARE) {
                if reply.status != status::DONE {
                    bail!("tare refused: {reply:?}");
                }
                return Ok(());
            }
        }
        bail!("no reply to the tare")
    }

    /// Motions, and the first faults that the board reported, for error messages.
    pub fn report(&self) -> String {
        let faults = self.cell.host.received.faults.iter().filter(|(_, event)| event.active == 1);
        let mut names: Vec<String> = Vec::new();
        for (_, event) in faults {
            let fault = Fault::ALL.into_iter().find(|fault| *fault as u16 == event.code);
            let name = fault.map_or_else(|| event.code.to_string(), |fault| format!("{fault:?}"));
            if !names.contains(&name) {
                names.push(name);
            }
        }
        let [commanded, reached] = self.moves;
        let opening_mm = 1e3 * self.cell.gripper.borrow().rig.plant.opening_m();
        format!(
            "state {}, opening {opening_mm:.2} mm, {reached} of {commanded} motions, faults: {}",
            self.cell.state(),
            names.join(", ")
        )
    }

    /// Runs until a recording, counted from 0, begins.
    ///
    /// # Errors
    /// The board cannot continue.
    pub fn run_to(&mut self, recording: usize) -> Result<()> {
        if recording > 0 {
            self.cell.gripper.borrow_mut().pause_fingertips(PAUSE_S);
        }
        while self.time_s() < self.programme.begin_s(recording) {
            self.tick()?;
        }
        // The periods of each recording are counted from 0, and the first has no motion.
        self.target.1 = 0;
        // Bytes of the line that nobody reads are lost.
        self.cell.board.take_sent();
        self.decoder = PacketDecoder::default();
        Ok(())
    }

    /// Advances a recording by a millisecond: the packets of the serial line with the times of their ends in seconds of the
    /// plant.
    ///
    /// # Errors
    /// The board cannot continue.
    pub fn record(&mut self) -> Result<Vec<(f64, Packet)>> {
        self.control();
        self.cell.step()?;
        let now_s = self.time_s();
        let now = Time::from_us(self.cell.time_us());
        let packets = self.cell.board.take_packets(&mut self.decoder).into_iter();
        Ok(packets.map(|(end, packet)| (now_s - now.since(end).as_s(), packet)).collect())
    }

    /// Advances by a millisecond and keeps the bytes of the serial line.
    ///
    /// # Errors
    /// The board cannot continue.
    pub fn step(&mut self) -> Result<()> {
        self.send_yaw();
        self.cell.step()
    }

    /// Advances by a millisecond.
    fn tick(&mut self) -> Result<()> {
        self.send_yaw();
        self.cell.try_tick()
    }

    fn send_yaw(&mut self) {
        if (self.cell.time_us() / 1000).is_multiple_of(YAW_MS) {
            let [_, _, yaw] = self.programme.orientation(self.time_s()).angles_rad;
            let yaw = (yaw * f64::from(AttitudeSample::PER_RAD)).round() as i16;
            let attitude = HostAttitude { yaw, yaw_only: true, ..HostAttitude::default() };
            self.cell.host.send(Message::HostAttitude(attitude));
        }
    }

    /// Moves the gripper at the begin of each period, and disables it before the load rises.
    fn control(&mut self) {
        self.send_yaw();
        let (_, since_s) = self.programme.at(self.time_s());
        let period = (since_s / PERIOD_S).floor().max(0.0) as u64;
        let phase_s = since_s.rem_euclid(PERIOD_S);
        if phase_s >= LOADED_S[0] - 0.05 || period == 0 {
            if self.task != HostTask::Waiting {
                self.task = HostTask::Waiting;
                self.moves[1] += u32::from(self.has_arrived());
                self.disable();
            }
            return;
        }
        match self.task {
            HostTask::Waiting if self.target.1 != period => {
                let share = uniform(&mut self.rng, 0.0, 1.0);
                let [min_mm, max_mm] = OPENING_MM;
                self.target = (min_mm + (max_mm - min_mm) * share * share, period);
                self.moves[0] += 1;
                self.cell.host.service(op::CLEAR_FAULTS, 0);
                self.order(mode::ENABLE);
                self.task = HostTask::Enabling;
            }
            HostTask::Enabling if self.cell.is_in(TaskState::Idle) => {
                self.order(mode::MOVE);
                self.task = HostTask::Moving;
            }
            // A motion that did not begin is commanded again.
            HostTask::Moving
                if self.cell.time_us() > self.ordered_us + RETRY_US
                    && self.cell.is_in(TaskState::Idle)
                    && !self.has_arrived() =>
            {
                self.order(mode::MOVE);
            }
            _ => {}
        }
    }

    fn disable(&mut self) {
        self.order(mode::DISABLE);
    }

    /// Sends a command; two equal ones in a row are both executed.
    fn order(&mut self, mode: u8) {
        self.toggled = !self.toggled;
        self.ordered_us = self.cell.time_us();
        // Until the calibration, effects look like contacts.
        let uncalibrated = if mode == mode::MOVE { flag::UNCALIBRATED } else { 0 };
        self.cell.host.order(Command {
            mode,
            position: (20.0 * self.target.0) as u16,
            speed: 230,
            flags: uncalibrated | if self.toggled { flag::AGAIN } else { 0 },
            ..Command::default()
        });
    }
}

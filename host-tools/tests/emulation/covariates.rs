//! What the image knows besides the fields: opening and rotor from its own encoder and homing, acceleration and tilt from its
//! inertial sensor, yaw from a host, temperatures from its thermistors.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use firmware::compensation::covariates::Covariates;
use firmware::config::constants::TICK_US;
use firmware::grip::commands::mode;
use firmware::grip::states::TaskState;
use firmware::protocol::messages::{Command, HostAttitude, Message};
use firmware::protocol::opening_mm;
use firmware::protocol::serial::{Packet, PacketDecoder, Tick};
use firmware::system::faults::Fault;
use libtest_mimic::{Failed, Trial};
use sim::board::SimulatedBoard;

use crate::boards::violations;
use crate::motion::{Cell, cell};

pub fn trials() -> Vec<Trial> {
    vec![
        Trial::test("covariates_of_a_moving_gripper", moving),
        Trial::test("covariates_of_attitude_and_failing_sensor", attitude),
        Trial::test("covariates_of_temperature", temperature),
    ]
}

/// True rotor angle and opening at a time.
#[derive(Clone, Copy, Debug)]
struct Truth {
    time_us: f64,
    angle_rad: f64,
    opening_mm: f64,
}

/// A workcell with the ticks of its serial line and the truth at each.
struct Observed {
    cell: Cell,
    decoder: PacketDecoder,
    truth: VecDeque<Truth>,
    /// Last tick.
    tick: Option<Tick>,
    now_us: u64,
}

impl Observed {
    fn new(cell: Cell) -> Self {
        let now_us = cell.time_us();
        let (decoder, truth) = (PacketDecoder::default(), VecDeque::new());
        Self { cell, decoder, truth, tick: None, now_us }
    }

    fn covariates(&self) -> Covariates {
        self.tick.as_ref().map(|tick| tick.covariates).unwrap_or_default()
    }

    /// Runs for a time; `check` sees every tick with the truth at its beginning.
    fn run(
        &mut self,
        seconds: f64,
        mut check: impl FnMut(&Covariates, Truth),
    ) -> Result<(), Failed> {
        const STEP_US: u64 = 50;
        let end_us = self.now_us + (1e6 * seconds) as u64;
        while self.now_us < end_us {
            if self.now_us.is_multiple_of(TICK_US) {
                self.cell.host.tick();
            }
            self.now_us += STEP_US;
            self.cell.board.run_until(self.now_us)?;
            let gripper = self.cell.gripper.borrow();
            self.truth.push_back(Truth {
                time_us: self.now_us as f64,
                angle_rad: gripper.rig.plant.train.angle_rad,
                opening_mm: 1e3 * gripper.rig.plant.opening_m(),
            });
            drop(gripper);
            if self.truth.len() > 200 {
                self.truth.pop_front();
            }
            // The board's clock starts with its program.
            let (counter_us, period_us) = self.cell.board.chip.soc.time_base();
            for (_, packet) in self.cell.board.take_packets(&mut self.decoder) {
                let Packet::Tick(tick) = packet else { continue };
                let begun_us = u64::from(tick.time_us) % period_us;
                let age_us = (counter_us + period_us - begun_us) % period_us;
                if let Some(truth) = self.truth_at(self.now_us as f64 - age_us as f64) {
                    check(&tick.covariates, truth);
                }
                self.tick = Some(tick);
            }
        }
        Ok(())
    }

    fn truth_at(&self, time_us: f64) -> Option<Truth> {
        let after = self.truth.iter().position(|truth| truth.time_us >= time_us)?;
        let (before, after) = (self.truth.get(after.checked_sub(1)?)?, self.truth.get(after)?);
        let share = (time_us - before.time_us) / (after.time_us - before.time_us);
        let between = |from: f64, to: f64| from + share * (to - from);
        Some(Truth {
            time_us,
            angle_rad: between(before.angle_rad, after.angle_rad),
            opening_mm: between(before.opening_mm, after.opening_mm),
        })
    }
}

/// Difference of an angle in 2^-16 turns from one in radians, in radians.
fn angle_error(turn: u16, angle_rad: f64) -> f64 {
    let difference = f64::from(turn) / 65_536.0 - angle_rad / TAU;
    (difference - difference.round()) * TAU
}

fn moving() -> Result<(), Failed> {
    let mut observed = Observed::new(cell(3.0)?);
    assert!(observed.cell.enable());
    observed.now_us = observed.cell.time_us();
    observed.run(0.05, |covariates, _| assert_eq!(covariates.opening_um, None))?;
    let status = observed.cell.host.received.status.unwrap().1;
    assert_eq!(opening_mm(&status), None, "before homing the opening is unknown");
    observed.cell.host.order(Command { mode: mode::HOME, ..Command::default() });
    for _ in 0..200 {
        observed.run(0.1, |_, _| {})?;
        if observed.cell.is_in(TaskState::Idle) {
            break;
        }
    }
    assert!(observed.cell.is_in(TaskState::Idle), "{}", observed.cell.state());
    // At full speed an age of a millisecond would be 0.06 mm and 0.11 rad.
    let (mut worst_mm, mut worst_rad, mut ticks) = (0.0_f64, 0.0_f64, 0);
    let position = (20.0 * 60.0) as u16;
    observed.cell.host.order(Command {
        mode: mode::MOVE,
        position,
        speed: 233,
        ..Command::default()
    });
    observed.run(1.5, |covariates, truth| {
        let opening_mm = 1e-3 * f64::from(covariates.opening_um.unwrap());
        worst_mm = worst_mm.max((opening_mm - truth.opening_mm).abs());
        let turn = covariates.motor.unwrap().turn;
        worst_rad = worst_rad.max(angle_error(turn, truth.angle_rad).abs());
        ticks += 1;
    })?;
    println!("{ticks} ticks; opening within {worst_mm:.3} mm, rotor within {worst_rad:.4} rad");
    assert!(ticks > 1400, "{ticks}");
    assert!(worst_mm < 0.05, "{worst_mm} mm");
    assert!(worst_rad < 0.02, "{worst_rad} rad");
    assert_eq!(violations(&observed.cell.board), [""; 0]);
    Ok(())
}

fn attitude() -> Result<(), Failed> {
    let mut observed = Observed::new(cell(20.0)?);
    observed.run(0.3, |_, _| {})?;
    let covariates = observed.covariates();
    let acceleration = covariates.acceleration.unwrap();
    let [x, y, z] = acceleration.mm_s2;
    assert!(x.abs() < 150 && y.abs() < 150 && (z - 9807).abs() < 150, "{acceleration:?}");
    assert!((-1000..2000).contains(&acceleration.age_us), "{acceleration:?}");
    assert_eq!(covariates.attitude, None, "without a yaw");
    let attitude = HostAttitude { yaw: 12_000, age: 5, yaw_only: true, ..HostAttitude::default() };
    observed.cell.host.send(Message::HostAttitude(attitude));
    observed.run(0.02, |_, _| {})?;
    let known = observed.covariates().attitude.unwrap();
    let [roll, pitch, yaw] = known.euler;
    assert!(roll.abs() < 150 && pitch.abs() < 150 && yaw == 12_000, "{known:?}");
    assert!((20..30).contains(&known.age_ms), "{known:?}");
    observed.run(0.1, |_, _| {})?;
    assert_eq!(observed.covariates().attitude, None, "the yaw is old");
    let connections = observed.cell.board.connections().clone();
    connections.inertial.borrow_mut().unplugged = true;
    observed.run(0.02, |_, _| {})?;
    assert_eq!(observed.covariates().acceleration, None, "without an inertial sensor");
    connections.inertial.borrow_mut().unplugged = false;
    observed.run(1.2, |_, _| {})?;
    assert!(observed.covariates().acceleration.is_some(), "connected again");
    connections.inertial.borrow_mut().frozen = true;
    observed.run(0.08, |_, _| {})?;
    assert_eq!(observed.covariates().acceleration, None, "it repeats its outputs");
    assert_eq!(violations(&observed.cell.board), [""; 0]);
    Ok(())
}

fn temperature() -> Result<(), Failed> {
    let mut cell = crate::motion::homed()?;
    let power = cell.host.received.power.unwrap().1;
    println!("{power:?}");
    assert!((24..=26).contains(&power.mcu) && (24..=26).contains(&power.motor), "{power:?}");
    // Braking charges the capacitors; nothing flows back into the supply.
    assert!((2300..=2700).contains(&power.bus), "{power:?}");
    cell.gripper.borrow_mut().temperatures_c = [60.0, 115.0];
    cell.run(0.25);
    let power = cell.host.received.power.unwrap().1;
    assert!((59..=61).contains(&power.motor), "{power:?}");
    let hot = cell.host.received.faults.iter().find(|(_, fault)| fault.code == Fault::Hot as u16);
    assert!(hot.is_some(), "{:?}", cell.host.received.faults);
    Ok(())
}

//! The first power-up of a board that was never operated, by the steps of `magpie board bringup`, and each planted fault at its step.

use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;

use anyhow::Result;
use device::bringup::{self, Action, Expected, Operator, Reading, Record, StepFailure, StepRecord};
use device::emulation::line::EmulatedLine;
use device::params_client;
use device::session::Credentials;
use firmware::config::constants;
use firmware::grip::commands::RefusalReason;
use firmware::parameters::schema::id;
use firmware::protocol::session::op;
use libtest_mimic::{Failed, Trial};
use sim::board::world::{World, WorldSample};
use sim::closed_loop::coupling::{GripperWorld, SharedGripper};
use sim::closed_loop::emulated_board::{EmulatedBoard, wiring};
use sim::closed_loop::grasp_rig::grip_command;
use sim::drivetrain::parameters::{Lead, PlantParameters, SCATTER};

use crate::Effort;
use crate::boards::{TYPICAL, gripper, image, violations};
use crate::images::Variant;
use crate::motion::Cell;

/// Boards without a fault, of which each differs by [`SCATTER`]; before a release.
const GOOD: [u64; 2] = [1, 20];

/// What is wrong with a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Planted {
    SingleBank,
    OneAddress,
    OtherFinger,
    OpenThermistor,
    NoMagnet,
    FloatingBreak,
    ExchangedSenses,
    InvertedShunt,
    HalfTorque,
}

/// Each with the step that finds it.
const PLANTED: [(Planted, usize); 9] = [
    (Planted::SingleBank, 1),
    (Planted::OneAddress, 3),
    (Planted::OtherFinger, 3),
    (Planted::OpenThermistor, 3),
    (Planted::NoMagnet, 4),
    (Planted::FloatingBreak, 6),
    (Planted::ExchangedSenses, 8),
    (Planted::InvertedShunt, 8),
    (Planted::HalfTorque, 8),
];

pub fn trials(effort: Effort) -> Vec<Trial> {
    let mut trials: Vec<Trial> = PLANTED
        .into_iter()
        .map(|(planted, step)| {
            Trial::test(format!("bringup_finds_{planted:?}"), move || finds(planted, step))
        })
        .collect();
    let good = GOOD[usize::from(effort == Effort::Acceptance)];
    trials
        .extend((1..=good).map(|seed| {
            Trial::test(format!("bringup_of_good_board_{seed}"), move || passes(seed))
        }));
    trials
}

type SharedCell = Rc<RefCell<Cell>>;

/// A person at an emulated board.
struct Person {
    cell: SharedCell,
    planted: Option<Planted>,
}

impl Operator for Person {
    fn act(&mut self, action: Action) -> Result<()> {
        let cell = &mut *self.cell.borrow_mut();
        match action {
            Action::Connect { step: 7, .. } => {
                cell.gripper.borrow_mut().rig.plant.set_supply(12.0);
            }
            Action::Connect { .. } => {}
            Action::Press(finger) => cell.gripper.borrow_mut().pressed_n[finger] = 20.0,
            Action::LetGo => cell.gripper.borrow_mut().pressed_n = [0.0; 2],
            Action::Turn => cell.gripper.borrow_mut().rig.plant.train.angle_rad += 1.5,
            Action::OpenBreak => cell.board.chip.soc.set_break_wire_open(true),
            Action::CloseBreak => {
                let is_open = self.planted == Some(Planted::FloatingBreak);
                cell.board.chip.soc.set_break_wire_open(is_open);
            }
            Action::Weight(newtons) => cell.gripper.borrow_mut().pressed_n[0] = newtons,
        }
        Ok(())
    }

    fn read(&mut self, _: Reading) -> Result<f64> {
        Ok(0.0)
    }
}

/// Two fingers whose plugs are exchanged at one sensor.
struct Exchanged(GripperWorld);

impl World for Exchanged {
    fn next(&mut self) -> Option<WorldSample> {
        let mut sample = self.0.next()?;
        sample.readings.swap(1, 2);
        Some(sample)
    }
}

/// A board that was never operated.
fn unused(seed: u64, planted: Option<Planted>, is_supplied: bool) -> Result<(SharedCell, Person)> {
    let made = image(Variant::Nominal).map_err(|failed| anyhow::anyhow!("{failed:?}"))?;
    let mut plant = PlantParameters::scattered(Lead::A, SCATTER, seed);
    plant.supply.voltage_v = if is_supplied { 12.0 } else { 0.0 };
    if planted == Some(Planted::HalfTorque) {
        plant.windings.flux_wb = 0.5 * PlantParameters::nominal(Lead::A).windings.flux_wb;
    }
    let gripper: SharedGripper = gripper(plant, 11.0, seed);
    let world = GripperWorld(gripper.clone());
    let world: Box<dyn World> = match planted {
        Some(Planted::OtherFinger) => Box::new(Exchanged(world)),
        _ => Box::new(world),
    };
    let image = made.image.clone();
    let mut board = EmulatedBoard::unused(image, TYPICAL, wiring(), world, gripper.clone())?;
    {
        let errors = &mut gripper.borrow_mut().errors;
        match planted {
            Some(Planted::ExchangedSenses) => {
                errors.counts = Some(Box::new(|[u, v, w, bus]| [u, w, v, bus]));
            }
            Some(Planted::InvertedShunt) => {
                errors.counts = Some(Box::new(|[u, v, w, bus]| [u, 4096 - v, w, bus]));
            }
            Some(Planted::NoMagnet) => errors.has_no_magnet = true,
            _ => {}
        }
    }
    match planted {
        Some(Planted::SingleBank) => {
            let options = board.chip.soc.option_bytes() & !(1 << 22);
            board.chip.soc.set_option_bytes(options);
            board.chip.power_cycle()?;
        }
        Some(Planted::OneAddress) => {
            board.connections.change_sensor(1, |sensor| sensor.address = 0x60);
        }
        Some(Planted::OpenThermistor) => gripper.borrow_mut().temperatures_c[0] = -250.0,
        Some(Planted::FloatingBreak) => board.chip.soc.set_break_wire_open(true),
        _ => {}
    }
    let cell = Rc::new(RefCell::new(Cell::from_board(board, gripper)));
    Ok((cell.clone(), Person { cell, planted }))
}

/// Does the steps from this number on.
fn bring_up(cell: &SharedCell, person: &mut Person, from: usize) -> (Record, Result<()>, u32) {
    let link = cell.borrow().board.connections.line.clone();
    let stepped = cell.clone();
    let mut line = EmulatedLine::new(link, move || stepped.borrow_mut().step());
    let mut record = Record::default();
    for step in 1..from {
        let (name, values) = (String::new(), Vec::new());
        record.steps.push(StepRecord { step, name, passed: true, values });
    }
    let expected = Expected { watch: Duration::from_millis(500), ..Expected::default() };
    let credentials = Credentials::UNPROTECTED;
    let mut saves = 0;
    // The chip starts.
    cell.borrow_mut().run(0.5);
    let save = |_: &Record| {
        saves += 1;
        Ok(())
    };
    let mut ended = bringup::run(&mut line, credentials, person, expected, &mut record, save);
    if ended.is_ok() {
        ended = bringup::sign_off(&mut line, credentials, &mut record, "test");
    }
    if ended.is_ok() {
        let bench = params_client::read(&mut line, id::BENCH);
        assert_eq!(bench.ok(), Some(0));
    }
    (record, ended, saves)
}

fn finds(planted: Planted, step: usize) -> Result<(), Failed> {
    let run = || -> Result<()> {
        let (cell, mut person) = unused(1, Some(planted), step > 7)?;
        let (record, ended, saves) = bring_up(&cell, &mut person, step);
        println!("{:?}", ended.as_ref().err().map(|error| format!("{error:#}")));
        let error = ended.expect_err("not found");
        let failure = error.downcast_ref::<StepFailure>().expect("no step has failed");
        assert_eq!(failure.step, step, "{failure}");
        assert_eq!(record.next(), Some(step));
        assert_eq!((saves, record.signed_by), (1, None));
        Ok(())
    };
    run().map_err(|error| Failed::from(format!("{error:#}")))
}

fn passes(seed: u64) -> Result<(), Failed> {
    let run = || -> Result<()> {
        let (cell, mut person) = unused(seed, None, false)?;
        let (record, ended, _) = bring_up(&cell, &mut person, 1);
        for done in &record.steps {
            for value in &done.values {
                println!("{} {}: {:.4} {:?}", done.step, value.name, value.value, value.limits);
            }
        }
        ended?;
        // The record is what can be read again.
        assert_eq!(toml::from_str::<Record>(&toml::to_string(&record)?)?, record);
        assert_eq!(record.signed_by.as_deref(), Some("test"));
        let cell = &mut *cell.borrow_mut();
        // The limits of the bench last until the next boot.
        assert!(cell.enable(), "{}", cell.state());
        cell.host.received.replies.clear();
        cell.host.order(grip_command(30.0));
        cell.run(0.2);
        let refused = cell.host.received.replies.iter().any(|(_, reply)| {
            (reply.op, reply.detail & 0xFF) == (op::COMMAND, RefusalReason::OutOfRange as u32)
        });
        assert!(refused, "{}", cell.state());
        assert_eq!(violations(&cell.board), [""; 0]);
        let is_near = |found: f64, stated: f64| (found / stated - 1.0).abs() < SCATTER + 0.1;
        let torque = record.steps[7].values.iter().find(|value| value.name.contains("torque"));
        assert!(torque.is_some_and(|value| is_near(value.value, constants::TORQUE_CONSTANT.value)));
        Ok(())
    };
    run().map_err(|error| Failed::from(format!("{error:#}")))
}

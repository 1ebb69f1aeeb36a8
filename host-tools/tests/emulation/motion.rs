//! The image drives a simulated gripper: it is armed over the CAN bus, homes, moves, grips, enters the ground-contact mode and releases.

use std::cell::OnceCell;

use firmware::grip::commands::mode;
use firmware::grip::states::{PowerState, TaskState, state_code};
use firmware::protocol;
use firmware::protocol::messages::Command;
use libtest_mimic::{Failed, Trial};
use sim::closed_loop::ClosedLoop;
use sim::closed_loop::coupling::GripperWorld;
use sim::closed_loop::emulated_board::EmulatedBoard;
use sim::closed_loop::grasp_rig::{contact_object, grip_command};
use sim::drivetrain::parameters::{Lead, PlantParameters};

use crate::Effort;
use crate::boards::{LOAD, TYPICAL, WORST_TICK_US, gripper, image, overload, violations};
use crate::images::Variant;

/// A workcell whose board runs the image.
pub type Cell = ClosedLoop<EmulatedBoard>;

/// Newtons of the grips.
pub const SET_N: f64 = 100.0;

pub fn trials(_: Effort) -> Vec<Trial> {
    vec![
        Trial::test("motion_home_move_grip_foot_release", whole_course),
        Trial::test("motion_copy_goes_on_like_the_original", copies),
    ]
}

/// A gripper that is switched on with its fingers this far apart.
pub fn cell(opening_mm: f64) -> Result<Cell, Failed> {
    let made = image(Variant::Nominal)?;
    let gripper = gripper(PlantParameters::nominal(Lead::A), opening_mm, 1);
    let world = Box::new(GripperWorld(gripper.clone()));
    let board = EmulatedBoard::start(made.image.clone(), TYPICAL, world, gripper.clone())?;
    Ok(ClosedLoop::from_board(board, gripper))
}

/// The same, armed and homed: a copy of one that each thread homes once, which takes longer than most of what follows.
pub fn homed() -> Result<Cell, Failed> {
    thread_local!(static HOMED: OnceCell<Cell> = const { OnceCell::new() });
    HOMED.with(|homed| {
        if homed.get().is_none() {
            let mut cell = cell(3.0)?;
            home(&mut cell);
            let _ = homed.set(cell);
        }
        homed.get().map(Cell::copy).ok_or_else(|| Failed::from("not homed"))
    })
}

/// Arms and homes.
pub fn home(cell: &mut Cell) {
    assert!(
        cell.enable(),
        "{}: {:?} {:?}",
        cell.state(),
        cell.host.received.faults,
        cell.host.received.replies
    );
    assert!(cell.is_in(TaskState::Unhomed), "{}", cell.state());
    cell.host.order(Command { mode: mode::HOME, ..Command::default() });
    let took_s = cell.until(20.0, |cell| cell.is_in(TaskState::Idle));
    assert!(took_s.is_some(), "{}: {:?}", cell.state(), cell.host.received.faults);
}

/// In hundredths of a millimetre and tenths of a millimetre in a second.
pub fn move_to(cell: &mut Cell, opening_mm: f64) {
    let position = (20.0 * opening_mm) as u16;
    cell.host.order(Command { mode: mode::MOVE, position, speed: 160, ..Command::default() });
    let is_there =
        |cell: &Cell| (1e3 * cell.gripper.borrow().rig.plant.opening_m() - opening_mm).abs() < 0.1;
    assert!(cell.until(5.0, is_there).is_some(), "{}", cell.state());
    cell.run(0.2);
}

/// Most tests begin with a copy.
fn copies() -> Result<(), Failed> {
    let mut original = cell(3.0)?;
    assert!(original.enable());
    original.host.order(Command { mode: mode::HOME, ..Command::default() });
    original.run(0.1);
    let mut copy = original.copy();
    let go_on = |cell: &mut Cell| {
        for _ in 0..200 {
            cell.step().unwrap();
        }
        let sent = cell.board.connections.line.borrow().sent.clone();
        let frames = cell.board.connections.can.borrow().board_frames.clone();
        let currents_a = cell.gripper.borrow().rig.plant.motor.currents_a;
        (cell.board.chip.now(), sent, frames, currents_a, cell.board.chip.profile())
    };
    let [original, copy] = [&mut original, &mut copy].map(go_on);
    assert!(original.1.len() > 1000 && original.3 != [0.0; 3]);
    assert_eq!(original, copy);
    Ok(())
}

fn whole_course() -> Result<(), Failed> {
    let mut cell = cell(3.0)?;
    home(&mut cell);
    println!("homed at {} us", cell.time_us());
    grip_and_release(&mut cell, 2.0);
    // Ground-contact mode needs closed fingers.
    move_to(&mut cell, 0.5);
    cell.host.order(Command { mode: mode::FOOT, ..Command::default() });
    let entered = cell.until(0.5, |cell| cell.is_in(TaskState::Foot));
    assert!(entered.is_some(), "{}", cell.state());
    cell.host.stop();
    assert!(
        cell.until(0.5, |cell| cell.state() < state_code(PowerState::Enabled, TaskState::Unhomed))
            .is_some(),
        "{}",
        cell.state()
    );
    keeps_limits(&mut cell, LOAD, WORST_TICK_US);
    Ok(())
}

/// Moves, grips an object, and releases it; the reported force differs from the true one by at most `tolerance_n`.
pub fn grip_and_release(cell: &mut Cell, tolerance_n: f64) {
    for opening_mm in [20.0, 45.0] {
        move_to(cell, opening_mm);
        let true_mm = 1e3 * cell.gripper.borrow().rig.plant.opening_m();
        assert!((true_mm - opening_mm).abs() < 0.1, "{true_mm} mm, {opening_mm} mm asked for");
    }
    let thing = contact_object(cell.gripper.borrow().rig.plant.parameters(), 40.0, 333.0);
    cell.gripper.borrow_mut().rig.plant.set_object(Some(&thing));
    cell.gripper.borrow_mut().peak_n = 0.0;
    cell.host.order(grip_command(SET_N));
    assert!(
        cell.until(3.0, |cell| cell.is_in(TaskState::HoldActive)).is_some(),
        "{}",
        cell.state()
    );
    cell.run(0.4);
    let reported_n: f64 = [0, 1]
        .iter()
        .map(|&sensor: &usize| {
            protocol::force_newtons(&cell.host.received.forces[sensor].unwrap().1).0[0]
        })
        .sum();
    let (true_n, peak_n) = (cell.force_n(), cell.gripper.borrow().peak_n);
    println!("peak {peak_n:.2} N, true {true_n:.2} N, reported {reported_n:.2} N");
    assert!(peak_n <= SET_N + tolerance_n, "{peak_n}");
    assert!((true_n - SET_N).abs() < tolerance_n, "{true_n}");
    assert!((reported_n - true_n).abs() < tolerance_n, "{reported_n} {true_n}");
    cell.host.order(Command {
        mode: mode::RELEASE,
        position: 1200,
        speed: 160,
        ..Command::default()
    });
    assert!(cell.until(3.0, |cell| cell.is_in(TaskState::Idle)).is_some(), "{}", cell.state());
    assert_eq!(cell.force_n(), 0.0);
    cell.gripper.borrow_mut().rig.plant.set_object(None);
}

/// Load, stack and longest tick are within their limits; there is no fault and no misuse of the chip.
pub fn keeps_limits(cell: &mut Cell, load: f64, most_us: u16) {
    let (profile, worst_us) = (cell.board.chip.profile(), cell.host.received.worst_tick_us);
    println!("{profile}worst tick {worst_us} us");
    assert_eq!(overload(&profile, 1.0 - profile.idle, load), [""; 0]);
    assert!((1..=most_us).contains(&worst_us), "{worst_us} us");
    let faults = &cell.host.received.faults;
    assert!(faults.is_empty(), "{faults:?}");
    assert_eq!(violations(&cell.board), [""; 0]);
}

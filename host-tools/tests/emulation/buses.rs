//! Many frames of other nodes on the CAN bus, forged ones, and an hour at rest.

use embedded_can::{Frame, StandardId};
use emulator::Halt;
use emulator::peripherals::gpio::Pin;
use emulator::wiring::Wiring;
use firmware::protocol::can::CanFrame;
use firmware::protocol::serial::{Packet, PacketDecoder};
use firmware::protocol::{DEFAULT_NODE, frame_id};
use firmware::system::faults::Fault;
use libtest_mimic::{Failed, Trial};
use sim::board::SimulatedBoard;
use sim::board::forger::Forger;
use sim::closed_loop::emulated_board::{self, ChipConditions, EmulatedBoard};

use crate::Effort;
use crate::boards::{LOAD_WITHOUT_CACHES, at_rest, board, image, overload, pressed, violations};
use crate::images::Variant;
use crate::stops::FORGED;

/// Frames of other nodes in a millisecond.
const FOREIGN: u64 = 8;

pub fn trials(effort: Effort) -> Vec<Trial> {
    let mut trials = vec![
        Trial::test("can_foreign_frames", foreign_frames),
        Trial::test("can_forged_frames", forged_frames),
        Trial::test("boot_pin_that_is_pulled_up", boot_pin),
    ];
    if effort == Effort::Acceptance {
        trials.push(Trial::test("an_hour_at_rest", hour_at_rest));
    }
    trials
}

/// Ticks on the serial line since the last call, and how often one was missing between two.
fn ticks(
    board: &EmulatedBoard,
    receiver: &mut PacketDecoder,
    last_us: &mut Option<u32>,
) -> (u64, u64) {
    let (mut count, mut gaps) = (0, 0);
    for (_, packet) in board.take_packets(receiver) {
        let Packet::Tick(tick) = packet else { continue };
        let after_us = last_us.map(|last_us| tick.time_us.wrapping_sub(last_us));
        gaps += u64::from(after_us.is_some_and(|after_us| !(900..=1100).contains(&after_us)));
        *last_us = Some(tick.time_us);
        count += 1;
    }
    (count, gaps)
}

/// Eight frames of other nodes in each millisecond for two seconds: none reaches the program.
fn foreign_frames() -> Result<(), Failed> {
    const MS: u64 = 2000;
    let made = image(Variant::Default)?;
    let mut board = board(&made, ChipConditions::SLOW, pressed(&made.built));
    board.run_until(300_000)?;
    let (mut receiver, mut last_us) = (PacketDecoder::default(), None);
    ticks(&board, &mut receiver, &mut last_us);
    let idle = {
        board.chip.clear_profile();
        board.run_until(500_000)?;
        board.chip.profile().idle
    };
    board.chip.clear_profile();
    ticks(&board, &mut receiver, &mut last_us);
    let id = StandardId::new(frame_id(DEFAULT_NODE + 1, 0x1F)).ok_or("no identifier")?;
    let frame = CanFrame::new(id, &[]).ok_or("no frame")?;
    for ms in 0..MS {
        for _ in 0..FOREIGN {
            board.connections.can.borrow_mut().put(frame);
        }
        board.run_until(501_000 + 1000 * ms)?;
    }
    let (count, gaps) = ticks(&board, &mut receiver, &mut last_us);
    let flooded = board.chip.profile();
    let unseen = board.chip.soc.unseen_frames();
    println!(
        "{unseen:?}, core idle {:.1} %, {:.1} % without them",
        100.0 * flooded.idle,
        100.0 * idle
    );
    let passed = FOREIGN * MS - board.connections.can.borrow().waiting() as u64;
    assert!(passed > FOREIGN * (MS - 10), "{passed} frames on the bus");
    // One may be under way.
    assert!(unseen.refused + 1 >= passed, "{unseen:?} of {passed}");
    assert_eq!(unseen.lost, 0);
    assert!(count >= MS - 1 && gaps == 0, "{count} ticks, {gaps} gaps");
    assert!(flooded.idle > idle - 0.02, "{} {idle}", flooded.idle);
    let flooded = format!("fault {} of", Fault::Flooded as u16);
    assert!(!board.chip.log().iter().any(|line| line.text.contains(&flooded)));
    assert_eq!(violations(&board), [""; 0]);
    Ok(())
}

/// A bus full of forged frames for two seconds, with caches that never hit: their codes are checked at a limited rate, so
/// that no tick is missed and the load stays within its limit.
fn forged_frames() -> Result<(), Failed> {
    const MS: u64 = 2000;
    let made = image(Variant::Default)?;
    let mut board = board(&made, ChipConditions::SLOW, pressed(&made.built));
    board.run_until(500_000)?;
    let (mut receiver, mut last_us) = (PacketDecoder::default(), None);
    ticks(&board, &mut receiver, &mut last_us);
    board.chip.clear_profile();
    let mut forger = Forger::new(1);
    for ms in 0..MS {
        forger.flood(&board.connections.can, FORGED);
        board.run_until(501_000 + 1000 * ms)?;
    }
    let (count, gaps) = ticks(&board, &mut receiver, &mut last_us);
    let profile = board.chip.profile();
    println!("core {:.1} % busy, {count} ticks", 100.0 * (1.0 - profile.idle));
    assert!(count >= MS - 1 && gaps == 0, "{count} ticks, {gaps} gaps");
    assert_eq!(overload(&profile, 1.0 - profile.idle, LOAD_WITHOUT_CACHES), [""; 0]);
    assert_eq!(violations(&board), [""; 0]);
    Ok(())
}

/// With a sensor bus at PB8, the chip as it is shipped starts its boot loader: the board's own pins are elsewhere.
fn boot_pin() -> Result<(), Failed> {
    let made = image(Variant::Default)?;
    let start = |sensor_buses: [[Pin; 2]; 2]| {
        let wiring = Wiring { sensor_buses, ..emulated_board::wiring() };
        let conditions = ChipConditions::TYPICAL;
        let world = pressed(&made.built);
        EmulatedBoard::wired(made.image.clone(), conditions, wiring, world, at_rest(1))
    };
    let [[clock, data], second] = emulated_board::wiring().sensor_buses;
    assert!(start([[clock, data], second]).is_ok());
    let refused = start([[Wiring::BOOT0, data], second]).err().ok_or("it starts")?;
    assert_eq!(refused.downcast_ref(), Some(&Halt::BootLoader));
    Ok(())
}

/// No tick is missed, nothing resets, and no fault comes.
fn hour_at_rest() -> Result<(), Failed> {
    const SECONDS: u64 = 3600;
    let made = image(Variant::Default)?;
    let mut board = board(&made, ChipConditions::TYPICAL, pressed(&made.built));
    let (mut receiver, mut last_us) = (PacketDecoder::default(), None);
    let (mut count, mut gaps) = (0, 0);
    for step in 1..=10 * SECONDS {
        board.run_until(100_000 * step)?;
        let (new, missing) = ticks(&board, &mut receiver, &mut last_us);
        (count, gaps) = (count + new, gaps + missing);
        board.connections.can.borrow_mut().board_frames.clear();
    }
    assert!(count >= 1000 * SECONDS - 11 && gaps == 0, "{count} ticks, {gaps} gaps");
    assert_eq!(board.chip.resets, []);
    let faults: Vec<_> =
        board.chip.log().iter().filter(|line| line.text.contains("fault")).collect();
    assert!(faults.is_empty(), "{faults:?}");
    assert_eq!(violations(&board), [""; 0]);
    println!("{count} ticks in {SECONDS} s");
    Ok(())
}

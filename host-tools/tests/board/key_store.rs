//! A stored key that is damaged: nothing moves before a person has accepted what is left, or has stored a key.

use firmware::motor::calibration::CalibrationKind;
use firmware::protocol::authentication::Key;
use firmware::protocol::messages::{KeyPart, Message, Service};
use firmware::protocol::serial::{MAX_PACKET_BYTES, Packet, encode};
use firmware::protocol::session::{op, status};
use firmware::system::faults::Fault;
use firmware::system::nv_storage::record::SLOT_BYTES;
use sim::board::VirtualTimeBoard;
use sim::board::host::CanHost;

use crate::services::{board, run_to, statuses};

const KEY: Key = Key(*b"the present key.");

/// Milliseconds from one step to the next.
const STEP_MS: u64 = 150;

/// A board whose first save is damaged in both of its records, after a restart, with a host.
fn damaged() -> (VirtualTimeBoard, CanHost, u64) {
    let mut board = board();
    for slot in [0, 1] {
        board.flash.flip(slot * SLOT_BYTES + 9, 0);
    }
    board.power_cycle();
    let mut host = CanHost::new(board.connections.can.clone());
    run_to(&mut board, &mut host, STEP_MS);
    (board, host, STEP_MS)
}

fn is_unsound(board: &VirtualTimeBoard) -> bool {
    board.exchange.is_active(Fault::StoreUnsound)
}

/// Status of each reply to a request for a session with motion.
fn arm(board: &mut VirtualTimeBoard, host: &mut CanHost, ms: &mut u64) -> Vec<u8> {
    *ms += STEP_MS;
    host.arm();
    run_to(board, host, *ms);
    statuses(host, op::ARM)
}

/// Status of the reply to a service.
fn serve(board: &mut VirtualTimeBoard, host: &mut CanHost, ms: &mut u64, of: Service) -> Vec<u8> {
    *ms += STEP_MS;
    host.service(of.op, of.argument);
    run_to(board, host, *ms);
    statuses(host, of.op)
}

/// Sends over the serial line.
fn send(board: &VirtualTimeBoard, message: Message) {
    let mut buffer = [0; MAX_PACKET_BYTES];
    let packet = Packet::Message { copy: 0, message };
    for byte in encode(&packet, &mut buffer).unwrap() {
        board.connections.line.borrow_mut().put(*byte);
    }
}

/// Sends a key over the serial line without a session.
fn write_key(board: &VirtualTimeBoard, key: Key) {
    for (number, part) in (0..).zip(key.0.as_chunks::<4>().0) {
        send(board, Message::KeyPart(KeyPart { number, part: u32::from_le_bytes(*part) }));
    }
    let argument = key.check_number();
    send(board, Message::Service(Service { op: op::WRITE_KEY, argument }));
}

#[test]
fn damaged_store_refuses_motion_and_is_not_written() {
    let (mut board, mut host, mut ms) = damaged();
    let before = board.flash.bytes();
    for _ in 0..3 {
        assert!(is_unsound(&board));
        assert_eq!(arm(&mut board, &mut host, &mut ms), [status::FAULTY]);
        for (op, argument) in [
            (op::SAVE, 0),
            (op::TARE, 0),
            (op::MEASURE, CalibrationKind::Motor as u32),
            (op::UPLOAD, 4000),
            (op::CLEAR_FAULTS, 0),
        ] {
            let service = Service { op, argument };
            assert_eq!(serve(&mut board, &mut host, &mut ms, service), [status::FAULTY]);
        }
        // Whoever is at the line, without the button.
        write_key(&board, KEY);
        send(&board, Message::Service(Service { op: op::ERASE_KEY, argument: 0 }));
        ms += STEP_MS;
        run_to(&mut board, &mut host, ms);
        assert!(board.flash.bytes() == before);
        board.power_cycle();
        ms += STEP_MS;
        run_to(&mut board, &mut host, ms);
    }
}

/// Before and after a restart nothing is wrong with the store, and a request for motion has these replies.
fn is_sound_after_restarts(
    (mut board, mut host, mut ms): (VirtualTimeBoard, CanHost, u64),
    replies: [u8; 2],
) {
    for _ in 0..2 {
        assert!(!is_unsound(&board));
        assert_eq!(arm(&mut board, &mut host, &mut ms), replies);
        board.power_cycle();
        ms += STEP_MS;
        run_to(&mut board, &mut host, ms);
    }
}

#[test]
fn button_accepts_what_a_damaged_store_has_left() {
    let (mut board, mut host, mut ms) = damaged();
    board.button.set(true);
    ms += STEP_MS;
    run_to(&mut board, &mut host, ms);
    board.button.set(false);
    is_sound_after_restarts((board, host, ms), [status::CHALLENGE, status::DONE]);
}

#[test]
fn new_key_replaces_a_damaged_store() {
    let (mut board, mut host, mut ms) = damaged();
    board.button.set(true);
    write_key(&board, KEY);
    ms += STEP_MS;
    run_to(&mut board, &mut host, ms);
    board.button.set(false);
    // This host has no key.
    is_sound_after_restarts((board, host, ms), [status::CHALLENGE, status::REFUSED]);
}

/// The line of a gripper without a key: anybody may store the first one, and nobody wears the flash without one.
#[test]
fn requests_without_a_key_do_not_wear_the_flash() {
    let mut board = board();
    let mut host = CanHost::new(board.connections.can.clone());
    run_to(&mut board, &mut host, STEP_MS);
    let before = board.flash.bytes();
    let mut ms = STEP_MS;
    for _ in 0..20 {
        send(&board, Message::Service(Service { op: op::ERASE_KEY, argument: 0 }));
        // Incomplete.
        send(&board, Message::Service(Service { op: op::WRITE_KEY, argument: 7 }));
        ms += 20;
        run_to(&mut board, &mut host, ms);
    }
    assert!(board.flash.bytes() == before);
    write_key(&board, KEY);
    ms += STEP_MS;
    run_to(&mut board, &mut host, ms);
    let written = board.flash.bytes();
    assert!(written != before);
    // Now only with the key, or with the button pressed: that stores the same key no second time.
    for is_pressed in [false, true] {
        board.button.set(is_pressed);
        for _ in 0..20 {
            if is_pressed {
                write_key(&board, KEY);
            } else {
                send(&board, Message::Service(Service { op: op::ERASE_KEY, argument: 0 }));
            }
            ms += 20;
            run_to(&mut board, &mut host, ms);
        }
        assert!(board.flash.bytes() == written, "{is_pressed}");
    }
}

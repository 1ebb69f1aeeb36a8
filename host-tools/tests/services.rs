//! What a host asks of the board over the CAN bus.

mod desk;

use std::path::Path;

use desk::Desk;
use embedded_can::Frame;
use firmware::limits::Limits;
use firmware::loops::{FIRST_TICK_US, Finder};
use firmware::parameters::table::id;
use firmware::parameters::{Parameters, op as parameter, status as parameters};
use firmware::session::{MAGIC, op, status};
use firmware::status::{Fault, Faults};
use firmware::units::Force;
use firmware::wire::can::CanFrame;
use firmware::wire::messages::{Message, ParamReply, ParamRequest, Service, ServiceReply};
use firmware::wire::serial::{Packet, Receiver, Tick};
use firmware::wire::{DEFAULT_NODE, identifier};
use host_tools::board::pressed::Pressed;
use host_tools::board::{Board, Program};
use model_export::inverse::build::{Variant, build};

/// A board on whose first sensor something weighs 20 N.
fn board() -> Board {
    let desk = Desk::empty();
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data/clean");
    desk.done(&format!("fit {} -o model.toml", data.display()));
    let built = build(&desk.0.path().join("model.toml"), Variant::Fitted).unwrap();
    let world = Pressed::new(&built.model, 1, |_| {
        [[0.0, 20.0], [0.0; 2], [0.0; 2], [0.0; 2]]
    });
    let program = Program {
        tables: built.chosen.tables,
        compensations: built.compensations,
        networks: None,
        parameters: Parameters::DEFAULT,
        limits: Limits::GRIPPER,
    };
    Board::start(program, Box::new(world))
}

fn run_to(board: &mut Board, ms: u64) {
    board.run_until(FIRST_TICK_US + 1000 * ms);
}

fn ask(board: &Board, message: &Message) {
    let id = identifier(DEFAULT_NODE, message.layout().number);
    let frame = CanFrame::of(id, message.to_bytes());
    board.connections.can.borrow_mut().put(frame);
}

fn service(op: u8, nonce: u16) -> Message {
    Message::Service(Service {
        op,
        magic: MAGIC,
        nonce,
        argument: 0,
    })
}

/// What the board has said on the CAN bus since the last look.
fn said(board: &Board) -> Vec<Message> {
    let heard = std::mem::take(&mut board.connections.can.borrow_mut().heard);
    let messages = heard.iter().map(|(_, frame)| {
        let number = (frame.identifier() & 0x1F) as u8;
        Message::from_frame(number, frame.data()).unwrap()
    });
    messages.collect()
}

fn replies(board: &Board) -> Vec<ServiceReply> {
    let reply = |message| match message {
        Message::ServiceReply(reply) => Some(reply),
        _ => None,
    };
    said(board).into_iter().filter_map(reply).collect()
}

/// Mean of Fz at the first sensor over the ticks since the last look, in newtons.
fn fz_n(board: &Board) -> f64 {
    let mut receiver = Receiver::default();
    let bytes = std::mem::take(&mut board.connections.line.borrow_mut().sent);
    let packets = bytes.iter().filter_map(|byte| receiver.take(*byte));
    let ticks: Vec<Tick> = packets
        .filter_map(|packet| match packet {
            Packet::Tick(tick) => Some(tick),
            Packet::Message { .. } => None,
        })
        .collect();
    let sum: i64 = ticks
        .iter()
        .map(|tick| i64::from(tick.sensors[0].force[1]))
        .sum();
    sum as f64 / ticks.len() as f64 / Force::PER_NEWTON
}

#[test]
fn a_tare_takes_what_rests_on_a_sensor_off_its_force_and_can_be_read_and_saved() {
    let mut board = board();
    run_to(&mut board, 200);
    assert!((fz_n(&board) - 20.0).abs() < 1.0);
    ask(&board, &service(op::TARE, 0));
    run_to(&mut board, 500);
    let [reply] = replies(&board)[..] else {
        panic!("one reply");
    };
    assert_eq!((reply.op, reply.status), (op::TARE, status::DONE));
    fz_n(&board);
    run_to(&mut board, 1000);
    assert!(fz_n(&board).abs() < 0.3);
    let read = ParamRequest {
        op: parameter::READ,
        id: id::TARE + 1,
        ..ParamRequest::default()
    };
    ask(&board, &Message::ParamRequest(read));
    ask(&board, &service(op::SAVE, 0));
    run_to(&mut board, 1010);
    let said = said(&board);
    let tare = said.iter().find_map(|message| match message {
        Message::ParamReply(ParamReply { value, status, .. }) if *status == parameters::DONE => {
            Some(f64::from(*value as i32) / Force::PER_NEWTON)
        }
        _ => None,
    });
    assert!((tare.unwrap() - 20.0).abs() < 1.0);
    let saved = |message: &&Message| {
        matches!(message, Message::ServiceReply(reply)
            if reply.op == op::SAVE && reply.status == status::DONE)
    };
    assert!(said.iter().find(saved).is_some());
}

#[test]
fn with_broken_tables_nobody_arms_and_a_session_that_was_open_ends() {
    let mut board = board();
    let arm = |board: &mut Board, ms| {
        ask(board, &service(op::ARM, 0));
        run_to(board, ms);
        let offer = replies(board)[0];
        if offer.status == status::SAY_BACK {
            ask(board, &service(op::ARM, offer.nonce));
            run_to(board, ms + 10);
            return replies(board)[0].status;
        }
        offer.status
    };
    run_to(&mut board, 100);
    assert_eq!(arm(&mut board, 110), status::DONE);
    // Armed, nothing is saved.
    ask(&board, &service(op::SAVE, 0));
    run_to(&mut board, 130);
    assert_eq!(replies(&board)[0].status, status::ARMED);
    let unsound = (Fault::TablesUnsound, 0);
    let mut faults = Faults::default();
    board
        .exchange
        .note(Finder::Scrub, &mut faults, unsound, true, 0);
    assert_eq!(arm(&mut board, 150), status::FAULTY);
    ask(&board, &service(op::SAVE, 0));
    run_to(&mut board, 170);
    assert_eq!(replies(&board)[0].status, status::DONE);
}

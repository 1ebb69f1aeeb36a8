use std::collections::VecDeque;
use std::vec;
use std::vec::Vec;

use proptest::prelude::*;

use super::*;
use crate::protocol::host_session::HostSession;
use crate::protocol::{CAN, DEFAULT_NODE, frame_id};

const KEY: Key = Key(*b"a key of 16 byte");
const COMMAND: Message =
    Message::Command(Command { mode: 2, position: 400, speed: 0, force: 0, flags: 0 });

/// Random number before the first challenge; more bits than a challenge has.
const RANDOM: u64 = 0xFEDC_BA98_7654_3210;

/// A gripper and a host that know the same key, and what the gripper answered.
struct Pair {
    gripper: Session,
    host: HostSession,
    random: u64,
}

impl Pair {
    fn new() -> Self {
        let gripper = Session::new(DEFAULT_NODE, KEY, 100);
        Self { gripper, host: HostSession::new(DEFAULT_NODE, KEY), random: RANDOM }
    }

    /// With an open session.
    fn opened(op: u8, at_ms: u64) -> Self {
        let mut pair = Self::new();
        pair.open(at_ms, op);
        assert!(pair.host.is_open());
        pair
    }

    fn open(&mut self, at_ms: u64, op: u8) {
        let mut messages: VecDeque<Message> = self.host.open(op).into_iter().collect();
        while let Some(message) = messages.pop_front() {
            if let SessionEvent::Reply(Message::ServiceReply(reply)) = self.send(at_ms, message) {
                messages.extend(self.host.receive(&reply));
            }
        }
    }

    fn send(&mut self, at_ms: u64, message: Message) -> SessionEvent {
        self.send_on(at_ms, CAN, message)
    }

    fn send_on(&mut self, at_ms: u64, source: u8, message: Message) -> SessionEvent {
        self.random += 1;
        let random = self.random;
        let id = frame_id(DEFAULT_NODE, message.number());
        self.gripper.receive(at_ms, source, (id, &message.to_bytes()), || Some(random))
    }

    /// Requests a challenge; returns the answer to it.
    fn answer(&mut self, at_ms: u64) -> [Message; 2] {
        let SessionEvent::Reply(Message::ServiceReply(reply)) = self.send(at_ms, service(op::ARM))
        else {
            panic!("no reply");
        };
        let answer = self.host.receive(&reply);
        [answer[0], answer[1]]
    }

    fn send_both(&mut self, at_ms: u64, [authentication, message]: [Message; 2]) -> SessionEvent {
        assert_eq!(self.send(at_ms, authentication), SessionEvent::Ignored);
        self.send(at_ms, message)
    }

    fn send_sealed(&mut self, at_ms: u64, message: Message) -> SessionEvent {
        let sealed = self.host.seal(message).unwrap();
        self.send_both(at_ms, sealed)
    }
}

fn service(op: u8) -> Message {
    Message::Service(Service { op, argument: 0 })
}

fn status_of(event: SessionEvent) -> Option<u8> {
    match event {
        SessionEvent::Reply(Message::ServiceReply(reply)) => Some(reply.status),
        _ => None,
    }
}

#[test]
fn commands_are_accepted_from_the_armed_owner_only() {
    let mut pair = Pair::new();
    assert_eq!(pair.send(0, COMMAND), SessionEvent::Ignored);
    pair.open(0, op::ARM);
    assert!(matches!(pair.send_sealed(1, COMMAND), SessionEvent::Command(_)));
    assert_eq!(pair.send(2, COMMAND), SessionEvent::Ignored);
    assert_eq!(pair.gripper.dropped().unauthenticated, 2);
    let mut pair = Pair::opened(op::OPEN, 0);
    assert_eq!(pair.send_sealed(1, COMMAND), SessionEvent::Ignored);
}

/// No request of the table that needs an owner is accepted without one: in particular none that moves the motor.
#[test]
fn each_request_needs_the_authority_of_its_rule() {
    let requests = (0..=255).map(service).chain([COMMAND]).chain((0..=0xFF).map(|id| {
        let request = parameters::op::WRITE;
        Message::ParamRequest(crate::protocol::messages::ParamRequest {
            op: request,
            id,
            status: 0,
            value: 1,
        })
    }));
    for request in requests {
        let rule = RequestKind::of(&request).map(|kind| kind.rule().authority);
        let is_free = matches!(Pair::new().send(0, request), SessionEvent::Other(_));
        assert_eq!(is_free, rule == Some(Authority::Anyone), "{request:?}");
        let mut other = Pair::opened(op::OPEN, 0);
        let mut host = HostSession::new(DEFAULT_NODE, Key([1; 16]));
        // The same challenge, but another key.
        let (extra, detail) = ((RANDOM >> 32) as u16, RANDOM as u32 + 1);
        host.receive(&ServiceReply { op: op::OPEN, status: 1, extra, detail });
        host.receive(&ServiceReply { op: op::OPEN, status: 0, extra: 0, detail: 0 });
        let [authentication, request] = host.seal(request).unwrap();
        other.send(1, authentication);
        let is_accepted = matches!(other.send(1, request), SessionEvent::Other(_));
        assert_eq!(is_accepted, rule == Some(Authority::Anyone), "{request:?}");
    }
}

#[test]
fn challenge_has_48_random_bits() {
    let mut pair = Pair::new();
    let SessionEvent::Reply(Message::ServiceReply(reply)) = pair.send(0, service(op::ARM)) else {
        panic!("no reply");
    };
    assert_eq!((reply.status, reply.extra, reply.detail), (1, 0xBA98, 0x7654_3211));
}

#[test]
fn another_key_or_time_out_is_in_effect_at_once() {
    let mut pair = Pair::opened(op::ARM, 0);
    assert!(pair.gripper.mac().is_some());
    pair.send_sealed(1, COMMAND);
    assert!(pair.gripper.is_alive(101) && !pair.gripper.is_alive(102));
    pair.gripper.set_timeout_ms(300);
    assert!(pair.gripper.is_alive(301) && !pair.gripper.is_alive(302));
    pair.gripper.set_key(Key([9; 16]));
    assert_eq!(pair.gripper.key(), Key([9; 16]));
    assert!(!pair.gripper.is_armed() && pair.gripper.mac().is_none());
    assert_eq!(pair.send_sealed(2, COMMAND), SessionEvent::Ignored);
    pair.open(3, op::ARM);
    assert!(!pair.gripper.is_armed());
}

#[test]
fn dropped_frames_are_counted_by_their_reason() {
    let mut pair = Pair::new();
    let frames: [(u8, &[u8]); 6] =
        [(0x1F, &[0; 8]), (3, &[0; 7]), (3, &[0xFF; 8]), (1, &[0; 8]), (3, &[0; 8]), (3, &[0; 8])];
    for (number, bytes) in frames {
        pair.gripper.receive(0, CAN, (frame_id(DEFAULT_NODE, number), bytes), || Some(0));
    }
    let dropped = pair.gripper.dropped();
    assert_eq!(dropped, DroppedFrames { unknown: 1, malformed: 3, unauthenticated: 2 });
    assert_eq!(dropped.all(), 6);
}

/// The challenge in a reply.
fn challenge_of(event: SessionEvent) -> (u16, u32) {
    match event {
        SessionEvent::Reply(Message::ServiceReply(reply)) if reply.status == status::CHALLENGE => {
            (reply.extra, reply.detail)
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn challenge_ends_2_s_after_it_was_drawn() {
    for (answered_ms, expected) in [(2000, status::DONE), (2001, status::REFUSED)] {
        let mut pair = Pair::new();
        let answer = pair.answer(0);
        let drawn = challenge_of(pair.send(1, service(op::ARM)));
        // However often anybody requests it.
        for at_ms in (2..=2000).step_by(6) {
            assert_eq!(challenge_of(pair.send(at_ms, service(op::ARM))), drawn);
        }
        assert_eq!(status_of(pair.send_both(answered_ms, answer)), Some(expected));
        pair.gripper.close();
        assert_eq!(status_of(pair.send_both(answered_ms + 1, answer)), Some(status::REFUSED));
        assert_ne!(challenge_of(pair.send(2002, service(op::ARM))), drawn);
    }
}

/// Somebody keeps back all frames of an owner, and delivers them later, while he asks for the challenge.
#[test]
fn withheld_session_is_not_accepted_after_2_s() {
    for delay_ms in [2001, 2100, 5000, 40_000] {
        let mut pair = Pair::new();
        let mut withheld = vec![pair.answer(0)];
        withheld.extend((0..20).map(|_| pair.host.seal(COMMAND).unwrap()));
        for at_ms in (0..delay_ms).step_by(100) {
            pair.gripper.expire(at_ms);
            pair.send(at_ms, service(op::ARM));
        }
        for (number, frames) in (0..).zip(withheld) {
            let event = pair.send_both(delay_ms + 20 * number, frames);
            assert!(!matches!(event, SessionEvent::Command(_)), "{delay_ms}");
            assert_ne!(status_of(event), Some(status::DONE), "{delay_ms}");
            assert!(!pair.gripper.is_armed());
        }
    }
}

#[test]
fn nothing_is_accepted_twice() {
    let mut pair = Pair::opened(op::ARM, 0);
    let sealed = pair.host.seal(COMMAND).unwrap();
    pair.send_both(1, sealed);
    assert!(pair.gripper.is_alive(1));
    for at_ms in 2..100 {
        assert_eq!(pair.send_both(at_ms, sealed), SessionEvent::Ignored);
    }
    // In a later session with the same key.
    pair.gripper.close();
    pair.open(200, op::ARM);
    assert_eq!(pair.send_both(201, sealed), SessionEvent::Ignored);
    assert!(matches!(pair.send_sealed(202, COMMAND), SessionEvent::Command(_)));
}

#[test]
fn lost_messages_do_not_end_the_session() {
    let mut pair = Pair::opened(op::ARM, 0);
    for (at_ms, lost) in [(10, 0), (20, 1), (30, 100), (40, 2047)] {
        for _ in 0..lost {
            pair.host.seal(COMMAND);
        }
        let event = pair.send_sealed(at_ms, COMMAND);
        assert!(matches!(event, SessionEvent::Command(_)), "{lost}");
    }
    // Only the code arrives; the next message is another one.
    let [authentication, _] = pair.host.seal(COMMAND).unwrap();
    pair.send(50, authentication);
    assert!(matches!(pair.send_sealed(60, COMMAND), SessionEvent::Command(_)));
}

#[test]
fn requests_without_a_code_use_up_none_of_the_checks() {
    let mut pair = Pair::opened(op::ARM, 0);
    for _ in 0..100 {
        pair.send(20, COMMAND);
    }
    assert!(matches!(pair.send_sealed(20, COMMAND), SessionEvent::Command(_)));
}

#[test]
fn refused_requests_are_answered_with_their_kind() {
    let parameter = |status| ParamReply { op: parameters::op::WRITE, id: 2, status, value: 0 };
    let request = Message::ParamRequest(crate::protocol::messages::ParamRequest {
        op: parameters::op::WRITE,
        id: 2,
        ..Default::default()
    });
    for (given, expected) in [
        (status::UNAUTHENTICATED, parameters::status::UNAUTHENTICATED),
        (status::ARMED, parameters::status::ARMED),
    ] {
        let reply = refusal(&request, given);
        assert_eq!(reply, Some(Message::ParamReply(parameter(expected))));
    }
    let upload = ServiceReply { op: op::UPLOAD, status: status::ARMED, extra: 0, detail: 0 };
    let chunk = Message::CalibrationChunk(crate::protocol::messages::CalibrationChunk::default());
    assert_eq!(refusal(&chunk, status::ARMED), Some(Message::ServiceReply(upload)));
    let save = ServiceReply { op: op::SAVE, status: status::GRIPPING, extra: 0, detail: 0 };
    assert_eq!(refusal(&service(op::SAVE), status::GRIPPING), Some(Message::ServiceReply(save)));
    assert_eq!(refusal(&COMMAND, status::ARMED), None);
}

/// An authentication that was not computed with the key.
fn forged(counter: u32) -> Message {
    Message::Authentication(Authentication { counter, tag_low: 0x1234_5678, tag_high: 9 })
}

/// A message with the code that its owner would compute, and any counter.
fn sealed_with(pair: &Pair, counter: u64, message: Message) -> [Message; 2] {
    let id = frame_id(DEFAULT_NODE, message.number());
    let tag = pair.host.mac().unwrap().tag(counter, id, message.to_bytes());
    [Message::Authentication(Authentication::new(counter, tag)), message]
}

#[test]
fn two_codes_of_other_counters_are_checked_in_10_ms_on_a_line() {
    let mut pair = Pair::opened(op::ARM, 0);
    for _ in 0..2 {
        pair.send_both(20, [forged(77), COMMAND]);
    }
    // Counters of an owner's own choice; the first one used up the checks.
    let [early, late] = [8_000_000, 8_000_001].map(|counter| sealed_with(&pair, counter, COMMAND));
    assert_eq!(pair.send_both(29, early), SessionEvent::Ignored);
    assert!(matches!(pair.send_both(30, late), SessionEvent::Command(_)));
    // The other line has checks of its own.
    for _ in 0..2 {
        pair.send_both(50, [forged(77), COMMAND]);
    }
    let [authentication, message] = sealed_with(&pair, 8_000_002, COMMAND);
    pair.send_on(50, SERIAL, authentication);
    assert!(matches!(pair.send_on(50, SERIAL, message), SessionEvent::Command(_)));
}

/// A due counter is seen by everybody once it was sent: its repetition does not replace the owner's code.
#[test]
fn forged_frames_between_code_and_request_do_no_harm() {
    for requests in 0..=7 {
        let mut pair = Pair::opened(op::ARM, 0);
        let [authentication, command] = pair.host.seal(COMMAND).unwrap();
        let Message::Authentication(Authentication { counter, .. }) = authentication else {
            unreachable!()
        };
        pair.send(20, authentication);
        for number in 0..requests {
            pair.send(20, forged(counter));
            (0..100)
                .for_each(|other| assert_eq!(pair.send(20, forged(other)), SessionEvent::Ignored));
            let forged = Command { mode: 4, force: number, ..Command::default() };
            assert_eq!(pair.send(20, Message::Command(forged)), SessionEvent::Ignored);
        }
        assert!(matches!(pair.send(20, command), SessionEvent::Command(_)), "{requests}");
    }
}

/// So many guesses has somebody who sees an authentication before its request.
#[test]
fn authentication_is_tried_with_8_requests() {
    let mut pair = Pair::opened(op::ARM, 0);
    let [authentication, command] = pair.host.seal(COMMAND).unwrap();
    pair.send(20, authentication);
    for force in 0..8 {
        let forged = Command { mode: 4, force, ..Command::default() };
        assert_eq!(pair.send(20, Message::Command(forged)), SessionEvent::Ignored);
    }
    assert_eq!(pair.send(20, command), SessionEvent::Ignored);
    assert!(matches!(pair.send_sealed(40, COMMAND), SessionEvent::Command(_)));
}

/// Half of a bus at 1 Mbit/s is four to five frames in a millisecond.
#[test]
fn flood_of_forged_frames_ends_no_session_and_no_command() {
    let mut pair = Pair::opened(op::ARM, 0);
    let mut state = 1_u32;
    let mut draw = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state >> 8
    };
    let mut accepted = 0;
    for at_ms in 1..=20_000 {
        pair.gripper.expire(at_ms);
        for _ in 0..5 {
            let message = match draw() % 4 {
                0 | 1 => forged(draw()),
                2 => Message::Command(Command { mode: 4, force: 100, ..Command::default() }),
                _ => service([op::END, op::ARM, op::SAVE, op::RENEW][draw() as usize % 4]),
            };
            let event = pair.send(at_ms, message);
            assert!(!matches!(event, SessionEvent::Command(_) | SessionEvent::Other(_)));
            assert_ne!(status_of(event), Some(status::DONE));
        }
        if at_ms % 20 == 0 {
            let sealed = pair.host.seal(COMMAND).unwrap();
            accepted +=
                u32::from(matches!(pair.send_both(at_ms, sealed), SessionEvent::Command(_)));
        }
        assert!(pair.gripper.is_armed());
        assert!(at_ms < 100 || pair.gripper.is_alive(at_ms), "{at_ms}");
    }
    // A guessed counter may be the one that is due.
    std::println!("{accepted} of 1000 commands");
    assert!(accepted >= 970, "{accepted}");
    assert!(pair.gripper.is_flooded(20_000) && pair.gripper.dropped().unauthenticated > 10_000);
}

/// A forged code precedes each frame of the host.
#[test]
fn session_opens_among_forged_codes() {
    for operation in [op::ARM, op::OPEN] {
        let mut pair = Pair::new();
        let mut messages: VecDeque<Message> = pair.host.open(operation).into_iter().collect();
        let mut statuses = Vec::new();
        while let Some(message) = messages.pop_front() {
            pair.send(0, forged(77));
            if let SessionEvent::Reply(Message::ServiceReply(reply)) = pair.send(0, message) {
                statuses.push(reply.status);
                messages.extend(pair.host.receive(&reply));
            }
        }
        assert_eq!(statuses, [status::REFUSED, status::DONE]);
        assert!(pair.host.is_open());
    }
}

/// The refusal of its own answer ends the attempt of a host with a wrong key.
#[test]
fn host_with_another_key_is_refused_once() {
    let mut pair = Pair::new();
    pair.host = HostSession::new(DEFAULT_NODE, Key([1; 16]));
    let answer = pair.answer(0);
    let SessionEvent::Reply(Message::ServiceReply(reply)) = pair.send_both(1, answer) else {
        panic!("no reply");
    };
    assert_eq!(reply.status, status::REFUSED);
    assert!(pair.host.receive(&reply).is_empty() && !pair.host.is_open());
}

#[test]
fn unprotected_gripper_is_open_to_everybody() {
    let mut pair = Pair::new();
    pair.gripper.set_key(Key::NONE);
    pair.host = HostSession::new(DEFAULT_NODE, Key::NONE);
    pair.open(0, op::ARM);
    assert!(matches!(pair.send_sealed(1, COMMAND), SessionEvent::Command(_)));
}

#[test]
fn withheld_command_acts_until_a_later_one() {
    let mut pair = Pair::opened(op::ARM, 0);
    let [first, second, third] = [0; 3].map(|_| pair.host.seal(COMMAND).unwrap());
    assert!(matches!(pair.send_both(5000, first), SessionEvent::Command(_)));
    assert!(matches!(pair.send_both(9000, third), SessionEvent::Command(_)));
    assert_eq!(pair.send_both(9001, second), SessionEvent::Ignored);
    assert_eq!(pair.send_both(9002, third), SessionEvent::Ignored);
}

#[test]
fn due_counters_are_those_of_the_next_messages() {
    let mut pair = Pair::new();
    assert!(!(0..1 << 24).any(|counter| pair.gripper.due_counters().contains(counter)));
    pair.open(0, op::ARM);
    let due = pair.gripper.due_counters();
    let next: Vec<u32> = (0..5)
        .map(|_| match pair.host.seal(COMMAND).unwrap()[0] {
            Message::Authentication(authentication) => authentication.counter,
            _ => unreachable!(),
        })
        .collect();
    assert!(next[..4].iter().all(|counter| due.contains(*counter)) && !due.contains(next[4]));
    assert_eq!((0..1 << 24).filter(|counter| due.contains(*counter)).count(), 4);
}

#[test]
fn message_with_a_bit_error_is_rejected() {
    for bit in 0..128 {
        let mut pair = Pair::opened(op::ARM, 0);
        let sealed = pair.host.seal(COMMAND).unwrap();
        let mut bytes = sealed.map(|message| message.to_bytes());
        bytes[bit / 64][bit % 64 / 8] ^= 1 << (bit % 8);
        let mut last = SessionEvent::Ignored;
        for (message, bytes) in sealed.iter().zip(bytes) {
            let id = frame_id(DEFAULT_NODE, message.number());
            last = pair.gripper.receive(1, CAN, (id, &bytes), || Some(0));
        }
        assert_eq!(last, SessionEvent::Ignored, "bit {bit}");
    }
}

#[test]
fn code_of_one_line_does_not_authenticate_a_message_of_another() {
    let mut pair = Pair::opened(op::ARM, 0);
    let [authentication, message] = pair.host.seal(COMMAND).unwrap();
    pair.send(1, authentication);
    let id = frame_id(DEFAULT_NODE, message.number());
    let event = pair.gripper.receive(1, SERIAL, (id, &message.to_bytes()), || Some(0));
    assert_eq!(event, SessionEvent::Ignored);
    assert!(matches!(pair.send(1, message), SessionEvent::Command(_)));
}

#[test]
fn no_challenge_without_a_random_number() {
    let mut pair = Pair::new();
    let request = service(op::ARM);
    let frame = (frame_id(DEFAULT_NODE, request.number()), &request.to_bytes()[..]);
    let reply = pair.gripper.receive(0, CAN, frame, || None);
    assert_eq!(status_of(reply), Some(status::FAULTY));
    pair.open(1, op::ARM);
    assert!(pair.host.is_open());
}

#[test]
fn session_is_taken_over_only_after_silence_and_rest() {
    let mut pair = Pair::opened(op::ARM, 0);
    pair.send_sealed(10, COMMAND);
    let request = |pair: &mut Pair, at_ms| status_of(pair.send(at_ms, service(op::ARM)));
    assert_eq!(request(&mut pair, 11), Some(status::ARMED));
    assert!(pair.gripper.is_alive(11));
    assert_eq!(request(&mut pair, 10 + TAKEOVER_MS), Some(status::ARMED));
    pair.gripper.set_is_moving(true);
    assert_eq!(request(&mut pair, 11 + TAKEOVER_MS), Some(status::ARMED));
    pair.gripper.set_is_moving(false);
    assert_eq!(request(&mut pair, 11 + TAKEOVER_MS), Some(status::CHALLENGE));
    // It proves nothing yet: the owner can still come back.
    assert!(matches!(pair.send_sealed(12 + TAKEOVER_MS, COMMAND), SessionEvent::Command(_)));
}

#[test]
fn session_ends_by_its_owner_or_by_silence() {
    let mut pair = Pair::opened(op::ARM, 0);
    assert_eq!(status_of(pair.send(1, service(op::END))), Some(status::UNAUTHENTICATED));
    assert!(pair.gripper.is_armed());
    assert_eq!(status_of(pair.send_sealed(2, service(op::END))), Some(status::DONE));
    assert!(!pair.gripper.is_armed() && !pair.gripper.is_silent(3));
    pair.open(10, op::ARM);
    pair.send_sealed(20, COMMAND);
    pair.gripper.expire(20 + EXPIRY_MS);
    assert!(pair.gripper.is_armed() && pair.gripper.is_silent(20 + EXPIRY_MS));
    pair.gripper.expire(21 + EXPIRY_MS);
    // The host stays lost until another one arms.
    assert!(!pair.gripper.is_armed() && pair.gripper.is_silent(21 + EXPIRY_MS));
    pair.open(30 + EXPIRY_MS, op::ARM);
    assert!(!pair.gripper.is_silent(31 + EXPIRY_MS));
}

#[test]
fn session_is_renewed_by_its_owner_only() {
    let mut pair = Pair::opened(op::OPEN, 0);
    assert_eq!(
        status_of(pair.send(EXPIRY_MS - 1, service(op::RENEW))),
        Some(status::UNAUTHENTICATED)
    );
    assert_eq!(status_of(pair.send_sealed(EXPIRY_MS, service(op::RENEW))), Some(status::DONE));
    pair.gripper.expire(2 * EXPIRY_MS);
    assert!(pair.gripper.mac().is_some());
    pair.gripper.expire(2 * EXPIRY_MS + 1);
    assert!(pair.gripper.mac().is_none());
}

#[test]
fn fault_ends_an_armed_session_and_allows_services() {
    let mut pair = Pair::opened(op::ARM, 0);
    pair.gripper.set_may_arm(false);
    assert!(!pair.gripper.is_armed());
    assert_eq!(status_of(pair.send(1, service(op::ARM))), Some(status::FAULTY));
    pair.open(2, op::OPEN);
    pair.gripper.set_may_arm(false);
    let event = pair.send_sealed(3, service(op::CLEAR_FAULTS));
    assert!(matches!(event, SessionEvent::Other(Message::Service(_))));
}

#[test]
fn key_is_written_on_the_serial_line_only() {
    let mut pair = Pair::new();
    let message = service(op::WRITE_KEY);
    let id = frame_id(DEFAULT_NODE, message.number());
    let frame = (id, &message.to_bytes()[..]);
    let on_serial = |pair: &mut Pair| pair.gripper.receive(0, SERIAL, frame, || Some(0));
    assert_eq!(status_of(on_serial(&mut pair)), Some(status::NOT_PRESENT));
    pair.gripper.set_is_present(true);
    assert_eq!(on_serial(&mut pair), SessionEvent::Other(message));
    assert_eq!(status_of(pair.send(0, message)), Some(status::NOT_PRESENT));
}

#[test]
fn stop_with_any_content_is_accepted_for_own_node_only() {
    let mut session = Session::new(DEFAULT_NODE, KEY, 100);
    let stop = frame_id(DEFAULT_NODE, EStop::LAYOUT.number);
    for content in [&[][..], &[0; 8], &[0xFF; 8], &[1, 2, 3], &[0; 64]] {
        let mut event = |id| session.receive(0, CAN, (id, content), || Some(0));
        assert_eq!(event(ESTOP_ALL_ID), SessionEvent::Stop);
        assert_eq!(event(stop), SessionEvent::Stop);
        assert_eq!(event(frame_id(3, EStop::LAYOUT.number)), SessionEvent::Ignored);
    }
    assert_eq!(session.dropped(), DroppedFrames::default());
}

#[test]
fn sixteen_rejections_within_a_second_are_a_flood() {
    let mut pair = Pair::new();
    for i in 0..15 {
        pair.send(60 * i, COMMAND);
        assert!(!pair.gripper.is_flooded(60 * i));
    }
    pair.send(900, COMMAND);
    assert!(pair.gripper.is_flooded(1000) && !pair.gripper.is_flooded(1001));
}

#[test]
fn message_of_own_node_is_counted_as_malformed() {
    let mut session = Session::new(DEFAULT_NODE, KEY, 100);
    let heartbeat = frame_id(DEFAULT_NODE, 1);
    assert_eq!(session.receive(0, CAN, (heartbeat, &[0; 8]), || Some(0)), SessionEvent::Ignored);
    assert_eq!(session.dropped().malformed, 1);
    let unknown = frame_id(DEFAULT_NODE, 0x1F);
    assert_eq!(session.receive(0, CAN, (unknown, &[0; 8]), || Some(0)), SessionEvent::Ignored);
    assert_eq!(session.dropped().unknown, 1);
}

proptest! {
    /// At any time, also beyond 2^32 milliseconds, which is after 49.7 days.
    #[test]
    fn limits_of_time_do_not_depend_on_the_time(
        begin in prop_oneof![0_u64..1 << 44, (1_u64 << 32) - 20_000..(1 << 32) + 20_000],
        after in 0_u64..20_000,
    ) {
        let mut pair = Pair::opened(op::ARM, begin);
        pair.send_sealed(begin, COMMAND);
        let now = begin + after;
        prop_assert_eq!(pair.gripper.is_alive(now), after <= 100);
        prop_assert_eq!(pair.gripper.is_silent(now), after > 100);
        pair.gripper.expire(now);
        prop_assert_eq!(pair.gripper.is_armed(), after <= EXPIRY_MS);
        let takes_over = status_of(pair.send(now, service(op::ARM))) == Some(status::CHALLENGE);
        prop_assert_eq!(takes_over, after > TAKEOVER_MS);
        let mut later = Pair::new();
        later.send(begin, service(op::ARM));
        prop_assert_eq!(later.gripper.is_arming(now), after <= CHALLENGE_TIMEOUT_MS);
    }

    /// Whoever does not know the key, but every code of an earlier session, gets nothing accepted.
    #[test]
    fn recorded_and_mixed_messages_are_rejected(
        picks in prop::collection::vec((0_usize..40, 0_usize..40, 0_u32..3), 1..60),
    ) {
        let mut pair = Pair::opened(op::ARM, 0);
        let mut recorded = Vec::new();
        for i in 0..40 {
            let command = Command { mode: i % 3, position: u16::from(i), ..Command::default() };
            let sealed = pair.host.seal(Message::Command(command)).unwrap();
            recorded.push(sealed);
            pair.send_both(1, sealed);
        }
        for (code, message, shift) in picks {
            let Message::Authentication(code) = recorded[code][0] else { unreachable!() };
            let counter = (code.counter + shift) & 0xFF_FFFF;
            pair.send(2, Message::Authentication(Authentication { counter, ..code }));
            prop_assert_eq!(pair.send(2, recorded[message][1]), SessionEvent::Ignored);
        }
    }
}

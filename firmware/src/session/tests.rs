use super::*;
use crate::wire::DEFAULT_NODE;

const COMMAND: u16 = identifier(DEFAULT_NODE, Command::LAYOUT.number);
const SERVICE: u16 = identifier(DEFAULT_NODE, Service::LAYOUT.number);
const NONCE: u16 = 0xBEEF;

fn service(op: u8, nonce: u16) -> [u8; 8] {
    let service = Service {
        op,
        magic: MAGIC,
        nonce,
        argument: 0,
    };
    service.to_bytes()
}

fn command(nonce: u16, counter: u8) -> Command {
    let command = Command {
        mode: 2,
        counter,
        position: 400,
        ..Command::default()
    };
    sealed(nonce, COMMAND, command)
}

fn armed(at_ms: u32) -> Session {
    let mut session = Session::new(DEFAULT_NODE, 100);
    session.hear(at_ms, SERVICE, &service(op::ARM, 0), NONCE);
    session.hear(at_ms, SERVICE, &service(op::ARM, NONCE), 0);
    assert!(session.is_open());
    session
}

fn say(session: &mut Session, now_ms: u32, command: Command) -> bool {
    session.hear(now_ms, COMMAND, &command.to_bytes(), 0) == Heard::Command(command)
}

#[test]
fn nothing_moves_before_somebody_has_armed() {
    let mut session = Session::new(DEFAULT_NODE, 100);
    assert!(!say(&mut session, 0, command(0, 1)));
    assert_eq!(session.dropped().late, 1);
}

#[test]
fn a_nonce_counts_for_half_a_second_and_once() {
    let mut session = Session::new(DEFAULT_NODE, 100);
    let ask = service(op::ARM, 0);
    let echo = service(op::ARM, NONCE);
    session.hear(0, SERVICE, &ask, NONCE);
    session.hear(501, SERVICE, &echo, 0);
    assert!(!session.is_open());
    // The offer is spent, even in time.
    session.hear(502, SERVICE, &echo, 0);
    assert!(!session.is_open());
    session.hear(600, SERVICE, &ask, NONCE);
    let Heard::Reply { reply, armed } = session.hear(1100, SERVICE, &echo, 0) else {
        panic!("no answer");
    };
    assert!(armed && reply.status == status::DONE && session.is_open());
    assert_eq!(session.dropped().late, 2);
}

#[test]
fn a_recorded_session_moves_nothing_in_the_next() {
    let mut session = armed(0);
    let recorded = command(NONCE, 1);
    assert!(say(&mut session, 1, recorded));
    session.close();
    session.hear(10, SERVICE, &service(op::ARM, 0), 0x1234);
    session.hear(11, SERVICE, &service(op::ARM, 0x1234), 0);
    assert!(session.is_open());
    assert!(!say(&mut session, 12, recorded));
    assert_eq!(session.dropped().malformed, 1);
}

#[test]
fn a_counter_that_does_not_go_on_by_one_or_two_is_a_replay() {
    let mut session = armed(0);
    for (counter, counts) in [
        (15, true),
        (15, false),
        (0, true),
        (2, true),
        (5, false),
        (1, false),
        (3, true),
    ] {
        assert_eq!(
            say(&mut session, 1, command(NONCE, counter)),
            counts,
            "{counter}"
        );
    }
    assert_eq!(session.dropped().replayed, 3);
}

#[test]
fn any_bit_that_flips_in_a_command_drops_it() {
    let sound = command(NONCE, 1).to_bytes();
    for bit in 0..64 {
        let mut session = armed(0);
        let mut spoilt = sound;
        spoilt[bit / 8] ^= 1 << (bit % 8);
        assert_eq!(
            session.hear(1, COMMAND, &spoilt, 0),
            Heard::Nothing,
            "bit {bit}"
        );
        assert_eq!(session.dropped().malformed, 1);
    }
}

#[test]
fn a_host_is_silent_after_a_tenth_of_a_second_also_when_the_clock_turns_over() {
    let begin = u32::MAX - 20;
    let mut session = armed(begin);
    assert!(!session.is_alive(begin));
    assert!(say(&mut session, begin, command(NONCE, 1)));
    assert!(session.is_alive(begin.wrapping_add(100)));
    assert!(!session.is_alive(begin.wrapping_add(101)));
}

#[test]
fn a_stop_is_heard_from_anybody_whatever_it_carries_and_other_nodes_are_not() {
    let mut session = Session::new(DEFAULT_NODE, 100);
    let stop = identifier(DEFAULT_NODE, EStop::LAYOUT.number);
    for carried in [&[][..], &[0; 8], &[0xFF; 8], &[1, 2, 3], &[0; 64]] {
        assert_eq!(session.hear(0, STOP_ALL, carried, 0), Heard::Stop);
        assert_eq!(session.hear(0, stop, carried, 0), Heard::Stop);
        let other = identifier(3, EStop::LAYOUT.number);
        assert_eq!(session.hear(0, other, carried, 0), Heard::Nothing);
    }
    assert_eq!(session.dropped(), Dropped::default());
}

#[test]
fn sixteen_dropped_frames_within_a_second_are_a_flood() {
    let mut session = armed(0);
    for i in 0..15 {
        session.hear(60 * i, COMMAND, &[0; 8], 0);
        assert!(!session.is_flooded(60 * i));
    }
    session.hear(900, COMMAND, &[0; 8], 0);
    assert!(session.is_flooded(1000) && !session.is_flooded(1001));
}

#[test]
fn who_speaks_in_this_nodes_name_is_counted() {
    let mut session = Session::new(DEFAULT_NODE, 100);
    let heartbeat = identifier(DEFAULT_NODE, 1);
    assert_eq!(session.hear(0, heartbeat, &[0; 8], 0), Heard::Nothing);
    assert_eq!(session.dropped().malformed, 1);
    assert_eq!(
        session.hear(0, identifier(DEFAULT_NODE, 0x1F), &[0; 8], 0),
        Heard::Nothing
    );
    assert_eq!(session.dropped().unknown, 1);
}

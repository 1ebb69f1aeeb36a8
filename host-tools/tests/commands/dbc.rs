//! The `.dbc`, read by a library that shares no code with the gripper, against frames of the gripper.

use can_dbc::{Dbc, MessageId, MultiplexIndicator, Signal, ValueType};
use firmware::estimator::{Estimate, Validity};
use firmware::fixed_point::Force;
use firmware::protocol::authentication::Key;
use firmware::protocol::layout::{MessageLayout, SignalLayout, encode};
use firmware::protocol::messages::{LAYOUTS, Message};
use firmware::protocol::session::{Session, SessionEvent};
use firmware::protocol::{self, CAN, DEFAULT_NODE, frame_id};
use host_tools::commands::dbc::dbc;

/// The value of a signal in a frame, by what the file says of it.
fn value(signal: &Signal, bytes: [u8; 8]) -> f64 {
    let bit = |i: u64| u64::from(bytes[(i / 8) as usize] >> (i % 8) & 1);
    let counts: u64 = (0..signal.size).map(|i| bit(signal.start_bit + i) << i).sum();
    let negative =
        signal.value_type == ValueType::Signed && bit(signal.start_bit + signal.size - 1) == 1;
    let counts = counts as i64 - if negative { 1_i64 << signal.size } else { 0 };
    counts as f64 * signal.factor + signal.offset
}

fn close(measured: f64, expected: f64) {
    assert!((measured - expected).abs() < 1e-9, "{measured} instead of {expected}");
}

/// A row of `tests/data/golden_frames.csv`: a frame, and what it means.
struct Golden {
    name: String,
    case: String,
    identifier: u16,
    bytes: [u8; 8],
    /// Signals of the frame and their values in their units.
    fields: Vec<(String, f64)>,
}

fn golden_frames() -> Vec<Golden> {
    let mut file = csv::Reader::from_path(tests::data("golden_frames.csv")).unwrap();
    file.records().map(|row| Golden::read(&row.unwrap())).collect()
}

impl Golden {
    fn read(row: &csv::StringRecord) -> Self {
        let bytes: Vec<u8> =
            row[3].split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
        let field = |field: &str| {
            let (name, value) = field.split_once('=').unwrap();
            (name.to_owned(), value.parse().unwrap())
        };
        Self {
            name: row[0].to_owned(),
            case: row[1].to_owned(),
            identifier: u16::from_str_radix(&row[2], 16).unwrap(),
            bytes: bytes.try_into().unwrap(),
            fields: row[4].split_whitespace().map(field).collect(),
        }
    }

    fn what(&self) -> String {
        format!("{} {}", self.name, self.case)
    }

    fn number(&self) -> u8 {
        let first = frame_id(DEFAULT_NODE, 0);
        self.identifier.checked_sub(first).unwrap() as u8
    }

    fn layout(&self) -> &'static MessageLayout {
        let number = self.number();
        LAYOUTS.iter().find(|layout| layout.numbers().contains(&number)).unwrap()
    }

    /// The values in the counts of their fields.
    fn counts(&self) -> Vec<i64> {
        let fields = self.layout().signals;
        assert_eq!(fields.len(), self.fields.len(), "{}", self.what());
        let each = fields.iter().zip(&self.fields);
        each.map(|(field, (_, value))| {
            let counts = (value / field.scale).round();
            close(counts * field.scale, *value);
            counts as i64
        })
        .collect()
    }

    /// The eight bytes of these values, each in the bits that the gripper's table gives its field.
    fn packed(&self) -> [u8; 8] {
        let fields = self.layout().signals.iter().zip(self.counts());
        let bits = fields.map(|(field, counts)| {
            if field.signed {
                encode(field.first_bit..field.end_bit, counts as i32)
            } else {
                encode(field.first_bit..field.end_bit, counts as u32)
            }
        });
        bits.fold(0, |frame, bits| frame | bits).to_le_bytes()
    }
}

#[test]
fn committed_dbc_equals_the_output_of_the_command() {
    let kept = include_str!("../../../firmware/magpie.dbc");
    assert!(kept == dbc(DEFAULT_NODE), "run: cargo magpie dev dbc -o firmware/magpie.dbc");
}

#[test]
fn every_coded_signal_has_the_names_of_its_values() {
    let file = Dbc::try_from(dbc(DEFAULT_NODE).as_str()).unwrap();
    let names = |message: &str, signal: &str| -> Vec<(i64, String)> {
        let id = file.messages.iter().find(|m| m.name == message).unwrap().id;
        let found = file.value_descriptions.iter().find_map(|table| match table {
            can_dbc::ValueDescription::Signal { message_id, name, value_descriptions }
                if *message_id == id && name == signal =>
            {
                Some(value_descriptions)
            }
            _ => None,
        });
        let values = found.unwrap_or_else(|| panic!("{message} {signal}"));
        values.iter().map(|value| (value.id, value.description.clone())).collect()
    };
    for (message, signal, value, name) in [
        ("Heartbeat", "object", 2, "contact while closing"),
        ("GripStatus", "object", 3, "at position"),
        ("Heartbeat", "state", 23, "hold active"),
        ("Service", "op", 5, "arm"),
        ("ServiceReply", "op", 7, "refused command"),
        ("ServiceReply", "status", 7, "gripping"),
        ("ParamReply", "status", 3, "armed"),
        ("FaultEvent", "code", 603, "stroke wrong"),
        ("FaultEvent", "active", 1, "set"),
    ] {
        let names = names(message, signal);
        assert!(names.contains(&(value, name.to_owned())), "{message} {signal}: {names:?}");
    }
    // The bits of the heartbeat are in the order of the faults.
    let text = dbc(DEFAULT_NODE);
    assert!(text.contains("Bits: 0 sensor lost, 1 sensor frozen,"), "{text}");
    assert!(text.contains("31 power stage."), "{text}");
}

#[test]
fn forces_of_the_third_sensor_are_read_in_newtons() {
    let estimate = Estimate {
        force: [Force(-(123 << 10)), Force(47 << 10)],
        sigma: Some([Force(2 << 10), Force(5 << 9)]),
        validity: Validity::Valid,
        ..Estimate::MISSING
    };
    let bytes = protocol::force_message(&estimate, 200).to_bytes();
    let file = Dbc::try_from(dbc(DEFAULT_NODE).as_str()).unwrap();
    let message = file.messages.iter().find(|m| m.name == "Force2").unwrap();
    let read = |name| {
        let signal = message.signals.iter().find(|s| s.name == name).unwrap();
        value(signal, bytes)
    };
    close(read("fx"), -123.0);
    close(read("fz"), 47.0);
    close(read("sigma_x"), 2.0);
    close(read("sigma_z"), 2.5);
    close(read("valid"), 1.0);
    close(read("stale"), 0.0);
    close(read("model"), 1.0);
    close(read("counter"), 200.0);
}

/// Frames of a session that another program has computed (`tests/data/README.md`).
#[test]
fn session_of_another_program_is_accepted() {
    let mut file = csv::Reader::from_path(tests::data("golden_session.csv")).unwrap();
    let rows: Vec<csv::StringRecord> = file.records().map(Result::unwrap).collect();
    let key: Vec<u8> =
        (0..16).map(|i| u8::from_str_radix(&rows[0][0][2 * i..2 * i + 2], 16).unwrap()).collect();
    let frame = |text: &str| -> [u8; 8] {
        let bytes: Vec<u8> =
            text.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
        bytes.try_into().unwrap()
    };
    let mut session = Session::new(DEFAULT_NODE, Key(key.try_into().unwrap()), 100);
    let mut now_ms = 0;
    let mut receive = |number, bytes: [u8; 8]| {
        // So fast that codes are checked only for their counters.
        now_ms += 1;
        session.receive(now_ms, CAN, (frame_id(DEFAULT_NODE, number), &bytes), || {
            Some(0x1122_3344_5566)
        })
    };
    let SessionEvent::Reply(reply) = receive(4, [5, 0, 0, 0, 0, 0, 0, 0]) else {
        panic!("no challenge");
    };
    assert_eq!(reply.to_bytes(), frame(&rows[0][1]));
    let events: Vec<SessionEvent> = rows
        .iter()
        .map(|row| {
            let layout = LAYOUTS.iter().find(|layout| layout.name == &row[2]).unwrap();
            assert_eq!(receive(0, frame(&row[4])), SessionEvent::Ignored);
            receive(layout.number, frame(&row[5]))
        })
        .collect();
    let done = |event: &SessionEvent| matches!(event, SessionEvent::Reply(Message::ServiceReply(reply)) if reply.status == 0);
    assert!(done(&events[0]) && done(&events[5]), "{events:?}");
    assert!(events[1..4].iter().all(|event| matches!(event, SessionEvent::Command(_))));
    assert!(matches!(events[4], SessionEvent::Other(Message::ParamRequest(_))));
}

#[test]
fn every_golden_frame_is_what_the_gripper_sends() {
    for row in golden_frames() {
        let what = row.what();
        assert_eq!(row.packed(), row.bytes, "{what}");
        let message = Message::from_frame(row.number(), &row.bytes).unwrap();
        assert_eq!(message.layout(), row.layout(), "{what}");
        assert_eq!(message.to_bytes(), row.bytes, "{what}");
    }
}

#[test]
fn every_golden_frame_is_read_through_the_dbc_as_it_was_meant() {
    let file = Dbc::try_from(include_str!("../../../firmware/magpie.dbc")).unwrap();
    for row in golden_frames() {
        let what = row.what();
        let message = file.messages.iter().find(|m| m.name == row.name).unwrap();
        assert_eq!(message.id, MessageId::Standard(row.identifier), "{what}");
        let selected = row.fields.first().map_or(0.0, |(_, value)| *value);
        let shown = |signal: &&Signal| match signal.multiplexer_indicator {
            MultiplexIndicator::MultiplexedSignal(value) => value as f64 == selected,
            _ => true,
        };
        let signals: Vec<&Signal> = message.signals.iter().filter(shown).collect();
        assert_eq!(signals.len(), row.fields.len(), "{what}");
        for (signal, (name, meant)) in signals.iter().zip(&row.fields) {
            assert_eq!(signal.name, *name, "{what}");
            close(value(signal, row.bytes), *meant);
        }
    }
}

#[test]
fn golden_frames_contain_every_message_at_zero_ends_and_between() {
    let rows = golden_frames();
    for (layout, number) in
        LAYOUTS.iter().flat_map(|layout| layout.numbers().map(move |n| (layout, n)))
    {
        let case = |case: &str| -> Vec<i64> {
            let row = rows.iter().find(|r| r.number() == number && r.case == case);
            row.unwrap_or_else(|| panic!("no frame '{case}' of {}, {number:#x}", layout.name))
                .counts()
        };
        let ends = |field: &SignalLayout| match (field.end_bit - field.first_bit, field.signed) {
            (width, true) => (-(1_i64 << (width - 1)), (1_i64 << (width - 1)) - 1),
            (width, false) => (0, (1_i64 << width) - 1),
        };
        let (least, greatest): (Vec<i64>, Vec<i64>) = layout.signals.iter().map(ends).unzip();
        assert_eq!(case("zero"), vec![0; least.len()], "{}", layout.name);
        // A message without fields is always the same.
        if layout.signals.is_empty() {
            continue;
        }
        assert_eq!(case("least"), least, "{}", layout.name);
        assert_eq!(case("greatest"), greatest, "{}", layout.name);
        let first = if layout.multiplexed { "mixed1" } else { "mixed" };
        let mixed = case(first);
        assert!(![vec![0; least.len()], least, greatest].contains(&mixed));
    }
}

#[test]
fn another_node_has_other_identifiers_and_the_same_messages() {
    let other = dbc(1);
    assert!(other.contains("BO_ 33 Heartbeat:"), "{other}");
    assert!(dbc(DEFAULT_NODE).contains("BO_ 513 Heartbeat:"));
    assert_eq!(other.matches("BO_ ").count(), dbc(DEFAULT_NODE).matches("BO_ ").count());
}

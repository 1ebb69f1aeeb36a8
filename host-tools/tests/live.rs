//! A gripper watched and recorded while it runs, as a user meets it: the virtual board behind its line.
#![cfg(unix)]

mod desk;
#[path = "desk/running.rs"]
mod running;

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use desk::Desk;
use embedded_can::Frame;
use firmware::limits::Limits;
use firmware::loops::FIRST_TICK_US;
use firmware::parameters::table::id;
use firmware::parameters::{Parameters, op};
use firmware::wire::DEFAULT_NODE;
use firmware::wire::messages::{Message, ParamRequest};
use firmware::wire::serial::{LONGEST, Packet, Receiver, encode};
use host_tools::board::pressed::Pressed;
use host_tools::board::{Board, Program};
use host_tools::live::rows::{Row, Rows};
use host_tools::live::source::packet;
use model_export::inverse::build::{Variant, build};
use model_export::recordings::Recording;
use model_export::recordings::align::Alignment;
use model_export::recordings::description::Description;
use model_export::recordings::raw::RawStream;
use running::Running;
use rustix::process::Signal;
use serde_json::Value;

/// A desk with a model of a gripper without any effect.
fn desk() -> Desk {
    let desk = Desk::empty();
    let data = data("clean");
    desk.done(&format!("fit {} -o model.toml", data.display()));
    desk
}

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../tests/data")
        .join(name)
}

fn board_s(object: &Value) -> f64 {
    object["board_s"].as_f64().unwrap_or(0.0)
}

#[test]
fn a_pressed_force_is_told_within_its_noise_until_nobody_reads_any_more() {
    let desk = desk();
    let mut monitor = Running::start(
        &desk,
        "monitor --virtual --model model.toml --press 20,-10 --json",
    );
    let told: Vec<Value> = monitor
        .objects()
        .skip_while(|object| board_s(object) < 0.5)
        .take(25)
        .collect();
    for (sensor, x_n) in [20.0, 20.0, -20.0, -20.0].into_iter().enumerate() {
        for (force, expected) in [("fx_n", x_n), ("fz_n", -10.0)] {
            let values = told.iter().map(|object| {
                let sensor = &object["sensors"][sensor];
                assert_eq!(sensor["validity"], "valid");
                sensor[force].as_f64().unwrap()
            });
            // White noise of one tick is 0.5 N at the most, the tables' error 0.2 N.
            let mean = values.sum::<f64>() / told.len() as f64;
            assert!((mean - expected).abs() < 0.7, "{sensor} {force}: {mean}");
        }
    }
    let last = &told[told.len() - 1];
    assert_eq!(last["faults"], Value::Array(Vec::new()));
    assert_eq!(last["lost"]["broken_packets"], 0);
    // A busy machine may lose one; what is counted but not sent would be a thousand a second.
    assert!(last["lost"]["messages"].as_u64() < Some(20), "{last}");
    assert_eq!(last["version"]["protocol"][0], 1);
    assert_eq!(last["heartbeat"]["sensors_ok"], 0b1111);
    assert!(last["load"]["worst_tick_us"].as_u64() > Some(200));
    // The objects' reader is gone.
    assert!(monitor.0.wait().unwrap().success());
}

#[test]
fn a_sensor_that_is_unplugged_is_told_by_name_within_milliseconds_of_the_board_s_time() {
    let desk = desk();
    let line = "monitor --virtual --model model.toml --press 20,0 --unplug 2@1.5 --json";
    let mut monitor = Running::start(&desk, line);
    let faulty = monitor.objects().find(|object| {
        assert!(board_s(object) < 60.0, "no fault is told");
        object["faults"][0]["name"] == "sensor lost" && board_s(object) > 1.6
    });
    let faulty = faulty.unwrap();
    let fault = &faulty["faults"][0];
    assert_eq!((&fault["code"], &fault["source"]), (&100.into(), &2.into()));
    let told_s = fault["since_board_s"].as_f64().unwrap();
    assert!((1.5..1.51).contains(&told_s), "{told_s}");
    assert_eq!(faulty["sensors"][2]["validity"], "no reading");
    assert_eq!(faulty["sensors"][3]["validity"], "valid");
}

#[test]
fn without_a_terminal_a_line_a_second_is_printed_and_the_time_ends_it() {
    let desk = desk();
    let line = "monitor --virtual --model model.toml --press 30,5 --seconds 2.5";
    let told = String::from_utf8(desk.done(line)).unwrap();
    let lines: Vec<&str> = told.lines().collect();
    assert!(lines[0].contains("Fx, Fz 3 / N"), "{told}");
    assert!((2..=3).contains(&lines.len()), "{told}");
    assert!(!told.contains('\u{1b}'));
}

#[test]
fn other_programs_read_the_virtual_board_s_line_and_ask_it() {
    let desk = desk();
    let mut monitor = Running::start(&desk, "monitor --virtual --model model.toml --seconds 60");
    let (path, _said) = monitor.line();
    let mut line = File::options().read(true).write(true).open(path).unwrap();
    let request = Message::ParamRequest(ParamRequest {
        op: op::READ,
        id: id::FORCE_RATE,
        ..ParamRequest::default()
    });
    let mut buffer = [0; LONGEST];
    let asked = Packet::Message {
        copy: 0,
        message: request,
    };
    line.write_all(encode(&asked, &mut buffer).unwrap())
        .unwrap();
    let mut receiver = Receiver::default();
    let (mut ticks, mut rate) = (Vec::new(), None);
    let mut bytes = [0; 512];
    while ticks.len() < 200 || rate.is_none() {
        let count = line.read(&mut bytes).unwrap();
        for byte in &bytes[..count] {
            match receiver.take(*byte) {
                Some(Packet::Tick(tick)) => ticks.push(tick.time_us),
                Some(Packet::Message {
                    message: Message::ParamReply(reply),
                    ..
                }) => rate = Some(reply.value),
                _ => {}
            }
        }
    }
    assert_eq!(rate, Some(100));
    assert!(ticks.windows(2).all(|pair| pair[1] > pair[0]));
}

/// Rows of the recording's own table, so that nothing between hides what is in it.
fn rows(recording: &Path) -> Vec<Vec<i64>> {
    let text = std::fs::read_to_string(recording.join("hall.csv")).unwrap_or_default();
    let rows = text.lines().skip(1).map(|line| {
        let cells = line.split(',').map(|cell| cell.trim().parse::<f64>());
        cells.map(|cell| (1000.0 * cell.unwrap()) as i64).collect()
    });
    rows.collect()
}

/// Waits until a recording that is being made has so many rows.
fn grown(recording: &Path, count: usize, running: &mut Running) -> Vec<Vec<i64>> {
    loop {
        let rows = rows(recording);
        if rows.len() >= count {
            return rows;
        }
        assert!(
            running.0.try_wait().unwrap().is_none(),
            "it ended by itself"
        );
        std::thread::sleep(Duration::from_millis(3));
    }
}

#[test]
fn a_recording_whose_recorder_is_killed_at_any_moment_reads_and_has_every_row_to_its_end() {
    let desk = desk();
    for (number, wanted) in [1, 300, 850, 1333, 2100].into_iter().enumerate() {
        let line = format!(
            "record --virtual --model model.toml --press 10,5 -o killed/{number} --start-s 0"
        );
        let mut record = Running::start(&desk, &line);
        let folder = desk.0.path().join(format!("killed/{number}"));
        let before = grown(&folder, wanted, &mut record);
        // Not always right after a flush.
        std::thread::sleep(Duration::from_millis(71 * number as u64));
        record.signal(Signal::KILL);
        record.0.wait().unwrap();
        let after = rows(&folder);
        assert_eq!(after[..before.len()], before);
        assert!(
            after
                .windows(2)
                .all(|pair| pair[1][0] - pair[0][0] == 1_000_000)
        );
        let recording = Recording::read(&folder, Alignment { delay_us: 0.0 }).unwrap();
        assert_eq!(recording.rows_read.0 as usize, after.len());
        assert!(recording.notices.is_empty(), "{:?}", recording.notices);
    }
}

#[test]
fn ctrl_c_ends_a_recording_cleanly_and_it_is_not_overwritten() {
    let desk = desk();
    let line = "record --virtual --model model.toml -o campaign/1 --note pressed --json";
    let mut record = Running::start(&desk, line);
    let folder = desk.0.path().join("campaign/1");
    grown(&folder, 600, &mut record);
    record.signal(Signal::INT);
    let told = record.objects().next().unwrap();
    assert!(record.0.wait().unwrap().success());
    assert_eq!(told["rows"], rows(&folder).len());
    assert_eq!(
        (&told["lost_rows"], &told["left_out_rows"]),
        (&0.into(), &0.into())
    );
    assert_eq!(told["sensors"], serde_json::json!([0, 1, 2, 3]));
    let (description, notices) = Description::read(&folder).unwrap();
    assert!(notices.is_empty());
    assert_eq!(
        (description.description.as_str(), description.start_s),
        ("pressed", 0.0)
    );
    let said = desk.refused("record --virtual --model model.toml -o campaign/1");
    assert!(said.contains("something else stands there"), "{said}");
    // The next one starts as long after it as the clock says.
    let line = "record --virtual --model model.toml -o campaign/2 --seconds 1 --json";
    let next = desk.told(line);
    assert!(next["start_s"].as_f64() >= Some(0.0));
}

#[test]
fn what_the_sensors_felt_is_what_is_recorded_count_for_count() {
    let desk = desk();
    let (source, seconds) = (data("clean/1"), 3);
    let felt = desk.0.path().join("felt");
    std::fs::create_dir(&felt).unwrap();
    std::fs::copy(source.join("recording.toml"), felt.join("recording.toml")).unwrap();
    for (name, rate) in [("hall.csv", 1000), ("force.csv", 100)] {
        let packed = File::open(source.join(format!("{name}.gz"))).unwrap();
        let text = std::io::read_to_string(flate2::read::MultiGzDecoder::new(packed)).unwrap();
        let lines: Vec<&str> = text.lines().take(1 + rate * seconds).collect();
        std::fs::write(felt.join(name), lines.join("\n") + "\n").unwrap();
    }
    let told = desk.told("record --virtual --model model.toml --replay felt -o again/1 --json");
    assert_eq!(
        (&told["lost_rows"], &told["left_out_rows"]),
        (&0.into(), &0.into())
    );
    let fields = |folder: &Path| {
        let (description, _) = Description::read(folder).unwrap();
        let mut stream =
            RawStream::open(folder, &description, Alignment { delay_us: 0.0 }).unwrap();
        let channels = [0, 1, 2, 3].map(|sensor| stream.layout().field_channels(sensor).unwrap());
        let mut rows = Vec::new();
        while let Some(row) = stream.next_row().unwrap() {
            rows.push(channels.map(|channels| channels.map(|channel| row.hall[channel])));
        }
        rows
    };
    let (felt, again) = (fields(&felt), fields(&desk.0.path().join("again/1")));
    // While it was asked for its parameters the board went on; it ends with the recording.
    let start = felt.iter().position(|row| *row == again[0]).unwrap();
    let common = again.len().min(felt.len() - start);
    assert!(common >= 1000, "{common} rows");
    assert_eq!(again[..common], felt[start..start + common]);
}

#[test]
fn over_a_can_bus_come_the_readings_of_the_serial_line() {
    let desk = desk();
    let built = build(&desk.0.path().join("model.toml"), Variant::Fitted).unwrap();
    let world = Pressed::new(&built.model, 7, |s| {
        [[10.0 * s, 5.0], [1.0, 2.0], [-10.0 * s, 0.0], [3.0; 2]]
    });
    let mut parameters = Parameters::DEFAULT;
    parameters.set(id::RAW, 1).unwrap();
    parameters.set(id::FORCE_RATE, 250).unwrap();
    let program = Program {
        tables: built.chosen.tables.clone(),
        compensations: built.compensations.clone(),
        networks: None,
        parameters,
        limits: Limits::GRIPPER,
    };
    let mut board = Board::start(program, Box::new(world));
    board.run_until(FIRST_TICK_US + 1_500_000);
    let gathered = |mut rows: Rows, packets: Vec<(u64, Packet)>| -> Vec<Row> {
        let rows = packets
            .iter()
            .filter_map(|(us, packet)| rows.take(*us as f64 * 1e-6, packet).unwrap());
        rows.collect()
    };
    let can = board.connections.can.borrow();
    let frames = can.heard.iter().filter_map(|(us, frame)| {
        packet(DEFAULT_NODE, frame.identifier(), frame.data()).map(|packet| (*us, packet))
    });
    let on_bus = gathered(Rows::of_sets(4000), frames.collect());
    let mut receiver = Receiver::default();
    let line = board.connections.line.borrow();
    let packets = line.sent.iter().filter_map(|byte| receiver.take(*byte));
    let on_line = gathered(
        Rows::of_ticks(),
        packets.map(|packet| (0, packet)).collect(),
    );
    let start = on_line
        .iter()
        .position(|row| row.readings == on_bus[0].readings)
        .unwrap();
    assert!(on_bus.len() > 370, "{}", on_bus.len());
    // The bus tells no time: that comes from its counters. Either may leave a tick out, and then no later
    // one may be taken for it.
    let begun_us = on_line[start].time_us;
    let mut compared = 0;
    for row in &on_bus {
        let at_once = |tick: &&Row| tick.time_us - begun_us == row.time_us;
        if let Some(tick) = on_line[start..].iter().find(at_once) {
            assert_eq!(row.readings, tick.readings, "{} us", row.time_us);
            compared += 1;
        }
    }
    assert!(
        compared > on_bus.len() * 95 / 100,
        "{compared} of {} and {}",
        on_bus.len(),
        on_line.len()
    );
}

#[test]
fn a_port_or_bus_that_is_none_is_told_with_what_to_do() {
    let desk = Desk::empty();
    let said = desk.refused("monitor --port /dev/no-such-port");
    assert!(
        said.contains("there is no such port; this computer has"),
        "{said}"
    );
    let said = desk.refused("record --port /dev/null -o never");
    assert!(said.contains("cannot be opened as a serial port"), "{said}");
    assert!(!desk.0.path().join("never").exists());
    let said = desk.refused("monitor");
    assert!(
        said.contains("--port") && said.contains("--can") && said.contains("--virtual"),
        "{said}"
    );
    let said = desk.refused("monitor --can no-such-bus");
    assert!(said.contains("no-such-bus: "), "{said}");
    let said = desk.refused("monitor --virtual --unplug 9@1");
    assert!(said.contains("write SENSOR@SECONDS"), "{said}");
}

#[test]
fn both_commands_help_has_examples() {
    let desk = Desk::empty();
    for command in ["monitor", "record"] {
        let help = String::from_utf8(desk.done(&format!("{command} --help"))).unwrap();
        assert!(
            help.contains(&format!("  cargo magpie {command} --port /dev/ttyACM0")),
            "{help}"
        );
    }
}

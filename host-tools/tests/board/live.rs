//! A gripper watched and recorded while it runs, as a user meets it: the virtual board behind its line.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::Duration;

use device::recorder::{SensorRow, SensorRowAssembler};
use device::source::packet;
use embedded_can::Frame;
use firmware::config::limits::DetectionLimits;
use firmware::parameters::schema::id;
use firmware::parameters::{Parameters, op};
use firmware::protocol::DEFAULT_NODE;
use firmware::protocol::messages::{Message, ParamRequest};
use firmware::protocol::serial::{MAX_PACKET_BYTES, Packet, PacketDecoder, encode};
use firmware::tasks::FIRST_TICK_US;
use model_export::effects::CATALOGUE;
use model_export::inverse::build::{ModelVariant, build};
use model_export::recordings::Recording;
use model_export::recordings::align::Alignment;
use model_export::recordings::description::RecordingDescription;
use model_export::recordings::stream::RawStream;
use rustix::process::Signal;
use serde_json::{Value, json};
use sim::board::world::PressedWorld;
use sim::board::{Program, VirtualTimeBoard};
use tests::data;
use tungstenite::Message as WebSocketMessage;
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;

use crate::workdir::WorkDir;
use crate::workdir::running::Running;

/// Folder with a model without effects.
fn workdir() -> WorkDir {
    WorkDir::with_model("clean")
}

fn board_s(object: &Value) -> f64 {
    object["board_s"].as_f64().unwrap_or(0.0)
}

#[test]
fn force_is_reported_within_its_noise_until_the_reader_ends() {
    // Of the default model, whose tables are those of all four sensors.
    let dir = WorkDir::empty();
    let mut monitor = Running::start(&dir, "monitor --virtual --press 20,-10 --json");
    let mut objects = monitor.objects().skip_while(|object| board_s(object) < 0.5);
    let output: Vec<Value> = objects.by_ref().take(25).collect();
    for (sensor, x_n) in [20.0, 20.0, -20.0, -20.0].into_iter().enumerate() {
        for (force, expected) in [("fx_n", x_n), ("fz_n", -10.0)] {
            let values = output.iter().map(|object| {
                let sensor = &object["sensors"][sensor];
                assert_eq!(sensor["validity"], "valid");
                sensor[force].as_f64().unwrap()
            });
            // White noise of one tick is 0.5 N at the most, the tables' error 0.2 N.
            let mean = values.sum::<f64>() / output.len() as f64;
            assert!((mean - expected).abs() < 0.7, "{sensor} {force}: {mean}");
        }
    }
    // The load is sent once a second, and a busy machine may lose one.
    let has_load = |object: &Value| object["load"]["worst_tick_us"].is_u64();
    let last = objects.take(200).find(has_load).expect("a load");
    assert_eq!(last["faults"], Value::Array(Vec::new()));
    assert_eq!(last["lost"]["broken_packets"], 0);
    // A busy machine may lose one; what is counted but not sent would be a thousand a second.
    assert!(last["lost"]["messages"].as_u64() < Some(20), "{last}");
    assert_eq!(last["version"]["protocol"][0], 2);
    assert_eq!(last["heartbeat"]["sensors_ok"], 0b1111);
    assert!(last["load"]["worst_tick_us"].as_u64() > Some(200));
    // The objects' reader is gone.
    assert!(monitor.0.wait().unwrap().success());
}

/// Messages of one topic of the server at this address, as its channels describe them, until `count` have been received.
fn foxglove_messages(address: &str, topic: &str, count: usize) -> (Vec<Value>, Vec<Vec<f64>>) {
    let mut request = address.into_client_request().unwrap();
    let protocol = HeaderValue::from_static("foxglove.sdk.v1");
    request.headers_mut().insert("Sec-WebSocket-Protocol", protocol);
    let (mut socket, _) = tungstenite::connect(request).unwrap();
    let mut channels: Vec<Value> = Vec::new();
    let mut messages = Vec::new();
    while messages.len() < count {
        match socket.read().unwrap() {
            WebSocketMessage::Text(text) => {
                let message: Value = serde_json::from_str(&text).unwrap();
                if message["op"] != "advertise" {
                    continue;
                }
                channels.extend(message["channels"].as_array().unwrap().iter().cloned());
                let Some(channel) = channels.iter().find(|channel| channel["topic"] == topic)
                else {
                    continue;
                };
                let subscription = json!({ "id": 7, "channelId": channel["id"] });
                let text = json!({ "op": "subscribe", "subscriptions": [subscription] });
                socket.send(WebSocketMessage::text(text.to_string())).unwrap();
            }
            WebSocketMessage::Binary(data) if data.first() == Some(&1) => {
                // Subscription, nanoseconds, then the message: four bytes of CDR's header and numbers.
                assert_eq!(u32::from_le_bytes(data[1..5].try_into().unwrap()), 7);
                let numbers = data[17..].chunks_exact(8);
                let numbers = numbers.map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap()));
                messages.push(numbers.collect());
            }
            _ => {}
        }
    }
    (channels, messages)
}

#[test]
fn foxglove_receives_every_tick_and_the_layout_shows_existing_topics() {
    let dir = WorkDir::empty();
    let line = "monitor --virtual --press 20,-10 --foxglove 127.0.0.1:0 --json";
    let mut monitor = Running::start(&dir, line);
    monitor.drop_output();
    let mut text = BufReader::new(monitor.0.stderr.take().unwrap()).lines();
    let address = text.find_map(|line| Some(line.unwrap().split_once("connection ")?.1.to_owned()));
    let (channels, messages) = foxglove_messages(&address.unwrap(), "/estimate", 2000);
    let fields = |topic: &str| -> Vec<String> {
        let channel = channels.iter().find(|channel| channel["topic"] == topic);
        let channel = channel.unwrap_or_else(|| panic!("{topic}: {channels:?}"));
        assert_eq!(
            (&channel["encoding"], &channel["schemaEncoding"]),
            (&json!("cdr"), &json!("ros2msg"))
        );
        let lines = channel["schema"].as_str().unwrap().lines();
        lines.map(|line| line.split(' ').nth(1).unwrap().to_owned()).collect()
    };
    let of_estimate = fields("/estimate");
    for (name, expected) in [("f0_x_n", 20.0), ("f3_x_n", -20.0), ("f1_z_n", -10.0)] {
        let place = of_estimate.iter().position(|field| field == name).unwrap();
        let values: Vec<f64> = messages.iter().map(|numbers| numbers[place]).collect();
        // The first ticks are those of the start.
        let values = &values[1000..];
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        assert!((mean - expected).abs() < 0.7, "{name}: {mean}");
    }
    let layout = std::fs::read_to_string(data("../../host-tools/foxglove/gripper.json")).unwrap();
    let layout: Value = serde_json::from_str(&layout).unwrap();
    let panels = layout["configById"].as_object().unwrap().values();
    let mut paths = panels.flat_map(|panel| panel["paths"].as_array().unwrap());
    let is_live = |path: &&Value| !path["value"].as_str().unwrap().starts_with("/reference");
    let mut count = 0;
    while let Some(path) = paths.find(is_live) {
        let (topic, field) = path["value"].as_str().unwrap().split_once('.').unwrap();
        assert!(fields(topic).iter().any(|own| own == field), "{topic}.{field}");
        count += 1;
    }
    assert!(count >= 30, "{count}");
}

#[test]
fn only_foxglove_and_pages_of_this_machine_may_read() {
    let dir = WorkDir::empty();
    let allow = "--foxglove-allow gripper.lab --foxglove-allow https://foxglove.lab:8080";
    let line = format!("monitor --virtual --foxglove 127.0.0.1:0 {allow} --json");
    let mut monitor = Running::start(&dir, &line);
    monitor.drop_output();
    let mut text = BufReader::new(monitor.0.stderr.take().unwrap()).lines();
    let address = text.find_map(|line| Some(line.unwrap().split_once("ws://")?.1.to_owned()));
    let address = address.unwrap();
    let answer = |headers: &str| {
        let mut stream = TcpStream::connect(&address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let request = format!(
            "GET / HTTP/1.1\r\nconnection: Upgrade\r\nupgrade: websocket\r\nsec-websocket-version: 13\r\n\
             sec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\nsec-websocket-protocol: foxglove.sdk.v1\r\n{headers}\r\n"
        );
        stream.write_all(request.as_bytes()).unwrap();
        let mut bytes = [0; 512];
        let mut said = Vec::new();
        while !said.windows(4).any(|end| end == b"\r\n\r\n") {
            let count = stream.read(&mut bytes).unwrap();
            assert!(count > 0, "{headers}: closed after {said:?}");
            said.extend(&bytes[..count]);
        }
        let said = String::from_utf8_lossy(&said).into_owned();
        said.split(' ').nth(1).unwrap().parse::<u16>().unwrap()
    };
    let port = address.split_once(':').unwrap().1;
    for host in [
        "127.0.0.1",
        "localhost",
        "LocalHost",
        "[::1]",
        "127.9.9.9",
        "gripper.lab",
        "[::ffff:127.0.0.1]",
    ] {
        assert_eq!(answer(&format!("host: {host}:{port}\r\n")), 101, "{host}");
        assert_eq!(answer(&format!("host: {host}\r\n")), 101, "{host}");
    }
    let own = format!("host: {address}\r\n");
    for host in [
        "evil.example",
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "evil.example@127.0.0.1",
        "10.0.0.1",
        "192.168.1.7",
        "0.0.0.0",
        "[fe80::1]",
        "notlocalhost",
        "2130706433",
        "",
        "127.0.0.1/",
        "sub.gripper.lab",
    ] {
        assert_eq!(answer(&format!("host: {host}:{port}\r\n")), 403, "{host}");
    }
    assert_eq!(answer(""), 403);
    assert_eq!(answer(&format!("{own}host: evil.example\r\n")), 403);
    for origin in [
        "https://app.foxglove.dev",
        "file://",
        "http://localhost",
        "http://localhost:8080",
        "https://127.0.0.1:3000",
        "http://[::1]:8080",
        "https://foxglove.lab:8080",
    ] {
        assert_eq!(answer(&format!("{own}origin: {origin}\r\n")), 101, "{origin}");
    }
    for origin in [
        "https://evil.example",
        "null",
        "",
        "http://app.foxglove.dev",
        "https://app.foxglove.dev.evil.example",
        "https://app.foxglove.dev:444",
        "https://evil.example/app.foxglove.dev",
        "http://localhost.evil.example",
        "file://evil",
        "http://localhost@evil.example",
        "https://foxglove.lab",
        "http://192.168.1.7",
        "chrome-extension://localhost",
    ] {
        assert_eq!(answer(&format!("{own}origin: {origin}\r\n")), 403, "{origin}");
    }
    assert_eq!(answer(&format!("{own}origin: file://\r\norigin: https://evil.example\r\n")), 403);
}

#[test]
fn unplugged_sensor_is_reported_within_milliseconds() {
    let dir = workdir();
    let line = "monitor --virtual --model model.toml --press 20,0 --unplug 2@1.5 --json";
    let mut monitor = Running::start(&dir, line);
    let faulty = monitor.objects().find(|object| {
        assert!(board_s(object) < 60.0, "no fault is reported");
        object["faults"][0]["name"] == "sensor lost" && board_s(object) > 1.6
    });
    let faulty = faulty.unwrap();
    let fault = &faulty["faults"][0];
    assert_eq!((&fault["code"], &fault["source"]), (&100.into(), &2.into()));
    let reported_s = fault["since_board_s"].as_f64().unwrap();
    assert!((1.5..1.51).contains(&reported_s), "{reported_s}");
    assert_eq!(faulty["sensors"][2]["validity"], "no reading");
    assert_eq!(faulty["sensors"][3]["validity"], "valid");
}

#[test]
fn without_a_terminal_one_line_per_second_is_printed() {
    let dir = workdir();
    let line = "monitor --virtual --model model.toml --press 30,5 --seconds 2.5";
    let output = String::from_utf8(dir.stdout(line)).unwrap();
    let lines: Vec<&str> = output.lines().collect();
    assert!(lines[0].starts_with("~ ") && lines[1].contains("Fx, Fz 3 / N"), "{output}");
    assert!((3..=4).contains(&lines.len()), "{output}");
    assert!(lines[2].ends_with("  safe"), "{output}");
    assert!(!output.contains('\u{1b}'));
}

#[test]
fn other_programs_use_the_virtual_board_line() {
    let dir = workdir();
    let mut monitor = Running::start(&dir, "monitor --virtual --model model.toml --seconds 60");
    let (path, _said) = monitor.line();
    let mut line = File::options().read(true).write(true).open(path).unwrap();
    let request = Message::ParamRequest(ParamRequest {
        op: op::READ,
        id: id::FORCE_RATE,
        ..ParamRequest::default()
    });
    let mut buffer = [0; MAX_PACKET_BYTES];
    let asked = Packet::Message { copy: 0, message: request };
    line.write_all(encode(&asked, &mut buffer).unwrap()).unwrap();
    let mut receiver = PacketDecoder::default();
    let (mut ticks, mut rate) = (Vec::new(), None);
    let mut bytes = [0; 512];
    while ticks.len() < 200 || rate.is_none() {
        let count = line.read(&mut bytes).unwrap();
        for byte in &bytes[..count] {
            match receiver.push(*byte) {
                Some(Packet::Tick(tick)) => ticks.push(tick.time_us),
                Some(Packet::Message { message: Message::ParamReply(reply), .. }) => {
                    rate = Some(reply.value)
                }
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
        assert!(running.0.try_wait().unwrap().is_none(), "it ended by itself");
        std::thread::sleep(Duration::from_millis(3));
    }
}

/// Time in seconds of the last row of a table of a recording.
fn last_s(table: &Path) -> f64 {
    let mut text = String::new();
    let file = File::open(table).unwrap();
    match table.extension().is_some_and(|extension| extension == "gz") {
        true => flate2::read::MultiGzDecoder::new(file).read_to_string(&mut text).unwrap(),
        false => BufReader::new(file).read_to_string(&mut text).unwrap(),
    };
    let (last, _) = text.lines().last().unwrap().split_once(',').unwrap();
    1e-6 * last.trim().parse::<f64>().unwrap()
}

#[test]
fn killed_recordings_are_valid_up_to_the_last_second() {
    let dir = workdir();
    let reference = "columns = [{ column = 1, unit = \"N\", to = \"f0_x_n\" }]\n";
    std::fs::write(dir.path("map.toml"), reference).unwrap();
    for (number, wanted) in [1, 250, 777, 1333, 1999, 2001, 2400, 3333].into_iter().enumerate() {
        let has_reference = number % 2 == 1;
        let server = has_reference.then(|| line_server(u32::MAX, |row| format!("{row}\n")));
        let mut line = format!(
            "record --virtual --model model.toml --press 10,5 -o k/{number} --mcap k{number}.mcap --start-s 0"
        );
        if let Some((port, _)) = &server {
            line += &format!(" --reference tcp:127.0.0.1:{port} --reference-map map.toml");
        }
        let mut record = Running::start(&dir, &line);
        let folder = dir.path(&format!("k/{number}"));
        let before = grown(&folder, wanted, &mut record);
        // With the first row of the reference; then not always right after a flush.
        while std::fs::read_to_string(folder.join("force.csv")).unwrap().lines().count() < 2 {
            std::thread::sleep(Duration::from_millis(3));
        }
        std::thread::sleep(Duration::from_millis(61 * number as u64));
        record.signal(Signal::KILL);
        record.0.wait().unwrap();
        if let Some((_, sender)) = server {
            sender.join().unwrap();
        }
        let force = std::fs::read_to_string(folder.join("force.csv")).unwrap();
        assert!(force.starts_with("t_us,f0_x_n"), "{number}: {force}");
        let after = rows(&folder);
        assert_eq!(after[..before.len()], before, "{number}");
        assert!(after.windows(2).all(|pair| pair[1][0] - pair[0][0] == 1_000_000), "{number}");
        let csv_s = last_s(&folder.join("hall.csv"));
        let recording = Recording::read(&folder, Alignment { delay_us: 0.0 }).unwrap();
        assert!(recording.notices.iter().all(|notice| !notice.message.contains("cut off")));
        if !has_reference {
            assert_eq!(recording.rows_read.0 as usize, after.len(), "{number}");
            assert!(recording.notices.is_empty(), "{number}: {:?}", recording.notices);
        }
        dir.stdout(&format!("import --guess k{number}.mcap -o k{number}.toml"));
        let imported =
            dir.run(&format!("import k{number}.toml k{number}.mcap -o imported{number}"));
        let text = String::from_utf8_lossy(&imported.stderr).into_owned()
            + &String::from_utf8_lossy(&imported.stdout);
        assert!(imported.status.success(), "{number}: {text}");
        let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words.contains("read up to its last whole chunk,"), "{number}: {text}");
        let mcap_s = last_s(&dir.path(&format!("imported{number}/1/hall.csv.gz")));
        // The CSV tables are at most half a second behind, or ahead by one chunk.
        assert!(mcap_s > csv_s - 1.1, "{number}: {mcap_s} of {csv_s}");
    }
}

#[test]
fn reference_that_ends_first_is_reported_and_keeps_its_rows() {
    let dir = workdir();
    let mapping = "columns = [{ column = 1, unit = \"N\", to = \"f0_x_n\" }]\n";
    std::fs::write(dir.path("map.toml"), mapping).unwrap();
    let record = |rows: u32, options: &str| {
        let (port, sender) = line_server(rows, |row| format!("{row}\n"));
        let output = dir.run(&format!(
            "record --virtual --model model.toml --seconds 4 --reference tcp:127.0.0.1:{port} --reference-map map.toml {options}"
        ));
        sender.join().unwrap();
        output
    };
    let output = record(150, "-o ended --json");
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(20), "{errors}");
    assert_eq!(errors.matches("the reference ended after ").count(), 2, "{errors}");
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    let end_s = summary["reference_ended_s"].as_f64().unwrap();
    let rows = summary["reference_rows"].as_u64().unwrap();
    assert!(end_s > 0.5 && end_s < summary["span_s"].as_f64().unwrap(), "{summary}");
    let force = std::fs::read_to_string(dir.path("ended/force.csv")).unwrap();
    assert!(rows > 20 && force.lines().count() as u64 == rows + 1, "{rows}: {force}");
    assert!(force.lines().last().unwrap().trim_end().ends_with(",149.0000"), "{force}");
    // Without any row of it the recording is kept and reported, too.
    let output = record(0, "-o none");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(20), "{text}");
    assert!(text.contains("Incomplete: the reference ended after 0."), "{text}");
    assert!(last_s(&dir.path("none/hall.csv")) > 1.0);
}

#[test]
fn ctrl_c_ends_a_recording_without_overwriting() {
    let dir = workdir();
    let line = "record --virtual --model model.toml -o campaign/1 --note pressed --json";
    let mut record = Running::start(&dir, line);
    let folder = dir.path("campaign/1");
    grown(&folder, 600, &mut record);
    record.signal(Signal::INT);
    let output = record.objects().next().unwrap();
    assert!(record.0.wait().unwrap().success());
    assert_eq!(output["rows"], rows(&folder).len());
    assert_eq!((&output["lost_rows"], &output["left_out_rows"]), (&0.into(), &0.into()));
    assert_eq!(output["sensors"], serde_json::json!([0, 1, 2, 3]));
    let (description, notices) = RecordingDescription::read(&folder).unwrap();
    assert!(notices.is_empty());
    assert_eq!((description.description.as_str(), description.start_s), ("pressed", 0.0));
    let message = dir.failure("record --virtual --model model.toml -o campaign/1");
    assert!(message.contains("not overwritten"), "{message}");
    // The next one starts as long after it as the clock says.
    let line = "record --virtual --model model.toml -o campaign/2 --seconds 1 --json";
    let next = dir.json(line);
    assert!(next["start_s"].as_f64() >= Some(0.0));
}

#[test]
fn plan_is_recorded_step_by_step() {
    let dir = workdir();
    let step = "[[step]]\nseconds = 2\nopening_mm = [10, 10]\n";
    // Nobody loads the virtual board: the second step is prolonged, and reported.
    let plan = format!("{step}{step}load = \"hold\"\nload_n = [80, 0]\n");
    std::fs::write(dir.path("plan.toml"), plan).unwrap();
    let line = "record --virtual --model model.toml --plan plan.toml -o campaign/1 --json";
    let output = dir.run(line);
    assert!(output.status.success());
    let shown = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(shown.contains("Step 1 of 2, 2 s: do not load the fingers"), "{shown}");
    assert!(shown.contains("Enough. Step 2 of 2, 2 s: hold 80 N lateral"), "{shown}");
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    let seconds = |step: usize| summary["steps"][step]["seconds"].as_f64().unwrap();
    assert!((1.9..2.2).contains(&seconds(0)) && (5.9..6.3).contains(&seconds(1)), "{summary}");
    assert_eq!(summary["steps"][0]["not_covered"], serde_json::json!([]));
    assert_eq!(summary["steps"][1]["not_covered"][0]["quantity"], "lateral force");
    let again = line.replace("campaign/1", "campaign/2");
    let message = dir.failure(&format!("{again} --plan-recording 2"));
    assert!(message.contains("the plan has 1"), "{message}");
}

#[test]
fn recorded_counts_equal_the_replayed_ones() {
    let dir = workdir();
    let (source, seconds) = (data("clean/1"), 3);
    let source_copy = dir.path("source_copy");
    std::fs::create_dir(&source_copy).unwrap();
    std::fs::copy(source.join("recording.toml"), source_copy.join("recording.toml")).unwrap();
    for (name, rate) in [("hall.csv", 1000), ("force.csv", 100)] {
        let packed = File::open(source.join(format!("{name}.gz"))).unwrap();
        let text = std::io::read_to_string(flate2::read::MultiGzDecoder::new(packed)).unwrap();
        let lines: Vec<&str> = text.lines().take(1 + rate * seconds).collect();
        std::fs::write(source_copy.join(name), lines.join("\n") + "\n").unwrap();
    }
    let output =
        dir.json("record --virtual --model model.toml --replay source_copy -o again/1 --json");
    assert_eq!((&output["lost_rows"], &output["left_out_rows"]), (&0.into(), &0.into()));
    let fields = |folder: &Path| {
        let mut stream = RawStream::open_folder(folder, Alignment { delay_us: 0.0 }).unwrap();
        let channels = [0, 1, 2, 3].map(|sensor| stream.layout().field_channels(sensor).unwrap());
        let mut rows = Vec::new();
        while let Some(row) = stream.next_row().unwrap() {
            rows.push(channels.map(|channels| channels.map(|channel| row.hall[channel])));
        }
        rows
    };
    let (source_copy, again) = (fields(&source_copy), fields(&dir.path("again/1")));
    // While it was asked for its parameters the board went on; it ends with the recording.
    let start = source_copy.iter().position(|row| *row == again[0]).unwrap();
    let common = again.len().min(source_copy.len() - start);
    assert!(common >= 1000, "{common} rows");
    assert_eq!(again[..common], source_copy[start..start + common]);
}

#[test]
fn can_bus_carries_the_readings_of_the_serial_line() {
    let dir = workdir();
    let built = build(&dir.path("model.toml"), ModelVariant::Fitted).unwrap();
    let world = PressedWorld::new(&built.model, 7, |s| {
        [[10.0 * s, 5.0], [1.0, 2.0], [-10.0 * s, 0.0], [3.0; 2]]
    });
    let mut parameters = Parameters::DEFAULT;
    parameters.set(id::RAW, 1).unwrap();
    parameters.set(id::FORCE_RATE, 250).unwrap();
    let program = Program {
        tables: built.chosen.tables.clone(),
        compensations: built.compensations.clone(),
        networks: None,
        description: "",
        parameters,
        limits: DetectionLimits::GRIPPER,
    };
    let mut board = VirtualTimeBoard::start(program, Box::new(world));
    board.run_until(FIRST_TICK_US + 1_500_000);
    let gathered = |mut rows: SensorRowAssembler, packets: Vec<(u64, Packet)>| -> Vec<SensorRow> {
        let rows =
            packets.iter().filter_map(|(us, packet)| rows.take(*us as f64 * 1e-6, packet).unwrap());
        rows.collect()
    };
    let can = board.connections.can.borrow();
    let frames = can.board_frames.iter().filter_map(|(us, frame)| {
        packet(DEFAULT_NODE, frame.identifier(), frame.data()).map(|packet| (*us, packet))
    });
    let on_bus = gathered(SensorRowAssembler::of_sets(4000), frames.collect());
    let mut receiver = PacketDecoder::default();
    let line = board.connections.line.borrow();
    let packets = line.sent.iter().filter_map(|byte| receiver.push(*byte));
    let on_line =
        gathered(SensorRowAssembler::of_ticks(), packets.map(|packet| (0, packet)).collect());
    let start = on_line.iter().position(|row| row.readings == on_bus[0].readings).unwrap();
    assert!(on_bus.len() > 370, "{}", on_bus.len());
    // The bus tells no time: that comes from its counters. Either may leave a tick out, and then no later
    // one may be taken for it.
    let begun_us = on_line[start].time_us;
    let mut compared = 0;
    for row in &on_bus {
        let at_once = |tick: &&SensorRow| tick.time_us - begun_us == row.time_us;
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
fn unusable_ports_and_buses_are_errors_with_a_remedy() {
    let dir = WorkDir::empty();
    for (line, words) in [
        ("monitor --port /dev/no-such-port", &["there is no such port; this computer has"][..]),
        ("record --port /dev/null -o never", &["cannot be opened as a serial port"]),
        ("monitor", &["--port", "--can", "--virtual"]),
        ("monitor --can no-such-bus", &["no-such-bus: "]),
        ("monitor --virtual --unplug 9@1", &["write SENSOR@SECONDS"]),
    ] {
        let message = dir.failure(line);
        assert!(words.iter().all(|word| message.contains(word)), "{line}: {message}");
    }
    assert!(!dir.path("never").exists());
}

/// Port of a socket that sends `rows` lines, one every 10 ms, each made from its number; ends early when the socket is closed.
fn line_server(rows: u32, line: fn(u32) -> String) -> (u16, std::thread::JoinHandle<()>) {
    let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = server.local_addr().unwrap().port();
    let sender = std::thread::spawn(move || {
        let (mut stream, _) = server.accept().unwrap();
        for row in 0..rows {
            if stream.write_all(line(row).as_bytes()).is_err() {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    });
    (port, sender)
}

#[test]
fn reference_on_a_socket_is_recorded_alongside() {
    let dir = workdir();
    // Begins within a line. Constant forces: a delay cannot be determined.
    let (port, sender) = line_server(u32::MAX, |row| {
        let cut = if row == 0 { "3;" } else { "" };
        format!("{cut}{}; 2.5; {}\n", 10 * row, 100 + row % 2)
    });
    let mapping = "clock = { column = 1, unit = \"ms\" }\n\
                   columns = [{ column = 2, unit = \"kg\", to = \"f0_x_n\", scale = -1 }]\n";
    std::fs::write(dir.path("map.toml"), mapping).unwrap();
    let output = dir.stdout(&format!(
        "record --virtual --model model.toml --press 20,-10 --seconds 3 -o bench --json \
         --reference tcp:127.0.0.1:{port} --reference-map map.toml"
    ));
    let output: Value = serde_json::from_slice(&output).unwrap();
    assert_eq!(output["reference"], true);
    assert_eq!(output["reference_delay"], Value::Null);
    assert!(output["reference_rows"].as_u64().unwrap() > 100, "{output}");
    assert_eq!(output["covariates"], serde_json::json!([]));
    let table = std::fs::read_to_string(dir.path("bench/force.csv")).unwrap();
    let lines: Vec<&str> = table.lines().map(str::trim_end).collect();
    assert_eq!(lines[0], "t_us,f0_x_n");
    let last: Vec<f64> =
        lines[lines.len() - 1].split(',').map(|cell| cell.parse().unwrap()).collect();
    // 2.5 kg are 24.5166 N. Rows that arrive while a busy machine ends the recording are later than its 3 s.
    assert!((last[1] + 24.5166).abs() < 1e-3 && last[0] < 4e6, "{last:?}");
    sender.join().unwrap();
}

#[test]
fn delay_of_an_unrelated_reference_is_not_applied() {
    let dir = workdir();
    // Loads of something else, while the virtual board grasps.
    let (port, sender) = line_server(u32::MAX, |row| {
        let time_s = 0.01 * f64::from(row);
        let load = |rad_s: f64| 10.0 * (rad_s * time_s).sin();
        format!("{}; {}\n", 10 * row, load(3.1) + load(7.7) + load(17.3))
    });
    let mapping = "clock = { column = 1, unit = \"ms\" }\n\
                   columns = [{ column = 2, unit = \"N\", to = \"f0_x_n\" }]\n";
    std::fs::write(dir.path("map.toml"), mapping).unwrap();
    let output = dir.run(&format!(
        "record --virtual --model model.toml --seconds 6 -o bench --reference tcp:127.0.0.1:{port} --reference-map map.toml"
    ));
    sender.join().unwrap();
    let text =
        String::from_utf8_lossy(&output.stdout).split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(output.status.success(), "{text}");
    assert!(text.contains("its delay cannot be determined, because"), "{text}");
    assert!(text.contains("t_us of force.csv is that of arrival"), "{text}");
    assert!(!text.contains("is corrected by it"), "{text}");
}

#[test]
fn pose_of_the_host_is_recorded_as_covariates_of_the_board() {
    let dir = workdir();
    // Roll 30 degrees; a yaw of 0.5 rad/s; 2 m/s^2 along x.
    let (port, sender) =
        line_server(u32::MAX, |row| format!("30 0 {} 2 0 0\n", 0.005 * f64::from(row)));
    let columns = [
        ("deg", "roll_rad"),
        ("deg", "pitch_rad"),
        ("rad", "yaw_rad"),
        ("m/s2", "linear_accel_x_mps2"),
        ("m/s2", "linear_accel_y_mps2"),
        ("m/s2", "linear_accel_z_mps2"),
    ];
    let columns = columns.iter().zip(1..).map(|((unit, to), column)| {
        format!("{{ column = {column}, unit = \"{unit}\", to = \"{to}\" }}")
    });
    let mapping = format!("columns = [{}]\n", columns.collect::<Vec<_>>().join(", "));
    std::fs::write(dir.path("pose.toml"), mapping).unwrap();
    let output = dir.json(&format!(
        "record --virtual --model model.toml --press 20,-10 --seconds 3 -o pose --json \
         --reference tcp:127.0.0.1:{port} --reference-map pose.toml"
    ));
    sender.join().unwrap();
    assert_eq!(output["reference"], false);
    let sent = output["pose_messages"].as_u64().unwrap();
    // A busy machine sends fewer.
    assert!((10..=300).contains(&sent), "{sent}");
    let recording = Recording::read(&dir.path("pose"), Alignment { delay_us: 0.0 }).unwrap();
    let column = |name: &str| &recording.covariates[name];
    assert!(column("roll_rad").iter().all(|rad| (rad.to_degrees() - 30.0).abs() < 0.06));
    assert!(column("pitch_rad").iter().all(|rad| rad.abs() < 1e-3));
    let yaw = column("yaw_rad");
    let rate = (yaw[yaw.len() - 1] - yaw[0]) / recording.span_s();
    assert!(yaw.is_sorted() && (0.2..0.7).contains(&rate), "{rate}");
    // Gravity in gripper axes: 9.807 m/s^2 along sine and cosine of the roll.
    let specific_force = [2.0, 9.807 * 0.5, 9.807 * 0.866];
    for (name, expected) in
        ["accel_x_mps2", "accel_y_mps2", "accel_z_mps2"].iter().zip(specific_force)
    {
        let mps2 = column(name)[column(name).len() / 2];
        assert!((mps2 - expected).abs() < 0.01, "{name}: {mps2}");
    }
}

#[test]
fn check_names_what_a_recording_can_decide() {
    let dir = workdir();
    let checked = |line: &str| {
        let line = format!("record --virtual --model model.toml {line} --check --json");
        dir.json(&line)["check"].clone()
    };
    let effect = |check: &Value, name: &str| {
        let effects = check["effects"].as_array().unwrap();
        assert_eq!(effects.len(), CATALOGUE.len());
        effects.iter().find(|effect| effect["effect"] == name).unwrap().clone()
    };
    // A constant load decides nothing.
    let little = checked("--press 10,5 --seconds 6 -o little");
    assert_eq!(effect(&little, "hysteresis")["decidable"], false);
    let reason = effect(&little, "hysteresis")["reason"].to_string();
    assert!(reason.contains("a constant load does not determine the response"), "{reason}");
    // Loads of both axes in both directions.
    let folder = data("clean/1");
    let much = checked(&format!("--replay {} --seconds 8 -o much", folder.display()));
    assert_eq!(much["estimated_forces"], 8);
    for name in ["hysteresis", "cross_coupling", "viscous_lag"] {
        assert_eq!(effect(&much, name)["decidable"], true, "{name}");
    }
    let opening = effect(&much, "neighbour_magnet");
    assert_eq!(opening["decidable"], false);
    assert_eq!(opening["reason"], "opening_mm was not recorded");
    assert!(opening["record"].as_str().unwrap().starts_with("Open and close"), "{opening}");
    let share = |check: &Value, name: &str| {
        let ranges = check["ranges"].as_array().unwrap();
        ranges.iter().find(|range| range["quantity"] == name).unwrap()["share"].as_f64().unwrap()
    };
    assert!(share(&little, "lateral force") < 0.02, "{little}");
    assert!(share(&much, "lateral force") > 0.1, "{much}");
}

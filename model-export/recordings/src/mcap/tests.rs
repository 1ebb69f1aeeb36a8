mod hostile;

use std::collections::BTreeMap;
use std::fs::File;

use tempfile::TempDir;

use mcap::MAGIC;

use super::*;
use crate::description::RecordingDescription;

/// One message of a channel: topic, schema name, schema encoding, schema, message encoding.
type Sent<'a> = (&'a str, &'a str, &'a str, &'a str, &'a str);

fn write(path: &Path, messages: &[(Sent<'_>, u64, Vec<u8>)]) {
    let mut writer = mcap::Writer::new(File::create(path).unwrap()).unwrap();
    for ((topic, name, encoding, schema, message_encoding), time_ns, data) in messages {
        let schema = writer.add_schema(name, encoding, schema.as_bytes()).unwrap();
        let channel =
            writer.add_channel(schema, topic, message_encoding, &BTreeMap::new()).unwrap();
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: 0,
            log_time: *time_ns,
            publish_time: *time_ns,
        };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
}

fn all(path: &Path) -> Vec<Topic> {
    read_topics(path, |_| true, Undecodable::Refuse).unwrap().topics
}

/// As `rosbags` writes the type, shortened.
const MAGNETIC_FIELD: &str = "std_msgs/Header header\ngeometry_msgs/Vector3 magnetic_field\nfloat64[3] diagonal\n\
    ================================================================================\n\
    MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n\
    ================================================================================\n\
    MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n\
    ================================================================================\n\
    MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n";

const MAG: Sent<'static> =
    ("/s0/mag", "sensor_msgs/msg/MagneticField", "ros2msg", MAGNETIC_FIELD, "cdr");

/// Plain CDR by hand (OMG CDR 15.3): after the header, numbers at multiples of their size, text with length and zero.
fn magnetic_field(sec: i32, nanosec: u32, field: [f64; 3]) -> Vec<u8> {
    let mut data = vec![0, 1, 0, 0];
    data.extend(sec.to_le_bytes());
    data.extend(nanosec.to_le_bytes());
    data.extend(3_u32.to_le_bytes());
    data.extend(b"ab\0");
    // 15 bytes of content, the next number of eight bytes at 16.
    data.push(0);
    field.iter().chain(&[7.0, 8.0, 9.0]).for_each(|value| data.extend(value.to_le_bytes()));
    data
}

#[test]
fn messages_of_ros_2_become_numbers_with_paths() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("a.mcap");
    let data = magnetic_field(1_764_000_000, 250, [1.5e-5, -0.125, 3.0]);
    write(&path, &[(MAG, 42, data)]);
    let topics = all(&path);
    let [topic] = topics.as_slice() else { panic!("{topics:?}") };
    let value = |path: &str| topic.values(path).unwrap()[0];
    assert_eq!(value("log_time"), 42.0);
    assert_eq!(value("header.stamp"), 1_764_000_000_000_000_250_f64);
    assert_eq!(value("magnetic_field.x"), 1.5e-5);
    assert_eq!(value("magnetic_field.y"), -0.125);
    assert_eq!(value("diagonal[2]"), 9.0);
    assert_eq!(topic.unit("magnetic_field.x").as_deref(), Some("T"));
    assert_eq!(common_clock(&topics), "header.stamp");
    assert!(topic.values("header.frame_id").is_none());
}

#[test]
fn fields_of_json_may_come_and_go() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("a.mcap");
    let json: Sent<'_> = ("/ft", "ft", "jsonschema", "{}", "json");
    let messages = [
        r#"{"f": [1, 2], "t": {"sec": 3, "nsec": 5}, "ok": true}"#,
        r#"{"g": 4.5}"#,
        r#"{"f": [6]}"#,
    ];
    let messages: Vec<_> = messages
        .iter()
        .zip(1..)
        .map(|(text, time)| (json, time, text.as_bytes().to_vec()))
        .collect();
    write(&path, &messages);
    let topics = all(&path);
    let values = |path: &str| topics[0].values(path).unwrap().to_vec();
    assert_eq!(values("t")[0], 3_000_000_005.0);
    assert_eq!((values("f[0]")[0], values("f[0]")[2], values("f[1]")[0]), (1.0, 6.0, 2.0));
    assert!(values("f[0]")[1].is_nan() && values("f[1]")[2].is_nan());
    assert!(values("g")[0].is_nan() && values("g")[1] == 4.5);
    assert_eq!(values("g").len(), 3);
    assert!(topics[0].values("ok").is_none());
}

fn topic(name: &str, time_ns: &[f64], values: &[f64]) -> Topic {
    let column =
        |path: &str, values: &[f64]| TopicColumn { path: path.to_owned(), values: values.to_vec() };
    let columns = vec![column(LOG_TIME, time_ns), column("v", values)];
    Topic { name: name.to_owned(), columns, ..Topic::default() }
}

fn joined(topics: &[Topic], column: &str, join: Join) -> Vec<String> {
    let joined =
        join_topics(Path::new("a.mcap"), topics, "/a.log_time", &[(column, None)], join).unwrap();
    let text = String::from_utf8(joined.text).unwrap();
    text.lines().skip(1).map(|line| line.split(',').nth(1).unwrap().to_owned()).collect()
}

#[test]
fn topics_are_joined_by_time() {
    let rows: Vec<f64> = (0..30).map(f64::from).collect();
    // Every second row, 0.4 later, unordered, with a gap from 12.4 to 24.4.
    let times = [4.4, 0.4, 2.4, 6.4, 8.4, 10.4, 12.4, 24.4, 26.4, 28.4];
    let topics = [topic("/a", &rows, &rows), topic("/b", &times, &times)];
    let nearest = joined(&topics, "/b.v", Join::EveryRow);
    // Interpolated to the times of the rows; before the first message it is that one.
    assert_eq!(nearest[..6], ["0.4", "1", "2", "3", "4", "5"]);
    // The gap is longer than five periods of 2 around row 18: 10 on either side reach over it, a wider one does not.
    assert_eq!((nearest[18].as_str(), nearest[19].as_str()), ("12.4", "24.4"));
    let wide = [0.0, 1.0, 2.0, 3.0, 29.0];
    let wide = [topic("/a", &rows, &rows), topic("/b", &wide, &wide)];
    let values = joined(&wide, "/b.v", Join::EveryRow);
    assert_eq!((values[8].as_str(), values[9].as_str(), values[24].as_str()), ("3", "", "29"));
    let once = joined(&topics, "/b.v", Join::Once);
    assert_eq!(once[..6], ["0.4", "", "2.4", "", "4.4", ""]);
    assert_eq!(once.iter().filter(|cell| !cell.is_empty()).count(), times.len());
}

#[test]
fn shift_of_a_second_sensor_is_interpolated_and_stated() {
    // 200 Hz, the second 3 ms later; an angle that wraps.
    let rows: Vec<f64> = (0..50).map(|row| 5e6 * f64::from(row)).collect();
    let later: Vec<f64> = rows.iter().map(|time| time + 3e6).collect();
    let angles: Vec<f64> = (0..50).map(|row| f64::from(row % 10) - 5.0).collect();
    let topics = [topic("/a", &rows, &rows), topic("/b", &later, &later)];
    for join in [Join::EveryRow, Join::Once] {
        let columns = [("/b.v", None)];
        let joined = join_topics(Path::new("a"), &topics, "/a.log_time", &columns, join).unwrap();
        let text = String::from_utf8(joined.text).unwrap();
        assert!(text.lines().skip(2).all(|line| {
            let (time, value) = line.split_once(',').unwrap();
            (time.parse::<f64>().unwrap() - value.parse::<f64>().unwrap()).abs() < 1.0
        }));
        // The nearest row of a message 3 ms after one row is 2 ms after it.
        let [channel] = &joined.joined[..] else { panic!("{:?}", joined.joined) };
        assert!(channel.to_string().contains("/b was sampled -2.00 ms"), "{channel}");
        assert_eq!(channel.columns, ["/b.v"]);
        // 0.4 of the next: third differences have 3.2 in place of 20 times the variance of the samples, a row 0.52 of it.
        let of_row = if join == Join::EveryRow { 1.0 } else { 0.52 };
        let expected = f64::sqrt(of_row * 20.0 / 3.2);
        assert!((channel.noise_factor - expected).abs() < 0.02, "{channel:?} {expected}");
    }
    let values = interpolated(&rows, &later, &angles, 3.0);
    assert!(values.iter().all(|value| angles.contains(value) || value.fract() != 0.0));
    assert!(values[2..].windows(2).all(|pair| pair[1] > pair[0] || pair[1] < pair[0] - 3.0));
}

#[test]
fn recording_round_trips_bit_by_bit() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("1.mcap");
    let mut description = RecordingDescription::new("bench \"a\"", 600.0);
    description.gauss_per_lsb = Some(0.125);
    let [hall, force] =
        [["s0_x_lsb", "opening_mm"], ["f0_x_n", "f0_z_n"]].map(|names| names.map(str::to_owned));
    let state = [StateTopic { name: "Power", signals: vec![("bus", "V"), ("counter", "")] }];
    let columns = TopicColumns { hall: &hall, force: &force, sensors: &[0], state: &state };
    let mut file = RecordingMcap::create(&path, &description, columns).unwrap();
    file.board(1000.0, &[-97.0, 0.1 + 0.2]).unwrap();
    file.reference(1000.0, &[f64::NAN, -0.0]).unwrap();
    let estimate = EstimatedForce { force_n: Some([1.0 / 3.0, 2.0]), sigma_n: None };
    file.estimate(1000.0, std::iter::once(estimate)).unwrap();
    file.state(0, 2000.0, &[24.12, 7.0]).unwrap();
    file.finish().unwrap();
    let topics = all(&path);
    let value = |topic: &str, field: &str| {
        let topic = topics.iter().find(|own| own.name == topic).unwrap();
        topic.values(field).unwrap()[0]
    };
    assert_eq!(value("/board", "log_time"), 600_001_000_000.0);
    assert_eq!(value("/board", "opening_mm").to_bits(), (0.1_f64 + 0.2).to_bits());
    assert!(value("/reference", "f0_x_n").is_nan());
    assert_eq!(value("/reference", "f0_z_n").to_bits(), (-0.0_f64).to_bits());
    assert_eq!(value("/estimate", "f0_x_n"), 1.0 / 3.0);
    assert!(value("/estimate", "f0_x_sigma_n").is_nan());
    assert_eq!(value("/state/Power", "bus"), 24.12);
    let unit = |name: &str| topics[0].unit(name);
    assert_eq!(
        (unit("s0_x_lsb").as_deref(), unit("opening_mm").as_deref()),
        (Some("lsb"), Some("mm"))
    );
    let mapping = stated_mapping(&path).unwrap().unwrap();
    assert!(
        mapping.contains("from = \"/board.s0_x_lsb\"") && mapping.contains("gauss_per_lsb = 0.125")
    );
    // A file of others states none.
    let other = folder.path().join("b.mcap");
    write(&other, &[(MAG, 1, magnetic_field(0, 0, [0.0; 3]))]);
    assert_eq!(stated_mapping(&other).unwrap(), None);
}

/// A recording of 3.5 s with its flushed length after each row of 1 ms, not completed.
fn cut_recording(path: &Path) -> Vec<u64> {
    let description = RecordingDescription::new("", 600.0);
    let hall = ["s0_x_lsb".to_owned()];
    let columns = TopicColumns { hall: &hall, force: &[], sensors: &[0], state: &[] };
    let mut file = RecordingMcap::create(path, &description, columns).unwrap();
    let length = || path.metadata().map_or(0, |metadata| metadata.len());
    let mut lengths = vec![length()];
    for ms in 0..3500 {
        file.board(1e3 * f64::from(ms), &[f64::from(ms)]).unwrap();
        lengths.push(length());
    }
    lengths
}

#[test]
fn file_appears_with_messages_and_grows_by_a_second_at_most() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("a.mcap");
    let lengths = cut_recording(&path);
    assert_eq!(lengths[0], 0);
    // A slow machine ends chunks earlier.
    let ends: Vec<usize> =
        (1..lengths.len()).filter(|row| lengths[*row] > lengths[row - 1]).collect();
    assert!(ends.len() >= 3, "{ends:?}");
    assert!([0].iter().chain(&ends).zip(&ends).all(|(a, b)| b - a <= 1001), "{ends:?}");
    // What had no message leaves nothing.
    let names = || std::fs::read_dir(folder.path()).unwrap().count();
    let columns = TopicColumns { hall: &["v".to_owned()], force: &[], sensors: &[], state: &[] };
    let description = RecordingDescription::new("", 0.0);
    let other = folder.path().join("b.mcap");
    drop(RecordingMcap::create(&other, &description, columns).unwrap());
    assert_eq!(names(), 1);
    let mut file = RecordingMcap::create(&other, &description, columns).unwrap();
    file.board(0.0, &[1.0]).unwrap();
    file.flush().unwrap();
    assert_eq!(all(&other)[0].values("v").unwrap(), [1.0]);
}

/// With the reader of the crate, as other programs read.
#[test]
fn other_readers_find_every_message_by_the_index() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("a.mcap");
    cut_recording(&path);
    let bytes = std::fs::read(&path).unwrap();
    let rows = mcap::MessageStream::new(&bytes).unwrap().map(|message| message.unwrap());
    let rows: Vec<_> = rows.map(|message| (message.log_time, message.sequence)).collect();
    assert_eq!(rows.len(), 3500);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let counts = summary.stats.unwrap();
    assert_eq!(
        (counts.message_count, counts.chunk_count as usize),
        (3500, summary.chunk_indexes.len())
    );
    assert_eq!((counts.message_start_time, counts.message_end_time), (rows[0].0, rows[3499].0));
    assert_eq!((counts.channel_count, summary.channels.len(), summary.schemas.len()), (2, 2, 2));
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let mut found = Vec::new();
    for chunk in &summary.chunk_indexes {
        for (channel, entries) in summary.read_message_indexes(&bytes, chunk).unwrap() {
            assert_eq!(channel.topic, "/board");
            for entry in entries {
                let message = summary.seek_message(&bytes, chunk, &entry).unwrap();
                assert_eq!(entry.log_time, message.log_time);
                assert!(
                    (chunk.message_start_time..=chunk.message_end_time).contains(&entry.log_time)
                );
                found.push((message.log_time, message.sequence));
            }
        }
    }
    assert_eq!(found, rows);
}

#[test]
fn cut_recording_is_read_up_to_its_last_whole_chunk() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("a.mcap");
    let lengths = cut_recording(&path);
    let whole = std::fs::read(&path).unwrap();
    // Dropping the writer has completed the file.
    assert_eq!(&whole[whole.len() - MAGIC.len()..], MAGIC);
    let read = |length: usize| {
        std::fs::write(&path, &whole[..length]).unwrap();
        read_topics(&path, |_| true, Undecodable::Refuse)
    };
    for length in (0..whole.len()).step_by(97).chain([whole.len() - 1]) {
        // Rows of the chunks that were in the file when it had this length.
        let flushed = lengths.iter().rposition(|end| *end <= length as u64).unwrap_or(0);
        let flushed = lengths.iter().position(|end| *end == lengths[flushed]).unwrap_or(0);
        let rows = flushed.saturating_sub(1);
        let BagTopics { topics, notices } = match read(length) {
            Ok(read) => read,
            Err(error) => {
                assert!(rows == 0 && error.to_string().contains("mcap recover"), "{error}");
                continue;
            }
        };
        let values = topics[0].values("s0_x_lsb").unwrap();
        assert!(values.len() >= rows.max(1), "{length}: {} of {rows}", values.len());
        let last_s = 1e-3 * values[values.len() - 1];
        let [notice] = &notices[..] else { panic!("{length}: {notices:?}") };
        let expected = format!("its last whole chunk, {last_s:.3} s after its first message");
        assert!(notice.message.contains(&expected), "{notice}");
    }
    assert!(read(whole.len()).unwrap().notices.is_empty());
}

#[test]
fn files_that_cannot_be_read_are_refused_with_a_remedy() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("a.mcap");
    let message =
        |path: &Path| read_topics(path, |_| true, Undecodable::Refuse).unwrap_err().to_string();
    let data = magnetic_field(1, 2, [0.0; 3]);
    write(&path, &[(MAG, 1, data.clone())]);
    let whole = std::fs::read(&path).unwrap();
    // Without its first whole chunk, and with a record that is longer than the file.
    std::fs::write(&path, &whole[..100]).unwrap();
    assert!(message(&path).contains("mcap recover"), "{}", message(&path));
    let mut damaged = whole.clone();
    damaged[MAGIC.len() + 2] = 1;
    std::fs::write(&path, &damaged).unwrap();
    assert!(message(&path).contains("mcap recover"), "{}", message(&path));
    std::fs::write(&path, b"t,x\n1,2\n").unwrap();
    assert!(message(&path).contains("damaged"), "{}", message(&path));
    write(&path, &[(MAG, 1, data[..20].to_vec())]);
    assert!(
        message(&path).contains("/s0/mag: its messages cannot be decoded"),
        "{}",
        message(&path)
    );
    write(&path, &[(("/cam", "x", "ros1msg", "", "ros1"), 1, vec![0])]);
    assert!(message(&path).contains("\"ros1\""), "{}", message(&path));
    assert!(read_topics(&path, |_| true, Undecodable::Skip).unwrap().topics.is_empty());
    let text = folder.path().join("a.db3");
    std::fs::write(&text, "t,x\n1,2\n").unwrap();
    assert!(message(&text).contains("ros2 bag reindex"), "{}", message(&text));
    write(&path, &[(MAG, 1, data)]);
    let topics = all(&path);
    let join = |column: &str| {
        join_topics(&path, &topics, "/s0/mag.log_time", &[(column, None)], Join::EveryRow)
            .unwrap_err()
            .to_string()
    };
    assert!(join("/s0/mag.magnetic_field.xx").contains("did you mean /s0/mag.magnetic_field.x?"));
}

//! Bags to tables: MCAP files with message definitions and messages of ROS 2 and JSON, and MCAP files and databases with changes
//! where their structure is.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

use model_export::recordings::mcap::{Join, Undecodable, join_topics, read_topics};

use super::bag_files;
use super::bytes::{Bytes, change};

/// A definition with nested types, arrays, text and times.
const DEFINITION: &str = "std_msgs/Header header\nVector3[] points\nfloat64[3] v\nint8 a\nuint16[<=4] b\nstring[] names\nfloat32 c\n\
    ===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n\
    ===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n\
    ===\nMSG: lab_msgs/Vector3\nfloat64 x\nfloat64 y\n";

/// What was read.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    /// Files of which all messages were decoded.
    pub decoded: u32,
    /// Refused files.
    pub refused: u32,
    /// Columns that were joined.
    pub joined: u32,
    /// Numbers of messages.
    pub numbers: u32,
}

impl Tally {
    /// The counters with their names.
    pub fn counts(&self) -> super::counters::Counts<4> {
        [
            ("decoded", self.decoded),
            ("refused", self.refused),
            ("joined", self.joined),
            ("numbers", self.numbers),
        ]
    }
}

/// One MCAP file with changed records.
pub fn read_mcap(bytes: &[u8]) -> Tally {
    read_file("a.mcap", &bag_files::mcap_file(&mut Bytes::new(bytes)))
}

/// One database with changed pages.
pub fn read_database(bytes: &[u8]) -> Tally {
    read_file("a.db3", &bag_files::database_file(&mut Bytes::new(bytes)))
}

fn read_file(name: &str, content: &[u8]) -> Tally {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join(name);
    std::fs::write(&path, content).expect("the file");
    // As a proposal of a mapping reads it.
    let _ = read_topics(&path, |_| true, Undecodable::Skip);
    let tally = tables(&path);
    let files = std::fs::read_dir(folder.path()).expect("the folder").count();
    assert_eq!(files, 1, "files beside the bag");
    tally
}

/// One file with messages of a definition.
pub fn read(bytes: &[u8]) -> Tally {
    let mut bytes = Bytes::new(bytes);
    let kind = bytes.byte();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.mcap");
    write(&path, kind, &mut bytes);
    if kind & 0xC0 == 0 {
        let mut file = std::fs::read(&path).expect("the file");
        let at = usize::from(bytes.word()) % file.len();
        file[at] = bytes.byte();
        std::fs::write(&path, file).expect("the file");
    }
    tables(&path)
}

/// Tables of equal columns, or an error.
fn tables(path: &Path) -> Tally {
    let mut tally = Tally::default();
    let topics = match read_topics(path, |_| true, Undecodable::Refuse) {
        Ok(read) => read.topics,
        Err(error) => {
            assert!(!error.to_string().trim().is_empty());
            tally.refused = 1;
            return tally;
        }
    };
    tally.decoded = 1;
    let names: Vec<String> = topics
        .iter()
        .flat_map(|topic| {
            assert!(topic.columns.iter().all(|column| column.values.len() == topic.messages()));
            topic.columns.iter().map(|column| topic.column_name(&column.path))
        })
        .collect();
    tally.numbers = names.len() as u32;
    let columns: Vec<(&str, Option<f64>)> =
        names.iter().map(|name| (name.as_str(), None)).collect();
    for join in [Join::EveryRow, Join::Once] {
        let Some((clock, _)) = columns.first() else { break };
        let text = join_topics(path, &topics, clock, &columns, join).expect("its own columns").text;
        let rows = topics[0].messages();
        assert_eq!(text.split(|byte| *byte == b'\n').count(), rows + 2);
        tally.joined += columns.len() as u32;
    }
    tally
}

/// A file that is valid but for some definitions and messages.
fn write(path: &Path, kind: u8, bytes: &mut Bytes) {
    let file = File::create(path).expect("a temporary file");
    let mut writer = mcap::Writer::new(file).expect("a writer");
    let mut definition = DEFINITION.to_owned();
    if kind & 3 == 1 {
        for _ in 0..=bytes.byte() % 3 {
            change(&mut definition, bytes);
        }
    }
    let metadata = BTreeMap::new();
    let schema = writer.add_schema("lab_msgs/msg/Reading", "ros2msg", definition.as_bytes());
    let schema = schema.expect("a schema");
    let ros = writer.add_channel(schema, "/ros", "cdr", &metadata).expect("a channel");
    let json = writer.add_channel(0, "/json", "json", &metadata).expect("a channel");
    for _ in 0..=kind >> 2 & 7 {
        let is_json = bytes.byte() & 7 == 0;
        let header = mcap::records::MessageHeader {
            channel_id: if is_json { json } else { ros },
            sequence: 0,
            log_time: u64::from(bytes.word()),
            publish_time: 0,
        };
        let data = if is_json { object(bytes) } else { message(kind & 3 == 2, bytes) };
        writer.write_to_known_channel(&header, &data).expect("a message");
    }
    writer.finish().expect("the end of the file");
}

/// An object of JSON, changed in half of all cases.
fn object(bytes: &mut Bytes) -> Vec<u8> {
    let number = f64::from(bytes.word() as i16) / 64.0;
    let mut text =
        format!("{{\"a\": [{number}, 1e3], \"t\": {{\"sec\": 1, \"nsec\": 2}}, \"b\": null}}");
    if bytes.byte() & 1 == 0 {
        change(&mut text, bytes);
    }
    text.into_bytes()
}

/// A message in CDR: any bytes, or that of the unchanged definition.
fn message(is_any: bool, bytes: &mut Bytes) -> Vec<u8> {
    if is_any {
        let length = usize::from(bytes.byte());
        return bytes.some(length).to_vec();
    }
    let mut data = vec![0, 1, 0, 0];
    let align = |data: &mut Vec<u8>, to: usize| {
        while !(data.len() - 4).is_multiple_of(to) {
            data.push(0);
        }
    };
    // The time, and an empty name.
    data.extend(u32::from(bytes.word()).to_le_bytes());
    data.extend(u32::from(bytes.word()).to_le_bytes());
    data.extend(1_u32.to_le_bytes());
    data.push(0);
    align(&mut data, 4);
    let points = u32::from(bytes.byte() & 3);
    data.extend(points.to_le_bytes());
    align(&mut data, 8);
    for _ in 0..2 * points + 3 {
        data.extend(f64::from_le_bytes(bytes.array()).to_le_bytes());
    }
    data.push(bytes.byte());
    align(&mut data, 4);
    data.extend(1_u32.to_le_bytes());
    data.extend(bytes.word().to_le_bytes());
    align(&mut data, 4);
    data.extend(0_u32.to_le_bytes());
    data.extend(bytes.array::<4>());
    data
}

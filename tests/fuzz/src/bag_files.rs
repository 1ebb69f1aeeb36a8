//! Bags with changes where their structure is: lengths, records, chunks and definitions of MCAP; page headers, cells, overflow pages
//! and the schema of SQLite. Unchanged they are imported with [`MAPPING`].

use std::sync::OnceLock;

use mcap::MAGIC;
use mcap::records::op;

use super::bytes::{Bytes, change};

#[allow(dead_code)] // The fuzz targets read without one.
pub const MAPPING: &str = r#"description = "a bag"
[hall]
clock = { from = "/field.log_time", unit = "ns" }
columns = [
  { from = "/field.field.x", unit = "T", to = "s0_x_gauss" },
  { from = "/field.field.y", unit = "T", to = "s0_y_gauss" },
  { from = "/field.field.z", unit = "T", to = "s0_z_gauss" },
]
[force]
clock = { from = "/force.log_time", unit = "ns" }
columns = [{ from = "/force.fz", unit = "N", to = "f0_z_n" }]
"#;

const FIELD: (&str, &str) = (
    "lab_msgs/msg/Field",
    "std_msgs/Header header\nVector3 field\nfloat64[] rest\n\
     ===\nMSG: std_msgs/Header\nint32 sec\nuint32 nanosec\nstring frame_id\n\
     ===\nMSG: lab_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n",
);
const FORCE: (&str, &str) = ("lab_msgs/msg/Force", "float64 fx\nfloat64 fz\n");
/// Messages of the field, one in each millisecond; each tenth is one of the force, too.
const MESSAGES: u64 = 60;

/// Numbers at the ends of their ranges.
const EXTREMES: [u64; 16] = [
    0,
    1,
    2,
    8,
    0x7F,
    0x80,
    0xFF,
    0xFFFF,
    1 << 20,
    i32::MAX as u64,
    u32::MAX as u64,
    1 << 40,
    1 << 60,
    i64::MAX as u64,
    1 << 63,
    u64::MAX,
];
/// Lines that recurse, repeat, or state a length.
const LINES: [&str; 8] = [
    "Field again\n",
    "lab_msgs/Vector3[4294967295] many\n",
    "Empty[] empty\n===\nMSG: lab_msgs/Empty\n",
    "float64[18446744073709551615] many\n",
    "string text \"\n",
    "A a\n===\nMSG: lab_msgs/A\nB b\n===\nMSG: lab_msgs/B\nA a\n",
    "uint8 ONE=1\n",
    "===\n",
];

fn extreme(bytes: &mut Bytes) -> u64 {
    EXTREMES[usize::from(bytes.byte() % 16)]
}

/// An index below `length`, which is not zero.
fn index(bytes: &mut Bytes, length: usize) -> usize {
    usize::from(bytes.word()) % length
}

/// Topic, time and content of each message.
fn messages() -> Vec<(u16, u64, Vec<u8>)> {
    let message = |topic: u16, row: u64, values: [f64; 3]| {
        let mut data = vec![0, 1, 0, 0];
        let kept = if topic == 1 {
            // The time, an empty name and its padding.
            data.extend([1_u32, 500, 1, 0].map(u32::to_le_bytes).concat());
            3
        } else {
            2
        };
        values[..kept].iter().for_each(|value| data.extend(value.to_le_bytes()));
        if topic == 1 {
            data.extend([3, 0, 0, 0, 0, 0, 0, 0]);
            data.extend([0; 24]);
        }
        (topic, 1_764_000_000_000_000_000 + row * 1_000_000, data)
    };
    let of_row = |row: u64| {
        let value = (row % 7) as f64;
        let force = row.is_multiple_of(10).then(|| message(2, row, [value, 10.0 * value, 0.0]));
        std::iter::once(message(1, row, [1e-3 * value, 2e-3, -1e-3])).chain(force)
    };
    (0..MESSAGES).flat_map(of_row).collect()
}

/// A record, with another length than its own if it is stated.
#[derive(Clone)]
struct Part {
    kind: u8,
    stated: Option<u64>,
    content: Vec<u8>,
}

impl Part {
    fn new(kind: u8, content: impl IntoIterator<Item = Vec<u8>>) -> Self {
        Self { kind, stated: None, content: content.into_iter().flatten().collect() }
    }

    fn write(&self, file: &mut Vec<u8>) {
        file.push(self.kind);
        file.extend(self.stated.unwrap_or(self.content.len() as u64).to_le_bytes());
        file.extend(&self.content);
    }
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

/// Records before the end of the data.
fn parts() -> Vec<Part> {
    let mut parts = vec![Part::new(op::HEADER, [text("ros2"), text("")])];
    for (number, topic, (name, definition)) in [(1_u16, "/field", FIELD), (2, "/force", FORCE)] {
        let id = number.to_le_bytes().to_vec();
        let schema = [id.clone(), text(name), text("ros2msg"), text(definition)];
        parts.push(Part::new(op::SCHEMA, schema));
        let channel = [id.clone(), id, text(topic), text("cdr"), vec![0; 4]];
        parts.push(Part::new(op::CHANNEL, channel));
    }
    let attachment = [vec![0; 16], text("a"), text("text/plain"), vec![2, 0, 0, 0, 0, 0, 0, 0]];
    parts.push(Part::new(op::ATTACHMENT, attachment.into_iter().chain([vec![1; 6]])));
    parts.push(Part::new(op::METADATA, [text("name"), vec![0; 4]]));
    for (topic, time, data) in messages() {
        let times = [time.to_le_bytes(), time.to_le_bytes()].concat();
        let head = [topic.to_le_bytes().to_vec(), vec![0; 4], times];
        parts.push(Part::new(op::MESSAGE, head.into_iter().chain([data])));
    }
    parts
}

fn change_parts(parts: &mut Vec<Part>, bytes: &mut Bytes) {
    // The first ones are not like the others, and few.
    let among = if bytes.byte() & 1 == 0 { 7 } else { parts.len() };
    let at = index(bytes, among.min(parts.len()));
    let count = parts.len();
    let part = &mut parts[at];
    match bytes.byte() % 9 {
        0 => part.stated = Some(extreme(bytes)),
        1 | 2 if part.content.len() >= 8 => {
            let from = index(bytes, part.content.len() - 7);
            let width = [2, 4, 4, 8][usize::from(bytes.byte() & 3)];
            let value = extreme(bytes).to_le_bytes();
            part.content[from..from + width].copy_from_slice(&value[..width]);
        }
        3 if !part.content.is_empty() => {
            let length = index(bytes, part.content.len());
            part.content.truncate(length);
        }
        4 if count > 1 => drop(parts.remove(at)),
        5 => {
            let copy = part.clone();
            let to = index(bytes, count);
            parts.insert(to, copy);
        }
        6 => {
            let to = index(bytes, count);
            parts.swap(at, to);
        }
        7 | 8 => {
            let (name, definition) = if bytes.byte() & 1 == 0 { FIELD } else { FORCE };
            let mut definition = definition.to_owned();
            match bytes.byte() & 3 {
                0 => change(&mut definition, bytes),
                _ => {
                    let line = LINES[usize::from(bytes.byte() & 7)];
                    let starts: Vec<usize> =
                        definition.match_indices('\n').map(|it| it.0 + 1).collect();
                    definition.insert_str(starts[index(bytes, starts.len())], line);
                }
            }
            let id = if name == FIELD.0 { 1_u16 } else { 2 };
            let of_id = |part: &&mut Part| {
                part.kind == op::SCHEMA && part.content.starts_with(&id.to_le_bytes())
            };
            if let Some(part) = parts.iter_mut().find(of_id) {
                let schema =
                    [id.to_le_bytes().to_vec(), text(name), text("ros2msg"), text(&definition)];
                part.content = schema.concat();
            }
        }
        _ => {}
    }
}

/// An MCAP file with some changes.
pub fn mcap_file(bytes: &mut Bytes) -> Vec<u8> {
    let mut parts = parts();
    for _ in 0..bytes.byte() % 4 {
        change_parts(&mut parts, bytes);
    }
    let mut file = MAGIC.to_vec();
    let in_chunk = bytes.byte();
    let from = if in_chunk & 1 == 0 { parts.len() } else { index(bytes, parts.len()) };
    parts[..from].iter().for_each(|part| part.write(&mut file));
    if from < parts.len() {
        let mut records = Vec::new();
        parts[from..].iter().for_each(|part| part.write(&mut records));
        let (name, packed) = match in_chunk & 2 {
            0 => ("", records.clone()),
            _ => ("zstd", zstd::encode_all(records.as_slice(), 1).expect("compressed records")),
        };
        let mut lengths = [records.len() as u64, packed.len() as u64];
        if in_chunk & 0x30 == 0 {
            lengths[usize::from(in_chunk >> 7)] = extreme(bytes);
        }
        let [whole, compressed] = lengths.map(|length| length.to_le_bytes().to_vec());
        let head = [vec![0; 16], whole, vec![0; 4], text(name), compressed, packed];
        Part::new(op::CHUNK, head).write(&mut file);
    }
    Part::new(op::DATA_END, [vec![0; 4]]).write(&mut file);
    Part::new(op::FOOTER, [vec![0; 20]]).write(&mut file);
    file.extend(MAGIC);
    if bytes.byte() & 7 == 0 {
        let at = index(bytes, file.len());
        file[at] ^= bytes.byte();
    }
    file
}

const PAGE: usize = 512;

/// A database of the tables of ROS 2, in small pages.
fn database() -> &'static [u8] {
    static DATABASE: OnceLock<Vec<u8>> = OnceLock::new();
    DATABASE.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.db3");
        let database = rusqlite::Connection::open(&path).expect("a database");
        let tables = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
            CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
            CREATE INDEX timestamp_idx ON messages (timestamp ASC);
            CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT, encoded_message_definition TEXT);";
        database.execute_batch(&format!("PRAGMA page_size={PAGE}; BEGIN; {tables}")).expect("tables");
        let insert = |query: &str, values: &[&dyn rusqlite::ToSql]| {
            database.execute(query, values).expect("a row");
        };
        for (topic, (kind, definition)) in [("/field", FIELD), ("/force", FORCE)] {
            insert("INSERT INTO topics (name, type, serialization_format) VALUES (?1, ?2, 'cdr')", &[&topic, &kind]);
            let query = "INSERT INTO message_definitions (topic_type, encoding, encoded_message_definition) VALUES (?1, 'ros2msg', ?2)";
            insert(query, &[&kind, &definition]);
        }
        for (topic, time, data) in messages() {
            let query = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?1, ?2, ?3)";
            insert(query, &[&topic, &(time as i64), &data]);
        }
        // Longer than a page.
        insert("INSERT INTO messages (topic_id, timestamp, data) VALUES (9, 1, zeroblob(3000))", &[]);
        database.execute_batch("COMMIT").expect("a commit");
        drop(database);
        std::fs::read(path).expect("the database")
    })
}

/// A database with some changes.
pub fn database_file(bytes: &mut Bytes) -> Vec<u8> {
    let mut file = database().to_vec();
    let pages = file.len() / PAGE;
    for _ in 0..bytes.byte() % 4 {
        let page = index(bytes, pages);
        let from = page * PAGE;
        // The header of a page follows that of the file.
        let header = if page == 0 { 100 } else { 0 };
        let is_leaf = file[from + header] & 8 != 0;
        let cells = from + header + if is_leaf { 8 } else { 12 };
        let cell = cells + 2 * usize::from(bytes.byte() % 16);
        let content = from + usize::from(u16::from_be_bytes([file[cell], file[cell + 1]])) % PAGE;
        let place = match bytes.byte() % 8 {
            // Format versions, sizes and encodings of the file.
            0 => 16 + usize::from(bytes.byte() % 84),
            // Kind, free space, number of cells and last page.
            1 => from + header + usize::from(bytes.byte() % 12),
            2 => cell + usize::from(bytes.byte() & 1),
            // Length, number and kinds of the values of a cell.
            3 | 4 => content + usize::from(bytes.byte() % 12),
            // A pointer to the next overflow page, and the text of the schema.
            5 => from + usize::from(bytes.byte() & 3),
            _ => from + index(bytes, PAGE),
        };
        let value = match bytes.byte() & 3 {
            0 => extreme(bytes) as u8,
            1 => (index(bytes, pages) + 1) as u8,
            2 => bytes.byte(),
            _ => file[place % (pages * PAGE)] ^ (1 << (bytes.byte() & 7)),
        };
        if let Some(byte) = file.get_mut(place) {
            *byte = value;
        }
    }
    match bytes.byte() & 31 {
        2 => {
            let length = index(bytes, file.len());
            file.truncate(length);
        }
        1 => {
            let (page, other) = (index(bytes, pages) * PAGE, index(bytes, pages) * PAGE);
            file.copy_within(page..page + PAGE, other);
        }
        _ => {}
    }
    file
}

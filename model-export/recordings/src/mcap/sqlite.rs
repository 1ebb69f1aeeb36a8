//! Bags of ROS 2 in SQLite (`.db3`, the default until ROS 2 Humble), read as channels and messages of MCAP. Only tables are read, and
//! nothing that a file of others defines is run; the file is opened as one that does not change, so that nothing is written next to it.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::sync::Arc;

use mcap::{Channel, Message, Schema};
use rusqlite::limits::Limit;
use rusqlite::types::Type;
use rusqlite::{Connection, OpenFlags, OptionalExtension as _, params};

use crate::error::{DataError, ErrorKind, Location};
use crate::input;
use crate::mcap::limits::{Deadline, MAX_RECORD_BYTES, MAX_TOPICS, check_topics};

/// Messages that are read at a time, and the bytes of them from which on no more are: a bag may hold images, too.
const PAGE: i64 = 1000;
const PAGE_BYTES: usize = 16 << 20;

/// Message types that bags of ROS 2 Humble and before use without stating their definition. From the interface packages
/// `builtin_interfaces`, `std_msgs`, `geometry_msgs` and `sensor_msgs`.
const DEFINITIONS: [(&str, &str); 18] = [
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec"),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id"),
    ("std_msgs/Float32", "float32 data"),
    ("std_msgs/Float64", "float64 data"),
    ("std_msgs/MultiArrayDimension", "string label\nuint32 size\nuint32 stride"),
    ("std_msgs/MultiArrayLayout", "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset"),
    ("std_msgs/Float32MultiArray", "std_msgs/MultiArrayLayout layout\nfloat32[] data"),
    ("std_msgs/Float64MultiArray", "std_msgs/MultiArrayLayout layout\nfloat64[] data"),
    ("std_msgs/Int16MultiArray", "std_msgs/MultiArrayLayout layout\nint16[] data"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z"),
    ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"),
    ("geometry_msgs/Vector3Stamped", "std_msgs/Header header\ngeometry_msgs/Vector3 vector"),
    ("geometry_msgs/Wrench", "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque"),
    ("geometry_msgs/WrenchStamped", "std_msgs/Header header\ngeometry_msgs/Wrench wrench"),
    (
        "sensor_msgs/MagneticField",
        "std_msgs/Header header\ngeometry_msgs/Vector3 magnetic_field\nfloat64[9] magnetic_field_covariance",
    ),
    (
        "sensor_msgs/JointState",
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
    ),
    ("sensor_msgs/Temperature", "std_msgs/Header header\nfloat64 temperature\nfloat64 variance"),
    (
        "sensor_msgs/Imu",
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n\
         geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\
         geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance",
    ),
];

/// The definition of a known type with those of the types that it refers to.
fn known_definition(kind: &str) -> Option<String> {
    let of = |kind: &str| {
        let name = kind.replacen("/msg/", "/", 1);
        DEFINITIONS.iter().find(|(known, _)| **known == name)
    };
    let mut text = of(kind)?.1.to_owned();
    let mut found = vec![of(kind)?];
    let mut index = 0;
    while let Some((_, definition)) = found.get(index) {
        for field in definition.lines() {
            let Some(used) = field.split([' ', '[']).next().and_then(of) else { continue };
            if !found.contains(&used) {
                found.push(used);
                text += &format!("\n{}\nMSG: {}\n{}", "=".repeat(80), used.0, used.1);
            }
        }
        index += 1;
    }
    Some(text)
}

/// Instructions of SQLite between two looks at the time.
const STEPS: i32 = 10_000;
/// Minimum of SQLite's limit of a text or row in bytes, which a query also needs.
const MIN_LENGTH: u64 = 10_000;

/// Messages of a bag in the order in which they were recorded.
pub struct SqliteMessages<'a> {
    file: &'a Path,
    database: Connection,
    channels: HashMap<i64, Arc<Channel<'static>>>,
    page: std::vec::IntoIter<Message<'static>>,
    /// Of the last message that was read.
    last_id: Option<i64>,
    /// Bytes that messages may still have: all of them are in the file.
    left: u64,
    deadline: Deadline,
    is_ended: bool,
}

impl<'a> SqliteMessages<'a> {
    /// # Errors
    /// The file is not a bag, or was not completed by its recorder.
    pub fn open(file: &'a Path, deadline: Deadline) -> Result<Self, DataError> {
        let unreadable = |error| ErrorKind::Unreadable(error).at(Location::file(file));
        let left = input::open(file)?.metadata().map_err(unreadable)?.len();
        check_completed(file)?;
        let damaged = |error| damaged(file, &error, deadline);
        let database = connect(file, left, deadline).map_err(damaged)?;
        for table in ["topics", "messages", "message_definitions"] {
            check_table(&database, table).map_err(damaged)?.map_err(|found| {
                let advice = "a bag of ROS 2 has plain tables; record or convert it again with `ros2 bag convert`";
                ErrorKind::bad_value(format!("{table}, which is {found},"), advice)
                    .at(Location::file(file))
            })?;
        }
        let topics = topics(&database, left).map_err(damaged)?;
        check_topics(topics.len()).map_err(|kind| kind.at(Location::file(file)))?;
        let channels = channels(&database, topics, left).map_err(damaged)?;
        let page = Vec::new().into_iter();
        Ok(Self { file, database, channels, page, last_id: None, left, deadline, is_ended: false })
    }

    fn read_page(&mut self) -> Result<Vec<Message<'static>>, DataError> {
        let deadline = self.deadline;
        let failed = |error| damaged(self.file, &error, deadline);
        let invalid =
            |reason: &str| ErrorKind::DamagedBag(reason.to_owned()).at(Location::file(self.file));
        let mut query = self
            .database
            .prepare_cached(
                "SELECT rowid, topic_id, timestamp, data FROM messages WHERE rowid > ?1 OR ?1 IS NULL ORDER BY rowid LIMIT ?2",
            )
            .map_err(failed)?;
        let mut rows = query.query(params![self.last_id, PAGE]).map_err(failed)?;
        let (mut page, mut bytes) = (Vec::new(), 0);
        self.is_ended = true;
        while bytes < PAGE_BYTES
            && let Some(row) = rows.next().map_err(failed)?
        {
            let id: i64 = row.get(0).map_err(failed)?;
            if self.last_id.is_some_and(|last| id <= last) {
                return Err(invalid("its messages are not in order"));
            }
            self.last_id = Some(id);
            self.is_ended = false;
            let time = row.get::<_, i64>(2).map_err(failed)?;
            let data = row.get_ref(3).map_err(failed)?.as_blob();
            let data = data.map_err(|_| invalid("a message is no blob"))?;
            self.left = self
                .left
                .checked_sub(data.len() as u64)
                .ok_or_else(|| invalid("its messages are longer than the file"))?;
            bytes += data.len();
            if let Some(channel) = self.channels.get(&row.get(1).map_err(failed)?) {
                let time = u64::try_from(time).unwrap_or(0);
                page.push(Message {
                    channel: channel.clone(),
                    sequence: 0,
                    log_time: time,
                    publish_time: time,
                    data: Cow::Owned(data.to_vec()),
                });
            }
        }
        Ok(page)
    }
}

/// A recorder that was interrupted leaves messages next to the file; they are only read from there by writing.
fn check_completed(file: &Path) -> Result<(), DataError> {
    let name = file.file_name().unwrap_or_default();
    for end in ["-wal", "-journal"] {
        let mut other = name.to_owned();
        other.push(end);
        if file.with_file_name(&other).metadata().is_ok_and(|metadata| metadata.len() > 0) {
            let [bag, name] = [name, &other].map(|name| name.to_string_lossy().into_owned());
            return Err(ErrorKind::UnfinishedBag { bag, name }.at(Location::file(file)));
        }
    }
    Ok(())
}

/// Opens a file of `bytes` for reading within limits.
fn connect(file: &Path, bytes: u64, deadline: Deadline) -> rusqlite::Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
        | OpenFlags::SQLITE_OPEN_NO_MUTEX
        | OpenFlags::SQLITE_OPEN_URI;
    let mut database = Connection::open_with_flags(uri(file), flags)?;
    let length = bytes.clamp(MIN_LENGTH, MAX_RECORD_BYTES);
    database.set_limit(Limit::SQLITE_LIMIT_LENGTH, i32::try_from(length).unwrap_or(i32::MAX))?;
    database.progress_handler(STEPS, Some(move || deadline.is_over()))?;
    database.pragma_update(None, "trusted_schema", false)?;
    database.pragma_update(None, "cell_size_check", true)?;
    Ok(database)
}

/// Address of a file that does not change: no journal is looked for, and none is created.
fn uri(file: &Path) -> String {
    let mut uri = String::from(if file.is_absolute() { "file://" } else { "file:" });
    for byte in file.as_os_str().as_encoded_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'_' | b'-' => {
                uri.push(char::from(*byte));
            }
            other => uri += &format!("%{other:02X}"),
        }
    }
    uri + "?immutable=1"
}

/// What else than a table with plain columns has this name, as SQLite has understood it: what the file states may differ.
fn check_table(database: &Connection, name: &str) -> rusqlite::Result<Result<(), &'static str>> {
    let object =
        "SELECT type, wr FROM pragma_table_list WHERE schema = 'main' AND name = ?1 COLLATE NOCASE";
    let of = |row: &rusqlite::Row| Ok((row.get::<_, String>(0)?, row.get::<_, bool>(1)?));
    let found = database.query_row(object, [name], of).optional()?;
    match found.as_ref().map(|(kind, is_without_rowid)| (kind.as_str(), is_without_rowid)) {
        None => return Ok(Ok(())),
        Some(("view", _)) => return Ok(Err("a view")),
        Some(("table", false)) => {}
        Some(_) => return Ok(Err("no ordinary table")),
    }
    let hidden = "SELECT count(*) FROM pragma_table_xinfo(?1) WHERE hidden <> 0";
    let has_computed = database.query_row(hidden, [name], |row| row.get::<_, i64>(0))? > 0;
    Ok(if has_computed { Err("a table with computed columns") } else { Ok(()) })
}

/// A text of a row, of those for which so many bytes are `left`: all of them are in the file.
fn text(row: &rusqlite::Row, index: usize, left: &mut u64) -> rusqlite::Result<String> {
    let text = row.get_ref(index)?.as_str()?;
    let exceeds = || {
        let reason = "its texts are longer than the file".into();
        rusqlite::Error::FromSqlConversionFailure(index, Type::Text, reason)
    };
    *left = left.checked_sub(text.len() as u64).ok_or_else(exceeds)?;
    Ok(text.to_owned())
}

impl Iterator for SqliteMessages<'_> {
    type Item = Result<Message<'static>, DataError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(message) = self.page.next() {
                return Some(Ok(message));
            }
            if self.is_ended {
                return None;
            }
            match self.read_page() {
                Ok(page) => self.page = page.into_iter(),
                Err(error) => {
                    self.is_ended = true;
                    return Some(Err(error));
                }
            }
        }
    }
}

fn damaged(file: &Path, error: &rusqlite::Error, deadline: Deadline) -> DataError {
    let kind = deadline.check().err();
    kind.unwrap_or_else(|| ErrorKind::DamagedBag(error.to_string())).at(Location::file(file))
}

/// A topic as the bag states it.
struct StatedTopic {
    id: i64,
    name: String,
    kind: String,
    message_encoding: String,
}

/// Topics of a bag, one more than allowed at most.
fn topics(database: &Connection, mut left: u64) -> rusqlite::Result<Vec<StatedTopic>> {
    let mut query =
        database.prepare("SELECT id, name, type, serialization_format FROM topics LIMIT ?1")?;
    let topic = |row: &rusqlite::Row| {
        let mut text = |index| text(row, index, &mut left);
        let [name, kind, message_encoding] = [text(1)?, text(2)?, text(3)?];
        Ok(StatedTopic { id: row.get(0)?, name, kind, message_encoding })
    };
    query.query_map([MAX_TOPICS as i64 + 1], topic)?.collect()
}

/// Channels by the number of their topic in the bag.
fn channels(
    database: &Connection,
    topics: Vec<StatedTopic>,
    left: u64,
) -> rusqlite::Result<HashMap<i64, Arc<Channel<'static>>>> {
    let definitions = if database.table_exists(None, "message_definitions")? {
        definitions(database, left)?
    } else {
        HashMap::new()
    };
    let mut channels = HashMap::new();
    for (index, topic) in topics.into_iter().enumerate() {
        let StatedTopic { id, name, kind, message_encoding } = topic;
        let definition = definitions.get(&kind).cloned();
        let definition =
            definition.or_else(|| Some(("ros2msg".to_owned(), known_definition(&kind)?)));
        // Without one the decoder refuses the topic.
        let number = u16::try_from(index + 1).unwrap_or(u16::MAX);
        let schema = definition.map(|(encoding, text)| {
            let data = Cow::Owned(text.into_bytes());
            Arc::new(Schema { id: number, name: kind, encoding, data })
        });
        let metadata = BTreeMap::new();
        let channel = Channel { id: number, topic: name, schema, message_encoding, metadata };
        channels.insert(id, Arc::new(channel));
    }
    Ok(channels)
}

/// Encoding and text of the definition of each message type; one may be empty where the recorder did not find it.
fn definitions(
    database: &Connection,
    mut left: u64,
) -> rusqlite::Result<HashMap<String, (String, String)>> {
    let query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions \
                WHERE encoded_message_definition <> '' LIMIT ?1";
    let of = |row: &rusqlite::Row| {
        let mut text = |index| text(row, index, &mut left);
        Ok((text(0)?, (text(1)?, text(2)?)))
    };
    database.prepare(query)?.query_map([MAX_TOPICS as i64], of)?.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mcap::decode::Definition;

    #[test]
    fn definitions_of_known_types_are_complete() {
        for (kind, _) in DEFINITIONS {
            let kind = kind.replacen('/', "/msg/", 1);
            let definition = Definition::parse(&kind, &known_definition(&kind).unwrap()).unwrap();
            assert!(definition.types[definition.root].min_bytes >= 4, "{kind}");
        }
        let imu = known_definition("sensor_msgs/msg/Imu").unwrap();
        assert_eq!(imu.matches("MSG: ").count(), 4, "{imu}");
        assert_eq!(known_definition("lab_msgs/msg/Finger"), None);
    }
}

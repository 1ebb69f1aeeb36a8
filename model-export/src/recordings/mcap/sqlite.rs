//! Bags of ROS 2 in SQLite (`.db3`, the default until ROS 2 Humble), read as channels and messages of MCAP.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::sync::Arc;

use mcap::{Channel, Message, Schema};
use rusqlite::{Connection, OpenFlags, OptionalExtension as _, params};

use crate::recordings::error::{DataError, ErrorKind, Location};

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

/// Messages of a bag in the order in which they were recorded.
pub struct SqliteMessages<'a> {
    file: &'a Path,
    database: Connection,
    channels: HashMap<i64, Arc<Channel<'static>>>,
    page: std::vec::IntoIter<Message<'static>>,
    /// Of the last message that was read.
    last_id: i64,
    is_ended: bool,
}

impl<'a> SqliteMessages<'a> {
    /// # Errors
    /// The file is not a bag.
    pub fn open(file: &'a Path) -> Result<Self, DataError> {
        let opened = || {
            let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
            let database = Connection::open_with_flags(file, flags)?;
            // Nothing in a file of others is run.
            database.pragma_update(None, "trusted_schema", false)?;
            let channels = channels(&database)?;
            Ok((database, channels))
        };
        let (database, channels) = opened().map_err(|error| damaged(file, &error))?;
        let page = Vec::new().into_iter();
        Ok(Self { file, database, channels, page, last_id: i64::MIN, is_ended: false })
    }

    fn read_page(&mut self) -> rusqlite::Result<Vec<Message<'static>>> {
        let mut query = self.database.prepare_cached(
            "SELECT id, topic_id, timestamp, data FROM messages WHERE id > ?1 ORDER BY id LIMIT ?2",
        )?;
        let mut rows = query.query(params![self.last_id, PAGE])?;
        let (mut page, mut bytes) = (Vec::new(), 0);
        self.is_ended = true;
        while bytes < PAGE_BYTES
            && let Some(row) = rows.next()?
        {
            self.last_id = row.get(0)?;
            self.is_ended = false;
            let time = u64::try_from(row.get::<_, i64>(2)?).unwrap_or(0);
            let data: Vec<u8> = row.get(3)?;
            bytes += data.len();
            if let Some(channel) = self.channels.get(&row.get(1)?) {
                page.push(Message {
                    channel: channel.clone(),
                    sequence: 0,
                    log_time: time,
                    publish_time: time,
                    data: Cow::Owned(data),
                });
            }
        }
        Ok(page)
    }
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
                    return Some(Err(damaged(self.file, &error)));
                }
            }
        }
    }
}

fn damaged(file: &Path, error: &rusqlite::Error) -> DataError {
    ErrorKind::DamagedBag(error.to_string()).at(Location::file(file))
}

/// Topics by their number in the bag.
fn channels(database: &Connection) -> rusqlite::Result<HashMap<i64, Arc<Channel<'static>>>> {
    let has_definitions = database.table_exists(None, "message_definitions")?;
    let stated = |kind: &str| {
        if !has_definitions {
            return Ok(None);
        }
        let text = "SELECT encoding, encoded_message_definition FROM message_definitions WHERE topic_type = ?1";
        let of = |row: &rusqlite::Row| Ok((row.get(0)?, row.get(1)?));
        database.query_row(text, [kind], of).optional()
    };
    let mut query = database.prepare("SELECT id, name, type, serialization_format FROM topics")?;
    let topic = |row: &rusqlite::Row| Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?));
    let topics: rusqlite::Result<Vec<(i64, String, String, String)>> =
        query.query_map([], topic)?.collect();
    let mut channels = HashMap::new();
    for (index, (id, topic, kind, message_encoding)) in topics?.into_iter().enumerate() {
        // A definition may be empty where the recorder did not find it.
        let stated = stated(&kind)?.filter(|(_, text): &(String, String)| !text.is_empty());
        let definition = stated.or_else(|| Some(("ros2msg".to_owned(), known_definition(&kind)?)));
        // Without one the decoder refuses the topic.
        let number = u16::try_from(index + 1).unwrap_or(u16::MAX);
        let schema = definition.map(|(encoding, text)| {
            let data = Cow::Owned(text.into_bytes());
            Arc::new(Schema { id: number, name: kind, encoding, data })
        });
        let metadata = BTreeMap::new();
        let channel = Channel { id: number, topic, schema, message_encoding, metadata };
        channels.insert(id, Arc::new(channel));
    }
    Ok(channels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use re_ros_msg::MessageSchema;

    #[test]
    fn definitions_of_known_types_are_complete() {
        for (kind, _) in DEFINITIONS {
            let kind = kind.replacen('/', "/msg/", 1);
            let schema = MessageSchema::parse(&kind, &known_definition(&kind).unwrap()).unwrap();
            assert!(!schema.spec.fields.is_empty(), "{kind}");
        }
        let imu = known_definition("sensor_msgs/msg/Imu").unwrap();
        assert_eq!(imu.matches("MSG: ").count(), 4, "{imu}");
        assert_eq!(known_definition("lab_msgs/msg/Finger"), None);
    }
}

//! Messages of MCAP channels as numbers with paths, such as `magnetic_field.x`: JSON, Protobuf, and CDR of ROS 2.

mod cdr;
mod definition;

use mcap::Channel;
use prost_reflect::{
    DescriptorPool, DynamicMessage, MapKey, MessageDescriptor, ReflectMessage as _,
};

use crate::mcap::limits::MAX_MESSAGE_BYTES;
pub use definition::Definition;

/// Longer arrays (images, point clouds) are not measurements of this project and are left out.
const MAX_ITEMS: usize = 64;
/// Maximum number of fields of a Protobuf message with those of its inner messages, also where they are absent.
const MAX_VISITS: usize = 100_000;

/// Decoder of the messages of one channel.
pub enum Decoder {
    Json,
    Protobuf(MessageDescriptor),
    Cdr(Definition),
}

impl Decoder {
    /// # Errors
    /// The encoding is not supported, or the schema is missing or invalid.
    pub fn new(channel: &Channel<'_>) -> Result<Self, String> {
        let schema = channel.schema.as_deref();
        let schema_encoding = schema.map_or("", |schema| schema.encoding.as_str());
        match (channel.message_encoding.as_str(), schema_encoding, schema) {
            ("json", ..) => Ok(Self::Json),
            ("protobuf", "protobuf", Some(schema)) => {
                check_length(&schema.data)?;
                let pool =
                    DescriptorPool::decode(schema.data.as_ref()).map_err(|e| e.to_string())?;
                let message = pool.get_message_by_name(&schema.name);
                message
                    .map(Self::Protobuf)
                    .ok_or_else(|| format!("its schema does not define {}", schema.name))
            }
            ("cdr", "ros2msg", Some(schema)) => {
                let text = std::str::from_utf8(&schema.data).map_err(|e| e.to_string())?;
                Definition::parse(&schema.name, text).map(Self::Cdr)
            }
            ("cdr", _, None) => Err(
                "the definition of its message type is not in the file; where its package is installed, `ros2 bag convert` adds it"
                    .to_owned(),
            ),
            (encoding, schema, _) => Err(format!(
                "messages in {encoding:?} with a schema in {schema:?} are not supported; supported are json, protobuf, and cdr with ros2msg"
            )),
        }
    }

    /// Calls `add` with path and value of each number of a message; flags and text are none.
    ///
    /// # Errors
    /// The bytes are not a message of this type.
    pub fn numbers(&self, data: &[u8], add: &mut dyn FnMut(&str, f64)) -> Result<(), String> {
        let mut path = String::new();
        match self {
            Self::Json => {
                check_length(data)?;
                let value: serde_json::Value =
                    serde_json::from_slice(data).map_err(|e| e.to_string())?;
                json(&value, &mut path, add);
            }
            Self::Protobuf(descriptor) => {
                check_length(data)?;
                let message = DynamicMessage::decode(descriptor.clone(), data);
                let message = message.map_err(|e| e.to_string())?;
                let mut visits = MAX_VISITS;
                protobuf(&message, &mut path, add, &mut visits)?;
            }
            Self::Cdr(definition) => cdr::numbers(definition, data, add)?,
        }
        Ok(())
    }
}

/// Decoding takes many times the length of a message.
fn check_length(data: &[u8]) -> Result<(), String> {
    if data.len() > MAX_MESSAGE_BYTES {
        return Err(format!(
            "a message or its schema is longer than {} kB",
            MAX_MESSAGE_BYTES >> 10
        ));
    }
    Ok(())
}

/// Extends the path by a field for the duration of `visit`.
fn with_field<T>(path: &mut String, name: &str, visit: impl FnOnce(&mut String) -> T) -> T {
    let length = path.len();
    if !path.is_empty() {
        path.push('.');
    }
    path.push_str(name);
    let result = visit(path);
    path.truncate(length);
    result
}

/// Extends the path by the index of an item for the duration of `visit`.
fn with_index<T>(path: &mut String, index: usize, visit: impl FnOnce(&mut String) -> T) -> T {
    let length = path.len();
    path.push_str(&format!("[{index}]"));
    let result = visit(path);
    path.truncate(length);
    result
}

/// Nanoseconds of a time in seconds and nanoseconds.
fn nanoseconds(seconds: f64, nanoseconds: f64) -> f64 {
    seconds.mul_add(1e9, nanoseconds)
}

/// Names of the two parts of a time: ROS 2, ROS 1 and Foxglove's JSON, Protobuf.
const TIME_FIELDS: [[&str; 2]; 3] = [["sec", "nanosec"], ["sec", "nsec"], ["seconds", "nanos"]];

fn json(value: &serde_json::Value, path: &mut String, add: &mut dyn FnMut(&str, f64)) {
    use serde_json::Value;
    match value {
        Value::Null | Value::String(_) | Value::Bool(_) => {}
        Value::Number(number) => add(path, number.as_f64().unwrap_or(f64::NAN)),
        Value::Array(items) if items.len() <= MAX_ITEMS => {
            for (i, item) in items.iter().enumerate() {
                with_index(path, i, |path| json(item, path, add));
            }
        }
        Value::Array(_) => {}
        Value::Object(fields) => {
            let part = |name: &str| fields.get(name).and_then(Value::as_f64);
            let time = TIME_FIELDS.iter().find_map(|[s, ns]| Some((part(s)?, part(ns)?)));
            if let Some((seconds, nanos)) = time.filter(|_| fields.len() == 2) {
                add(path, nanoseconds(seconds, nanos));
                return;
            }
            for (name, field) in fields {
                with_field(path, name, |path| json(field, path, add));
            }
        }
    }
}

fn protobuf(
    message: &DynamicMessage,
    path: &mut String,
    add: &mut dyn FnMut(&str, f64),
    visits: &mut usize,
) -> Result<(), String> {
    let descriptor = message.descriptor();
    if descriptor.full_name() == "google.protobuf.Timestamp" {
        let part = |name: &str| {
            let value = message.get_field_by_name(name)?;
            protobuf_number(&value)
        };
        if let (Some(seconds), Some(nanos)) = (part("seconds"), part("nanos")) {
            add(path, nanoseconds(seconds, nanos));
        }
        return Ok(());
    }
    // Fields with their default value are absent from the message.
    for field in descriptor.fields() {
        *visits = visits
            .checked_sub(1)
            .ok_or_else(|| format!("a message has more than {MAX_VISITS} fields"))?;
        if field.supports_presence() && !message.has_field(&field) {
            continue;
        }
        let value = message.get_field(&field);
        with_field(path, field.name(), |path| protobuf_value(&value, path, add, visits))?;
    }
    Ok(())
}

fn protobuf_value(
    value: &prost_reflect::Value,
    path: &mut String,
    add: &mut dyn FnMut(&str, f64),
    visits: &mut usize,
) -> Result<(), String> {
    use prost_reflect::Value;
    if let Some(number) = protobuf_number(value) {
        add(path, number);
        return Ok(());
    }
    match value {
        Value::Message(inner) => protobuf(inner, path, add, visits)?,
        Value::List(items) if items.len() <= MAX_ITEMS => {
            for (i, item) in items.iter().enumerate() {
                with_index(path, i, |path| protobuf_value(item, path, add, visits))?;
            }
        }
        Value::Map(items) if items.len() <= MAX_ITEMS => {
            for (key, item) in items {
                if let MapKey::String(name) = key {
                    with_field(path, name, |path| protobuf_value(item, path, add, visits))?;
                }
            }
        }
        _ => {}
    }
    Ok(())
}

fn protobuf_number(value: &prost_reflect::Value) -> Option<f64> {
    use prost_reflect::Value;
    Some(match value {
        Value::I32(number) | Value::EnumNumber(number) => f64::from(*number),
        Value::I64(number) => *number as f64,
        Value::U32(number) => f64::from(*number),
        Value::U64(number) => *number as f64,
        Value::F32(number) => f64::from(*number),
        Value::F64(number) => *number,
        _ => return None,
    })
}

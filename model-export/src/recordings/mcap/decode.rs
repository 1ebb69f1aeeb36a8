//! Messages of MCAP channels as numbers with paths, such as `magnetic_field.x`: JSON, Protobuf, and CDR of ROS 2.

use mcap::Channel;
use prost_reflect::{
    DescriptorPool, DynamicMessage, MapKey, MessageDescriptor, ReflectMessage as _,
};
use re_cdr::{BigEndian, CdrReader, LittleEndian};
use re_ros_msg::MessageSchema;
use re_ros_msg::deserialize::primitive_array::PrimitiveArray;
use re_ros_msg::deserialize::{TypeResolver, Value, decode_message};
use re_ros_msg::message_spec::{ComplexType, MessageSpecification, message_package};

/// Longer arrays (images, point clouds) are not measurements of this project and are left out.
const MAX_ITEMS: usize = 64;

/// Bytes before the content of a CDR message: representation and options.
const CDR_HEADER: usize = 4;

/// Decoder of the messages of one channel.
pub enum Decoder {
    Json,
    Protobuf(MessageDescriptor),
    Cdr(Box<RosTypes>),
}

/// A ROS 2 message type with the types that it refers to.
pub struct RosTypes(MessageSchema);

impl TypeResolver for RosTypes {
    fn resolve(
        &self,
        scope: &MessageSpecification,
        kind: &ComplexType,
    ) -> Option<&MessageSpecification> {
        let name = match kind {
            ComplexType::Absolute { package, name } => format!("{package}/{name}"),
            ComplexType::Relative { name } => match message_package(&scope.name) {
                Some(package) => format!("{package}/{name}"),
                None => name.clone(),
            },
        };
        self.0.dependencies.iter().find(|spec| spec.name == name)
    }
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
                let pool =
                    DescriptorPool::decode(schema.data.as_ref()).map_err(|e| e.to_string())?;
                let message = pool.get_message_by_name(&schema.name);
                message
                    .map(Self::Protobuf)
                    .ok_or_else(|| format!("its schema does not define {}", schema.name))
            }
            ("cdr", "ros2msg", Some(schema)) => {
                let text = std::str::from_utf8(&schema.data).map_err(|e| e.to_string())?;
                let types =
                    MessageSchema::parse(&schema.name, text).map_err(|e| format!("{e:#}"))?;
                Ok(Self::Cdr(Box::new(RosTypes(types))))
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
                let value: serde_json::Value =
                    serde_json::from_slice(data).map_err(|e| e.to_string())?;
                json(&value, &mut path, add);
            }
            Self::Protobuf(descriptor) => {
                let message = DynamicMessage::decode(descriptor.clone(), data);
                protobuf(&message.map_err(|e| e.to_string())?, &mut path, add);
            }
            Self::Cdr(types) => {
                let value = types.decode(data)?;
                ros(&value, &mut path, add);
            }
        }
        Ok(())
    }
}

impl RosTypes {
    fn decode(&self, data: &[u8]) -> Result<Value, String> {
        let (Some(representation), Some(content)) = (data.get(1), data.get(CDR_HEADER..)) else {
            return Err("the message is shorter than its header".to_owned());
        };
        let spec = &self.0.spec;
        // Plain CDR of version 1, as all ROS 2 middlewares write it (OMG DDSI-RTPS, 10.5).
        let value = match representation {
            0 => decode_message(&mut CdrReader::<BigEndian>::new(content), spec, self),
            1 => decode_message(&mut CdrReader::<LittleEndian>::new(content), spec, self),
            other => return Err(format!("the CDR representation {other} is not supported")),
        };
        value.map_err(|error| error.to_string())
    }
}

/// Extends the path by a field for the duration of `visit`.
fn with_field(path: &mut String, name: &str, visit: impl FnOnce(&mut String)) {
    let length = path.len();
    if !path.is_empty() {
        path.push('.');
    }
    path.push_str(name);
    visit(path);
    path.truncate(length);
}

/// Extends the path by the index of an item for the duration of `visit`.
fn with_index(path: &mut String, index: usize, visit: impl FnOnce(&mut String)) {
    let length = path.len();
    path.push_str(&format!("[{index}]"));
    visit(path);
    path.truncate(length);
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

fn protobuf(message: &DynamicMessage, path: &mut String, add: &mut dyn FnMut(&str, f64)) {
    let descriptor = message.descriptor();
    if descriptor.full_name() == "google.protobuf.Timestamp" {
        let part = |name: &str| {
            let value = message.get_field_by_name(name)?;
            protobuf_number(&value)
        };
        if let (Some(seconds), Some(nanos)) = (part("seconds"), part("nanos")) {
            add(path, nanoseconds(seconds, nanos));
        }
        return;
    }
    // Fields with their default value are absent from the message.
    for field in descriptor.fields() {
        if field.supports_presence() && !message.has_field(&field) {
            continue;
        }
        let value = message.get_field(&field);
        with_field(path, field.name(), |path| protobuf_value(&value, path, add));
    }
}

fn protobuf_value(value: &prost_reflect::Value, path: &mut String, add: &mut dyn FnMut(&str, f64)) {
    use prost_reflect::Value;
    if let Some(number) = protobuf_number(value) {
        return add(path, number);
    }
    match value {
        Value::Message(inner) => protobuf(inner, path, add),
        Value::List(items) if items.len() <= MAX_ITEMS => {
            for (i, item) in items.iter().enumerate() {
                with_index(path, i, |path| protobuf_value(item, path, add));
            }
        }
        Value::Map(items) if items.len() <= MAX_ITEMS => {
            for (key, item) in items {
                if let MapKey::String(name) = key {
                    with_field(path, name, |path| protobuf_value(item, path, add));
                }
            }
        }
        _ => {}
    }
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

fn ros(value: &Value, path: &mut String, add: &mut dyn FnMut(&str, f64)) {
    if let Some(number) = ros_number(value) {
        return add(path, number);
    }
    match value {
        Value::Message(fields) => {
            let part = |name: &str| fields.get(name).and_then(ros_number);
            let time = TIME_FIELDS.iter().find_map(|[s, ns]| Some((part(s)?, part(ns)?)));
            if let Some((seconds, nanos)) = time.filter(|_| fields.len() == 2) {
                return add(path, nanoseconds(seconds, nanos));
            }
            for (name, field) in fields {
                with_field(path, name, |path| ros(field, path, add));
            }
        }
        Value::Array(items) | Value::Sequence(items) if items.len() <= MAX_ITEMS => {
            for (i, item) in items.iter().enumerate() {
                with_index(path, i, |path| ros(item, path, add));
            }
        }
        Value::PrimitiveArray(items) | Value::PrimitiveSeq(items) => {
            for (i, number) in ros_array(items).into_iter().enumerate() {
                with_index(path, i, |path| add(path, number));
            }
        }
        _ => {}
    }
}

fn ros_number(value: &Value) -> Option<f64> {
    Some(match value {
        Value::I8(number) => f64::from(*number),
        Value::U8(number) => f64::from(*number),
        Value::I16(number) => f64::from(*number),
        Value::U16(number) => f64::from(*number),
        Value::I32(number) => f64::from(*number),
        Value::U32(number) => f64::from(*number),
        Value::I64(number) => *number as f64,
        Value::U64(number) => *number as f64,
        Value::F32(number) => f64::from(*number),
        Value::F64(number) => *number,
        _ => return None,
    })
}

/// Numbers of a short array; empty for a long one and for text.
fn ros_array(array: &PrimitiveArray) -> Vec<f64> {
    fn all<T: Copy>(items: &[T], of: impl Fn(T) -> f64) -> Vec<f64> {
        if items.len() > MAX_ITEMS {
            Vec::new()
        } else {
            items.iter().map(|item| of(*item)).collect()
        }
    }
    match array {
        PrimitiveArray::I8(items) => all(items, f64::from),
        PrimitiveArray::U8(items) => all(items, f64::from),
        PrimitiveArray::I16(items) => all(items, f64::from),
        PrimitiveArray::U16(items) => all(items, f64::from),
        PrimitiveArray::I32(items) => all(items, f64::from),
        PrimitiveArray::U32(items) => all(items, f64::from),
        PrimitiveArray::I64(items) => all(items, |number| number as f64),
        PrimitiveArray::U64(items) => all(items, |number| number as f64),
        PrimitiveArray::F32(items) => all(items, f64::from),
        PrimitiveArray::F64(items) => all(items, |number| number),
        PrimitiveArray::Bool(_) | PrimitiveArray::String(_) => Vec::new(),
    }
}

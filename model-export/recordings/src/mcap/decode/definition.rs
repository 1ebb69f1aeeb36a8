//! Message definitions of ROS 2 (`.msg` with those of the types that it refers to,
//! <https://docs.ros.org/en/jazzy/Concepts/Basic/About-Interfaces.html>), resolved once for each topic: a type that contains itself, or
//! nests too deeply, is refused here and never met in a message.

use std::collections::HashMap;

use crate::mcap::limits::{MAX_MESSAGE_BYTES, MAX_PATH_BYTES};

/// Maximum nesting of message types. Those of ROS 2 reach 6.
pub const MAX_DEPTH: usize = 32;

/// Numbers of CDR.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Number {
    /// Bytes.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }
}

/// Type of a field, or of each item of an array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Number(Number),
    Flag,
    Text,
    /// A message type, by its index in [`Definition::types`].
    Message(usize),
}

/// Number of values of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    One,
    Fixed(usize),
    /// Stated in the message.
    Sequence,
}

/// A field of a message type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    pub name: String,
    pub kind: Kind,
    pub count: Count,
}

/// A message type whose fields are resolved.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MessageType {
    pub fields: Vec<Field>,
    /// Bytes of the shortest message, without padding; at least one.
    pub min_bytes: u64,
    /// Levels of message types, with this one.
    depth: usize,
}

/// A message type with all types that it refers to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Definition {
    pub types: Vec<MessageType>,
    /// Index of the type of the messages.
    pub root: usize,
}

impl Definition {
    /// Resolves the definition `text` of a type.
    ///
    /// # Errors
    /// A sentence: a line that is no field, a type that is unknown, contains itself or is nested too deeply.
    pub fn parse(name: &str, text: &str) -> Result<Self, String> {
        if text.len() > MAX_MESSAGE_BYTES {
            return Err(format!("its definition is longer than {} kB", MAX_MESSAGE_BYTES >> 10));
        }
        let mut resolver = Resolver {
            texts: HashMap::new(),
            resolved: HashMap::new(),
            enumerations: HashMap::new(),
            types: vec![],
        };
        let mut lines = text.lines();
        let mut section: Vec<&str> =
            lines.by_ref().take_while(|line| !is_separator(line)).collect();
        let root = key(name);
        resolver.texts.insert(root.clone(), section);
        loop {
            section = lines.by_ref().take_while(|line| !is_separator(line)).collect();
            let Some((first, body)) = section.split_first() else {
                // Two separators may follow each other.
                if lines.clone().next().is_none() { break } else { continue }
            };
            if let Some(name) = first.trim().strip_prefix("MSG: ") {
                resolver.texts.entry(key(name)).or_insert_with(|| body.to_vec());
            }
        }
        let root = resolver.resolve(&root, &mut Vec::new())?;
        Ok(Self { types: resolver.types, root })
    }
}

fn is_separator(line: &str) -> bool {
    let line = line.trim();
    line.len() >= 3 && line.bytes().all(|byte| byte == b'=')
}

/// Name of a type without the folder of its definition: `std_msgs/msg/Header` is `std_msgs/Header`.
fn key(name: &str) -> String {
    name.trim().replacen("/msg/", "/", 1)
}

struct Resolver<'a> {
    /// Lines of the types that are defined.
    texts: HashMap<String, Vec<&'a str>>,
    /// Types that are resolved, by name.
    resolved: HashMap<String, usize>,
    /// Types of enumerations that were looked up, by name.
    enumerations: HashMap<String, Option<Kind>>,
    types: Vec<MessageType>,
}

impl Resolver<'_> {
    /// Index of a type; `path` has the names of the types in which it is.
    fn resolve(&mut self, name: &str, path: &mut Vec<String>) -> Result<usize, String> {
        if path.iter().any(|outer| outer == name) {
            return Err(format!("its type {name} contains itself ({} > {name})", path.join(" > ")));
        }
        let too_deep = || format!("its types are nested more than {MAX_DEPTH} levels deep");
        if path.len() >= MAX_DEPTH {
            return Err(too_deep());
        }
        if let Some(index) = self.resolved.get(name) {
            let depth = self.types[*index].depth;
            return if path.len() + depth > MAX_DEPTH { Err(too_deep()) } else { Ok(*index) };
        }
        let lines = self.texts.get(name).cloned();
        let lines = lines.ok_or_else(|| format!("the definition of its type {name} is missing"))?;
        path.push(name.to_owned());
        let mut fields = Vec::new();
        let mut constants: Vec<Kind> = Vec::new();
        for line in lines {
            let Some(parsed) = parse_line(line).map_err(|reason| format!("{name}: {reason}"))?
            else {
                continue;
            };
            if parsed.is_constant {
                constants.extend(builtin(parsed.kind)?);
                continue;
            }
            let kind = match builtin(parsed.kind)? {
                Some(kind) => kind,
                None => self.kind_of_message(name, parsed.kind, path)?,
            };
            fields.push(Field { name: parsed.name.to_owned(), kind, count: parsed.count });
        }
        path.pop();
        if fields.is_empty() {
            // ROS gives a message without fields one of a byte.
            fields.push(Field {
                name: "structure_needs_at_least_one_member".to_owned(),
                kind: Kind::Number(Number::U8),
                count: Count::One,
            });
        }
        let min_bytes =
            fields.iter().map(|field| self.min_bytes(field)).fold(0, u64::saturating_add);
        let inner = fields.iter().filter_map(|field| match field.kind {
            Kind::Message(index) => Some(self.types[index].depth),
            _ => None,
        });
        let depth = 1 + inner.max().unwrap_or(0);
        self.types.push(MessageType { fields, min_bytes, depth });
        let index = self.types.len() - 1;
        self.resolved.insert(name.to_owned(), index);
        Ok(index)
    }

    /// Type of a field that is a message; a type of constants of one byte stands for that byte.
    fn kind_of_message(
        &mut self,
        scope: &str,
        name: &str,
        path: &mut Vec<String>,
    ) -> Result<Kind, String> {
        let name = match scope.split_once('/') {
            Some((package, _)) if !name.contains('/') => format!("{package}/{name}"),
            _ => key(name),
        };
        let known = self.enumerations.get(&name).copied();
        let enumeration = known.unwrap_or_else(|| self.enumeration(&name));
        self.enumerations.insert(name.clone(), enumeration);
        match enumeration {
            Some(kind) => Ok(kind),
            None => Ok(Kind::Message(self.resolve(&name, path)?)),
        }
    }

    /// Type of the constants of an enumeration: without fields, and all of the same one byte.
    fn enumeration(&self, name: &str) -> Option<Kind> {
        let mut kinds = Vec::new();
        for line in self.texts.get(name)? {
            if let Some(parsed) = parse_line(line).ok()? {
                kinds.push(parsed.is_constant.then_some(builtin(parsed.kind).ok()??)?);
            }
        }
        let first = *kinds.first()?;
        let is_byte = matches!(first, Kind::Flag | Kind::Number(Number::I8 | Number::U8));
        (is_byte && kinds.iter().all(|kind| *kind == first)).then_some(first)
    }

    fn min_bytes(&self, field: &Field) -> u64 {
        let of_one = self.kind_bytes(field.kind);
        match field.count {
            Count::One => of_one,
            Count::Fixed(count) => of_one.saturating_mul(count as u64),
            Count::Sequence => 4,
        }
    }

    fn kind_bytes(&self, kind: Kind) -> u64 {
        min_bytes(&self.types, kind)
    }
}

/// Bytes of the shortest value.
pub(crate) fn min_bytes(types: &[MessageType], kind: Kind) -> u64 {
    match kind {
        Kind::Number(number) => number.size() as u64,
        Kind::Flag => 1,
        Kind::Text => 4,
        Kind::Message(index) => types[index].min_bytes,
    }
}

struct Line<'a> {
    /// Type without its count.
    kind: &'a str,
    count: Count,
    name: &'a str,
    is_constant: bool,
}

fn parse_line(line: &str) -> Result<Option<Line<'_>>, String> {
    let line = line.split('#').next().unwrap_or_default().trim();
    if line.is_empty() {
        return Ok(None);
    }
    let invalid =
        || format!("the line {:?} is no field", line.chars().take(80).collect::<String>());
    let (kind, rest) = line.split_once(char::is_whitespace).ok_or_else(invalid)?;
    let rest = rest.trim_start();
    let end = rest.find(|c: char| c.is_whitespace() || c == '=').unwrap_or(rest.len());
    let (name, rest) = rest.split_at(end);
    let is_constant = rest.trim_start().starts_with('=');
    let (kind, count) = match kind.split_once('[') {
        None => (kind, Count::One),
        Some((kind, size)) => {
            let size = size.strip_suffix(']').ok_or_else(invalid)?;
            let number = |text: &str| text.parse().ok().filter(|count: &usize| *count > 0);
            let count = match size.strip_prefix("<=") {
                Some(bound) => number(bound).map(|_| Count::Sequence),
                None if size.is_empty() => Some(Count::Sequence),
                None => number(size).map(Count::Fixed),
            };
            (kind, count.ok_or_else(invalid)?)
        }
    };
    if name.is_empty() || kind.is_empty() || name.len() > MAX_PATH_BYTES {
        return Err(invalid());
    }
    Ok(Some(Line { kind, count, name, is_constant }))
}

/// A type that is no message.
fn builtin(name: &str) -> Result<Option<Kind>, String> {
    Ok(Some(match name.split_once("<=").map_or(name, |(name, _)| name) {
        "bool" => Kind::Flag,
        "byte" | "char" | "uint8" => Kind::Number(Number::U8),
        "int8" => Kind::Number(Number::I8),
        "int16" => Kind::Number(Number::I16),
        "uint16" => Kind::Number(Number::U16),
        "int32" => Kind::Number(Number::I32),
        "uint32" => Kind::Number(Number::U32),
        "int64" => Kind::Number(Number::I64),
        "uint64" => Kind::Number(Number::U64),
        "float32" => Kind::Number(Number::F32),
        "float64" => Kind::Number(Number::F64),
        "string" => Kind::Text,
        // Its layout differs between middlewares.
        "wstring" => return Err("wstring is not supported".to_owned()),
        _ => return Ok(None),
    }))
}

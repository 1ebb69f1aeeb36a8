//! Messages of ROS 2 in plain CDR (OMG DDSI-RTPS, 10.5; OMG CDR, 15.3), read in place: nothing is allocated for what a message states.

use super::MAX_ITEMS;
use super::definition::{Count, Definition, Kind, MessageType, Number, min_bytes};
use super::{TIME_FIELDS, nanoseconds, with_field, with_index};

/// Bytes before the content: representation and options.
const HEADER: usize = 4;

/// Calls `add` with path and value of each number of a message.
///
/// # Errors
/// The bytes are not a message of this definition.
pub fn numbers(
    definition: &Definition,
    data: &[u8],
    add: &mut dyn FnMut(&str, f64),
) -> Result<(), String> {
    let (Some(representation), Some(content)) = (data.get(1), data.get(HEADER..)) else {
        return Err("the message is shorter than its header".to_owned());
    };
    let is_big_endian = match representation {
        0 => true,
        1 => false,
        other => return Err(format!("the CDR representation {other} is not supported")),
    };
    let mut reader = Reader { types: &definition.types, content, at: 0, is_big_endian };
    reader.message(definition.root, &mut String::new(), &mut Some(add))
}

/// Receives the numbers; `None` in an array that is left out.
type Add<'a, 'b> = Option<&'a mut (dyn FnMut(&str, f64) + 'b)>;

struct Reader<'a> {
    types: &'a [MessageType],
    content: &'a [u8],
    at: usize,
    is_big_endian: bool,
}

impl<'a> Reader<'a> {
    /// Recurses at most to the depth of the definition.
    fn message(&mut self, index: usize, path: &mut String, add: &mut Add) -> Result<(), String> {
        let types = self.types;
        let fields = &types[index].fields;
        self.check(1, types[index].min_bytes)?;
        if let [seconds, nanos] = fields.as_slice()
            && TIME_FIELDS.contains(&[seconds.name.as_str(), nanos.name.as_str()])
            && let (Kind::Number(seconds_of), Kind::Number(nanos_of)) = (seconds.kind, nanos.kind)
            && (seconds.count, nanos.count) == (Count::One, Count::One)
        {
            let time = nanoseconds(self.number(seconds_of)?, self.number(nanos_of)?);
            if let Some(add) = add {
                add(path, time);
            }
            return Ok(());
        }
        for field in fields {
            // Nobody asks for the path of what is left out.
            let name = if add.is_some() { field.name.as_str() } else { "" };
            with_field(path, name, |path| match field.count {
                Count::One => self.value(field.kind, path, add),
                Count::Fixed(count) => self.array(field.kind, count, path, add),
                Count::Sequence => {
                    let count = self.length()?;
                    self.array(field.kind, count, path, add)
                }
            })?;
        }
        Ok(())
    }

    fn value(&mut self, kind: Kind, path: &mut String, add: &mut Add) -> Result<(), String> {
        match kind {
            Kind::Number(number) => {
                let value = self.number(number)?;
                if let Some(add) = add {
                    add(path, value);
                }
            }
            Kind::Flag => drop(self.take(1, 1)?),
            Kind::Text => {
                let length = self.length()?;
                self.take(length, 1)?;
            }
            Kind::Message(index) => self.message(index, path, add)?,
        }
        Ok(())
    }

    fn array(
        &mut self,
        kind: Kind,
        count: usize,
        path: &mut String,
        add: &mut Add,
    ) -> Result<(), String> {
        self.check(count as u64, min_bytes(self.types, kind))?;
        let is_left_out = count > MAX_ITEMS || add.is_none();
        match kind {
            Kind::Number(number) if is_left_out => {
                self.take(count.saturating_mul(number.size()), number.size()).map(drop)
            }
            Kind::Flag => self.take(count, 1).map(drop),
            _ if is_left_out => (0..count).try_for_each(|_| self.value(kind, path, &mut None)),
            _ => (0..count)
                .try_for_each(|index| with_index(path, index, |path| self.value(kind, path, add))),
        }
    }

    /// Checks that so many values of at least so many bytes can follow.
    fn check(&self, count: u64, bytes: u64) -> Result<(), String> {
        let left = self.content.len().saturating_sub(self.at) as u64;
        let needed = count.saturating_mul(bytes);
        if needed > left {
            return Err(format!(
                "it ends {} bytes too early, or a length in it is wrong",
                needed - left
            ));
        }
        Ok(())
    }

    /// So many bytes at a multiple of `alignment`; padding comes before values only.
    fn take(&mut self, count: usize, alignment: usize) -> Result<&'a [u8], String> {
        if count == 0 {
            return Ok(&[]);
        }
        let from = self.at.next_multiple_of(alignment);
        let to = from.saturating_add(count);
        let taken = self.content.get(from..to).ok_or("it ends too early")?;
        self.at = to;
        Ok(taken)
    }

    fn length(&mut self) -> Result<usize, String> {
        Ok(self.number(Number::U32)? as usize)
    }

    fn number(&mut self, number: Number) -> Result<f64, String> {
        let mut bytes = [0; 8];
        let taken = self.take(number.size(), number.size())?;
        // Little-endian, with zeros above.
        for (byte, own) in bytes.iter_mut().zip(taken) {
            *byte = *own;
        }
        if self.is_big_endian {
            bytes[..taken.len()].reverse();
        }
        let [b0, b1, b2, b3, ..] = bytes;
        Ok(match number {
            Number::I8 => f64::from(b0 as i8),
            Number::U8 => f64::from(b0),
            Number::I16 => f64::from(i16::from_le_bytes([b0, b1])),
            Number::U16 => f64::from(u16::from_le_bytes([b0, b1])),
            Number::I32 => f64::from(i32::from_le_bytes([b0, b1, b2, b3])),
            Number::U32 => f64::from(u32::from_le_bytes([b0, b1, b2, b3])),
            Number::I64 => i64::from_le_bytes(bytes) as f64,
            Number::U64 => u64::from_le_bytes(bytes) as f64,
            Number::F32 => f64::from(f32::from_le_bytes([b0, b1, b2, b3])),
            Number::F64 => f64::from_le_bytes(bytes),
        })
    }
}

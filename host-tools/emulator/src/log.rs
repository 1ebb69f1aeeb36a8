//! The image's log: frames of `defmt` in the ring buffer of the debugger's real-time transfer (RTT), decoded with the
//! strings in the ELF file.

use defmt_decoder::{DecodeError, Frame, StreamDecoder, Table};

use crate::image::Image;
use crate::soc::Soc;
use crate::time::Time;

/// Fields of the control block in bytes from its beginning: SEGGER's RTT, channel 0 upwards.
const BUFFER: u32 = 28;
const SIZE: u32 = 32;
const WRITE: u32 = 36;
const READ: u32 = 40;
const FLAGS: u32 = 44;
/// Flags of a debugger that wants every byte: a full buffer blocks the program.
const BLOCKING: u32 = 2;
const IDENTIFIER: &[u8] = b"SEGGER RTT";

/// A line of the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLine {
    /// When the emulator has read it.
    pub time: Time,
    /// The image's own time stamp, as it prints it.
    pub stamp: Option<String>,
    /// Level and text.
    pub text: String,
}

/// The debugger's end.
pub(crate) struct Log {
    /// Address of the control block; none where the image has no log.
    block: Option<u32>,
    /// Strings of the image. It lives as long as this program, because the decoder borrows it: images are few.
    table: Option<&'static Table>,
    decoder: Option<Box<dyn StreamDecoder + Send + Sync>>,
    pub(crate) lines: Vec<LogLine>,
    /// The debugger has stopped reading.
    is_stalled: bool,
}

impl Log {
    pub(crate) fn new(image: &Image) -> Self {
        let block = image.symbols_named("_SEGGER_RTT").next().map(|symbol| symbol.address);
        let table = Table::parse(&image.elf).ok().flatten();
        let table: Option<&'static Table> = table.map(|table| &*Box::leak(Box::new(table)));
        Self {
            block,
            table,
            decoder: table.map(Table::new_stream_decoder),
            lines: Vec::new(),
            is_stalled: false,
        }
    }

    /// A copy that begins with the next line.
    pub(crate) fn copy(&self) -> Self {
        let decoder = self.table.map(Table::new_stream_decoder);
        Self {
            block: self.block,
            table: self.table,
            decoder,
            lines: self.lines.clone(),
            is_stalled: self.is_stalled,
        }
    }

    /// Begins anew after a reset: what had not ended is lost.
    pub(crate) fn restart(&mut self) {
        self.decoder = self.table.map(Table::new_stream_decoder);
    }

    /// The debugger asks for every byte, as probe-rs does, and stops reading: its cable is pulled. The buffer is full.
    pub(crate) fn stall(&mut self, soc: &mut Soc) {
        self.read(soc);
        self.is_stalled = true;
        let Some(block) = self.block else { return };
        let word =
            |offset| Some(u32::from_le_bytes(soc.memory(block + offset, 4)?.try_into().ok()?));
        if let (Some(write), Some(size)) = (word(WRITE), word(SIZE)) {
            soc.write_memory(block + READ, &((write + 1) % size.max(1)).to_le_bytes());
            soc.write_memory(block + FLAGS, &BLOCKING.to_le_bytes());
        }
    }

    /// Reads what the program has written since.
    pub(crate) fn read(&mut self, soc: &mut Soc) {
        let Some(block) = self.block.filter(|_| !self.is_stalled) else { return };
        if soc.memory(block, IDENTIFIER.len()) != Some(IDENTIFIER) {
            return;
        }
        let word = |offset: u32| {
            let bytes = soc.memory(block + offset, 4)?;
            bytes.try_into().ok().map(u32::from_le_bytes)
        };
        let (Some(buffer), Some(size), Some(write), Some(mut read)) =
            (word(BUFFER), word(SIZE), word(WRITE), word(READ))
        else {
            return;
        };
        // The program may be about to initialise it: then the rest is what memory holds at power-on.
        if read >= size || write >= size {
            return;
        }
        let mut bytes = Vec::new();
        while read != write {
            bytes.extend_from_slice(soc.memory(buffer.wrapping_add(read), 1).unwrap_or_default());
            read = (read + 1) % size;
        }
        if bytes.is_empty() {
            return;
        }
        soc.write_memory(block + READ, &read.to_le_bytes());
        let Some(decoder) = &mut self.decoder else {
            return;
        };
        decoder.received(&bytes);
        loop {
            let (stamp, text) = match decoder.decode() {
                Ok(frame) => {
                    (frame.display_timestamp().map(|stamp| stamp.to_string()), text(&frame))
                }
                Err(DecodeError::UnexpectedEof) => break,
                Err(DecodeError::Malformed) => (None, "(not decodable)".to_owned()),
            };
            self.lines.push(LogLine { time: soc.now(), stamp, text });
        }
    }
}

fn text(frame: &Frame<'_>) -> String {
    let level = frame.level().map_or("", |level| level.as_str());
    format!("{level:<5} {}", frame.display_message())
}

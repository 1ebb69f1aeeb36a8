//! Correction of one table, row by row in constant memory: sorting, removal of duplicates, exchange and conversion of
//! columns.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::{Context, Result};
use csv::ByteRecord;
use flate2::Compression;
use flate2::write::GzEncoder;

use crate::data_quality::fix::description::{convert, negate};
use crate::data_quality::fix::repair::Change;
use crate::data_quality::scan::clock::SORT_WINDOW;
use crate::data_quality::scan::table::{is_packed, names, number, reader};

/// Copies `from` to `to` with these changes; returns descriptions with counts.
pub fn rewrite(from: &Path, to: &Path, changes: &[&Change]) -> Result<Vec<String>> {
    let out = BufWriter::new(File::create_new(to)?);
    if is_packed(from) {
        let mut packer = GzEncoder::new(out, Compression::default());
        let done = rewrite_into(from, &mut packer, changes)?;
        packer.finish()?.flush()?;
        Ok(done)
    } else {
        let mut out = out;
        let done = rewrite_into(from, &mut out, changes)?;
        out.flush()?;
        Ok(done)
    }
}

fn rewrite_into(from: &Path, out: &mut impl Write, changes: &[&Change]) -> Result<Vec<String>> {
    let mut reader = reader(from)?;
    let mut writer = csv::WriterBuilder::new().flexible(true).from_writer(out);
    let mut header = ByteRecord::new();
    reader.read_byte_record(&mut header)?;
    writer.write_byte_record(&header)?;
    let names = names(&header);
    let cells = Cells::plan(&names, changes)?;
    let time_column = names.iter().position(|name| name == "t_us");
    let sort = changes.contains(&&Change::SortRows);
    let drop = changes.contains(&&Change::DropCopies);
    let mut order = Order::new(time_column.context("there is no t_us")?, sort, drop);
    let mut record = ByteRecord::new();
    while reader.read_byte_record(&mut record)? {
        for ready in order.push(record.clone()) {
            writer.write_byte_record(&cells.apply(&ready))?;
        }
    }
    for ready in order.rest() {
        writer.write_byte_record(&cells.apply(&ready))?;
    }
    writer.flush()?;
    Ok(changes
        .iter()
        .map(|change| match change {
            Change::DropCopies => format!("{change} ({})", order.dropped),
            Change::SortRows => format!("{change} ({} moved)", order.moved),
            _ => change.to_string(),
        })
        .collect())
}

/// Source of each cell of a row.
struct Cells {
    sources: Vec<Source>,
}

/// Source column and conversion.
struct Source {
    column: usize,
    negate: bool,
    convert: Option<(f64, f64)>,
}

impl Cells {
    fn plan(names: &[String], changes: &[&Change]) -> Result<Self> {
        let find = |wanted: &str| {
            let place = names.iter().position(|name| name == wanted);
            place.with_context(|| format!("there is no column {wanted}"))
        };
        let mut sources: Vec<Source> = (0..names.len())
            .map(|column| Source { column, negate: false, convert: None })
            .collect();
        for change in changes {
            match change {
                Change::Take { to, from, negate } => {
                    let source = &mut sources[find(to)?];
                    (source.column, source.negate) = (find(from)?, *negate);
                }
                Change::Convert { column, factor, offset } => {
                    sources[find(column)?].convert = Some((*factor, *offset))
                }
                Change::DropCopies | Change::SortRows => {}
            }
        }
        Ok(Self { sources })
    }

    fn apply(&self, record: &ByteRecord) -> ByteRecord {
        // The strict reader reports rows that are too short or too long.
        if record.len() != self.sources.len() {
            return record.clone();
        }
        let cell = |source: &Source| {
            let bytes = record.get(source.column).unwrap_or_default();
            let Ok(text) = std::str::from_utf8(bytes) else {
                return bytes.to_vec();
            };
            let signed = if source.negate { negate(text) } else { text.to_owned() };
            let converted =
                source.convert.and_then(|(factor, offset)| convert(&signed, factor, offset));
            converted.unwrap_or(signed).into_bytes()
        };
        self.sources.iter().map(cell).collect()
    }
}

/// Buffer that sorts rows within a window.
struct Order {
    time_column: usize,
    sort: bool,
    drop: bool,
    /// Rows in order of time.
    held: VecDeque<(f64, ByteRecord)>,
    moved: u64,
    dropped: u64,
}

impl Order {
    fn new(time_column: usize, sort: bool, drop: bool) -> Self {
        Self { time_column, sort, drop, held: VecDeque::new(), moved: 0, dropped: 0 }
    }

    /// Adds a row; returns rows that no later row can precede. Without sorting a single row is buffered, to
    /// compare it with a duplicate.
    fn push(&mut self, record: ByteRecord) -> Vec<ByteRecord> {
        let time = record.get(self.time_column).map_or(f64::NAN, number);
        let after = self.held.iter().rev().take_while(|(t, _)| *t > time).count();
        let place = if self.sort { self.held.len() - after } else { self.held.len() };
        let mut same = self.held.iter().filter(|(t, _)| *t == time);
        if self.drop && same.any(|(_, other)| *other == record) {
            self.dropped += 1;
            return Vec::new();
        }
        self.moved += u64::from(place < self.held.len());
        self.held.insert(place, (time, record));
        let most = if self.sort { SORT_WINDOW } else { 1 };
        let ready = self.held.len().saturating_sub(most);
        self.held.drain(..ready).map(|(_, row)| row).collect()
    }

    /// Remaining buffered rows.
    fn rest(&mut self) -> Vec<ByteRecord> {
        self.held.drain(..).map(|(_, row)| row).collect()
    }
}

//! A corrected copy of a campaign.

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use csv::ByteRecord;
use flate2::Compression;
use flate2::write::GzEncoder;
use model_export::input;
use model_export::output::{StagingDir, check_vacant};
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::csv_table::{CsvReader, column_names, is_compressed};
use model_export::recordings::description::RECORDING_FILE;
use toml_edit::{DocumentMut, value};

use crate::data_quality::finding::Finding;
use crate::data_quality::fix::{Change, Repair};
use crate::data_quality::scan::clock::SORT_WINDOW;
use crate::data_quality::scan::finite;

/// Writes the campaign to the new folder `to` with the corrections of all
/// findings; everything else is copied byte for byte. `check` returns the findings of a campaign. Returns one sentence for each
/// correction.
///
/// # Errors
/// The folder exists or cannot be written, no finding has a correction, or the corrected copy still has an error of a corrected
/// kind; no folder is left behind.
pub fn write(
    campaign: &Path,
    findings: &[Finding],
    to: &Path,
    check: impl Fn(&Path) -> Result<Vec<Finding>>,
) -> Result<Vec<String>> {
    check_vacant(to)?;
    let repairs: Vec<&Repair> = findings
        .iter()
        .filter_map(|finding| finding.fix.as_ref())
        .flat_map(|fix| &fix.repairs)
        .collect();
    if repairs.is_empty() {
        bail!("no finding has an unambiguous correction, so nothing is written");
    }
    let folders = recording_folders(campaign)?;
    let unwritable = || format!("{}: cannot be written", to.display());
    let draft = StagingDir::new(to, "fix")?;
    let mut corrections = Vec::new();
    for folder in &folders {
        let inside = folder.strip_prefix(campaign).unwrap_or(Path::new(""));
        let target = draft.path().join(inside);
        fs::create_dir_all(&target).with_context(unwritable)?;
        corrections.extend(recording(folder, &target, &repairs)?);
    }
    if folders.iter().all(|folder| folder != campaign) {
        copy_files(campaign, draft.path())?;
    }
    let is_corrected =
        |id| findings.iter().any(|finding| finding.id == id && finding.fix.is_some());
    let left = check(draft.path())?.into_iter().filter(|finding| is_corrected(finding.id));
    let left: Vec<String> = left.map(|finding| describe(&finding, draft.path())).collect();
    if !left.is_empty() {
        bail!(
            "the corrected copy would still have {}: correct all columns of this kind yourself; nothing is written",
            left.join(" and ")
        );
    }
    draft.commit(to)?;
    Ok(corrections)
}

/// Identifier and place of a finding, relative to `folder`.
fn describe(finding: &Finding, folder: &Path) -> String {
    let mut place = finding.place.clone();
    place.file = place.file.strip_prefix(folder).map(Path::to_path_buf).unwrap_or(place.file);
    format!("{} ({place})", finding.id)
}

/// Writes one recording; returns its corrections.
fn recording(folder: &Path, target: &Path, repairs: &[&Repair]) -> Result<Vec<String>> {
    let mut corrections = Vec::new();
    for path in files_of(folder)? {
        let name = path.file_name().unwrap_or_default();
        let changes: Vec<&Change> = repairs
            .iter()
            .filter(|repair| repair.file == path)
            .map(|repair| &repair.change)
            .collect();
        if changes.is_empty() {
            fs::copy(&path, target.join(name)).with_context(|| format!("{}", path.display()))?;
            continue;
        }
        let done = rewrite(&path, &target.join(name), &changes)
            .with_context(|| format!("{}", path.display()))?;
        let name = name.to_string_lossy();
        corrections.extend(done.into_iter().map(|done| format!("{name}: {done}")));
    }
    if !corrections.is_empty() && folder.join(RECORDING_FILE).is_file() {
        extend_description(&target.join(RECORDING_FILE), &corrections)?;
    }
    let recording =
        folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    Ok(corrections.into_iter().map(|done| format!("recording {recording}, {done}")).collect())
}

fn copy_files(from: &Path, to: &Path) -> Result<()> {
    for path in files_of(from)? {
        let name = path.file_name().unwrap_or_default();
        fs::copy(&path, to.join(name)).with_context(|| format!("{}", path.display()))?;
    }
    Ok(())
}

/// Regular files of a folder, sorted by name.
fn files_of(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).with_context(|| format!("{}", folder.display()))?;
    let mut files: Vec<PathBuf> = entries
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| path.is_file())
        .collect();
    files.sort();
    Ok(files)
}

/// Copies `from` to `to` with these changes; returns descriptions with counts.
fn rewrite(from: &Path, to: &Path, changes: &[&Change]) -> Result<Vec<String>> {
    let out = BufWriter::new(File::create_new(to)?);
    if is_compressed(from) {
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
    let mut reader = CsvReader::open(from)?;
    let mut writer = csv::WriterBuilder::new().flexible(true).from_writer(out);
    let mut header = ByteRecord::new();
    reader.read(&mut header)?;
    writer.write_byte_record(&header)?;
    let names = column_names(&header);
    let cells = Cells::plan(&names, changes)?;
    let time_column = names.iter().position(|name| name == "t_us");
    let sort = changes.contains(&&Change::SortRows);
    let drop = changes.contains(&&Change::DropCopies);
    let mut order = Order::new(time_column.context("there is no t_us")?, sort, drop);
    let mut record = ByteRecord::new();
    while reader.read(&mut record)? {
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
    /// Threshold and offset.
    unwrap: Option<(f64, f64)>,
}

impl Cells {
    fn plan(names: &[String], changes: &[&Change]) -> Result<Self> {
        let find = |wanted: &str| {
            let place = names.iter().position(|name| name == wanted);
            place.with_context(|| format!("there is no column {wanted}"))
        };
        let mut sources: Vec<Source> = (0..names.len())
            .map(|column| Source { column, negate: false, convert: None, unwrap: None })
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
                Change::Unwrap { column, threshold, offset } => {
                    sources[find(column)?].unwrap = Some((*threshold, *offset));
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
            let signed = match source.unwrap.and_then(|unwrap| unwrapped(&signed, unwrap)) {
                Some(unwrapped) => unwrapped,
                None => signed,
            };
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
        let time = record.get(self.time_column).map_or(f64::NAN, finite);
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

/// Appends the corrections to the key `description`; the rest of the file is unchanged.
fn extend_description(path: &Path, done: &[String]) -> Result<()> {
    let named = || format!("{}", path.display());
    let text = input::read_text(path)?;
    let extended = with_words(&text, &done.join("; ")).with_context(named)?;
    fs::write(path, extended).with_context(named)
}

fn with_words(text: &str, done: &str) -> Result<String> {
    let mut document: DocumentMut = text.parse()?;
    let before = document.get("description").and_then(|item| item.as_str()).unwrap_or_default();
    let after = if before.is_empty() {
        format!("corrected: {done}")
    } else {
        format!("{before} (corrected: {done})")
    };
    document["description"] = value(after);
    Ok(document.to_string())
}

/// `text` times `factor` plus `offset`, with a resolution of a tenth of the step of `text` (its own step where
/// the factor is 1 or a power of ten). `None` where the text is not a number.
fn convert(text: &str, factor: f64, offset: f64) -> Option<String> {
    let trimmed = text.trim();
    let value: f64 = trimmed.parse().ok().filter(|value: &f64| value.is_finite())?;
    let shift = factor.abs().log10();
    let power_of_ten = (shift - shift.round()).abs() < 1e-9;
    let finer = if power_of_ten { -shift.round() as i32 } else { 1 - shift.floor() as i32 };
    let of_offset = decimals(&offset.to_string());
    let decimals = (decimals(trimmed) + finer).max(0);
    let decimals = if offset == 0.0 { decimals } else { decimals.max(of_offset) };
    let written = format!("{:.*}", decimals as usize, value * factor + offset);
    Some(written)
}

/// The number plus the offset, if it is on the wrong side of the threshold.
fn unwrapped(text: &str, (threshold, offset): (f64, f64)) -> Option<String> {
    let value: f64 = text.trim().parse().ok()?;
    let is_wrong = if offset > 0.0 { value < threshold } else { value > threshold };
    is_wrong.then(|| convert(text, 1.0, offset)).flatten()
}

/// The number with the opposite sign, as text.
fn negate(text: &str) -> String {
    let trimmed = text.trim();
    match (trimmed.strip_prefix('-'), trimmed.strip_prefix('+')) {
        (Some(rest), _) => rest.to_owned(),
        (None, Some(rest)) => format!("-{rest}"),
        // An empty cell and zero have no sign.
        _ if trimmed.parse::<f64>().is_ok_and(|value| value != 0.0) => format!("-{trimmed}"),
        _ => trimmed.to_owned(),
    }
}

/// Decimal places minus the exponent.
fn decimals(text: &str) -> i32 {
    let (mantissa, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let digits = mantissa.split_once('.').map_or(0, |(_, digits)| digits.len());
    digits as i32 - exponent.parse::<i32>().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_description_changes() {
        let text = "format = 1\ndescription = \"bench\"\nstart_s  =  0.0 # first\n[design]\ngap_mm = 1.50\n";
        let expected = text.replace("\"bench\"", "\"bench (corrected: rows sorted)\"");
        assert_eq!(with_words(text, "rows sorted").unwrap(), expected);
    }

    #[test]
    fn conversion_keeps_the_resolution() {
        let degree = std::f64::consts::PI / 180.0;
        for (text, factor, offset, converted) in [
            // A power of ten moves the decimal point.
            ("1234.5", 1e-3, 0.0, Some("1.2345")),
            ("0.0400", 1e3, 0.0, Some("40.0")),
            ("-0.021", 1e3, 0.0, Some("-21")),
            ("297.40", 1.0, -273.15, Some("24.25")),
            ("300", 1.0, -273.15, Some("26.85")),
            ("57.296", degree, 0.0, Some("1.000004")),
            ("1e2", degree, 0.0, Some("1.7")),
            ("none", degree, 0.0, None),
        ] {
            assert_eq!(convert(text, factor, offset).as_deref(), converted, "{text}");
        }
    }

    #[test]
    fn negation_changes_the_text_only() {
        for (text, negated) in [("-98", "98"), ("0.10", "-0.10"), ("0", "0"), ("", "")] {
            assert_eq!(negate(text), negated);
        }
    }
}

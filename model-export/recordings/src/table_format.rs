//! How a foreign table writes its values, taken from its first rows: separator, decimal mark, mark between thousands, dates,
//! lines before the header, and a row of units below it.
//!
//! What the first rows leave open is not assumed: such a cell stays text, and its reader refuses it with its line and column.

use std::borrow::Cow;
use std::cmp::Ordering;
use std::fmt::Write as _;

use jiff::Timestamp;
use jiff::civil::{Date, DateTime, Time};

use crate::units::unit_of_text;

/// Bytes at the start of a table that are examined.
pub const EXAMINED_BYTES: u64 = 1 << 16;
/// Records of these at most.
const EXAMINED_RECORDS: usize = 1000;
/// Separators of cells; among equally regular ones the first, which is that of this project.
pub const SEPARATORS: [u8; 3] = *b",;\t";
/// Consecutive rows of numbers below a header: a line about the logger has a number too.
const DATA_ROWS: usize = 3;
/// Forms of a date with a time of day besides ISO 8601. Where day and month cannot be distinguished, the cell stays text.
const DATE_FORMS: [&str; 2] = ["%d.%m.%Y %H:%M:%S%.f", "%Y/%m/%d %H:%M:%S%.f"];

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TableFormat {
    /// Between cells.
    pub separator: u8,
    /// Records before the header.
    pub preamble: usize,
    /// Whether the record below the header has the units of the columns.
    pub has_units: bool,
    numbers: NumberFormat,
    has_dates: bool,
}

/// Marks in a number besides the decimal point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct NumberFormat {
    has_decimal_comma: bool,
    thousands: Option<char>,
}

impl NumberFormat {
    const PLAIN: Self = Self { has_decimal_comma: false, thousands: None };

    fn is_plain(self) -> bool {
        self == Self::PLAIN
    }
}

impl Default for TableFormat {
    fn default() -> Self {
        let numbers = NumberFormat::PLAIN;
        Self { separator: b',', preamble: 0, has_units: false, numbers, has_dates: false }
    }
}

/// Text of a cell: UTF-8, else Latin-1, as which older programs save their degrees and micro signs.
pub fn text_of(cell: &[u8]) -> String {
    match std::str::from_utf8(cell) {
        Ok(text) => text.to_owned(),
        Err(_) => cell.iter().map(|byte| char::from(*byte)).collect(),
    }
}

impl TableFormat {
    /// The format of a table that begins with `start`; `is_whole` if nothing follows.
    pub fn of(start: &[u8], is_whole: bool) -> Self {
        let by_separator = SEPARATORS.map(|separator| Layout::of(start, is_whole, separator));
        // The first of equally long ones: `max_by_key` returns the last.
        let Some(layout) = by_separator.into_iter().flatten().rev().max_by_key(Layout::rank) else {
            return Self::default();
        };
        let cells = layout.rows.iter().flat_map(|row| row.iter().map(text_of));
        let cells: Vec<String> = cells.map(|cell| cell.trim().to_owned()).collect();
        Self {
            separator: layout.separator,
            preamble: layout.header,
            has_units: layout.has_units,
            numbers: number_format(&cells, layout.separator),
            has_dates: cells.iter().any(|cell| seconds(cell).is_some()),
        }
    }

    /// Names of the columns from the header and the row of units, where the table has one: `Fz [N]`.
    pub fn with_units(header: &csv::ByteRecord, units: &csv::ByteRecord) -> csv::ByteRecord {
        let named = |(name, unit): (&[u8], &[u8])| match unit_in(unit) {
            Some(unit) => format!("{} [{unit}]", text_of(name).trim()),
            None => text_of(name),
        };
        header.iter().zip(units).map(named).collect()
    }

    /// Whether cells may have to be rewritten.
    pub fn is_plain(&self) -> bool {
        self.numbers.is_plain() && !self.has_dates
    }

    /// The cell as the number that it is: with a decimal point, without marks between thousands, a time in seconds; all else
    /// unchanged.
    pub fn plain<'a>(&self, cell: &'a [u8]) -> Cow<'a, [u8]> {
        if self.is_plain() || cell.iter().all(u8::is_ascii_digit) {
            return Cow::Borrowed(cell);
        }
        let text = text_of(cell);
        let text = text.trim();
        if self.has_dates
            && let Some(seconds) = seconds(text)
        {
            return Cow::Owned(seconds.into_bytes());
        }
        if self.numbers.is_plain() || !is_number_like(text) {
            return Cow::Borrowed(cell);
        }
        match without_marks(text, self.numbers) {
            Some(number) => Cow::Owned(number.into_bytes()),
            // Not to be read as a number with a decimal point.
            None => Cow::Owned(format!("\u{201c}{text}\u{201d}").into_bytes()),
        }
    }

    /// What is read otherwise than in a table of this project, one sentence each.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.preamble > 0 {
            let lines = if self.preamble == 1 { "line" } else { "lines" };
            notes.push(format!("{} {lines} before the header are left out", self.preamble));
        }
        if self.has_units {
            notes.push("units are taken from the row below the header".to_owned());
        }
        let mut numbers = String::new();
        if self.numbers.has_decimal_comma {
            numbers.push_str("decimals follow a comma");
        }
        if let Some(mark) = self.numbers.thousands {
            let and = if numbers.is_empty() { "" } else { " and " };
            let _ = write!(numbers, "{and}thousands are separated by {mark:?}");
        }
        if !numbers.is_empty() {
            notes.push(numbers);
        }
        if self.has_dates {
            notes.push(
                "times of day and dates are read as seconds, without a time zone as UTC".to_owned(),
            );
        }
        notes
    }
}

/// Where header and rows are if a separator is the right one.
struct Layout {
    separator: u8,
    certainty: Certainty,
    width: usize,
    header: usize,
    has_units: bool,
    rows: Vec<csv::ByteRecord>,
}

impl Layout {
    /// `None` if the separator yields one column.
    fn of(start: &[u8], is_whole: bool, separator: u8) -> Option<Self> {
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .comment(Some(b'#'))
            .delimiter(separator)
            .from_reader(start);
        let records: Result<Vec<_>, _> = reader.byte_records().take(EXAMINED_RECORDS + 1).collect();
        let mut records = records.ok()?;
        // The last one may be cut.
        if !is_whole || records.len() > EXAMINED_RECORDS {
            records.pop();
        }
        let is_row = |record: &csv::ByteRecord, width: usize| {
            record.len() == width && record.iter().any(is_value)
        };
        let first_row = (1..records.len()).find(|&first| {
            let width = records[first].len();
            let end = records.len().min(first + DATA_ROWS);
            width > 1
                && records[first - 1].len() == width
                && !records[first - 1].iter().any(is_value)
                && records[first..end].iter().all(|record| is_row(record, width))
        });
        let width = records.get(first_row.unwrap_or(0))?.len();
        if width < 2 {
            return None;
        }
        let certainty = match first_row {
            Some(_) => Certainty::TextAboveNumbers,
            None if records.iter().all(|record| record.len() == width) => Certainty::OneWidth,
            None => Certainty::FirstRecord,
        };
        let rows = records.split_off(first_row.unwrap_or(1).min(records.len()));
        let has_units = match &records[..] {
            [.., names, units] => names.len() == width && is_row_of_units(units),
            _ => false,
        };
        let header = records.len() - 1 - usize::from(has_units);
        let rows = rows.into_iter().filter(|record| record.len() == width).collect();
        Some(Self { separator, certainty, width, header, has_units, rows })
    }

    fn rank(&self) -> (Certainty, usize, usize) {
        (self.certainty, self.rows.len(), self.width)
    }
}

/// What a layout is taken from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Certainty {
    /// The first record is the header: what does not fit it is named by the reader.
    FirstRecord,
    /// All records have as many cells, and the header is not text alone.
    OneWidth,
    TextAboveNumbers,
}

/// Whether a cell is a number in any format, or a time.
fn is_value(cell: &[u8]) -> bool {
    let text = text_of(cell);
    let text = text.trim();
    is_number_like(text) || seconds(text).is_some()
}

/// Unit in a cell, without brackets; a dash or an empty cell is none.
fn unit_in(cell: &[u8]) -> Option<String> {
    let text = text_of(cell);
    let text = text.trim().trim_matches(['[', ']', '(', ')']).trim();
    let is_none = text.is_empty() || text.chars().all(|c| c == '-');
    (!is_none).then(|| text.to_owned())
}

/// Whether most stated units of a row are known.
fn is_row_of_units(record: &csv::ByteRecord) -> bool {
    let stated: Vec<String> = record.iter().filter_map(unit_in).collect();
    let known = stated.iter().filter(|unit| unit_of_text(unit).is_some());
    2 * known.count() > stated.len()
}

/// Whether a cell consists of digits with signs and marks.
fn is_number_like(text: &str) -> bool {
    let is_allowed = |c: char| c.is_ascii_digit() || "+-.,eE".contains(c) || is_space_mark(c);
    text.starts_with(|c: char| c.is_ascii_digit() || "+-.,".contains(c))
        && text.contains(|c: char| c.is_ascii_digit())
        && text.chars().all(is_allowed)
}

/// Marks between thousands that are nothing else in a number: spaces and apostrophes.
fn is_space_mark(c: char) -> bool {
    matches!(c, ' ' | '\u{a0}' | '\u{2009}' | '\u{202f}' | '\'' | '\u{2019}')
}

/// The format in which most cells are numbers, the plainest of these; plain where two would yield different numbers.
fn number_format(cells: &[String], separator: u8) -> NumberFormat {
    let numbers: Vec<&String> = cells.iter().filter(|cell| is_number_like(cell)).collect();
    let format = |has_decimal_comma, thousands| NumberFormat { has_decimal_comma, thousands };
    let count = |format: NumberFormat| {
        numbers.iter().filter(|cell| without_marks(cell, format).is_some()).count()
    };
    let comma_between_thousands = format(false, Some(','));
    let mut formats = vec![NumberFormat::PLAIN, format(true, None), format(true, Some('.'))];
    let space = numbers.iter().find_map(|cell| cell.chars().find(|c| is_space_mark(*c)));
    if space.is_some() {
        formats.extend([format(false, space), format(true, space)]);
    }
    let most = formats.iter().map(|format| count(*format)).max().unwrap_or(0);
    let best = formats.into_iter().find(|format| count(*format) == most);
    let best = best.unwrap_or(NumberFormat::PLAIN);
    match count(comma_between_thousands).cmp(&most) {
        Ordering::Greater => comma_between_thousands,
        Ordering::Less => best,
        // `1,234` in a table of semicolons; in one of commas it stays open.
        Ordering::Equal if best == format(true, None) && separator != b',' => best,
        Ordering::Equal => NumberFormat::PLAIN,
    }
}

/// A number without marks between its thousands and with a decimal point; `None` if these marks are not every three digits.
fn without_marks(text: &str, format: NumberFormat) -> Option<String> {
    let decimal = if format.has_decimal_comma { ',' } else { '.' };
    let end = text.find(['e', 'E']).unwrap_or(text.len());
    let (mantissa, exponent) = text.split_at(end);
    let (whole, decimals) = match mantissa.split_once(decimal) {
        Some((whole, decimals)) => (whole, Some(decimals)),
        None => (mantissa, None),
    };
    let sign = whole.len() - whole.trim_start_matches(['+', '-']).len();
    let (sign, whole) = whole.split_at(sign);
    let whole = match format.thousands {
        Some(mark) if whole.contains(mark) => {
            let mut groups = whole.split(mark);
            let is_first = groups
                .next()
                .is_some_and(|first| (1..=3).contains(&first.len()) && !first.starts_with('0'));
            if !is_first || !groups.all(|group| group.len() == 3) {
                return None;
            }
            Cow::Owned(whole.replace(mark, ""))
        }
        _ => Cow::Borrowed(whole),
    };
    let is_digits = |part: &str| part.bytes().all(|byte| byte.is_ascii_digit());
    if !is_digits(&whole) || !decimals.is_none_or(is_digits) {
        return None;
    }
    let point = if decimals.is_some() { "." } else { "" };
    Some(format!("{sign}{whole}{point}{}{exponent}", decimals.unwrap_or_default()))
}

/// Seconds of a time of day since midnight, or of a date since 1970, as a decimal number; without a time zone it counts as UTC.
/// `None` for all else.
fn seconds(text: &str) -> Option<String> {
    if !text.contains(':') || !text.starts_with(|c: char| c.is_ascii_digit()) {
        return None;
    }
    let text = text.replace(',', ".");
    let epoch = Date::constant(1970, 1, 1).to_datetime(Time::midnight());
    let of_form = |form| DateTime::strptime(form, &text).ok();
    let date = || text.parse().ok().or_else(|| DATE_FORMS.into_iter().find_map(of_form));
    // The parser of times accepts dates as well, and keeps their time only.
    let since_epoch = if let Ok(instant) = text.parse::<Timestamp>() {
        instant.duration_since(Timestamp::UNIX_EPOCH)
    } else if let Some(date) = date() {
        date.duration_since(epoch)
    } else {
        epoch.with().time(text.parse().ok()?).build().ok()?.duration_since(epoch)
    };
    let (seconds, nanoseconds) = (since_epoch.as_secs(), since_epoch.subsec_nanos());
    (!since_epoch.is_negative()).then(|| format!("{seconds}.{nanoseconds:09}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn format(table: &str) -> TableFormat {
        TableFormat::of(table.as_bytes(), true)
    }

    fn read(table: &str, cell: &str) -> String {
        String::from_utf8(format(table).plain(cell.as_bytes()).into_owned()).unwrap()
    }

    #[test]
    fn numbers_are_read_as_the_table_writes_them() {
        for (table, cell, number) in [
            ("t,b\n0,1.5\n1,2.5\n", "1234.5", "1234.5"),
            ("t;b\n0;1,5\n1;2,5\n", "-1234,5", "-1234.5"),
            ("t;b\n0;1.234,5\n1;2,5\n", "1.234", "1234"),
            ("t;b\n0;1.234,5\n1;2,5\n", "-144.364,1", "-144364.1"),
            ("t\tb\n0\t1,234.5\n1\t2.5\n", "12,345.5", "12345.5"),
            ("t,b\n\"0,000\",\"2411,4\"\n\"0,020\",\"2398,4\"\n", "2411,4", "2411.4"),
            ("t,b\n0,\"1,234,567\"\n", "1,234", "1234"),
            ("t;b\n0;1 234,5\n1;2,5\n", "1\u{a0}234,5", "\u{201c}1\u{a0}234,5\u{201d}"),
            ("t;b\n0;1 234,5\n1;2,5\n", "1 234,5", "1234.5"),
            ("t;b\n0;1'234.5\n1;2.5\n", "-1'234.5e-3", "-1234.5e-3"),
            ("t;b\n0;1,5e3\n1;2,5\n", "1,5e3", "1.5e3"),
        ] {
            assert_eq!(read(table, cell), number, "{table}: {cell}");
        }
    }

    #[test]
    fn what_the_rows_leave_open_stays_text() {
        // One and a bit, or one thousand and more?
        assert_eq!(read("t,b\n0,\"1,234\"\n1,\"2,345\"\n", "1,234"), "1,234");
        // A decimal point where points separate thousands.
        assert_eq!(read("t;b\n0;1.234,5\n1;2,5\n", "24.08"), "\u{201c}24.08\u{201d}");
        // One and a quarter, and one thousand?
        assert_eq!(read("t;b\n0;1.250\n1;2,345\n", "1.250"), "1.250");
        // The third of May, or the fifth of March?
        assert_eq!(
            read("t,b\n05/03/2026 12:00:00,1\n05/03/2026 12:00:01,1\n", "05/03/2026 12:00:01"),
            "05/03/2026 12:00:01"
        );
    }

    #[test]
    fn times_become_seconds() {
        for (cell, expected) in [
            ("14:02:11.5", "50531.500000000"),
            ("14:02:11,020", "50531.020000000"),
            // date -u -d 2026-05-03T14:03:11Z +%s
            ("2026-05-03T14:03:11.370", "1777816991.370000000"),
            ("2026-05-03 14:03:11Z", "1777816991.000000000"),
            ("2026-05-03T16:03:11+02:00", "1777816991.000000000"),
            ("03.05.2026 14:03:11,25", "1777816991.250000000"),
            ("2026/05/03 14:03:11", "1777816991.000000000"),
        ] {
            assert_eq!(seconds(cell).as_deref(), Some(expected), "{cell}");
        }
        for text in ["a:b", "12:61:00", "10:2026", "s0:x"] {
            assert_eq!(seconds(text), None, "{text}");
        }
    }

    #[test]
    fn header_is_the_text_above_the_numbers() {
        for (table, preamble, has_units) in [
            ("t,b\n0,1\n1,2\n", 0, false),
            ("export v3\nSerial;0815\nDate;2026-05-03\n\nt;b;c\n0;1;2\n1;2;3\n2;2;3\n", 3, false),
            ("Serial;0815\nDate;2026-05-03\nt;b\n0;1\n1;2\n2;3\n", 2, false),
            ("t;b\n[s];[uT]\n0;1\n1;2\n", 0, true),
            ("t;b;note\ns;\u{b5}T;\n0;1;x\n1;2;y\n", 0, true),
            ("t;b\nsec;Gauss\n0;1\n1;2\n", 0, true),
            ("0,1\n1,2\n", 0, false),
        ] {
            let format = format(table);
            assert_eq!((format.preamble, format.has_units), (preamble, has_units), "{table}");
        }
    }

    /// Names that are numbers, no rows, and rows with a cell more than the header.
    #[test]
    fn separator_is_found_without_text_above_numbers() {
        for table in ["t;1;2\n0;1,5;2\n1;2,5;3\n", "t;b\n", "t;b\n0;1,5;\n1;2,5;\n"] {
            let format = format(table);
            assert_eq!((format.separator, format.preamble), (b';', 0), "{table}");
        }
        assert_eq!(read("t;1;2\n0;1,5;2\n1;2,5;3\n", "1,5"), "1.5");
    }

    #[test]
    fn units_follow_the_names() {
        let record = |cells: &[&str]| csv::ByteRecord::from(cells.to_vec());
        let names =
            TableFormat::with_units(&record(&["t", "Bx", "n"]), &record(&["s", "[uT]", "-"]));
        assert_eq!(names, record(&["t [s]", "Bx [uT]", "n"]));
    }

    #[test]
    fn cut_start_of_a_table_is_enough() {
        let table = "t;b\n0,5;1.234,5\n1,5;1.23";
        assert_eq!(TableFormat::of(table.as_bytes(), false).separator, b';');
    }
}

//! Terminal output: tables and wrapped text; [`TextTable`] is also drawn on pages.

use std::fmt;
use std::io::{ErrorKind, Write};
use std::path::Path;

use anstyle::{AnsiColor, Style};
use anyhow::Result;
use comfy_table::{CellAlignment, ContentArrangement, LineStyle, Table, TableStyle};
use serde_json::Value;

/// Maximum line width in characters.
pub const WIDTH: u16 = 100;
/// Line width of running text: the default width of a terminal.
pub const NARROW_WIDTH: u16 = 80;

pub const GOOD: Style = AnsiColor::Green.on_default().bold();
/// Style of a result to note.
pub const WARNING: Style = AnsiColor::Yellow.on_default().bold();
pub const ERROR: Style = AnsiColor::Red.on_default().bold();
pub const HEADING: Style = Style::new().bold();

/// Sensor columns per table.
pub const SENSORS_ACROSS: usize = 4;

/// Rules below the header and at the end only.
const STYLE: TableStyle = TableStyle::new()
    .header_separator(LineStyle::none().fill('─').junction('─'))
    .bottom_border(LineStyle::none().fill('─').junction('─'));

/// An empty table with these column headers.
pub fn table<S: ToString>(headers: impl IntoIterator<Item = S>) -> Table {
    let headers: Vec<_> = headers.into_iter().map(|h| h.to_string()).collect();
    let mut table = Table::new();
    table
        .load_style(STYLE)
        .set_content_arrangement(ContentArrangement::Dynamic)
        .set_width(WIDTH)
        .set_header(headers);
    table
}

/// A table of texts, for the terminal and for a page.
#[derive(Clone, Debug)]
pub struct TextTable {
    pub heads: Vec<String>,
    pub rows: Vec<Vec<String>>,
    /// Columns of text at the left; the others are numbers.
    pub text_columns: usize,
    /// Maximum width on the terminal in characters.
    pub width: u16,
}

impl TextTable {
    pub fn new<R: IntoIterator<Item = String>>(
        heads: &[&str],
        text_columns: usize,
        rows: impl IntoIterator<Item = R>,
    ) -> Self {
        Self {
            heads: heads.iter().map(ToString::to_string).collect(),
            rows: rows.into_iter().map(|row| row.into_iter().collect()).collect(),
            text_columns,
            width: WIDTH,
        }
    }
}

impl fmt::Display for TextTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut table = table(&self.heads);
        table.set_width(self.width).add_rows(&self.rows);
        right_align(&mut table, self.text_columns);
        table.fmt(f)
    }
}

/// The text of a value; a dash for one that is not finite.
pub fn or_dash(value: f64, text: String) -> String {
    if value.is_finite() { text } else { "-".to_owned() }
}

/// Aligns all columns to the right but the first `text_columns`.
pub fn right_align(table: &mut Table, text_columns: usize) {
    for column in table.column_iter_mut().skip(text_columns) {
        column.set_cell_alignment(CellAlignment::Right);
        column.set_padding((1, 0));
    }
}

/// Prints on stdout, without colors if it is no terminal or `NO_COLOR` is set. A closed pipe (`| head`) is no
/// error.
pub fn print(text: &str) -> std::io::Result<()> {
    match anstream::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        result => result,
    }
}

/// Prints the result of a command: one JSON object with `--json`, otherwise text.
pub fn print_result(
    json: bool,
    object: impl FnOnce() -> Value,
    text: impl FnOnce() -> String,
) -> Result<()> {
    let output = if json { format!("{}\n", object()) } else { text() };
    Ok(print(&output)?)
}

/// Prints where a result was written, or the option that writes it.
pub fn print_written(output: Option<&Path>, option: &str) -> std::io::Result<()> {
    print(&match output {
        Some(path) => format!("Written to {}.\n", path.display()),
        None => format!("Not written; use {option}.\n"),
    })
}

/// The line with the path of an HTML report; empty if none was written.
pub fn report_line(output: Option<&Path>) -> String {
    output.map_or_else(String::new, |path| format!("Report: {}\n", path.display()))
}

/// Text wrapped at `width` in a style, set for each line so that a pager that shows one line keeps it.
pub fn styled(style: Style, text: &str, width: u16) -> String {
    wrap(text, width).lines().map(|line| format!("{style}{line}{style:#}\n")).collect()
}

/// Wraps text at [`WIDTH`]; all lines have the indentation of the first.
pub fn paragraph(text: &str) -> String {
    wrap(text, WIDTH)
}

/// Wraps running text at [`NARROW_WIDTH`]; all lines have the indentation of the first.
pub fn narrow(text: &str) -> String {
    wrap(text, NARROW_WIDTH)
}

/// [`narrow`] in a style.
pub fn narrow_styled(style: Style, text: &str) -> String {
    styled(style, text, NARROW_WIDTH)
}

/// Wraps text at `width`; all lines have the indentation of the first.
pub fn wrap(text: &str, width: u16) -> String {
    let indent = " ".repeat(text.len() - text.trim_start().len());
    let options = textwrap::Options::new(usize::from(width)).subsequent_indent(&indent);
    textwrap::fill(text, options) + "\n"
}

//! Terminal output: tables, wrapped text, formatted numbers and progress bars (on stderr, terminals only).

use std::io::{ErrorKind, Write};
use std::path::Path;
use std::time::Duration;

use anyhow::Result;
use comfy_table::{CellAlignment, ContentArrangement, LineStyle, Table, TableStyle};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value;

/// Maximum line width in characters.
pub const WIDTH: u16 = 100;
/// Line width of running text: the default width of a terminal.
pub const NARROW_WIDTH: u16 = 80;

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

/// Prints messages as notes on stderr.
pub fn print_notes(notes: &[impl std::fmt::Display]) {
    for note in notes {
        eprintln!("note: {note}");
    }
}

/// Wraps text at [`WIDTH`]; all lines have the indentation of the first.
pub fn paragraph(text: &str) -> String {
    wrap(text, WIDTH)
}

/// Wraps text at `width`; all lines have the indentation of the first.
pub fn wrap(text: &str, width: u16) -> String {
    let indent = " ".repeat(text.len() - text.trim_start().len());
    let options = textwrap::Options::new(usize::from(width)).subsequent_indent(&indent);
    textwrap::fill(text, options) + "\n"
}

/// `value±error`, both to two significant digits of the error, but no finer than a thousandth of `scale`.
pub fn with_error(value: f64, error: f64, scale: f64) -> String {
    let decimals = decimals_for(error).min(decimals_for(0.01 * scale));
    format!("{value:.decimals$}±{error:.decimals$}")
}

/// A number with at most `decimals` decimals, without trailing zeros.
pub fn decimal(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// [`decimal`] of a finite number, otherwise a dash.
pub fn decimal_or_dash(value: f64, decimals: usize) -> String {
    if value.is_finite() { decimal(value, decimals) } else { "-".to_owned() }
}

/// Number of decimals (0 to 6) that gives `magnitude` two significant digits.
pub fn decimals_for(magnitude: f64) -> usize {
    if !(magnitude.is_finite() && magnitude > 0.0) {
        return 3;
    }
    (1.0 - magnitude.log10().floor()).clamp(0.0, 6.0) as usize
}

/// A bar over `steps`, removed when dropped.
pub fn progress_bar(message: &'static str, steps: usize) -> ProgressBar {
    let bar = ProgressBar::new(steps as u64);
    styled(bar, "{msg:<28} [{bar:30}] {pos}/{len} {elapsed}", message)
}

/// A spinner with the number and rate of rows, where the total is unknown.
pub fn row_spinner(message: &'static str) -> ProgressBar {
    let template = "{msg:<28} {spinner} {human_pos} rows, {per_sec}";
    styled(ProgressBar::new_spinner(), template, message)
}

/// A spinner behind a changing message.
pub fn status_spinner(message: &'static str) -> ProgressBar {
    styled(ProgressBar::new_spinner(), "{msg} {spinner}", message)
}

/// A bar over training epochs with the maximum remaining time.
pub fn epoch_bar(message: &'static str, epochs: u32, done: u32) -> ProgressBar {
    let bar = ProgressBar::new(u64::from(epochs)).with_position(u64::from(done));
    let template = "{msg:<44} [{bar:20}] {pos}/{len} {elapsed}, at most {eta} left";
    let bar = styled(bar, template, message);
    bar.reset_eta();
    bar
}

/// A bar whose length grows as work is announced, with the maximum remaining time.
pub fn growing_bar() -> ProgressBar {
    let template = "{msg:<44} [{bar:20}] {elapsed}, at most {eta} left";
    styled(ProgressBar::new(0), template, "fitting the physics")
}

fn styled(bar: ProgressBar, template: &str, message: &'static str) -> ProgressBar {
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_message(message);
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_follow_the_error_and_are_limited_by_the_scale() {
        for (value, error, scale, text) in [
            (501.097_4, 0.019_68, 0.1, "501.097±0.020"),
            (-35.2, 17.0, 50.0, "-35±17"),
            (501.097_4, 0.001_9, 50.0, "501.10±0.00"),
        ] {
            assert_eq!(with_error(value, error, scale), text);
        }
    }
}

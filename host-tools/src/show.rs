//! Numbers and tables as people read them.

use std::io::Write;

use comfy_table::{CellAlignment, ContentArrangement, LineStyle, Table, TableStyle};

/// Widest line that is printed.
pub const WIDTH: u16 = 100;
/// Width of a page that is read rather than looked up: that of a terminal as it opens.
pub const NARROW: u16 = 80;

/// A rule under the heads and at the end: the rows themselves need none.
const STYLE: TableStyle = TableStyle::new()
    .header_separator(LineStyle::none().fill('─').junction('─'))
    .bottom_border(LineStyle::none().fill('─').junction('─'));

/// A table with these column heads.
pub fn table<S: ToString>(heads: impl IntoIterator<Item = S>) -> Table {
    let mut table = Table::new();
    table
        .load_style(STYLE)
        .set_content_arrangement(ContentArrangement::Dynamic)
        .set_width(WIDTH)
        .set_header(
            heads
                .into_iter()
                .map(|head| head.to_string())
                .collect::<Vec<_>>(),
        );
    table
}

/// Prints a page on stdout, without its colours where that is no terminal or `NO_COLOR` is set; a
/// reader that has seen enough (`| head`) is no error.
pub fn page(text: &str) -> std::io::Result<()> {
    match anstream::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        result => result,
    }
}

/// Text broken into lines of the page's width, as far as its first line is set in.
pub fn paragraph(text: &str) -> String {
    wrapped(text, WIDTH)
}

/// The same in lines of this width.
pub fn wrapped(text: &str, width: u16) -> String {
    let indent = " ".repeat(text.len() - text.trim_start().len());
    let options = textwrap::Options::new(usize::from(width)).subsequent_indent(&indent);
    textwrap::fill(text, options) + "\n"
}

/// Puts all columns but the first `words` to the right.
pub fn right_align(table: &mut Table, words: usize) {
    for column in table.column_iter_mut().skip(words) {
        column.set_cell_alignment(CellAlignment::Right);
        column.set_padding((1, 0));
    }
}

/// `value±error`, both to two digits of the error, but no finer than a thousandth of `scale`.
pub fn with_error(value: f64, error: f64, scale: f64) -> String {
    let decimals = decimals_for(error).min(decimals_for(0.01 * scale));
    format!("{value:.decimals$}±{error:.decimals$}")
}

/// A number without the digits that do not matter: `0.10` is `0.1`, `-0` is `0`.
pub fn plain(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// As many decimals as show `size` to two digits, six at the most.
pub fn decimals_for(size: f64) -> usize {
    if !(size.is_finite() && size > 0.0) {
        return 3;
    }
    (1.0 - size.log10().floor()).clamp(0.0, 6.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_shown_to_two_digits_of_its_error() {
        assert_eq!(with_error(501.097_4, 0.019_68, 0.1), "501.097±0.020");
        assert_eq!(with_error(-35.2, 17.0, 50.0), "-35±17");
    }

    #[test]
    fn digits_far_below_the_scale_are_not_shown() {
        assert_eq!(with_error(501.097_4, 0.001_9, 50.0), "501.10±0.00");
    }
}

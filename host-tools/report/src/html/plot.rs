//! Common parts of all plots: size, axes, text, embedding into the page.

use std::ops::Range;

use maud::{Markup, PreEscaped, html};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::html::palette::{self, Role};
use analysis::numbers::number;
use analysis::numbers::{decimal, decimals_for};

/// Drawing units per pixel: the backend has integer coordinates, too coarse in pixels.
const PX: u32 = 4;
/// Line height of text in pixels, 1.24 times the font size: a plot 440 pixels wide
/// is scaled to 358 on a phone.
const LETTERS: u32 = 16;
/// Mean width of a letter in pixels.
pub const LETTER_WIDTH: f64 = 8.0;
/// Minimum width of the labels of a vertical axis in pixels.
const LABEL_WIDTH: f64 = 60.0;
/// Size in pixels of plots placed in pairs; the text remains legible on a phone.
pub const HALF: (u32, u32) = (440, 260);

/// Error of the backend.
pub type Failure = DrawingAreaErrorKind<std::io::Error>;
/// Plot with two linear axes.
pub type Chart<'a, 'b> =
    ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
/// Drawing area of a plot.
pub type Paper<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Converts pixels to drawing units.
pub fn px(pixels: f64) -> i32 {
    (pixels * f64::from(PX)).round() as i32
}

/// Draws `width` by `height` pixels; `says` is the text for screen readers.
pub fn figure(
    (width, height): (u32, u32),
    says: &str,
    draw: impl FnOnce(&Paper) -> Result<(), Failure>,
) -> Markup {
    let mut text = String::new();
    let drawn = {
        let paper =
            SVGBackend::with_string(&mut text, (width * PX, height * PX)).into_drawing_area();
        draw(&paper).and_then(|()| paper.present())
    };
    if let Err(error) = drawn {
        return html! { p.empty { "This plot could not be drawn: " (error) "." } };
    }
    // Remove the namespace and the fixed size of the root element.
    let inside = text.split_once('>').map_or("", |(_, inside)| inside);
    let inside = inside.trim_end().trim_end_matches("</svg>");
    // Remove default values.
    let inside = inside.replace(" opacity=\"1\"", "");
    let view = format!("0 0 {} {}", width * PX, height * PX);
    html! {
        svg viewBox=(view) role="img" aria-label=(says) style=(format!("max-width:{}px", width * 5 / 4)) {
            (PreEscaped(inside))
        }
    }
}

/// What the numbers of an axis are, and how its labels are written.
#[derive(Clone, Debug, PartialEq)]
pub enum AxisScale {
    Linear,
    /// Decimal logarithms; the labels show the values.
    Logarithmic,
    /// Indices of these names.
    Names(Vec<String>),
}

/// Axis: label with unit, and range.
#[derive(Clone, Debug)]
pub struct Along {
    pub words: String,
    pub range: Range<f64>,
    /// Approximate number of tick labels; 0 for categories.
    pub labels: usize,
    pub scale: AxisScale,
}

impl Along {
    /// Linear axis with this range.
    pub fn linear(words: impl Into<String>, range: Range<f64>, labels: usize) -> Self {
        Self { words: words.into(), range, labels, scale: AxisScale::Linear }
    }

    /// Range of the values with a margin; length 1 for constant values.
    pub fn holding(words: impl Into<String>, values: impl IntoIterator<Item = f64>) -> Self {
        let (least, greatest) = bounds(values).unwrap_or((0.0, 1.0));
        let margin = match greatest - least {
            span if span > 0.0 => 0.04 * span,
            _ => 0.5,
        };
        Self::linear(words, least - margin..greatest + margin, 5)
    }

    /// From zero to slightly above the maximum.
    pub fn bars(words: impl Into<String>, values: impl IntoIterator<Item = f64>) -> Self {
        let greatest = bounds(values).map_or(0.0, |(_, greatest)| greatest);
        Self::linear(words, 0.0..if greatest > 0.0 { 1.08 * greatest } else { 1.0 }, 5)
    }

    /// Logarithmic axis for these decimal logarithms.
    pub fn powers(words: impl Into<String>, values: impl IntoIterator<Item = f64>) -> Self {
        Self { scale: AxisScale::Logarithmic, ..Self::holding(words, values) }
    }

    /// Axis of `count` categories, each one unit wide.
    pub fn things(count: usize) -> Self {
        Self::linear("", 0.0..count.max(1) as f64, 0)
    }

    /// Axis of these names, at 0, 1 and so on.
    pub fn names(names: Vec<String>) -> Self {
        Self {
            words: String::new(),
            range: -0.5..names.len().max(1) as f64 - 0.5,
            labels: names.len() + 1,
            scale: AxisScale::Names(names),
        }
    }

    /// Width of its labels as a vertical axis in pixels.
    fn width(&self) -> f64 {
        match &self.scale {
            AxisScale::Names(names) => {
                let longest = names.iter().map(|name| name.chars().count()).max().unwrap_or(0);
                LABEL_WIDTH.max(LETTER_WIDTH * longest as f64)
            }
            _ => LABEL_WIDTH,
        }
    }

    fn label(&self, value: f64) -> String {
        match &self.scale {
            AxisScale::Linear => {}
            AxisScale::Logarithmic => return power(value),
            AxisScale::Names(names) => {
                let is_index = value >= 0.0 && (value - value.round()).abs() < 1e-9;
                let name = names.get(value.round() as usize).filter(|_| is_index);
                return name.cloned().unwrap_or_default();
            }
        }
        let step = (self.range.end - self.range.start) / self.labels.max(1) as f64;
        let text = decimal(value, decimals_for(step));
        match text.as_str() {
            "-0" => "0".to_owned(),
            _ => text.replace('-', "\u{2212}"),
        }
    }
}

/// Label of a logarithmic axis. Powers of ten are written without further digits and large ones
/// with an exponent, which fits the margin at an end of the axis.
fn power(logarithm: f64) -> String {
    let whole = logarithm.round();
    match (logarithm - whole).abs() < 1e-9 {
        true if (-3.0..=3.0).contains(&whole) => decimal(10.0_f64.powf(whole), 3),
        true => {
            let digits = format!("{whole}").chars().map(raised).collect::<String>();
            format!("10{digits}")
        }
        false => number(10.0_f64.powf(logarithm)),
    }
}

fn raised(digit: char) -> char {
    match digit {
        '-' => '\u{207b}',
        '1' => '\u{b9}',
        '2' => '\u{b2}',
        '3' => '\u{b3}',
        digit => char::from_u32(0x2070 + digit.to_digit(10).unwrap_or(0)).unwrap_or(digit),
    }
}

/// Minimum and maximum of the finite values.
pub fn bounds(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    let mut values = values.into_iter().filter(|value| value.is_finite());
    let first = values.next()?;
    Some(
        values.fold((first, first), |(least, greatest), value| {
            (least.min(value), greatest.max(value))
        }),
    )
}

/// Bands beyond this multiple of the largest mean are clipped: bins of few rows would flatten all others.
const FURTHEST_BAND: f64 = 1.6;

/// Range that holds zero, these means and their bands, with a margin as a fraction.
pub fn range_of_bands(
    means: impl IntoIterator<Item = f64>,
    bands: impl IntoIterator<Item = f64>,
    margin: f64,
) -> Range<f64> {
    let (least, greatest) = bounds(means).unwrap_or((-1.0, 1.0));
    let furthest = FURTHEST_BAND * least.abs().max(greatest.abs()).max(f64::MIN_POSITIVE);
    let (low, high) = bounds(bands).unwrap_or((least, greatest));
    let low = low.min(least).min(0.0).max(-furthest);
    let high = high.max(greatest).max(0.0).min(furthest);
    low - margin * (high - low)..high + margin * (high - low)
}

/// "opening in mm"; without a unit the name alone.
pub fn with_unit(words: &str, unit: &str) -> String {
    if unit.is_empty() { words.to_owned() } else { format!("{words} in {unit}") }
}

pub fn axes<'a, 'b>(
    paper: &Paper<'b>,
    across: &Along,
    upwards: &Along,
) -> Result<Chart<'a, 'b>, Failure> {
    let below = match (across.labels, across.words.is_empty()) {
        (0, _) => 34.0,
        (_, true) => 20.0,
        (_, false) => 38.0,
    };
    let mut chart = ChartBuilder::on(paper)
        .margin(px(4.0))
        .margin_top(px(8.0))
        .margin_right(px(10.0))
        .x_label_area_size(px(below))
        .y_label_area_size(px(upwards.width()))
        .build_cartesian_2d(across.range.clone(), upwards.range.clone())?;
    let grid = stroke(palette::GRID, 1.0);
    let mut mesh = chart.configure_mesh();
    mesh.light_line_style(TRANSPARENT)
        .bold_line_style(grid)
        .axis_style(stroke(palette::MUTED, 1.0))
        .label_style(letters(palette::INK, 1.0))
        .axis_desc_style(letters(palette::MUTED, 1.0))
        .set_all_tick_mark_size(px(3.0))
        .x_labels(across.labels)
        .y_labels(upwards.labels);
    let (x, y) = (|value: &f64| across.label(*value), |value: &f64| upwards.label(*value));
    mesh.x_label_formatter(&x).y_label_formatter(&y);
    if across.labels == 0 {
        mesh.disable_x_mesh();
    }
    if !across.words.is_empty() {
        mesh.x_desc(across.words.as_str());
    }
    if !upwards.words.is_empty() {
        mesh.y_desc(upwards.words.as_str());
    }
    mesh.draw()?;
    Ok(chart)
}

/// Line of this width in pixels.
pub fn stroke(role: Role, pixels: f64) -> ShapeStyle {
    role.light.stroke_width(px(pixels) as u32)
}

/// Text of `times` the default size.
pub fn letters(role: Role, times: f64) -> TextStyle<'static> {
    let size = f64::from(LETTERS * PX) * times;
    ("sans-serif", size).into_font().color(&role.light)
}

pub fn centred(role: Role, times: f64) -> TextStyle<'static> {
    letters(role, times).pos(Pos::new(HPos::Center, VPos::Center))
}

/// Curve: colour and points.
pub type Curve = (Role, Vec<(f64, f64)>);

/// Maximum number of points of a curve, about two per pixel.
const CURVE_POINTS: usize = 900;

/// Width of a curve in pixels.
const CURVE_WIDTH: f64 = 1.5;

/// A figure of curves.
pub fn curve_figure(says: &str, across: &Along, upwards: &Along, curves: &[Curve]) -> Markup {
    let drawn = figure(HALF, says, |paper| {
        let mut chart = axes(paper, across, upwards)?;
        for (role, points) in curves {
            let every = points.len().div_ceil(CURVE_POINTS).max(1);
            let thinned: Vec<_> = points.iter().copied().step_by(every).collect();
            chart.draw_series([PathElement::new(thinned, stroke(*role, CURVE_WIDTH))])?;
        }
        Ok(())
    });
    html! { figure { (drawn) } }
}

/// Splits points at gaps into lines.
pub fn lines(points: &[(f64, f64)]) -> Vec<Vec<(f64, f64)>> {
    points
        .split(|(x, y)| !(x.is_finite() && y.is_finite()))
        .filter(|run| !run.is_empty())
        .map(<[_]>::to_vec)
        .collect()
}

/// Legend.
pub fn key(entries: &[(Swatch, Role, String)]) -> Markup {
    html! {
        ul.key {
            @for (swatch, role, words) in entries {
                li { (swatch.draw(*role)) (words) }
            }
        }
    }
}

/// Legend symbol.
#[derive(Clone, Copy, Debug)]
pub enum Swatch {
    /// Line with the dashes of its colour.
    Line,
    Broad,
    Full,
    Framed,
    Mark,
}

impl Swatch {
    fn draw(self, role: Role) -> Markup {
        let colour = palette::hex(role.light);
        let area = |fill: &str, opacity: &str| {
            html! { rect x="7" y="1" width="12" height="10" stroke-width="1.5" stroke=(colour) fill=(fill) fill-opacity=(opacity) {} }
        };
        html! {
            svg.swatch viewBox="0 0 26 12" aria-hidden="true" {
                @match self {
                    Swatch::Line => polyline points="0,6 26,6" fill="none" stroke-width="2" stroke=(colour) {},
                    Swatch::Broad => line x1="0" x2="26" y1="6" y2="6" opacity="0.4" stroke-width="5" stroke=(colour) {},
                    Swatch::Full => (area(&colour, "1")),
                    Swatch::Framed => (area(&colour, "0.25")),
                    Swatch::Mark => line x1="4" x2="22" y1="6" y2="6" stroke-width="3" stroke=(colour) {},
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gap_splits_a_line() {
        let points = [(0.0, 1.0), (1.0, f64::NAN), (2.0, 3.0), (3.0, 4.0)];
        assert_eq!(lines(&points), [vec![(0.0, 1.0)], vec![(2.0, 3.0), (3.0, 4.0)]]);
    }

    #[test]
    fn powers_of_ten_have_short_labels() {
        let labels = [-4.0, -2.0, 0.0, 3.0, 4.0, 12.0, 0.5].map(power);
        let known =
            ["10\u{207b}\u{2074}", "0.01", "1", "1000", "10\u{2074}", "10\u{b9}\u{b2}", "3.16"];
        assert_eq!(labels, known);
    }

    #[test]
    fn names_are_written_at_their_index_only() {
        let axis = Along::names(vec!["idle".to_owned(), "holding the object".to_owned()]);
        let labels = [-0.5, 0.0, 0.5, 1.0, 2.0].map(|value| axis.label(value));
        assert_eq!(labels, ["", "idle", "", "holding the object", ""]);
        assert_eq!((axis.range.clone(), axis.width()), (-0.5..1.5, 18.0 * LETTER_WIDTH));
    }

    #[test]
    fn axis_of_a_constant_has_a_length() {
        let axis = Along::holding("N", [2.0, f64::NAN, 2.0]);
        assert_eq!(axis.range, 1.5..2.5);
        assert_eq!(Along::bars("G", [f64::NAN, f64::INFINITY]).range, 0.0..1.0);
    }

    #[test]
    fn figure_has_a_description_and_no_address() {
        let drawn = figure((100, 80), "Bars of <b>", |paper| {
            axes(paper, &Along::things(2), &Along::bars("G", [1.0])).map(|_| ())
        });
        let text = drawn.into_string();
        assert!(text.starts_with(
            "<svg viewBox=\"0 0 400 320\" role=\"img\" aria-label=\"Bars of &lt;b&gt;\""
        ));
        assert!(text.ends_with("</svg>"));
        assert!(!text.contains("http"));
    }
}

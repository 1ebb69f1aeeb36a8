//! Map of the RMS residual over two covariates, in multiples of the floor.

use maud::{Markup, html};
use plotters::prelude::*;
use plotters::style::colors::colormaps::{ColorMap, ViridisRGB};

use crate::html::plot::{Along, Failure, Paper, axes, bounds, figure, letters, px};
use crate::html::summary::initial;
use crate::html::{both, palette};
use analysis::compare::{Comparison, ResidualMap};
use analysis::numbers::number;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Size of the map in pixels.
const SIZE: (u32, u32) = (460, 360);
/// Width of the colour bar with its labels.
const BAR: i32 = 72;
/// Minimum cell size in pixels for a number.
const NARROWEST: (f64, f64) = (30.0, 15.0);
/// Number of steps of the colour bar.
const STEPS: i32 = 48;

/// The map of the model, and of the baseline if any, with one scale of colours.
pub fn section(comparison: &Comparison) -> Markup {
    let models = both(comparison);
    let maps = models
        .iter()
        .rev()
        .filter_map(|(role, letter, model)| Some((initial(*role, letter), model.map.as_ref()?)));
    let maps: Vec<_> = maps.collect();
    let floors = maps.iter().flat_map(|(_, map)| cells(map)).map(|(_, floors)| floors);
    let colours = bounds(floors).map(|(least, greatest)| Colours {
        // A minimum range, so that noise does not fill the colour scale.
        least: least.min(1.0),
        greatest: greatest.max(2.0),
    });
    html! {
        section #map {
            h2 { "Map over two covariates" }
            @match &colours {
                None => p.empty { "No pair of covariates was recorded well enough." },
                Some(colours) => div.pair {
                    @for (letter, map) in &maps { (plot(letter, map, colours)) }
                },
            }
        }
    }
}

/// Corners and multiples of the floor of each cell.
fn cells(map: &ResidualMap) -> Vec<([(f64, f64); 2], f64)> {
    let rows = map.upwards.windows(2).zip(&map.rms);
    rows.flat_map(|(y, row)| {
        let columns = map.across.windows(2).zip(row);
        columns.filter_map(move |(x, rms)| {
            let (&[left, right], &[low, high]) = (x, y) else {
                return None;
            };
            let floors = rms / map.floor;
            (floors.is_finite() && floors > 0.0).then_some(([(left, low), (right, high)], floors))
        })
    })
    .collect()
}

fn plot(letter: &Markup, map: &ResidualMap, colours: &Colours) -> Markup {
    let cells = cells(map);
    let of_cells = bounds(cells.iter().map(|(_, floors)| *floors));
    let (least, greatest) = of_cells.unwrap_or((colours.least, colours.greatest));
    let [across, upwards] = &map.axes;
    let says = format!(
        "Map of the root mean square over {across} and {upwards}, in floors of {} {}: from {} to {}.",
        number(map.floor),
        map.error_unit.symbol(),
        number(least),
        number(greatest)
    );
    let drawn = figure(SIZE, &says, |paper| {
        let (left, right) = paper.split_horizontally(px(f64::from(SIZE.0 as i32 - BAR)));
        grid(&left, map, &cells, colours)?;
        bar(&right, colours)
    });
    html! {
        figure.map {
            figcaption { (letter) " RMS in floors (1 = " (number(map.floor)) " " (map.error_unit.symbol()) "); grey: not measured" }
            (drawn)
        }
    }
}

/// Logarithmic colour scale.
struct Colours {
    least: f64,
    greatest: f64,
}

impl Colours {
    fn share(&self, floors: f64) -> f32 {
        let share = (floors / self.least).ln() / (self.greatest / self.least).ln();
        share.clamp(0.0, 1.0) as f32
    }

    fn of(&self, floors: f64) -> RGBColor {
        ViridisRGB.get_color(self.share(floors))
    }

    /// Legible text colour.
    fn letters(&self, floors: f64) -> RGBColor {
        if self.share(floors) > 0.55 { BLACK } else { WHITE }
    }
}

fn grid(
    paper: &Paper,
    map: &ResidualMap,
    cells: &[([(f64, f64); 2], f64)],
    colours: &Colours,
) -> Result<(), Failure> {
    let ends = |edges: &[f64]| bounds(edges.iter().copied()).unwrap_or((0.0, 1.0));
    let axis = |words: &String, edges: &[f64]| {
        let (from, to) = ends(edges);
        Along::linear(words, from..to, 6)
    };
    let [across, upwards] = &map.axes;
    let (across, upwards) = (axis(across, &map.across), axis(upwards, &map.upwards));
    let mut chart = axes(paper, &across, &upwards)?;
    let all = [(across.range.start, upwards.range.start), (across.range.end, upwards.range.end)];
    chart.draw_series([Rectangle::new(all, palette::GRID.light.filled())])?;
    let coloured = cells
        .iter()
        .map(|(corners, floors)| Rectangle::new(*corners, colours.of(*floors).filled()));
    chart.draw_series(coloured)?;
    for ([low, high], floors) in cells {
        let ((left, bottom), (right, top)) = (chart.backend_coord(low), chart.backend_coord(high));
        if right - left >= px(NARROWEST.0) && bottom - top >= px(NARROWEST.1) {
            let colour = colours.letters(*floors);
            let style = letters(palette::INK, 0.85)
                .color(&colour)
                .pos(Pos::new(HPos::Center, VPos::Center));
            let at = ((left + right) / 2, (bottom + top) / 2);
            paper.draw(&Text::new(number(*floors), at, style))?;
        }
    }
    Ok(())
}

fn bar(paper: &Paper, colours: &Colours) -> Result<(), Failure> {
    let (_, height) = paper.dim_in_pixel();
    let (top, foot) = (px(26.0), height as i32 - px(44.0));
    let (left, right) = (px(4.0), px(20.0));
    let at = |share: f64| foot - ((f64::from(foot - top)) * share).round() as i32;
    let floors = |share: f64| colours.least * (colours.greatest / colours.least).powf(share);
    for step in 0..STEPS {
        let (low, high) = (f64::from(step), f64::from(step + 1));
        let (low, high) = (low / f64::from(STEPS), high / f64::from(STEPS));
        let corners = [(left, at(high)), (right, at(low))];
        let colour = colours.of(floors((low + high) / 2.0));
        paper.draw(&Rectangle::new(corners, colour.filled()))?;
    }
    let left_of = Pos::new(HPos::Left, VPos::Center);
    for quarter in 0..=4 {
        let share = f64::from(quarter) / 4.0;
        let words = number(floors(share));
        let place = (right + px(5.0), at(share));
        paper.draw(&Text::new(words, place, letters(palette::INK, 1.0).pos(left_of)))?;
    }
    let head = (left, px(10.0));
    paper.draw(&Text::new("\u{d7} floor", head, letters(palette::MUTED, 1.0).pos(left_of)))
}

//! Head of the report with the verdict, and all errors on one scale; setup errors; provenance.
//!
//! The scale is in multiples of the noise floor, the residual of a perfect model, up to the span of the
//! measurement.

use crate::html::both;
use crate::html::palette::{self, Role};
use crate::html::plot::{Failure, Paper, Swatch, centred, figure, key, letters, px, stroke};
use crate::text::comparison::conclusion::{validation, verdict};
use crate::text::comparison::{force_headline, force_origins};
use crate::text::findings;
use analysis::compare::Comparison;
use analysis::numbers::{number, percent};
use analysis::statistics::ErrorStatistics;
use analysis::statistics::rms_of_finite;
use maud::{Markup, html};
use model_export::recordings::columns::Axis;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Error of one quantity over all sensors and axes.
struct Pool {
    of: &'static str,
    unit: &'static str,
    error: ErrorStatistics,
    floor: f64,
}

impl Pool {
    fn of(
        of: &'static str,
        unit: &'static str,
        errors: impl Iterator<Item = (ErrorStatistics, f64)>,
    ) -> Option<Self> {
        let errors: Vec<_> = errors.collect();
        let over = |figure: fn(&ErrorStatistics) -> f64| {
            rms_of_finite(errors.iter().map(|(error, _)| figure(error)))
        };
        (!errors.is_empty()).then(|| Self {
            of,
            unit,
            error: ErrorStatistics {
                rms: over(|error| error.rms),
                mean: over(|error| error.mean),
                std: over(|error| error.std),
                p95: over(|error| error.p95),
                greatest: errors.iter().fold(f64::NAN, |most, (error, _)| most.max(error.greatest)),
                span: over(|error| error.span),
            },
            floor: rms_of_finite(errors.iter().map(|(_, floor)| *floor)),
        })
    }

    fn floors(&self, size: f64) -> Option<f64> {
        let floors = size / self.floor;
        (floors.is_finite() && floors > 0.0).then_some(floors)
    }
}

fn pools(comparison: &Comparison) -> Vec<Pool> {
    let field = comparison.axes.iter().map(|a| (a.error, a.floor.total));
    let forces = |axis: Axis| {
        let of = comparison.forces.iter().filter(move |f| f.axis == axis);
        of.map(|f| (f.error, f.floor))
    };
    [
        Pool::of("Field", comparison.noise.unit.symbol(), field),
        Pool::of("Lateral force", "N", forces(Axis::X)),
        Pool::of("Longitudinal force", "N", forces(Axis::Z)),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Model, campaign, verdict, and evaluation method.
pub fn head(comparison: &Comparison) -> Markup {
    let models = both(comparison);
    let two = models.len() > 1;
    let headline = force_headline(comparison);
    html! {
        header {
            h1 { "Model versus measurement" }
            dl.of {
                @for (role, letter, model) in &models {
                    dt { "Model" @if two { " " (initial(*role, letter)) } } dd { (model.model) }
                }
                dt { "Campaign" } dd { (comparison.campaign) }
            }
            @if !headline.is_empty() { p.verdict { (headline) } }
            @for origin in force_origins(comparison) { p { (origin) } }
            @for (role, letter, model) in &models {
                p.verdict {
                    @if two { (initial(*role, letter)) ": " }
                    (verdict(model))
                }
            }
            @if comparison.validation.is_some() { p.validation { "Evaluation: " (validation(comparison)) } }
        }
    }
}

/// Letter of a model in its colour.
pub fn initial(role: Role, letter: &str) -> Markup {
    html! { span.letter style=(format!("color:var(--{})", role.name)) { (letter) } }
}

pub fn section(comparison: &Comparison) -> Markup {
    if pools(comparison).is_empty() {
        return html! {};
    }
    html! {
        section #scale {
            h2 { "Overall error" }
            div.columns {
                (tiles(comparison))
                (scale(comparison))
            }
        }
    }
}

fn tiles(comparison: &Comparison) -> Markup {
    let rows = interleaved(comparison);
    html! {
        ul.tiles {
            @for group in rows.chunk_by(|(_, _, one), (_, _, next)| one.of == next.of) {
                li {
                    @for (i, (role, letter, pool)) in group.iter().enumerate() {
                        @if i == 0 { span.of { (pool.of) ", RMS" } }
                        span.size {
                            @if comparison.other.is_some() { (initial(*role, letter)) " " }
                            (number(pool.error.rms)) " " (pool.unit)
                        }
                        span.share {
                            @if let Some(floors) = pool.floors(pool.error.rms) { (number(floors)) " times the floor, " }
                            (percent(pool.error.rms / pool.error.span)) " of its span"
                        }
                    }
                }
            }
        }
    }
}

/// Width of the scale in pixels.
const WIDTH: u32 = 440;
/// Height of one row.
const ROW: u32 = 44;
/// Height of the axis labels.
const FOOT: u32 = 40;
/// Left margin in pixels.
const LEFT: f64 = 14.0;
/// Minimum of the scale in floors.
const LEAST: f64 = 0.7;

fn scale(comparison: &Comparison) -> Markup {
    let rows = interleaved(comparison);
    let most = rows
        .iter()
        .filter_map(|(_, _, pool)| pool.floors(pool.error.span.max(pool.error.greatest)))
        .fold(10.0, f64::max);
    let says = rows.iter().fold(
        "Errors as multiples of the floor, on a logarithmic scale.".to_owned(),
        |says, (_, _, pool)| {
            let floors = |size| pool.floors(size).map_or_else(|| "unknown".to_owned(), number);
            format!(
                "{says} {}: RMS {}, max {}, span {}.",
                pool.of,
                floors(pool.error.rms),
                floors(pool.error.greatest),
                floors(pool.error.span)
            )
        },
    );
    let place = |floors: f64| {
        let share = (floors / LEAST).ln() / (1.3 * most / LEAST).ln();
        px(LEFT + share * (f64::from(WIDTH) - 2.0 * LEFT))
    };
    let height = ROW * rows.len() as u32 + FOOT;
    let drawn = figure((WIDTH, height), &says, |paper| {
        ticks(paper, &place, most, height)?;
        for (i, (role, letter, pool)) in rows.iter().enumerate() {
            row(paper, &place, f64::from(ROW) * (i as f64 + 0.75), *role, letter, pool)?;
        }
        Ok(())
    });
    html! {
        figure.scale {
            (drawn)
            figcaption {
                "From the floor, the residual of a perfect model, to the span of the measurement. "
                "Filled: RMS. Short mark: 95th percentile. Hollow: maximum. Square: span."
            }
            @if let Some(other) = &comparison.other {
                (key(&[
                    (Swatch::Full, palette::FIRST, format!("A: {}", comparison.model)),
                    (Swatch::Full, palette::SECOND, format!("B: {}", other.model)),
                ]))
            }
        }
    }
}

/// Field of both models, then each force of both.
fn interleaved(comparison: &Comparison) -> Vec<(Role, &'static str, Pool)> {
    let of_model = |(role, letter, model): (Role, &'static str, &Comparison)| {
        let pools = pools(model).into_iter();
        pools.map(move |pool| (role, letter, pool))
    };
    let mut rows: Vec<_> = both(comparison).into_iter().flat_map(of_model).collect();
    let rank = |of: &str| {
        let first = ["Field", "Lateral force"];
        first.iter().position(|name| *name == of)
    };
    rows.sort_by_key(|(_, _, pool)| rank(pool.of).unwrap_or(2));
    rows
}

fn ticks(
    paper: &Paper,
    place: &impl Fn(f64) -> i32,
    most: f64,
    height: u32,
) -> Result<(), Failure> {
    let foot = px(f64::from(height - FOOT) + 4.0);
    paper.draw(&Rectangle::new(
        [(place(LEAST), px(4.0)), (place(1.0), foot)],
        palette::GRID.light.mix(0.6).filled(),
    ))?;
    let mut floors = 1.0;
    while floors <= 1.3 * most {
        let x = place(floors);
        paper.draw(&PathElement::new([(x, px(4.0)), (x, foot)], stroke(palette::GRID, 1.0)))?;
        let words = match floors {
            1.0 => "floor".to_owned(),
            _ => format!("{floors}\u{d7}"),
        };
        let at = (x, foot + px(10.0));
        paper.draw(&Text::new(words, at, centred(palette::INK, 1.0)))?;
        floors *= 10.0;
    }
    let middle = (px(f64::from(WIDTH) / 2.0), foot + px(27.0));
    let words = "error, in floors (logarithmic)";
    paper.draw(&Text::new(words, middle, centred(palette::MUTED, 1.0)))
}

fn row(
    paper: &Paper,
    place: &impl Fn(f64) -> i32,
    y: f64,
    role: Role,
    letter: &str,
    pool: &Pool,
) -> Result<(), Failure> {
    let y = px(y);
    let Some(rms) = pool.floors(pool.error.rms) else {
        let words = format!("{letter} {}: noise floor unknown", pool.of);
        return paper.draw(&Text::new(
            words,
            (place(1.0) + px(6.0), y),
            letters(palette::MUTED, 1.0),
        ));
    };
    let line = stroke(role, 2.0);
    let at = |size: f64| pool.floors(size).map(|floors| place(floors.max(LEAST)));
    let rms_x = place(rms.max(LEAST));
    if let Some(span) = at(pool.error.span) {
        let line = stroke(palette::MUTED, 1.0);
        paper.draw(&PathElement::new([(rms_x, y), (span, y)], line))?;
        let half = px(4.0);
        let corners = [(span - half, y - half), (span + half, y + half)];
        paper.draw(&Rectangle::new(corners, palette::MUTED.light.filled()))?;
    }
    if let Some(greatest) = at(pool.error.greatest) {
        paper.draw(&PathElement::new([(rms_x, y), (greatest, y)], line))?;
        paper.draw(&Circle::new((greatest, y), px(5.0), line))?;
    }
    if let Some(p95) = at(pool.error.p95) {
        let (half, reach) = (px(1.0), px(6.0));
        let corners = [(p95 - half, y - reach), (p95 + half, y + reach)];
        paper.draw(&Rectangle::new(corners, role.light.filled()))?;
    }
    paper.draw(&Circle::new((rms_x, y), px(5.5), role.light.filled()))?;
    let words = format!(
        "{letter} {}: RMS {} {} = {}\u{d7} floor",
        pool.of,
        number(pool.error.rms),
        pool.unit,
        number(rms)
    );
    let style = letters(palette::INK, 1.0).pos(Pos::new(HPos::Left, VPos::Bottom));
    paper.draw(&Text::new(words, (place(1.0) + px(6.0), y - px(7.0)), style))
}

/// All setup errors, or a note that there are none.
pub fn findings_section(comparison: &Comparison) -> Markup {
    let findings = &comparison.findings;
    html! {
        section #findings {
            @if findings.is_empty() {
                p.none { "Setup errors: none found." }
            } @else {
                h2 { "Found in the recordings: " (findings.len()) }
                ol.findings {
                    @for finding in findings {
                        li.stops[finding.stops] {
                            @if finding.stops { strong { "Prevents the comparison. " } }
                            (findings::message(finding))
                            span.place { (finding.place) }
                            @if let Some(fix) = &finding.fix {
                                span.fix { code { "--fix" } ": " (findings::fix(fix)) }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Provenance as name and value: version, files with hashes, seeds, assumptions.
fn provenance(comparison: &Comparison) -> Vec<(String, String)> {
    let mut list = vec![("tool", format!("magpie {}", env!("CARGO_PKG_VERSION")))];
    let Some(from) = &comparison.provenance else {
        return list.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    };
    let scale = from.sensor_scale;
    let effects = if from.effects.is_empty() { "none".to_owned() } else { from.effects.join(", ") };
    let assumed = if scale.assumed { " (assumed: not stated in the recordings)" } else { "" };
    list.extend([
        (
            "model",
            format!(
                "fitted to {} ({} recordings, {} rows) by {}",
                from.fitted_campaign, from.fitted_recordings, from.fitted_rows, from.fitted_by
            ),
        ),
        ("effects", effects),
        (
            "bands",
            format!("95 %, bootstrap of blocks of {:.1} s, seed {}", from.block_s, from.seed),
        ),
        (
            "sensor",
            format!("{} G per count, range {} G{assumed}", scale.gauss_per_lsb, scale.range_gauss),
        ),
    ]);
    let recordings = from.recordings.iter();
    let recordings =
        recordings.map(|(name, sha256)| (format!("recording {name}"), format!("sha256 {sha256}")));
    list.into_iter().map(|(name, value)| (name.to_owned(), value)).chain(recordings).collect()
}

/// Provenance, seeds and assumptions, of both models.
pub fn provenance_section(comparison: &Comparison) -> Markup {
    html! {
        section #origin {
            h2 { "Provenance" }
            @for (_, letter, model) in both(comparison) {
                @if comparison.other.is_some() { h3 { (letter) ": " (model.model) } }
                dl.origin {
                    @for (name, value) in provenance(model) { dt { (name) } dd { (value) } }
                }
            }
        }
    }
}

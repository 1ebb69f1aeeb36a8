//! Detection rate and false alarms of the magnetic-disturbance detector.

use maud::{Markup, html};
use plotters::prelude::*;

use crate::html::Section;
use crate::html::palette::{self, Role};
use crate::html::plot::{
    Along, AxisScale, Failure, Paper, Swatch, axes, centred, figure, key, px, stroke,
};
use crate::text::disturbance::summary;
use analysis::magnetic_disturbance::counts::{DetectionCounts, MEASURES, OperatingPoint, PER_S};
use analysis::magnetic_disturbance::event::MAX_LATENCY;
use analysis::numbers::decimal;

/// Size of the plot in pixels.
const SIZE: (u32, u32) = (660, 340);
/// Radius of a dot in pixels.
const DOT: f64 = 5.0;
/// Colours of the detector statistics.
const ROLES: [Role; 4] = [palette::FIRST, palette::SECOND, palette::THIRD, palette::MUTED];

/// Plot and summary; `of` describes the data.
pub fn section(tally: &DetectionCounts, of: &str) -> Section {
    let curves: Vec<Curve> = MEASURES
        .iter()
        .zip(ROLES)
        .enumerate()
        .map(|(measure, (name, role))| (*name, role, tally.characteristic(measure)))
        .filter(|(_, _, points)| !points.is_empty())
        .collect();
    let mut entries: Vec<_> = curves
        .iter()
        .map(|(name, role, _)| (Swatch::Line, *role, format!("{name} only")))
        .collect();
    entries.push((Swatch::Full, palette::INK, "device (majority vote)".to_owned()));
    let body = html! {
        p { (of) }
        p { (summary(tally).replace('`', "")) }
        @if tally.relevant_count() == 0 {
            p.empty { "No magnet changed a force by more than " (decimal(tally.alarm_error_n, 2)) " N: nothing to draw." }
        } @else {
            figure {
                figcaption { "Share of magnets detected within " (MAX_LATENCY) " ms of a force error of " (decimal(tally.alarm_error_n, 2)) " N versus "
                    "false alarms in ten hours, over the threshold of a single statistic" }
                (plot(tally, &curves))
                (key(&entries))
            }
            p.note { "At the left end no false alarm was observed, which does not prove that there are none. A statistic counts one "
                "false alarm for every second above its threshold." }
        }
    };
    Section { id: "foreign", heading: "Magnetic disturbance".to_owned(), body }
}

/// Statistic, colour, curve.
type Curve = (&'static str, Role, Vec<OperatingPoint>);

/// Position of a rate: decades above one alarm in the total time, which is one unit right of
/// zero alarms.
fn across(tally: &DetectionCounts, false_per_10h: f64) -> f64 {
    let alarms = false_per_10h * tally.seconds / PER_S;
    if alarms > 0.5 { 1.0 + alarms.log10() } else { 0.0 }
}

/// Lower end of the axis in percent.
fn from_percent(shares: impl Iterator<Item = f64>) -> f64 {
    let least = 100.0 * shares.fold(1.0, f64::min);
    let ends = [98.0, 95.0, 90.0, 80.0, 50.0];
    ends.into_iter().find(|end| least > *end).unwrap_or(0.0)
}

fn plot(tally: &DetectionCounts, curves: &[Curve]) -> Markup {
    let says = "Lines: share of magnets detected in time by each statistic versus its false alarms; \
                a square: the device.";
    figure(SIZE, says, |paper| draw(paper, tally, curves))
}

fn draw(paper: &Paper, tally: &DetectionCounts, curves: &[Curve]) -> Result<(), Failure> {
    let most = across(tally, PER_S);
    let along = Along { range: -0.3..most + 0.2, ..Along::things(1) };
    let shares = curves.iter().flat_map(|(_, _, points)| points);
    let from = from_percent(shares.map(|p| p.detected).chain(tally.detected()));
    let upwards = Along {
        words: "detected in time, %".to_owned(),
        range: from..100.0 + 0.04 * (100.0 - from),
        labels: 6,
        scale: AxisScale::Linear,
    };
    let mut chart = axes(paper, &along, &upwards)?;
    for (_, role, points) in curves {
        let points = points.iter().map(|p| (across(tally, p.false_per_10h), 100.0 * p.detected));
        chart.draw_series([PathElement::new(points.collect::<Vec<_>>(), stroke(*role, 2.0))])?;
    }
    if let Some(share) = tally.detected() {
        let (x, y) = chart.backend_coord(&(across(tally, tally.false_per_10h()), 100.0 * share));
        let corners = [(x - px(DOT), y - px(DOT)), (x + px(DOT), y + px(DOT))];
        paper.draw(&Rectangle::new(corners, palette::INK.light.filled()))?;
    }
    let labels = (0..=PER_S.log10() as i32).map(|decade| {
        let rate = 10.0_f64.powi(decade);
        (across(tally, rate), format!("{rate:.0}"))
    });
    let labels = labels.filter(|(at, _)| *at > 0.5);
    for (at, words) in std::iter::once((0.0, "none".to_owned())).chain(labels) {
        let (x, y) = chart.backend_coord(&(at, from));
        let place = (x, y + px(14.0));
        paper.draw(&Text::new(words, place, centred(palette::INK, 1.0)))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_logarithmic_and_shares_fill_the_height() {
        let mut tally = DetectionCounts::default();
        tally.seconds = 3600.0;
        // One per hour is ten in ten hours.
        assert_eq!(across(&tally, 0.0), 0.0);
        assert!((across(&tally, 10.0) - 1.0).abs() < 1e-12);
        assert!((across(&tally, 1000.0) - 3.0).abs() < 1e-12);
        let from = |shares: &[f64]| from_percent(shares.iter().copied());
        assert_eq!((from(&[1.0, 0.999]), from(&[0.96]), from(&[0.2, 1.0])), (98.0, 95.0, 0.0));
    }
}

//! How surely and how often in vain a foreign magnet is noticed.

use maud::{Markup, html};
use plotters::prelude::*;

use crate::foreign::passage::IN_TIME;
use crate::foreign::tally::{MEASURES, Operating, PER_S, Tally};
use crate::foreign::words::sentences;
use crate::report::Section;
use crate::report::palette::{self, Role};
use crate::report::plot::{Along, Failure, Paper, Swatch, axes, centred, figure, key, px, stroke};
use crate::show::plain;

/// Size of the plot, in pixels.
const SIZE: (u32, u32) = (660, 340);
/// Radius of a dot, in pixels.
const DOT: f64 = 5.0;
/// Colours of the measures.
const ROLES: [Role; 4] = [
    palette::FIRST,
    palette::SECOND,
    palette::THIRD,
    palette::MUTED,
];

/// Plot and sentences; `of` says what ran and where.
pub fn section(tally: &Tally, of: &str) -> Section {
    let curves: Vec<Curve> = MEASURES
        .iter()
        .zip(ROLES)
        .enumerate()
        .map(|(measure, (name, role))| (*name, role, tally.characteristic(measure)))
        .filter(|(_, _, points)| !points.is_empty())
        .collect();
    let mut entries: Vec<_> = curves
        .iter()
        .map(|(name, role, _)| (Swatch::Line, *role, format!("{name} alone")))
        .collect();
    entries.push((Swatch::Full, palette::INK, "the device's vote".to_owned()));
    let body = html! {
        p { (of) }
        p { (sentences(tally).replace('`', "")) }
        @if tally.judged() == 0 {
            p.empty { "No magnet moved a force by more than " (plain(tally.worth_n, 2)) " N: there is nothing to draw." }
        } @else {
            figure {
                figcaption { "Share of the magnets noticed within " (IN_TIME) " ms of a force that is off by " (plain(tally.worth_n, 2)) " N, against "
                    "false alarms in ten hours, as the threshold of one measure falls" }
                (plot(tally, &curves))
                (key(&entries))
            }
            p.note { "On the left no false alarm was counted, which is no proof that there is none. A measure counts a "
                "false alarm for every second in which it is above the threshold." }
        }
    };
    Section {
        id: "foreign",
        heading: "A foreign magnet".to_owned(),
        body,
    }
}

/// A measure, its colour, and its curve.
type Curve = (&'static str, Role, Vec<Operating>);

/// Where a rate stands: decades above one alarm in the whole time, which is one place to the right of
/// none at all.
fn across(tally: &Tally, false_per_10h: f64) -> f64 {
    let alarms = false_per_10h * tally.seconds / PER_S;
    match alarms > 0.5 {
        true => 1.0 + alarms.log10(),
        false => 0.0,
    }
}

/// From where the shares are drawn, in percent: so that what is missing shows.
fn from_percent(shares: impl Iterator<Item = f64>) -> f64 {
    let least = 100.0 * shares.fold(1.0, f64::min);
    let ends = [98.0, 95.0, 90.0, 80.0, 50.0];
    ends.into_iter().find(|end| least > *end).unwrap_or(0.0)
}

fn plot(tally: &Tally, curves: &[Curve]) -> Markup {
    let says = "Lines: the share of magnets noticed in time by each measure against its false alarms; \
                a square: what the device's vote does.";
    figure(SIZE, says, |paper| draw(paper, tally, curves))
}

fn draw(paper: &Paper, tally: &Tally, curves: &[Curve]) -> Result<(), Failure> {
    let most = across(tally, PER_S);
    let along = Along {
        range: -0.3..most + 0.2,
        ..Along::things(1)
    };
    let shares = curves.iter().flat_map(|(_, _, points)| points);
    let from = from_percent(shares.map(|p| p.noticed).chain(tally.detected()));
    let upwards = Along {
        words: "noticed in time, %".to_owned(),
        range: from..100.0 + 0.04 * (100.0 - from),
        labels: 6,
        powers: false,
    };
    let mut chart = axes(paper, &along, &upwards)?;
    for (_, role, points) in curves {
        let points = points
            .iter()
            .map(|p| (across(tally, p.false_per_10h), 100.0 * p.noticed));
        chart.draw_series([PathElement::new(
            points.collect::<Vec<_>>(),
            stroke(*role, 2.0),
        )])?;
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
    fn rates_stand_in_decades_beside_none_and_the_shares_fill_the_height() {
        let mut tally = Tally::default();
        tally.seconds = 3600.0;
        // One in an hour is ten in ten hours.
        assert_eq!(across(&tally, 0.0), 0.0);
        assert!((across(&tally, 10.0) - 1.0).abs() < 1e-12);
        assert!((across(&tally, 1000.0) - 3.0).abs() < 1e-12);
        let from = |shares: &[f64]| from_percent(shares.iter().copied());
        assert_eq!(
            (from(&[1.0, 0.999]), from(&[0.96]), from(&[0.2, 1.0])),
            (98.0, 95.0, 0.0)
        );
    }
}

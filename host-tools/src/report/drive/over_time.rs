//! Place, speed, current and voltage over time.

use maud::html;

use super::{Curve, curves};
use crate::drive::told::Told;
use crate::drive::trace::Point;
use crate::report::Section;
use crate::report::numbers::number;
use crate::report::palette::{self, Role};
use crate::report::plot::{Swatch, key};
use crate::report::tables::table;

/// One plot for each quantity, and the run's figures.
pub fn section(told: &Told) -> Section {
    let curve = |role: Role, of: &dyn Fn(&Point) -> f64| -> Curve {
        let points = told.run.points.iter();
        (
            role,
            points.map(|point| (point.time_s, of(point))).collect(),
        )
    };
    let asked: Vec<(f64, f64)> = told
        .run
        .points
        .iter()
        .filter_map(|point| Some((point.time_s, point.asked_mm?)))
        .collect();
    let mut places = vec![curve(palette::FIRST, &|point| point.opening_mm)];
    if !asked.is_empty() {
        places.insert(0, (palette::SECOND, asked));
    }
    let entry = |role: Role, words: &str| (Swatch::Line, role, words.to_owned());
    let rows = told.figures().into_iter().map(|(name, value, unit)| {
        vec![
            html! { (name) },
            html! { (number(value)) },
            html! { (unit) },
        ]
    });
    let time = "time in s";
    let body = html! {
        p { (told.sentence()) }
        div.pair {
            div {
                (curves("The opening over time, asked and reached.", (time, "opening, mm"), &places))
                (key(&[entry(palette::FIRST, "reached"), entry(palette::SECOND, "asked, on the way to a place")]))
            }
            (curves("The speed of closing over time.", (time, "closing, mm/s"),
                &[curve(palette::FIRST, &|point| point.closing_mm_s)]))
            (curves("The motor's currents over time.", (time, "current, A"), &[
                curve(palette::SECOND, &|point| point.current_a[0]),
                curve(palette::FIRST, &|point| point.current_a[1]),
            ]))
            div {
                (curves("The motor's voltages over time.", (time, "voltage, V"), &[
                    curve(palette::SECOND, &|point| point.voltage_v[0]),
                    curve(palette::FIRST, &|point| point.voltage_v[1]),
                ]))
                (key(&[entry(palette::FIRST, "quadrature: makes torque"), entry(palette::SECOND, "direct: makes none")]))
            }
            (curves("The bus voltage over time.", (time, "bus, V"),
                &[curve(palette::FIRST, &|point| point.bus_v)]))
        }
        (table("This run", &["figure", "", "unit"], rows))
        p.note { "Currents, speed and place are those of the simulated motor, not as it is sensed; voltages are what "
            "the control decided." }
    };
    Section {
        id: "run",
        heading: "The run".to_owned(),
        body,
    }
}

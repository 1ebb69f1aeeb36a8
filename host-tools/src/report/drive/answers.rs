//! The current loop's answers, and a step of the place.

use maud::html;

use super::curves;
use crate::drive::figures::STEP_MM;
use crate::drive::told::Told;
use crate::report::Section;
use crate::report::numbers::{maybe, number, percent};
use crate::report::palette;
use crate::report::plot::{Swatch, key};

/// Step and frequency response of the current loop.
pub fn current(told: &Told) -> Section {
    let step = told.step.points.iter();
    let step = step.map(|[time_s, share]| (1e3 * time_s, *share)).collect();
    let khz = |of: fn(&crate::drive::response::Tone) -> f64| {
        let tones = told.sweep.iter();
        tones
            .map(|tone| (1e-3 * tone.frequency_hz, of(tone)))
            .collect()
    };
    let body = html! {
        p { "With the rotor held: from 10 to 90 % in " (number(1e3 * told.step.rise_s())) " ms, "
            (percent(told.step.overshoot())) " beyond; the gain has fallen by 3 dB at "
            (maybe(told.bandwidth_hz())) " Hz. At least 1000 Hz and at most 10 % are asked." }
        div.pair {
            (curves("The current's answer to a step.", ("time in ms", "share of the step"), &[(palette::FIRST, step)]))
            (curves("The current's gain over frequency.", ("frequency in kHz", "gain, dB"),
                &[(palette::FIRST, khz(|tone| 20.0 * tone.gain.log10()))]))
            (curves("The current's lag over frequency.", ("frequency in kHz", "lag, degrees"),
                &[(palette::FIRST, khz(|tone| tone.lag_deg))]))
        }
        p.note { "The step goes from 1 to 4 A and is the mean of 16 with noise of their own; each frequency is a sine of "
            "1 A about 2.5 A, against what the control follows." }
    };
    Section {
        id: "current",
        heading: "The current loop".to_owned(),
        body,
    }
}

/// A step of the place, and how far it is off.
pub fn place(told: &Told) -> Section {
    let points = &told.place.points;
    let [from_mm, to_mm] = STEP_MM;
    let reached = points.iter().map(|p| (p.time_s, p.opening_mm)).collect();
    let asked = points.iter().filter_map(|p| Some((p.time_s, p.asked_mm?)));
    let off = points
        .iter()
        .filter_map(|p| Some((p.time_s, 1e3 * (p.opening_mm - p.asked_mm?))));
    let curve = |role, words: &str| (Swatch::Line, role, words.to_owned());
    let body = html! {
        p { "From " (number(from_mm)) " to " (number(to_mm)) " mm at the greatest speed, on a way bounded in speed, "
            "acceleration and jerk." }
        (key(&[curve(palette::FIRST, "reached"), curve(palette::SECOND, "asked")]))
        div.pair {
            (curves("The opening after a step of its set-point.", ("time in s", "opening, mm"),
                &[(palette::SECOND, asked.collect()), (palette::FIRST, reached)]))
            (curves("The opening minus what is asked.", ("time in s", "off, um"), &[(palette::FIRST, off.collect())]))
        }
    };
    Section {
        id: "place",
        heading: "A step of 10 mm".to_owned(),
        body,
    }
}

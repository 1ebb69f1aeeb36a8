//! Sections of a run of the drive.

use crate::html::Section;
use crate::html::palette::{self, Role};
use crate::html::plot::{Along, Curve, Swatch, curve_figure, key};
use crate::html::tables::{table, text_table};
use crate::text::grasp::motion_table;
use analysis::numbers;
use analysis::numbers::{maybe, number, percent};
use firmware::config::constants::Constant;
use maud::{Markup, html};
use sim::closed_loop::drive_result::DriveResult;
use sim::closed_loop::motor_rig::{MotorSample, POSITION_STEP_MM};

pub fn title(result: &DriveResult) -> String {
    format!("magpie: the drive with screw {:?}", result.case.lead)
}

pub fn sections(result: &DriveResult) -> Vec<Section> {
    vec![
        time_section(result),
        current_response(result),
        position_response(result),
        assumptions_section(&result.assumed()),
    ]
}

/// Curves over one axis.
pub(super) fn curves(says: &str, (across, upwards): (&str, &str), curves: &[Curve]) -> Markup {
    let all = || curves.iter().flat_map(|(_, points)| points);
    let across = Along::holding(across, all().map(|point| point.0));
    let upwards = Along::holding(upwards, all().map(|point| point.1));
    curve_figure(says, &across, &upwards, curves)
}

/// Step and frequency response of the current loop.
pub fn current_response(result: &DriveResult) -> Section {
    let step = result.step.points.iter();
    let step = step.map(|[time_s, share]| (1e3 * time_s, *share)).collect();
    let khz = |of: fn(&sim::closed_loop::frequency_response::FrequencyPoint) -> f64| {
        let tones = result.sweep.iter();
        tones.map(|tone| (1e-3 * tone.frequency_hz, of(tone))).collect()
    };
    let body = html! {
        p { "With a blocked rotor: rise time (10 to 90 %) " (number(1e3 * result.step.rise_s())) " ms, overshoot "
            (percent(result.step.overshoot())) "; -3 dB bandwidth "
            (maybe(result.bandwidth_hz())) " Hz. Specified: at least 1000 Hz and at most 10 %." }
        div.pair {
            (curves("Step response of the current.", ("time in ms", "share of the step"), &[(palette::FIRST, step)]))
            (curves("Gain of the current loop over frequency.", ("frequency in kHz", "gain, dB"),
                &[(palette::FIRST, khz(|tone| 20.0 * tone.gain.log10()))]))
            (curves("Phase lag of the current loop over frequency.", ("frequency in kHz", "lag, degrees"),
                &[(palette::FIRST, khz(|tone| tone.lag_deg))]))
        }
        p.note { "The step from 1 to 4 A is the mean of 16 runs with independent noise; each frequency is a sine of "
            "1 A around 2.5 A." }
    };
    Section { id: "current", heading: "Current loop".to_owned(), body }
}

pub fn position_response(result: &DriveResult) -> Section {
    let points = &result.position_step.points;
    let [from_mm, to_mm] = POSITION_STEP_MM;
    let reached = points.iter().map(|p| (p.time_s, p.opening_mm)).collect();
    let asked = points.iter().filter_map(|p| Some((p.time_s, p.setpoint_mm?)));
    let off = points.iter().filter_map(|p| Some((p.time_s, 1e3 * (p.opening_mm - p.setpoint_mm?))));
    let curve = |role, words: &str| (Swatch::Line, role, words.to_owned());
    let body = html! {
        p { "From " (number(from_mm)) " to " (number(to_mm)) " mm at maximum speed, on a trajectory limited in speed, "
            "acceleration and jerk." }
        (key(&[curve(palette::FIRST, "actual"), curve(palette::SECOND, "set-point")]))
        div.pair {
            (curves("Opening after a position step.", ("time in s", "opening, mm"),
                &[(palette::SECOND, asked.collect()), (palette::FIRST, reached)]))
            (curves("Tracking error of the opening.", ("time in s", "error, um"), &[(palette::FIRST, off.collect())]))
        }
    };
    Section { id: "place", heading: "Position step of 10 mm".to_owned(), body }
}

pub fn assumptions_section(assumed: &[Constant]) -> Section {
    let rows = assumed.iter().map(|constant| {
        let value = numbers::decimal(constant.value, 6);
        [constant.name, &value, constant.unit, constant.source].map(str::to_owned)
    });
    let body = html! {
        p { "No motor was available, and the paper specifies none. All results on this page are simulated and depend on these." }
        (table("Assumed", &["constant", "value", "unit", "reason"], rows))
        p.note { "Not modelled: current ripple within a PWM period, vibration of fingers and flexures, saturation of iron, "
            "heat, wear." }
    };
    Section { id: "assumed", heading: "Assumptions".to_owned(), body }
}

/// Plots of each quantity, and the results of the run.
pub fn time_section(result: &DriveResult) -> Section {
    let curve = |role: Role, of: &dyn Fn(&MotorSample) -> f64| -> Curve {
        let points = result.run.points.iter();
        (role, points.map(|point| (point.time_s, of(point))).collect())
    };
    let asked: Vec<(f64, f64)> = result
        .run
        .points
        .iter()
        .filter_map(|point| Some((point.time_s, point.setpoint_mm?)))
        .collect();
    let mut places = vec![curve(palette::FIRST, &|point| point.opening_mm)];
    if !asked.is_empty() {
        places.insert(0, (palette::SECOND, asked));
    }
    let entry = |role: Role, words: &str| (Swatch::Line, role, words.to_owned());
    let time = "time in s";
    let body = html! {
        p { (result.sentence()) }
        div.pair {
            div {
                (curves("Opening over time, set-point and actual.", (time, "opening, mm"), &places))
                (key(&[entry(palette::FIRST, "actual"), entry(palette::SECOND, "set-point, during a position move")]))
            }
            (curves("Closing speed over time.", (time, "closing, mm/s"),
                &[curve(palette::FIRST, &|point| point.closing_mm_s)]))
            (curves("Motor currents over time.", (time, "current, A"), &[
                curve(palette::SECOND, &|point| point.current_a[0]),
                curve(palette::FIRST, &|point| point.current_a[1]),
            ]))
            div {
                (curves("Motor voltages over time.", (time, "voltage, V"), &[
                    curve(palette::SECOND, &|point| point.voltage_v[0]),
                    curve(palette::FIRST, &|point| point.voltage_v[1]),
                ]))
                (key(&[entry(palette::FIRST, "quadrature (torque)"), entry(palette::SECOND, "direct")]))
            }
            (curves("Bus voltage over time.", (time, "bus, V"),
                &[curve(palette::FIRST, &|point| point.bus_v)]))
        }
        (text_table("Run", &motion_table(result)))
        p.note { "Currents, speed and position are those of the simulated motor, not measured values; voltages are the "
            "controller output." }
    };
    Section { id: "run", heading: "Run".to_owned(), body }
}

use super::*;
use crate::html::fixture::{assert_no_invalid_number, comparison, section};
use crate::html::page_with;
use crate::text::diagnosis_fixture::full;
use analysis::compare::{ErrorRows, ForceError};
use analysis::numbers::number;

fn page(diagnosis: &Diagnosis) -> String {
    page_with(&comparison(1, 4, 4.0), &sections(diagnosis))
}

#[test]
fn sections_are_between_the_summary_and_the_figures() {
    let page = page(&full());
    let places = ["scale", "diagnosis", "staircase", "found", "open", "errors"];
    let places = places.map(|id| page.find(&format!("<section id=\"{id}\"")).unwrap());
    assert!(places.is_sorted(), "{places:?}");
}

#[test]
fn each_step_has_a_large_plot_and_one_per_channel() {
    let page = page(&full());
    let found = section(&page, "found");
    // Two steps; two sensors of three axes each.
    assert_eq!(found.matches("<svg viewBox=\"0 0 1760").count(), 2);
    assert_eq!(found.matches("<svg viewBox=\"0 0 1360").count(), 12);
    assert!(found.contains("s3 y over the temperature"));
    assert!(found.contains("what magnet_temperature or sensor_temperature took away"));
    assert!(!found.contains("could not be drawn"));
}

#[test]
fn staircase_has_a_bar_with_its_height_per_step() {
    let page = page(&full());
    let stairs = section(&page, "staircase");
    assert_eq!(stairs.matches("role=\"img\"").count(), 1);
    for step in &full().staircase {
        let height = format!("{} G.", number(step.held_out_rms_g));
        assert!(stairs.contains(&height), "{height}");
    }
    assert!(stairs.contains("<th scope=\"row\">+ hysteresis</th>"));
    assert!(stairs.contains("RMS in G"));

    // With forces of every step: 0.5^2 - 0.4^2 = 0.3^2.
    let mut with_forces = full();
    let force = Some(ForceError::of_device(0.5, 0.4, ErrorRows::LeaveRecordingOut));
    with_forces.staircase.iter_mut().for_each(|step| step.force = force);
    let page = page_with(&comparison(1, 4, 4.0), &sections(&with_forces));
    let stairs = section(&page, "staircase");
    assert!(stairs.contains("excess in newtons") && stairs.contains("0.300 N"), "{stairs}");
}

#[test]
fn open_questions_suggest_recordings() {
    let page = page(&full());
    let open = section(&page, "open");
    assert!(open.contains("UNEXPLAINED: 84 % of the residual follows the rotor angle"));
    assert!(open.contains("To distinguish them, record, for magnet_temperature: Warm the gripper"));
    assert!(open.contains("<strong>earth_field</strong>: roll_rad was not recorded."));
}

#[test]
fn suggested_commands_are_escaped() {
    let page = page(&full());
    assert!(section(&page, "diagnosis").contains("'my &lt;b&gt;' hysteresis"));
    assert!(!page.contains("my <b>"));
}

#[test]
fn complete_model_has_no_found_section() {
    let clean = Diagnosis {
        at_floor: true,
        staircase: full().staircase[..1].to_vec(),
        ..Diagnosis::default()
    };
    let page = page(&clean);
    assert!(section(&page, "diagnosis").contains("AT NOISE FLOOR: the error of the field"));
    assert!(!page.contains("<section id=\"found\""));
    assert!(!page.contains("<section id=\"open\""));
}

#[test]
fn invalid_numbers_are_not_drawn() {
    let mut broken = full();
    broken.staircase[1].held_out_rms_g = f64::NAN;
    broken.staircase[0].floor_g = f64::INFINITY;
    broken.shapes[0].bins[0].centre = f64::NAN;
    broken.shapes[1].bins.clear();
    let page = page(&broken);
    for id in ["diagnosis", "staircase", "found"] {
        assert_no_invalid_number(section(&page, id));
    }
}

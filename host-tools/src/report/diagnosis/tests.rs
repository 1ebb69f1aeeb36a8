use std::path::Path;

use super::*;
use crate::diagnose::fixture::full;
use crate::report::fixture::comparison;
use crate::report::{page_with, write};

/// Where a browser's check wants a page.
const PAGE: &str = "MAGPIE_REPORT_PAGE";

fn page(diagnosis: &Diagnosis) -> String {
    page_with(&comparison(1, 4, 4.0), &sections(diagnosis))
}

/// A section of the page.
fn section<'a>(page: &'a str, id: &str) -> &'a str {
    let (_, rest) = page.split_once(&format!("<section id=\"{id}\">")).unwrap();
    rest.split_once("</section>").unwrap().0
}

#[test]
fn the_sections_stand_between_the_summary_and_the_figures() {
    let page = page(&full());
    let places = ["scale", "diagnosis", "staircase", "found", "open", "errors"];
    let places = places.map(|id| page.find(&format!("<section id=\"{id}\"")).unwrap());
    assert!(places.is_sorted(), "{places:?}");
}

#[test]
fn each_accepted_step_has_one_large_plot_and_a_small_one_for_each_channel() {
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
fn the_staircase_has_a_bar_for_each_stair_with_its_floors() {
    let page = page(&full());
    let stairs = section(&page, "staircase");
    assert_eq!(stairs.matches("role=\"img\"").count(), 1);
    for floors in ["24.0 x", "13.0 x", "1.45 x"] {
        assert!(stairs.contains(floors), "{floors}");
    }
    assert!(stairs.contains("2. + hysteresis"));
}

#[test]
fn what_stays_open_stands_with_what_would_help() {
    let page = page(&full());
    let open = section(&page, "open");
    assert!(open.contains("UNEXPLAINED: 84 % of what is left follows the rotor angle"));
    assert!(open.contains("To tell, record, for magnet_temperature: Let it warm"));
    assert!(open.contains("<strong>earth_field</strong>: roll_rad was not recorded."));
}

#[test]
fn what_to_type_is_shown_and_is_never_markup() {
    let page = page(&full());
    assert!(section(&page, "diagnosis").contains("'my &lt;b&gt;' hysteresis"));
    assert!(!page.contains("my <b>"));
}

#[test]
fn where_nothing_is_missing_nothing_is_shown_as_found() {
    let clean = Diagnosis {
        at_floor: true,
        staircase: full().staircase[..1].to_vec(),
        ..Diagnosis::default()
    };
    let page = page(&clean);
    assert!(section(&page, "diagnosis").contains("AT NOISE FLOOR: what is left"));
    assert!(!page.contains("<section id=\"found\""));
    assert!(!page.contains("<section id=\"open\""));
}

#[test]
fn what_is_no_number_is_nowhere_drawn() {
    let mut broken = full();
    broken.staircase[1].held_out_rms_g = f64::NAN;
    broken.staircase[0].floor_g = f64::INFINITY;
    broken.shapes[0].bins[0].centre = f64::NAN;
    broken.shapes[1].bins.clear();
    let page = page(&broken);
    for id in ["diagnosis", "staircase", "found"] {
        let section = section(&page, id);
        for word in ["NaN", "inf,", "inf ", "\"inf", "-2147483648", "2147483647"] {
            assert!(!section.contains(word), "{word} in {id}");
        }
    }
}

#[test]
fn a_page_to_look_at_is_left_where_it_is_wanted() {
    if let Ok(path) = std::env::var(PAGE) {
        let path = Path::new(&path).with_extension("diagnosis.html");
        write(&path, &comparison(1, 4, 4.0), &sections(&full())).unwrap();
    }
}

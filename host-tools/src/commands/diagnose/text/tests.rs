use super::*;
use crate::diagnose::fixture::full;

/// The page without its colours.
fn plain(diagnosis: &Diagnosis) -> String {
    anstream::adapter::strip_str(&text(diagnosis)).to_string()
}

fn said(page: &str) -> String {
    page.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn no_line_but_a_command_is_wider_than_a_terminal_as_it_opens() {
    let page = plain(&full());
    for line in page.lines().filter(|line| !line.contains("magpie add")) {
        assert!(line.chars().count() <= 80, "{line}");
    }
}

#[test]
fn every_row_of_the_table_is_one_line() {
    let page = plain(&full());
    let table: Vec<&str> = page
        .lines()
        .skip_while(|line| !line.starts_with('─'))
        .skip(1)
        .take_while(|line| !line.starts_with('─'))
        .collect();
    assert_eq!(table.len(), 9, "{table:#?}");
    assert!(table[8].contains("ABSENT") && table[8].contains("< 0.08 of typical"));
}

#[test]
fn a_tie_says_what_to_record_for_each_of_its_members() {
    let page = said(&plain(&full()));
    assert!(page.contains("Not told apart: magnet_temperature, sensor_temperature"));
    assert!(page.contains("To tell, record, for magnet_temperature: Let it warm by 10 K"));
    assert!(page.contains("To tell, record, for sensor_temperature: Warm and cool the unloaded"));
}

#[test]
fn what_is_not_judgeable_is_said_reason_by_reason() {
    let page = said(&plain(&full()));
    assert!(page.contains(
        "tip_slope, geometric_stiffening: typical is too small. To judge, record: Load each flexure"
    ));
    assert!(
        page.contains(
            "earth_field: roll_rad was not recorded. To judge, record: Turn the unloaded"
        )
    );
    assert!(page.contains("thermal_gap: it moves or changes the magnet"));
}

#[test]
fn what_is_unexplained_is_said_with_the_way_to_a_formula() {
    let mut diagnosis = full();
    let page = said(&plain(&diagnosis));
    assert!(
        page.contains(
            "UNEXPLAINED: 84 % of what is left follows the rotor angle (motor_angle_rad)"
        )
    );
    assert!(page.contains("--expr"));
    assert!(!page.contains("AT NOISE FLOOR"));
    diagnosis.at_floor = true;
    let page = said(&plain(&diagnosis));
    assert!(page.contains("AT NOISE FLOOR with what was found"));
    assert!(!page.contains("UNEXPLAINED"));
}

#[test]
fn a_found_effect_has_its_value_beside_the_typical_one_and_its_physics() {
    let page = said(&plain(&full()));
    let at = page
        .find("hysteresis: 7.982±0.010 N, friction force")
        .unwrap();
    assert!(page[at..].contains("typical is 2.5 N Where the finger rubs on a guide"));
    assert!(page.contains("It takes away 99.4 %."));
}

#[test]
fn the_last_thing_said_is_what_to_type() {
    let page = plain(&full());
    assert!(page.ends_with("\n  magpie add model.toml 'my <b>' hysteresis -o new.toml\n"));
}

#[test]
fn a_provisional_name_has_a_question_mark_that_is_explained() {
    let mut diagnosis = full();
    diagnosis.verdicts[0].provisional = true;
    let page = plain(&diagnosis);
    assert!(page.contains(" FOUND? "));
    assert!(page.contains("A question mark: provisional"));
    assert!(!plain(&full()).contains("A question mark"));
}

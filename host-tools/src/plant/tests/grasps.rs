//! Screw, fingers and object.

use std::f64::consts::FRAC_PI_2;

use firmware::motor::stage::Drive;
use firmware::params;

use super::source::{drive_until, hold};
use crate::plant::Plant;
use crate::plant::object::Object;
use crate::plant::parameters::{Lead, Parameters};

const RIGID: f64 = 1000.0;

/// Squeezed up to a current that rises ever more slowly, so that nothing swings on.
fn squeezed(parameters: Parameters, current_a: f64) -> Plant {
    let mut plant = Plant::new(parameters, 0.04, 1);
    plant.hold(Some(&Object::new(0.04, RIGID)));
    let ramp = |time_s: f64| current_a * (time_s.min(1.0) * FRAC_PI_2).sin();
    drive_until(&mut plant, ramp, |plant| plant.time_s() > 1.2);
    plant
}

#[test]
fn rated_torque_is_350_n_with_either_screw() {
    for lead in Lead::BOTH {
        let rated_a = params::RATED_TORQUE.value / params::TORQUE_CONSTANT.value;
        let plain = squeezed(Parameters::plain(lead), rated_a).grip_n();
        assert!((plain / 350.0 - 1.0).abs() < 0.01, "{lead:?}: {plain}");
        let nominal = squeezed(Parameters::nominal(lead), rated_a).grip_n();
        assert!((nominal / 350.0 - 1.0).abs() < 0.03, "{lead:?}: {nominal}");
    }
}

#[test]
fn without_current_screw_a_keeps_its_grip_and_screw_b_drops_it() {
    for (lead, keeps) in [(Lead::A, true), (Lead::B, false)] {
        let mut plant = squeezed(Parameters::nominal(lead), 2.0);
        let before_n = plant.grip_n();
        hold(&mut plant, Drive::Off, 0.5);
        let after_n = plant.grip_n();
        assert!(before_n > 80.0, "{lead:?}: {before_n}");
        match keeps {
            true => assert!(after_n > 0.97 * before_n, "{after_n} of {before_n}"),
            false => assert!(after_n < 0.3 * before_n, "{after_n} of {before_n}"),
        }
    }
}

#[test]
fn screw_b_holds_350_n_with_less_than_a_third_of_what_brought_it() {
    let mut plant = squeezed(Parameters::plain(Lead::B), 5.8);
    // F r (1 - f) - Tc = 0.358 * 0.435 - 0.02 = 0.136 N m.
    drive_until(&mut plant, |_| 1.4, |plant| plant.time_s() > 1.4);
    assert!((plant.grip_n() - 350.0).abs() < 5.0, "{}", plant.grip_n());
    drive_until(&mut plant, |_| 1.25, |plant| plant.time_s() > 1.8);
    assert!(plant.grip_n() < 345.0, "{}", plant.grip_n());
}

#[test]
fn without_friction_a_rotor_swings_against_an_object_at_12_hz() {
    let mut parameters = Parameters::plain(Lead::B);
    parameters.rotor.dry.breakaway_nm = 0.0;
    parameters.rotor.dry.dry_nm = 0.0;
    parameters.rotor.viscous_nm_s = 0.0;
    parameters.screw.friction = 0.0;
    let mut plant = Plant::new(parameters, 0.04, 1);
    plant.hold(Some(&Object {
        damping_ns_per_m: 0.0,
        ..Object::new(0.04, RIGID)
    }));
    plant.train.speed_rad_s = 10.0;
    plant.train.travel_m_s = 10.0 * Lead::B.travel_m_per_rad();
    let mut touching_s = 0.0;
    while plant.train.speed_rad_s > 0.0 || plant.grip_n() > 0.0 {
        hold(&mut plant, Drive::Off, 50e-6);
        touching_s += 50e-6;
        assert!(touching_s < 0.1);
    }
    // Half a swing: pi sqrt(J / (r^2 k)), the screw's give in series with 333 N/mm.
    let stiffness = 1.0 / (3e-6 + 1.0 / 20e6);
    let half_s = std::f64::consts::PI / (1.0228e-3 * f64::sqrt(stiffness / 6e-5));
    assert!(
        (touching_s / half_s - 1.0).abs() < 0.01,
        "{touching_s} {half_s}"
    );
}

#[test]
fn the_fingers_wait_while_the_screw_turns_through_the_play() {
    let mut plant = Plant::new(Parameters::nominal(Lead::A), 0.04, 1);
    let (angle_rad, travel_m) = (plant.train.angle_rad, plant.train.travel_m);
    let moved = |plant: &Plant| (plant.train.travel_m - travel_m).abs() > 1e-6;
    assert!(drive_until(&mut plant, |_| -1.0, moved));
    let lost_m = (angle_rad - plant.train.angle_rad) * Lead::A.travel_m_per_rad();
    assert!((lost_m - 31e-6).abs() < 2e-6, "{lost_m}");
}

#[test]
fn fingers_stop_at_both_ends_of_their_travel() {
    for (start_m, current_a) in [(0.001, 1.0), (0.079, -1.0)] {
        let mut plant = Plant::new(Parameters::nominal(Lead::B), start_m, 1);
        drive_until(&mut plant, |_| current_a, |plant| plant.time_s() > 0.5);
        let opening_m = plant.opening_m();
        let end_m = if current_a > 0.0 { 0.0 } else { 0.08 };
        assert!(plant.train.speed_rad_s.abs() < 0.1);
        assert!((opening_m - end_m).abs() < 0.6e-3, "{opening_m}");
    }
}

#[test]
fn closing_at_rated_speed_is_the_paper_s_58_3_mm_s() {
    for (lead, per_finger) in [(Lead::A, 1.0), (Lead::B, 0.5)] {
        let mut plant = Plant::new(Parameters::nominal(lead), 0.08, 1);
        let fast = |plant: &Plant| plant.train.speed_rad_s >= params::RATED_SPEED.value;
        assert!(drive_until(&mut plant, |_| 3.0, fast));
        let stated_mm_s = 1e3 * plant.train.travel_m_s * per_finger;
        assert!(
            (stated_mm_s / 58.3 - 1.0).abs() < 0.03,
            "{lead:?}: {stated_mm_s}"
        );
    }
}

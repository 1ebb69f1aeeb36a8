//! The rotor and its windings.

use std::f64::consts::TAU;

use firmware::motor::stage::Drive;
use firmware::params;

use super::source::{current, hold, voltage};
use crate::plant::parameters::{Lead, Parameters};
use crate::plant::{PERIOD_S, Plant};

const RATED_RAD_S: f64 = params::RATED_SPEED.value;

fn open(lead: Lead) -> Plant {
    Plant::new(Parameters::plain(lead), 0.08, 1)
}

fn spinning(lead: Lead, speed_rad_s: f64) -> Plant {
    let mut plant = open(lead);
    plant.train.speed_rad_s = speed_rad_s;
    plant.train.travel_m_s = speed_rad_s * lead.travel_m_per_rad();
    plant
}

/// Currents of the phases for a quadrature current.
fn phases_of(plant: &Plant, quadrature_a: f64) -> [f64; 3] {
    let electrical_rad = plant.parameters().windings.pole_pairs * plant.train.angle_rad;
    [0.0, 1.0, 2.0].map(|phase: f64| -quadrature_a * (electrical_rad - phase * TAU / 3.0).sin())
}

#[test]
fn free_speed_is_where_back_emf_and_resistance_take_the_whole_voltage() {
    let mut plant = open(Lead::A);
    for _ in 0..8000 {
        let [_, quadrature] = plant.direct_quadrature_a();
        let windings = plant.parameters().windings;
        let reactance = windings.pole_pairs * plant.train.speed_rad_s * windings.inductance_h;
        let drive = voltage(&plant, -reactance * quadrature, 8.0);
        plant.step(drive);
    }
    // 8 V = 0.4 ohm * i + w / 15, 0.1 N m/A * i = 0.02 + 1e-4 w: w = 118.09 rad/s.
    let speed = plant.train.speed_rad_s;
    assert!((speed - 118.09).abs() < 0.2, "{speed}");
}

#[test]
fn a_rotor_left_alone_coasts_14_3_rad() {
    let mut plant = spinning(Lead::A, RATED_RAD_S);
    let start_rad = plant.train.angle_rad;
    hold(&mut plant, Drive::Off, 0.5);
    // J/B (w - Tc/B ln(1 + B w/Tc)) = 0.6 (114 - 200 ln 1.57).
    let coasted_rad = plant.train.angle_rad - start_rad;
    assert_eq!(plant.train.speed_rad_s, 0.0);
    let expected_rad = 0.6 * (114.0 - 200.0 * 1.57_f64.ln());
    assert!(
        (coasted_rad / expected_rad - 1.0).abs() < 2e-3,
        "{coasted_rad}"
    );
}

#[test]
fn a_braked_rotor_s_current_peaks_at_11_6_a() {
    let mut plant = spinning(Lead::A, RATED_RAD_S);
    let mut peak_a = 0.0_f64;
    for _ in 0..200 {
        plant.step(Drive::Brake);
        let [_, quadrature] = plant.direct_quadrature_a();
        peak_a = peak_a.max(-quadrature);
    }
    // Shorted at this speed for ever it would be 7.6 V * R / (R^2 + (we L)^2) = 11.6 A; the transient
    // overshoots by a little and the speed falls meanwhile.
    assert!((peak_a / 11.6 - 1.0).abs() < 0.05, "{peak_a}");
}

#[test]
fn braking_at_9_6_a_returns_95_mj_and_raises_the_bus_to_31_3_v() {
    let mut plant = spinning(Lead::A, RATED_RAD_S);
    // The current flows already: what its inductance takes is not in the case.
    plant.motor.currents_a = phases_of(&plant, -9.6);
    let mut peak_v = 0.0_f64;
    while plant.train.speed_rad_s > 1.0 && plant.time_s() < 0.1 {
        let drive = current(&plant, -9.6);
        plant.step(drive);
        peak_v = peak_v.max(plant.bus.voltage_v);
    }
    // The windings take 55 W: what is left of 109 W is returned until half the speed is gone, and drawn
    // again after that.
    assert!(
        (plant.time_s() - 7.1e-3).abs() < 0.5e-3,
        "{}",
        plant.time_s()
    );
    assert!((peak_v - 31.3).abs() < 0.3, "{peak_v}");
}

#[test]
fn a_current_of_10_a_dies_out_through_the_diodes_within_a_quarter_of_a_millisecond() {
    let mut plant = open(Lead::A);
    // Phase U ahead of the star by (24.8 + 0.8) * 2/3 = 17.1 V: 10 A / (17.1 V / 0.4 mH) = 0.23 ms
    // at the most, since the resistance helps.
    plant.motor.currents_a = [10.0, -5.0, -5.0];
    hold(&mut plant, Drive::Off, 0.15e-3);
    assert!(
        plant.motor.currents_a[0] > 1.0,
        "{:?}",
        plant.motor.currents_a
    );
    hold(&mut plant, Drive::Off, 0.1e-3);
    assert_eq!(plant.motor.currents_a, [0.0; 3]);
    assert!(plant.bus.voltage_v > 24.0);
}

#[test]
fn with_all_switches_off_only_a_rotor_faster_than_the_bus_charges_it() {
    // From line to line 34.6 V at 300 rad/s, 23.1 V at 200.
    let mut slow = spinning(Lead::A, 200.0);
    hold(&mut slow, Drive::Off, 1e-3);
    assert_eq!(
        (slow.motor.currents_a, slow.bus.voltage_v),
        ([0.0; 3], 24.0)
    );
    let mut fast = spinning(Lead::A, 300.0);
    hold(&mut fast, Drive::Off, 5e-3);
    let sum: f64 = fast.motor.currents_a.iter().sum();
    assert!(
        fast.bus.voltage_v > 26.0 && sum.abs() < 1e-9,
        "{}",
        fast.bus.voltage_v
    );
}

#[test]
fn an_ampere_of_quadrature_current_is_a_tenth_of_a_newton_metre() {
    let mut plant = open(Lead::A);
    plant.train.angle_rad += 1.0;
    // Against the end of the travel it stays where it is.
    let mut parameters = *plant.parameters();
    parameters.rotor.dry.breakaway_nm = 10.0;
    parameters.rotor.dry.dry_nm = 10.0;
    let mut plant = Plant::new(parameters, 0.08, 1);
    for _ in 0..400 {
        let drive = current(&plant, 4.0);
        plant.step(drive);
    }
    let [direct, quadrature] = plant.direct_quadrature_a();
    assert!(
        direct.abs() < 0.05 && (quadrature - 4.0).abs() < 0.05,
        "{direct} {quadrature}"
    );
    assert!((parameters.windings.torque_constant() - 0.1).abs() < 1e-12);
}

#[test]
fn a_step_of_voltage_brings_current_by_its_time_constant() {
    let mut parameters = Parameters::plain(Lead::A);
    parameters.rotor.inertia_kg_m2 = 1e3;
    let mut plant = Plant::new(parameters, 0.08, 1);
    let drive = voltage(&plant, 2.0, 0.0);
    hold(&mut plant, drive, 1e-3);
    // 5 A (1 - 1/e) after L/R = 1 ms; half a per cent is what the bus gives way.
    let [direct, _] = plant.direct_quadrature_a();
    assert!(
        (direct / (5.0 * (1.0 - (-1.0_f64).exp())) - 1.0).abs() < 0.01,
        "{direct}"
    );
}

#[test]
fn swapped_phases_turn_the_other_way() {
    let turned = |swapped| {
        let parameters = Parameters {
            swapped,
            ..Parameters::plain(Lead::A)
        };
        let mut plant = Plant::new(parameters, 0.04, 1);
        let start_rad = plant.train.angle_rad;
        // A field that turns slowly pulls the rotor along.
        for period in 0..20_000 {
            let angle = TAU * 5.0 * f64::from(period) * PERIOD_S;
            let duties = [0.0, 1.0, 2.0]
                .map(|phase: f64| (0.5 + 0.1 * (angle - phase * TAU / 3.0).cos()) as f32);
            plant.step(Drive::Duty(duties));
        }
        plant.train.angle_rad - start_rad
    };
    // Five electrical turns are five sevenths of one, give or take where it began.
    let (right, wrong) = (turned(false), turned(true));
    let turn = TAU * 5.0 / 7.0;
    assert!(
        (right - turn).abs() < 0.5 && (wrong + turn).abs() < 0.5,
        "{right} {wrong}"
    );
}

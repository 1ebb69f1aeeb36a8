//! The drivetrain against cases that can be solved by hand, and against an earlier study.

use crate::drivetrain::mechanics::Object;
use crate::drivetrain::parameters::{Lead, PlantParameters};
use crate::drivetrain::{PERIOD_S, Plant};
use firmware::config::constants;
use firmware::motor::power_stage::BridgeCommand;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Duties for voltages on d and q in V.
pub fn voltage(plant: &Plant, direct_v: f64, quadrature_v: f64) -> BridgeCommand {
    let windings = plant.parameters().windings;
    // Angle in the middle of the next period.
    let rotor = &plant.train;
    let middle_rad = rotor.angle_rad + 0.5 * PERIOD_S * rotor.speed_rad_s;
    let electrical_rad = windings.pole_pairs * (middle_rad - plant.parameters().zero_rad);
    BridgeCommand::Duty([0.0, 1.0, 2.0].map(|phase: f64| {
        let (sin, cos) = (electrical_rad - phase * std::f64::consts::TAU / 3.0).sin_cos();
        let volts = direct_v * cos - quadrature_v * sin;
        (0.5 + volts / plant.bus.voltage_v) as f32
    }))
}

/// Duties for a quadrature current at the end of the next period, within the bus voltage, without direct
/// current.
pub fn current(plant: &Plant, quadrature_a: f64) -> BridgeCommand {
    let windings = plant.parameters().windings;
    let [direct, quadrature] = plant.direct_quadrature_a();
    let turning = windings.pole_pairs * plant.train.speed_rad_s;
    let reactance = turning * windings.inductance_h;
    // Half of the deadbeat gain: the mean of the period counts.
    let gain = 0.5 * windings.inductance_h / PERIOD_S;
    let direct_v = -reactance * quadrature_a - gain * direct;
    let quadrature_v = windings.resistance_ohm * quadrature_a
        + turning * windings.flux_wb
        + gain * (quadrature_a - quadrature);
    voltage(plant, direct_v, quadrature_v)
}

/// Runs with a current source until `done`; false after two seconds.
pub fn drive_until(
    plant: &mut Plant,
    current_a: impl Fn(f64) -> f64,
    done: impl Fn(&Plant) -> bool,
) -> bool {
    let start_s = plant.time_s();
    while plant.time_s() - start_s < 2.0 {
        if done(plant) {
            return true;
        }
        let drive = current(plant, current_a(plant.time_s() - start_s));
        plant.step(drive);
    }
    false
}

/// Runs with one drive state.
pub fn run_drive(plant: &mut Plant, drive: BridgeCommand, seconds: f64) {
    let periods = (seconds / PERIOD_S).round() as u32;
    for _ in 0..periods {
        plant.step(drive);
    }
}

const RATED_RAD_S: f64 = constants::RATED_SPEED.value;

fn open(lead: Lead) -> Plant {
    Plant::new(PlantParameters::simplified(lead), 0.08, 1)
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
fn free_speed_balances_back_emf_and_resistance() {
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
fn undriven_rotor_coasts_14_3_rad() {
    let mut plant = spinning(Lead::A, RATED_RAD_S);
    let start_rad = plant.train.angle_rad;
    run_drive(&mut plant, BridgeCommand::Off, 0.5);
    // J/B (w - Tc/B ln(1 + B w/Tc)) = 0.6 (114 - 200 ln 1.57).
    let coasted_rad = plant.train.angle_rad - start_rad;
    assert_eq!(plant.train.speed_rad_s, 0.0);
    let expected_rad = 0.6 * (114.0 - 200.0 * 1.57_f64.ln());
    assert!((coasted_rad / expected_rad - 1.0).abs() < 2e-3, "{coasted_rad}");
}

#[test]
fn shorted_windings_current_peaks_at_11_6_a() {
    let mut plant = spinning(Lead::A, RATED_RAD_S);
    let mut peak_a = 0.0_f64;
    for _ in 0..200 {
        plant.step(BridgeCommand::Brake);
        let [_, quadrature] = plant.direct_quadrature_a();
        peak_a = peak_a.max(-quadrature);
    }
    // Steady state at this speed is 7.6 V * R / (R^2 + (we L)^2) = 11.6 A; the transient
    // overshoots by a little and the speed falls meanwhile.
    assert!((peak_a / 11.6 - 1.0).abs() < 0.05, "{peak_a}");
}

#[test]
fn regeneration_at_9_6_a_raises_the_bus_to_31_3_v() {
    let mut plant = spinning(Lead::A, RATED_RAD_S);
    // Start with the current, to exclude the energy of the inductance.
    plant.motor.currents_a = phases_of(&plant, -9.6);
    let mut peak_v = 0.0_f64;
    while plant.train.speed_rad_s > 1.0 && plant.time_s() < 0.1 {
        let drive = current(&plant, -9.6);
        plant.step(drive);
        peak_v = peak_v.max(plant.bus.voltage_v);
    }
    // Copper loss is 55 W: the rest of 109 W is regenerated until half of the speed, then current is drawn
    // from the bus.
    assert!((plant.time_s() - 7.1e-3).abs() < 0.5e-3, "{}", plant.time_s());
    assert!((peak_v - 31.3).abs() < 0.3, "{peak_v}");
}

#[test]
fn diode_current_of_10_a_decays_within_0_25_ms() {
    let mut plant = open(Lead::A);
    // Phase U ahead of the star by (24.8 + 0.8) * 2/3 = 17.1 V: 10 A / (17.1 V / 0.4 mH) = 0.23 ms
    // at the most, since the resistance helps.
    plant.motor.currents_a = [10.0, -5.0, -5.0];
    run_drive(&mut plant, BridgeCommand::Off, 0.15e-3);
    assert!(plant.motor.currents_a[0] > 1.0, "{:?}", plant.motor.currents_a);
    run_drive(&mut plant, BridgeCommand::Off, 0.1e-3);
    assert_eq!(plant.motor.currents_a, [0.0; 3]);
    assert!(plant.bus.voltage_v > 24.0);
}

#[test]
fn freewheeling_charges_the_bus_above_its_back_emf_only() {
    // From line to line 34.6 V at 300 rad/s, 23.1 V at 200.
    let mut slow = spinning(Lead::A, 200.0);
    run_drive(&mut slow, BridgeCommand::Off, 1e-3);
    assert_eq!((slow.motor.currents_a, slow.bus.voltage_v), ([0.0; 3], 24.0));
    let mut fast = spinning(Lead::A, 300.0);
    run_drive(&mut fast, BridgeCommand::Off, 5e-3);
    let sum: f64 = fast.motor.currents_a.iter().sum();
    assert!(fast.bus.voltage_v > 26.0 && sum.abs() < 1e-9, "{}", fast.bus.voltage_v);
}

#[test]
fn torque_constant_is_0_1_nm_per_a() {
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
    assert!(direct.abs() < 0.05 && (quadrature - 4.0).abs() < 0.05, "{direct} {quadrature}");
    assert!((parameters.windings.torque_constant() - 0.1).abs() < 1e-12);
}

#[test]
fn voltage_step_response_has_the_electrical_time_constant() {
    let mut parameters = PlantParameters::simplified(Lead::A);
    parameters.rotor.inertia_kg_m2 = 1e3;
    let mut plant = Plant::new(parameters, 0.08, 1);
    let drive = voltage(&plant, 2.0, 0.0);
    run_drive(&mut plant, drive, 1e-3);
    // 5 A (1 - 1/e) after L/R = 1 ms; half a per cent is what the bus gives way.
    let [direct, _] = plant.direct_quadrature_a();
    assert!((direct / (5.0 * (1.0 - (-1.0_f64).exp())) - 1.0).abs() < 0.01, "{direct}");
}

#[test]
fn swapped_phases_reverse_the_rotation() {
    let turned = |swapped| {
        let parameters = PlantParameters { swapped, ..PlantParameters::simplified(Lead::A) };
        let mut plant = Plant::new(parameters, 0.04, 1);
        let start_rad = plant.train.angle_rad;
        // A field that turns slowly pulls the rotor along.
        for period in 0..20_000 {
            let angle = TAU * 5.0 * f64::from(period) * PERIOD_S;
            let duties = [0.0, 1.0, 2.0]
                .map(|phase: f64| (0.5 + 0.1 * (angle - phase * TAU / 3.0).cos()) as f32);
            plant.step(BridgeCommand::Duty(duties));
        }
        plant.train.angle_rad - start_rad
    };
    // Five electrical turns are five sevenths of one, give or take where it began.
    let (right, wrong) = (turned(false), turned(true));
    let turn = TAU * 5.0 / 7.0;
    assert!((right - turn).abs() < 0.5 && (wrong + turn).abs() < 0.5, "{right} {wrong}");
}

const RIGID: f64 = 1000.0;

/// Grip with a smoothly rising current, without oscillation.
fn gripped(parameters: PlantParameters, current_a: f64) -> Plant {
    let mut plant = Plant::new(parameters, 0.04, 1);
    plant.set_object(Some(&Object::new(0.04, RIGID)));
    let ramp = |time_s: f64| current_a * (time_s.min(1.0) * FRAC_PI_2).sin();
    drive_until(&mut plant, ramp, |plant| plant.time_s() > 1.2);
    plant
}

#[test]
fn rated_torque_gives_350_n_with_either_screw() {
    for lead in Lead::BOTH {
        let rated_a = constants::RATED_TORQUE.value / constants::TORQUE_CONSTANT.value;
        let simplified = gripped(PlantParameters::simplified(lead), rated_a).grip_n();
        assert!((simplified / 350.0 - 1.0).abs() < 0.01, "{lead:?}: {simplified}");
        let nominal = gripped(PlantParameters::nominal(lead), rated_a).grip_n();
        assert!((nominal / 350.0 - 1.0).abs() < 0.03, "{lead:?}: {nominal}");
    }
}

#[test]
fn only_screw_a_maintains_the_grip_without_current() {
    for (lead, is_self_locking) in [(Lead::A, true), (Lead::B, false)] {
        let mut plant = gripped(PlantParameters::nominal(lead), 2.0);
        let before_n = plant.grip_n();
        run_drive(&mut plant, BridgeCommand::Off, 0.5);
        let after_n = plant.grip_n();
        assert!(before_n > 80.0, "{lead:?}: {before_n}");
        if is_self_locking {
            assert!(after_n > 0.97 * before_n, "{after_n} of {before_n}");
        } else {
            assert!(after_n < 0.3 * before_n, "{after_n} of {before_n}");
        }
    }
}

#[test]
fn screw_b_holds_350_n_with_a_third_of_the_current() {
    let mut plant = gripped(PlantParameters::simplified(Lead::B), 5.8);
    // F r (1 - f) - Tc = 0.358 * 0.435 - 0.02 = 0.136 N m.
    drive_until(&mut plant, |_| 1.4, |plant| plant.time_s() > 1.4);
    assert!((plant.grip_n() - 350.0).abs() < 5.0, "{}", plant.grip_n());
    drive_until(&mut plant, |_| 1.25, |plant| plant.time_s() > 1.8);
    assert!(plant.grip_n() < 345.0, "{}", plant.grip_n());
}

#[test]
fn frictionless_contact_oscillates_at_12_hz() {
    let mut parameters = PlantParameters::simplified(Lead::B);
    parameters.rotor.dry.breakaway_nm = 0.0;
    parameters.rotor.dry.dry_nm = 0.0;
    parameters.rotor.viscous_nm_s = 0.0;
    parameters.screw.friction = 0.0;
    let mut plant = Plant::new(parameters, 0.04, 1);
    plant.set_object(Some(&Object { damping_ns_per_m: 0.0, ..Object::new(0.04, RIGID) }));
    plant.train.speed_rad_s = 10.0;
    plant.train.travel_m_s = 10.0 * Lead::B.travel_m_per_rad();
    let mut touching_s = 0.0;
    while plant.train.speed_rad_s > 0.0 || plant.grip_n() > 0.0 {
        run_drive(&mut plant, BridgeCommand::Off, 50e-6);
        touching_s += 50e-6;
        assert!(touching_s < 0.1);
    }
    // Half a swing: pi sqrt(J / (r^2 k)), the screw's give in series with 333 N/mm.
    let stiffness = 1.0 / (3e-6 + 1.0 / 20e6);
    let half_s = std::f64::consts::PI / (1.0228e-3 * f64::sqrt(stiffness / 6e-5));
    assert!((touching_s / half_s - 1.0).abs() < 0.01, "{touching_s} {half_s}");
}

#[test]
fn backlash_delays_the_fingers_after_reversal() {
    let mut plant = Plant::new(PlantParameters::nominal(Lead::A), 0.04, 1);
    let (angle_rad, travel_m) = (plant.train.angle_rad, plant.train.travel_m);
    let moved = |plant: &Plant| (plant.train.travel_m - travel_m).abs() > 1e-6;
    assert!(drive_until(&mut plant, |_| -1.0, moved));
    let lost_m = (angle_rad - plant.train.angle_rad) * Lead::A.travel_m_per_rad();
    assert!((lost_m - 31e-6).abs() < 2e-6, "{lost_m}");
}

#[test]
fn fingers_stop_at_both_ends_of_the_travel() {
    for (start_m, current_a) in [(0.001, 1.0), (0.079, -1.0)] {
        let mut plant = Plant::new(PlantParameters::nominal(Lead::B), start_m, 1);
        drive_until(&mut plant, |_| current_a, |plant| plant.time_s() > 0.5);
        let opening_m = plant.opening_m();
        let end_m = if current_a > 0.0 { 0.0 } else { 0.08 };
        assert!(plant.train.speed_rad_s.abs() < 0.1);
        assert!((opening_m - end_m).abs() < 0.6e-3, "{opening_m}");
    }
}

#[test]
fn rated_speed_closes_at_58_3_mm_s() {
    for (lead, per_finger) in [(Lead::A, 1.0), (Lead::B, 0.5)] {
        let mut plant = Plant::new(PlantParameters::nominal(lead), 0.08, 1);
        let fast = |plant: &Plant| plant.train.speed_rad_s >= constants::RATED_SPEED.value;
        assert!(drive_until(&mut plant, |_| 3.0, fast));
        let stated_mm_s = 1e3 * plant.train.travel_m_s * per_finger;
        assert!((stated_mm_s / 58.3 - 1.0).abs() < 0.03, "{lead:?}: {stated_mm_s}");
    }
}

/// Supplied energy and imbalance, in J.
fn energy_balance(plant: &Plant, stored_j: f64) -> (f64, f64) {
    let ledger = &plant.ledger;
    let found_j = ledger.heat_j() + plant.stored().all_j() - stored_j;
    (ledger.supplied_j, ledger.supplied_j - found_j)
}

#[test]
fn energy_of_grasp_and_release_balances_within_1_percent() {
    for lead in Lead::BOTH {
        let mut plant = Plant::new(PlantParameters::nominal(lead), 0.05, 1);
        plant.set_object(Some(&Object::new(0.04, 1000.0)));
        let stored_j = plant.stored().all_j();
        drive_until(&mut plant, |_| 4.0, |plant| plant.grip_n() > 100.0);
        run_drive(&mut plant, BridgeCommand::Brake, 0.05);
        drive_until(&mut plant, |_| -8.0, |plant| plant.opening_m() > 0.045);
        run_drive(&mut plant, BridgeCommand::Off, 0.05);
        let (supplied_j, missing_j) = energy_balance(&plant, stored_j);
        assert!(supplied_j > 0.3, "{lead:?}: {supplied_j}");
        assert!(missing_j.abs() < 0.01 * supplied_j, "{lead:?}: {missing_j} of {supplied_j}");
    }
}

#[test]
fn braking_energy_becomes_copper_and_friction_loss() {
    let mut plant = Plant::new(PlantParameters::simplified(Lead::A), 0.08, 1);
    plant.train.speed_rad_s = 114.0;
    plant.train.travel_m_s = 0.0583;
    run_drive(&mut plant, BridgeCommand::Brake, 0.1);
    let (copper_j, friction_j) = (plant.ledger.copper_j, plant.ledger.friction_j);
    // 1/2 J w^2 = 0.390 J.
    assert!((copper_j + friction_j - 0.390).abs() < 0.004, "{copper_j} + {friction_j}");
    assert!(copper_j > 0.9 * (copper_j + friction_j));
    assert!(plant.bus.voltage_v < 24.01);
}

#[test]
fn cogging_is_conservative() {
    let mut parameters = PlantParameters::simplified(Lead::A);
    parameters.cogging.torque_nm = 0.05;
    let mut plant = Plant::new(parameters, 0.08, 1);
    plant.train.speed_rad_s = 114.0;
    plant.train.travel_m_s = 0.0583;
    let stored_j = plant.stored().all_j();
    run_drive(&mut plant, BridgeCommand::Off, 0.05);
    let (_, missing_j) = energy_balance(&plant, stored_j);
    assert!(missing_j.abs() < 1e-3 * 0.39, "{missing_j}");
}

/// Peak force after contact with a rigid object at full speed.
fn peak_n(lead: Lead, drive: BridgeCommand, refined: u32) -> f64 {
    let mut parameters = PlantParameters::simplified(lead);
    // The study's friction: of the screw alone.
    parameters.screw.friction = if lead == Lead::A { 2.2 } else { 0.61 };
    let mut plant = Plant::new(parameters, 0.04, 1);
    plant.refine(refined);
    plant.set_object(Some(&Object::new(0.04, 1000.0)));
    plant.train.speed_rad_s = constants::RATED_SPEED.value;
    plant.train.travel_m_s = constants::RATED_SPEED.value * lead.travel_m_per_rad();
    let mut peak_n = 0.0_f64;
    for _ in 0..2000 {
        plant.step(drive);
        peak_n = peak_n.max(plant.grip_n());
    }
    peak_n
}

#[test]
fn peak_force_after_contact_agrees_with_the_earlier_study() {
    for (lead, off_n, brake_n) in [(Lead::A, 264.0, 71.0), (Lead::B, 376.0, 133.0)] {
        let (off, brake) =
            (peak_n(lead, BridgeCommand::Off, 1), peak_n(lead, BridgeCommand::Brake, 1));
        println!("{lead:?}: off {off:.1} N ({off_n}), brake {brake:.1} N ({brake_n})");
        assert!((off / off_n - 1.0).abs() < 0.05, "{lead:?}: {off}");
        assert!((brake / brake_n - 1.0).abs() < 0.05, "{lead:?}: {brake}");
    }
}

#[test]
fn halved_step_changes_the_peak_by_less_than_0_1_percent() {
    for drive in [BridgeCommand::Off, BridgeCommand::Brake] {
        let (coarse, fine) = (peak_n(Lead::B, drive, 1), peak_n(Lead::B, drive, 2));
        println!("{drive:?}: {coarse} {fine}");
        assert!((coarse / fine - 1.0).abs() < 1e-3, "{drive:?}: {coarse} {fine}");
    }
}

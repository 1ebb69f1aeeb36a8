//! Energy that comes in is found again.

use firmware::motor::stage::Drive;

use super::source::{drive_until, hold};
use crate::plant::Plant;
use crate::plant::object::Object;
use crate::plant::parameters::{Lead, Parameters};

/// Supplied, and what does not balance, in J.
fn books(plant: &Plant, stored_j: f64) -> (f64, f64) {
    let ledger = &plant.ledger;
    let found_j = ledger.heat_j() + plant.stored().all_j() - stored_j;
    (ledger.supplied_j, ledger.supplied_j - found_j)
}

#[test]
fn a_grasp_a_brake_and_a_release_balance_within_a_percent() {
    for lead in Lead::BOTH {
        let mut plant = Plant::new(Parameters::nominal(lead), 0.05, 1);
        plant.hold(Some(&Object::new(0.04, 1000.0)));
        let stored_j = plant.stored().all_j();
        drive_until(&mut plant, |_| 4.0, |plant| plant.grip_n() > 100.0);
        hold(&mut plant, Drive::Brake, 0.05);
        drive_until(&mut plant, |_| -8.0, |plant| plant.opening_m() > 0.045);
        hold(&mut plant, Drive::Off, 0.05);
        let (supplied_j, missing_j) = books(&plant, stored_j);
        assert!(supplied_j > 0.3, "{lead:?}: {supplied_j}");
        assert!(
            missing_j.abs() < 0.01 * supplied_j,
            "{lead:?}: {missing_j} of {supplied_j}"
        );
    }
}

#[test]
fn a_braked_rotor_s_energy_becomes_heat_in_the_windings_and_friction() {
    let mut plant = Plant::new(Parameters::plain(Lead::A), 0.08, 1);
    plant.train.speed_rad_s = 114.0;
    plant.train.travel_m_s = 0.0583;
    hold(&mut plant, Drive::Brake, 0.1);
    let (copper_j, friction_j) = (plant.ledger.copper_j, plant.ledger.friction_j);
    // 1/2 J w^2 = 0.390 J.
    assert!(
        (copper_j + friction_j - 0.390).abs() < 0.004,
        "{copper_j} + {friction_j}"
    );
    assert!(copper_j > 0.9 * (copper_j + friction_j));
    assert!(plant.bus.voltage_v < 24.01);
}

#[test]
fn teeth_take_nothing_over_a_turn() {
    let mut parameters = Parameters::plain(Lead::A);
    parameters.cogging.torque_nm = 0.05;
    let mut plant = Plant::new(parameters, 0.08, 1);
    plant.train.speed_rad_s = 114.0;
    plant.train.travel_m_s = 0.0583;
    let stored_j = plant.stored().all_j();
    hold(&mut plant, Drive::Off, 0.05);
    let (_, missing_j) = books(&plant, stored_j);
    assert!(missing_j.abs() < 1e-3 * 0.39, "{missing_j}");
}

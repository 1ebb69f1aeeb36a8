//! The firmware's motor control on the plant.

use crate::board::world::{SimulatedMotor, World, WorldSample};
use crate::closed_loop::coupling::{GripperMotor, GripperWorld, SimulatedGripper};
use crate::closed_loop::frequency_response::{bandwidth_hz, frequency_response, step_response};
use crate::closed_loop::motor_rig::{
    DriveCase, MotorRig, run_at_speed, run_to_position, static_force_n, wiring,
};
use crate::closed_loop::requirements;
use crate::drivetrain::fingertips::{Fingertips, Impact};
use crate::drivetrain::mechanics::Object;
use crate::drivetrain::parameters::{Lead, PlantParameters, SCATTER};
use firmware::config::constants::{self, TICK_US};
use firmware::motor::{MotorCommand, MotorState, Setpoint, Settings};
use firmware::sensors::imu::decode;
use firmware::tasks::FIRST_TICK_US;
use std::cell::RefCell;
use std::rc::Rc;

#[test]
fn drive_meets_all_requirements_with_either_screw() {
    for lead in Lead::BOTH {
        for figure in requirements::evaluate(lead, 1..=3) {
            println!("{lead:?} {figure:?}");
            assert!(figure.is_met(), "{lead:?}: {figure:?}");
        }
    }
}

#[test]
fn position_run_respects_its_speed_limit() {
    let case = DriveCase::nominal(Lead::A, 1);
    let trace = run_to_position(&case, [40.0, 20.0], 40.0);
    let fastest = trace.max(|point| point.closing_mm_s);
    assert!((fastest - 40.0).abs() < 1.5, "{fastest}");
    let end_mm = trace.mean_of_last(0.05, |point| point.opening_mm);
    assert!((end_mm - 20.0).abs() < 0.05, "{end_mm}");
}

#[test]
fn runs_are_seeded_and_reproducible() {
    let run = |seed| run_at_speed(&DriveCase::nominal(Lead::B, seed), 60.0, 50.0, 0.05);
    assert_eq!(run(7), run(7));
    assert_ne!(run(7).trace, run(8).trace);
}

#[test]
fn commissioning_identifies_the_plant() {
    for seed in 1..=3 {
        let mut parameters = PlantParameters::scattered(Lead::A, SCATTER, seed);
        parameters.swapped = seed == 2;
        let mut rig =
            MotorRig::with_settings(Settings::assumed(Lead::A.screw()), parameters, 40.0, seed);
        rig.motor.handle_command(MotorCommand::Commission);
        rig.run(1e-3);
        let under_way = |state| matches!(state, MotorState::Arming | MotorState::Commissioning);
        rig.run_while(10.0, |telling| under_way(telling.state));
        rig.run(1e-3);
        let found = rig.motor.identification();
        let found = found.unwrap_or_else(|| panic!("{:?}", rig.motor.status().state));
        let near = |found: f32, is: f64, share: f64| (f64::from(found) / is - 1.0).abs() < share;
        assert!(near(found.resistance_ohm, parameters.windings.resistance_ohm, 0.05), "{found:?}");
        assert!(near(found.inductance_h, parameters.windings.inductance_h, 0.1), "{found:?}");
        assert_eq!(f64::from(found.pole_pairs), constants::POLE_PAIRS.value);
        assert_eq!(found.wiring.is_swapped, parameters.swapped);
        let off = found.wiring.offset.wrapping_sub(wiring(&parameters).offset) as i32;
        // Friction and the sensor's own error leave a few electrical degrees.
        let off_deg = f64::from(off) / 4_294_967_296.0 * 360.0;
        assert!(off_deg.abs() < 15.0, "{off_deg}");
    }
}

#[test]
fn static_force_is_proportional_to_the_current() {
    let case = DriveCase::nominal(Lead::B, 1);
    let [less_n, more_n] = [3.0, 3.3].map(|current_a| static_force_n(&case, current_a));
    // (3.3 - 0.2) / (3 - 0.2) with 0.02 N m of dry friction; breakaway and guides take a little more.
    assert!((more_n / less_n / (3.1 / 2.8) - 1.0).abs() < 0.02, "{less_n} {more_n}");
}

#[test]
fn current_loop_is_a_low_pass() {
    let tones = frequency_response(&DriveCase::nominal(Lead::A, 1));
    assert!((tones[0].gain - 1.0).abs() < 0.02, "{:?}", tones[0]);
    assert!(tones[0].lag_deg.abs() < 10.0, "{:?}", tones[0]);
    assert!(tones.last().is_some_and(|tone| tone.gain < 0.7), "{tones:?}");
    assert!(bandwidth_hz(&tones).is_some());
    let step = step_response(&DriveCase::nominal(Lead::A, 1));
    assert!((step.end() - 1.0).abs() < 0.02, "{}", step.end());
}

#[test]
fn tripped_drive_does_not_move() {
    let mut rig = MotorRig::armed(Lead::A, PlantParameters::nominal(Lead::A), 40.0, 1);
    let nothing = f32::NAN;
    rig.run_setpoint(Setpoint::Current { closing_a: nothing }, 0.01);
    assert!(matches!(rig.motor.status().state, MotorState::Tripped(_)));
    rig.run_setpoint(Setpoint::Current { closing_a: 5.0 }, 0.05);
    assert_eq!(rig.plant.train.speed_rad_s, 0.0);
}

#[test]
fn world_samples_follow_the_gripper() {
    let rig = MotorRig::armed(Lead::B, PlantParameters::nominal(Lead::B), 40.0, 1);
    let tips = Fingertips::new(1, 0.0, &[]).unwrap();
    let gripper = Rc::new(RefCell::new(SimulatedGripper::new(rig, tips, 1)));
    let mut world = GripperWorld(gripper.clone());
    let before = world.next().unwrap();
    {
        let gripper = &mut *gripper.borrow_mut();
        let rig = &mut gripper.rig;
        rig.plant.set_object(Some(&Object::new(0.038, 1000.0)));
        rig.motor.handle_command(MotorCommand::Setpoint(Setpoint::Current { closing_a: 2.0 }));
        gripper.impacts.push(Impact {
            start_s: rig.plant.time_s() + 0.3,
            lasts_s: 0.02,
            peak_n: 40.0,
        });
    }
    let moments: Vec<WorldSample> = (0..310).filter_map(|_| world.next()).collect();
    let (held, landing) = (&moments[290], &moments[309]);
    // 120 N and more, a half on each sensor of a finger: the fields of both fingers part.
    let lateral = |moment: &WorldSample, sensor: usize| moment.readings[sensor].unwrap().field[0];
    let moved = |sensor| i32::from(lateral(held, sensor)) - i32::from(lateral(&before, sensor));
    assert!(moved(0) > 200 && moved(2) < -200, "{} {}", moved(0), moved(2));
    // The foot's 40 N are 20 m/s^2 on top of gravity.
    let specific_force = |moment: &WorldSample| decode(moment.inertial.unwrap()).acceleration[2];
    assert!((specific_force(held) - 9810).abs() < 100, "{}", specific_force(held));
    assert!((specific_force(landing) - 29_500).abs() < 1000, "{}", specific_force(landing));
    let status = GripperMotor(gripper).status(FIRST_TICK_US + 310 * TICK_US).value;
    let opening_mm = status.opening_mm.unwrap();
    assert!((36.0..38.1).contains(&opening_mm), "{opening_mm}");
    assert!(status.current.q > 1.9);
}

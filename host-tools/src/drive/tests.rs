//! The firmware's control on the plant.

use std::cell::RefCell;
use std::rc::Rc;

use firmware::motor::{Setpoint, Settings, State};
use firmware::params;

use super::figures::{self, SCATTER};
use super::response::{bandwidth_hz, step, sweep};
use super::runs::{Case, at_speed, squeeze_n, to_place};
use super::world::{Gripper, Senses};
use super::{Rig, wiring};
use crate::board::world::{Moment, World};
use crate::plant::hall::Fingertips;
use crate::plant::impact::Impact;
use crate::plant::object::Object;
use crate::plant::parameters::{Lead, Parameters};

#[test]
fn every_figure_asked_of_the_drive_is_reached_with_either_screw() {
    for lead in Lead::BOTH {
        for figure in figures::of(lead, 1..=3) {
            println!("{lead:?} {figure:?}");
            assert!(figure.is_met(), "{lead:?}: {figure:?}");
        }
    }
}

#[test]
fn a_way_of_20_mm_is_as_long_as_its_speed_asks() {
    let case = Case::nominal(Lead::A, 1);
    let trace = to_place(&case, [40.0, 20.0], 40.0);
    let fastest = trace.most(|point| point.closing_mm_s);
    assert!((fastest - 40.0).abs() < 1.5, "{fastest}");
    let end_mm = trace.last(0.05, |point| point.opening_mm);
    assert!((end_mm - 20.0).abs() < 0.05, "{end_mm}");
}

#[test]
fn the_same_seed_gives_the_same_run_and_another_seed_another() {
    let run = |seed| at_speed(&Case::nominal(Lead::B, seed), 60.0, 50.0, 0.05);
    assert_eq!(run(7), run(7));
    assert_ne!(run(7).trace, run(8).trace);
}

#[test]
fn commissioning_finds_the_plant_that_is_there() {
    for seed in 1..=3 {
        let mut parameters = Parameters::scattered(Lead::A, SCATTER, seed);
        parameters.swapped = seed == 2;
        let mut rig = Rig::set(Settings::assumed(Lead::A.screw()), parameters, 40.0, seed);
        rig.motor.commission();
        let under_way = |state| matches!(state, State::Arming | State::Commissioning);
        rig.run_while(10.0, |telling| under_way(telling.state));
        let found = rig.motor.found();
        let found = found.unwrap_or_else(|| panic!("{:?}", rig.motor.telling().state));
        let near = |found: f32, is: f64, share: f64| (f64::from(found) / is - 1.0).abs() < share;
        assert!(
            near(
                found.resistance_ohm,
                parameters.windings.resistance_ohm,
                0.05
            ),
            "{found:?}"
        );
        assert!(
            near(found.inductance_h, parameters.windings.inductance_h, 0.1),
            "{found:?}"
        );
        assert_eq!(f64::from(found.pole_pairs), params::POLE_PAIRS.value);
        assert_eq!(found.wiring.is_swapped, parameters.swapped);
        let off = found.wiring.offset.wrapping_sub(wiring(&parameters).offset) as i32;
        // Friction and the sensor's own error leave a few electrical degrees.
        let off_deg = f64::from(off) / 4_294_967_296.0 * 360.0;
        assert!(off_deg.abs() < 15.0, "{off_deg}");
    }
}

#[test]
fn a_tenth_more_current_is_a_tenth_more_force() {
    let case = Case::nominal(Lead::B, 1);
    let [less_n, more_n] = [3.0, 3.3].map(|current_a| squeeze_n(&case, current_a));
    // (3.3 - 0.2) / (3 - 0.2) with 0.02 N m of dry friction; breakaway and guides take a little more.
    assert!(
        (more_n / less_n / (3.1 / 2.8) - 1.0).abs() < 0.02,
        "{less_n} {more_n}"
    );
}

#[test]
fn the_current_loop_follows_slow_sines_and_not_fast_ones() {
    let tones = sweep(&Case::nominal(Lead::A, 1));
    assert!((tones[0].gain - 1.0).abs() < 0.02, "{:?}", tones[0]);
    assert!(tones[0].lag_deg.abs() < 10.0, "{:?}", tones[0]);
    assert!(
        tones.last().is_some_and(|tone| tone.gain < 0.7),
        "{tones:?}"
    );
    assert!(bandwidth_hz(&tones).is_some());
    let step = step(&Case::nominal(Lead::A, 1));
    assert!((step.end() - 1.0).abs() < 0.02, "{}", step.end());
}

#[test]
fn a_tripped_drive_does_nothing() {
    let mut rig = Rig::armed(Lead::A, Parameters::nominal(Lead::A), 40.0, 1);
    let nothing = f32::NAN;
    rig.under(Setpoint::Current { closing_a: nothing }, 0.01);
    assert!(matches!(rig.motor.telling().state, State::Tripped(_)));
    rig.under(Setpoint::Current { closing_a: 5.0 }, 0.05);
    assert_eq!(rig.plant.train.speed_rad_s, 0.0);
}

#[test]
fn a_world_feels_what_the_drive_does() {
    let rig = Rig::armed(Lead::B, Parameters::nominal(Lead::B), 40.0, 1);
    let tips = Fingertips::new(1, 0.0, &[]).unwrap();
    let gripper = Rc::new(RefCell::new(Gripper::new(rig, tips, 1)));
    let mut world = Senses(gripper.clone());
    let before = world.next().unwrap();
    {
        let gripper = &mut *gripper.borrow_mut();
        let rig = &mut gripper.rig;
        rig.plant.hold(Some(&Object::new(0.038, 1000.0)));
        rig.motor.command(Setpoint::Current { closing_a: 2.0 });
        gripper.impacts.push(Impact {
            start_s: rig.plant.time_s() + 0.3,
            lasts_s: 0.02,
            peak_n: 40.0,
        });
    }
    let moments: Vec<Moment> = (0..310).filter_map(|_| world.next()).collect();
    let (held, landing) = (&moments[290], &moments[309]);
    // 120 N and more, a half on each sensor of a finger: the fields of both fingers part.
    let lateral = |moment: &Moment, sensor: usize| moment.readings[sensor].unwrap().field[0];
    let moved = |sensor| i32::from(lateral(held, sensor)) - i32::from(lateral(&before, sensor));
    assert!(
        moved(0) > 200 && moved(2) < -200,
        "{} {}",
        moved(0),
        moved(2)
    );
    // The foot's 40 N are 20 m/s^2 on top of gravity.
    let felt = |moment: &Moment| moment.around.acceleration.unwrap()[2];
    assert!((felt(held) - 9810).abs() < 100, "{}", felt(held));
    assert!((felt(landing) - 29_500).abs() < 1000, "{}", felt(landing));
    let opening_um = held.around.opening_um.unwrap();
    assert!((36_000..38_100).contains(&opening_um), "{opening_um}");
    assert!(held.around.motor.unwrap().iq_ma > 1900);
}

//! The firmware's grasp on the plant. Motor constants are assumed, the sensing of the force is perfect but for
//! its age of a millisecond and its noise.

use firmware::grip::order::mode;
use firmware::grip::states::{Power, Task};
use firmware::motor::Order;
use firmware::wire::messages::Command;
use host_tools::drive::Rig;
use host_tools::drive::course::{Asked, current_limited, grasp};
use host_tools::drive::grasp::{Bench, grip_command, object};
use host_tools::drive::landing::Landing;
use host_tools::drive::runs::Case;
use host_tools::plant::parameters::{Lead, Parameters};
use host_tools::plant::pulled::Pulled;

/// Newtons to the millimetre.
const CONTACTS: [f64; 3] = [333.0, 50.0, 5.0];
const FORCES_N: [f64; 4] = [10.0, 50.0, 100.0, 350.0];

#[test]
fn a_force_is_passed_by_no_more_than_two_newtons_or_per_cent_and_is_held() {
    for lead in Lead::BOTH {
        for contact in CONTACTS {
            for set_n in FORCES_N {
                let asked = Asked::new(contact, set_n, 0.6);
                let course = grasp(lead, Parameters::nominal(lead), asked, 1);
                let over_n = course.peak_n() - set_n;
                let ms = |seconds: Option<f64>| seconds.map(|seconds| (1e3 * seconds).round());
                println!(
                    "{lead:?} {contact} N/mm {set_n} N: over {over_n:.2} N, 95 % {:?} ms, held {:?} ms, \
                     end {:.2} N, rms {:.2} N, {:.2} A, {:?}",
                    ms(course.rise_s()),
                    ms(course.hold_s()),
                    course.end_n(),
                    course.error_n(),
                    course.current_a(),
                    course.task(),
                );
                assert!(over_n <= f64::max(2.0, 0.02 * set_n), "{over_n}");
                let error_n = course.error_n();
                assert!(error_n <= f64::max(0.8, 0.01 * set_n), "{error_n}");
                let expected = match lead {
                    Lead::A => Task::HoldLatched,
                    Lead::B => Task::HoldActive,
                };
                assert_eq!(course.task(), Some(expected));
                if (contact, set_n) == (333.0, 100.0) {
                    let rise_s = course.rise_s().unwrap();
                    assert!((0.015..=0.040).contains(&rise_s), "{rise_s}");
                }
            }
        }
    }
}

#[test]
fn other_grippers_of_the_same_drawing_pass_it_by_no_more() {
    for lead in Lead::BOTH {
        let mut worst_n = f64::MIN;
        for seed in 0..10 {
            for set_n in [10.0, 100.0, 350.0] {
                let parameters = Parameters::scattered(lead, 0.2, seed);
                let course = grasp(lead, parameters, Asked::new(333.0, set_n, 0.25), seed);
                let over_n = course.peak_n() - set_n;
                worst_n = worst_n.max(over_n);
                assert!(
                    over_n <= f64::max(2.0, 0.02 * set_n),
                    "{lead:?} {seed} {set_n}: {over_n}"
                );
                assert!(course.hold_s().is_some(), "{lead:?} {seed} {set_n}");
            }
        }
        println!("{lead:?}: worst of 30: {worst_n:.2} N over");
    }
}

fn held(lead: Lead, set_n: f64) -> Bench {
    let parameters = Parameters::nominal(lead);
    let mut bench = Bench::new(lead, parameters, 42.0, 1);
    bench
        .rig
        .plant
        .hold(Some(&object(&parameters, 40.0, 333.0)));
    bench.order(grip_command(set_n));
    assert!(
        bench
            .until(3.0, |bench| bench.grip.task() == Task::HoldActive)
            .is_some()
    );
    bench.run(0.4);
    bench
}

#[test]
fn a_hold_survives_its_host_and_the_sensors_of_a_finger() {
    for lead in Lead::BOTH {
        let mut bench = held(lead, 100.0);
        bench.host.is_alive = false;
        bench.run(0.3);
        bench.lost = [true, true, false, false];
        bench.run(0.5);
        let force_n = bench.rig.plant.grip_n();
        println!("{lead:?}: {force_n:.2} N");
        assert!((force_n - 100.0).abs() < 2.0, "{lead:?}: {force_n}");
        assert_eq!(bench.grip.power(), Power::Enabled);
    }
}

#[test]
fn blind_in_a_hold_the_force_stays() {
    for lead in Lead::BOTH {
        let mut bench = held(lead, 100.0);
        bench.lost = [true; 4];
        bench.run(0.5);
        let force_n = bench.rig.plant.grip_n();
        println!("{lead:?}: {force_n:.2} N, {:?}", bench.grip.power());
        assert!((force_n - 100.0).abs() < 5.0, "{lead:?}: {force_n}");
    }
}

#[test]
fn an_object_that_is_taken_away_is_told_lost_within_five_milliseconds() {
    for lead in Lead::BOTH {
        let mut bench = held(lead, 100.0);
        bench.rig.plant.hold(None);
        let told_s = bench
            .until(0.1, |bench| bench.grip.task() == Task::Lost)
            .unwrap();
        println!("{lead:?}: lost after {:.1} ms", 1e3 * told_s);
        assert!((0.002..=0.0051).contains(&told_s), "{told_s}");
        let opening_m = bench.rig.plant.opening_m();
        bench.run(0.5);
        assert!((bench.rig.plant.opening_m() - opening_m).abs() < 0.5e-3);
    }
}

#[test]
fn what_is_gripped_is_released() {
    for lead in Lead::BOTH {
        let mut bench = held(lead, 100.0);
        bench.order(Command {
            mode: mode::RELEASE,
            position: 1200,
            speed: 160,
            ..Command::default()
        });
        assert!(
            bench
                .until(3.0, |bench| bench.grip.task() == Task::Idle)
                .is_some()
        );
        assert!((1e3 * bench.rig.plant.opening_m() - 60.0).abs() < 0.15);
        assert_eq!(bench.rig.plant.grip_n(), 0.0);
    }
}

#[test]
fn homing_finds_the_opening_to_a_tenth_of_a_millimetre() {
    for lead in Lead::BOTH {
        let mut rig = Rig::armed(lead, Parameters::nominal(lead), 6.0, 1);
        rig.motor.obey(Order::Opening {
            opening_mm: f32::NAN,
        });
        let mut bench = Bench::of(lead, rig, 1);
        bench.run(0.01);
        assert_eq!(bench.grip.task(), Task::Unhomed);
        bench.order(Command {
            mode: mode::HOME,
            ..Command::default()
        });
        bench.run(0.01);
        let took_s = bench
            .until(20.0, |bench| bench.grip.task() != Task::Homing)
            .unwrap();
        assert_eq!(bench.grip.task(), Task::Idle, "{lead:?}");
        bench.run(0.2);
        let told_mm = f64::from(bench.rig.motor.telling().opening_mm.unwrap());
        let true_mm = 1e3 * bench.rig.plant.opening_m();
        println!(
            "{lead:?}: homed in {took_s:.2} s, off by {:.3} mm",
            told_mm - true_mm
        );
        assert!((told_mm - true_mm).abs() < 0.1, "{told_mm} {true_mm}");
    }
}

#[test]
fn with_nothing_but_a_bound_of_the_current_a_grasp_ends_where_the_study_found() {
    // A bound for 50 N and 100 N, at 58.3 mm/s.
    for (lead, set_n, study_n) in [
        (Lead::A, 50.0, 322.0),
        (Lead::A, 100.0, 370.0),
        (Lead::B, 50.0, 240.0),
        (Lead::B, 100.0, 287.0),
    ] {
        let asked = Asked {
            from_mm: 15.0,
            ..Asked::new(333.0, set_n, 0.1)
        };
        let peak_n = current_limited(lead, Parameters::nominal(lead), asked, 1).peak_n();
        println!("{lead:?} {set_n} N: {peak_n:.0} N ({study_n})");
        assert!((peak_n / study_n - 1.0).abs() < 0.03, "{lead:?}: {peak_n}");
    }
}

#[test]
fn what_slips_is_gripped_harder_until_it_holds() {
    for lead in Lead::BOTH {
        let mut bench = held(lead, 60.0);
        bench.pulled = Some(Pulled::new(0.5));
        let pull = |bench: &mut Bench, pull_n: f64| {
            if let Some(pulled) = &mut bench.pulled {
                pulled.pull_n = pull_n;
            }
        };
        // 2 * 0.5 * 60 N are borne; nine tenths of it are a slip before it slips.
        for newton in 0..=56 {
            pull(&mut bench, f64::from(newton));
            bench.run(0.005);
        }
        bench.run(1.0);
        let force_n = bench.rig.plant.grip_n();
        let slipped_m = bench.pulled.unwrap().slipped_m;
        println!(
            "{lead:?}: {force_n:.1} N, slipped by {:.3} mm",
            1e3 * slipped_m
        );
        assert!((70.0..=101.0).contains(&force_n), "{force_n}");
        assert_eq!(slipped_m, 0.0);
        // Within 24 ms it pulls harder than the grip bears: the force grows as fast.
        for newton in 57..=80 {
            pull(&mut bench, f64::from(newton));
            bench.run(0.001);
        }
        bench.run(0.5);
        let (force_n, pulled) = (bench.rig.plant.grip_n(), bench.pulled.unwrap());
        println!("{lead:?}: {force_n:.1} N, {pulled:?}");
        assert!(
            force_n > 80.0 && pulled.speed_m_s == 0.0,
            "{force_n} {pulled:?}"
        );
        assert!(pulled.slipped_m < 1e-3, "{pulled:?}");
    }
}

#[test]
fn a_landing_is_told_in_time_and_moves_nothing() {
    for lead in Lead::BOTH {
        let landing = Landing {
            peak_n: 150.0,
            lasts_s: 0.01,
            along_mm: 12.0,
            phase: 0.3,
        };
        let landed = landing.run(&Case::nominal(lead, 1));
        let contact_s = landed.contact_s().unwrap();
        assert!((0.0002..=0.002).contains(&contact_s), "{contact_s}");
        let (held_n, peak_n) = (landed.held_n(), landed.peak_n());
        assert!((held_n / peak_n - 1.0).abs() < 0.06, "{held_n} {peak_n}");
        let along_mm = landed.along_mm().unwrap();
        assert!((along_mm - 12.0).abs() < 1.5, "{along_mm}");
        assert!(landed.moved_mm < 0.05, "{}", landed.moved_mm);
    }
}

//! The firmware's grasp on the plant. Motor constants are assumed; force sensing is ideal but for 1 ms delay and noise.

use firmware::grip::states::TaskState;
use sim::closed_loop::grasp_result::{GraspTarget, run_current_limited, run_grasp};
use sim::closed_loop::grasp_rig::{GraspRig, contact_object, grip_command};
use sim::closed_loop::landing::{FootContact, Landing};
use sim::closed_loop::motor_rig::DriveCase;
use sim::drivetrain::mechanics::PulledObject;
use sim::drivetrain::parameters::{Lead, PlantParameters};

/// Contact stiffnesses in N/mm.
const CONTACTS: [f64; 3] = [333.0, 50.0, 5.0];
const FORCES_N: [f64; 4] = [10.0, 50.0, 100.0, 350.0];

#[test]
fn overshoot_is_below_2_n_or_2_percent_and_force_is_held() {
    for lead in Lead::BOTH {
        for contact in CONTACTS {
            for set_n in FORCES_N {
                let target = GraspTarget::new(contact, set_n, 0.6);
                let trace = run_grasp(lead, PlantParameters::nominal(lead), target, 1);
                let over_n = trace.peak_n() - set_n;
                let ms = |seconds: Option<f64>| seconds.map(|seconds| (1e3 * seconds).round());
                println!(
                    "{lead:?} {contact} N/mm {set_n} N: over {over_n:.2} N, 95 % {:?} ms, gripping {:?} ms, \
                     end {:.2} N, rms {:.2} N, {:.2} A, {:?}",
                    ms(trace.rise_s()),
                    ms(trace.hold_s()),
                    trace.end_n(),
                    trace.error_n(),
                    trace.current_a(),
                    trace.task(),
                );
                assert!(over_n <= f64::max(2.0, 0.02 * set_n), "{over_n}");
                let error_n = trace.error_n();
                assert!(error_n <= f64::max(0.8, 0.01 * set_n), "{error_n}");
                let expected = match lead {
                    Lead::A => TaskState::HoldLatched,
                    Lead::B => TaskState::HoldActive,
                };
                assert_eq!(trace.task(), Some(expected));
                if (contact, set_n) == (333.0, 100.0) {
                    let rise_s = trace.rise_s().unwrap();
                    assert!((0.015..=0.040).contains(&rise_s), "{rise_s}");
                }
            }
        }
    }
}

#[test]
fn overshoot_of_scattered_grippers_is_within_limits() {
    for lead in Lead::BOTH {
        let mut worst_n = f64::MIN;
        for seed in 0..10 {
            for set_n in [10.0, 100.0, 350.0] {
                let parameters = PlantParameters::scattered(lead, 0.2, seed);
                let trace = run_grasp(lead, parameters, GraspTarget::new(333.0, set_n, 0.25), seed);
                let over_n = trace.peak_n() - set_n;
                worst_n = worst_n.max(over_n);
                assert!(over_n <= f64::max(2.0, 0.02 * set_n), "{lead:?} {seed} {set_n}: {over_n}");
                assert!(trace.hold_s().is_some(), "{lead:?} {seed} {set_n}");
            }
        }
        println!("{lead:?}: worst of 30: {worst_n:.2} N over");
    }
}

fn gripping(lead: Lead, set_n: f64) -> GraspRig {
    let parameters = PlantParameters::nominal(lead);
    let mut grasp = GraspRig::new(lead, parameters, 42.0, 1);
    grasp.rig.plant.set_object(Some(&contact_object(&parameters, 40.0, 333.0)));
    grasp.order(grip_command(set_n));
    assert!(grasp.until(3.0, |grasp| grasp.grip.task() == TaskState::HoldActive).is_some());
    grasp.run(0.4);
    grasp
}

#[test]
fn hold_without_sensors_maintains_the_force() {
    for lead in Lead::BOTH {
        let mut grasp = gripping(lead, 100.0);
        grasp.lost = [true; 4];
        grasp.run(0.5);
        let force_n = grasp.rig.plant.grip_n();
        println!("{lead:?}: {force_n:.2} N, {:?}", grasp.grip.power());
        assert!((force_n - 100.0).abs() < 5.0, "{lead:?}: {force_n}");
    }
}

#[test]
fn removed_object_is_detected_within_5_ms() {
    for lead in Lead::BOTH {
        let mut grasp = gripping(lead, 100.0);
        grasp.rig.plant.set_object(None);
        let detected_s = grasp.until(0.1, |grasp| grasp.grip.task() == TaskState::Lost).unwrap();
        println!("{lead:?}: lost after {:.1} ms", 1e3 * detected_s);
        assert!((0.002..=0.0051).contains(&detected_s), "{detected_s}");
        let opening_m = grasp.rig.plant.opening_m();
        grasp.run(0.5);
        assert!((grasp.rig.plant.opening_m() - opening_m).abs() < 0.5e-3);
    }
}

#[test]
fn current_limited_peak_force_agrees_with_the_study() {
    // A bound for 50 N and 100 N, at 58.3 mm/s.
    for (lead, set_n, study_n) in [
        (Lead::A, 50.0, 322.0),
        (Lead::A, 100.0, 370.0),
        (Lead::B, 50.0, 240.0),
        (Lead::B, 100.0, 287.0),
    ] {
        let target = GraspTarget { from_mm: 15.0, ..GraspTarget::new(333.0, set_n, 0.1) };
        let peak_n = run_current_limited(lead, PlantParameters::nominal(lead), target, 1).peak_n();
        println!("{lead:?} {set_n} N: {peak_n:.0} N ({study_n})");
        assert!((peak_n / study_n - 1.0).abs() < 0.03, "{lead:?}: {peak_n}");
    }
}

#[test]
fn slip_increases_the_force_until_the_object_sticks() {
    for lead in Lead::BOTH {
        let mut grasp = gripping(lead, 60.0);
        grasp.pulled = Some(PulledObject::new(0.5));
        let pull = |grasp: &mut GraspRig, pull_n: f64| {
            if let Some(pulled) = &mut grasp.pulled {
                pulled.pull_n = pull_n;
            }
        };
        // 2 * 0.5 * 60 N are borne; nine tenths of it are a slip before it slips.
        for newton in 0..=56 {
            pull(&mut grasp, f64::from(newton));
            grasp.run(0.005);
        }
        grasp.run(1.0);
        let force_n = grasp.rig.plant.grip_n();
        let slipped_m = grasp.pulled.unwrap().slipped_m;
        println!("{lead:?}: {force_n:.1} N, slipped by {:.3} mm", 1e3 * slipped_m);
        assert!((70.0..=101.0).contains(&force_n), "{force_n}");
        assert_eq!(slipped_m, 0.0);
        // Within 24 ms it pulls harder than the grip bears: the force grows as fast.
        for newton in 57..=80 {
            pull(&mut grasp, f64::from(newton));
            grasp.run(0.001);
        }
        grasp.run(0.5);
        let (force_n, pulled) = (grasp.rig.plant.grip_n(), grasp.pulled.unwrap());
        println!("{lead:?}: {force_n:.1} N, {pulled:?}");
        assert!(force_n > 80.0 && pulled.speed_m_s == 0.0, "{force_n} {pulled:?}");
        assert!(pulled.slipped_m < 1e-3, "{pulled:?}");
    }
}

#[test]
fn landing_is_reported_in_time_without_finger_motion() {
    let contacts = [(FootContact::Flat, 0.0), (FootContact::Line, 8.0)];
    for (lead, (contact, across_mm)) in
        Lead::BOTH.into_iter().flat_map(|lead| contacts.map(|contact| (lead, contact)))
    {
        let landing = Landing {
            peak_n: 150.0,
            lasts_s: 0.01,
            contact,
            along_mm: 12.0,
            across_mm,
            phase: 0.3,
        };
        let result = landing.run(&DriveCase::nominal(lead, 1));
        let contact_s = result.contact_s().unwrap();
        assert!((0.0002..=0.002).contains(&contact_s), "{contact_s}");
        let (held_n, peak_n) = (result.held_n(), result.peak_n());
        assert!((held_n / peak_n - 1.0).abs() < 0.06, "{held_n} {peak_n}");
        let [along_mm, found_mm] = result.centre_mm().unwrap();
        assert!((along_mm - 12.0).abs() < 1.5, "{along_mm}");
        assert!((found_mm - across_mm).abs() < 1.5, "{found_mm}");
        assert!(result.moved_mm < 0.05, "{}", result.moved_mm);
    }
}

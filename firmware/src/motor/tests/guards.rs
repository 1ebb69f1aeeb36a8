//! What ends a motion: bounds, trips, and what is no number.

use proptest::prelude::*;

use super::super::*;
use super::bench::{Bench, armed, both};
use crate::motor::current::Windings;
use crate::motor::handed::Action;
use crate::motor::limits::Limit;
use crate::motor::screw::Screw;
use crate::motor::speed::SpeedLoop;
use crate::motor::stage::{Drive, EncoderError};
use crate::motor::svpwm;
use crate::motor::transform::Dq;

#[test]
fn without_its_angle_the_rotor_is_braked_within_a_millisecond() {
    let mut bench = Bench::new();
    let mut motor = armed(&mut bench, Settings::assumed(Screw::A));
    motor.obey(Order::Do(Setpoint::Speed {
        closing_mm_s: 50.0,
        most_a: 9.6,
    }));
    bench.run(&mut motor, 2000, |_, _| {});
    let blind = Sensed {
        angle: Err(EncoderError::Field),
        ..bench.sensed
    };
    let braked = (0..20).position(|_| both(&mut motor, &blind) == Drive::Brake);
    assert!(braked.is_some_and(|periods| periods < 20), "{braked:?}");
    assert_eq!(motor.telling().state, State::Tripped(Trip::Encoder));
    both(&mut motor, &blind);
    assert_eq!(motor.outer.rotor_mm(), None);
}

#[test]
fn a_current_beyond_its_bound_switches_everything_off() {
    let mut bench = Bench::new();
    let mut motor = armed(&mut bench, Settings::assumed(Screw::A));
    motor.obey(Order::Do(Setpoint::Current { closing_a: 1.0 }));
    bench.run(&mut motor, 100, |_, _| {});
    let mut sensed = bench.sensed;
    sensed.phases[1] = 2048 + 1600;
    assert_eq!(both(&mut motor, &sensed), Drive::Off);
    assert_eq!(motor.telling().state, State::Tripped(Trip::OverCurrent));
    assert_eq!(both(&mut motor, &bench.sensed), Drive::Off);
}

#[test]
fn fingers_slow_down_before_the_end_of_their_way_and_before_they_are_homed() {
    let mut bench = Bench::new();
    let mut motor = armed(&mut bench, Settings::assumed(Screw::A));
    let open = Setpoint::Speed {
        closing_mm_s: -58.0,
        most_a: 9.6,
    };
    motor.obey(Order::Do(open));
    bench.run(&mut motor, 40_000, |_, _| {});
    let opening = bench.opening(Screw::A);
    assert!((79.5..80.02).contains(&opening), "{opening}");
    assert!(motor.telling().limits.has(Limit::EndStop));
    motor.obey(Order::Opening {
        opening_mm: f32::NAN,
    });
    motor.obey(Order::Do(open));
    bench.run(&mut motor, 2_000, |_, _| {});
    let told = motor.telling();
    assert!((told.closing_mm_s + 5.0).abs() < 0.3, "{told:?}");
    assert!(told.limits.has(Limit::NotHomed) && told.opening_mm.is_none());
    motor.obey(Order::Do(Setpoint::Position {
        opening_mm: 20.0,
        speed_mm_s: 50.0,
        most_a: 9.6,
    }));
    bench.run(&mut motor, 2_000, |_, _| {});
    let told = motor.telling();
    assert!(
        told.speed.abs() < 0.5 && told.limits.has(Limit::NotHomed),
        "{told:?}"
    );
}

#[test]
fn a_set_point_s_own_bound_of_the_current_holds() {
    let mut bench = Bench::new();
    let mut motor = armed(&mut bench, Settings::assumed(Screw::B));
    bench.load = 0.4;
    motor.obey(Order::Do(Setpoint::Speed {
        closing_mm_s: 30.0,
        most_a: 3.0,
    }));
    let mut most = 0_f64;
    bench.run(&mut motor, 300, |bench, _| most = most.max(bench.q().abs()));
    assert!((2.8..3.3).contains(&most), "{most}");
    assert!(motor.telling().limits.has(Limit::Current));
}

#[test]
fn a_power_stage_that_switched_itself_off_is_a_trip_until_disarmed() {
    let mut bench = Bench::new();
    let mut motor = armed(&mut bench, Settings::assumed(Screw::A));
    motor.obey(Order::Do(Setpoint::Brake));
    bench.run(&mut motor, 6, |_, _| {});
    assert_eq!(bench.drive, Drive::Brake);
    motor.shut_off();
    motor.obey(Order::Arm);
    bench.run(&mut motor, 10, |_, _| {});
    let tripped = State::Tripped(Trip::PowerStage);
    assert_eq!((motor.telling().state, bench.drive), (tripped, Drive::Off));
    motor.obey(Order::Disarm);
    bench.run(&mut motor, 10, |_, _| {});
    motor.obey(Order::Arm);
    bench.run(&mut motor, 10, |_, _| {});
    assert_eq!(motor.telling().state, State::Arming);
}

#[test]
fn without_its_outer_tick_an_armed_motor_is_braked_within_a_millisecond() {
    let mut bench = Bench::new();
    let mut motor = armed(&mut bench, Settings::assumed(Screw::A));
    motor.obey(Order::Do(Setpoint::Current { closing_a: 2.0 }));
    bench.run(&mut motor, 100, |_, _| {});
    let drives = [(); 20].map(|()| motor.inner.tick(&bench.sensed));
    let braked = drives.iter().position(|drive| *drive == Drive::Brake);
    // It was heard last in the period before these, or up to four earlier; three turns are fifteen.
    assert!(
        braked.is_some_and(|periods| (10..=15).contains(&periods)),
        "{braked:?}"
    );
    assert_eq!(motor.telling().state, State::Tripped(Trip::Unled));
}

#[test]
fn a_speed_that_nobody_asks_for_again_ends_on_the_brake_within_six_milliseconds_and_a_place_does_not()
 {
    let moving = Setpoint::Speed {
        closing_mm_s: 20.0,
        most_a: 9.6,
    };
    let place = Setpoint::Position {
        opening_mm: 30.0,
        speed_mm_s: 20.0,
        most_a: 9.6,
    };
    for (setpoint, expected) in [(moving, Some(105)), (place, None)] {
        let mut bench = Bench::new();
        let mut motor = armed(&mut bench, Settings::assumed(Screw::A));
        motor.obey(Order::Do(setpoint));
        // Whoever asked falls silent at once.
        motor.setpoint = None;
        let mut braked = None;
        for period in 0..400 {
            bench.run(&mut motor, 1, |_, _| {});
            if bench.drive == Drive::Brake {
                braked = braked.or(Some(period));
            }
        }
        assert_eq!(braked, expected);
        let is_tripped = motor.telling().state == State::Tripped(Trip::Unled);
        assert_eq!(is_tripped, expected.is_some());
    }
}

#[test]
fn a_bus_that_is_lifted_from_outside_ends_on_the_shorted_windings_and_comes_back() {
    let mut bench = Bench::new();
    let mut motor = armed(&mut bench, Settings::assumed(Screw::A));
    motor.obey(Order::Do(Setpoint::Current { closing_a: 1.0 }));
    bench.run(&mut motor, 20, |_, _| {});
    let mut drive_at = |volts: f64| {
        let bus = (volts / 0.015) as u16;
        let sensed = Sensed {
            bus,
            ..bench.sensed
        };
        let drive = both(&mut motor, &sensed);
        (drive, motor.telling().limits.has(Limit::Regeneration))
    };
    assert_eq!(drive_at(32.1), (Drive::Brake, true));
    assert_eq!(drive_at(29.0), (Drive::Brake, true));
    assert!(matches!(drive_at(28.0), (Drive::Duty(_), false)));
    assert_eq!(drive_at(7.0).0, Drive::Off);
}

#[test]
fn settings_with_which_nothing_can_be_computed_do_not_arm() {
    let spoils: [fn(&mut Settings); 10] = [
        |settings| settings.machine.resistance_ohm = f32::NAN,
        |settings| settings.machine.inductance_h = 0.0,
        |settings| settings.machine.torque_nm_a = f32::INFINITY,
        |settings| settings.machine.inertia_kg_m2 = -1.0,
        |settings| settings.machine.pole_pairs = 0,
        |settings| settings.machine.dry_nm = f32::NAN,
        |settings| settings.screw.ratio_mm = f32::NAN,
        |settings| settings.limits.peak_a = f32::NAN,
        |settings| settings.limits.burn_v = [28.0, 28.0],
        |settings| settings.angle_age_periods = f32::NAN,
    ];
    for (number, spoil) in spoils.into_iter().enumerate() {
        let mut settings = Settings::assumed(Screw::A);
        assert!(settings.is_sound());
        spoil(&mut settings);
        let mut motor = Motor::new(settings);
        motor.obey(Order::Arm);
        let mut bench = Bench::new();
        bench.run(&mut motor, 10, |_, _| {});
        let state = motor.telling().state;
        assert_eq!(state, State::Tripped(Trip::NotANumber), "{number}");
    }
}

/// Has the inner tick follow currents that the outer one never asked for.
fn ask(motor: &mut Motor, d: f32, q: f32) {
    motor.ask = Some(Ask {
        change: None,
        action: Action::Follow(Dq { d, q }),
    });
}

#[test]
fn what_is_not_a_number_inside_or_asked_for_switches_off_and_is_told() {
    let spoils: [fn(&mut Motor); 7] = [
        |motor| ask(motor, f32::INFINITY, 0.0),
        |motor| ask(motor, 0.0, f32::NAN),
        |motor| motor.outer.speed = SpeedLoop::start(f32::NAN),
        |motor| {
            motor.inner.windings = Windings::of(&settings::Machine {
                inductance_h: f32::NAN,
                ..motor.inner.settings.machine
            })
        },
        |motor| {
            motor.obey(Order::Do(Setpoint::Current {
                closing_a: f32::NAN,
            }))
        },
        |motor| {
            motor.obey(Order::Do(Setpoint::Position {
                opening_mm: f32::NAN,
                speed_mm_s: 1.0,
                most_a: 1.0,
            }))
        },
        |motor| motor.outer.settings.machine.torque_nm_a = f32::NAN,
    ];
    for (number, spoil) in spoils.into_iter().enumerate() {
        let mut bench = Bench::new();
        let mut motor = armed(&mut bench, Settings::assumed(Screw::A));
        motor.obey(Order::Do(Setpoint::Speed {
            closing_mm_s: 20.0,
            most_a: 9.6,
        }));
        bench.run(&mut motor, 100, |_, _| {});
        spoil(&mut motor);
        let sensed = bench.sensed;
        let drives = [(); 12].map(|()| both(&mut motor, &sensed));
        let state = motor.telling().state;
        std::println!("{number} {state:?} {drives:?}");
        assert_eq!(state, State::Tripped(Trip::NotANumber), "{number}");
        assert_eq!(drives[11], Drive::Off, "{number}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Any counts and any set-points: duties stay in their range.
    #[test]
    fn whatever_is_sensed_the_switches_get_what_they_can_do(
        sensed in prop::collection::vec(
            (prop::array::uniform4(0_u16..4096), 0_u16..16384, 0_u8..20), 50..400,
        ),
        setpoints in prop::collection::vec((0_u8..5, -1e4_f32..1e4), 1..20),
    ) {
        let mut bench = Bench::new();
        let mut motor = armed(&mut bench, Settings::assumed(Screw::B));
        for (at, ([a, b, c, bus], angle, kind)) in sensed.iter().copied().enumerate() {
            if at % 20 == 0 {
                motor.obey(Order::Disarm);
                both(&mut motor, &bench.sensed);
                both(&mut motor, &bench.sensed);
                motor.inner.state = State::Armed;
                both(&mut motor, &bench.sensed);
                let (kind, value) = setpoints[at / 20 % setpoints.len()];
                motor.obey(Order::Do(match kind {
                    0 => Setpoint::Off,
                    1 => Setpoint::Brake,
                    2 => Setpoint::Current { closing_a: value },
                    3 => Setpoint::Speed { closing_mm_s: value, most_a: value },
                    _ => Setpoint::Position { opening_mm: value, speed_mm_s: value, most_a: 5.0 },
                }));
            }
            let angle = match kind {
                0 => Err(EncoderError::Silent),
                _ => Ok(angle),
            };
            let drive = both(&mut motor, &Sensed { phases: [a, b, c], bus, angle });
            if let Drive::Duty(duties) = drive {
                for duty in duties {
                    prop_assert!((0.0..=svpwm::MODULATION).contains(&duty));
                }
            }
        }
    }
}

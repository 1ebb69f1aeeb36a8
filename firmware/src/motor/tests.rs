//! The whole control on a motor of a few lines.

use core::f64::consts::TAU;

use proptest::prelude::*;

use super::stage::EncoderError;
use super::*;
use crate::motor::screw::Screw;

/// Sub-steps of a period.
const STEPS: u32 = 10;

/// A motor with sinusoidal magnets behind ideal switches: what the control knows of, and what it does not.
struct Bench {
    resistance: f64,
    inductance: f64,
    flux: f64,
    pole_pairs: f64,
    inertia: f64,
    dry: f64,
    /// Torque that opens, in newton metres.
    load: f64,
    bus: f64,
    /// Of the bus, which the supply feeds and never unloads; zero: a bus that never gives way.
    capacitance: f64,
    swapped: bool,
    /// Of the sensor, in turns.
    sits: f64,
    /// A speed in rad/s that it is turned with, whatever its torque.
    turned: Option<f64>,
    current: [f64; 2],
    speed: f64,
    angle: f64,
    drive: Drive,
    sensed: Sensed,
}

impl Bench {
    fn new() -> Self {
        let machine = Settings::assumed(Screw::A).machine;
        Self {
            resistance: machine.resistance_ohm.into(),
            inductance: machine.inductance_h.into(),
            flux: machine.flux_wb().into(),
            pole_pairs: machine.pole_pairs.into(),
            inertia: machine.inertia_kg_m2.into(),
            dry: machine.dry_nm.into(),
            load: 0.0,
            bus: 24.0,
            capacitance: 0.0,
            swapped: false,
            sits: 0.0,
            turned: None,
            current: [0.0; 2],
            speed: 0.0,
            angle: 0.0,
            drive: Drive::Off,
            sensed: Sensed {
                phases: [2048; 3],
                bus: 1600,
                angle: Ok(0),
            },
        }
    }

    fn swap(&self, [u, v, w]: [f64; 3]) -> [f64; 3] {
        match self.swapped {
            true => [u, w, v],
            false => [u, v, w],
        }
    }

    /// The period in which `drive` holds; senses in its middle.
    fn period(&mut self) {
        for step in 0..STEPS {
            if step == STEPS / 2 {
                self.sense();
            }
            self.step(f64::from(PERIOD_S) / f64::from(STEPS));
        }
    }

    fn step(&mut self, dt: f64) {
        let duties = match self.drive {
            Drive::Off => {
                self.current = [0.0; 2];
                [0.0; 3]
            }
            Drive::Brake => [0.0; 3],
            Drive::Duty(duties) => self.swap(duties.map(f64::from)),
        };
        let [u, v, w] = duties.map(|duty| duty * self.bus);
        let volts = [(2.0 * u - v - w) / 3.0, (v - w) / 3_f64.sqrt()];
        let electrical = self.pole_pairs * self.angle;
        let (sin, cos) = electrical.sin_cos();
        let induced = self.pole_pairs * self.speed * self.flux;
        let magnets = [-sin * induced, cos * induced];
        let mut power = 0.0;
        for axis in 0..2 {
            power += 1.5 * volts[axis] * self.current[axis];
            let drop = volts[axis] - self.resistance * self.current[axis] - magnets[axis];
            if self.drive != Drive::Off {
                self.current[axis] += dt * drop / self.inductance;
            }
        }
        if self.capacitance > 0.0 {
            self.bus = (self.bus - dt * power / (self.bus * self.capacitance)).max(24.0);
        }
        let q = cos * self.current[1] - sin * self.current[0];
        let torque = 1.5 * self.pole_pairs * self.flux * q - self.load;
        self.turn(torque, dt);
    }

    /// Friction stops and never reverses.
    fn turn(&mut self, torque: f64, dt: f64) {
        let free = self.speed + dt * torque / self.inertia;
        let friction = dt * self.dry / self.inertia;
        self.speed = free.signum() * (free.abs() - friction).max(0.0);
        self.speed = self.turned.unwrap_or(self.speed);
        self.angle += dt * self.speed;
    }

    fn sense(&mut self) {
        let [alpha, beta] = self.current;
        let side = 3_f64.sqrt() / 2.0 * beta;
        let phases = self.swap([alpha, side - 0.5 * alpha, -side - 0.5 * alpha]);
        let turns = self.angle / TAU + self.sits;
        self.sensed = Sensed {
            phases: phases
                .map(|current| (2048.0 + current / 0.0125).round().clamp(0.0, 4095.0) as u16),
            bus: (self.bus / 0.015).round() as u16,
            angle: Ok((turns * 16384.0).floor() as i64 as u16 & 0x3fff),
        };
    }

    /// Runs a motor's control for some periods; calls `each` after each.
    fn run(&mut self, motor: &mut Motor, periods: u32, mut each: impl FnMut(&Self, &Motor)) {
        for _ in 0..periods {
            self.period();
            let sensed = self.sensed;
            motor.period(&sensed, self);
            each(self, motor);
        }
    }

    fn q(&self) -> f64 {
        let (sin, cos) = (self.pole_pairs * self.angle).sin_cos();
        cos * self.current[1] - sin * self.current[0]
    }

    fn opening(&self, screw: Screw) -> f64 {
        40.0 - self.angle * f64::from(screw.ratio_mm)
    }
}

impl PowerStage for Bench {
    fn drive(&mut self, drive: Drive) {
        self.drive = drive;
    }
}

fn armed(bench: &mut Bench, settings: Settings) -> Motor {
    let mut motor = Motor::new(settings);
    motor.arm();
    bench.run(&mut motor, 600, |_, _| {});
    assert_eq!(motor.telling().state, State::Armed);
    motor.set_opening(40.0);
    motor
}

/// Overshoot of a current step from one ampere to four, in shares of the step.
fn overshoot(bench: &mut Bench) -> f64 {
    let mut motor = armed(bench, Settings::assumed(Screw::A));
    motor.command(Setpoint::Current { closing_a: 1.0 });
    bench.run(&mut motor, 400, |_, _| {});
    motor.command(Setpoint::Current { closing_a: 4.0 });
    let (mut greatest, mut last) = (0_f64, 0.0);
    bench.run(&mut motor, 200, |bench, _| {
        last = bench.q();
        greatest = greatest.max(last);
    });
    assert!((last - 4.0).abs() < 0.1, "{last}");
    (greatest - 4.0) / 3.0
}

#[test]
fn a_current_step_overshoots_by_less_than_a_tenth_whatever_the_motor() {
    let mut worst = 0_f64;
    for number in 0..81 {
        let share = |place: u32| 0.8 + 0.2 * f64::from(number / 3_u32.pow(place) % 3);
        let mut bench = Bench::new();
        bench.resistance *= share(0);
        bench.inductance *= share(1);
        bench.flux *= share(2);
        bench.turned = Some([0.0, 100.0, -100.0][(number / 27 % 3) as usize]);
        worst = worst.max(overshoot(&mut bench));
    }
    std::println!("overshoot at most {worst:.3}");
    assert!((0.01..0.1).contains(&worst), "{worst}");
}

/// Gain of the current loop at a frequency, by a sine of one ampere on four.
fn gain(bench: &mut Bench, hertz: f64) -> f64 {
    bench.turned = Some(0.0);
    let mut motor = armed(bench, Settings::assumed(Screw::A));
    motor.command(Setpoint::Current { closing_a: 4.0 });
    bench.run(&mut motor, 200, |_, _| {});
    let (mut sums, periods) = ([0.0; 2], 4000);
    for period in 0..periods + 1000 {
        let (sin, cos) = (TAU * hertz * f64::from(period) * f64::from(PERIOD_S)).sin_cos();
        // The innermost loop alone: its input is what the outer tick leaves.
        motor.asked.q = 4.0 + sin as f32;
        bench.period();
        bench.drive = motor.current_tick(&bench.sensed);
        if period >= 1000 {
            sums[0] += (bench.q() - 4.0) * sin;
            sums[1] += (bench.q() - 4.0) * cos;
        }
    }
    2.0 * sums[0].hypot(sums[1]) / f64::from(periods)
}

#[test]
fn the_current_loop_passes_a_kilohertz_whatever_the_motor() {
    for (resistance, inductance) in [(1.0, 1.0), (0.8, 0.8), (0.8, 1.2), (1.2, 0.8), (1.2, 1.2)] {
        let mut bench = Bench::new();
        bench.resistance *= resistance;
        bench.inductance *= inductance;
        let gain = gain(&mut bench, 1000.0);
        std::println!("R {resistance} L {inductance}: gain at 1 kHz {gain:.3}");
        // Half the power, and no resonance.
        assert!(
            (0.707..1.3).contains(&gain),
            "{resistance} {inductance}: {gain}"
        );
    }
}

#[test]
fn ten_millimetres_end_where_they_should_on_either_screw() {
    for screw in [Screw::A, Screw::B] {
        for (target, load) in [(30.0, 0.0), (50.0, 0.0), (30.0, 0.1)] {
            let mut bench = Bench::new();
            let mut motor = armed(&mut bench, Settings::assumed(screw));
            bench.load = load;
            let start = bench.opening(screw);
            motor.command(Setpoint::Position {
                opening_mm: target,
                speed_mm_s: 58.3,
                most_a: 9.6,
            });
            let (mut beyond, ahead) = (0_f64, (f64::from(target) - start).signum());
            bench.run(&mut motor, 12_000, |bench, _| {
                beyond = beyond.max(ahead * (bench.opening(screw) - f64::from(target)));
            });
            let error = (bench.opening(screw) - f64::from(target)).abs();
            std::println!(
                "ratio {}: beyond {beyond:.4} error {error:.5}",
                screw.ratio_mm
            );
            assert!(beyond < 0.05 && error < 0.02, "{beyond} {error}");
            assert!(
                motor.telling().limits == Active::default(),
                "{:?}",
                motor.telling()
            );
        }
    }
}

#[test]
fn stopping_from_full_speed_takes_less_than_half_a_millimetre_and_the_bus_stays_in_bounds() {
    for (screw, stop) in [
        (Screw::A, Setpoint::Brake),
        (Screw::B, Setpoint::Brake),
        (
            Screw::A,
            Setpoint::Speed {
                closing_mm_s: 0.0,
                most_a: 9.6,
            },
        ),
        (
            Screw::B,
            Setpoint::Speed {
                closing_mm_s: 0.0,
                most_a: 9.6,
            },
        ),
    ] {
        let mut bench = Bench::new();
        bench.capacitance = 470e-6;
        let mut motor = armed(&mut bench, Settings::assumed(screw));
        motor.command(Setpoint::Speed {
            closing_mm_s: 114.0 * screw.ratio_mm,
            most_a: 9.6,
        });
        bench.run(&mut motor, 4000, |_, _| {});
        assert!((bench.speed - 114.0).abs() < 1.0, "{}", bench.speed);
        let from = bench.angle;
        motor.command(stop);
        let mut highest = 0_f64;
        bench.run(&mut motor, 1000, |bench, _| {
            highest = highest.max(bench.bus)
        });
        let way = (bench.angle - from) * f64::from(screw.ratio_mm);
        std::println!(
            "{stop:?} ratio {}: {way:.3} mm, {highest:.2} V",
            screw.ratio_mm
        );
        assert!(bench.speed.abs() < 0.5 && way < 0.5, "{stop:?}: {way} mm");
        assert!(highest < 30.0, "{highest} V");
    }
}

#[test]
fn commissioning_finds_what_the_motor_is_and_how_it_is_wired() {
    for (pole_pairs, swapped, sits) in [(7.0, false, 0.013), (7.0, true, 0.4), (11.0, false, 0.77)]
    {
        let mut bench = Bench::new();
        (bench.pole_pairs, bench.swapped, bench.sits) = (pole_pairs, swapped, sits);
        bench.flux = 0.1 / (1.5 * pole_pairs);
        (bench.resistance, bench.inductance) = (0.5, 0.3e-3);
        bench.angle = 0.21;
        // What was found before does not matter.
        let mut settings = Settings::assumed(Screw::A);
        settings.wiring.is_swapped = sits > 0.3;
        let mut motor = Motor::new(settings);
        motor.commission();
        bench.run(&mut motor, 60_000, |_, _| {});
        let found = motor
            .found()
            .unwrap_or_else(|| panic!("{:?}", motor.telling()));
        std::println!("{found:?}");
        assert_eq!(
            (f64::from(found.pole_pairs), found.wiring.is_swapped),
            (pole_pairs, swapped)
        );
        assert!((found.resistance_ohm / 0.5 - 1.0).abs() < 0.03, "{found:?}");
        assert!(
            (found.inductance_h / 0.3e-3 - 1.0).abs() < 0.05,
            "{found:?}"
        );
        // With what was found the motor closes when asked to, with the torque that is asked.
        motor.arm();
        bench.run(&mut motor, 600, |_, _| {});
        bench.turned = Some(0.0);
        motor.command(Setpoint::Current { closing_a: 3.0 });
        bench.run(&mut motor, 400, |_, _| {});
        assert!((bench.q() - 3.0).abs() < 0.05, "{}", bench.q());
    }
}

#[test]
fn commissioning_says_what_is_wrong() {
    use commission::Refusal;
    let refused = |spoil: fn(&mut Bench)| {
        let mut bench = Bench::new();
        spoil(&mut bench);
        let mut motor = Motor::new(Settings::assumed(Screw::A));
        motor.commission();
        bench.run(&mut motor, 60_000, |_, _| {});
        assert_eq!(bench.drive, Drive::Off);
        match motor.telling().state {
            State::Refused(refusal) => refusal,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(refused(|bench| bench.turned = Some(0.0)), Refusal::Stuck);
    let open = refused(|bench| bench.resistance = 100.0);
    assert!(matches!(open, Refusal::NoCurrent { .. }), "{open:?}");
    let thin = refused(|bench| bench.resistance = 1.7);
    assert!(
        matches!(thin, Refusal::Resistance { measured_ohm } if measured_ohm > 1.6),
        "{thin:?}"
    );
    let iron = refused(|bench| bench.inductance = 2e-3);
    assert!(
        matches!(iron, Refusal::Inductance { measured_h } if measured_h > 1.7e-3),
        "{iron:?}"
    );
}

#[test]
fn amplifiers_that_are_far_off_do_not_arm() {
    let mut motor = Motor::new(Settings::assumed(Screw::A));
    motor.arm();
    let sensed = Sensed {
        phases: [2048, 2300, 2048],
        bus: 1600,
        angle: Ok(0),
    };
    for _ in 0..600 {
        assert_eq!(motor.current_tick(&sensed), Drive::Off);
    }
    assert_eq!(motor.telling().state, State::Tripped(Trip::CurrentSense));
    motor.arm();
    assert_eq!(motor.telling().state, State::Tripped(Trip::CurrentSense));
    motor.disarm();
    motor.arm();
    assert_eq!(motor.telling().state, State::Arming);
}

#[test]
fn without_its_angle_the_rotor_is_braked_within_a_millisecond() {
    let mut bench = Bench::new();
    let mut motor = armed(&mut bench, Settings::assumed(Screw::A));
    motor.command(Setpoint::Speed {
        closing_mm_s: 50.0,
        most_a: 9.6,
    });
    bench.run(&mut motor, 2000, |_, _| {});
    let blind = Sensed {
        angle: Err(EncoderError::Field),
        ..bench.sensed
    };
    let braked = (0..20).position(|_| motor.current_tick(&blind) == Drive::Brake);
    assert!(braked.is_some_and(|periods| periods < 20), "{braked:?}");
    assert_eq!(motor.telling().state, State::Tripped(Trip::Encoder));
    assert_eq!(motor.rotor_mm(), None);
}

#[test]
fn a_current_beyond_its_bound_switches_everything_off() {
    let mut bench = Bench::new();
    let mut motor = armed(&mut bench, Settings::assumed(Screw::A));
    motor.command(Setpoint::Current { closing_a: 1.0 });
    bench.run(&mut motor, 100, |_, _| {});
    let mut sensed = bench.sensed;
    sensed.phases[1] = 2048 + 1600;
    assert_eq!(motor.current_tick(&sensed), Drive::Off);
    assert_eq!(motor.telling().state, State::Tripped(Trip::OverCurrent));
    assert_eq!(motor.current_tick(&bench.sensed), Drive::Off);
}

#[test]
fn fingers_slow_down_before_the_end_of_their_way_and_before_they_are_homed() {
    let mut bench = Bench::new();
    let mut motor = armed(&mut bench, Settings::assumed(Screw::A));
    let open = Setpoint::Speed {
        closing_mm_s: -58.0,
        most_a: 9.6,
    };
    motor.command(open);
    bench.run(&mut motor, 40_000, |_, _| {});
    let opening = bench.opening(Screw::A);
    assert!((79.5..80.02).contains(&opening), "{opening}");
    assert!(motor.telling().limits.has(Limit::EndStop));
    motor.set_opening(f32::NAN);
    motor.command(open);
    bench.run(&mut motor, 2_000, |_, _| {});
    let told = motor.telling();
    assert!((told.closing_mm_s + 5.0).abs() < 0.3, "{told:?}");
    assert!(told.limits.has(Limit::NotHomed) && told.opening_mm.is_none());
    motor.command(Setpoint::Position {
        opening_mm: 20.0,
        speed_mm_s: 50.0,
        most_a: 9.6,
    });
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
    motor.command(Setpoint::Speed {
        closing_mm_s: 30.0,
        most_a: 3.0,
    });
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
    bench.run(&mut motor, 5, |_, _| {});
    assert_eq!(bench.drive, Drive::Brake);
    motor.shut_off();
    motor.obey(Order::Arm);
    bench.run(&mut motor, 5, |_, _| {});
    let tripped = State::Tripped(Trip::PowerStage);
    assert_eq!((motor.telling().state, bench.drive), (tripped, Drive::Off));
    motor.obey(Order::Disarm);
    motor.obey(Order::Arm);
    assert_eq!(motor.telling().state, State::Arming);
}

#[test]
fn a_bus_that_is_lifted_from_outside_ends_on_the_shorted_windings_and_comes_back() {
    let mut bench = Bench::new();
    let mut motor = armed(&mut bench, Settings::assumed(Screw::A));
    motor.command(Setpoint::Current { closing_a: 1.0 });
    bench.run(&mut motor, 20, |_, _| {});
    let mut drive_at = |volts: f64| {
        let bus = (volts / 0.015) as u16;
        let drive = motor.current_tick(&Sensed {
            bus,
            ..bench.sensed
        });
        motor.motion_tick();
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
        motor.arm();
        let state = motor.telling().state;
        assert_eq!(state, State::Tripped(Trip::NotANumber), "{number}");
    }
}

#[test]
fn what_is_not_a_number_inside_or_asked_for_switches_off_and_is_told() {
    let spoils: [fn(&mut Motor); 7] = [
        |motor| motor.asked.d = f32::INFINITY,
        |motor| motor.asked.q = f32::NAN,
        |motor| motor.speed = SpeedLoop::start(f32::NAN),
        |motor| {
            motor.windings = Windings::of(&settings::Machine {
                inductance_h: f32::NAN,
                ..motor.settings.machine
            })
        },
        |motor| {
            motor.command(Setpoint::Current {
                closing_a: f32::NAN,
            })
        },
        |motor| {
            motor.command(Setpoint::Position {
                opening_mm: f32::NAN,
                speed_mm_s: 1.0,
                most_a: 1.0,
            })
        },
        |motor| motor.settings.machine.torque_nm_a = f32::NAN,
    ];
    for (number, spoil) in spoils.into_iter().enumerate() {
        let mut bench = Bench::new();
        let mut motor = armed(&mut bench, Settings::assumed(Screw::A));
        motor.command(Setpoint::Speed {
            closing_mm_s: 20.0,
            most_a: 9.6,
        });
        bench.run(&mut motor, 100, |_, _| {});
        spoil(&mut motor);
        let sensed = bench.sensed;
        let drives = [(); 12].map(|()| {
            let drive = motor.current_tick(&sensed);
            motor.motion_tick();
            drive
        });
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
                motor.disarm();
                motor.state = State::Armed;
                let (kind, value) = setpoints[at / 20 % setpoints.len()];
                motor.command(match kind {
                    0 => Setpoint::Off,
                    1 => Setpoint::Brake,
                    2 => Setpoint::Current { closing_a: value },
                    3 => Setpoint::Speed { closing_mm_s: value, most_a: value },
                    _ => Setpoint::Position { opening_mm: value, speed_mm_s: value, most_a: 5.0 },
                });
            }
            let angle = match kind {
                0 => Err(EncoderError::Silent),
                _ => Ok(angle),
            };
            let drive = motor.current_tick(&Sensed { phases: [a, b, c], bus, angle });
            motor.motion_tick();
            if let Drive::Duty(duties) = drive {
                for duty in duties {
                    prop_assert!((0.0..=svpwm::MODULATION).contains(&duty));
                }
            }
        }
    }
}

//! The motor's control: the most instructions of its ticks over much that may be sensed, and of a whole millisecond.

use core::fmt::{Error, Result, Write};
use core::hint::black_box;

use firmware::motor::screw::Screw;
use firmware::motor::stage::Sensed;
use firmware::motor::{Inner, MOTION_PERIODS, Order, Outer, Setpoint, Settings, State};
use firmware::params;

use crate::counts::Counter;
use crate::vectors::Random;

/// Periods that are counted for each set-point.
const PERIODS: u32 = 600;
/// Periods from one set-point to the next: here the outer tick runs in each.
const ORDERED: u32 = 10;
/// Periods in a millisecond.
const PERIODS_MS: u32 = params::PWM_RATE.value as u32;
/// Periods in which it arms.
const ARMS: u32 = 600;

/// A line for each tick.
pub fn print(counter: &Counter, out: &mut impl Write) -> Result {
    let mut random = Random(17);
    let mut greatest = [0; 3];
    for setpoint in [
        Setpoint::Current { closing_a: -9.0 },
        Setpoint::Speed {
            closing_mm_s: 50.0,
            most_a: 9.6,
        },
        Setpoint::Position {
            opening_mm: 70.0,
            speed_mm_s: 58.0,
            most_a: 9.6,
        },
        Setpoint::Position {
            opening_mm: 10.0,
            speed_mm_s: 58.0,
            most_a: 9.6,
        },
    ] {
        let mut ticks = Ticks::armed(&mut random);
        let opening_mm = 40.0;
        ticks.order(Order::Opening { opening_mm });
        let [inner, outer] = ticks.count(setpoint, counter, &mut random).ok_or(Error)?;
        let millisecond = ticks
            .millisecond(setpoint, counter, &mut random)
            .ok_or(Error)?;
        for (greatest, count) in greatest.iter_mut().zip([inner, outer, millisecond]) {
            *greatest = count.max(*greatest);
        }
    }
    let [inner, outer, millisecond] = greatest;
    writeln!(out, "motor_inner {inner}")?;
    writeln!(out, "motor_outer {outer}")?;
    writeln!(out, "motor_millisecond {millisecond}")
}

/// Both ticks, as the board's interrupts call them.
struct Ticks {
    inner: Inner,
    outer: Outer,
}

impl Ticks {
    fn armed(random: &mut Random) -> Self {
        let mut settings = Settings::assumed(Screw::A);
        // What is sensed here fits nothing.
        let limits = &mut settings.limits;
        (limits.sum_a, limits.beside_v) = (f32::MAX, f32::MAX);
        (limits.unfollowed_a, limits.runaway) = (f32::MAX, f32::MAX);
        let mut ticks = Self {
            inner: Inner::new(settings),
            outer: Outer::new(settings),
        };
        ticks.order(Order::Arm);
        for period in 0..ARMS {
            ticks.inner.tick(&sensed(period, random, 0));
            let ask = ticks.outer.tick(ticks.inner.felt());
            ticks.inner.hear(ask);
        }
        ticks
    }

    fn order(&mut self, order: Order) {
        if let Some(ask) = self.outer.obey(order) {
            self.inner.hear(ask);
        }
    }

    /// The most instructions of each; none where the motor did not stay armed, and little was counted.
    fn count(
        &mut self,
        setpoint: Setpoint,
        counter: &Counter,
        random: &mut Random,
    ) -> Option<[u32; 2]> {
        let mut greatest = [0; 2];
        let mut felt = self.inner.felt();
        for period in 0..PERIODS {
            if period % ORDERED == 0 {
                self.order(Order::Do(setpoint));
            }
            let sensed = sensed(ARMS + period, random, 700);
            let ask = self.outer.tick(felt);
            // All that the interrupt does at most in one period.
            let inner = counter.instructions(|| {
                self.inner.hear(black_box(ask));
                black_box(self.inner.tick(black_box(&sensed)));
                felt = self.inner.felt();
            });
            let outer = match period % u32::from(MOTION_PERIODS) {
                0 => counter.instructions(|| {
                    black_box(self.outer.tick(black_box(felt)));
                }),
                _ => 0,
            };
            // The first run of a piece of code does not count: the emulator translates it meanwhile.
            if period > 20 {
                greatest = [greatest[0].max(inner), greatest[1].max(outer)];
            }
        }
        self.is_armed().then_some(greatest)
    }

    /// The most instructions of a millisecond: the outer tick runs, hears and is heard in one period of five, and is
    /// ordered in one of twenty, as the board's interrupts have it. None where the motor did not stay armed.
    fn millisecond(
        &mut self,
        setpoint: Setpoint,
        counter: &Counter,
        random: &mut Random,
    ) -> Option<u32> {
        let (mut greatest, mut count) = (0, 0);
        let mut ask = None;
        for period in 1..=PERIODS {
            let sensed = sensed(ARMS + PERIODS + period, random, 700);
            count += counter.instructions(|| {
                if period % PERIODS_MS == 1 {
                    ask = ask
                        .take()
                        .or(self.outer.obey(Order::Do(black_box(setpoint))));
                }
                if let Some(ask) = ask.take() {
                    self.inner.hear(black_box(ask));
                }
                black_box(self.inner.tick(black_box(&sensed)));
                if period.is_multiple_of(MOTION_PERIODS.into()) {
                    ask = Some(self.outer.tick(self.inner.felt()));
                }
            });
            if period.is_multiple_of(PERIODS_MS) {
                // As above, not the first.
                greatest = greatest.max(if period > PERIODS_MS { count } else { 0 });
                count = 0;
            }
        }
        self.is_armed().then_some(greatest)
    }

    fn is_armed(&self) -> bool {
        self.outer.telling().state == State::Armed
    }
}

/// Currents of a width in counts, a bus between braking and too little, a rotor that turns at 100 rad/s.
fn sensed(period: u32, random: &mut Random, width: i32) -> Sensed {
    let mut near = |middle: i32, width: i32| {
        let beside = random.word() % (width + 1);
        middle.saturating_add(beside).clamp(1, 4094) as u16
    };
    Sensed {
        phases: [near(2048, width), near(2048, width), near(2048, width)],
        bus: near(1650, width / 2),
        angle: Ok((period * 13 & 0x3fff) as u16),
    }
}

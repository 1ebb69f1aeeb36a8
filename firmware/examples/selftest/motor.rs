//! The motor control: maximum of the instructions of its ticks over random inputs, and of a whole millisecond.

use core::fmt::{Error, Result, Write};
use core::hint::black_box;

use firmware::config::constants;
use firmware::motor::power_stage::MotorSamples;
use firmware::motor::screw::Screw;
use firmware::motor::{
    CurrentLoop, MOTION_PERIODS, MotionLoop, MotorCommand, MotorState, Setpoint, Settings,
};

use crate::counts::Counter;
use crate::vectors::Random;

/// Counted periods for each set-point.
const PERIODS: u32 = 600;
/// Periods between two set-points.
const ORDER_PERIODS: u32 = 10;
/// Periods in a millisecond.
const PERIODS_MS: u32 = constants::PWM_RATE.value as u32;
/// Periods for arming.
const ARMING_PERIODS: u32 = 600;

/// Prints the maximum of each tick.
pub fn print(counter: &Counter, out: &mut impl Write) -> Result {
    let mut random = Random(17);
    let mut max_count = [0; 3];
    for setpoint in [
        Setpoint::Current { closing_a: -9.0 },
        Setpoint::Speed { closing_mm_s: 50.0, max_a: 9.6 },
        Setpoint::Position { opening_mm: 70.0, speed_mm_s: 58.0, max_a: 9.6 },
        Setpoint::Position { opening_mm: 10.0, speed_mm_s: 58.0, max_a: 9.6 },
    ] {
        let mut ticks = Ticks::armed(&mut random);
        let opening_mm = 40.0;
        ticks.order(MotorCommand::SetOpening { opening_mm });
        let [inner, outer] = ticks.count(setpoint, counter, &mut random).ok_or(Error)?;
        let millisecond = ticks.millisecond(setpoint, counter, &mut random).ok_or(Error)?;
        for (max_count, count) in max_count.iter_mut().zip([inner, outer, millisecond]) {
            *max_count = count.max(*max_count);
        }
    }
    let [inner, outer, millisecond] = max_count;
    writeln!(out, "motor_inner {inner}")?;
    writeln!(out, "motor_outer {outer}")?;
    writeln!(out, "motor_millisecond {millisecond}")
}

/// Both loops, called as by the interrupts of the board.
struct Ticks {
    inner: CurrentLoop,
    outer: MotionLoop,
}

impl Ticks {
    fn armed(random: &mut Random) -> Self {
        let mut settings = Settings::assumed(Screw::A);
        // Disable plausibility checks, which random inputs would violate.
        let limits = &mut settings.limits;
        (limits.sum_a, limits.unexplained_v) = (f32::MAX, f32::MAX);
        (limits.tracking_error_a, limits.runaway) = (f32::MAX, f32::MAX);
        let mut ticks =
            Self { inner: CurrentLoop::new(settings), outer: MotionLoop::new(settings) };
        ticks.order(MotorCommand::Arm);
        for period in 0..ARMING_PERIODS {
            ticks.inner.tick(&sensed(period, random, 0));
            let ask = ticks.outer.tick(ticks.inner.take_report());
            ticks.inner.apply(ask);
        }
        ticks
    }

    fn order(&mut self, order: MotorCommand) {
        if let Some(ask) = self.outer.handle_command(order) {
            self.inner.apply(ask);
        }
    }

    /// Maximum of each loop; `None` if the motor was disarmed, so that too little was counted.
    fn count(
        &mut self,
        setpoint: Setpoint,
        counter: &Counter,
        random: &mut Random,
    ) -> Option<[u32; 2]> {
        let mut max_count = [0; 2];
        let mut report = self.inner.take_report();
        for period in 0..PERIODS {
            if period % ORDER_PERIODS == 0 {
                self.order(MotorCommand::Setpoint(setpoint));
            }
            let sensed = sensed(ARMING_PERIODS + period, random, 700);
            let ask = self.outer.tick(report);
            // The longest path of the interrupt in one period.
            let inner = counter.instructions(|| {
                self.inner.apply(black_box(ask));
                black_box(self.inner.tick(black_box(&sensed)));
                report = self.inner.take_report();
            });
            let outer = match period % u32::from(MOTION_PERIODS) {
                0 => counter.instructions(|| {
                    black_box(self.outer.tick(black_box(report)));
                }),
                _ => 0,
            };
            // The first run of a code section is not counted: the emulator translates it.
            if period > 20 {
                max_count = [max_count[0].max(inner), max_count[1].max(outer)];
            }
        }
        self.is_armed().then_some(max_count)
    }

    /// Maximum of a millisecond: the motion loop runs in every fifth period and receives an order in every twentieth, as on the
    /// board. `None` if the motor was disarmed.
    fn millisecond(
        &mut self,
        setpoint: Setpoint,
        counter: &Counter,
        random: &mut Random,
    ) -> Option<u32> {
        let (mut max_count, mut count) = (0, 0);
        let mut ask = None;
        for period in 1..=PERIODS {
            let sensed = sensed(ARMING_PERIODS + PERIODS + period, random, 700);
            count += counter.instructions(|| {
                if period % PERIODS_MS == 1 {
                    ask = ask
                        .take()
                        .or(self.outer.handle_command(MotorCommand::Setpoint(black_box(setpoint))));
                }
                if let Some(ask) = ask.take() {
                    self.inner.apply(black_box(ask));
                }
                black_box(self.inner.tick(black_box(&sensed)));
                if period.is_multiple_of(MOTION_PERIODS.into()) {
                    ask = Some(self.outer.tick(self.inner.take_report()));
                }
            });
            if period.is_multiple_of(PERIODS_MS) {
                // As above, without the first.
                max_count = max_count.max(if period > PERIODS_MS { count } else { 0 });
                count = 0;
            }
        }
        self.is_armed().then_some(max_count)
    }

    fn is_armed(&self) -> bool {
        self.outer.status().state == MotorState::Armed
    }
}

/// Currents with a spread of `width` counts, a bus voltage within its limits, a rotor at 100 rad/s.
fn sensed(period: u32, random: &mut Random, width: i32) -> MotorSamples {
    let mut around = |middle: i32, width: i32| {
        let offset = random.word() % (width + 1);
        middle.saturating_add(offset).clamp(1, 4094) as u16
    };
    MotorSamples {
        phases: [around(2048, width), around(2048, width), around(2048, width)],
        bus: around(1650, width / 2),
        angle: Ok((period * 13 & 0x3fff) as u16),
    }
}

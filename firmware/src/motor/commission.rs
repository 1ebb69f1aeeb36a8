//! Commissioning: the windings' resistance and inductance, pole pairs, the way the phases are wired and how
//! the rotor's sensor sits, each measured and held against what is plausible.
//!
//! Nothing may be gripped, and the fingers need room: the rotor turns by two electrical turns and back. In
//! order:
//!
//! 1. A current along phase U settles at two levels; of the difference of the voltages comes the resistance,
//!    and the dead time falls out. The rotor turns its magnets to phase U.
//! 2. The field turns forward by two electrical turns and back. How far the rotor turns meanwhile tells pole
//!    pairs and direction; where it rests at phase U after either way, and friction holds it behind by as
//!    much, tells how its sensor sits.
//! 3. On the upper level a square wave is added to the voltage; the slopes of the current are the inductance.

use super::PERIOD_S;
use super::number::Direction;
use super::settings::{Machine, Wiring};
use super::transform::{AlphaBeta, Dq};
use crate::params;

/// Periods in which a level settles: 0.3 s.
const SETTLE: u32 = 6_000;
/// Periods over which a level is averaged, one of 1 / 2^n for the mean: 51 ms.
const AVERAGE: u32 = 1_024;
/// Periods of each way of the field: 0.5 s.
const TURN: u32 = 10_000;
/// Electrical turns of each way.
const TURNS: u32 = 2;
/// Periods of rest after each way.
const PAUSE: u32 = 4_000;
/// Periods of square waves, eight each.
const WAVES: u32 = 2_048;
/// Volts for one ampere and second of the controller that settles the levels: 20 Hz at the resistance
/// assumed.
const SETTLES: f32 = 50.0;
/// The levels, in shares of the rated current.
const LEVELS: [f32; 2] = [0.35, 0.7];
/// A level that is further off than this share of it has not settled.
const SETTLED: f32 = 0.1;
/// Greatest voltage along phase U in volts.
const GREATEST_V: f32 = 8.0;
/// Of the square wave, in volts.
const WAVE_V: f32 = 2.0;
/// Resistance and inductance are plausible within these shares of what is assumed.
const PLAUSIBLE: core::ops::RangeInclusive<f32> = 0.25..=4.0;
/// Most pole pairs.
const POLE_PAIRS: f32 = 30.0;
/// A count of pole pairs may be off a whole number by this.
const WHOLE: f32 = 0.25;
/// The rotor comes back to within this share of an electrical turn.
const BACK: f32 = 0.1;

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Of one phase, in ohms.
    pub resistance_ohm: f32,
    /// Of one phase, in henries.
    pub inductance_h: f32,
    /// Pole pairs.
    pub pole_pairs: u8,
    /// Sensor and phases.
    pub wiring: Wiring,
}

/// Why there is no result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refusal {
    /// The current does not settle: a phase is open, or the bus is low.
    NoCurrent {
        /// What flows, in amperes.
        current_a: f32,
    },
    /// The resistance is not plausible, in ohms.
    Resistance {
        /// What was measured.
        measured_ohm: f32,
    },
    /// The inductance is not plausible, in henries.
    Inductance {
        /// What was measured.
        measured_h: f32,
    },
    /// The rotor does not follow the field: it is held, or nothing couples it to its sensor.
    Stuck,
    /// No whole number of pole pairs explains how far the rotor turned.
    PolePairs {
        /// What would.
        measured: f32,
    },
    /// The rotor did not come back to where it started: it slipped or was turned.
    Slipped,
}

/// What is sensed in a period.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Current along phase U in amperes.
    pub alpha_a: f32,
    /// The rotor's angle by its sensor, in 2^-32 turns.
    pub angle: u32,
    /// The voltage in volts that can be had.
    pub greatest_v: f32,
}

/// What follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Next {
    /// This voltage.
    Drive(AlphaBeta),
    /// It is over.
    Ended(Result<Found, Refusal>),
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Phase {
    #[default]
    Lower,
    Upper,
    Forward,
    Ahead,
    Backward,
    Behind,
    Waves,
}

/// The measurement.
#[derive(Clone, Copy, Debug, Default)]
pub struct Commissioning {
    phase: Phase,
    periods: u32,
    volts: f32,
    sum_v: f32,
    sum_a: f32,
    lower: [f32; 2],
    resistance_ohm: f32,
    /// The rotor after one of the forward turns, after both, and in rest ahead.
    angles: [u32; 3],
    behind: u32,
    last_a: f32,
    rises: Slopes,
    falls: Slopes,
}

/// The mean of a current's steps.
#[derive(Clone, Copy, Debug, Default)]
struct Slopes {
    sum: f32,
    count: f32,
}

impl Slopes {
    fn add(&mut self, step: f32) {
        self.sum += step;
        self.count += 1.0;
    }
}

impl Commissioning {
    /// Takes a period.
    pub fn tick(&mut self, seen: &Seen) -> Next {
        self.periods = self.periods.saturating_add(1);
        match self.phase {
            Phase::Lower => self.level(seen, 0),
            Phase::Upper => self.level(seen, 1),
            Phase::Forward => self.forward(seen),
            Phase::Ahead => self.rest(seen, Phase::Backward),
            Phase::Backward => self.backward(),
            Phase::Behind => self.rest(seen, Phase::Waves),
            Phase::Waves => self.wave(seen),
        }
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.periods = 0;
    }

    /// The voltage of the upper level along a direction of the field.
    fn field(&self, angle: u32) -> Next {
        let along = Dq {
            d: self.volts,
            q: 0.0,
        };
        Next::Drive(along.fixed(Direction::of(angle)))
    }

    fn level(&mut self, seen: &Seen, upper: usize) -> Next {
        const RATED_A: f32 = (params::RATED_TORQUE.value / params::TORQUE_CONSTANT.value) as f32;
        let [low, high] = LEVELS;
        let level_a = RATED_A * if upper == 0 { low } else { high };
        let volts = self.volts + SETTLES * PERIOD_S * (level_a - seen.alpha_a);
        self.volts = volts.min(GREATEST_V.min(seen.greatest_v)).max(-GREATEST_V);
        if self.periods > SETTLE {
            self.sum_v += self.volts;
            self.sum_a += seen.alpha_a;
        }
        if self.periods >= SETTLE + AVERAGE {
            const SHARE: f32 = 1.0 / AVERAGE as f32;
            let mean = [self.sum_v * SHARE, self.sum_a * SHARE];
            (self.sum_v, self.sum_a) = (0.0, 0.0);
            let [mean_v, mean_a] = mean;
            if (mean_a / level_a - 1.0).abs() > SETTLED {
                return Next::Ended(Err(Refusal::NoCurrent { current_a: mean_a }));
            }
            if upper == 0 {
                self.lower = mean;
                self.enter(Phase::Upper);
            } else {
                let [lower_v, lower_a] = self.lower;
                let measured_ohm = (mean_v - lower_v) / (mean_a - lower_a);
                let share = measured_ohm / Machine::ASSUMED.resistance_ohm;
                if !PLAUSIBLE.contains(&share) {
                    return Next::Ended(Err(Refusal::Resistance { measured_ohm }));
                }
                self.resistance_ohm = measured_ohm;
                self.volts = mean_v;
                self.enter(Phase::Forward);
            }
        }
        self.field(0)
    }

    /// How far the field has turned.
    fn turned(&self) -> u32 {
        const STEP: u32 = ((TURNS as u64) << 32).div_ceil(TURN as u64) as u32;
        STEP.wrapping_mul(self.periods)
    }

    fn forward(&mut self, seen: &Seen) -> Next {
        let [half, whole, _] = &mut self.angles;
        if self.periods == TURN / TURNS {
            *half = seen.angle;
        }
        if self.periods >= TURN {
            *whole = seen.angle;
            self.enter(Phase::Ahead);
            return self.field(0);
        }
        self.field(self.turned())
    }

    fn backward(&mut self) -> Next {
        if self.periods >= TURN {
            self.enter(Phase::Behind);
            return self.field(0);
        }
        self.field(self.turned().wrapping_neg())
    }

    fn rest(&mut self, seen: &Seen, then: Phase) -> Next {
        if self.periods >= PAUSE {
            let [.., ahead] = &mut self.angles;
            match then {
                Phase::Backward => *ahead = seen.angle,
                _ => self.behind = seen.angle,
            }
            self.enter(then);
        }
        self.field(0)
    }

    fn wave(&mut self, seen: &Seen) -> Next {
        // A step between two samples has the voltages that the last two ticks but one decided.
        let rises = |tick: u32| tick % 8 < 4;
        let step = seen.alpha_a - self.last_a;
        self.last_a = seen.alpha_a;
        let (one, two) = (self.periods.wrapping_sub(1), self.periods.wrapping_sub(2));
        if self.periods > 16 && rises(one) == rises(two) {
            match rises(one) {
                true => self.rises.add(step),
                false => self.falls.add(step),
            }
        }
        if self.periods >= WAVES {
            return Next::Ended(self.close());
        }
        let wave = if rises(self.periods) { WAVE_V } else { -WAVE_V };
        Next::Drive(AlphaBeta {
            alpha: self.volts + wave,
            beta: 0.0,
        })
    }

    fn close(&self) -> Result<Found, Refusal> {
        let slope = self.rises.sum / self.rises.count - self.falls.sum / self.falls.count;
        let inductance_h = 2.0 * WAVE_V * PERIOD_S / slope;
        if !PLAUSIBLE.contains(&(inductance_h / Machine::ASSUMED.inductance_h)) {
            return Err(Refusal::Inductance {
                measured_h: inductance_h,
            });
        }
        let (pole_pairs, is_swapped) = self.pole_pairs()?;
        Ok(Found {
            resistance_ohm: self.resistance_ohm,
            inductance_h,
            pole_pairs,
            wiring: Wiring {
                offset: self.offset(pole_pairs)?,
                is_swapped,
            },
        })
    }

    /// Pole pairs, and whether the rotor turned against the field: by the second forward turn, at whose
    /// beginning and end friction holds the rotor behind by as much.
    fn pole_pairs(&self) -> Result<(u8, bool), Refusal> {
        let [half, whole, _] = self.angles;
        let turned = whole.wrapping_sub(half) as i32 as f32 / 4_294_967_296.0;
        if turned.abs() * POLE_PAIRS < 0.5 {
            return Err(Refusal::Stuck);
        }
        let measured = 1.0 / turned.abs();
        let nearest = (measured + 0.5) as u8;
        if nearest == 0 || (measured - f32::from(nearest)).abs() > WHOLE {
            return Err(Refusal::PolePairs { measured });
        }
        Ok((nearest, turned < 0.0))
    }

    /// The offset by the mean of both rests.
    fn offset(&self, pole_pairs: u8) -> Result<u32, Refusal> {
        let [.., ahead] = self.angles;
        let ahead = ahead.wrapping_mul(pole_pairs.into());
        let behind = self.behind.wrapping_mul(pole_pairs.into());
        let apart = behind.wrapping_sub(ahead) as i32;
        if apart.unsigned_abs() as f32 > BACK * 4_294_967_296.0 {
            return Err(Refusal::Slipped);
        }
        Ok(ahead.wrapping_add((apart / 2) as u32).wrapping_neg())
    }
}

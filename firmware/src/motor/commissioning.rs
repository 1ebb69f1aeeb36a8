//! Commissioning: measures resistance and inductance of the windings, pole pairs, order of the phases, and the
//! offset of the rotor sensor, each checked for plausibility. A [`super::spin_test`] follows.
//!
//! Nothing may be gripped, and the fingers need room: the rotor turns by two electrical turns and back. In order:
//!
//! 1. A current along phase U at two levels. The difference of the voltages gives the resistance, without the dead
//!    time. The rotor aligns with phase U.
//! 2. The field turns forward by two electrical turns and back; the measured current must turn with it. The rotation of the rotor gives pole pairs and
//!    direction; the mean of its positions at phase U after either direction, between which friction cancels, gives
//!    the offset of the sensor.
//! 3. A square wave added to the voltage of the upper level. The slopes of the current give the inductance.

use crate::config::constants;
use crate::math::{Direction, TURN_UNITS};
use crate::motor::foc::{AlphaBeta, Dq};
use crate::motor::settings::{IdentifiedMotor, MotorParameters, MotorWiring};
use crate::motor::timing::PERIOD_S;

/// Settling periods of a level: 0.3 s.
const SETTLE: u32 = 6_000;
/// Averaging periods of a level, a power of two: 51 ms.
const AVERAGE: u32 = 1_024;
/// Periods of each rotation of the field, 1 s: the voltage that the rotor induces stays below that of the current.
const TURN: u32 = 20_000;
/// Electrical turns of each rotation.
const TURNS: u32 = 2;
/// Periods over which the current is compared with the turning field: 37 degrees.
const WINDOW: u32 = 1_024;
/// Tangent of the greatest angle between them: 30 degrees.
const DIRECTION_TOLERANCE: f32 = 0.577;
/// Periods of rest after each rotation.
const PAUSE: u32 = 4_000;
/// Periods of the square wave, eight per cycle.
const WAVES: u32 = 2_048;
/// Integral gain of the level controller in V/(A s): 20 Hz at the assumed resistance.
const INTEGRAL_GAIN: f32 = 50.0;
/// Highest current, relative to the rated one.
const MAX_SHARE: f32 = 0.7;
/// Current levels relative to the highest current.
const LEVELS: [f32; 2] = [0.5, 1.0];
/// Maximum relative error of a settled level.
const LEVEL_TOLERANCE: f32 = 0.1;
/// Maximum voltage along phase U in volts.
const MAX_V: f32 = 8.0;
/// Amplitude of the square wave in volts.
const WAVE_V: f32 = 2.0;
/// Maximum pole pairs.
const MAX_POLE_PAIRS: f32 = 30.0;
/// Maximum deviation of the measured pole pairs from an integer.
const POLE_PAIR_TOLERANCE: f32 = 0.25;
/// Maximum difference of both rest positions in electrical turns: friction holds the rotor back by up to a tenth on either side
/// where the current is low.
const REST_TOLERANCE: f32 = 0.2;

/// Why commissioning failed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CommissioningError {
    /// The current does not settle: open phase or low bus voltage.
    NoCurrent {
        /// Measured current in amperes.
        current_a: f32,
    },
    /// The resistance is implausible.
    Resistance {
        /// Measured resistance in ohms.
        measured_ohm: f32,
    },
    /// The inductance is implausible.
    Inductance {
        /// Measured inductance in henries.
        measured_h: f32,
    },
    /// The rotor does not follow the field: blocked, or not coupled to its sensor.
    Stuck,
    /// The number of pole pairs is not an integer.
    PolePairs {
        /// Measured number.
        measured: f32,
    },
    /// The measured current does not follow the field as it turns: current sensors are exchanged or inverted.
    CurrentSense,
    /// The rotor did not return to its start: it slipped or was turned.
    Slipped,
    /// The torque constant is implausible.
    TorqueConstant {
        /// Measured torque constant in N m per ampere.
        measured_nm_a: f32,
    },
    /// The inertia is implausible.
    Inertia {
        /// Measured inertia in kg m^2.
        measured_kg_m2: f32,
    },
}

/// Highest current of the measurements in amperes, with a limit of the motor's current.
pub fn max_a(limit_a: f32) -> f32 {
    const RATED_A: f32 = (constants::RATED_TORQUE.value / constants::TORQUE_CONSTANT.value) as f32;
    (MAX_SHARE * RATED_A).min(limit_a)
}

/// Measurements of one period.
#[derive(Clone, Copy, Debug)]
pub struct CommissioningInputs {
    /// Current in amperes.
    pub current: AlphaBeta,
    /// Angle of the rotor sensor in 2^-32 turns.
    pub angle: u32,
    /// Available voltage in volts.
    pub max_v: f32,
    /// See [`max_a`].
    pub max_a: f32,
}

/// Result of one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CommissioningStep {
    /// Voltage to apply.
    Drive(AlphaBeta),
    /// End of the measurement.
    Ended(Result<IdentifiedMotor, CommissioningError>),
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum CommissioningPhase {
    #[default]
    LowerLevel,
    UpperLevel,
    TurnForward,
    RestForward,
    TurnBackward,
    RestBackward,
    SquareWave,
}

/// State of the measurement.
#[derive(Clone, Copy, Debug, Default)]
pub struct Commissioning {
    phase: CommissioningPhase,
    periods: u32,
    volts: f32,
    sum_v: f32,
    sum_a: f32,
    lower: [f32; 2],
    resistance_ohm: f32,
    /// Sum of the currents in the axes of the turning field.
    along: Dq,
    /// Rotor angle after one forward turn, after both, and at rest.
    angles: [u32; 3],
    /// Rotor angle at rest after the backward rotation.
    backward_angle: u32,
    last_a: f32,
    rises: Slopes,
    falls: Slopes,
}

/// Mean of current steps.
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
    /// One period.
    pub fn tick(&mut self, inputs: &CommissioningInputs) -> CommissioningStep {
        self.periods = self.periods.saturating_add(1);
        match self.phase {
            CommissioningPhase::LowerLevel => self.level(inputs, 0),
            CommissioningPhase::UpperLevel => self.level(inputs, 1),
            CommissioningPhase::TurnForward => self.turn_forward(inputs),
            CommissioningPhase::RestForward => self.rest(inputs, CommissioningPhase::TurnBackward),
            CommissioningPhase::TurnBackward => self.turn_backward(),
            CommissioningPhase::RestBackward => self.rest(inputs, CommissioningPhase::SquareWave),
            CommissioningPhase::SquareWave => self.square_wave(inputs),
        }
    }

    fn enter(&mut self, phase: CommissioningPhase) {
        self.phase = phase;
        self.periods = 0;
    }

    /// Applies the voltage of the present level at an electrical angle.
    fn field(&self, angle: u32) -> CommissioningStep {
        let along = Dq { d: self.volts, q: 0.0 };
        CommissioningStep::Drive(along.to_stator(Direction::of(angle)))
    }

    fn level(&mut self, inputs: &CommissioningInputs, upper: usize) -> CommissioningStep {
        let [low, high] = LEVELS;
        let level_a = inputs.max_a * if upper == 0 { low } else { high };
        let volts = self.volts + INTEGRAL_GAIN * PERIOD_S * (level_a - inputs.current.alpha);
        self.volts = volts.min(MAX_V.min(inputs.max_v)).max(-MAX_V);
        if self.periods > SETTLE {
            self.sum_v += self.volts;
            self.sum_a += inputs.current.alpha;
        }
        if self.periods >= SETTLE + AVERAGE {
            const SHARE: f32 = 1.0 / AVERAGE as f32;
            let mean = [self.sum_v * SHARE, self.sum_a * SHARE];
            (self.sum_v, self.sum_a) = (0.0, 0.0);
            let [mean_v, mean_a] = mean;
            if (mean_a / level_a - 1.0).abs() > LEVEL_TOLERANCE {
                return CommissioningStep::Ended(Err(CommissioningError::NoCurrent {
                    current_a: mean_a,
                }));
            }
            if upper == 0 {
                self.lower = mean;
                self.enter(CommissioningPhase::UpperLevel);
            } else {
                let [lower_v, lower_a] = self.lower;
                let measured_ohm = (mean_v - lower_v) / (mean_a - lower_a);
                let assumed_ohm = MotorParameters::ASSUMED.resistance_ohm;
                if !MotorParameters::is_plausible(measured_ohm, assumed_ohm) {
                    return CommissioningStep::Ended(Err(CommissioningError::Resistance {
                        measured_ohm,
                    }));
                }
                self.resistance_ohm = measured_ohm;
                self.volts = mean_v;
                self.enter(CommissioningPhase::TurnForward);
            }
        }
        self.field(0)
    }

    /// Rotation of the field in 2^-32 turns.
    fn rotation(&self) -> u32 {
        const STEP: u32 = ((TURNS as u64) << 32).div_ceil(TURN as u64) as u32;
        STEP.wrapping_mul(self.periods)
    }

    fn turn_forward(&mut self, inputs: &CommissioningInputs) -> CommissioningStep {
        let Dq { d, q } = inputs.current.to_rotor(Direction::of(self.rotation()));
        self.along = Dq { d: self.along.d + d, q: self.along.q + q };
        if self.periods.is_multiple_of(WINDOW) {
            let Dq { d, q } = core::mem::take(&mut self.along);
            // False for NaN.
            let is_along = q.abs() <= DIRECTION_TOLERANCE * d;
            if !is_along {
                return CommissioningStep::Ended(Err(CommissioningError::CurrentSense));
            }
        }
        let [half, whole, _] = &mut self.angles;
        if self.periods == TURN / TURNS {
            *half = inputs.angle;
        }
        if self.periods >= TURN {
            *whole = inputs.angle;
            self.enter(CommissioningPhase::RestForward);
            return self.field(0);
        }
        self.field(self.rotation())
    }

    fn turn_backward(&mut self) -> CommissioningStep {
        if self.periods >= TURN {
            self.enter(CommissioningPhase::RestBackward);
            return self.field(0);
        }
        self.field(self.rotation().wrapping_neg())
    }

    fn rest(
        &mut self,
        inputs: &CommissioningInputs,
        then: CommissioningPhase,
    ) -> CommissioningStep {
        if self.periods >= PAUSE {
            let [.., forward] = &mut self.angles;
            match then {
                CommissioningPhase::TurnBackward => *forward = inputs.angle,
                _ => self.backward_angle = inputs.angle,
            }
            self.enter(then);
        }
        self.field(0)
    }

    fn square_wave(&mut self, inputs: &CommissioningInputs) -> CommissioningStep {
        // A current step results from the voltages of the two periods before it.
        let rises = |tick: u32| tick % 8 < 4;
        let step = inputs.current.alpha - self.last_a;
        self.last_a = inputs.current.alpha;
        let (one, two) = (self.periods.wrapping_sub(1), self.periods.wrapping_sub(2));
        if self.periods > 16 && rises(one) == rises(two) {
            let slopes = if rises(one) { &mut self.rises } else { &mut self.falls };
            slopes.add(step);
        }
        if self.periods >= WAVES {
            return CommissioningStep::Ended(self.result());
        }
        let wave = if rises(self.periods) { WAVE_V } else { -WAVE_V };
        CommissioningStep::Drive(AlphaBeta { alpha: self.volts + wave, beta: 0.0 })
    }

    fn result(&self) -> Result<IdentifiedMotor, CommissioningError> {
        let slope = self.rises.sum / self.rises.count - self.falls.sum / self.falls.count;
        let inductance_h = 2.0 * WAVE_V * PERIOD_S / slope;
        if !MotorParameters::is_plausible(inductance_h, MotorParameters::ASSUMED.inductance_h) {
            return Err(CommissioningError::Inductance { measured_h: inductance_h });
        }
        let (pole_pairs, is_swapped) = self.pole_pairs()?;
        Ok(IdentifiedMotor {
            resistance_ohm: self.resistance_ohm,
            inductance_h,
            pole_pairs,
            wiring: MotorWiring { offset: self.offset(pole_pairs)?, is_swapped },
            ..IdentifiedMotor::ASSUMED
        })
    }

    /// Pole pairs, and whether the rotor turned against the field, from the second forward turn, during which the
    /// lag by friction is constant.
    fn pole_pairs(&self) -> Result<(u8, bool), CommissioningError> {
        let [half, whole, _] = self.angles;
        let turned = whole.wrapping_sub(half) as i32 as f32 / TURN_UNITS;
        if turned.abs() * MAX_POLE_PAIRS < 0.5 {
            return Err(CommissioningError::Stuck);
        }
        let measured = 1.0 / turned.abs();
        let nearest = (measured + 0.5) as u8;
        if nearest == 0 || (measured - f32::from(nearest)).abs() > POLE_PAIR_TOLERANCE {
            return Err(CommissioningError::PolePairs { measured });
        }
        Ok((nearest, turned < 0.0))
    }

    /// Offset of the sensor from the mean of both rest positions.
    fn offset(&self, pole_pairs: u8) -> Result<u32, CommissioningError> {
        let [.., forward] = self.angles;
        let forward = forward.wrapping_mul(pole_pairs.into());
        let backward = self.backward_angle.wrapping_mul(pole_pairs.into());
        let difference = backward.wrapping_sub(forward) as i32;
        if difference.unsigned_abs() as f32 > REST_TOLERANCE * TURN_UNITS {
            return Err(CommissioningError::Slipped);
        }
        Ok(forward.wrapping_add((difference / 2) as u32).wrapping_neg())
    }
}

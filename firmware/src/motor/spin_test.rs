//! Spin test: measures torque constant, inertia and dry friction of the drive, after resistance and inductance are known.
//!
//! A slowly rising current finds the friction. Then a current of constant magnitude reverses whenever the rotor reaches
//! `TURN_BACK`, which works for any inertia and torque constant. A line through the voltages over the speed has the torque
//! constant as its slope; errors of resistance and dead time add a voltage with the sign of the current, which the fit separates. The
//! rotor accelerates with the difference of torque and friction, and slows down with their sum.

use crate::motor::commissioning::CommissioningError;
use crate::motor::diagnostics::{ElectricalSample, voltage_residual};
use crate::motor::settings::{IdentifiedMotor, MotorParameters};
use crate::motor::timing::PERIOD_S;

/// Rise of the current in amperes per second until the rotor turns.
const RISE_A_S: f32 = 1.0;
/// Rotor speed in rad/s at which it turns.
const TURNS: f32 = 6.0;
/// Current that reverses, relative to the one that turned the rotor.
const EXCESS: f32 = 1.5;
/// Rotor speed in rad/s at which the current reverses; the fingers move by less than a millimetre.
const TURN_BACK: f32 = 20.0;
/// Speeds relative to it between which the acceleration is measured: friction differs at rest, and the tracker lags a reversal.
const WINDOW: core::ops::Range<f32> = 0.3..0.9;
/// Reversals that are measured.
const REVERSALS: u8 = 9;
/// Periods after which the test fails: 6 s.
const TIMEOUT: u32 = 120_000;

/// Result of one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SpinStep {
    /// Set-point of the q current in amperes.
    Drive(f32),
    /// End of the test.
    Ended(Result<IdentifiedMotor, CommissioningError>),
}

/// Change of the speed in a direction relative to that of the current.
#[derive(Clone, Copy, Debug, Default)]
struct Slope {
    change: f32,
    periods: f32,
}

impl Slope {
    /// Acceleration in rad/s^2.
    fn mean(&self) -> f32 {
        self.change / (self.periods * PERIOD_S)
    }
}

/// Sums of a straight line through points.
#[derive(Clone, Copy, Debug)]
struct Fit {
    count: f32,
    x: f32,
    y: f32,
    xx: f32,
    xy: f32,
}

impl Fit {
    const NONE: Self = Self { count: 0.0, x: 0.0, y: 0.0, xx: 0.0, xy: 0.0 };

    fn add(&mut self, x: f32, y: f32) {
        self.count += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
    }

    fn slope(&self) -> f32 {
        (self.count * self.xy - self.x * self.y) / (self.count * self.xx - self.x * self.x)
    }
}

/// State of the test.
#[derive(Clone, Copy, Debug)]
pub struct SpinTest {
    found: IdentifiedMotor,
    max_a: f32,
    periods: u32,
    /// Set-point, with its sign.
    current_a: f32,
    /// Count once the rotor has turned.
    reversals: Option<u8>,
    last_speed: f32,
    fit: Fit,
    /// While it slows down, and while it accelerates.
    slopes: [Slope; 2],
    /// Sum of the measured current in the direction of the set-point, over the periods of both slopes.
    sum_a: f32,
}

impl SpinTest {
    /// For a motor with measured windings, with at most this current.
    pub const fn new(found: IdentifiedMotor, max_a: f32) -> Self {
        Self {
            found,
            max_a,
            periods: 0,
            current_a: 0.0,
            reversals: None,
            last_speed: 0.0,
            fit: Fit::NONE,
            slopes: [Slope { change: 0.0, periods: 0.0 }; 2],
            sum_a: 0.0,
        }
    }

    /// One period, with a rotor speed in rad/s and the electrical quantities, of which the set-point is not used.
    pub fn tick(
        &mut self,
        speed: f32,
        sample: &ElectricalSample,
        machine: &MotorParameters,
    ) -> SpinStep {
        self.periods = self.periods.saturating_add(1);
        if self.periods > TIMEOUT {
            return SpinStep::Ended(Err(CommissioningError::Stuck));
        }
        match self.reversals {
            None if speed.abs() > TURNS => {
                self.current_a = (EXCESS * self.current_a).min(self.max_a);
                self.reversals = Some(0);
            }
            None if self.current_a >= self.max_a => {
                return SpinStep::Ended(Err(CommissioningError::Stuck));
            }
            None => self.current_a += RISE_A_S * PERIOD_S,
            Some(count) => {
                let direction = self.current_a.signum();
                if count > 0 {
                    self.measure(direction, speed, sample, machine);
                }
                if direction * speed > TURN_BACK {
                    if count >= REVERSALS {
                        return SpinStep::Ended(self.result());
                    }
                    self.current_a = -self.current_a;
                    self.reversals = Some(count + 1);
                }
            }
        }
        self.last_speed = speed;
        SpinStep::Drive(self.current_a)
    }

    fn measure(
        &mut self,
        direction: f32,
        speed: f32,
        sample: &ElectricalSample,
        machine: &MotorParameters,
    ) {
        self.fit.add(direction * speed, direction * voltage_residual(sample, machine, 0.0).q);
        if WINDOW.contains(&(speed.abs() / TURN_BACK)) {
            let [slows, accelerates] = &mut self.slopes;
            let slope = if direction * speed < 0.0 { slows } else { accelerates };
            slope.change += direction * (speed - self.last_speed);
            slope.periods += 1.0;
            self.sum_a += direction * sample.measured.q;
        }
    }

    fn result(&self) -> Result<IdentifiedMotor, CommissioningError> {
        let torque_nm_a = 1.5 * self.fit.slope();
        if !MotorParameters::is_plausible(torque_nm_a, MotorParameters::ASSUMED.torque_nm_a) {
            return Err(CommissioningError::TorqueConstant { measured_nm_a: torque_nm_a });
        }
        let [slows, accelerates] = &self.slopes;
        let torque_nm = torque_nm_a * self.sum_a / (slows.periods + accelerates.periods);
        let (slows, accelerates) = (slows.mean(), accelerates.mean());
        let inertia_kg_m2 = 2.0 * torque_nm / (slows + accelerates);
        if !MotorParameters::is_plausible(inertia_kg_m2, MotorParameters::ASSUMED.inertia_kg_m2) {
            return Err(CommissioningError::Inertia { measured_kg_m2: inertia_kg_m2 });
        }
        let dry_nm = (0.5 * inertia_kg_m2 * (slows - accelerates)).max(0.0);
        Ok(IdentifiedMotor { torque_nm_a, inertia_kg_m2, dry_nm, ..self.found })
    }
}

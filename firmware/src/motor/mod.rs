//! The motor: from what is sensed in a period of the pulses to what the switches do in the next.
//!
//! - [`stage`]: the border to what switches and senses.
//! - [`as5047`]: a sensor of the rotor's angle.
//! - [`number`]: arithmetic that hides nothing.
//! - [`transform`]: phases and turning axes.
//! - [`pi`]: controllers that know of limits.
//! - [`svpwm`]: voltages into duties.
//! - [`sensing`]: counts into amperes.
//! - [`limits`], [`screw`], [`settings`]: what is known and allowed.
//! - [`encoder`]: place and speed of the rotor.
//! - [`current`], [`speed`], [`position`] with [`trajectory`]: the loops, each on top of the one before.
//! - [`plausible`]: whether what is sensed fits together.
//! - [`regeneration`]: what comes back while braking.
//! - [`commission`], [`selflock`], [`calibration`]: what the device measures of itself.
//! - [`state`]: what is asked, done and told.
//!
//! - [`Inner`], [`Outer`]: the two ticks, 20 kHz and 4 kHz, with [`handed`] between them.
//!
//! On the board each tick is an interrupt, and the inner one interrupts the outer; a simulation calls
//! [`Motor::period`]. Orders may come at any time; a grasp gives a set-point each millisecond. Whatever is not a
//! number ends with all switches off and [`Trip::NotANumber`].

pub mod as5047;
pub mod calibration;
pub mod commission;
pub mod current;
pub mod encoder;
pub mod handed;
mod inner;
pub mod limits;
pub mod number;
mod outer;
pub mod pi;
pub mod plausible;
pub mod position;
pub mod regeneration;
pub mod screw;
pub mod selflock;
pub mod sensing;
pub mod settings;
pub mod speed;
pub mod stage;
pub mod state;
pub mod svpwm;
#[cfg(test)]
mod tests;
pub mod trajectory;
pub mod transform;

pub use inner::Inner;
pub use outer::Outer;
pub use settings::Settings;
pub use state::{Order, Setpoint, State, Telling, Trip};

use commission::Found;
use handed::Ask;
use stage::{PowerStage, Sensed};

use crate::params;

/// One period of the pulses in seconds.
pub const PERIOD_S: f32 = (1e-3 / params::PWM_RATE.value) as f32;
/// Periods from one tick of the outer loops to the next.
pub const MOTION_PERIODS: u8 = 5;
/// Rate of the outer loops.
pub const MOTION_HZ: f64 = params::PWM_RATE.value * 1e3 / MOTION_PERIODS as f64;

/// Periods from one repetition of an order to the next: a millisecond.
const REPEATED_PERIODS: u8 = (1e-3 * params::PWM_RATE.value * 1e3) as u8;

/// Both ticks of the motor's control, one after the other, and somebody who gives the last set-point again each
/// millisecond, as a grasp does. A simulation calls [`Motor::period`].
#[derive(Clone, Copy, Debug)]
pub struct Motor {
    inner: Inner,
    outer: Outer,
    /// What the outer tick said, to be heard in the next period.
    ask: Option<Ask>,
    setpoint: Option<Setpoint>,
    periods: u8,
    since_order: u8,
}

impl Motor {
    /// Disarmed.
    pub fn new(settings: Settings) -> Self {
        Self {
            inner: Inner::new(settings),
            outer: Outer::new(settings),
            ask: None,
            setpoint: None,
            periods: 0,
            since_order: 0,
        }
    }

    /// One period: sets the switches, and every [`MOTION_PERIODS`] calls goes on with the outer loops.
    pub fn period(&mut self, sensed: &Sensed, stage: &mut impl PowerStage) {
        self.since_order = self.since_order.saturating_add(1);
        if self.since_order >= REPEATED_PERIODS
            && let Some(setpoint) = self.setpoint
        {
            self.obey(Order::Do(setpoint));
        }
        if let Some(ask) = self.ask.take() {
            self.inner.hear(ask);
        }
        stage.drive(self.inner.tick(sensed));
        self.periods = self.periods.saturating_add(1);
        if self.periods >= MOTION_PERIODS {
            self.periods = 0;
            if let Some(found) = self.inner.take_found() {
                self.outer.adopt(found);
            }
            self.ask = Some(self.outer.tick(self.inner.felt()));
        }
    }

    /// Does what an order says: [`Outer::obey`].
    pub fn obey(&mut self, order: Order) {
        match order {
            Order::Do(setpoint) => (self.setpoint, self.since_order) = (Some(setpoint), 0),
            Order::Disarm => self.setpoint = None,
            Order::Arm | Order::Commission | Order::Opening { .. } | Order::Temperatures(_) => {}
        }
        let Some(urgent) = self.outer.obey(order) else {
            return;
        };
        if let Some(earlier) = self.ask.replace(urgent) {
            self.inner.hear(earlier);
        }
    }

    /// The power stage has switched itself off, by its break input.
    pub fn shut_off(&mut self) {
        self.inner.shut_off();
    }

    /// What commissioning found last, to be stored.
    pub const fn found(&self) -> Option<Found> {
        self.outer.found()
    }

    /// What it does now.
    pub fn telling(&self) -> Telling {
        self.outer.tell(&self.inner.feels())
    }
}

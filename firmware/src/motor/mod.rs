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
//! [`Motor::current_tick`] runs at 20 kHz, [`Motor::motion_tick`] at 4 kHz once the switches are set: together
//! [`Motor::period`]. A set-point may come at any time; a grasp sets one each millisecond. Whatever is not a
//! number ends with all switches off and [`Trip::NotANumber`].

pub mod as5047;
pub mod calibration;
pub mod commission;
pub mod current;
pub mod encoder;
pub mod limits;
mod motion;
pub mod number;
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
mod tick;
pub mod trajectory;
pub mod transform;

pub use settings::Settings;
pub use state::{Order, Setpoint, State, Telling, Trip};

use commission::{Commissioning, Found, Next, Seen};
use current::{CurrentLoop, Decided, Windings};
use encoder::{Place, Tracker};
use limits::{Active, Around, Bounds, Heat, Limit, Temperatures};
use number::{Direction, greater, within};
use plausible::{Runaway, Seen as Driven, SupplyWatch, Watch};
use position::PositionLoop;
use screw::Play;
use sensing::{Offsets, Zeroing};
use speed::SpeedLoop;
use stage::{Drive, PowerStage, Sensed};
use transform::{AlphaBeta, Dq};

use crate::params;

/// One period of the pulses in seconds.
pub const PERIOD_S: f32 = (1e-3 / params::PWM_RATE.value) as f32;
/// Periods from one tick of the outer loops to the next.
pub const MOTION_PERIODS: u8 = 5;
/// Rate of the outer loops.
pub const MOTION_HZ: f64 = params::PWM_RATE.value * 1e3 / MOTION_PERIODS as f64;
/// From the middle of a period, where is sensed, to the middle of the next, about which a voltage acts.
const DELAY_S: f32 = PERIOD_S;
/// Without this bus voltage, in volts, the switches' drivers do not work.
const DEAD_BUS_V: f32 = 8.0;

/// Where the fingers are.
#[derive(Clone, Copy, Debug)]
struct Home {
    place: Place,
    opening_mm: f32,
    play: Play,
}

/// The motor's control. A board's interrupt or a simulation calls [`Motor::period`].
#[derive(Clone, Copy, Debug)]
pub struct Motor {
    settings: Settings,
    windings: Windings,
    speed_gains: pi::Gains,
    state: State,
    setpoint: Setpoint,
    offsets: Offsets,
    zeroing: Zeroing,
    /// Under way, or about to be once the offsets are taken.
    commissioning: Option<Commissioning>,
    found: Option<Found>,
    tracker: Tracker,
    home: Option<Home>,
    currents: CurrentLoop,
    speed: SpeedLoop,
    position: Option<PositionLoop>,
    heat: Heat,
    temperatures: Temperatures,
    bounds: Bounds,
    rotor: Direction,
    measured: Dq,
    asked: Dq,
    decided: Decided,
    bus_v: f32,
    opening_mm: Option<f32>,
    /// The bus is too high: the windings are shorted until it has fallen.
    is_shorted: bool,
    held_by: Active,
    watch: Watch,
    runaway: Runaway,
    supply: SupplyWatch,
    periods: u8,
}

impl Motor {
    /// Disarmed.
    pub fn new(settings: Settings) -> Self {
        Self {
            windings: Windings::of(&settings.machine),
            speed_gains: speed::gains(&settings.machine),
            settings,
            state: State::Disarmed,
            setpoint: Setpoint::Off,
            offsets: Offsets::NOMINAL,
            zeroing: Zeroing::default(),
            commissioning: None,
            found: None,
            tracker: Tracker::default(),
            home: None,
            currents: CurrentLoop::default(),
            speed: SpeedLoop::default(),
            position: None,
            heat: Heat::default(),
            temperatures: Temperatures::default(),
            bounds: Bounds::default(),
            rotor: Direction::default(),
            measured: Dq::default(),
            asked: Dq::default(),
            decided: Decided::default(),
            bus_v: 0.0,
            opening_mm: None,
            is_shorted: false,
            held_by: Active::default(),
            watch: Watch::default(),
            runaway: Runaway::default(),
            supply: SupplyWatch::default(),
            periods: 0,
        }
    }

    /// One period: sets the switches, and every [`MOTION_PERIODS`] calls goes on with the outer loops.
    pub fn period(&mut self, sensed: &Sensed, stage: &mut impl PowerStage) {
        stage.drive(self.current_tick(sensed));
        self.periods = self.periods.saturating_add(1);
        if self.periods >= MOTION_PERIODS {
            self.periods = 0;
            self.motion_tick();
        }
    }

    /// Follows set-points once the currents' offsets are taken, 26 ms: [`State::Armed`] tells when. Nothing
    /// where the motor is not disarmed; a trip where its settings are unsound.
    pub fn arm(&mut self) {
        if let State::Disarmed | State::Refused(_) = self.state {
            self.state = State::Arming;
            self.setpoint = Setpoint::Off;
            self.zeroing = Zeroing::default();
            self.commissioning = None;
            if !self.settings.is_sound() {
                self.trip(Trip::NotANumber);
            }
        }
    }

    /// Measures windings, phases and sensor, 3 s; nothing may be gripped. Ends disarmed with
    /// [`Self::found`], which holds from then on, or in [`State::Refused`].
    pub fn commission(&mut self) {
        self.arm();
        if self.state == State::Arming {
            self.commissioning = Some(Commissioning::default());
        }
    }

    /// What commissioning found last, to be stored.
    pub const fn found(&self) -> Option<Found> {
        self.found
    }

    /// Everything off; the only way out of a trip.
    pub fn disarm(&mut self) {
        self.state = State::Disarmed;
        self.setpoint = Setpoint::Off;
        self.commissioning = None;
        self.rest();
    }

    /// What is to be done from now on; while not armed nothing.
    pub fn command(&mut self, setpoint: Setpoint) {
        if self.state != State::Armed {
            return;
        }
        if !setpoint.is_finite() {
            self.trip(Trip::NotANumber);
            return;
        }
        if let Setpoint::Current { .. } | Setpoint::Off | Setpoint::Brake = self.setpoint {
            // The speed loop takes over what flows.
            self.speed = SpeedLoop::start(self.asked.q);
        }
        match (setpoint, self.position) {
            (Setpoint::Position { .. }, None) => self.start_position(),
            (Setpoint::Position { .. }, Some(_)) => {}
            _ => self.position = None,
        }
        self.setpoint = setpoint;
    }

    /// The fingers are this far apart now, in millimetres, the flanks of the screws that close touching: from
    /// a homing, or from what was stored.
    pub fn set_opening(&mut self, opening_mm: f32) {
        self.home = opening_mm.is_finite().then(|| Home {
            place: self.tracker.place(),
            opening_mm,
            play: Play::new(opening_mm),
        });
        self.position = None;
        if let Setpoint::Position { .. } = self.setpoint {
            self.start_position();
        }
    }

    /// Temperatures, as often as they are measured.
    pub fn set_temperatures(&mut self, temperatures: Temperatures) {
        self.temperatures = temperatures;
    }

    /// Does what an order says.
    pub fn obey(&mut self, order: Order) {
        match order {
            Order::Arm => self.arm(),
            Order::Commission => self.commission(),
            Order::Disarm => self.disarm(),
            Order::Do(setpoint) => self.command(setpoint),
            Order::Opening { opening_mm } => self.set_opening(opening_mm),
            Order::Temperatures(temperatures) => self.set_temperatures(temperatures),
        }
    }

    /// The power stage has switched itself off, by its break input.
    pub fn shut_off(&mut self) {
        if !matches!(self.state, State::Tripped(_)) {
            self.trip(Trip::PowerStage);
        }
    }

    /// What it is set to, commissioning's results in it.
    pub const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// What it does now.
    pub fn telling(&self) -> Telling {
        let speed = self.tracker.speed();
        let mut limits = self.bounds.reasons.and(self.held_by);
        limits.set(Limit::Voltage, self.decided.is_limited);
        Telling {
            state: self.state,
            opening_mm: self.opening_mm,
            asked_mm: self.position.map(|position| position.asked_mm()),
            closing_mm_s: self.settings.screw.closing_mm_s(speed),
            turned_rad: self.tracker.turned_since(Place::default()),
            speed,
            angle_rad: self.tracker.angle_rad(),
            electrical: self.rotor,
            current: self.measured,
            asked: self.asked,
            voltage: self.decided.voltage,
            bus_v: self.bus_v,
            supply: self.supply.told(),
            is_hot: self.bounds.is_hot,
            limits,
            found: self.found,
        }
    }

    /// The rotor's place as an opening, the screw's play not counted.
    fn rotor_mm(&self) -> Option<f32> {
        let home = self.home?;
        let turned = self.tracker.turned_since(home.place);
        Some(home.opening_mm - turned * self.settings.screw.ratio_mm)
    }

    fn start_position(&mut self) {
        let opening_mm_s = -self.settings.screw.closing_mm_s(self.tracker.speed());
        let start = |opening_mm| PositionLoop::start(opening_mm, opening_mm_s);
        self.position = self.rotor_mm().map(start);
    }

    /// Forgets what the loops have gathered.
    fn rest(&mut self) {
        self.watch.rest();
        self.runaway = Runaway::default();
        self.currents = CurrentLoop::default();
        self.speed = SpeedLoop::default();
        self.asked = Dq::default();
        self.decided = Decided::default();
    }

    fn trip(&mut self, trip: Trip) -> Drive {
        self.state = State::Tripped(trip);
        self.setpoint = Setpoint::Off;
        self.commissioning = None;
        self.position = None;
        self.rest();
        trip.drive()
    }
}

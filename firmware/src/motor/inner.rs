//! The inner tick, 20 kHz: from what is sensed to what the switches do.

use super::commission::{Commissioning, Found, Next, Seen};
use super::current::{CurrentLoop, Decided, Windings};
use super::encoder::Tracker;
use super::handed::{Action, Ask, Change, Felt};
use super::number::{Direction, greater};
use super::plausible::Watch;
use super::sensing::{self, Offsets, Zeroing};
use super::settings::Settings;
use super::stage::{Drive, Sensed};
use super::state::{State, Trip};
use super::svpwm;
use super::transform::{AlphaBeta, Dq};
use super::{MOTION_PERIODS, PERIOD_S};

/// From the middle of a period, where is sensed, to the middle of the next, about which a voltage acts.
const DELAY_S: f32 = PERIOD_S;
/// Without this bus voltage, in volts, the switches' drivers do not work.
const DEAD_BUS_V: f32 = 8.0;
/// Periods without a word from the outer tick that are borne: it has missed its turn three times.
const UNLED: u8 = 3 * MOTION_PERIODS;

/// The current loop, what watches over it, and the motor's state.
#[derive(Clone, Copy, Debug)]
pub struct Inner {
    pub(super) settings: Settings,
    pub(super) windings: Windings,
    pub(super) state: State,
    pub(super) action: Action,
    offsets: Offsets,
    zeroing: Zeroing,
    /// Under way, or about to be once the offsets are taken.
    commissioning: Option<Commissioning>,
    found: Option<Found>,
    tracker: Tracker,
    currents: CurrentLoop,
    rotor: Direction,
    measured: Dq,
    /// What was measured a period before.
    before: Dq,
    decided: Decided,
    /// The voltage that acted between.
    acted: Dq,
    watch: Watch,
    bus_v: f32,
    is_shorted: bool,
    is_let_go: bool,
    is_lost: bool,
    /// Periods since the outer tick was heard.
    unled: u8,
}

impl Inner {
    /// Disarmed.
    pub fn new(settings: Settings) -> Self {
        Self {
            windings: Windings::of(&settings.machine),
            settings,
            state: State::Disarmed,
            action: Action::Off,
            offsets: Offsets::NOMINAL,
            zeroing: Zeroing::default(),
            commissioning: None,
            found: None,
            tracker: Tracker::default(),
            currents: CurrentLoop::default(),
            rotor: Direction::default(),
            measured: Dq::default(),
            before: Dq::default(),
            decided: Decided::default(),
            acted: Dq::default(),
            watch: Watch::default(),
            bus_v: 0.0,
            is_shorted: false,
            is_let_go: false,
            is_lost: false,
            unled: 0,
        }
    }

    /// Does from now on what the outer tick asks.
    pub fn hear(&mut self, ask: Ask) {
        self.unled = 0;
        match ask.change {
            None => {}
            Some(Change::Arm) => self.arm(None),
            Some(Change::Commission) => self.arm(Some(Commissioning::default())),
            Some(Change::Disarm) => self.disarm(),
            Some(Change::Trip(trip)) => {
                self.trip(trip);
            }
        }
        self.action = match self.state {
            State::Armed => ask.action,
            _ => Action::Off,
        };
    }

    /// What the outer tick is told.
    pub fn felt(&mut self) -> Felt {
        let felt = self.feels();
        self.is_let_go = false;
        self.is_lost = false;
        felt
    }

    /// What it feels now.
    pub(super) fn feels(&self) -> Felt {
        Felt {
            state: self.state,
            rotor: self.tracker,
            current: self.measured,
            before: self.before,
            voltage: self.acted,
            is_limited: self.decided.is_limited,
            bus_v: self.bus_v,
            is_shorted: self.is_shorted,
            is_let_go: self.is_let_go,
            is_lost: self.is_lost,
        }
    }

    /// What commissioning has found since the last time, for [`super::Outer::adopt`].
    pub fn take_found(&mut self) -> Option<Found> {
        self.found.take()
    }

    /// The power stage has switched itself off, by its break input.
    pub fn shut_off(&mut self) {
        if !matches!(self.state, State::Tripped(_)) {
            self.trip(Trip::PowerStage);
        }
    }

    /// What the switches do in the next period. To be called in each, in the middle of which `sensed` was
    /// sensed.
    pub fn tick(&mut self, sensed: &Sensed) -> Drive {
        self.unled = self.unled.saturating_add(1);
        self.bus_v = sensing::bus_v(sensed);
        let tracked = self
            .tracker
            .take(sensed.angle, self.settings.angle_age_periods);
        self.is_lost |= tracked.is_err();
        let phases = self.swapped(self.offsets.amperes(sensed));
        let known = match self.state {
            State::Tripped(trip) => return trip.drive(),
            State::Arming => return self.take_offsets(sensed),
            State::Disarmed | State::Refused(_) => Ok(()),
            State::Armed | State::Commissioning => tracked
                .map_err(|_| Trip::Encoder)
                .and(self.check(sensed, phases))
                .and(self.fits(sensed, phases)),
        };
        let current = AlphaBeta::of_phases(phases);
        match (known, self.state) {
            (Err(trip), _) => self.trip(trip),
            (_, State::Armed) => self.act(phases, current),
            (_, State::Commissioning) => self.measure(phases, current),
            _ => {
                self.see(current);
                Drive::Off
            }
        }
    }

    fn arm(&mut self, commissioning: Option<Commissioning>) {
        if let State::Disarmed | State::Refused(_) = self.state {
            self.state = State::Arming;
            self.zeroing = Zeroing::default();
            self.commissioning = commissioning;
            if !self.settings.is_sound() {
                self.trip(Trip::NotANumber);
            }
        }
    }

    fn disarm(&mut self) {
        self.state = State::Disarmed;
        self.commissioning = None;
        self.let_go();
    }

    fn trip(&mut self, trip: Trip) -> Drive {
        self.state = State::Tripped(trip);
        self.commissioning = None;
        self.let_go();
        trip.drive()
    }

    /// Forgets what the loops have gathered.
    fn let_go(&mut self) {
        self.currents = CurrentLoop::default();
        self.decided = Decided::default();
        self.is_let_go = true;
    }

    /// Phases V and W change places where they are wired so; twice is as before. Commissioning finds out anew.
    fn swapped(&self, [u, v, w]: [f32; 3]) -> [f32; 3] {
        let commissions = matches!(self.state, State::Commissioning);
        match self.settings.wiring.is_swapped && !commissions {
            true => [u, w, v],
            false => [u, v, w],
        }
    }

    /// What must hold while the switches may be on.
    fn check(&self, sensed: &Sensed, phases: [f32; 3]) -> Result<(), Trip> {
        let limits = &self.settings.limits;
        let speed = self.tracker.speed();
        let [u, v, w] = phases;
        if !(u + v + w + speed).is_finite() {
            return Err(Trip::NotANumber);
        }
        let greatest_a = greater(u.abs(), greater(v.abs(), w.abs()));
        if sensing::is_at_end(sensed) || greatest_a > limits.trip_a {
            return Err(Trip::OverCurrent);
        }
        if self.unled > UNLED {
            return Err(Trip::Unled);
        }
        match speed.abs() > limits.trip_speed {
            true => Err(Trip::OverSpeed),
            false => Ok(()),
        }
    }

    /// What must fit together once the currents' offsets are known; commissioning looks for itself.
    fn fits(&mut self, sensed: &Sensed, phases: [f32; 3]) -> Result<(), Trip> {
        match self.state {
            State::Armed => self.watch.note(sensed, phases, &self.settings.limits),
            _ => Ok(()),
        }
    }

    fn take_offsets(&mut self, sensed: &Sensed) -> Drive {
        match self.zeroing.take(sensed) {
            None => Drive::Off,
            Some(Err(_)) => self.trip(Trip::CurrentSense),
            Some(Ok(_)) if !self.tracker.is_known() => self.trip(Trip::Encoder),
            Some(Ok(offsets)) => {
                self.offsets = offsets;
                self.let_go();
                self.state = match self.commissioning {
                    Some(_) => State::Commissioning,
                    None => State::Armed,
                };
                Drive::Off
            }
        }
    }

    /// The currents as seen from the rotor.
    #[inline(always)] // A call costs as much as it saves.
    fn see(&mut self, current: AlphaBeta) {
        self.rotor = Direction::of(self.tracker.electrical(&self.settings));
        self.before = self.measured;
        self.measured = current.turning(self.rotor);
        self.acted = self.decided.voltage;
    }

    fn act(&mut self, phases: [f32; 3], current: AlphaBeta) -> Drive {
        self.see(current);
        let limits = &self.settings.limits;
        let [_, burns] = limits.burn_v;
        self.is_shorted = self.bus_v > limits.high_v || (self.is_shorted && self.bus_v > burns);
        let still = match self.action {
            Action::Off => Drive::Off,
            _ if self.bus_v < DEAD_BUS_V => Drive::Off,
            _ if self.is_shorted => Drive::Brake,
            Action::Brake => Drive::Brake,
            Action::Follow(asked) => return self.follow(asked, phases),
        };
        self.let_go();
        still
    }

    fn follow(&mut self, asked: Dq, phases: [f32; 3]) -> Drive {
        let speed = self.tracker.speed() * f32::from(self.settings.machine.pole_pairs);
        self.decided = self.currents.decide(
            &self.windings,
            asked,
            self.measured,
            speed,
            svpwm::greatest_v(self.bus_v),
        );
        let voltage = self
            .decided
            .voltage
            .fixed(self.rotor.turned(speed * DELAY_S));
        self.switch(voltage, phases)
    }

    fn measure(&mut self, phases: [f32; 3], current: AlphaBeta) -> Drive {
        self.see(current);
        let Some(commissioning) = &mut self.commissioning else {
            return self.trip(Trip::NotANumber);
        };
        let seen = Seen {
            alpha_a: current.alpha,
            angle: self.tracker.angle(),
            greatest_v: svpwm::greatest_v(self.bus_v),
        };
        match commissioning.tick(&seen) {
            Next::Drive(voltage) => self.switch(voltage, phases),
            Next::Ended(result) => {
                self.disarm();
                match result {
                    Ok(found) => self.adopt(found),
                    Err(refusal) => self.state = State::Refused(refusal),
                }
                Drive::Off
            }
        }
    }

    fn adopt(&mut self, found: Found) {
        self.found = Some(found);
        self.settings.adopt(&found);
        self.windings = Windings::of(&self.settings.machine);
    }

    /// Duties for a voltage; what is no number ends here.
    fn switch(&mut self, voltage: AlphaBeta, phases: [f32; 3]) -> Drive {
        let duties = svpwm::with_dead_time(svpwm::duties(voltage, self.bus_v), phases);
        let [u, v, w] = duties;
        match (u + v + w).is_finite() {
            true => Drive::Duty(self.swapped(duties)),
            false => self.trip(Trip::NotANumber),
        }
    }
}

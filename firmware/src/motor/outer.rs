//! The outer tick, 4 kHz: from orders to the currents that the inner one follows.

use super::commission::Found;
use super::encoder::Place;
use super::handed::{Action, Ask, Change, Felt};
use super::limits::{Active, Around, Bounds, Heat, Limit, Temperatures};
use super::number::{Direction, greater, within};
use super::plausible::{Fit, Runaway, Seen, SupplyWatch};
use super::position::PositionLoop;
use super::regeneration;
use super::screw::Play;
use super::settings::Settings;
use super::speed::{self, SpeedLoop};
use super::state::{Order, Setpoint, State, Telling, Trip};
use super::svpwm;
use super::transform::Dq;
use super::{MOTION_HZ, pi};

/// Ticks for which a current or a speed is followed without being asked for again, 5 ms: the grasp does it each
/// millisecond. A place is where the way ends by itself.
const UNASKED: u8 = 20;

/// Where the fingers are.
#[derive(Clone, Copy, Debug)]
struct Home {
    place: Place,
    opening_mm: f32,
    play: Play,
}

/// Orders, bounds, and the loops of speed and place.
#[derive(Clone, Copy, Debug)]
pub struct Outer {
    pub(super) settings: Settings,
    speed_gains: pi::Gains,
    felt: Felt,
    setpoint: Setpoint,
    /// Ticks since it was given.
    unasked: u8,
    home: Option<Home>,
    pub(super) speed: SpeedLoop,
    position: Option<PositionLoop>,
    heat: Heat,
    temperatures: Temperatures,
    bounds: Bounds,
    pub(super) asked: Dq,
    opening_mm: Option<f32>,
    held_by: Active,
    found: Option<Found>,
    fit: Fit,
    runaway: Runaway,
    supply: SupplyWatch,
}

impl Outer {
    /// Nothing is asked.
    pub fn new(settings: Settings) -> Self {
        Self {
            speed_gains: speed::gains(&settings.machine),
            settings,
            felt: Felt::default(),
            setpoint: Setpoint::Off,
            unasked: 0,
            home: None,
            speed: SpeedLoop::default(),
            position: None,
            heat: Heat::default(),
            temperatures: Temperatures::default(),
            bounds: Bounds::default(),
            asked: Dq::default(),
            opening_mm: None,
            held_by: Active::default(),
            found: None,
            fit: Fit::default(),
            runaway: Runaway::default(),
            supply: SupplyWatch::default(),
        }
    }

    /// Does what an order says, from the next tick on; what needs no loop does not wait for it, and is for the
    /// inner tick to hear at once. While the motor is not armed, a set-point is nothing.
    pub fn obey(&mut self, order: Order) -> Option<Ask> {
        let change = match order {
            Order::Arm => Some(Change::Arm),
            Order::Commission => Some(Change::Commission),
            Order::Disarm => {
                self.setpoint = Setpoint::Off;
                Some(Change::Disarm)
            }
            Order::Do(setpoint) => self.follow(setpoint).err().map(Change::Trip),
            Order::Opening { opening_mm } => {
                self.set_opening(opening_mm);
                return None;
            }
            Order::Temperatures(temperatures) => {
                self.temperatures = temperatures;
                return None;
            }
        };
        let action = match self.setpoint {
            Setpoint::Brake => Some(Action::Brake),
            Setpoint::Off => Some(Action::Off),
            Setpoint::Current { .. } | Setpoint::Speed { .. } | Setpoint::Position { .. } => None,
        };
        (change.is_some() || action.is_some()).then_some(Ask {
            change,
            action: action.unwrap_or_default(),
        })
    }

    /// Goes on by a tick with what the inner one felt.
    pub fn tick(&mut self, felt: Felt) -> Ask {
        const SECONDS: f32 = 1.0 / MOTION_HZ as f32;
        self.take(felt);
        let limits = self.settings.limits;
        self.heat.add(&limits, felt.current.squared(), SECONDS);
        let rotor_mm = self.rotor_mm();
        let screw = &self.settings.screw;
        self.opening_mm = rotor_mm.and_then(|rotor_mm| {
            let home = self.home.as_mut()?;
            Some(home.play.opening_mm(screw, rotor_mm))
        });
        self.held_by = Active::default();
        let acted = match felt.state {
            State::Armed => self.judge().and_then(|()| self.act(rotor_mm)),
            _ => Ok(Action::Off),
        };
        match acted {
            Ok(action) => Ask {
                change: None,
                action,
            },
            Err(trip) => Ask {
                change: Some(Change::Trip(trip)),
                action: Action::Off,
            },
        }
    }

    /// Takes over what commissioning found.
    pub fn adopt(&mut self, found: Found) {
        self.found = Some(found);
        self.settings.adopt(&found);
    }

    /// What commissioning found last, to be stored.
    pub const fn found(&self) -> Option<Found> {
        self.found
    }

    /// What the motor does, as felt last.
    pub fn telling(&self) -> Telling {
        self.tell(&self.felt)
    }

    /// What the motor does, as felt by `felt`.
    pub(super) fn tell(&self, felt: &Felt) -> Telling {
        let mut limits = self.bounds.reasons.and(self.held_by);
        limits.set(Limit::Voltage, felt.is_limited);
        Telling {
            state: felt.state,
            opening_mm: self.opening_mm,
            asked_mm: self.position.map(|position| position.asked_mm()),
            closing_mm_s: self.settings.screw.closing_mm_s(felt.rotor.speed()),
            turned_rad: felt.rotor.place().since(Place::default()),
            speed: felt.rotor.speed(),
            angle_rad: felt.rotor.angle_rad(),
            electrical: Direction::of(felt.rotor.electrical(&self.settings)),
            current: felt.current,
            asked: self.asked,
            voltage: felt.voltage,
            bus_v: felt.bus_v,
            supply: self.supply.told_with(felt.bus_v, &self.settings.limits),
            is_hot: self.bounds.is_hot,
            limits,
            found: self.found,
        }
    }

    fn take(&mut self, felt: Felt) {
        if felt.is_lost {
            self.home = None;
            self.position = None;
        }
        if felt.is_let_go {
            self.speed = SpeedLoop::default();
            self.asked = Dq::default();
            self.fit = Fit::default();
            self.runaway = Runaway::default();
        }
        if felt.state != State::Armed {
            self.setpoint = Setpoint::Off;
            self.position = None;
        }
        self.felt = felt;
    }

    /// What is to be done from now on.
    fn follow(&mut self, setpoint: Setpoint) -> Result<(), Trip> {
        if self.felt.state != State::Armed {
            return Ok(());
        }
        if !setpoint.is_finite() {
            return Err(Trip::NotANumber);
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
        self.unasked = 0;
        Ok(())
    }

    /// The fingers are this far apart now, the flanks of the screws that close touching.
    fn set_opening(&mut self, opening_mm: f32) {
        self.home = opening_mm.is_finite().then(|| Home {
            place: self.felt.rotor.place(),
            opening_mm,
            play: Play::new(opening_mm),
        });
        self.position = None;
        if let Setpoint::Position { .. } = self.setpoint {
            self.start_position();
        }
    }

    /// The rotor's place as an opening, the screw's play not counted.
    pub(super) fn rotor_mm(&self) -> Option<f32> {
        let home = self.home?;
        let turned = self.felt.rotor.place().since(home.place);
        Some(home.opening_mm - turned * self.settings.screw.ratio_mm)
    }

    fn start_position(&mut self) {
        let opening_mm_s = -self.settings.screw.closing_mm_s(self.felt.rotor.speed());
        let start = |opening_mm| PositionLoop::start(opening_mm, opening_mm_s);
        self.position = self.rotor_mm().map(start);
    }

    /// Whether what the inner tick felt fits together.
    fn judge(&mut self) -> Result<(), Trip> {
        let (felt, machine, limits) = (&self.felt, &self.settings.machine, &self.settings.limits);
        self.supply.note(felt.bus_v, limits);
        if felt.is_let_go {
            return Ok(());
        }
        let seen = Seen {
            measured: felt.current,
            before: felt.before,
            asked: self.asked,
            voltage: felt.voltage,
            greatest_v: svpwm::greatest_v(felt.bus_v),
            speed: felt.rotor.speed() * f32::from(machine.pole_pairs),
        };
        self.fit.judge(&seen, machine, limits)
    }

    fn draw_bounds(&mut self) {
        let around = Around {
            speed: self.felt.rotor.speed(),
            bus_v: self.felt.bus_v,
            heat: self.heat,
            temperatures: self.temperatures,
            speed_gain: self.speed_gains.proportional,
        };
        let mut bounds = Bounds::draw(&self.settings, &around);
        let most = self.setpoint.most_a();
        bounds.low_a = within(bounds.low_a, -most, most);
        bounds.high_a = within(bounds.high_a, -most, most);
        self.bounds = bounds;
    }

    fn act(&mut self, rotor_mm: Option<f32>) -> Result<Action, Trip> {
        self.draw_bounds();
        self.unasked = self.unasked.saturating_add(1);
        if let Setpoint::Current { .. } | Setpoint::Speed { .. } = self.setpoint
            && self.unasked > UNASKED
        {
            return Err(Trip::Unled);
        }
        let speed = self.felt.rotor.speed();
        let (q, is_held) = match self.setpoint {
            Setpoint::Off => return Ok(Action::Off),
            Setpoint::Brake => return Ok(Action::Brake),
            Setpoint::Current { closing_a } => {
                let given = within(closing_a, self.bounds.low_a, self.bounds.high_a);
                (given, given != closing_a)
            }
            Setpoint::Speed { closing_mm_s, .. } => {
                self.ask_speed(closing_mm_s, rotor_mm, speed)?
            }
            Setpoint::Position {
                opening_mm,
                speed_mm_s,
                ..
            } => self.ask_place(opening_mm, speed_mm_s, rotor_mm, speed)?,
        };
        self.held_by.set(Limit::Current, is_held);
        let (bus_v, amplitude_a) = (self.felt.bus_v, self.bounds.amplitude_a);
        let (asked, burns) = regeneration::burning(&self.settings, q, speed, bus_v, amplitude_a);
        self.held_by
            .set(Limit::Regeneration, burns || self.felt.is_shorted);
        // Said to be no number by the inner tick.
        self.asked = asked;
        Ok(Action::Follow(asked))
    }

    /// A speed, slower where the way ends or is not known.
    fn ask_speed(
        &mut self,
        closing_mm_s: f32,
        rotor_mm: Option<f32>,
        speed: f32,
    ) -> Result<(f32, bool), Trip> {
        let limits = &self.settings.limits;
        let [closed, open] = limits.ends_mm;
        let [slowest, fastest, limit] = match rotor_mm {
            Some(mm) => {
                let to_end = |way: f32| PositionLoop::GAIN * greater(way, 0.0);
                [-to_end(open - mm), to_end(mm - closed), f32::INFINITY]
            }
            None => [-limits.homing_mm_s, limits.homing_mm_s, limits.homing_mm_s],
        };
        let given = within(closing_mm_s, slowest, fastest);
        let is_slowed = given != closing_mm_s;
        self.held_by
            .set(Limit::EndStop, is_slowed && limit.is_infinite());
        self.held_by
            .set(Limit::NotHomed, is_slowed && limit.is_finite());
        let screw = &self.settings.screw;
        let asked = within(screw.rotor_speed(given), -limits.speed, limits.speed);
        let ahead_a = speed::ahead_a(&self.settings.machine, asked, 0.0);
        self.follow_speed([asked, speed], ahead_a)
    }

    /// A place on the way between the ends; where the opening is not known, the rotor is held still.
    fn ask_place(
        &mut self,
        opening_mm: f32,
        speed_mm_s: f32,
        rotor_mm: Option<f32>,
        speed: f32,
    ) -> Result<(f32, bool), Trip> {
        let (Some(position), Some(rotor_mm)) = (&mut self.position, rotor_mm) else {
            self.held_by.set(Limit::NotHomed, true);
            return self.follow_speed([0.0, speed], 0.0);
        };
        let [_, open] = self.settings.limits.ends_mm;
        let target = within(opening_mm, 0.0, open);
        self.held_by.set(Limit::EndStop, target != opening_mm);
        let wanted = position.tick(&self.settings, target, speed_mm_s, rotor_mm);
        let limit = self.settings.limits.speed;
        let asked = within(wanted.speed, -limit, limit);
        self.follow_speed([asked, speed], wanted.ahead_a)
    }

    /// The current for a speed asked for and the one that is, unless the rotor runs away from it.
    fn follow_speed(&mut self, speeds: [f32; 2], ahead_a: f32) -> Result<(f32, bool), Trip> {
        let limits = &self.settings.limits;
        self.runaway.note(speeds, self.asked.q, limits)?;
        Ok(self
            .speed
            .decide(&self.speed_gains, speeds, ahead_a, &self.bounds))
    }
}

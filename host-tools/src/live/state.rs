//! What is known of a gripper: the newest of everything it told, and what did not arrive.

use std::collections::{BTreeMap, HashMap};

use firmware::force::Validity;
use firmware::frame::SENSORS;
use firmware::hall::Reading;
use firmware::params::TICK_US;
use firmware::status::Fault;
use firmware::units::Force;
use firmware::wire::layout::take;
use firmware::wire::messages::{self, FaultEvent, GripStatus, Heartbeat, Message, Timing, Version};
use firmware::wire::newtons;
use firmware::wire::serial::{Packet, Tick};

use super::board_clock::BoardClock;
use super::history::History;

/// Forces of ticks count before those of messages, which are coarser, while ticks come: for this long.
const FRESH_S: f64 = 0.1;

/// Something told, and when, in seconds since hearing began.
#[derive(Clone, Copy, Debug)]
pub struct Told<T> {
    /// What.
    pub value: T,
    /// When.
    pub at_s: f64,
}

/// One sensor.
#[derive(Clone, Debug)]
pub struct SensorState {
    /// Forces, lateral and longitudinal, in newtons.
    pub force_n: [f64; 2],
    /// Their standard deviations; none where the gripper tells none.
    pub sigma_n: [Option<f64>; 2],
    /// Whether they may be used.
    pub validity: Validity,
    /// A foreign magnet is near.
    pub disturbed: bool,
    /// Whether a network made the estimate.
    pub network: bool,
    /// Its last reading, and when it came.
    pub reading: Option<Told<Reading>>,
    /// When its forces were told last.
    pub told_s: Option<f64>,
    /// When a tick told them.
    tick_s: f64,
    /// Its forces of the last seconds.
    pub history: History,
}

impl Default for SensorState {
    fn default() -> Self {
        Self {
            force_n: [0.0; 2],
            sigma_n: [None; 2],
            validity: Validity::Missing,
            disturbed: false,
            network: false,
            reading: None,
            told_s: None,
            tick_s: f64::NEG_INFINITY,
            history: History::default(),
        }
    }
}

/// A fault that is there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Active {
    /// Since when, in seconds since hearing began.
    pub since_s: f64,
    /// The board's time at the last tick before it was told, in seconds.
    pub since_board_s: Option<f64>,
    /// What was measured; none where it had come before anybody heard.
    pub detail: Option<u32>,
}

/// What did not arrive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lost {
    /// Ticks, by the board's time.
    pub ticks: u64,
    /// Messages, by their counters.
    pub messages: u64,
    /// Packets that were not understood.
    pub broken: u32,
    /// Starts of the board since hearing began.
    pub restarts: u32,
}

/// All of it.
#[derive(Clone, Debug, Default)]
pub struct State {
    /// What runs on the gripper.
    pub version: Option<Version>,
    /// The newest heartbeat.
    pub heartbeat: Option<Told<Heartbeat>>,
    /// The newest figures of its load.
    pub timing: Option<Told<Timing>>,
    /// The newest status of the grip.
    pub grip: Option<Told<GripStatus>>,
    /// The sensors.
    pub sensors: [SensorState; SENSORS],
    /// Active faults with their source, where it is known.
    pub faults: BTreeMap<(u16, Option<u8>), Active>,
    /// What did not arrive.
    pub lost: Lost,
    /// The board's time in microseconds.
    pub board_us: Option<u64>,
    /// When anything was heard last.
    pub heard_s: Option<f64>,
    /// Ticks in the last whole second.
    pub ticks_hz: u32,
    clock: BoardClock,
    counters: HashMap<u8, u8>,
    second: (u64, u32),
}

impl State {
    /// Takes a packet that was heard `at_s` seconds after hearing began.
    pub fn take(&mut self, at_s: f64, packet: &Packet) {
        self.heard_s = Some(at_s);
        match packet {
            Packet::Tick(tick) => self.tick(at_s, tick),
            Packet::Message { copy, message } => {
                self.count(*copy, message);
                self.message(at_s, usize::from(*copy), message);
            }
        }
    }

    fn tick(&mut self, at_s: f64, tick: &Tick) {
        match self.clock.take(tick.time_us, at_s) {
            Some(time_us) => {
                let before_us = self.board_us.replace(time_us);
                let step_us = before_us.map_or(TICK_US, |before_us| time_us - before_us);
                self.lost.ticks += ((step_us + TICK_US / 2) / TICK_US).saturating_sub(1);
            }
            None => self.restart(),
        }
        let (second, ticks) = self.second;
        self.second = match at_s as u64 {
            now if now == second => (second, ticks + 1),
            now => {
                self.ticks_hz = if now == second + 1 { ticks } else { 0 };
                (now, 1)
            }
        };
        for (state, sensor) in self.sensors.iter_mut().zip(&tick.sensors) {
            state.force_n = sensor.force.map(|force| Force(force).newtons());
            state.validity = sensor.validity();
            (state.told_s, state.tick_s) = (Some(at_s), at_s);
            if let Some(value) = sensor.reading() {
                state.reading = Some(Told { value, at_s });
            }
            state.remember(at_s);
        }
    }

    /// The board has started anew: what it told before holds no more.
    fn restart(&mut self) {
        self.lost.restarts += 1;
        self.board_us = None;
        self.counters.clear();
        self.faults.clear();
    }

    /// Counts what is missing between two messages of a number.
    fn count(&mut self, copy: u8, message: &Message) {
        let layout = message.layout();
        let Some(field) = layout.fields.iter().find(|field| field.name == "counter") else {
            return;
        };
        let counter: u8 = take(
            u64::from_le_bytes(message.to_bytes()),
            field.first..field.end,
        );
        let turn = u8::MAX.unbounded_shr(u32::from(8 + field.first - field.end));
        if let Some(before) = self.counters.insert(layout.number + copy, counter) {
            let missing = counter.wrapping_sub(before).wrapping_sub(1) & turn;
            self.lost.messages += u64::from(missing);
        }
    }

    fn message(&mut self, at_s: f64, copy: usize, message: &Message) {
        match message {
            Message::Version(version) => self.version = Some(*version),
            Message::Heartbeat(value) => {
                let value = *value;
                self.heartbeat = Some(Told { value, at_s });
                self.agree(at_s, value.faults);
            }
            Message::Timing(value) => {
                let value = *value;
                self.timing = Some(Told { value, at_s });
            }
            Message::GripStatus(value) => {
                let value = *value;
                self.grip = Some(Told { value, at_s });
            }
            Message::Force(force) => {
                if let Some(sensor) = self.sensors.get_mut(copy) {
                    sensor.told(at_s, force);
                }
            }
            Message::HallRaw(raw) => {
                if let Some(sensor) = self.sensors.get_mut(usize::from(raw.sensor)) {
                    let value = Reading {
                        field: [raw.x, raw.y, raw.z],
                        temperature: raw.temperature,
                    };
                    sensor.reading = Some(Told { value, at_s });
                }
            }
            Message::FaultEvent(event) => self.fault(at_s, event),
            _ => {}
        }
    }

    fn fault(&mut self, at_s: f64, event: &FaultEvent) {
        // Its source is known from now on.
        let unplaced = self.faults.remove(&(event.code, None));
        let place = (event.code, Some(event.source));
        if event.active == 0 {
            self.faults.remove(&place);
            return;
        }
        let came = unplaced.unwrap_or(Active {
            since_s: at_s,
            since_board_s: self.board_s(),
            detail: None,
        });
        let detail = Some(event.detail);
        self.faults.insert(place, Active { detail, ..came });
    }

    /// Brings the list to what a heartbeat tells: faults that came before anybody heard, and events that
    /// were lost.
    fn agree(&mut self, at_s: f64, bits: u32) {
        for (bit, fault) in Fault::ALL.into_iter().enumerate() {
            let code = fault as u16;
            if bits & (1 << bit) == 0 {
                self.faults.retain(|(known, _), _| *known != code);
            } else if !self.faults.keys().any(|(known, _)| *known == code) {
                let active = Active {
                    since_s: at_s,
                    since_board_s: self.board_s(),
                    detail: None,
                };
                self.faults.insert((code, None), active);
            }
        }
    }

    /// The board's time in seconds.
    pub fn board_s(&self) -> Option<f64> {
        self.board_us.map(|time_us| time_us as f64 * 1e-6)
    }
}

impl SensorState {
    fn told(&mut self, at_s: f64, message: &messages::Force) {
        let (force_n, sigma_n) = newtons(message);
        self.sigma_n = sigma_n;
        self.disturbed = message.disturbed;
        self.network = message.model != 0;
        if at_s - self.tick_s <= FRESH_S {
            return;
        }
        self.force_n = force_n;
        self.validity = match message {
            messages::Force { valid: true, .. } => Validity::Valid,
            messages::Force { stale: true, .. } => Validity::Missing,
            messages::Force {
                saturated: true, ..
            } => Validity::Saturated,
            _ => Validity::OutsideModel,
        };
        self.told_s = Some(at_s);
        self.remember(at_s);
    }

    /// What is missing is no force of nought.
    fn remember(&mut self, at_s: f64) {
        if self.validity != Validity::Missing {
            self.history.push(at_s, self.force_n);
        }
    }
}

#[cfg(test)]
mod tests;

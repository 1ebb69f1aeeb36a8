//! Latest state of a gripper from its messages, with counts of lost messages, recent forces and the extended board clock.

use firmware::compensation::covariates::Covariates;
use firmware::config::constants::TICK_US;
use firmware::estimator::Validity;
use firmware::fixed_point::Force;
use firmware::protocol::PROTOCOL_VERSION;
use firmware::protocol::force_newtons;
use firmware::protocol::layout::{Direction, decode};
use firmware::protocol::messages::{
    self, FaultEvent, GripStatus, Heartbeat, Message, Power, Timing, Version,
};
use firmware::protocol::serial::{Packet, Tick};
use firmware::sensors::hall::{HallReading, SENSORS};
use firmware::system::faults::Fault;
use std::collections::{BTreeMap, HashMap, VecDeque};

/// Time in seconds for which a value is current. So long forces of tick packets take precedence over those of messages, which are
/// coarser.
pub const FRESH_S: f64 = 0.1;

/// Value with its time in seconds since the start of reception.
#[derive(Clone, Copy, Debug)]
pub struct Timestamped<T> {
    pub value: T,
    /// Time in seconds.
    pub at_s: f64,
}

#[derive(Clone, Debug)]
pub struct SensorState {
    /// Forces, lateral and longitudinal, in newtons.
    pub force_n: [f64; 2],
    /// Standard deviations in newtons; `None` where the gripper reports none.
    pub sigma_n: [Option<f64>; 2],
    /// Validity of the forces.
    pub validity: Validity,
    /// Magnetic disturbance detected.
    pub disturbed: bool,
    /// True where a network made the estimate.
    pub network: bool,
    /// Last reading and its time.
    pub reading: Option<Timestamped<HallReading>>,
    /// Time of the last forces.
    pub forces_s: Option<f64>,
    /// Time of the last forces from a tick packet.
    tick_s: f64,
    /// Recent forces.
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
            forces_s: None,
            tick_s: f64::NEG_INFINITY,
            history: History::default(),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActiveFault {
    /// Start, in seconds since the start of reception.
    pub since_s: f64,
    /// Board time of the last tick before the fault, in seconds.
    pub since_board_s: Option<f64>,
    /// Detail of the fault; `None` where it preceded the reception.
    pub detail: Option<u32>,
}

/// Counts of lost messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LostMessages {
    /// Ticks, by the board's clock.
    pub ticks: u64,
    /// Messages, by their counters.
    pub messages: u64,
    /// Invalid packets.
    pub broken: u32,
    /// Restarts of the board since the start of reception.
    pub restarts: u32,
}

/// Time in seconds after which messages of another protocol are those of the gripper, if none of the own protocol arrives between
/// them: ten heartbeats.
const OTHER_PROTOCOL_S: f64 = 1.0;

/// Heartbeats and versions of another major version of the protocol. Everybody can put one on a bus: it says nothing on the
/// gripper while the gripper's own arrive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OtherProtocol {
    pub messages: u64,
    /// Version of the latest.
    pub major: u8,
    /// True while they are those of the gripper.
    pub is_of_gripper: bool,
    /// Time of the first since the last message of the own version.
    since_s: Option<f64>,
}

impl OtherProtocol {
    /// Whether a message has the own version, or none.
    fn admits(&mut self, at_s: f64, message: &Message) -> bool {
        let major = match message {
            Message::Version(version) => version.protocol_major,
            Message::Heartbeat(beat) => beat.protocol_major,
            _ => return true,
        };
        if major == PROTOCOL_VERSION.0 {
            (self.since_s, self.is_of_gripper) = (None, false);
            return true;
        }
        (self.messages, self.major) = (self.messages + 1, major);
        self.is_of_gripper = at_s - *self.since_s.get_or_insert(at_s) >= OTHER_PROTOCOL_S;
        false
    }
}

/// Complete state.
#[derive(Clone, Debug, Default)]
pub struct GripperState {
    /// Firmware version.
    pub version: Option<Version>,
    /// Latest heartbeat.
    pub heartbeat: Option<Timestamped<Heartbeat>>,
    /// Latest load of the processor.
    pub timing: Option<Timestamped<Timing>>,
    /// Latest status of the grip.
    pub grip: Option<Timestamped<GripStatus>>,
    /// Latest supply and temperatures.
    pub power: Option<Timestamped<Power>>,
    /// Covariates of the last tick.
    pub covariates: Option<Timestamped<Covariates>>,
    pub sensors: [SensorState; SENSORS],
    /// Active faults by code and source, where the source is known.
    pub faults: BTreeMap<(u16, Option<u8>), ActiveFault>,
    pub lost: LostMessages,
    /// Messages of another protocol.
    pub other_protocol: OtherProtocol,
    /// Board time in microseconds.
    pub board_us: Option<u64>,
    /// Time of the last message.
    pub received_s: Option<f64>,
    /// Ticks in the last full second.
    pub ticks_hz: u32,
    clock: BoardClock,
    counters: HashMap<u8, u8>,
    second: (u64, u32),
}

impl GripperState {
    /// Updates the state with a packet received `at_s` seconds after the start.
    pub fn update(&mut self, at_s: f64, packet: &Packet) {
        // Hosts on the same bus are not the gripper.
        if matches!(packet, Packet::Message { message, .. } if message.direction() == Direction::In)
        {
            return;
        }
        self.received_s = Some(at_s);
        match packet {
            Packet::Tick(tick) => self.tick(at_s, tick),
            Packet::Message { copy, message } if self.other_protocol.admits(at_s, message) => {
                self.count(*copy, message);
                self.message(at_s, usize::from(*copy), message);
            }
            Packet::Message { .. } => {}
        }
    }

    fn tick(&mut self, at_s: f64, tick: &Tick) {
        match self.clock.extend(tick.time_us, at_s) {
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
        self.covariates = Some(Timestamped { value: tick.covariates, at_s });
        for (state, sensor) in self.sensors.iter_mut().zip(&tick.sensors) {
            state.force_n = sensor.force.map(|force| Force(force).newtons());
            state.validity = sensor.validity();
            (state.forces_s, state.tick_s) = (Some(at_s), at_s);
            if let Some(value) = sensor.reading() {
                state.reading = Some(Timestamped { value, at_s });
            }
            state.remember(at_s);
        }
    }

    /// Clears the state after a restart of the board.
    fn restart(&mut self) {
        self.lost.restarts += 1;
        self.board_us = None;
        self.counters.clear();
        self.faults.clear();
    }

    /// Counts missing messages by the counter.
    fn count(&mut self, copy: u8, message: &Message) {
        let layout = message.layout();
        let Some(field) = layout.signals.iter().find(|field| field.name == "counter") else {
            return;
        };
        let counter: u8 =
            decode(u64::from_le_bytes(message.to_bytes()), field.first_bit..field.end_bit);
        let turn = u8::MAX.unbounded_shr(u32::from(8 + field.first_bit - field.end_bit));
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
                self.heartbeat = Some(Timestamped { value, at_s });
                self.agree(at_s, value.faults);
            }
            Message::Timing(value) => {
                let value = *value;
                self.timing = Some(Timestamped { value, at_s });
            }
            Message::GripStatus(value) => {
                let value = *value;
                self.grip = Some(Timestamped { value, at_s });
            }
            Message::Power(value) => {
                let value = *value;
                self.power = Some(Timestamped { value, at_s });
            }
            Message::Force(force) => {
                if let Some(sensor) = self.sensors.get_mut(copy) {
                    sensor.update_forces(at_s, force);
                }
            }
            Message::HallRaw(raw) => {
                if let Some(sensor) = self.sensors.get_mut(usize::from(raw.sensor)) {
                    let value =
                        HallReading { field: [raw.x, raw.y, raw.z], temperature: raw.temperature };
                    sensor.reading = Some(Timestamped { value, at_s });
                }
            }
            Message::FaultEvent(event) => self.fault(at_s, event),
            _ => {}
        }
    }

    fn fault(&mut self, at_s: f64, event: &FaultEvent) {
        // The source is known from now on.
        let unplaced = self.faults.remove(&(event.code, None));
        let place = (event.code, Some(event.source));
        if event.active == 0 {
            self.faults.remove(&place);
            return;
        }
        let came = unplaced.unwrap_or(ActiveFault {
            since_s: at_s,
            since_board_s: self.board_s(),
            detail: None,
        });
        let detail = Some(event.detail);
        self.faults.insert(place, ActiveFault { detail, ..came });
    }

    /// Matches the list of faults to a heartbeat, for faults before the reception and lost
    /// events.
    fn agree(&mut self, at_s: f64, bits: u32) {
        for (bit, fault) in Fault::ALL.into_iter().enumerate() {
            let code = fault as u16;
            if bits & (1 << bit) == 0 {
                self.faults.retain(|(known, _), _| *known != code);
            } else if !self.faults.keys().any(|(known, _)| *known == code) {
                let active =
                    ActiveFault { since_s: at_s, since_board_s: self.board_s(), detail: None };
                self.faults.insert((code, None), active);
            }
        }
    }

    /// Whether the gripper has reported that it has no key.
    pub fn is_unprotected(&self) -> bool {
        self.heartbeat.is_some_and(|latest| latest.value.unprotected)
    }

    /// Whether a stop is latched.
    pub fn is_stopped(&self) -> bool {
        self.heartbeat.is_some_and(|latest| latest.value.stopped)
    }

    /// Board time in seconds.
    pub fn board_s(&self) -> Option<f64> {
        self.board_us.map(|time_us| time_us as f64 * 1e-6)
    }
}

impl SensorState {
    fn update_forces(&mut self, at_s: f64, message: &messages::Force) {
        let (force_n, sigma_n) = force_newtons(message);
        self.sigma_n = sigma_n;
        self.disturbed = message.disturbed;
        self.network = message.model != 0;
        if at_s - self.tick_s <= FRESH_S {
            return;
        }
        self.force_n = force_n;
        self.validity = match message {
            messages::Force { valid: true, missing_inputs: true, .. } => Validity::MissingInputs,
            messages::Force { valid: true, .. } => Validity::Valid,
            messages::Force { stale: true, .. } => Validity::Missing,
            messages::Force { saturated: true, .. } => Validity::Saturated,
            _ => Validity::OutsideModel,
        };
        self.forces_s = Some(at_s);
        self.remember(at_s);
    }

    /// Missing values are not stored as zero.
    fn remember(&mut self, at_s: f64) {
        if self.validity != Validity::Missing {
            self.history.push(at_s, self.force_n);
        }
    }
}

/// Length of the history in seconds.
pub const HISTORY_S: f64 = 10.0;
/// Time between two points in seconds.
const HISTORY_STEP_S: f64 = 0.05;

/// Recent forces of one sensor.
#[derive(Clone, Debug, Default)]
pub struct History {
    points: VecDeque<(f64, [f64; 2])>,
}

impl History {
    /// Adds the forces at a monotonic time in seconds.
    pub fn push(&mut self, at_s: f64, force_n: [f64; 2]) {
        if self.points.back().is_none_or(|(last_s, _)| at_s - last_s >= HISTORY_STEP_S) {
            self.points.push_back((at_s, force_n));
        }
        while self.points.front().is_some_and(|(first_s, _)| at_s - first_s > HISTORY_S) {
            self.points.pop_front();
        }
    }

    /// One force relative to the current time.
    pub fn curve(&self, force: usize, now_s: f64) -> Vec<(f64, f64)> {
        let points = self.points.iter();
        points.map(|(at_s, force_n)| (at_s - now_s, force_n[force.min(1)])).collect()
    }
}

/// Maximum delay of a packet in seconds; a clock step longer than the elapsed time plus this is invalid.
const SLACK_S: f64 = 2.0;

/// Extends the board's 32-bit microsecond clock over its overflow (71.6 minutes).
#[derive(Clone, Copy, Debug, Default)]
pub struct BoardClock {
    last: Option<ClockSample>,
}

#[derive(Clone, Copy, Debug)]
struct ClockSample {
    board_us: u32,
    time_us: u64,
    at_s: f64,
}

impl BoardClock {
    /// Microseconds since the board's start, or since the first packet; `at_s` is the reception time of `board_us`
    /// in seconds. `None` after a restart of the board.
    pub fn extend(&mut self, board_us: u32, at_s: f64) -> Option<u64> {
        let time_us = match self.last {
            None => u64::from(board_us),
            Some(last) => {
                let step_us = board_us.wrapping_sub(last.board_us);
                let passed_s = at_s - last.at_s + SLACK_S;
                if step_us == 0 || f64::from(step_us) > 1e6 * passed_s {
                    self.last = None;
                    return None;
                }
                last.time_us + u64::from(step_us)
            }
        };
        self.last = Some(ClockSample { board_us, time_us, at_s });
        Some(time_us)
    }
}

#[cfg(test)]
mod unit_tests {
    use super::*;

    #[test]
    fn history_contains_the_last_seconds_only() {
        let mut history = History::default();
        for tick in 0..30_000 {
            let at_s = f64::from(tick) * 1e-3;
            history.push(at_s, [at_s, -at_s]);
        }
        let curve = history.curve(1, 30.0);
        assert!((curve.len() as f64 - HISTORY_S / HISTORY_STEP_S).abs() <= 2.0, "{}", curve.len());
        let (first, last) = (curve[0], curve[curve.len() - 1]);
        assert!(
            first.0 >= -HISTORY_S - HISTORY_STEP_S
                && last.0 <= 0.0
                && last.0 >= -2.0 * HISTORY_STEP_S
        );
        assert!((last.1 + 30.0 + last.0).abs() < 1e-9);
    }
}

#[cfg(test)]
mod tests;

//! States and measurements during a session, and its result.

use std::sync::mpsc::Sender;

use anyhow::Error;
use device::format;
use device::session::Client;
use firmware::protocol::opening_mm;
use serde_json::{Value, json};

use crate::commands::result_code::ResultCode;

/// Period of printed lines and of points in JSON, in seconds.
const LINE_PERIOD_S: f64 = 1.0;
const POINT_PERIOD_S: f64 = 0.05;

/// States and measurements reported during a command.
pub(super) struct CommandLog {
    /// Receives the printed lines; none with --json.
    lines: Option<Sender<String>>,
    /// The lines are JSON objects.
    is_json: bool,
    state: Option<u8>,
    active_faults: Vec<String>,
    line_s: f64,
    point_s: f64,
    points: Vec<Value>,
    states: Vec<Value>,
    /// All faults of the session in JSON, by their first time.
    faults: Vec<Value>,
    /// Printed last: a line that differs only in its time is omitted.
    last_line: String,
}

impl CommandLog {
    pub(super) fn new(lines: Option<Sender<String>>, is_json: bool) -> Self {
        Self {
            lines,
            is_json,
            state: None,
            active_faults: Vec::new(),
            line_s: 0.0,
            point_s: 0.0,
            points: Vec::new(),
            states: Vec::new(),
            faults: Vec::new(),
            last_line: String::new(),
        }
    }

    /// Records the current state of the client.
    pub(super) fn update(&mut self, client: &Client) {
        let now_s = client.elapsed_s();
        let state = client.state.heartbeat.map(|beat| beat.value.state);
        let faults: Vec<_> = client.state.faults.iter().map(format::fault_line).collect();
        let is_new = state.is_some() && (state != self.state || faults != self.active_faults);
        if let Some(code) = state.filter(|_| state != self.state) {
            let state = format::state_name(code);
            let state = json!({ "time_s": rounded(now_s), "state": state, "code": code });
            self.print_event("state", &state);
            self.states.push(state);
        }
        if faults != self.active_faults {
            for fault in client.state.faults.iter().map(format::fault_json) {
                let place = |known: &&mut Value| {
                    ["code", "source", "since_s"].iter().all(|key| known[key] == fault[key])
                };
                match self.faults.iter_mut().find(place) {
                    Some(known) => *known = fault,
                    None => {
                        self.print_event("fault", &fault);
                        self.faults.push(fault);
                    }
                }
            }
        }
        (self.state, self.active_faults) = (state, faults);
        if is_new || state.is_some() && now_s >= self.line_s + LINE_PERIOD_S {
            self.line_s = now_s;
            let line = self.line(client);
            if line != self.last_line {
                self.print(format!("{now_s:>7.2} s  {line}"));
                self.last_line = line;
            }
        }
        if now_s >= self.point_s + POINT_PERIOD_S {
            self.point_s = now_s;
            if let Some(point) = point(client, now_s) {
                self.print_event("point", &point);
                self.points.push(point);
            }
        }
    }

    /// Prints a line of text, except with JSON.
    pub(super) fn print(&self, line: String) {
        if !self.is_json {
            self.send(line);
        }
    }

    /// Prints a JSON object with --json-lines.
    fn print_event(&self, event: &str, object: &Value) {
        if self.is_json {
            self.send(event_line(event, object));
        }
    }

    fn send(&self, line: String) {
        if let Some(lines) = &self.lines {
            // Where nobody prints any more, nothing is lost.
            let _ = lines.send(line);
        }
    }

    fn line(&self, client: &Client) -> String {
        let mut text = format!("{:<14}", self.state_text());
        if let Some(([force_n, current_a], opening_mm)) = measurements(client) {
            let opening =
                opening_mm.map_or_else(|| "unknown".to_owned(), |mm| format!("{mm:>6.2} mm"));
            text +=
                &format!("  force {force_n:>6.1} N  opening {opening}  current {current_a:>6.2} A");
        }
        if self.active_faults.is_empty() {
            text
        } else {
            text + "  fault: " + &self.active_faults.join("; ")
        }
    }

    fn state_text(&self) -> String {
        self.state.map_or("unknown".to_owned(), format::state_name)
    }

    /// Last line of --json-lines.
    pub(super) fn result_line(&self, end: &SessionEnd, error: Option<&Error>) -> String {
        event_line("result", &end.json(error)) + "\n"
    }

    /// The session as JSON. `error` is what is printed without --json.
    pub(super) fn json(&self, client: &Client, end: &SessionEnd, error: Option<&Error>) -> Value {
        json!({
            "simulated": false,
            "gripper": client.name(),
            "result": end.json(error),
            "reached": end.is_reached,
            "error": error.map(|error| format!("{error:#}")),
            "disabled": end.is_disabled,
            "left_gripped": end.is_left_gripped,
            "states": self.states,
            "points": self.points,
            "faults": self.faults,
        })
    }

    /// The session as text.
    pub(super) fn text(&self, end: &SessionEnd) -> String {
        let Measured { force_n, opening_mm, .. } = &end.measured;
        let values = force_n.zip(*opening_mm).map_or_else(String::new, |(force_n, opening_mm)| {
            format!(" with {force_n:.1} N at {opening_mm:.2} mm")
        });
        format!("Done{values}. The gripper is in state {}.\n", self.state_text())
    }
}

/// Measurements when the result was determined, before the session was ended.
#[derive(Clone, Debug, Default)]
pub(super) struct Measured {
    time_s: f64,
    state: Option<String>,
    pub(super) force_n: Option<f64>,
    pub(super) opening_mm: Option<f64>,
}

impl Measured {
    pub(super) fn of(client: &Client) -> Self {
        let values = measurements(client);
        Self {
            time_s: rounded(client.elapsed_s()),
            state: client.state.heartbeat.map(|beat| format::state_name(beat.value.state)),
            force_n: values.map(|([force_n, _], _)| rounded(force_n)),
            opening_mm: values.and_then(|(_, opening_mm)| opening_mm).map(rounded),
        }
    }
}

/// How a session ended.
pub(super) struct SessionEnd {
    pub(super) code: ResultCode,
    pub(super) measured: Measured,
    /// The set-point was reached at any time.
    pub(super) is_reached: bool,
    /// The drive is disabled.
    pub(super) is_disabled: bool,
    /// An object that another host gripped is still held.
    pub(super) is_left_gripped: bool,
}

impl SessionEnd {
    fn json(&self, error: Option<&Error>) -> Value {
        let Measured { time_s, state, force_n, opening_mm } = &self.measured;
        json!({
            "code": self.code.name(),
            "status": self.code.status(),
            "error": error.map(|error| format!("{error:#}")),
            "time_s": time_s,
            "state": state,
            "force_n": force_n,
            "opening_mm": opening_mm,
        })
    }
}

/// An object with the kind of its event.
fn event_line(event: &str, object: &Value) -> String {
    let mut line = json!({ "event": event });
    if let (Some(line), Some(object)) = (line.as_object_mut(), object.as_object()) {
        line.extend(object.clone());
    }
    line.to_string()
}

/// Grasping force in newtons and current in amperes; opening in millimetres, if it is known.
fn measurements(client: &Client) -> Option<([f64; 2], Option<f64>)> {
    let status = client.state.grip?.value;
    let values = [0.1 * f64::from(status.force), 0.01 * f64::from(status.current)];
    Some((values, opening_mm(&status)))
}

/// The state is that of the last heartbeat, up to 0.1 s old.
fn point(client: &Client, now_s: f64) -> Option<Value> {
    let ([force_n, current_a], opening_mm) = measurements(client)?;
    let heartbeat = client.state.heartbeat;
    Some(json!({
        "time_s": rounded(now_s),
        "state": heartbeat.map(|beat| format::state_name(beat.value.state)),
        "state_age_s": heartbeat.map(|beat| rounded(now_s - beat.at_s)),
        "force_n": rounded(force_n),
        "opening_mm": opening_mm.map(rounded),
        "current_a": rounded(current_a),
    }))
}

/// Rounds to three decimals, the resolution of the messages.
fn rounded(value: f64) -> f64 {
    (1e3 * value).round() / 1e3
}

//! States and measurements during a session.

use std::sync::mpsc::Sender;

use serde_json::{Value, json};

use crate::format::{self, GripValues, rounded};
use crate::session::Client;

/// Period of printed lines and of points in JSON, in seconds.
const LINE_PERIOD_S: f64 = 1.0;
const POINT_PERIOD_S: f64 = 0.05;

/// Format of the lines during a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineFormat {
    /// No lines.
    None,
    /// Text for people.
    Text,
    /// A JSON object for each event.
    Json,
}

/// States and measurements reported during a command.
#[derive(Default)]
pub struct CommandLog {
    /// Receives the lines.
    lines: Option<(Sender<String>, LineFormat)>,
    state: Option<u8>,
    active_faults: Vec<String>,
    /// Whether messages of a stranger were reported.
    knows_stranger: bool,
    line_s: f64,
    point_s: f64,
    /// Kept for the JSON object at the end only: a hold lasts hours.
    pub(super) points: Vec<Value>,
    pub(super) states: Vec<Value>,
    /// All faults of the session in JSON, by their first time.
    pub(super) faults: Vec<Value>,
    /// Printed last: a line that differs only in its time is omitted.
    last_line: String,
}

impl CommandLog {
    /// Sends lines in this format from now on.
    pub fn print_to(&mut self, lines: Sender<String>, format: LineFormat) {
        self.lines = Some((lines, format));
    }

    /// Ends the lines for their receiver.
    pub(super) fn end_lines(&mut self) {
        self.lines = None;
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
            self.event("state", &state);
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
                        self.event("fault", &fault);
                        self.faults.push(fault);
                    }
                }
            }
        }
        (self.state, self.active_faults) = (state, faults);
        if let Some(stranger) =
            format::stranger_line(&client.state).filter(|_| !self.knows_stranger)
        {
            self.knows_stranger = true;
            self.note(&format!("Note: {stranger}."));
            self.event("other_protocol", &json!({ "time_s": rounded(now_s) }));
        }
        if is_new || state.is_some() && now_s >= self.line_s + LINE_PERIOD_S {
            self.line_s = now_s;
            let line = self.line(client);
            if line != self.last_line {
                self.note(&format!("{now_s:>7.2} s  {line}"));
                self.last_line = line;
            }
        }
        if now_s >= self.point_s + POINT_PERIOD_S {
            self.point_s = now_s;
            if let Some(point) = point(client, now_s) {
                self.event("point", &point);
                if matches!(self.lines, Some((_, LineFormat::None))) {
                    self.points.push(point);
                }
            }
        }
    }

    /// Adds a line of text.
    pub fn note(&self, text: &str) {
        self.send(LineFormat::Text, || text.to_owned());
    }

    fn event(&self, event: &str, object: &Value) {
        self.send(LineFormat::Json, || event_line(event, object));
    }

    fn send(&self, of: LineFormat, line: impl FnOnce() -> String) {
        if let Some((lines, format)) = &self.lines
            && *format == of
        {
            // Where nobody prints any more, nothing is lost.
            let _ = lines.send(line());
        }
    }

    fn line(&self, client: &Client) -> String {
        let mut text = format!("{:<14}", self.state_text());
        if let Some(grip) = client.state.grip {
            text += &format!("  {}", GripValues::of(&grip.value).line());
        }
        if self.active_faults.is_empty() {
            text
        } else {
            text + "  fault: " + &self.active_faults.join("; ")
        }
    }

    pub(super) fn state_text(&self) -> String {
        self.state.map_or("unknown".to_owned(), format::state_name)
    }
}

/// State and measurements.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Measured {
    /// Time in seconds since the start.
    pub time_s: f64,
    /// State of the gripper.
    pub state: Option<String>,
    /// Grasping force in newtons.
    pub force_n: Option<f64>,
    /// Opening in mm, if it is known.
    pub opening_mm: Option<f64>,
}

impl Measured {
    /// The latest ones of a client.
    pub fn of(client: &Client) -> Self {
        let values = client.state.grip.map(|grip| GripValues::of(&grip.value));
        Self {
            time_s: rounded(client.elapsed_s()),
            state: client.state.heartbeat.map(|beat| format::state_name(beat.value.state)),
            force_n: values.map(|values| values.force_n),
            opening_mm: values.and_then(|values| values.opening_mm),
        }
    }
}

/// A JSON object with the name of its event first.
pub(super) fn event_line(event: &str, object: &Value) -> String {
    let mut line = json!({ "event": event });
    if let (Some(line), Some(object)) = (line.as_object_mut(), object.as_object()) {
        line.extend(object.clone());
    }
    line.to_string()
}

/// The state is that of the last heartbeat, up to 0.1 s old.
fn point(client: &Client, now_s: f64) -> Option<Value> {
    let GripValues { force_n, opening_mm, current_a, .. } =
        GripValues::of(&client.state.grip?.value);
    let heartbeat = client.state.heartbeat;
    Some(json!({
        "time_s": rounded(now_s),
        "state": heartbeat.map(|beat| format::state_name(beat.value.state)),
        "state_age_s": heartbeat.map(|beat| rounded(now_s - beat.at_s)),
        "force_n": force_n,
        "opening_mm": opening_mm,
        "current_a": current_a,
    }))
}

//! What a commanded gripper reported: lines as it comes, and all of it at the end.

use anyhow::Error;
use serde_json::{Value, json};

use crate::live::client::Client;
use crate::live::{answers, json as live_json, words};

/// Between two lines, and two points in JSON, in seconds.
const LINE_S: f64 = 1.0;
const POINT_S: f64 = 0.05;

/// The course so far.
pub(super) struct Course {
    /// Nothing is printed.
    is_silent: bool,
    state: Option<u8>,
    faults: Vec<String>,
    line_s: f64,
    point_s: f64,
    points: Vec<Value>,
    states: Vec<Value>,
}

impl Course {
    pub(super) fn new(is_silent: bool) -> Self {
        Self {
            is_silent,
            state: None,
            faults: Vec::new(),
            line_s: 0.0,
            point_s: 0.0,
            points: Vec::new(),
            states: Vec::new(),
        }
    }

    /// Takes what the client knows now.
    pub(super) fn update(&mut self, client: &Client) {
        let now_s = client.elapsed_s();
        let state = client.state.heartbeat.map(|beat| beat.value.state);
        let faults: Vec<_> = client.state.faults.iter().map(words::fault).collect();
        let is_new = state.is_some() && (state != self.state || faults != self.faults);
        if state != self.state {
            self.states.extend(state.map(|code| {
                json!({ "time_s": rounded(now_s), "state": answers::state(code), "code": code })
            }));
        }
        (self.state, self.faults) = (state, faults);
        if is_new || state.is_some() && now_s >= self.line_s + LINE_S {
            self.line_s = now_s;
            if !self.is_silent {
                eprintln!("{}", self.line(client, now_s));
            }
        }
        if now_s >= self.point_s + POINT_S {
            self.point_s = now_s;
            self.points.extend(point(client, now_s));
        }
    }

    fn line(&self, client: &Client, now_s: f64) -> String {
        let state = self.state.map_or("-".to_owned(), answers::state);
        let mut text = format!("{now_s:>7.2} s  {state:<14}");
        if let Some([force_n, opening_mm, current_a]) = figures(client) {
            text += &format!(
                "  force {force_n:>6.1} N  opening {opening_mm:>6.2} mm  current {current_a:>6.2} A"
            );
        }
        match self.faults.is_empty() {
            true => text,
            false => text + "  fault: " + &self.faults.join("; "),
        }
    }

    /// The last line.
    pub(super) fn text(&self, is_reached: bool) -> String {
        let state = self.state.map_or("unknown".to_owned(), answers::state);
        match is_reached {
            true => format!("Done. The gripper is in state {state}.\n"),
            false => format!("Stopped before it was reached. The gripper is in state {state}.\n"),
        }
    }

    /// The object.
    pub(super) fn json(
        &self,
        client: &Client,
        result: Result<&bool, &Error>,
        is_off: bool,
    ) -> Value {
        json!({
            "simulated": false,
            "gripper": client.name(),
            "reached": result.is_ok_and(|reached| *reached),
            "error": result.err().map(|error| format!("{error:#}")),
            "disabled": is_off,
            "states": self.states,
            "points": self.points,
            "faults": client.state.faults.iter().map(live_json::fault).collect::<Vec<_>>(),
        })
    }
}

/// Grasping force in newtons, opening in millimetres, current in amperes.
fn figures(client: &Client) -> Option<[f64; 3]> {
    let status = client.state.grip?.value;
    Some([
        0.1 * f64::from(status.force),
        0.01 * f64::from(status.position),
        0.01 * f64::from(status.current),
    ])
}

fn point(client: &Client, now_s: f64) -> Option<Value> {
    let [force_n, opening_mm, current_a] = figures(client)?;
    let state = client
        .state
        .heartbeat
        .map(|beat| answers::state(beat.value.state));
    Some(json!({
        "time_s": rounded(now_s),
        "state": state,
        "force_n": rounded(force_n),
        "opening_mm": rounded(opening_mm),
        "current_a": rounded(current_a),
    }))
}

/// To thousandths: messages are no finer.
fn rounded(value: f64) -> f64 {
    (1e3 * value).round() / 1e3
}

//! Format of the scenario files, described in `tests/scenarios/README.md`.

use serde::Deserialize;

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Purpose, in a sentence.
    pub shows: String,
    /// Duration.
    pub seconds: f64,
    /// Constant force of both fingers.
    pub grip_n: f64,
    /// Force of the right finger, if different.
    pub right_n: Option<f64>,
    /// Responsible detector: without it the scenario must fail.
    pub detector: Option<Detector>,
    /// Actions.
    #[serde(default)]
    pub step: Vec<Step>,
    /// Expectations.
    #[serde(default)]
    pub expect: Vec<Expect>,
}

/// Detectors of `firmware::config::limits` that can be disabled.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Detector {
    LostTicks,
    FrozenAxes,
    FailedTransfers,
    StuckTicks,
    Unbalanced,
    OutsideTicks,
    FloodFrames,
    CommandTimeout,
}

/// An action at a time, counted from the first tick.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Step {
    pub at_ms: f64,
    #[serde(flatten)]
    pub act: Act,
}

/// An action on the board.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Act {
    Unplug { sensor: usize },
    Plug { sensor: usize },
    Refuse { sensor: usize, transfers: u32 },
    Freeze { sensor: usize },
    Thaw { sensor: usize },
    Gain { sensor: usize, factor: f64 },
    Slip { sensor: usize, clocks: u32 },
    Stretch { sensor: usize, us: u64 },
    Short { bus: usize },
    Open { bus: usize },
    Residue { bus: usize },
    DisturbCan,
    CalmCan,
    LeaveAlone,
    Join,
    Flood { frames_per_s: u32 },
    Garbage { bytes_per_s: u32 },
    Arm,
    Command { per_s: u32 },
    Spoil { frames: u32 },
    Repeat { frames: u32 },
}

/// An expectation.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Expect {
    /// A fault becomes active.
    Comes(Moment),
    /// A fault becomes inactive.
    Goes(Moment),
    /// A fault is permitted.
    May {
        fault: String,
        #[serde(default)]
        source: u8,
    },
    /// The forces are valid in every tick of an interval.
    Valid { sensors: Vec<usize>, from_ms: f64, to_ms: f64 },
    /// The forces are invalid in every tick of an interval.
    NotValid { sensors: Vec<usize>, from_ms: f64, to_ms: f64 },
    /// Magnitude of the lateral forces in every tick of an interval.
    Force { sensors: Vec<usize>, newtons: f64, within_n: f64, from_ms: f64, to_ms: f64 },
    /// Exact number of bus recoveries.
    Cleared { times: usize },
    /// Maximum number of missed ticks.
    Missed { ticks: u32 },
    /// Exact number of frames rejected by the session.
    Dropped { frames: u32 },
}

/// Time window of a fault.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Moment {
    /// Name of the fault as in `firmware::system::faults`.
    pub fault: String,
    /// Sensor, bus or path.
    #[serde(default)]
    pub source: u8,
    /// Start of the window.
    pub after_ms: f64,
    /// Length of the window.
    pub within_ms: f64,
}

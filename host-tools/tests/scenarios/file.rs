//! What a scenario file says; the words are defined in `tests/scenarios/README.md`.

use serde::Deserialize;

/// A scenario.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// What it shows, in a sentence.
    pub shows: String,
    /// How long it goes on.
    pub seconds: f64,
    /// Force with which both fingers press all the while.
    pub grip_n: f64,
    /// Force with which the right finger presses, if it is another one.
    pub right_n: Option<f64>,
    /// Which detector notices: without it the scenario must fail.
    pub detector: Option<Detector>,
    /// What happens.
    #[serde(default)]
    pub step: Vec<Step>,
    /// What must be seen.
    #[serde(default)]
    pub expect: Vec<Expect>,
}

/// Detectors of `firmware::limits` that can be switched off.
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

/// Something done at a time, counted from the first tick.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Step {
    pub at_ms: f64,
    #[serde(flatten)]
    pub act: Act,
}

/// Something done to the board.
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

/// Something that must be seen.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Expect {
    /// A fault comes.
    Comes(Moment),
    /// A fault goes.
    Goes(Moment),
    /// A fault may come and go, or not.
    May {
        fault: String,
        #[serde(default)]
        source: u8,
    },
    /// The forces at sensors may be used in every tick of a stretch.
    Valid {
        sensors: Vec<usize>,
        from_ms: f64,
        to_ms: f64,
    },
    /// They may be used in none.
    NotValid {
        sensors: Vec<usize>,
        from_ms: f64,
        to_ms: f64,
    },
    /// The lateral forces at sensors are this in every tick of a stretch, whichever way they point.
    Force {
        sensors: Vec<usize>,
        newtons: f64,
        within_n: f64,
        from_ms: f64,
        to_ms: f64,
    },
    /// Buses were cleared so many times, exactly.
    Cleared { times: usize },
    /// So many ticks were missed at the most.
    Missed { ticks: u32 },
    /// So many frames of hosts were dropped by the session, exactly.
    Dropped { frames: u32 },
}

/// When a fault is told.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Moment {
    /// Name of the fault as in `firmware::status`.
    pub fault: String,
    /// Sensor, bus or way.
    #[serde(default)]
    pub source: u8,
    /// Not before this.
    pub after_ms: f64,
    /// And within so long after it.
    pub within_ms: f64,
}

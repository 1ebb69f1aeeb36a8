//! Order, duplicates and gaps of a clock, and the steadiness of the rotor's speed.

use csv::ByteRecord;
use model_export::recordings::csv_table::GAP_STEPS;
use std::collections::VecDeque;
use std::f64::consts::TAU;

/// Window of the sort in rows: one second of the board, the largest disorder of a logger's buffers.
pub const SORT_WINDOW: usize = 1000;

/// Above this share of late rows the disorder is no buffer swap.
const FEW_LATE: f64 = 0.01;

/// Classification of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TickOutcome {
    /// Time increased.
    On {
        /// True where no row is missing before it.
        regular: bool,
    },
    /// Time equal to or before the previous row; the row is not used.
    Off,
}

/// Statistics of a clock, row by row.
#[derive(Clone, Debug)]
pub struct ClockScan {
    /// Typical step in microseconds; 0 where unknown.
    pub period_us: f64,
    /// Rows read.
    pub rows: u64,
    /// First time in microseconds.
    pub first_us: f64,
    /// Maximum time so far in microseconds.
    pub greatest_us: f64,
    /// Number of decreases.
    pub falls: u64,
    /// First decrease: line, time before, time after.
    pub first_fall: Option<(u64, f64, f64)>,
    /// Rows earlier than a previous row.
    pub late: u64,
    /// Exact duplicates of one of the last [`SORT_WINDOW`] rows.
    pub copies: u64,
    /// Rows with the time of the previous row but different cells.
    pub clashes: u64,
    /// Line of the first duplicate or conflict.
    pub first_copy: u64,
    /// True where sorting within [`SORT_WINDOW`] would not restore the order.
    unsortable: bool,
    /// Number of steps above [`GAP_STEPS`] typical ones.
    pub gaps: u64,
    /// Total length of the gaps in microseconds.
    pub lost_us: f64,
    /// Longest gap: length in microseconds, line, and time before it.
    pub longest: (f64, u64, f64),
    last_us: f64,
    /// Time and cells of the last rows.
    recent: VecDeque<(f64, Vec<u8>)>,
}

impl ClockScan {
    /// Clock with this typical step in microseconds.
    pub fn new(period_us: f64) -> Self {
        Self {
            period_us,
            rows: 0,
            first_us: f64::NAN,
            greatest_us: f64::NEG_INFINITY,
            falls: 0,
            first_fall: None,
            late: 0,
            copies: 0,
            clashes: 0,
            first_copy: 0,
            unsortable: false,
            gaps: 0,
            lost_us: 0.0,
            longest: (0.0, 0, 0.0),
            last_us: f64::NAN,
            recent: VecDeque::with_capacity(SORT_WINDOW),
        }
    }

    /// Adds a row.
    pub fn tick(&mut self, line: u64, t_us: f64, record: &ByteRecord) -> TickOutcome {
        self.rows += 1;
        if self.rows == 1 {
            self.first_us = t_us;
        }
        if t_us < self.last_us {
            self.falls += 1;
            self.first_fall.get_or_insert((line, self.last_us, t_us));
        }
        self.last_us = t_us;
        let turn = if t_us > self.greatest_us {
            self.step_on(line, t_us)
        } else {
            self.stay_behind(line, t_us, record.as_slice())
        };
        let oldest = if self.recent.len() == SORT_WINDOW { self.recent.pop_front() } else { None };
        let mut cells = oldest.map_or_else(Vec::new, |(_, cells)| cells);
        cells.clear();
        cells.extend_from_slice(record.as_slice());
        self.recent.push_back((t_us, cells));
        turn
    }

    fn step_on(&mut self, line: u64, t_us: f64) -> TickOutcome {
        let step = t_us - self.greatest_us;
        let before = std::mem::replace(&mut self.greatest_us, t_us);
        if !step.is_finite() || self.period_us <= 0.0 {
            return TickOutcome::On { regular: true };
        }
        if step > GAP_STEPS * self.period_us {
            self.gaps += 1;
            self.lost_us += step;
            if step > self.longest.0 {
                self.longest = (step, line, before);
            }
        }
        TickOutcome::On { regular: step < 1.5 * self.period_us }
    }

    fn stay_behind(&mut self, line: u64, t_us: f64, cells: &[u8]) -> TickOutcome {
        let mut same_time = self.recent.iter().filter(|(time, _)| *time == t_us);
        let copy = same_time.clone().any(|(_, other)| other == cells);
        let clash = same_time.next().is_some() && !copy;
        let behind = t_us < self.greatest_us;
        let within = self.recent.len() < SORT_WINDOW
            || self.recent.front().is_some_and(|(time, _)| *time <= t_us);
        self.late += u64::from(behind);
        self.unsortable |= behind && (clash || !within);
        if copy || clash {
            if self.copies + self.clashes == 0 {
                self.first_copy = line;
            }
            self.copies += u64::from(copy);
            self.clashes += u64::from(clash);
        }
        TickOutcome::Off
    }

    /// True where few rows are out of order and sorting fixes them.
    pub fn can_be_sorted(&self) -> bool {
        let few = (FEW_LATE * self.rows as f64).max(10.0);
        self.falls > 0 && !self.unsortable && self.late as f64 <= few
    }

    /// Time span in seconds.
    pub fn span_s(&self) -> f64 {
        1e-6 * (self.greatest_us - self.first_us)
    }
}

/// Rows per speed estimate.
const ROWS: usize = 100;
/// Maximum relative deviation of a steady speed.
const STEADY: f64 = 0.02;
/// Minimum number of speed estimates.
const LEAST: f64 = 10.0;

/// Speed statistics of `motor_angle_rad`.
#[derive(Clone, Debug, Default)]
pub struct RotorSpeed {
    last: Option<(f64, f64)>,
    turned: f64,
    time_us: f64,
    rows: usize,
    /// Number, sum and sum of squares of the speeds in hertz.
    speeds: [f64; 3],
}

impl RotorSpeed {
    /// Adds an angle in rad.
    pub fn push(&mut self, angle: f64, t_us: f64) {
        if let Some((before, at)) = self.last {
            let step = angle - before;
            self.turned += step - TAU * (step / TAU).round();
            self.time_us += t_us - at;
            self.rows += 1;
        }
        self.last = Some((angle, t_us));
        if self.rows == ROWS {
            let speed = self.turned / TAU / (1e-6 * self.time_us);
            self.speeds =
                [self.speeds[0] + 1.0, self.speeds[1] + speed, self.speeds[2] + speed * speed];
            (self.turned, self.time_us, self.rows) = (0.0, 0.0, 0);
        }
    }

    /// Rotor speed in turns per second, if steady throughout.
    pub fn steady_hz(&self) -> Option<f64> {
        let [count, sum, squares] = self.speeds;
        let mean = sum / count;
        let spread = (squares / count - mean * mean).max(0.0).sqrt();
        let steady = count >= LEAST && mean != 0.0 && spread <= STEADY * mean.abs();
        steady.then_some(mean.abs())
    }
}

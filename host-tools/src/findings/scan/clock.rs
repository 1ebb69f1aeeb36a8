//! Order, copies and gaps of a clock.

use std::collections::VecDeque;
use std::hash::{DefaultHasher, Hash, Hasher};

use csv::ByteRecord;
use model_export::recordings::clock::GAP_STEPS;

/// Rows that a sort looks back over: a second of the board, the most that a logger's buffers mix up.
pub const SORT_WINDOW: usize = 1000;

/// More rows out of place than this share are no slip of a buffer.
const FEW_LATE: f64 = 0.01;

/// What became of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// A step onwards, of the usual length or not.
    On {
        /// True where no row is missing before it.
        regular: bool,
    },
    /// The same time as the row before, or earlier: it says nothing that can be used.
    Off,
}

/// A clock's order, row by row.
#[derive(Clone, Debug)]
pub struct ClockScan {
    /// Typical step in microseconds; 0 where it is not known.
    pub period_us: f64,
    /// Rows read.
    pub rows: u64,
    /// First time, in microseconds.
    pub first_us: f64,
    /// Greatest time so far, in microseconds.
    pub greatest_us: f64,
    /// Falls of the clock.
    pub falls: u64,
    /// Line, time before and after of the first fall.
    pub first_fall: Option<(u64, f64, f64)>,
    /// Rows that are earlier than one before them.
    pub late: u64,
    /// Rows that are a copy of one of the last [`SORT_WINDOW`], cell by cell.
    pub copies: u64,
    /// Rows that have the time of the row before and other cells.
    pub clashes: u64,
    /// First line of those two.
    pub first_copy: u64,
    /// True where sorting within [`SORT_WINDOW`] would not put the rows in order.
    unsortable: bool,
    /// Steps above [`GAP_STEPS`] typical ones.
    pub gaps: u64,
    /// Sum of those in microseconds.
    pub lost_us: f64,
    /// The longest: its length in microseconds, line, and time before it.
    pub longest: (f64, u64, f64),
    last_us: f64,
    recent: VecDeque<(f64, u64)>,
}

impl ClockScan {
    /// A clock with this typical step in microseconds.
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

    /// Takes the next row.
    pub fn tick(&mut self, line: u64, t_us: f64, record: &ByteRecord) -> Turn {
        let hash = hash(record);
        self.rows += 1;
        if self.rows == 1 {
            self.first_us = t_us;
        }
        if t_us < self.last_us {
            self.falls += 1;
            self.first_fall.get_or_insert((line, self.last_us, t_us));
        }
        self.last_us = t_us;
        let turn = match t_us > self.greatest_us {
            true => self.step_on(line, t_us),
            false => self.stay_behind(line, t_us, hash),
        };
        if self.recent.len() == SORT_WINDOW {
            self.recent.pop_front();
        }
        self.recent.push_back((t_us, hash));
        turn
    }

    fn step_on(&mut self, line: u64, t_us: f64) -> Turn {
        let step = t_us - self.greatest_us;
        let before = std::mem::replace(&mut self.greatest_us, t_us);
        if !step.is_finite() || self.period_us <= 0.0 {
            return Turn::On { regular: true };
        }
        if step > GAP_STEPS * self.period_us {
            self.gaps += 1;
            self.lost_us += step;
            if step > self.longest.0 {
                self.longest = (step, line, before);
            }
        }
        Turn::On {
            regular: step < 1.5 * self.period_us,
        }
    }

    fn stay_behind(&mut self, line: u64, t_us: f64, hash: u64) -> Turn {
        let mut same_time = self.recent.iter().filter(|(time, _)| *time == t_us);
        let copy = same_time.clone().any(|(_, other)| *other == hash);
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
        Turn::Off
    }

    /// True where a few rows are out of place and sorting puts them in order.
    pub fn can_be_sorted(&self) -> bool {
        let few = (FEW_LATE * self.rows as f64).max(10.0);
        self.falls > 0 && !self.unsortable && self.late as f64 <= few
    }

    /// Seconds from the first to the greatest time.
    pub fn span_s(&self) -> f64 {
        1e-6 * (self.greatest_us - self.first_us)
    }
}

/// The same cells, the same number.
pub fn hash(record: &ByteRecord) -> u64 {
    let mut hasher = DefaultHasher::new();
    record.as_slice().hash(&mut hasher);
    hasher.finish()
}

//! Stretches in which a column does not change.

/// A stretch of equal values.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Run {
    /// Rows in it.
    pub rows: u64,
    /// Times of its first and last row in microseconds.
    pub from_us: f64,
    /// See `from_us`.
    pub to_us: f64,
    /// Line of its first row.
    pub line: u64,
    /// The value.
    pub value: f64,
}

/// Follows a column.
#[derive(Clone, Debug, Default)]
pub struct Runs {
    now: Run,
    longest: Run,
    /// Runs of two rows and more that are over: how many, and rows in them.
    over: (u64, u64),
}

impl Runs {
    /// Takes the next value; the rows of the run that it belongs to.
    pub fn push(&mut self, value: f64, t_us: f64, line: u64) -> u64 {
        if self.now.rows > 0 && value == self.now.value {
            self.now.rows += 1;
            self.now.to_us = t_us;
            return self.now.rows;
        }
        self.close();
        self.now = Run {
            rows: 1,
            from_us: t_us,
            to_us: t_us,
            line,
            value,
        };
        1
    }

    /// Ends the present run.
    pub fn close(&mut self) {
        if self.now.rows >= 2 {
            self.over.0 += 1;
            self.over.1 += self.now.rows;
        }
        if self.now.rows > self.longest.rows {
            self.longest = self.now;
        }
        self.now = Run::default();
    }

    /// The longest run that is over.
    pub fn longest(&self) -> Run {
        self.longest
    }

    /// Mean length of the other runs of two rows and more, at least 1.
    pub fn usual(&self) -> f64 {
        let longest = if self.longest.rows >= 2 {
            (1, self.longest.rows)
        } else {
            (0, 0)
        };
        let (count, rows) = (self.over.0 - longest.0, self.over.1 - longest.1);
        (rows as f64 / count.max(1) as f64).max(1.0)
    }

    /// Share of rows outside the longest run that repeat the value before, of `rows` rows in all.
    pub fn share(&self, rows: u64) -> f64 {
        let repeated = self.over.1 - self.over.0;
        let own = self.longest.rows.saturating_sub(1);
        let others = rows.saturating_sub(self.longest.rows).max(1);
        repeated.saturating_sub(own) as f64 / others as f64
    }
}

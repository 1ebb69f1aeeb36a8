//! Rows in which no axis of a sensor changed although the clock went on.

/// Follows the axes of one sensor together.
#[derive(Clone, Debug, Default)]
pub struct Repeats {
    /// Number of the sensor.
    pub sensor: u32,
    /// Where its axes stand in a row.
    pub indices: Vec<usize>,
    last: Vec<f64>,
    /// Rows after the first.
    pub rows: u64,
    /// Those in which no field changed.
    pub repeated: u64,
    /// Line of the first of them.
    pub line: u64,
    /// Of the other rows: in how many each field did not change.
    single: Vec<u64>,
}

impl Repeats {
    /// Of a sensor, the first of whose axes stands in that column.
    pub fn of(sensor: u32, index: usize) -> Self {
        Self {
            sensor,
            indices: vec![index],
            ..Self::default()
        }
    }

    /// Takes the next row's fields.
    pub fn push(&mut self, fields: &[f64], line: u64) {
        if self.last.len() != fields.len() {
            self.last = fields.to_vec();
            self.single = vec![0; fields.len()];
            return;
        }
        self.rows += 1;
        if self.last == fields {
            if self.repeated == 0 {
                self.line = line;
            }
            self.repeated += 1;
            return;
        }
        for ((count, last), now) in self.single.iter_mut().zip(&self.last).zip(fields) {
            *count += u64::from(last == now);
        }
        self.last.copy_from_slice(fields);
    }

    /// Share of rows in which no field changed.
    pub fn share(&self) -> f64 {
        self.repeated as f64 / self.rows.max(1) as f64
    }

    /// The share that chance would give, were the fields' noises independent.
    pub fn by_chance(&self) -> f64 {
        let others = (self.rows - self.repeated).max(1) as f64;
        self.single
            .iter()
            .map(|count| *count as f64 / others)
            .product()
    }
}

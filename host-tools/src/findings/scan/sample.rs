//! A few values of a column, evenly spread over a recording of any length.

/// Most values that are kept.
const MOST: usize = 512;

/// Keeps every n-th value; n doubles whenever there are too many.
#[derive(Clone, Debug)]
pub struct Sample {
    values: Vec<f64>,
    stride: u64,
    seen: u64,
}

impl Default for Sample {
    fn default() -> Self {
        Self {
            values: Vec::new(),
            stride: 1,
            seen: 0,
        }
    }
}

impl Sample {
    /// Takes the next value.
    pub fn push(&mut self, value: f64) {
        if self.seen.is_multiple_of(self.stride) {
            if self.values.len() == MOST {
                let mut kept = 0_u64;
                self.values.retain(|_| {
                    kept += 1;
                    kept % 2 == 1
                });
                self.stride *= 2;
            }
            if self.seen.is_multiple_of(self.stride) {
                self.values.push(value);
            }
        }
        self.seen += 1;
    }

    /// The value below which this share of the sizes (absolute values) lies; `None` without any.
    pub fn size(&self, share: f64) -> Option<f64> {
        let mut sizes: Vec<f64> = self.values.iter().map(|value| value.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let last = sizes.len().checked_sub(1)?;
        sizes.get((share * last as f64).round() as usize).copied()
    }

    /// The middle value; `None` without any.
    pub fn median(&self) -> Option<f64> {
        let mut values = self.values.clone();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    }
}

//! Batches for truncated back-propagation through time: parallel streams of rows, each with its own state.

use candle_core::{Device, Result, Tensor};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::gru::train::dataset::ScaledSequence;

/// Rows of back-propagation: enough to identify the direction of a motion. Earlier rows act through the state,
/// which carries over between windows. Shorter windows give more steps for short recordings.
pub const WINDOW_ROWS: usize = 64;
/// Maximum number of streams.
pub const STREAMS: usize = 16;
/// Windows without loss that initialise the state: a quarter of a second.
const WARM_UP_WINDOWS: usize = 4;
/// Minimum windows of a stream.
const MIN_WINDOWS: usize = 16;

/// Start of one stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Start {
    recording: usize,
    row: usize,
}

/// The streams of one epoch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StreamBatches {
    starts: Vec<Start>,
    /// Windows of every stream.
    pub windows: usize,
}

/// Inputs, true outputs and their weights of one window of all streams and networks.
pub struct Batch {
    /// `networks x streams*rows x inputs`.
    pub inputs: Tensor,
    /// `networks x streams*rows x forces`.
    pub truth: Tensor,
    /// The same.
    pub weight: Tensor,
    /// Total weight of each network.
    pub counts: Vec<f32>,
}

impl StreamBatches {
    /// Draws new starts for an epoch, so that window borders vary.
    pub fn sample(recordings: &[ScaledSequence], seed: u64, epoch: u32) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // Random stream 0 is for the starts, with a separate part for each epoch.
        rng.set_word_pos(u128::from(epoch) << 20);
        let total: usize = recordings.iter().map(|recording| recording.rows).sum();
        let streams = (total / (MIN_WINDOWS * WINDOW_ROWS)).clamp(1, STREAMS);
        let windows = (total / (streams * WINDOW_ROWS)).max(1);
        let length = windows * WINDOW_ROWS;
        let mut starts = Vec::new();
        for (recording, scaled) in recordings.iter().enumerate() {
            let cuts = ((scaled.rows as f64 / length as f64).round() as usize).max(1);
            for cut in 0..cuts {
                let shift = rng.random_range(0..length) as isize - (length / 2) as isize;
                let row = (cut * length) as isize + shift;
                let last = scaled.rows.saturating_sub(length);
                starts.push(Start { recording, row: (row.max(0) as usize).min(last) });
            }
        }
        Self { starts, windows }
    }

    /// Number of streams.
    pub fn count(&self) -> usize {
        self.starts.len()
    }

    /// One window of all streams. The first windows of a stream that starts within a recording have zero
    /// weight.
    pub fn batch(
        &self,
        recordings: &[ScaledSequence],
        networks: usize,
        window: usize,
    ) -> Result<Batch> {
        let mut lists = [Vec::new(), Vec::new(), Vec::new()];
        let mut counts = Vec::new();
        for network in 0..networks {
            let before = lists[2].len();
            for start in &self.starts {
                let from = start.row + window * WINDOW_ROWS;
                let counts = window >= WARM_UP_WINDOWS || start.row == 0;
                recordings[start.recording].window(network, from, WINDOW_ROWS, counts, &mut lists);
            }
            counts.push(lists[2][before..].iter().sum());
        }
        let rows = self.count() * WINDOW_ROWS;
        let width = |list: &Vec<f32>| list.len() / (networks * rows);
        let tensor = |list: Vec<f32>| {
            let width = width(&list);
            Tensor::from_vec(list, (networks, rows, width), &Device::Cpu)
        };
        let [inputs, truth, weight] = lists;
        Ok(Batch {
            inputs: tensor(inputs)?,
            truth: tensor(truth)?,
            weight: tensor(weight)?,
            counts,
        })
    }
}

//! The recordings cut into streams that are learned from side by side, each with its own state.

use candle_core::{Device, Result, Tensor};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::lesson::Scaled;

/// Rows through which the slope of the loss goes back: the direction of a motion shows within them.
/// What lies further back reaches the loss through the state, which is carried from window to window.
/// Shorter windows make more steps of the same rows, which is what short recordings lack.
pub const WINDOW_ROWS: usize = 64;
/// Streams that a campaign is cut into, where it is long enough.
pub const STREAMS: usize = 16;
/// Windows that only bring a state to where the sensor's past would have it: a quarter of a second.
const LEADING_WINDOWS: usize = 4;
/// Fewest windows of a stream.
const FEWEST_WINDOWS: usize = 16;

/// Where one stream of an epoch begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Start {
    recording: usize,
    row: usize,
}

/// The streams of one epoch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Streams {
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
    /// How much truth each network has in it.
    pub counts: Vec<f32>,
}

impl Streams {
    /// Cuts the recordings anew; the cuts differ from epoch to epoch, so that a state is not always
    /// carried to the same places.
    pub fn cut(recordings: &[Scaled], seed: u64, epoch: u32) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        // Stream 0 is the cuts', and each epoch has its own part of it.
        rng.set_word_pos(u128::from(epoch) << 20);
        let total: usize = recordings.iter().map(|recording| recording.rows).sum();
        let streams = (total / (FEWEST_WINDOWS * WINDOW_ROWS)).clamp(1, STREAMS);
        let windows = (total / (streams * WINDOW_ROWS)).max(1);
        let length = windows * WINDOW_ROWS;
        let mut starts = Vec::new();
        for (recording, scaled) in recordings.iter().enumerate() {
            let cuts = ((scaled.rows as f64 / length as f64).round() as usize).max(1);
            for cut in 0..cuts {
                let shift = rng.random_range(0..length) as isize - (length / 2) as isize;
                let row = (cut * length) as isize + shift;
                let last = scaled.rows.saturating_sub(length);
                starts.push(Start {
                    recording,
                    row: (row.max(0) as usize).min(last),
                });
            }
        }
        Self { starts, windows }
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.starts.len()
    }

    /// One window of all streams. The leading ones of a stream that begins within a recording count
    /// nothing.
    pub fn batch(&self, recordings: &[Scaled], networks: usize, window: usize) -> Result<Batch> {
        let mut lists = [Vec::new(), Vec::new(), Vec::new()];
        let mut counts = Vec::new();
        for network in 0..networks {
            let before = lists[2].len();
            for start in &self.starts {
                let from = start.row + window * WINDOW_ROWS;
                let counts = window >= LEADING_WINDOWS || start.row == 0;
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

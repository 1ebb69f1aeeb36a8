//! Windows for truncated back-propagation through time: parallel streams of rows, each with its own state.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::gru::train::backprop::StreamRows;
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

    /// Rows of one window of a stream for a network. The first windows of a stream that starts within a recording have zero
    /// weight.
    pub fn window(
        &self,
        recordings: &[ScaledSequence],
        network: usize,
        (stream, window): (usize, usize),
        into: &mut StreamRows,
    ) {
        let start = &self.starts[stream];
        let from = start.row + window * WINDOW_ROWS;
        let counts = window >= WARM_UP_WINDOWS || start.row == 0;
        recordings[start.recording].window(network, from, WINDOW_ROWS, counts, into);
    }
}

//! What networks tell over a whole recording, begun as the device begins.

use candle_core::{Device, Result, Tensor};

use super::forward::{GREATEST_LOG_SIGMA, LEAST_LOG_SIGMA, State, Weights};
use super::lesson::Scaled;
use super::parameters::Parameters;

/// Rows that are computed at once; the memory that it takes does not grow with the recording.
const CHUNK_ROWS: usize = 4096;

/// One row with truth, for one force, in shares of the scale of the forces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Told {
    /// Row of the board.
    pub row: usize,
    /// The force.
    pub truth: f64,
    /// What the network tells.
    pub mean: f64,
    /// Logarithm of the standard deviation that it tells.
    pub log_sigma: f64,
}

impl Told {
    /// Negative logarithm of the likelihood without its constant, in nats.
    pub fn loss(&self) -> f64 {
        let log_sigma = self.log_sigma.clamp(LEAST_LOG_SIGMA, GREATEST_LOG_SIGMA);
        let share = (self.truth - self.mean) * libm::exp(-log_sigma);
        0.5 * share * share + log_sigma
    }
}

/// What every network tells of every force, where truth is known: `[network][force]`.
pub fn tell(parameters: &Parameters, recording: &Scaled) -> Result<Vec<Vec<Vec<Told>>>> {
    let networks = parameters.size.networks;
    let weights = Weights::of(parameters)?;
    let mut state = State::zero(parameters.size, 1);
    let mut told = vec![vec![Vec::new(); recording.forces]; networks];
    let mut from = 0;
    while from < recording.rows {
        let rows = CHUNK_ROWS.min(recording.rows - from);
        let mut lists = [Vec::new(), Vec::new(), Vec::new()];
        for network in 0..networks {
            recording.window(network, from, rows, true, &mut lists);
        }
        let [inputs, truth, weight] = lists;
        let inputs = Tensor::from_vec(inputs, (networks, rows, recording.inputs), &Device::Cpu)?;
        let outputs = weights.forward(&inputs, 1, &mut state)?;
        let outputs = outputs.flatten_all()?.to_vec1::<f32>()?;
        let known = weight.iter().enumerate().filter(|(_, w)| **w > 0.0);
        for (at, _) in known {
            let (row, force) = (at / recording.forces, at % recording.forces);
            // Two means, two logarithms for each sensor.
            let mean = row * 2 * recording.forces + force / 2 * 4 + force % 2;
            told[row / rows][force].push(Told {
                row: from + row % rows,
                truth: f64::from(truth[at]),
                mean: f64::from(outputs[mean]),
                log_sigma: f64::from(outputs[mean + 2]),
            });
        }
        from += rows;
    }
    Ok(told)
}

/// Mean loss of each network, in nats for each force.
pub fn mean_losses(told: &[Vec<Vec<Told>>]) -> Vec<f64> {
    let mean = |forces: &Vec<Vec<Told>>| {
        let rows: usize = forces.iter().map(Vec::len).sum();
        let sum: f64 = forces.iter().flatten().map(Told::loss).sum();
        sum / rows as f64
    };
    told.iter().map(mean).collect()
}

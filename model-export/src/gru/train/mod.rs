//! Training: weights that make what was recorded likely.
//!
//! - [`lesson`]: what is learned from, and its scaling.
//! - [`parameters`]: everything that training changes.
//! - [`hold`]: weights brought back to what the device can hold.
//! - [`curves`]: sigmoid and tangent, several values at once.
//! - [`recurrence`]: a layer's recurrence as one operation, forward and backward.
//! - [`forward`]: the networks over a window, and the loss.
//! - [`streams`]: recordings cut into streams.
//! - [`adam`]: the optimiser.
//! - [`judge`]: what networks tell over a whole recording.
//! - [`course`]: the training itself, from epoch to epoch.
//! - [`checkpoint`]: a training on disk.
//!
//! The same seed and recordings give the same bytes, whatever the number of threads, and however
//! often the training was interrupted.

pub mod adam;
pub mod checkpoint;
pub mod course;
pub mod curves;
pub mod forward;
pub mod hold;
pub mod judge;
pub mod lesson;
pub mod parameters;
pub mod recurrence;
pub mod streams;

#[cfg(test)]
mod learning;
#[cfg(test)]
mod tests;

use crate::gru::network::Input;

/// A training that cannot be done.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // The sentence of each variant is its documentation.
pub enum Problem {
    #[error(
        "{} never changes in the recordings that are learned from: nothing can be learned from it",
        name(*input)
    )]
    ConstantInput { input: Input },
    #[error(
        "in no row that is learned from is a valid estimate together with a measured force other than zero; check force.csv"
    )]
    NoTruth,
    #[error(
        "recording {recording}: sensor {sensor} has no row with a measured force and a valid estimate; leave the recording out, or complete it"
    )]
    NoTruthAt { recording: String, sensor: u32 },
    #[error(
        "the loss of the network of sensors {sensors:?} is no number after epoch {epoch}; train with a lower --rate"
    )]
    Diverged { sensors: Vec<u32>, epoch: u32 },
    #[error(transparent)]
    Tensors(#[from] candle_core::Error),
    #[error(transparent)]
    File(#[from] crate::recordings::Problem),
}

/// An input in words.
fn name(input: Input) -> String {
    match input {
        Input::Field { sensor, axis } => {
            format!(
                "the field of sensor {sensor} along {}",
                ["x", "y", "z"][axis]
            )
        }
        Input::Ideal { sensor, axis } => {
            format!(
                "the ideal model's {} at sensor {sensor}",
                ["Fx", "Fz"][axis]
            )
        }
    }
}

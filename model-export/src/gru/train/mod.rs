//! Training of the networks by maximum likelihood.
//!
//! - [`dataset`]: recordings as training sequences, and their scaling.
//! - [`parameters`]: trainable tensors, their initial values and the device's weight limits.
//! - `backprop`: loss and gradients of one network.
//! - `tbptt`: windows for truncated back-propagation through time.
//! - `adam`: the optimiser.
//! - [`trainer`]: epochs, learning rate schedule and early stopping.
//! - [`predictions`]: evaluation of trained networks.
//! - [`checkpoint`]: a training run on disk.
//!
//! The same seed and recordings give the same bytes on any number of threads, with or without interruptions.

mod adam;
mod backprop;
pub mod checkpoint;
pub mod dataset;
pub mod parameters;
pub mod predictions;
mod tbptt;
pub mod trainer;

#[cfg(test)]
mod tests;
#[cfg(test)]
mod trainer_tests;

use crate::gru::network::Input;

/// Reasons for which a training fails.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // The sentence of each variant is its documentation.
pub enum TrainError {
    #[error(
        "{} never changes in the training recordings and carries no information; leave it out",
        name(*input)
    )]
    ConstantInput { input: Input },
    #[error(
        "no training row has a valid estimate and a measured force other than zero; check force.csv"
    )]
    NoTruth,
    #[error(
        "recording {recording}: sensor {sensor} has no row with a measured force and a valid estimate; leave the recording out, or complete it"
    )]
    NoTruthAt { recording: String, sensor: u32 },
    #[error(
        "the loss of the network of sensors {sensors:?} is not finite after epoch {epoch}; train with a lower --rate"
    )]
    Diverged { sensors: Vec<u32>, epoch: u32 },
    #[error(transparent)]
    File(#[from] crate::recordings::DataError),
}

/// Name of an input in messages.
fn name(input: Input) -> String {
    match input {
        Input::Field { sensor, axis } => {
            format!("the field of sensor {sensor} along {}", ["x", "y", "z"][axis])
        }
        Input::Ideal { sensor, axis } => {
            format!("the ideal model's {} at sensor {sensor}", ["Fx", "Fz"][axis])
        }
    }
}

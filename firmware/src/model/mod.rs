//! The model on the device: tables and the arithmetic over them. No floating point, no allocation.
//!
//! - [`table`]: the formats. What the exporter builds and the device reads is the same struct.
//! - [`activation`]: sigmoid and tanh.
//! - [`network`]: the formats of a recurrent network.
//! - `kernel`: only on the chip: what takes the time, in assembly.
//! - [`grbf`]: Gaussian radial basis functions, the definition of every bit.
//! - [`gru`]: the recurrent network, the definition of every bit.
//! - [`parity`]: three axes against two forces.
//! - [`ideal`]: scaling, linear part and radial basis functions: from a field to two forces.
//! - [`check`]: whether tables and weights are still those that were exported.
//! - `tables`: only on the chip: the tables of this image, written by `magpie export`.

pub mod activation;
pub mod check;
pub mod grbf;
pub mod gru;
pub mod ideal;
pub mod network;
pub mod parity;
pub mod table;

#[cfg(target_os = "none")]
pub mod kernel;

// Only the image needs them, and a test of their checksum: the tool that writes them must build without
// them.
#[cfg(any(target_os = "none", test))]
// Generated; its header says what it is.
#[allow(missing_docs, clippy::all)]
pub mod tables {
    include!(env!("MAGPIE_TABLES_SOURCE"));
}

//! The model on the device: formats, tables, integer kernels. No floating point, no allocation.
//!
//! - [`axis_map`]: orientation of a sensor.
//! - [`formats`]: structs shared with the exporter.
//! - [`kernel`]: sums of the ideal model and of the recurrent network, bit-exact on every platform.
//! - [`integrity`]: checksums of tables and weights.
//! - `tables`: only in images and tests: the tables of this build, written by `magpie dev export`.

pub mod axis_map;
pub mod calibration;
pub mod encoding;
pub mod formats;
pub mod integrity;
pub mod kernel;

// Not in host builds: the tool that writes the tables must build without them.
#[cfg(any(target_os = "none", test))]
// Generated.
#[allow(missing_docs, unused_imports, clippy::all)]
pub mod tables {
    include!(env!("MAGPIE_TABLES_SOURCE"));
}

//! Analyses of recordings and models. Nothing here imports the command line, the report or the device access.
//!
//! - [`replay`]: recordings through the device's code, compared with the reference.
//! - [`compare`]: error of a model relative to the noise floor, and its attribution to covariates.
//! - [`comparison`]: the same from files, with all setup errors.
//! - [`data_quality`]: setup errors in recordings.
//! - [`diagnose`]: missing physical effects.
//! - [`model`]: a model, read once.
//! - [`import`]: tables of other loggers as a campaign, checked.
//! - [`parameters`]: the fitted parameters of a model, and what the recordings do not identify.
//! - [`fit`], [`edit_model`]: fit of the base physics, and of other effects.
//! - [`workbench`]: models of one campaign side by side, each fitted on first use.
//! - [`network_training`]: training of recurrent networks.
//! - [`reference_delay`]: delay between the clocks of board and reference.
//! - [`calibration`], [`network_calibration`]: coverage of predicted standard deviations.
//! - [`notes`]: remarks on a result.
//! - [`statistics`]: running statistics. [`numbers`]: numbers as text. [`progress`]: progress bars.
//!
//! Results are data; the crate `report` writes their text.

pub mod calibration;
pub mod compare;
pub mod comparison;
pub mod data_quality;
pub mod diagnose;
pub mod edit_model;
pub mod fit;
pub mod import;
pub mod model;
pub mod network_calibration;
pub mod network_training;
pub mod noise_floor;
pub mod notes;
pub mod numbers;
pub mod parameters;
pub mod progress;
pub mod reference_delay;
pub mod replay;
pub mod statistics;
pub mod workbench;

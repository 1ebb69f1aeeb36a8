//! Recordings and campaigns. A recording is one uninterrupted run of one gripper; a campaign is a folder
//! of recordings.
//!
//! - [`error`]: input errors and notices, each with file, line and column.
//! - [`input`]: regular files only, and the limits of all inputs.
//! - [`output`]: atomic writes that never overwrite foreign files.
//! - [`units`]: accepted units and their conversion factors.
//! - [`columns`]: column names and the channel layout.
//! - [`description`]: `recording.toml`: sensor scale and nominal design.
//! - [`csv_table`]: streaming reader of `.csv` and `.csv.gz` with validation and clock checks.
//! - [`noise`]: white-noise estimate from third differences.
//! - [`noise_estimate`]: noise of a recording as its estimators give it.
//! - [`noise_model`]: these estimators: noise of the aligned rows, and whether their order carries time.
//! - `repeated_settings`: pure error of a table of settings.
//! - `smooth_field`: the smooth that removes the motion of the load from that estimate.
//! - [`smoothing`]: local regression over rows, which excludes the reference's noise.
//! - `table_format`: how a foreign table writes its values.
//! - [`align`]: resampling of the board's stream onto the reference clock.
//! - [`stream`]: rows of one recording, on the reference clock or at the board's rate.
//! - [`recording`]: one recording in memory.
//! - [`windows`]: reading of a recording, averaged over the better one of two windows.
//! - [`campaign`]: all recordings of one gripper.
//! - [`dependence`]: recordings of a campaign that are not independent.
//! - [`mapping`]: mapping files and attitude conversion for imports.
//! - [`import`]: conversion of third-party tables to a campaign.
//! - [`mcap`]: topics of MCAP files and ROS 2 bags as tables, and the writer of MCAP files.
//! - [`guess`]: proposal of a mapping file from the names and values of a table.

#![warn(missing_docs)]

pub mod align;
pub mod campaign;
pub mod columns;
pub mod csv_table;
pub mod dependence;
pub mod description;
pub mod error;
pub mod guess;
pub mod import;
pub mod input;
pub mod mapping;
pub mod mcap;
pub mod noise;
pub mod noise_estimate;
pub mod noise_model;
pub mod output;
mod readers;
pub mod recording;
mod repeated_settings;
mod smooth_field;
pub mod smoothing;
pub mod stream;
mod table_format;
pub mod units;
pub mod windows;

pub use campaign::Campaign;
pub use error::{DataError, Location, Notice};
pub use recording::{Recording, SensorSeries};

/// The results, or the first error in their order: the same input always gives the same error, whichever thread met one first.
///
/// # Errors
/// A result is one.
pub fn in_order<T: Send, E: Send>(
    results: impl rayon::iter::ParallelIterator<Item = Result<T, E>>,
) -> Result<Vec<T>, E> {
    results.collect::<Vec<_>>().into_iter().collect()
}

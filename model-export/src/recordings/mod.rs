//! Recordings: one uninterrupted run of one gripper each; a campaign is a folder of them.
//!
//! - [`problem`]: what can be wrong with a recording, each with its place and its one sentence.
//! - [`columns`]: what a column's name means.
//! - [`layout`]: which channels a recording has.
//! - [`description`]: `recording.toml`, the sensor's scale and the nominal design.
//! - [`table`]: a `.csv` or `.csv.gz` as a stream of checked rows.
//! - [`clock`]: a clock watched for gaps.
//! - [`noise`]: white noise of a stream, from differences of its rows.
//! - [`align`]: the board's stream brought to the reference's clock.
//! - [`stream`]: one recording as rows on the reference's clock.
//! - [`raw`]: one recording at the board's own rate, for replay.
//! - [`recording`]: one folder, checked, aligned and in memory.
//! - [`campaign`]: all recordings of one gripper.
//! - [`attitude`]: quaternions of foreign recordings as angles.
//! - [`mapping`]: what a mapping file holds.
//! - [`import`]: foreign tables turned into a campaign by a mapping file.

pub mod align;
pub mod attitude;
pub mod campaign;
pub mod clock;
pub mod columns;
pub mod description;
mod force_reader;
mod hall_reader;
pub mod import;
pub mod layout;
pub mod mapping;
pub mod noise;
pub mod problem;
pub mod raw;
pub mod recording;
pub mod stream;
pub mod table;

pub use campaign::Campaign;
pub use problem::{Notice, Place, Problem};
pub use recording::{Recording, SensorTrack};

//! One tolerant pass over every file of a campaign, in constant memory.
//!
//! - [`table`]: reader and statistics of one file. [`recording`]: both files of a recording.
//! - [`clock`]: order, duplicates and gaps of a clock; rotor speed.
//! - [`channel`]: statistics of a column. [`sensor`]: repeated samples and outliers.
//! - [`spectrum`]: averaged periodograms and their narrow lines.

pub mod channel;
pub mod clock;
pub mod recording;
pub mod sensor;
pub mod spectrum;
pub mod table;

pub use channel::{ColumnScan, Quantity};
pub use recording::RecordingScan;
pub use table::TableScan;

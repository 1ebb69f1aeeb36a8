//! Every file of a campaign read once, into figures that do not grow with its length.
//!
//! - [`rows`]: a table read tolerantly: what the strict reader refuses is passed over here.
//! - [`clock`]: order, copies and gaps of a clock.
//! - [`column`](mod@column): everything that is kept of a column, from the following.
//! - [`runs`]: stretches of equal values. [`ends`]: its extreme values. [`grid`]: its steps.
//!   [`spikes`]: rows that stand out, and its noise by quantiles. [`sample`]: a few values.
//! - [`spectrum`]: periodograms averaged, and the narrow lines in them.
//! - [`repeats`]: rows in which no field changed. [`turning`]: how steadily the rotor turned.
//! - [`table`]: one file. [`recording`]: both of a recording.

pub mod clock;
pub mod column;
pub mod ends;
pub mod grid;
pub mod recording;
pub mod repeats;
pub mod rows;
pub mod runs;
pub mod sample;
pub mod spectrum;
pub mod spikes;
pub mod table;
pub mod turning;

pub use column::{ColumnScan, Quantity};
pub use recording::RecordingScan;
pub use table::TableScan;

//! The sections of a comparison of networks with physics, as the paper shows it.
//!
//! - [`figures`]: the table.
//! - [`calibration`]: whether standard deviations mean what they say.
//! - [`time`]: truth and estimates over time (the paper's Fig. 7).
//! - [`spread`]: how often errors of each size occur (Fig. 8).
//! - [`lengths`]: the error against the seconds that are learned from.
//! - [`foreign`]: how surely a foreign magnet is noticed.

pub mod calibration;
pub mod figures;
pub mod foreign;
pub mod lengths;
pub mod spread;
pub mod time;

use super::Section;
use super::palette::{self, Role};
use crate::table::Table;
use crate::table::variant::Variant;

/// The paper's order and names: Fz above Fx.
const FORCES: [(usize, &str); 2] = [(1, "Fz, longitudinal"), (0, "Fx, lateral")];

/// The ways that are drawn over time and as histograms, as in the paper: ideal, 2 and 3 axes.
const DRAWN: [(Variant, Role); 3] = [
    (Variant::IdealFitted, palette::FIRST),
    (Variant::Gru2Axis, palette::SECOND),
    (Variant::Gru3Axis, palette::THIRD),
];

/// The page's heading.
pub fn title(table: &Table) -> String {
    format!(
        "magpie: ways of telling the force, recording {}",
        table.recordings.1
    )
}

/// All of them.
pub fn sections(table: &Table) -> Vec<Section> {
    let mut sections = vec![
        figures::section(table),
        time::section(table),
        spread::section(table),
        calibration::section(table),
    ];
    sections.extend(lengths::section(table));
    let magnet = table.foreign.as_ref();
    sections.extend(magnet.map(|magnet| foreign::section(&magnet.tally, &magnet.of)));
    sections
}

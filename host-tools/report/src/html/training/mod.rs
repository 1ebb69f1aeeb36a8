//! Sections of a benchmark of networks and physics, as in the paper.
//!
//! - [`figures`]: error tables.
//! - [`calibration`]: calibration of predicted standard deviations.
//! - [`time`]: reference and estimates over time (the paper's Fig. 7).
//! - [`spread`]: error histograms (Fig. 8).
//! - [`lengths`]: error versus training duration.
//! - [`foreign`]: magnetic-disturbance detector.

pub mod calibration;
pub mod figures;
pub mod foreign;
pub mod lengths;
pub mod spread;
pub mod time;

use crate::html::Section;
use crate::html::palette::{self, Role};
use crate::text::disturbance::detector;
use analysis::benchmark::Benchmark;
use analysis::benchmark::variants::EstimatorVariant;

/// Forces in the paper's order: Fz above Fx.
const FORCES: [(usize, &str); 2] = [(1, "Fz, longitudinal"), (0, "Fx, lateral")];

/// Estimators in the time plots and histograms, as in the paper: ideal, 2 and 3 axes.
const DRAWN: [(EstimatorVariant, Role); 3] = [
    (EstimatorVariant::IdealFitted, palette::FIRST),
    (EstimatorVariant::Gru2Axis, palette::SECOND),
    (EstimatorVariant::Gru3Axis, palette::THIRD),
];

/// Title.
pub fn title(table: &Benchmark) -> String {
    format!("magpie: force estimators, recording {}", table.recordings.1)
}

/// All sections.
pub fn sections(table: &Benchmark) -> Vec<Section> {
    let mut sections = vec![
        figures::section(table),
        time::section(table),
        spread::section(table),
        calibration::section(table),
    ];
    sections.extend(lengths::section(table));
    let magnet = table.disturbance.as_ref();
    sections
        .extend(magnet.map(|magnet| foreign::section(&magnet.counts, &detector(table, magnet))));
    sections
}

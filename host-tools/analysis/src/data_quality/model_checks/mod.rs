//! Setup errors that a model's prediction reveals: permuted axes, wrong signs, wrong units, and
//! clock offsets.
//!
//! - `case`: one sensor over one recording.
//! - `hypothesis`: candidate errors (permutations, signs, unit factors), and the one that removes the residual.
//! - `column_findings`: the findings.
//! - `clock`: offset of the reference's clock.
//!
//! A missing effect leaves a residual of some ten percent. A setup error leaves a residual as large as the
//! signal, and a single permutation removes nearly all of it: only that is reported.

mod case;
pub(super) mod clock;
pub(super) mod column_findings;
mod hypothesis;

use std::collections::BTreeSet;
use std::path::PathBuf;

use model_export::recordings::Campaign;
use model_export::recordings::align::Alignment;
use model_export::recordings::columns::Axis;
use model_export::recordings::csv_table::table_path;
use rayon::prelude::*;

use crate::data_quality::model_checks::case::Case;
pub use crate::data_quality::model_checks::case::SensorPrediction;
use crate::data_quality::model_checks::hypothesis::Verdict;
use crate::data_quality::scan::TolerantReader;

/// Input of a check against a model: residuals of the sensors in each recording.
pub struct ModelResiduals<'a> {
    campaign: &'a Campaign,
    names: Names,
    alignment: Alignment,
    /// Column errors, grouped over sensors and recordings.
    column_errors: Vec<Vec<Verdict>>,
    /// Cases of the recordings without column errors.
    sound: Vec<Case<'a>>,
}

impl<'a> ModelResiduals<'a> {
    /// Residuals of a campaign that was read with this alignment.
    pub fn new(
        campaign: &'a Campaign,
        alignment: Alignment,
        sensors: &[SensorPrediction<'a>],
    ) -> Self {
        let mut cases: Vec<Case> = sensors
            .par_iter()
            .flat_map_iter(|sensor| {
                let parts = sensor.rows.parts.iter().enumerate();
                parts.filter_map(|(recording, part)| Case::new(sensor, recording, part))
            })
            .collect();
        let column_errors = hypothesis::column_errors(campaign, &cases);
        let hit: BTreeSet<usize> =
            column_errors.iter().flatten().map(|verdict| verdict.recording).collect();
        cases.retain(|case| !hit.contains(&case.recording));
        Self { campaign, names: Names::of(campaign), alignment, column_errors, sound: cases }
    }
}

/// Headers of both tables of every recording.
pub struct Names {
    tables: Vec<[Table; 2]>,
}

/// File and header; empty where unreadable.
#[derive(Default)]
struct Table {
    path: PathBuf,
    header: Vec<String>,
}

impl Names {
    /// Reads the headers.
    pub fn of(campaign: &Campaign) -> Self {
        let table = |folder: &std::path::Path, name: &'static str| {
            let path = table_path(folder, name).ok()?;
            let header = TolerantReader::open(&path)?.header;
            Some(Table { path, header })
        };
        let recordings = campaign.recordings.iter();
        Self {
            tables: recordings
                .map(|recording| {
                    ["hall.csv", "force.csv"]
                        .map(|name| table(&recording.folder, name).unwrap_or_default())
                })
                .collect(),
        }
    }

    /// Path of the board's table.
    pub fn hall(&self, recording: usize) -> PathBuf {
        self.tables[recording][0].path.clone()
    }

    /// Path of the reference's table.
    pub fn force(&self, recording: usize) -> PathBuf {
        self.tables[recording][1].path.clone()
    }

    /// True where the sensor's field was recorded in counts.
    pub fn is_raw(&self, recording: usize, sensor: u32) -> bool {
        self.field(recording, sensor, 0).ends_with("_lsb")
    }

    /// Column name of a field; axis 0 is x, 1 y, 2 z.
    pub fn field(&self, recording: usize, sensor: u32, axis: usize) -> String {
        let prefix = format!("s{sensor}_{}_", Axis::ALL[axis].letter());
        let mut header = self.tables[recording][0].header.iter();
        header.find(|name| name.starts_with(&prefix)).cloned().unwrap_or(prefix)
    }
}

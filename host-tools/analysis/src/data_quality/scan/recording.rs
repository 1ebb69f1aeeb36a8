//! Scan of both tables of a recording.

use std::path::{Path, PathBuf};

use firmware::sensors::hall::a31301::FIELD_LIMITS;
use model_export::recordings::columns::FieldUnit;
use model_export::recordings::description::RecordingDescription;

use crate::data_quality::scan::channel::{ColumnScan, Quantity};
use crate::data_quality::scan::table::{TableScan, table_path};

/// Scan of one recording.
#[derive(Clone)]
pub struct RecordingScan {
    /// Name of the folder.
    pub name: String,
    /// Path of the folder.
    pub folder: PathBuf,
    /// Readable tables: the board's, the reference's.
    pub tables: Vec<TableScan>,
}

impl RecordingScan {
    /// Scans the recording in `folder`, one of `recordings`. Missing files are skipped: the strict
    /// reader reports them.
    pub fn read(folder: &Path, recordings: usize) -> Self {
        let description = RecordingDescription::read(folder).ok().map(|(found, _)| found);
        let declared = description.as_ref().map_or_else(Vec::new, |found| found.covariates.clone());
        let read = |name: &'static str| {
            let path = table_path(folder, name)?;
            TableScan::read(&path, name, &declared, recordings, |column| {
                prepare(column, description.as_ref());
            })
        };
        Self {
            name: folder
                .file_name()
                .map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
            folder: folder.to_path_buf(),
            tables: ["hall.csv", "force.csv"].into_iter().filter_map(read).collect(),
        }
    }

    /// Table by file name.
    pub fn table(&self, name: &str) -> Option<&TableScan> {
        self.tables.iter().find(|table| table.name == name)
    }
}

/// Sets scale and limits of a field.
fn prepare(column: &mut ColumnScan, description: Option<&RecordingDescription>) {
    let Quantity::Field { unit, .. } = column.quantity else {
        return;
    };
    let raw = unit == FieldUnit::Lsb;
    let most = description.map_or(f64::INFINITY, |found| found.saturated_gauss(raw));
    column.limits = (-most, most);
    if raw {
        column.scale = description.and_then(|found| found.gauss_per_lsb).unwrap_or(1.0);
        let (low, high) = (f64::from(FIELD_LIMITS.0), f64::from(FIELD_LIMITS.1));
        let most = most / column.scale;
        column.limits = (low.max(-most), high.min(most));
    }
}

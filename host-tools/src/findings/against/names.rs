//! How the columns are called, and in which files they are.

use std::path::PathBuf;

use model_export::recordings::Campaign;
use model_export::recordings::columns::Axis;

use crate::findings::scan::rows::{Rows, table_path};

/// The two tables of every recording.
pub struct Names {
    tables: Vec<[Table; 2]>,
}

/// A table's file and header; both empty where it cannot be read.
#[derive(Default)]
struct Table {
    path: PathBuf,
    header: Vec<String>,
}

impl Names {
    /// Reads the headers.
    pub fn of(campaign: &Campaign) -> Self {
        let table = |folder: &std::path::Path, name: &str| {
            let path = table_path(folder, name)?;
            let header = Rows::open(&path)?.header;
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

    /// The board's file.
    pub fn hall(&self, recording: usize) -> PathBuf {
        self.tables[recording][0].path.clone()
    }

    /// The reference's file.
    pub fn force(&self, recording: usize) -> PathBuf {
        self.tables[recording][1].path.clone()
    }

    /// True where the sensor's field was recorded as counts.
    pub fn is_raw(&self, recording: usize, sensor: u32) -> bool {
        let name = format!("s{sensor}_x_lsb");
        self.tables[recording][0].header.contains(&name)
    }

    /// Column of a field: 0 for x, 1 for y, 2 for z.
    pub fn field(&self, recording: usize, sensor: u32, axis: usize) -> String {
        let unit = match self.is_raw(recording, sensor) {
            true => "lsb",
            false => "gauss",
        };
        format!("s{sensor}_{}_{unit}", Axis::ALL[axis].letter())
    }
}

/// Column of a force.
pub fn force_name((place, axis): (u32, Axis)) -> String {
    format!("f{place}_{}_n", axis.letter())
}

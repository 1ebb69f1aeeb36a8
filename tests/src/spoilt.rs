//! A copy of a small campaign, spoilt in a way that a bench really would, or told otherwise.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

use flate2::read::GzDecoder;
use tempfile::TempDir;

use crate::{data, pack};

/// A table as text cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    /// Names of the columns.
    pub header: Vec<String>,
    /// Row by row.
    pub rows: Vec<Vec<String>>,
}

impl Cells {
    /// Reads a packed table.
    pub fn read(path: &Path) -> Self {
        let mut text = String::new();
        GzDecoder::new(fs::File::open(path).expect("a file"))
            .read_to_string(&mut text)
            .expect("text");
        let mut rows = text.lines().map(|line| {
            let cells = line.split(',').map(str::to_owned);
            cells.collect::<Vec<_>>()
        });
        Self {
            header: rows.next().expect("a header"),
            rows: rows.collect(),
        }
    }

    fn write(&self, folder: &Path, name: &str) {
        let mut text = self.header.join(",") + "\n";
        for row in &self.rows {
            text += &(row.join(",") + "\n");
        }
        fs::write(folder.join(name), text).expect("written");
        pack(folder, name);
    }

    /// Where a column stands.
    pub fn index(&self, column: &str) -> usize {
        let place = self.header.iter().position(|name| name == column);
        place.unwrap_or_else(|| panic!("no column {column}"))
    }

    /// The numbers of a column.
    pub fn numbers(&self, column: &str) -> Vec<f64> {
        let i = self.index(column);
        self.rows
            .iter()
            .map(|row| row[i].parse().expect("a number"))
            .collect()
    }

    /// Changes a column: the row's number and its value make the new text.
    pub fn change(&mut self, column: &str, change: impl Fn(usize, f64) -> String) {
        let i = self.index(column);
        for (number, row) in self.rows.iter_mut().enumerate() {
            row[i] = change(number, row[i].parse().expect("a number"));
        }
    }

    /// Exchanges the names of two columns.
    pub fn exchange(&mut self, one: &str, other: &str) {
        let (one, other) = (self.index(one), self.index(other));
        self.header.swap(one, other);
    }
}

/// A campaign of one's own, in a folder that goes away.
pub struct Spoilt {
    folder: TempDir,
}

impl Default for Spoilt {
    fn default() -> Self {
        Self::new()
    }
}

impl Spoilt {
    /// A copy of `clean`, nothing spoilt yet.
    pub fn new() -> Self {
        Self::of("clean")
    }

    /// A copy of another small campaign.
    pub fn of(campaign: &str) -> Self {
        let spoilt = Self {
            folder: TempDir::new().expect("a folder"),
        };
        for recording in 1..=3 {
            let (from, to) = (
                data(campaign).join(recording.to_string()),
                spoilt.recording(recording),
            );
            fs::create_dir_all(&to).expect("a folder");
            for name in ["recording.toml", "hall.csv.gz", "force.csv.gz"] {
                fs::copy(from.join(name), to.join(name)).expect("copied");
            }
        }
        spoilt
    }

    /// The campaign's folder.
    pub fn path(&self) -> PathBuf {
        self.folder.path().join("campaign")
    }

    /// A folder beside it that does not exist yet.
    pub fn beside(&self) -> PathBuf {
        self.folder.path().join("mended")
    }

    /// Folder of a recording, from 1.
    pub fn recording(&self, number: u32) -> PathBuf {
        self.path().join(number.to_string())
    }

    /// Exchanges the names of two recordings' folders.
    pub fn exchange_recordings(self, one: u32, other: u32) -> Self {
        let between = self.path().join("between");
        fs::rename(self.recording(one), &between).expect("renamed");
        fs::rename(self.recording(other), self.recording(one)).expect("renamed");
        fs::rename(&between, self.recording(other)).expect("renamed");
        self
    }

    /// Changes the table `name` (without .gz) of these recordings.
    pub fn change(self, recordings: &[u32], name: &str, change: impl Fn(&mut Cells)) -> Self {
        for &recording in recordings {
            let path = self.recording(recording).join(format!("{name}.gz"));
            let mut cells = Cells::read(&path);
            change(&mut cells);
            fs::remove_file(path).expect("removed");
            cells.write(&self.recording(recording), name);
        }
        self
    }
}

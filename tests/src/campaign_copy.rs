//! Modified copies of a small campaign, with errors that occur on real setups.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

use flate2::read::GzDecoder;
use tempfile::TempDir;

use crate::{compress, data};

/// A CSV table as text.
#[derive(Clone, Debug, PartialEq)]
pub struct CsvTable {
    /// Column names.
    pub header: Vec<String>,
    /// Cells by rows.
    pub rows: Vec<Vec<String>>,
}

impl CsvTable {
    /// Reads a compressed table.
    pub fn read(path: &Path) -> Self {
        let mut text = String::new();
        GzDecoder::new(fs::File::open(path).expect("a file"))
            .read_to_string(&mut text)
            .expect("text");
        let mut rows = text.lines().map(|line| {
            let cells = line.split(',').map(str::to_owned);
            cells.collect::<Vec<_>>()
        });
        Self { header: rows.next().expect("a header"), rows: rows.collect() }
    }

    /// Writes it compressed, as `name` with .gz.
    pub fn write(&self, folder: &Path, name: &str) {
        let mut text = self.header.join(",") + "\n";
        for row in &self.rows {
            text += &(row.join(",") + "\n");
        }
        fs::write(folder.join(name), text).expect("written");
        compress(folder, name);
    }

    pub fn index(&self, column: &str) -> usize {
        let index = self.header.iter().position(|name| name == column);
        index.unwrap_or_else(|| panic!("no column {column}"))
    }

    pub fn numbers(&self, column: &str) -> Vec<f64> {
        let i = self.index(column);
        self.rows.iter().map(|row| row[i].parse().expect("a number")).collect()
    }

    /// Replaces a column's values by a function of row index and value.
    pub fn change(&mut self, column: &str, change: impl Fn(usize, f64) -> String) {
        let i = self.index(column);
        for (number, row) in self.rows.iter_mut().enumerate() {
            row[i] = change(number, row[i].parse().expect("a number"));
        }
    }

    /// Removes a column.
    pub fn remove(&mut self, column: &str) {
        let i = self.index(column);
        self.header.remove(i);
        self.rows.iter_mut().for_each(|row| drop(row.remove(i)));
    }

    /// Swaps the names of two columns.
    pub fn exchange(&mut self, one: &str, other: &str) {
        let (one, other) = (self.index(one), self.index(other));
        self.header.swap(one, other);
    }
}

/// A copy of a campaign in a temporary folder.
pub struct CampaignCopy {
    folder: TempDir,
}

impl Default for CampaignCopy {
    fn default() -> Self {
        Self::new()
    }
}

impl CampaignCopy {
    /// Copy of `clean`.
    pub fn new() -> Self {
        Self::of("clean")
    }

    /// Copy of a campaign in `tests/data`.
    pub fn of(campaign: &str) -> Self {
        let copy = Self { folder: TempDir::new().expect("a folder") };
        for recording in 1..=3 {
            let (from, to) =
                (data(campaign).join(recording.to_string()), copy.recording(recording));
            fs::create_dir_all(&to).expect("a folder");
            for name in ["recording.toml", "hall.csv.gz", "force.csv.gz"] {
                fs::copy(from.join(name), to.join(name)).expect("copied");
            }
        }
        copy
    }

    /// Folder of the campaign.
    pub fn path(&self) -> PathBuf {
        self.folder.path().join("campaign")
    }

    /// Output folder of a repair; does not exist yet.
    pub fn repaired_path(&self) -> PathBuf {
        self.folder.path().join("repaired")
    }

    /// Folder of a recording, numbered from 1.
    pub fn recording(&self, number: u32) -> PathBuf {
        self.path().join(number.to_string())
    }

    /// Swaps the folders of two recordings.
    pub fn exchange_recordings(self, one: u32, other: u32) -> Self {
        let temporary = self.path().join("temporary");
        fs::rename(self.recording(one), &temporary).expect("renamed");
        fs::rename(self.recording(other), self.recording(one)).expect("renamed");
        fs::rename(&temporary, self.recording(other)).expect("renamed");
        self
    }

    /// Modifies the table `name` (without .gz) of these recordings.
    pub fn change(self, recordings: &[u32], name: &str, change: impl Fn(&mut CsvTable)) -> Self {
        change_tables(&self.path(), recordings, name, change);
        self
    }
}

/// Modifies the table `name` (without .gz) of these recordings of a campaign.
pub fn change_tables(
    campaign: &Path,
    recordings: &[u32],
    name: &str,
    change: impl Fn(&mut CsvTable),
) {
    for recording in recordings {
        let folder = campaign.join(recording.to_string());
        let path = folder.join(format!("{name}.gz"));
        let mut cells = CsvTable::read(&path);
        change(&mut cells);
        fs::remove_file(path).expect("removed");
        cells.write(&folder, name);
    }
}

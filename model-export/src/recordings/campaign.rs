//! A campaign: a folder of recordings of one gripper.

use std::collections::BTreeSet;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use sha2::{Digest, Sha256};

use super::align::Alignment;
use super::description::{Design, FILE};
use super::problem::{Fault, Notice, Place, Problem};
use super::recording::Recording;

/// All recordings of one gripper, in the order in which they were made.
#[derive(Clone, Debug)]
pub struct Campaign {
    /// Its folder.
    pub folder: PathBuf,
    /// At least one, ordered by start.
    pub recordings: Vec<Recording>,
}

impl Campaign {
    /// Reads every recording in `folder`; a folder that is itself a recording is a campaign of one.
    ///
    /// `read` is called once for each recording that has been read, from any thread.
    pub fn read(
        folder: &Path,
        alignment: Alignment,
        read: impl Fn(&str) + Sync,
    ) -> Result<Self, Problem> {
        let folders = recording_folders(folder)?;
        let mut recordings = folders
            .par_iter()
            .map(|folder| {
                let recording = Recording::read(folder, alignment)?;
                read(&recording.name);
                Ok(recording)
            })
            .collect::<Result<Vec<_>, Problem>>()?;
        recordings.sort_by(|a, b| a.description.start_s.total_cmp(&b.description.start_s));
        let campaign = Self {
            folder: folder.to_path_buf(),
            recordings,
        };
        campaign.check_same_gripper()?;
        Ok(campaign)
    }

    /// Numbers of the sensors, the same in every recording.
    pub fn sensors(&self) -> Vec<u32> {
        self.recordings
            .first()
            .map_or_else(Vec::new, |first| first.sensors.keys().copied().collect())
    }

    /// The nominal design, the same in every recording.
    pub fn design(&self) -> Option<&Design> {
        self.recordings.first()?.description.design.as_ref()
    }

    /// What a person should know, recording by recording.
    pub fn notices(&self) -> impl Iterator<Item = &Notice> {
        self.recordings
            .iter()
            .flat_map(|recording| &recording.notices)
    }

    /// Seconds covered by the aligned rows.
    pub fn duration_s(&self) -> f64 {
        self.recordings.iter().map(Recording::span_s).sum()
    }

    /// Refuses recordings of different grippers or sensors.
    pub fn check_same_gripper(&self) -> Result<(), Problem> {
        let Some((first, others)) = self.recordings.split_first() else {
            return Ok(());
        };
        let different = |recording: &Recording, found: String, expected: String| {
            Err(Fault::DifferentGripper {
                found,
                expected,
                other: format!("recording {}", first.name),
            }
            .at(Place::file(&recording.folder)))
        };
        for recording in others {
            let list = |r: &Recording| {
                let sensors: Vec<String> = r.sensors.keys().map(u32::to_string).collect();
                format!("sensors {}", sensors.join(", "))
            };
            if !recording.sensors.keys().eq(first.sensors.keys()) {
                return different(recording, list(recording), list(first));
            }
            if recording.description.design != first.description.design {
                let found = "another [design]".to_owned();
                return different(recording, found, "its own".to_owned());
            }
            let scale = |r: &Recording| (r.description.gauss_per_lsb, r.description.range_gauss);
            if scale(recording) != scale(first) {
                let found = "another gauss_per_lsb or range_gauss".to_owned();
                return different(recording, found, "its own".to_owned());
            }
        }
        Ok(())
    }
}

/// Folders under `folder` (or itself) that hold a recording, ordered by name with numbers as numbers.
pub fn recording_folders(folder: &Path) -> Result<Vec<PathBuf>, Problem> {
    if folder.is_file() {
        return Err(Fault::NoFolder.at(Place::file(folder)));
    }
    let entries =
        fs::read_dir(folder).map_err(|error| Fault::Unreadable(error).at(Place::file(folder)))?;
    if is_recording(folder) {
        return Ok(vec![folder.to_path_buf()]);
    }
    let mut folders: Vec<PathBuf> = entries
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| path.is_dir() && is_recording(path))
        .collect();
    if folders.is_empty() {
        return Err(Fault::NoRecordings.at(Place::file(folder)));
    }
    folders.sort_by_key(|path| {
        let name = path
            .file_name()
            .map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        (name.parse::<u64>().unwrap_or(u64::MAX), name)
    });
    Ok(folders)
}

/// Anything that holds one of the three files is meant as a recording: what is missing is an error.
fn is_recording(folder: &Path) -> bool {
    [FILE, "hall.csv", "hall.csv.gz", "force.csv", "force.csv.gz"]
        .iter()
        .any(|name| folder.join(name).is_file())
}

/// A recording's name: that of its folder.
pub fn name_of(folder: &Path) -> String {
    let name = folder.file_name();
    name.map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

/// SHA-256 over a recording's files, in order of their names: the same bytes, the same hash.
pub fn fingerprint(folder: &Path) -> Result<String, Problem> {
    let mut hash = Sha256::new();
    let unreadable = |error| Fault::Unreadable(error).at(Place::file(folder));
    let files: BTreeSet<PathBuf> = fs::read_dir(folder)
        .map_err(unreadable)?
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| path.is_file())
        .collect();
    for path in files {
        let mut file = fs::File::open(&path).map_err(unreadable)?;
        let mut chunk = [0; 1 << 16];
        loop {
            match file.read(&mut chunk).map_err(unreadable)? {
                0 => break,
                n => hash.update(&chunk[..n]),
            }
        }
    }
    Ok(hex(&hash.finalize()))
}

/// Lower-case hexadecimal.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

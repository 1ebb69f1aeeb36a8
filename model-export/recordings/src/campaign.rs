//! A campaign: a folder of recordings of one gripper.

use crate::columns::SignalUnit;
use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::align::Alignment;
use crate::description::{NominalDesign, RECORDING_FILE};
use crate::error::{DataError, ErrorKind, Location, Notice};
use crate::in_order;
use crate::output::{is_draft, remove_abandoned};
use crate::recording::{Recording, fingerprint, recording_name};
use crate::repeated_settings;
use crate::windows::RecordingWindows;

/// All recordings of one gripper in order of their start.
#[derive(Clone, Debug)]
pub struct Campaign {
    /// Path of the folder.
    pub folder: PathBuf,
    /// At least one, in order of their start.
    pub recordings: Vec<Recording>,
}

impl Campaign {
    /// Reads every recording in `folder`; a folder that is itself a recording is a campaign of one.
    /// `progress` is called with the name of each completed recording, from any thread.
    pub fn read(
        folder: &Path,
        alignment: Alignment,
        progress: impl Fn(&str) + Sync,
    ) -> Result<Self, DataError> {
        let folders = recording_folders(folder)?;
        let mut recordings = in_order(folders.par_iter().map(|folder| {
            let recording = RecordingWindows::read(folder, alignment)?;
            progress(&recording.wide.name);
            Ok::<_, DataError>(recording)
        }))?;
        recordings
            .sort_by(|a, b| a.wide.description.start_s.total_cmp(&b.wide.description.start_s));
        let campaign = Self::of(folder.to_path_buf(), recordings);
        campaign.check_same_gripper()?;
        Ok(campaign)
    }

    /// All recordings of a folder, in order of their start.
    pub fn of(folder: PathBuf, recordings: Vec<RecordingWindows>) -> Self {
        let mut recordings = RecordingWindows::better(recordings);
        repeated_settings::between(&mut recordings);
        Self { folder, recordings }
    }

    /// Rows of all recordings, on the clock of the reference.
    pub fn row_count(&self) -> usize {
        self.recordings.iter().map(|recording| recording.time_s.len()).sum()
    }

    /// Indices of the sensors, equal in all recordings.
    pub fn sensors(&self) -> Vec<u32> {
        self.recordings
            .first()
            .map_or_else(Vec::new, |first| first.sensors.keys().copied().collect())
    }

    /// Nominal design, equal in all recordings.
    pub fn design(&self) -> Option<&NominalDesign> {
        self.recordings.first()?.description.design.as_ref()
    }

    /// Notices of all recordings.
    pub fn notices(&self) -> impl Iterator<Item = &Notice> {
        self.recordings.iter().flat_map(|recording| &recording.notices)
    }

    /// Unit of the signals, that of the first sensor.
    pub fn signal_unit(&self) -> SignalUnit {
        self.recordings.first().map_or(SignalUnit::Gauss, |recording| recording.noise.unit)
    }

    /// Total time of the aligned rows in seconds.
    pub fn duration_s(&self) -> f64 {
        self.recordings.iter().map(Recording::span_s).sum()
    }

    /// Checks that all recordings have the same sensors, design and scale.
    pub fn check_same_gripper(&self) -> Result<(), DataError> {
        let Some((first, others)) = self.recordings.split_first() else {
            return Ok(());
        };
        let different = |recording: &Recording, found: String, expected: String| {
            Err(ErrorKind::InconsistentCampaign {
                found,
                expected,
                other: format!("recording {}", first.name),
            }
            .at(Location::file(&recording.folder)))
        };
        for recording in others {
            let sensor_list = |r: &Recording| {
                let sensors: Vec<String> = r.sensors.keys().map(u32::to_string).collect();
                format!("sensors {}", sensors.join(", "))
            };
            if !recording.sensors.keys().eq(first.sensors.keys()) {
                return different(recording, sensor_list(recording), sensor_list(first));
            }
            if recording.description.design != first.description.design {
                let found = "one [design]".to_owned();
                return different(recording, found, "another".to_owned());
            }
            let scale = |r: &Recording| (r.description.gauss_per_lsb, r.description.range_gauss);
            if scale(recording) != scale(first) {
                let found = "one gauss_per_lsb or range_gauss".to_owned();
                return different(recording, found, "another".to_owned());
            }
        }
        Ok(())
    }
}

/// Folders of recordings in `folder` (or itself), in natural order of their names: not those that are being written. What a killed
/// writer has left there is deleted.
pub fn recording_folders(folder: &Path) -> Result<Vec<PathBuf>, DataError> {
    if folder.is_file() {
        return Err(ErrorKind::CampaignIsFile.at(Location::file(folder)));
    }
    let entries = fs::read_dir(folder)
        .map_err(|error| ErrorKind::Unreadable(error).at(Location::file(folder)))?;
    if is_recording(folder) {
        return Ok(vec![folder.to_path_buf()]);
    }
    remove_abandoned(folder);
    let mut folders: Vec<PathBuf> = entries
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| path.is_dir() && !is_draft(path) && is_recording(path))
        .collect();
    if folders.is_empty() {
        let kind = match several_campaigns(folder) {
            Some(campaigns) => ErrorKind::SeveralCampaigns { campaigns },
            None => ErrorKind::NoRecordings,
        };
        return Err(kind.at(Location::file(folder)));
    }
    folders.sort_by_key(|path| {
        let name = recording_name(path);
        (name.parse::<u64>().unwrap_or(u64::MAX), name)
    });
    Ok(folders)
}

/// SHA-256 of each recording of a campaign, by which output files name it as their input.
pub fn fingerprints(folder: &Path) -> Result<Vec<String>, DataError> {
    recording_folders(folder)?.iter().map(|folder| fingerprint(folder)).collect()
}

/// Names of the folders that are campaigns.
fn several_campaigns(folder: &Path) -> Option<String> {
    let folders = |folder: &Path| -> Vec<PathBuf> {
        let entries = fs::read_dir(folder).into_iter().flatten();
        entries
            .filter_map(|entry| entry.ok().map(|entry| entry.path()))
            .filter(|path| path.is_dir())
            .collect()
    };
    let is_campaign = |path: &PathBuf| folders(path).iter().any(|path| is_recording(path));
    let mut campaigns: Vec<String> = folders(folder)
        .iter()
        .filter(|path| is_campaign(path))
        .map(|path| recording_name(path))
        .collect();
    campaigns.sort();
    (!campaigns.is_empty()).then(|| campaigns.join(", "))
}

/// A folder with any of the three files counts as a recording: the missing files are errors.
fn is_recording(folder: &Path) -> bool {
    [RECORDING_FILE, "hall.csv", "hall.csv.gz", "force.csv", "force.csv.gz"]
        .iter()
        .any(|name| folder.join(name).is_file())
}

//! The recordings of a campaign: cached in memory if they are few, otherwise read again for each pass.

use crate::progress;
use anyhow::{Result, bail};
use model_export::model_file::ModelFile;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::{fingerprint, recording_folders};
use model_export::recordings::description::RecordingDescription;
use model_export::recordings::recording::recording_name;
use model_export::recordings::{Campaign, DataError, Recording};
use rayon::prelude::*;
use std::borrow::Cow;
use std::path::{Path, PathBuf};

/// Rows per sensor in memory at the same time: ten minutes at 100 Hz.
pub const MAX_ROWS_IN_MEMORY: usize = 60_000;

/// Identity of a recording.
#[derive(Clone, Debug)]
pub struct RecordingId {
    /// Folder of the recording.
    pub folder: PathBuf,
    /// Name of the folder.
    pub name: String,
    /// SHA-256 over its files.
    pub sha256: String,
}

/// The recordings of a campaign.
pub struct CampaignReader {
    /// The campaign's folder.
    pub folder: PathBuf,
    /// Alignment of the clocks.
    pub alignment: Alignment,
    /// Recordings in chronological order.
    pub names: Vec<RecordingId>,
    /// Number of recordings in memory at the same time.
    pub at_once: usize,
    /// All recordings, if they are few.
    cache: Vec<Recording>,
}

impl CampaignReader {
    /// Finds the recordings and reads them if they are few.
    ///
    /// # Errors
    /// A recording cannot be read, or two are the same data.
    pub fn open(folder: &Path, alignment: Alignment) -> Result<Self> {
        let mut list = recording_folders(folder)?
            .into_par_iter()
            .map(|folder| {
                let (description, _) = RecordingDescription::read(&folder)?;
                let named = RecordingId {
                    name: recording_name(&folder),
                    sha256: fingerprint(&folder)?,
                    folder,
                };
                Ok((description.start_s, named))
            })
            .collect::<Result<Vec<_>, DataError>>()?;
        list.sort_by(|a, b| a.0.total_cmp(&b.0));
        let names: Vec<RecordingId> = list.into_iter().map(|(_, named)| named).collect();
        for (i, one) in names.iter().enumerate() {
            if let Some(other) = names[..i].iter().find(|other| other.sha256 == one.sha256) {
                bail!(
                    "{}: recordings {} and {} are the same data; remove one",
                    folder.display(),
                    other.name,
                    one.name
                );
            }
        }
        let mut source =
            Self { folder: folder.to_path_buf(), alignment, names, at_once: 1, cache: Vec::new() };
        let first = source.read(0)?.into_owned();
        source.at_once = (MAX_ROWS_IN_MEMORY / first.time_s.len().max(1)).max(1);
        if source.names.len() <= source.at_once {
            let bar = progress::progress_bar("reading recordings", source.names.len());
            bar.inc(1);
            let others = source.names[1..]
                .par_iter()
                .map(|named| {
                    let recording = Recording::read(&named.folder, alignment);
                    bar.inc(1);
                    recording
                })
                .collect::<Vec<_>>()
                .into_iter()
                .collect::<Result<Vec<_>, DataError>>()?;
            bar.finish_and_clear();
            source.cache = std::iter::once(first).chain(others).collect();
        }
        Ok(source)
    }

    /// Reads one recording, from the cache where possible.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn read(&self, place: usize) -> Result<Cow<'_, Recording>, DataError> {
        match self.cache.get(place) {
            Some(recording) => Ok(Cow::Borrowed(recording)),
            None => Ok(Cow::Owned(Recording::read(&self.names[place].folder, self.alignment)?)),
        }
    }

    /// Some of the recordings as a campaign.
    ///
    /// # Errors
    /// One cannot be read, or they are of different grippers.
    pub fn campaign(&self, places: &[usize]) -> Result<Campaign, DataError> {
        let read = |place: &usize| Ok(self.read(*place)?.into_owned());
        let campaign = Campaign {
            folder: self.folder.clone(),
            recordings: places
                .par_iter()
                .map(read)
                .collect::<Vec<_>>()
                .into_iter()
                .collect::<Result<_, DataError>>()?,
        };
        campaign.check_same_gripper()?;
        Ok(campaign)
    }
}

/// Reads a whole campaign with a progress bar.
///
/// # Errors
/// A recording cannot be read.
pub fn read_campaign(folder: &Path, alignment: Alignment) -> Result<Campaign> {
    let bar = progress::progress_bar("reading recordings", recording_folders(folder)?.len());
    let campaign = Campaign::read(folder, alignment, |_| bar.inc(1))?;
    bar.finish_and_clear();
    Ok(campaign)
}

/// Refuses recordings whose sensor scale differs from the model's.
///
/// # Errors
/// The scales differ.
pub fn check_sensor_scale(
    folder: &Path,
    description: &RecordingDescription,
    model: &ModelFile,
) -> Result<()> {
    let (own, stated) = (model.sensor_scale.gauss_per_lsb, description.gauss_per_lsb);
    if let Some(other) = stated.filter(|other| *other != own) {
        bail!(
            "{}: gauss_per_lsb is {other}, but the model's tables are for {own}; fit these recordings, or correct recording.toml",
            folder.display()
        );
    }
    Ok(())
}

/// Index of the held-out recording: `number` counted from 1, or the last one.
///
/// # Errors
/// There are fewer than two recordings, or fewer than `number`.
pub fn held_out_index(campaign: &Path, recordings: usize, number: Option<usize>) -> Result<usize> {
    if recordings < 2 {
        bail!(
            "{}: there is one recording, and a second one is required for validation: split it in two, or record again",
            campaign.display()
        );
    }
    match number {
        None => Ok(recordings - 1),
        Some(number @ 1..) if number <= recordings => Ok(number - 1),
        Some(number) => {
            bail!("--hold-out {number}: there are {recordings} recordings, counted from 1")
        }
    }
}

/// Fails if two recordings, given as name and SHA-256, hold the same data: one could be fitted and the other
/// held out.
pub fn check_distinct<'a>(
    campaign: &str,
    recordings: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<()> {
    let mut seen: Vec<(&str, &str)> = Vec::new();
    for (name, sha256) in recordings {
        if let Some((other, _)) = seen.iter().find(|(_, hash)| *hash == sha256) {
            bail!(
                "{campaign}: recordings {other} and {name} are the same data; remove one, or the held-out errors would not be held out"
            );
        }
        seen.push((name, sha256));
    }
    Ok(())
}

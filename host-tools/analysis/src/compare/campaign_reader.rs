//! The recordings of a campaign: scanned for setup errors, then cached in memory if they are few, otherwise read again
//! for each pass.

use crate::data_quality::{Finding, scan_files};
use crate::progress;
use anyhow::{Result, bail};
use model_export::model_file::ModelFile;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::description::RecordingDescription;
use model_export::recordings::in_order;
use model_export::recordings::recording::{fingerprint, recording_name};
use model_export::recordings::windows::RecordingWindows;
use model_export::recordings::{Campaign, DataError, Recording};
use model_export::stop;
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
    /// All recordings, if they are few or were requested.
    cache: Option<Campaign>,
}

/// A campaign after the data-quality scan of its files.
pub struct ScannedCampaign {
    /// The campaign's folder.
    pub folder: PathBuf,
    /// Findings from the files alone, most severe first.
    pub findings: Vec<Finding>,
    /// The recordings; `None` if a finding stops the evaluation.
    pub reader: Option<CampaignReader>,
}

impl ScannedCampaign {
    /// Scans the files and opens the campaign unless a finding stops the evaluation.
    ///
    /// # Errors
    /// There are no recordings, or one cannot be read.
    pub fn open(folder: &Path, alignment: Alignment, caching: Caching) -> Result<Self> {
        let findings = scan_with_progress(folder, alignment)?;
        let stops = findings.iter().any(|finding| finding.stops);
        let open = || CampaignReader::open(folder, alignment, caching);
        let reader = if stops { None } else { Some(open()?) };
        Ok(Self { folder: folder.to_path_buf(), findings, reader })
    }
}

/// [`scan_files`] with a progress bar.
///
/// # Errors
/// The folder holds no recordings.
pub fn scan_with_progress(folder: &Path, alignment: Alignment) -> Result<Vec<Finding>> {
    let bar = progress::progress_bar("checking recordings", recording_folders(folder)?.len());
    let findings = scan_files(folder, alignment, |_| bar.inc(1))?;
    bar.finish_and_clear();
    Ok(findings)
}

/// Which recordings stay in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Caching {
    /// All of them.
    Always,
    /// All of them if they are few, otherwise none.
    IfFew,
}

impl CampaignReader {
    /// Finds the recordings and caches them.
    ///
    /// # Errors
    /// A recording cannot be read.
    pub fn open(folder: &Path, alignment: Alignment, caching: Caching) -> Result<Self> {
        let folders = recording_folders(folder)?.into_par_iter();
        let mut list = in_order(folders.map(|folder| {
            let (description, _) = RecordingDescription::read(&folder)?;
            let named = RecordingId {
                name: recording_name(&folder),
                sha256: fingerprint(&folder)?,
                folder,
            };
            Ok::<_, DataError>((description.start_s, named))
        }))?;
        list.sort_by(|a, b| a.0.total_cmp(&b.0));
        let names: Vec<RecordingId> = list.into_iter().map(|(_, named)| named).collect();
        let mut source =
            Self { folder: folder.to_path_buf(), alignment, names, at_once: 1, cache: None };
        let first = source.read_windows(0)?;
        source.at_once = (MAX_ROWS_IN_MEMORY / first.wide.time_s.len().max(1)).max(1);
        if caching == Caching::Always || source.names.len() <= source.at_once {
            let bar = progress::progress_bar("reading recordings", source.names.len());
            bar.inc(1);
            let read = |place: usize| {
                let recording = source.read_windows(place)?;
                bar.inc(1);
                Ok(recording)
            };
            let others: Vec<Result<_, DataError>> =
                (1..source.names.len()).into_par_iter().map(read).collect();
            let recordings = std::iter::once(Ok(first)).chain(others).collect::<Result<_, _>>()?;
            bar.finish_and_clear();
            source.cache = Some(Campaign::of(folder.to_path_buf(), recordings));
        }
        Ok(source)
    }

    /// All recordings, where they are in memory.
    pub fn cached(&self) -> Option<&Campaign> {
        self.cache.as_ref()
    }

    /// Fails if two recordings are the same data.
    ///
    /// # Errors
    /// Two recordings are the same data.
    pub fn check_distinct(&self) -> Result<()> {
        for (i, one) in self.names.iter().enumerate() {
            if let Some(other) = self.names[..i].iter().find(|other| other.sha256 == one.sha256) {
                bail!(
                    "{}: recordings {} and {} are the same data; remove one",
                    self.folder.display(),
                    other.name,
                    one.name
                );
            }
        }
        Ok(())
    }

    fn read_windows(&self, place: usize) -> Result<RecordingWindows, DataError> {
        stop::check();
        let named = &self.names[place];
        let recording = RecordingWindows::read(&named.folder, self.alignment)?;
        Ok(recording.with_sha256(&named.sha256))
    }

    /// Reads one recording, from the cache where possible.
    ///
    /// # Errors
    /// The recording is unreadable.
    pub fn read(&self, place: usize) -> Result<Cow<'_, Recording>, DataError> {
        if let Some(campaign) = &self.cache {
            return Ok(Cow::Borrowed(&campaign.recordings[place]));
        }
        Ok(Cow::Owned(self.read_windows(place)?.alone()))
    }

    /// All recordings as a campaign.
    ///
    /// # Errors
    /// One cannot be read, or they are of different grippers.
    pub fn whole(&self) -> Result<Cow<'_, Campaign>, DataError> {
        let places: Vec<usize> = (0..self.names.len()).collect();
        self.campaign(&places)
    }

    /// Some of the recordings, in ascending order, as a campaign.
    ///
    /// # Errors
    /// One cannot be read, or they are of different grippers.
    pub fn campaign(&self, places: &[usize]) -> Result<Cow<'_, Campaign>, DataError> {
        let campaign = match &self.cache {
            Some(campaign) if places.len() == campaign.recordings.len() => Cow::Borrowed(campaign),
            _ => {
                let read = |place: &usize| Ok(self.read(*place)?.into_owned());
                let recordings: Vec<Result<_, DataError>> = places.par_iter().map(read).collect();
                Cow::Owned(Campaign {
                    folder: self.folder.clone(),
                    recordings: recordings.into_iter().collect::<Result<_, _>>()?,
                })
            }
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

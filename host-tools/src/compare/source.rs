//! The recordings of a campaign: kept in memory where they are few, read again where they are many.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::{fingerprint, name_of, recording_folders};
use model_export::recordings::description::Description;
use model_export::recordings::{Campaign, Problem, Recording};
use rayon::prelude::*;

use crate::progress;

/// Rows for each sensor that are held in memory at once: ten minutes at 100 Hz.
pub const MOST_ROWS: usize = 60_000;

/// One recording, by name.
#[derive(Clone, Debug)]
pub struct Named {
    /// Its folder.
    pub folder: PathBuf,
    /// The folder's name.
    pub name: String,
    /// SHA-256 over its files.
    pub sha256: String,
}

/// The recordings of a campaign.
pub struct Source {
    /// The campaign's folder.
    pub folder: PathBuf,
    /// How the clocks belong together.
    pub alignment: Alignment,
    /// In the order in which they were made.
    pub names: Vec<Named>,
    /// Recordings that are held in memory at once.
    pub at_once: usize,
    /// All of them, where they are few.
    kept: Vec<Recording>,
}

impl Source {
    /// Finds the recordings and reads them where they are few.
    pub fn open(folder: &Path, alignment: Alignment) -> Result<Self> {
        let mut list = recording_folders(folder)?
            .into_par_iter()
            .map(|folder| {
                let (description, _) = Description::read(&folder)?;
                let named = Named {
                    name: name_of(&folder),
                    sha256: fingerprint(&folder)?,
                    folder,
                };
                Ok((description.start_s, named))
            })
            .collect::<Result<Vec<_>, Problem>>()?;
        list.sort_by(|a, b| a.0.total_cmp(&b.0));
        let names: Vec<Named> = list.into_iter().map(|(_, named)| named).collect();
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
        let mut source = Self {
            folder: folder.to_path_buf(),
            alignment,
            names,
            at_once: 1,
            kept: Vec::new(),
        };
        let first = source.read(0)?.into_owned();
        source.at_once = (MOST_ROWS / first.time_s.len().max(1)).max(1);
        if source.names.len() <= source.at_once {
            let bar = progress::bar("reading recordings", source.names.len());
            bar.inc(1);
            let others = source.names[1..]
                .par_iter()
                .map(|named| {
                    let recording = Recording::read(&named.folder, alignment);
                    bar.inc(1);
                    recording
                })
                .collect::<Result<Vec<_>, Problem>>()?;
            bar.finish_and_clear();
            source.kept = std::iter::once(first).chain(others).collect();
        }
        Ok(source)
    }

    /// One recording.
    pub fn read(&self, place: usize) -> Result<Cow<'_, Recording>, Problem> {
        match self.kept.get(place) {
            Some(recording) => Ok(Cow::Borrowed(recording)),
            None => Ok(Cow::Owned(Recording::read(
                &self.names[place].folder,
                self.alignment,
            )?)),
        }
    }

    /// Some recordings as a campaign of their own.
    pub fn campaign(&self, places: &[usize]) -> Result<Campaign, Problem> {
        let read = |place: &usize| Ok(self.read(*place)?.into_owned());
        let campaign = Campaign {
            folder: self.folder.clone(),
            recordings: places
                .par_iter()
                .map(read)
                .collect::<Result<_, Problem>>()?,
        };
        campaign.check_same_gripper()?;
        Ok(campaign)
    }
}

//! Import of measurement tables as a campaign, with the checks of a fit.

use std::error::Error;
use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::Result;
use model_export::error::ErrorKind;
use model_export::fit::FitError;
use model_export::fit::campaign::FitSetup;
use model_export::recordings::align::Alignment;
use model_export::recordings::import::{self, Imported};
use model_export::recordings::{Campaign, DataError};

use crate::compare::campaign_reader::scan_with_progress;
use crate::fit::{data_findings, unused_forces};
use crate::notes::{Note, collect};
use crate::progress;

/// Ratio of the lengths of two tables of one recording from which a clock is probably in another unit.
const OTHER_UNIT: f64 = 30.0;

pub struct ImportedCampaign {
    /// The recordings, as a fit will read them.
    pub campaign: Campaign,
    /// Folder and rows of each.
    pub recordings: Vec<Imported>,
    /// Notes on the recordings and their setup errors.
    pub notes: Vec<Note>,
    /// Why a fit will refuse them.
    pub fit_error: Option<FitError>,
}

impl ImportedCampaign {
    /// Whether the unit of a channel is wrong.
    pub fn has_wrong_unit(&self) -> bool {
        self.notes.iter().any(is_of_unit)
    }

    /// Whether the mapping must be corrected before a fit.
    pub fn is_refused(&self) -> bool {
        let stops = |note: &Note| matches!(note, Note::SetupError(finding) if finding.stops);
        self.fit_error.is_some() || self.notes.iter().any(stops)
    }
}

fn is_of_unit(note: &Note) -> bool {
    matches!(note, Note::SetupError(finding) if finding.is_channel_unit())
}

/// Converts `sources` with a mapping file to the campaign `output`, which must not exist, and checks it.
///
/// # Errors
/// The mapping or a source cannot be used; the message says what to correct in the mapping.
pub fn import_campaign(
    mapping: &Path,
    sources: &[PathBuf],
    output: &Path,
) -> Result<ImportedCampaign> {
    let explained = |error| ImportError::of(error, mapping, output);
    collect(|notes| {
        let bar = progress::progress_bar("importing", sources.len());
        let (recordings, notices) =
            import::import(mapping, sources, output, |_| bar.inc(1)).map_err(explained)?;
        bar.finish_and_clear();
        notes.extend(notices.into_iter().map(Note::Recording));
        let alignment = Alignment { delay_us: 0.0 };
        let campaign = Campaign::read(output, alignment, |_| ()).map_err(explained)?;
        let findings = data_findings(scan_with_progress(&campaign.folder, alignment)?, &campaign);
        notes.extend(findings.into_iter().map(Box::new).map(Note::SetupError));
        notes.extend(unused_forces(&campaign).map(Note::Recording));
        // A channel in another unit looks like permuted axes, too.
        let fit_error = campaign.design().and_then(|_| FitSetup::cylinder(&campaign).err());
        let fit_error = fit_error.filter(|_| !notes.iter().any(is_of_unit));
        Ok(ImportedCampaign { campaign, recordings, notes: std::mem::take(notes), fit_error })
    })
}

/// An error with what to correct in the mapping: the user has the sources and the mapping, not the columns of the new recordings.
#[derive(Debug)]
pub struct ImportError {
    pub error: DataError,
    text: String,
}

impl fmt::Display for ImportError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl Error for ImportError {}

impl ImportError {
    fn of(error: DataError, mapping: &Path, output: &Path) -> Self {
        let mapping = mapping.display();
        let is_in_campaign =
            error.location.file.starts_with(output) && error.location.file != output;
        let text = match *error.kind {
            ErrorKind::NoOverlap { hall_from, hall_to, force_from, force_to } => {
                let ratio = (force_to - force_from) / (hall_to - hall_from);
                let increase = hall_from - force_from;
                if (1.0 / OTHER_UNIT..=OTHER_UNIT).contains(&ratio) {
                    format!(
                        "{error}; in {mapping}: where both began at the same instant, increase offset_s of the clock of [force] by \
                         {increase:.3}, or, where they do in every recording, set from_first_row = true in both clocks"
                    )
                } else {
                    format!(
                        "{error}; {mapping}: the reference lasts {ratio:.3} times as long as the board, as if one of the two clocks were in \
                         another unit: correct `unit` of the clock there"
                    )
                }
            }
            ErrorKind::EmptyCell if !error.location.file.starts_with(output) => {
                format!("{error}; or leave the column out of {mapping}")
            }
            _ if is_in_campaign && error.kind.is_of_unit() => {
                format!("{error}; units and clocks are what {mapping} states: correct `unit` there")
            }
            _ if is_in_campaign => {
                format!("{error} ({mapping} states which columns of the source this file has)")
            }
            _ => error.to_string(),
        };
        Self { error, text }
    }
}

//! A campaign with its setup errors: those of its files, and those that a model shows.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use anyhow::Result;
use model_export::effects::ExcitationSeries;
use model_export::fit::rows::SensorRows;
use model_export::model_file::Predictor;
use model_export::recordings::align::Alignment;
use model_export::recordings::{Campaign, DataError};

use crate::compare::campaign_reader::{Caching, CampaignReader, ScannedCampaign};
use crate::data_quality::campaign_checks::{campaign_findings, is_of_set_covariates};
use crate::data_quality::finding::Finding;
use crate::data_quality::model_checks::SensorPrediction;
use crate::data_quality::{check_against_model, merge};
use crate::model::Model;
use crate::notes::Note;
use crate::progress;

/// A campaign after the checks of its files and against a model.
pub struct CheckedCampaign {
    /// The campaign's folder.
    pub folder: PathBuf,
    /// Setup errors, most severe first.
    pub findings: Vec<Finding>,
    /// `None` if a finding from the files stops the evaluation.
    reader: Option<CampaignReader>,
}

impl CheckedCampaign {
    /// Scans the files of a campaign, reads its recordings and compares them with the predictions of a model.
    ///
    /// # Errors
    /// A recording cannot be read.
    pub fn open(
        folder: &Path,
        model: &Model,
        alignment: Alignment,
        caching: Caching,
    ) -> Result<Self> {
        let ScannedCampaign { folder, findings, reader } =
            ScannedCampaign::open(folder, alignment, caching)?;
        let of_model = match &reader {
            Some(reader) => model_findings(reader, model)?,
            None => Vec::new(),
        };
        let mut findings = merge(findings, of_model);
        if let Some(campaign) = reader.as_ref().and_then(CampaignReader::cached) {
            findings.retain(|finding| !is_of_set_covariates(finding, campaign));
            findings.extend(campaign_findings(campaign));
        }
        Ok(Self { folder, findings, reader })
    }

    /// The recordings; `None` if a setup error prevents any result.
    ///
    /// # Errors
    /// Two recordings are the same data.
    pub fn distinct(&self) -> Result<Option<&CampaignReader>> {
        if let Some(reader) = &self.reader {
            reader.check_distinct()?;
        }
        Ok(self.reader())
    }

    /// The recordings, which may be the same data; `None` if a setup error prevents any result.
    pub fn reader(&self) -> Option<&CampaignReader> {
        let is_stopped = self.findings.iter().any(|finding| finding.stops);
        self.reader.as_ref().filter(|_| !is_stopped)
    }

    /// All recordings; `None` if a setup error prevents any result.
    ///
    /// # Errors
    /// One cannot be read, or they are of different grippers.
    pub fn campaign(&self) -> Result<Option<Cow<'_, Campaign>>, DataError> {
        self.reader().map(CampaignReader::whole).transpose()
    }

    /// Notes on a model that was fitted to other recordings; none where a setup error prevents any result.
    ///
    /// # Errors
    /// A recording cannot be read.
    pub fn notes(&self, model: &Model) -> Result<Vec<Note>, DataError> {
        let Some(campaign) = self.campaign()? else { return Ok(Vec::new()) };
        let design = Note::other_design(&campaign, &model.file);
        Ok(design.into_iter().chain(self.other_recordings(model)).collect())
    }

    /// A note if a model was fitted to none of the recordings.
    pub fn other_recordings(&self, model: &Model) -> Option<Note> {
        let hashes = self.reader()?.names.iter().map(|recording| recording.sha256.as_str());
        Note::other_recordings(&model.file, hashes)
    }
}

/// Setup errors that are detectable only with a model, some recordings at a time.
///
/// # Errors
/// A recording cannot be read.
pub(crate) fn model_findings(source: &CampaignReader, model: &Model) -> Result<Vec<Finding>> {
    let mut findings = Vec::new();
    let places: Vec<usize> = (0..source.names.len()).collect();
    let bar = progress::progress_bar("checking columns against the model", places.len());
    for places in places.chunks(source.at_once) {
        let campaign = source.campaign(places)?;
        let rows = model.file.sensors.iter().filter_map(|sensor| {
            let predictor = model.file.predictor(sensor.number, &model.effects)?;
            // Hypotheses on the force columns are of pairs.
            let rows = SensorRows::with_own_forces(&campaign, sensor.number).ok()?;
            (rows.forces.len() == 2).then(|| (rows.turned(sensor.orientation), predictor))
        });
        let rows: Vec<(SensorRows, Predictor)> = rows.collect();
        let place_of = |recording: usize| {
            let named = places.get(recording).and_then(|place| source.names.get(*place));
            model.place_of(named.map_or("", |named| named.sha256.as_str()))
        };
        let predicts: Vec<_> = rows
            .iter()
            .map(|(_, predictor)| {
                move |track: &ExcitationSeries| {
                    let track =
                        ExcitationSeries { recording: place_of(track.recording), ..track.clone() };
                    predictor.fields(&track).unwrap_or_default()
                }
            })
            .collect();
        let sensors: Vec<SensorPrediction> = rows
            .iter()
            .zip(&predicts)
            .map(|((rows, _), predict)| SensorPrediction { rows, predict })
            .collect();
        findings.extend(check_against_model(&campaign, source.alignment, &sensors));
        bar.inc(places.len() as u64);
    }
    bar.finish_and_clear();
    Ok(findings)
}

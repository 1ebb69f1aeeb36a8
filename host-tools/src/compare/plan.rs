//! Which values of a model judge which rows, so that none has seen what it judges.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use model_export::effects::Addition;
use model_export::fit::campaign::Prepared;
use model_export::fit::folds::Split;
use model_export::fit::joint::JointFit;
use model_export::fit::{FitError, Options};
use model_export::model_file::{Base, ModelFile, Provenance};
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::{fingerprint, recording_folders};
use model_export::recordings::description::Description;
use model_export::recordings::{Campaign, Problem, Recording};
use rayon::prelude::*;

use crate::progress;

/// Rows for each sensor on which a model is fitted again to judge what it has seen: ten minutes at
/// 100 Hz tell the parameters of a gripper far better than they need be known.
const MOST_ROWS: usize = 60_000;
/// Where the file's own values err more than those of a fit to the same recordings by this factor, the
/// file is no fit of these recordings (edited, or of an older tool), and is judged as it stands.
const NOT_A_FIT: f64 = 1.02;

/// A model with values that did not see what they judge.
pub struct Judge {
    /// The model.
    pub model: ModelFile,
    /// Its effects.
    pub additions: Vec<Addition>,
}

/// One recording of the campaign.
#[derive(Clone, Debug)]
pub struct Planned {
    /// Its folder.
    pub folder: PathBuf,
    /// Its name.
    pub name: String,
    /// SHA-256 over its files.
    pub sha256: String,
    /// Which judge is in charge until which second of the recording, in order.
    pub judges: Vec<(f64, usize)>,
}

/// The whole campaign.
pub struct Plan {
    /// Every set of values.
    pub judges: Vec<Judge>,
    /// The recordings, in the order in which they were made.
    pub recordings: Vec<Planned>,
    /// How it is held out, in one sentence.
    pub judged: String,
}

impl Judge {
    /// The place of a recording among those that the model was fitted to, or one beyond the last.
    pub fn place_of(&self, recording: &Planned) -> usize {
        let fitted = &self.model.provenance.recordings;
        let place = fitted
            .iter()
            .position(|other| other.sha256 == recording.sha256);
        place.unwrap_or(fitted.len())
    }
}

/// The recordings under `campaign` in the order in which they were made, not yet judged.
pub fn recordings(campaign: &Path) -> Result<Vec<Planned>> {
    let mut list = recording_folders(campaign)?
        .into_par_iter()
        .map(|folder| {
            let (description, _) = Description::read(&folder)?;
            let planned = Planned {
                name: folder
                    .file_name()
                    .map_or_else(String::new, |name| name.to_string_lossy().into_owned()),
                sha256: fingerprint(&folder)?,
                judges: vec![(f64::INFINITY, 0)],
                folder,
            };
            Ok((description.start_s, planned))
        })
        .collect::<Result<Vec<_>, Problem>>()?;
    list.sort_by(|a, b| a.0.total_cmp(&b.0));
    let list: Vec<Planned> = list.into_iter().map(|(_, planned)| planned).collect();
    for (i, one) in list.iter().enumerate() {
        if let Some(other) = list[..i].iter().find(|other| other.sha256 == one.sha256) {
            bail!(
                "{}: recordings {} and {} are the same data; remove one",
                campaign.display(),
                other.name,
                one.name
            );
        }
    }
    Ok(list)
}

impl Plan {
    /// Decides who judges the recordings of `campaign`. `path` is the model's, for messages.
    pub fn new(
        path: &Path,
        model: &ModelFile,
        campaign: &Path,
        recordings: Vec<Planned>,
        alignment: Alignment,
        options: Options,
    ) -> Result<Self> {
        let stands = Judge {
            additions: model.additions(path)?,
            model: model.clone(),
        };
        let unseen = model.provenance.recordings.len();
        let seen: Vec<usize> = (0..recordings.len())
            .filter(|&i| stands.place_of(&recordings[i]) < unseen)
            .collect();
        let mut plan = Self {
            judges: vec![stands],
            recordings,
            judged: "the model has seen none of these recordings: its values stand as they are"
                .to_owned(),
        };
        if !seen.is_empty() {
            plan.refit(campaign, &seen, alignment, options)?;
        }
        Ok(plan)
    }

    /// Fits the model again without what is judged.
    fn refit(
        &mut self,
        folder: &Path,
        seen: &[usize],
        alignment: Alignment,
        options: Options,
    ) -> Result<()> {
        let campaign = self.read_some(folder, seen, alignment)?;
        let (model, additions) = (
            self.judges[0].model.clone(),
            self.judges[0].additions.clone(),
        );
        let prepared = match model.base {
            Base::Cylinder => Prepared::cylinder(&campaign),
            Base::Polynomial => Prepared::polynomial(&campaign, model.degree(), options),
        };
        let bar = progress::bar("fitting without what is judged", campaign.sensors().len());
        let fitted = prepared.and_then(|prepared| {
            let split = prepared.split(&additions);
            let fit = prepared.fit(&additions, split, options, |_| bar.inc(1))?;
            Ok((prepared, fit))
        });
        bar.finish_and_clear();
        let (prepared, fit) = match fitted {
            Ok(fitted) => fitted,
            Err(FitError::Recording(problem)) => return Err(problem.into()),
            Err(why) => {
                self.judged = format!(
                    "NOT held out: the model was fitted to these recordings and could not be fitted again ({why})"
                );
                return Ok(());
            }
        };
        if let Some(worse) = stands_apart(&model, &additions, &prepared, &fit) {
            self.judged = format!(
                "the file's own values leave {worse:.2} times what a fit of the same recordings leaves, so they are judged as they stand"
            );
            return Ok(());
        }
        let provenance = Provenance::of(&campaign, alignment.delay_us, options)?;
        let judge = |fit: &JointFit| Judge {
            model: ModelFile::with_effects(
                &campaign,
                &prepared,
                fit,
                &additions,
                provenance.clone(),
            ),
            additions: additions.clone(),
        };
        let folds = fit.sensors.first().map_or(0, |sensor| sensor.folds.len());
        let first = self.judges.len();
        self.judges
            .extend((0..folds).map(|fold| judge(&fit.without(fold))));
        let all = self.judges.len();
        self.judges.push(judge(&fit));
        let names: Vec<String> = campaign.recordings.iter().map(|r| r.name.clone()).collect();
        for &i in seen {
            let recording = &mut self.recordings[i];
            recording.judges = match names.iter().position(|name| *name == recording.name) {
                None => vec![(f64::INFINITY, all)],
                Some(part) => segments(&prepared, &fit, part, first),
            };
        }
        self.judged = sentence(fit.split, seen.len(), names.len(), self.recordings.len());
        Ok(())
    }

    /// Reads the recordings that the model is fitted to again: all that it has seen, or where they are
    /// many, some spread evenly over them.
    fn read_some(&self, folder: &Path, seen: &[usize], alignment: Alignment) -> Result<Campaign> {
        let read = |i: usize| Recording::read(&self.recordings[i].folder, alignment);
        let bar = progress::bar("reading recordings", seen.len());
        let first = read(seen[0])?;
        bar.inc(1);
        let most = (MOST_ROWS / first.time_s.len().max(1))
            .max(3)
            .min(seen.len());
        let others = (1..most)
            .into_par_iter()
            .map(|i| {
                let recording = read(seen[i * seen.len() / most]);
                bar.inc(1);
                recording
            })
            .collect::<Result<Vec<_>, Problem>>()?;
        bar.finish_and_clear();
        let mut recordings = vec![first];
        recordings.extend(others);
        let campaign = Campaign {
            folder: folder.to_path_buf(),
            recordings,
        };
        campaign.check_same_gripper()?;
        Ok(campaign)
    }
}

/// By how much the file's own values err more than those of a fit to the same rows; `None` where the
/// file is that fit.
fn stands_apart(
    model: &ModelFile,
    additions: &[Addition],
    prepared: &Prepared,
    fit: &JointFit,
) -> Option<f64> {
    let (mut own, mut rows) = (0.0, 0.0);
    for sensor in &prepared.rows {
        let Some(predictor) = model.predictor(sensor.sensor, additions) else {
            continue;
        };
        for part in &sensor.parts {
            let predicted = predictor.over(part, &sensor.forces);
            let errors = part.field_g.iter().zip(&predicted.field_g);
            own += errors.map(|(b, m)| (b - m).norm_squared()).sum::<f64>();
            rows += 3.0 * part.len() as f64;
        }
    }
    let scores = || fit.sensors.iter().flat_map(|sensor| &sensor.scores);
    let squares: f64 = scores().map(|score| score.fitted_rms_g.powi(2)).sum();
    let ratio = (own / rows / (squares / scores().count().max(1) as f64)).sqrt();
    (ratio > NOT_A_FIT).then_some(ratio)
}

/// Which judge is in charge when: that of the fold in which a row was judged.
fn segments(prepared: &Prepared, fit: &JointFit, part: usize, first: usize) -> Vec<(f64, usize)> {
    if let Split::Recordings(_) = fit.split {
        return vec![(f64::INFINITY, first + part)];
    }
    let Some((rows, of)) = prepared.rows.first().zip(fit.sensors.first()) else {
        return Vec::new();
    };
    let time_s = &rows.parts[part].track.time_s;
    let folds = fit.split.folds(rows, of.block_s);
    let mut list: Vec<(f64, usize)> = folds
        .iter()
        .enumerate()
        .flat_map(|(fold, of)| of.test.iter().map(move |stretch| (fold, stretch)))
        .filter(|(_, stretch)| stretch.part == part)
        .map(|(fold, stretch)| {
            let until = time_s.get(stretch.rows.end).copied();
            (until.unwrap_or(f64::INFINITY), first + fold)
        })
        .collect();
    list.sort_by(|a, b| a.0.total_cmp(&b.0));
    list
}

fn sentence(split: Split, seen: usize, fitted: usize, all: usize) -> String {
    let how = match split {
        Split::Recordings(_) => "each recording is judged by a fit of the others",
        Split::Sixths => {
            "one recording: each sixth of it is judged by a fit of the rest, and nothing is claimed beyond this recording"
        }
        Split::Comb => {
            "the model has an effect that lives within recordings: every sixth quarter of a second is judged by a fit of the rest"
        }
    };
    let some = match fitted < seen {
        true => format!(
            "; fitted to {fitted} recordings spread over the {seen}, the others are judged by that fit"
        ),
        false => String::new(),
    };
    let unseen = match all - seen {
        0 => String::new(),
        1 => "; 1 recording that the model has not seen is judged by its own values".to_owned(),
        n => format!("; {n} recordings that the model has not seen are judged by its own values"),
    };
    format!("{how}{some}{unseen}")
}

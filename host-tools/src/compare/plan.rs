//! Which values of a model judge which rows, so that none has seen what it judges.

use std::path::Path;

use anyhow::Result;
use model_export::effects::Addition;
use model_export::fit::campaign::Prepared;
use model_export::fit::folds::Split;
use model_export::fit::joint::JointFit;
use model_export::fit::{FitError, Options};
use model_export::model_file::{Base, ModelFile, Provenance};

use super::source::{Named, Source};
use crate::progress;

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
    /// Its name, folder and hash.
    pub named: Named,
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
            .position(|other| other.sha256 == recording.named.sha256);
        place.unwrap_or(fitted.len())
    }
}

impl Plan {
    /// Decides who judges the recordings of `source`. `path` is the model's, for messages.
    pub fn new(path: &Path, model: &ModelFile, source: &Source, options: Options) -> Result<Self> {
        let unjudged = |named: &Named| Planned {
            named: named.clone(),
            judges: vec![(f64::INFINITY, 0)],
        };
        let recordings: Vec<Planned> = source.names.iter().map(unjudged).collect();
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
            plan.refit(source, &seen, options)?;
        }
        Ok(plan)
    }

    /// Fits the model again without what is judged.
    fn refit(&mut self, source: &Source, seen: &[usize], options: Options) -> Result<()> {
        // Ten minutes tell a gripper's parameters far better than they need be known: of more, some
        // recordings spread evenly over them.
        let most = source.at_once.max(3).min(seen.len());
        let some: Vec<usize> = (0..most).map(|i| seen[i * seen.len() / most]).collect();
        let campaign = source.campaign(&some)?;
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
        let provenance = Provenance::of(&campaign, source.alignment.delay_us, options)?;
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
            recording.judges = match names.iter().position(|name| *name == recording.named.name) {
                None => vec![(f64::INFINITY, all)],
                Some(part) => segments(&prepared, &fit, part, first),
            };
        }
        self.judged = sentence(fit.split, seen.len(), names.len(), self.recordings.len());
        Ok(())
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

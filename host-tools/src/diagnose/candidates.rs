//! What may be missing, and what these recordings cannot judge at all.

use model_export::effects::{Addition, CATALOGUE};
use model_export::model_file::Base;
use model_export::recordings::{Campaign, Recording};

/// A candidate that cannot be judged, and why.
#[derive(Clone, Debug)]
pub struct Unjudged {
    /// Its name.
    pub effect: String,
    /// Why, in one sentence.
    pub why: String,
    /// What to record.
    pub record: String,
}

/// Effects to judge, and those that these recordings cannot judge.
pub fn candidates(
    campaign: &Campaign,
    base: Base,
    axes: Option<[bool; 2]>,
    present: &[Addition],
    own: &[Addition],
) -> (Vec<Addition>, Vec<Unjudged>) {
    let (mut judged, mut unjudged) = (Vec::new(), Vec::new());
    let catalogue = CATALOGUE.iter().map(|effect| Addition::Catalogue(effect));
    let all = catalogue.chain(own.iter().cloned());
    for candidate in all.filter(|candidate| !present.contains(candidate)) {
        match why_not(&candidate, campaign, base, axes) {
            Some(why) => unjudged.push(Unjudged {
                effect: candidate.name().to_owned(),
                why,
                record: candidate
                    .effect()
                    .map_or_else(String::new, |effect| effect.record.to_owned()),
            }),
            None => judged.push(match axes {
                Some(axes) => candidate.beside_polynomial(axes),
                None => candidate,
            }),
        }
    }
    (judged, unjudged)
}

/// Why a candidate cannot be judged from these recordings whatever they show.
fn why_not(
    candidate: &Addition,
    campaign: &Campaign,
    base: Base,
    axes: Option<[bool; 2]>,
) -> Option<String> {
    if base == Base::Polynomial && candidate.stage().needs_geometry() {
        return Some("it moves or changes the magnet, and a polynomial knows no magnet".to_owned());
    }
    let flexure = |axes: [bool; 2]| candidate.clone().beside_polynomial(axes) != *candidate;
    if axes.is_some_and(|axes| axes == [false; 2] && flexure(axes)) {
        return Some("it acts through a force, and none was recorded".to_owned());
    }
    for column in candidate.needs() {
        let columns = campaign
            .recordings
            .iter()
            .map(|recording| values(recording, &column));
        let columns: Vec<Vec<f64>> = columns.collect();
        if columns.iter().any(Vec::is_empty) {
            return Some(format!("{column} was not recorded"));
        }
        if !moves(&columns) {
            return Some(format!("{column} never moves beyond its noise"));
        }
    }
    None
}

/// Values of a column over a recording, all sensors' one after the other where each has its own; empty
/// where it was not recorded. Forces and times always were.
fn values(recording: &Recording, column: &str) -> Vec<f64> {
    match column {
        "temp_c" => {
            let sensors = recording.sensors.values();
            sensors
                .flat_map(|sensor| sensor.temperature_c.iter().copied())
                .collect()
        }
        "fx_n" | "fz_n" | "time_s" | "session_s" => recording.time_s.clone(),
        _ => recording
            .covariates
            .get(column)
            .cloned()
            .unwrap_or_default(),
    }
}

/// A column moves where it spreads by more than this many times what changes from row to row.
const MOVES: f64 = 2.0;

/// Whether a column shows more than noise over all recordings together.
fn moves(columns: &[Vec<f64>]) -> bool {
    let all = || columns.iter().flatten();
    let count = all().count().max(1) as f64;
    let mean = all().sum::<f64>() / count;
    let spread = (all().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt();
    let steps = columns
        .iter()
        .flat_map(|column| column.windows(2).map(|pair| pair[1] - pair[0]));
    let step = (steps.map(|step| step * step).sum::<f64>() / count).sqrt();
    spread > MOVES * step / std::f64::consts::SQRT_2 && spread > 1e-9 * mean.abs()
}

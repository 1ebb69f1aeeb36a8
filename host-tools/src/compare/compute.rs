//! From a model and a campaign to everything that is known of both.

use std::path::Path;

use anyhow::Result;
use model_export::effects::{Addition, Track};
use model_export::fit::Options;
use model_export::fit::blocks::correlation_rows;
use model_export::fit::rows::SensorRows;
use model_export::model_file::{ModelFile, Predictor};
use model_export::recordings::Place;
use model_export::recordings::align::Alignment;
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::columns::Axis;

use super::bands::Bands;
use super::collect::{Seen, SensorSeen, collect};
use super::device::forces;
use super::locate::{Found, Locator};
use super::map::map;
use super::plan::{Plan, Planned};
use super::replicates::scatter;
use super::rest::slow;
use super::rows::SensorColumns;
use super::source::Source;
use super::worst::worst;
use super::{AxisFigures, Comparison, Finding, Floor, Located, words};
use crate::findings::against::{Beside, against};
use crate::findings::files::scan;
use crate::findings::merge;
use crate::progress;

/// Shortest block of the bootstrap in seconds.
const SHORTEST_BLOCK_S: f64 = 1.0;

/// Compares the model at `path` with a campaign; and the model at `other`, on the same rows.
pub fn compare(
    path: &Path,
    campaign: &Path,
    other: Option<&Path>,
    alignment: Alignment,
    options: Options,
) -> Result<Comparison> {
    let model = ModelFile::read(path)?;
    let bar = progress::bar(
        "looking for mistakes of the rig",
        recording_folders(campaign)?.len(),
    );
    let findings = scan(campaign, |_| bar.inc(1))?;
    bar.finish_and_clear();
    let stopped = |findings: Vec<Finding>| Comparison {
        model: path.display().to_string(),
        campaign: campaign.display().to_string(),
        verdict: words::stopped(&findings),
        findings,
        provenance: vec![(
            "tool".to_owned(),
            format!("magpie {}", env!("CARGO_PKG_VERSION")),
        )],
        ..Comparison::default()
    };
    if findings.iter().any(|finding| finding.stops) {
        return Ok(stopped(findings));
    }
    let source = Source::open(campaign, alignment)?;
    let findings = merge(findings, beside(&source, &model, &model.additions(path)?)?);
    if findings.iter().any(|finding| finding.stops) {
        return Ok(stopped(findings));
    }
    let mut comparison = judge(path, &model, &source, &findings, options)?;
    if let Some(other) = other {
        let judged = judge(other, &ModelFile::read(other)?, &source, &findings, options)?;
        comparison.other = Some(Box::new(judged));
    }
    if let Some(doubt) = words::doubt(&findings) {
        comparison.verdict = format!("{doubt} {}", comparison.verdict);
    }
    comparison.findings = findings;
    Ok(comparison)
}

/// Mistakes of the rig that show only beside a model, some recordings at a time.
fn beside(source: &Source, model: &ModelFile, additions: &[Addition]) -> Result<Vec<Finding>> {
    let mut findings = Vec::new();
    let places: Vec<usize> = (0..source.names.len()).collect();
    let bar = progress::bar("holding columns against the model", places.len());
    for places in places.chunks(source.at_once) {
        let campaign = source.campaign(places)?;
        let rows = model.sensors.iter().filter_map(|sensor| {
            let predictor = model.predictor(sensor.number, additions)?;
            let rows = SensorRows::with_own_forces(&campaign, sensor.number).ok()?;
            Some((rows, predictor))
        });
        let rows: Vec<(SensorRows, Predictor)> = rows.collect();
        let place_of = |recording: usize| {
            let named = places
                .get(recording)
                .and_then(|place| source.names.get(*place));
            let fitted = &model.provenance.recordings;
            let found = fitted
                .iter()
                .position(|f| Some(&f.sha256) == named.map(|n| &n.sha256));
            found.unwrap_or(fitted.len())
        };
        let predicts: Vec<_> = rows
            .iter()
            .map(|(_, predictor)| {
                move |track: &Track| {
                    let track = Track {
                        recording: place_of(track.recording),
                        ..track.clone()
                    };
                    predictor.fields(&track).unwrap_or_default()
                }
            })
            .collect();
        let sensors: Vec<Beside> = rows
            .iter()
            .zip(&predicts)
            .map(|((rows, _), predict)| Beside { rows, predict })
            .collect();
        findings.extend(against(&campaign, source.alignment, &sensors));
        bar.inc(places.len() as u64);
    }
    bar.finish_and_clear();
    Ok(findings)
}

/// Holds one model against recordings that are sound.
fn judge(
    path: &Path,
    model: &ModelFile,
    source: &Source,
    findings: &[Finding],
    options: Options,
) -> Result<Comparison> {
    let (fitted_ms, delay_ms) = (model.provenance.delay_ms, 1e-3 * source.alignment.delay_us);
    if fitted_ms != delay_ms {
        eprintln!(
            "note: {} was fitted with --delay-ms {fitted_ms}, these recordings are read with {delay_ms}",
            path.display()
        );
    }
    let plan = Plan::new(path, model, source, options)?;
    let mut seen = collect(&plan, source)?;
    // A finding tells of a column in all recordings at once: that is not told again.
    let told = |place: &Place| {
        let same =
            |of: &Place| of.file.file_name() == place.file.file_name() && of.column == place.column;
        findings.iter().any(|finding| same(&finding.place))
    };
    let untold = seen.notices.iter().filter(|notice| !told(&notice.place));
    untold.for_each(|notice| eprintln!("note: {notice}"));
    let alignment = source.alignment;
    let device = forces(&plan, path, alignment, &seen.origins_s, &mut seen.traces)?;
    let columns: Vec<SensorColumns> = seen
        .sensors
        .iter_mut()
        .map(|sensor| std::mem::replace(&mut sensor.columns, SensorColumns::new(0, &[])))
        .collect();
    let correlation_s = correlation_s(&columns);
    let block_s = (3.0 * correlation_s).max(SHORTEST_BLOCK_S);
    let locator = Locator::new(&columns, block_s);
    let ranked = locator.rank();
    let names: Vec<String> = source
        .names
        .iter()
        .map(|named| named.name.clone())
        .collect();
    let mut comparison = Comparison {
        model: path.display().to_string(),
        campaign: source.folder.display().to_string(),
        judged: plan.judged.clone(),
        axes: axes(&seen, &columns),
        forces: device.figures,
        no_forces: device.none,
        located: located(&columns, &locator, &ranked, block_s, options.seed),
        map: match ranked.as_slice() {
            [first, second, ..] => map(&columns, first.covariate, second.covariate),
            _ => None,
        },
        worst: worst(&columns, &names, &seen.spans_s),
        correlation_s,
        traces: seen.traces,
        histograms: device.histograms,
        provenance: provenance(model, &plan, block_s, options),
        ..Comparison::default()
    };
    comparison.verdict = words::verdict(&comparison);
    Ok(comparison)
}

fn axes(seen: &Seen, columns: &[SensorColumns]) -> Vec<AxisFigures> {
    let of_sensor = |(sensor, columns): (&SensorSeen, &SensorColumns)| {
        let (replicates, slow) = (scatter(columns), slow(columns));
        let axis = |(i, axis): (usize, Axis)| {
            let error = sensor.errors[i].figures();
            let rows = sensor.errors[i].rows().max(1.0);
            let part = |of: usize| (sensor.floor[of][i] / rows).max(0.0).sqrt();
            let total = part(0).hypot(part(2));
            AxisFigures {
                sensor: sensor.sensor,
                axis,
                error,
                floor: Floor {
                    white: part(0),
                    quantisation: part(1),
                    reference: part(2),
                    slow: slow.map(|slow| slow[i]),
                    replicates: replicates.map(|replicates| replicates[i]),
                    total,
                },
                explainable: (error.rms.powi(2) - total.powi(2)).max(0.0).sqrt(),
            }
        };
        Axis::ALL
            .into_iter()
            .enumerate()
            .map(axis)
            .collect::<Vec<_>>()
    };
    seen.sensors
        .iter()
        .zip(columns)
        .flat_map(of_sensor)
        .collect()
}

fn located(
    columns: &[SensorColumns],
    locator: &Locator,
    ranked: &[Found],
    block_s: f64,
    seed: u64,
) -> Vec<Located> {
    let bands = Bands::new(columns, block_s, seed);
    let one = |found: &Found| {
        let covariate = &columns.first()?.covariates[found.covariate].of;
        let binning = locator.binnings[found.covariate].as_ref()?;
        Some(Located {
            covariate: covariate.name.clone(),
            words: covariate.words.clone(),
            unit: covariate.unit,
            share: found.share,
            alone: found.alone,
            chosen: found.chosen,
            sensors: columns.iter().map(|sensor| sensor.sensor).collect(),
            bins: bands.bins(columns, binning),
        })
    };
    ranked.iter().filter_map(one).collect()
}

/// The longest integrated autocorrelation time of any channel, in seconds.
pub fn correlation_s(columns: &[SensorColumns]) -> f64 {
    let of_channel = |sensor: &SensorColumns, axis: usize| {
        let (mut sum, mut rows, mut at) = (0.0, 0.0, 0);
        for chunk in sensor.recording.chunk_by(|a, b| a == b) {
            let range = at..at + chunk.len();
            at = range.end;
            let time_s = &sensor.time_s[range.clone()];
            let span_s = time_s
                .last()
                .zip(time_s.first())
                .map_or(0.0, |(to, from)| to - from);
            let values: Vec<f64> = sensor.residual_g[range].iter().map(|r| r[axis]).collect();
            sum += correlation_rows(&values) * span_s;
            rows += chunk.len() as f64;
        }
        sum / f64::max(rows, 1.0)
    };
    let channels = columns
        .iter()
        .flat_map(|sensor| [0, 1, 2].map(|axis| of_channel(sensor, axis)));
    channels.fold(0.0, f64::max)
}

fn provenance(
    model: &ModelFile,
    plan: &Plan,
    block_s: f64,
    options: Options,
) -> Vec<(String, String)> {
    let effects: Vec<&str> = model
        .effects
        .iter()
        .map(|effect| effect.name.as_str())
        .collect();
    let hash = |recording: &Planned| format!("sha256 {}", recording.named.sha256);
    let mut list = vec![
        (
            "tool".to_owned(),
            format!("magpie {}", env!("CARGO_PKG_VERSION")),
        ),
        (
            "model".to_owned(),
            format!(
                "fitted to {} ({} recordings, {} rows) by {}",
                model.provenance.campaign,
                model.provenance.recordings.len(),
                model.provenance.rows,
                model.provenance.tool
            ),
        ),
        (
            "effects".to_owned(),
            match effects.is_empty() {
                true => "none beside the base".to_owned(),
                false => effects.join(", "),
            },
        ),
        ("held out".to_owned(), plan.judged.clone()),
        (
            "bands".to_owned(),
            format!(
                "95 %, bootstrap of blocks of {block_s:.1} s, seed {}",
                options.seed
            ),
        ),
        (
            "sensor".to_owned(),
            format!(
                "{} G a count, range {} G{}",
                model.sensor_scale.gauss_per_lsb,
                model.sensor_scale.range_gauss,
                if model.sensor_scale.assumed {
                    " (assumed: the recordings do not say it)"
                } else {
                    ""
                }
            ),
        ),
    ];
    list.extend(
        plan.recordings
            .iter()
            .map(|r| (format!("recording {}", r.named.name), hash(r))),
    );
    list
}

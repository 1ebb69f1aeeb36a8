//! Candidate effects: which of them the recordings can test, and their screening by a score test with a wild
//! bootstrap.

use crate::diagnose::fitted_model::MIN_GAIN;
use crate::diagnose::verdict::{AssumedTimes, Reason, Verdict, VerdictKind, record_of};
use crate::statistics::mean_and_std;
use model_export::effects::excitation::{BUILT_IN_COVARIATES, OPENING_RATE, source_column};
use model_export::effects::{CATALOGUE, EffectTerm};
use model_export::fit::held_out::BlockChange;
use model_export::fit::score_test::{CandidateScore, ScoreTest};
use model_export::model_file::{BaseKind, ModelFile};
use model_export::recordings::columns::SignalUnit;
use model_export::recordings::noise_estimate::RowOrder;
use model_export::recordings::{Campaign, Recording};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// A candidate that these recordings cannot test.
#[derive(Clone, Debug)]
pub struct UntestableEffect {
    pub effect: String,
    pub reason: Reason,
    /// Recording that would test it.
    pub record: String,
}

impl UntestableEffect {
    /// The verdict that these recordings cannot test it.
    pub fn verdict(&self) -> Verdict {
        let record = self.record.clone();
        let kind = VerdictKind::Inconclusive;
        Verdict { record, ..Verdict::new(&self.effect, kind, self.reason.clone()) }
    }
}

/// Effects that these recordings can test in addition to a model (by default of the magnet, which needs all forces), and those that
/// they cannot.
pub fn candidates(
    campaign: &Campaign,
    model: Option<&ModelFile>,
    present: &[EffectTerm],
    own: &[EffectTerm],
) -> (Vec<EffectTerm>, Vec<UntestableEffect>) {
    let (mut testable, mut untestable) = (Vec::new(), Vec::new());
    let catalogue = CATALOGUE.iter().map(|effect| EffectTerm::Catalogue(effect));
    let all = catalogue.chain(own.iter().cloned());
    let is_present = |name: &str| present.iter().any(|effect| effect.name() == name);
    for candidate in all.filter(|candidate| !is_present(candidate.name())) {
        match obstacle(&candidate, campaign, model) {
            Some(reason) => {
                // No recording makes up for what the model does not have.
                let is_of_model = matches!(
                    reason,
                    Reason::NeedsGeometry | Reason::InPolynomial | Reason::NotAField(_)
                );
                untestable.push(UntestableEffect {
                    effect: candidate.name().to_owned(),
                    reason,
                    record: if is_of_model { String::new() } else { record_of(&candidate) },
                });
            }
            None => testable.push(candidate),
        }
    }
    (testable, untestable)
}

/// Why these recordings cannot test a candidate.
fn obstacle(
    candidate: &EffectTerm,
    campaign: &Campaign,
    model: Option<&ModelFile>,
) -> Option<Reason> {
    if let Some(model) = model.filter(|model| model.base == BaseKind::Polynomial) {
        if candidate.stage().needs_geometry() {
            return Some(Reason::NeedsGeometry);
        }
        if candidate.is_function_of_force() {
            return Some(Reason::InPolynomial);
        }
        if candidate.stage().acts_on_force() && !model.has_force_input() {
            return Some(Reason::NeedsForce);
        }
    }
    let mut sensors = campaign.recordings.iter().flat_map(|recording| recording.sensors.values());
    if candidate.is_of_field()
        && let Some(unit) = sensors.find_map(|sensor| match sensor.unit {
            SignalUnit::Gauss => None,
            SignalUnit::Other(symbol) => Some(symbol),
        })
    {
        return Some(Reason::NotAField(unit));
    }
    let is_shuffled = |recording: &Recording| recording.noise.order == RowOrder::Shuffled;
    if candidate.depends_on_order() && campaign.recordings.iter().any(is_shuffled) {
        return Some(Reason::NoTimeOrder);
    }
    if let Some(times) = assumed_times(candidate, campaign) {
        return Some(Reason::AssumedTimes(times));
    }
    for column in candidate.needs() {
        let columns = campaign.recordings.iter().map(|recording| values(recording, &column));
        let columns: Vec<Vec<f64>> = columns.collect();
        let pairs = campaign.recordings.iter().zip(&columns);
        let without = pairs.filter(|(_, column)| column.is_empty());
        let without: Vec<String> = without.map(|(recording, _)| recording.name.clone()).collect();
        if !without.is_empty() {
            let is_nowhere = without.len() == campaign.recordings.len();
            return Some(Reason::NotRecorded(
                column,
                if is_nowhere { Vec::new() } else { without },
            ));
        }
        if !varies(&columns) && !is_set_by_row(campaign, &column) {
            return Some(Reason::DoesNotVary(column));
        }
    }
    None
}

/// Times on which a candidate depends and which are assumed. The first recording may start at any time.
fn assumed_times(candidate: &EffectTerm, campaign: &Campaign) -> Option<AssumedTimes> {
    if candidate.depends_on_time() && is_clock_assumed(campaign) {
        return Some(AssumedTimes::Rows);
    }
    let mut later = campaign.recordings.iter().skip(1);
    let is_assumed = later.any(|recording| recording.description.is_start_assumed());
    (candidate.depends_on_start() && is_assumed).then_some(AssumedTimes::Starts)
}

/// Whether the times of the rows are unknown in a recording.
fn is_clock_assumed(campaign: &Campaign) -> bool {
    campaign.recordings.iter().any(|recording| recording.description.is_clock_assumed())
}

/// Values of a column over a recording, concatenated over sensors; empty where it was not recorded. Forces and
/// times always are.
fn values(recording: &Recording, column: &str) -> Vec<f64> {
    match column {
        "temp_c" => {
            let sensors = recording.sensors.values();
            sensors.flat_map(|sensor| sensor.temperature_c.iter().copied()).collect()
        }
        "fx_n" | "fz_n" | "time_s" | "session_s" => recording.time_s.clone(),
        _ => recording.covariates.get(column).cloned().unwrap_or_default(),
    }
}

/// Covariates of formulas that vary over these recordings; `axes`: whether a lateral and a longitudinal force were recorded.
pub fn varying_covariates(campaign: &Campaign, axes: [bool; 2]) -> Vec<String> {
    let Some(first) = campaign.recordings.first() else {
        return Vec::new();
    };
    let recorded = first.covariates.keys().map(String::as_str);
    let has_opening = first.covariates.contains_key("opening_mm");
    let mut orders = campaign.recordings.iter().map(|recording| recording.noise.order);
    let is_shuffled = orders.any(|order| order == RowOrder::Shuffled);
    let names = BUILT_IN_COVARIATES.into_iter().chain(recorded);
    names
        .chain(has_opening.then_some(OPENING_RATE))
        .filter(|name| match *name {
            "time_s" | "fx_rate_n_per_s" | "fz_rate_n_per_s" | OPENING_RATE if is_shuffled => false,
            // The load varies, else it could not be fitted.
            "fx_n" => axes[0],
            "fz_n" => axes[1],
            "fx_rate_n_per_s" => axes[0] && !is_clock_assumed(campaign),
            "fz_rate_n_per_s" => axes[1] && !is_clock_assumed(campaign),
            "session_s" => false,
            "time_s" if is_clock_assumed(campaign) => false,
            name => {
                let name = source_column(name);
                let columns = campaign.recordings.iter().map(|recording| values(recording, name));
                let columns: Vec<Vec<f64>> = columns.collect();
                columns.iter().all(|column| !column.is_empty())
                    && (varies(&columns) || is_set_by_row(campaign, name))
            }
        })
        .map(str::to_owned)
        .collect()
}

/// Whether a column was set anew for each row: its values then vary like noise.
fn is_set_by_row(campaign: &Campaign, column: &str) -> bool {
    campaign.recordings.iter().any(|recording| recording.is_set_by_row(column))
}

/// Minimum ratio of a column's standard deviation to its noise.
const MIN_VARIATION: f64 = 2.0;
/// Quantile of the absolute changes from row to row by which the noise is estimated, and its value for a standard normal
/// variable. Short variations, such as the current of a motor that accelerates, are not noise.
const NOISE_QUANTILE: (f64, f64) = (0.75, 1.150_349);

/// Whether a column varies beyond its noise over all recordings.
pub fn varies(columns: &[Vec<f64>]) -> bool {
    let all = || columns.iter().flatten();
    let count = all().count().max(1) as f64;
    let mean = all().sum::<f64>() / count;
    let sigma = (all().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt();
    let steps = columns.iter().flat_map(|column| column.windows(2).map(|pair| pair[1] - pair[0]));
    let mut steps: Vec<f64> = steps.map(f64::abs).collect();
    steps.sort_unstable_by(f64::total_cmp);
    let (quantile, of_normal) = NOISE_QUANTILE;
    let step = steps.get((quantile * steps.len() as f64) as usize).copied().unwrap_or(0.0);
    let noise = step / (of_normal * std::f64::consts::SQRT_2);
    sigma > MIN_VARIATION * noise && sigma > 1e-9 * mean.abs()
}

/// Bootstrap resamples.
const DRAWS: usize = 499;
/// Significance level, adjusted for all candidates.
pub const LEVEL: f64 = 0.05;
/// Least p-value that is stated: further tails of sums over some blocks are not known.
const LEAST_P: f64 = 0.001;
/// Minimum gain of a transient effect relative to an arbitrary function of time.
const MIN_OF_FREE: f64 = 0.8;

/// Score test of one candidate.
pub struct ScreenedEffect {
    pub candidate: EffectTerm,
    /// Result of the score test.
    pub evidence: CandidateScore,
    /// Share of random signs of the blocks under which any candidate explains as much of the fitted rows. Noise as slow as the
    /// recordings makes it small.
    pub p_explained: f64,
    /// p-value of no reduction of the held-out squared error by more than [`MIN_GAIN`], and of a transient effect by more than
    /// 0.8 of what an arbitrary function of time does; adjusted for all candidates.
    pub p_adjusted: f64,
    /// Share of the resamples of the blocks of time in which the held-out squared error falls by more than [`MIN_GAIN`].
    pub inclusion: f64,
}

impl ScreenedEffect {
    /// Whether it lowers the held-out error significantly and in every fold.
    pub fn is_significant(&self) -> bool {
        self.p_adjusted < LEVEL && self.lowers_error()
    }

    /// Whether it explains the fitted rows, and the error decreases in every fold. An event may be within one block of time, which
    /// explains as much with another sign.
    pub fn lowers_error(&self) -> bool {
        (self.p_explained < LEVEL || self.candidate.is_event())
            && self.evidence.wins() == self.evidence.folds.len()
            && self.evidence.gain() > MIN_GAIN
    }
}

/// Minimum share of an effect's pattern that one which can replace it reproduces.
pub const REPLACES: f64 = 0.8;

/// Screens the candidates; sorted by gain.
pub fn screen(around: &ScoreTest, candidates: &[EffectTerm], seed: u64) -> Vec<ScreenedEffect> {
    let evidence: Vec<(EffectTerm, CandidateScore)> = candidates
        .par_iter()
        .filter_map(|candidate| Some((candidate.clone(), around.score(candidate)?)))
        .collect();
    let Some(best) = evidence.iter().max_by(|a, b| a.1.gain().total_cmp(&b.1.gain())) else {
        return Vec::new();
    };
    let draws = signs(around.blocks, seed);
    let mut maxima = vec![f64::NEG_INFINITY; DRAWS];
    let mut scores = Vec::new();
    for (_, one) in &evidence {
        let drawn = around.resampled(one, &best.1, &draws);
        let (mean, sigma) = mean_and_std(&drawn);
        let sigma = sigma.max(1e-9);
        for (max, drawn) in maxima.iter_mut().zip(&drawn) {
            *max = max.max((drawn - mean) / sigma);
        }
        scores.push((one.explained - mean) / sigma);
    }
    let p_value = |z: f64| {
        let beyond = maxima.iter().filter(|max| **max >= z).count();
        (1 + beyond) as f64 / (1 + DRAWS) as f64
    };
    let count = evidence.len() as f64;
    let p_of = |evidence: &CandidateScore, least: f64| {
        (p_of_reduction(&evidence.by_block, least) * count).clamp(LEAST_P, 1.0)
    };
    let mut spline_gain = None;
    let mut p_adjusted = |candidate: &EffectTerm, evidence: &CandidateScore| {
        let p = p_of(evidence, MIN_GAIN);
        if !candidate.is_transient() || p >= LEVEL {
            return p;
        }
        let free = *spline_gain.get_or_insert_with(|| around.time_spline_gain());
        p_of(evidence, (MIN_OF_FREE * free).max(MIN_GAIN))
    };
    let mut screened: Vec<ScreenedEffect> = evidence
        .into_iter()
        .zip(scores)
        .map(|((candidate, evidence), z)| ScreenedEffect {
            p_adjusted: p_adjusted(&candidate, &evidence),
            inclusion: inclusion(&evidence.by_block, seed),
            candidate,
            evidence,
            p_explained: p_value(z),
        })
        .collect();
    screened.sort_by(|a, b| b.evidence.gain().total_cmp(&a.evidence.gain()));
    screened
}

/// p-value of no reduction of the held-out squared residual by more than the fraction `least`, from its changes by block of time;
/// 1 where there is none.
///
/// With the residual e of the model with the candidate and the change m of the model, the reduction is the sum of m^2 + 2 e m. Where
/// m is the true change, e is noise, and the sums of 2 e m over blocks give the standard error. Where m is fitted to the noise of
/// other recordings, the reduction is negative on average, however slow the noise is.
fn p_of_reduction(by_block: &[BlockChange], least: f64) -> f64 {
    let blocks: Vec<&BlockChange> = by_block.iter().filter(|block| block.without > 0.0).collect();
    let beyond: f64 = blocks.iter().map(|block| block.reduction - least * block.without).sum();
    let variance: f64 = blocks.iter().map(|block| (2.0 * block.product).powi(2)).sum();
    let freedom = blocks.len() as f64 - 1.0;
    match StudentsT::new(0.0, 1.0, freedom) {
        Ok(distribution) if beyond > 0.0 && variance > 0.0 => {
            distribution.sf(beyond / variance.sqrt())
        }
        _ => 1.0,
    }
}

/// Resamples of the blocks of time for the inclusion of an effect.
pub const RESAMPLES: usize = 200;

/// Share of the resamples of the blocks, with replacement, in which the held-out squared residual falls by more than [`MIN_GAIN`].
fn inclusion(by_block: &[BlockChange], seed: u64) -> f64 {
    let blocks: Vec<&BlockChange> = by_block.iter().filter(|block| block.without > 0.0).collect();
    if blocks.is_empty() {
        return f64::NAN;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut falls = || {
        let beyond: f64 = (0..blocks.len())
            .map(|_| {
                let block = blocks[rng.random_range(0..blocks.len())];
                block.reduction - MIN_GAIN * block.without
            })
            .sum();
        beyond > 0.0
    };
    (0..RESAMPLES).filter(|_| falls()).count() as f64 / RESAMPLES as f64
}

/// Random signs of the blocks, one list per resample.
fn signs(blocks: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut sign = || if rng.random::<bool>() { 1.0 } else { -1.0 };
    (0..DRAWS).map(|_| (0..blocks).map(|_| sign()).collect()).collect()
}

/// Minimum typical magnitude in standard errors for a conclusive verdict.
pub const MIN_Z: f64 = 4.0;

/// Why a typical magnitude is not detectable; `None` where it is.
pub fn insufficient(evidence: &CandidateScore) -> Option<Reason> {
    if evidence.z_typical >= MIN_Z {
        None
    } else if evidence.z_unadjusted < MIN_Z {
        Some(Reason::HardlyChangesField)
    } else if evidence.z_white_noise < MIN_Z {
        Some(Reason::Confounded)
    } else {
        Some(Reason::Masked)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    fn noise(count: usize) -> Vec<f64> {
        let rng = ChaCha8Rng::seed_from_u64(1);
        StandardNormal.sample_iter(rng).take(count).collect()
    }

    /// Sums of four blocks: squared residual 10, and this change.
    fn p(reduction: f64, product: f64) -> f64 {
        let block = BlockChange { without: 10.0, reduction, product };
        p_of_reduction(&[block; 4], MIN_GAIN)
    }

    #[test]
    fn p_value_is_that_of_the_sum_over_blocks_by_their_products() {
        // 4 * (1 - 0.01) over 2 * 0.1 * sqrt(4): 9.9, with three degrees of freedom.
        assert!((p(1.0, 0.1) - 0.001_096).abs() < 1e-6, "{}", p(1.0, 0.1));
        // The same change within noise of ten times that product.
        assert!((p(1.0, 1.0) - 0.197_58).abs() < 1e-4, "{}", p(1.0, 1.0));
        // A reduction of less than 0.1 % is none, however certain.
        assert!(p(0.009, 1e-6) == 1.0 && p(-1.0, 0.1) == 1.0);
    }

    #[test]
    fn inclusion_is_the_share_of_resamples_with_a_reduction() {
        let block = |reduction: f64| BlockChange { without: 10.0, reduction, product: 0.0 };
        assert_eq!(inclusion(&[block(1.0); 5], 1), 1.0);
        assert_eq!(inclusion(&[block(0.005); 5], 1), 0.0);
        // One block of two explains what the other one loses: both of the first, or one of each.
        let both = inclusion(&[block(3.0), block(-2.0)], 1);
        assert!((both - 0.75).abs() < 0.1, "{both}");
        assert!(inclusion(&[], 1).is_nan());
    }

    #[test]
    fn white_noise_and_a_constant_do_not_vary() {
        assert!(!varies(&[noise(2000), noise(500)]));
        assert!(!varies(&[vec![3.0; 100]]));
    }

    #[test]
    fn slow_change_and_short_bursts_vary() {
        let slow = noise(2000).iter().enumerate().map(|(row, n)| n + 0.01 * row as f64).collect();
        assert!(varies(&[slow]));
        // Three rows of a motor that accelerates, three of one that brakes, each second.
        let burst = |row: usize| match row % 100 {
            0..3 => 15.0,
            50..53 => -15.0,
            _ => 0.0,
        };
        let bursts = noise(2000).iter().enumerate().map(|(row, n)| n + burst(row)).collect();
        assert!(varies(&[bursts]));
    }
}

//! The shortest recording that decides what a diagnosis leaves open: equivalent effects, and effects of which these recordings
//! would not show a typical magnitude.
//!
//! A planned recording is computed with the model at hand and appended to the recordings. For an effect, the score test on all of
//! them gives its typical magnitude in standard errors. For two equivalent effects, the fields of the model with the first are
//! what the model with the second is fitted to (linearised, with all its parameters): the squared error that remains is what
//! distinguishes them (the expected log-likelihood ratio is half of it, in units of the noise variance). Steps of a few
//! patterns are added one by one, each time the one that decides most, and shortened at the end.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use firmware::config::constants;
use model_export::effects::excitation::LoadCycleCounter;
use model_export::effects::{EffectTerm, ExcitationSeries, find};
use model_export::fit::FitOptions;
use model_export::fit::campaign::FitSetup;
use model_export::fit::joint::SensorFit;
use model_export::fit::problem::SensorProblem;
use model_export::fit::rows::{RecordingRows, SensorRows};
use model_export::fit::score_test::ScoreTest;
use model_export::recordings::columns::{Axis, COVARIATES, STATOR_CURRENTS};
use model_export::recordings::smoothing::{HALF_WINDOW, Smoother};
use model_export::stop;
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::Serialize;
use sim::campaign::excitation::Excitation;
use sim::campaign::plan::{AttitudePattern, LoadPattern, PlanStep, RecordingPlan};
use sim::external_fields::motor_currents;
use sim::motion::LEAD_MM;
use statrs::distribution::{ContinuousCDF, Normal};

use crate::diagnose::candidates::{MIN_Z, UntestableEffect, varies};
use crate::diagnose::confusable_effects::Collinearity;
use crate::diagnose::fitted_model::{DISTINGUISHABLE, FittedModel};
use crate::diagnose::observer::Observer;
use crate::diagnose::selection::{Selection, replaced};
use crate::diagnose::verdict::{Reason, Verdict, VerdictKind};

/// Standard errors that a test of all candidates together needs at its level.
const DETECTED: f64 = 3.0;
/// Pause before the planned recording in seconds (assumed; it matters to drifts alone).
const PAUSE_S: f64 = 600.0;
/// Time at the start of a planned recording in seconds that is not counted: what an effect with a memory does there depends on the
/// load before it, which no model knows.
const SETTLED_S: f64 = 0.2;
/// Wanted probability of a right decision.
const WANTED: f64 = 0.95;
/// Duration of a step before it is shortened, and the shorter ones that are tried, in seconds.
const STEP_S: f64 = 10.0;
const SHORTER_S: [f64; 2] = [5.0, 7.0];
/// Duration of a step in which the temperature changes (assumed: a heat gun or a fan changes it by 0.3 K/s).
const WARMING_S: f64 = 25.0;
/// Maximum duration of all planned recordings in seconds.
pub const MAX_S: f64 = 60.0;
/// A step must add this much to the sum of the decided shares.
const MIN_PROGRESS: f64 = 0.02;
/// Steps within this of the best are equivalent; the one with the fewest quantities that vary is taken.
const NEAR: f64 = 0.02;
/// Rows of each recording during the search, and at the end: as many as the screening uses.
const SEARCH_ROWS: usize = 500;
const FINAL_ROWS: usize = 1500;
/// Loads relative to the largest recorded ones.
const LOAD: f64 = 0.8;
/// Change of the temperature in a step, and its limits since the start, in kelvin.
const CHANGE_K: f64 = 8.0;
const WARMING_K: [f64; 2] = [0.0, 10.0];
/// Opening where none was recorded or it hardly varies, in mm.
const OPENING_MM: [f64; 2] = [10.0, 40.0];
const MIN_STROKE_MM: f64 = 10.0;
/// Variance of the error difference of two models, relative to that of independent noise on all channels: the noise of the
/// reference moves the three axes of a sensor together.
const CORRELATED: f64 = 3.0;

/// What a planned recording decides.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlannedDecision {
    /// One effect, or two of which one is present.
    pub effects: Vec<String>,
    /// Predicted probability of the right decision with the recordings at hand.
    pub power_now: f64,
    /// The same together with the planned recording.
    pub power_planned: f64,
}

/// A proposed recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecordingProposal {
    /// The steps; none where no recording decides more.
    pub plan: RecordingPlan,
    /// What it decides, and what it cannot decide (with a low probability).
    pub decisions: Vec<PlannedDecision>,
    /// Effects for which nothing was planned: inconclusive for another reason than the excitation, or not fitted.
    pub left: Vec<String>,
}

impl RecordingProposal {
    fn none() -> Self {
        let plan = RecordingPlan::new(Vec::new());
        Self { plan, decisions: Vec::new(), left: Vec::new() }
    }
}

/// What is open.
enum Question<'a> {
    /// Which of two effects is present: the last model, and the same with the other effect.
    Equivalent { truth: &'a FittedModel, rival: FittedModel, effects: [String; 2] },
    /// Whether an effect is present, and the column that must vary for that, if it does not.
    Presence(EffectTerm, Option<String>),
}

impl Question<'_> {
    fn effects(&self) -> Vec<String> {
        match self {
            Self::Equivalent { effects, .. } => effects.to_vec(),
            Self::Presence(effect, _) => vec![effect.name().to_owned()],
        }
    }
}

/// Evidence on a question, and the probability of a right decision.
#[derive(Clone, Copy, Debug)]
struct Evidence {
    /// Relative to what is wanted, at most 1.
    share: f64,
    power: f64,
}

/// Proposes a recording for what the verdicts leave open, with a sample of the rows of `all`.
pub fn propose(
    (setup, all): (&FitSetup, &FitSetup),
    selection: &Selection,
    verdicts: &[Verdict],
    untestable: &[UntestableEffect],
    options: FitOptions,
    observer: &Observer,
) -> RecordingProposal {
    let Some(last) = selection.stages.last() else {
        return RecordingProposal::none();
    };
    observer.stage("planning a recording", 0.5);
    let mut proposal = RecordingProposal::none();
    let questions = questions(setup, selection, verdicts, untestable, options, &mut proposal);
    let planner = Planner {
        setup,
        last,
        block_s: selection.block_s,
        noise: Normal::standard(),
        limits: Limits::of(setup),
        templates: all.rows.iter().map(Template::of).collect(),
        rows_per_sampled: (longest(all) / longest(setup).max(1)).max(1),
    };
    if questions.is_empty() {
        return proposal;
    }
    let plan = planner.search(&questions, observer);
    let all: Vec<usize> = (0..setup.rows.len()).collect();
    let now = planner.evidence(&questions, None, &all, FINAL_ROWS);
    let planned = match plan.steps.is_empty() {
        true => now.clone(),
        false => planner.evidence(&questions, Some(&plan), &all, FINAL_ROWS),
    };
    proposal.plan = plan;
    for ((question, now), planned) in questions.iter().zip(now).zip(planned) {
        proposal.decisions.push(PlannedDecision {
            effects: question.effects(),
            power_now: now.power,
            power_planned: planned.power,
        });
    }
    proposal.decisions.sort_by(|a, b| b.power_planned.total_cmp(&a.power_planned));
    let decided = proposal.decisions.iter().filter(|decision| decision.power_planned >= WANTED);
    proposal.plan.decides = decided.map(|decision| decision.effects.join(" or ")).collect();
    proposal
}

/// Questions that a recording can answer; the others are added to `proposal.left`.
fn questions<'a>(
    setup: &FitSetup,
    selection: &'a Selection,
    verdicts: &[Verdict],
    untestable: &[UntestableEffect],
    options: FitOptions,
    proposal: &mut RecordingProposal,
) -> Vec<Question<'a>> {
    let mut questions = Vec::new();
    let Some(last) = selection.stages.last() else {
        return questions;
    };
    for step in &selection.steps {
        for other in &step.tied {
            let effects = replaced(&last.effects, &step.chosen, other);
            match FittedModel::without_validation(setup, effects, options) {
                Ok(rival) => questions.push(Question::Equivalent {
                    truth: last,
                    rival,
                    effects: [step.chosen.name(), other.name()].map(str::to_owned),
                }),
                Err(_) => proposal.left.push(other.name().to_owned()),
            }
        }
    }
    let screened = |name: &str| {
        let mut all = selection.last.iter().map(|screened| &screened.candidate);
        all.find(|candidate| candidate.name() == name).cloned()
    };
    for verdict in verdicts.iter().filter(|verdict| verdict.kind == VerdictKind::Inconclusive) {
        let known = screened(&verdict.effect);
        let (effect, column) = match &verdict.reason {
            Reason::HardlyChangesField | Reason::Confounded | Reason::Masked => (known, None),
            Reason::DoesNotVary(column) => {
                let named = untestable.iter().find(|one| one.effect == verdict.effect);
                let effect = named.and_then(|one| find(&one.effect).ok());
                (effect.map(EffectTerm::Catalogue), Some(column.clone()))
            }
            _ => (None, None),
        };
        match effect {
            Some(effect) if !effect.is_transient() => {
                questions.push(Question::Presence(effect, column));
            }
            _ => proposal.left.push(verdict.effect.clone()),
        }
    }
    questions
}

/// Ranges of a planned recording.
struct Limits {
    /// Amplitudes of the lateral and the longitudinal load.
    load_n: [f64; 2],
    opening_mm: [f64; 2],
    /// Rotor's angle at the screw's zero, with the lead of MAGPIE's screw (assumed, as the current of strokes).
    rotor_rad: f64,
}

impl Limits {
    fn of(setup: &FitSetup) -> Self {
        let parts = || setup.rows.iter().flat_map(|rows| &rows.parts);
        let peak = |axis: usize| {
            let forces = parts().flat_map(|part| &part.track.force_n);
            forces.map(|force| force[axis].abs()).fold(0.0, f64::max)
        };
        let column = |name: &str| {
            let columns = parts().filter_map(|part| part.track.covariates.get(name));
            columns.flatten().copied().collect::<Vec<f64>>()
        };
        let opening = column("opening_mm");
        let low = opening.iter().copied().fold(f64::INFINITY, f64::min);
        let high = opening.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let (mut sin, mut cos) = (0.0, 0.0);
        for (angle, opening) in column("motor_angle_rad").iter().zip(&opening) {
            let rotor = angle - TAU * opening / LEAD_MM;
            (sin, cos) = (sin + rotor.sin(), cos + rotor.cos());
        }
        let whole = |mm: f64| mm.round().max(0.0);
        Self {
            load_n: [peak(0), peak(1)].map(|peak| (LOAD * peak / 5.0).floor() * 5.0),
            opening_mm: match (low, high) {
                _ if opening.is_empty() => OPENING_MM,
                (low, high) if high - low >= MIN_STROKE_MM => [whole(low), whole(high)],
                (low, _) => {
                    let stroke_mm = OPENING_MM[1] - OPENING_MM[0];
                    let from_mm = whole(low).min(constants::STROKE.value - stroke_mm);
                    [from_mm, from_mm + stroke_mm]
                }
            },
            rotor_rad: f64::atan2(sin, cos),
        }
    }

    /// Steps that can follow a plan: every pattern of the loads, with every change of the quantities on which the effects depend.
    fn steps(&self, plan: &RecordingPlan, needs: &[String]) -> Vec<PlanStep> {
        let depends = |names: &[&str]| {
            needs.iter().any(|need| names.iter().any(|name| need.starts_with(name)))
        };
        let still = [self.opening_mm[0]; 2];
        let openings = match depends(&["opening", "motor"]) {
            true => vec![still, self.opening_mm],
            false => vec![still],
        };
        let so_far = plan.warming_k(plan.seconds());
        let mut changes = vec![0.0];
        if depends(&["temp"]) {
            let possible =
                |change: &f64| (WARMING_K[0]..=WARMING_K[1]).contains(&(so_far + change));
            changes.extend([CHANGE_K, -CHANGE_K].into_iter().filter(possible));
        }
        let mut attitudes = vec![AttitudePattern::Level];
        if depends(&["roll", "pitch", "yaw", "accel"]) {
            attitudes.push(AttitudePattern::Turning);
        }
        if depends(&["accel"]) {
            attitudes.push(AttitudePattern::Shaken);
        }
        let left_s = MAX_S / f64::from(plan.recordings) - plan.seconds();
        let mut steps = Vec::new();
        for load in [LoadPattern::Cycles, LoadPattern::None, LoadPattern::Fast, LoadPattern::Hold] {
            for &opening_mm in &openings {
                for &temperature_k in &changes {
                    for &attitude in &attitudes {
                        steps.push(PlanStep {
                            seconds: if temperature_k == 0.0 { STEP_S } else { WARMING_S },
                            load,
                            load_n: match load {
                                LoadPattern::None => [0.0; 2],
                                _ => self.load_n,
                            },
                            opening_mm,
                            temperature_k,
                            attitude,
                        });
                    }
                }
            }
        }
        steps.retain(|step: &PlanStep| step.seconds <= left_s);
        steps
    }
}

/// Number of quantities that vary in a step.
fn effort(step: &PlanStep) -> usize {
    let varies = [
        step.load != LoadPattern::None,
        step.opening_mm[0] != step.opening_mm[1],
        step.temperature_k != 0.0,
        step.attitude != AttitudePattern::Level,
    ];
    varies.into_iter().filter(|varies| *varies).count()
}

/// Search for a plan.
struct Planner<'a> {
    setup: &'a FitSetup,
    last: &'a FittedModel,
    block_s: f64,
    noise: Normal,
    limits: Limits,
    /// Of every sensor, from all rows: delays of milliseconds are computed with the period of the recordings.
    templates: Vec<Template>,
    /// Rows of a recording for each sampled one.
    rows_per_sampled: usize,
}

impl Planner<'_> {
    /// The best plan; without steps where none decides more than the recordings at hand.
    fn search(&self, questions: &[Question], observer: &Observer) -> RecordingPlan {
        let mut needs: Vec<String> = Vec::new();
        for name in questions.iter().flat_map(Question::effects) {
            needs.extend(
                find(&name).into_iter().flat_map(|e| e.needs.iter().map(|n| (*n).to_owned())),
            );
        }
        let total = |plan: Option<&RecordingPlan>| -> f64 {
            let evidence = self.evidence(questions, plan, &[0], SEARCH_ROWS);
            evidence.iter().map(|one| one.share).sum()
        };
        let enough = questions.len() as f64 - 1e-9;
        // Whether an effect is present shows in the error of recordings that were not fitted.
        let is_presence = |question: &Question| matches!(question, Question::Presence(..));
        let recordings = if questions.iter().any(is_presence) { 2 } else { 1 };
        let mut plan = RecordingPlan::new(Vec::new()).repeated(recordings);
        let mut reached = total(None);
        while reached < enough && !observer.is_stopped() {
            observer.stage(&format!("planning a recording, step {}", plan.steps.len() + 1), 0.3);
            let steps = self.limits.steps(&plan, &needs);
            let scored: Vec<(f64, RecordingPlan)> = steps
                .into_par_iter()
                .map(|step| {
                    stop::check();
                    let mut longer = plan.clone();
                    longer.steps.push(step);
                    (total(Some(&longer)), longer)
                })
                .collect();
            let best = scored.iter().map(|(score, _)| *score).fold(0.0, f64::max);
            if best < reached + MIN_PROGRESS {
                break;
            }
            let near = scored.into_iter().filter(|(score, _)| *score >= best - NEAR);
            let Some((score, simplest)) =
                near.min_by_key(|(_, plan)| plan.steps.last().map_or(0, effort))
            else {
                break;
            };
            (reached, plan) = (score, simplest);
        }
        for place in 0..plan.steps.len() {
            // Warming and several strokes take their time.
            let step = &plan.steps[place];
            let is_fixed = step.temperature_k != 0.0 || step.opening_mm[0] != step.opening_mm[1];
            for seconds in SHORTER_S.into_iter().filter(|_| !is_fixed) {
                let mut shorter = plan.clone();
                shorter.steps[place].seconds = seconds;
                if total(Some(&shorter)) >= reached - 1e-9 {
                    plan = shorter;
                    break;
                }
            }
        }
        plan
    }

    /// Evidence on each question by the recordings, with planned ones, of some sensors.
    fn evidence(
        &self,
        questions: &[Question],
        plan: Option<&RecordingPlan>,
        sensors: &[usize],
        max_rows: usize,
    ) -> Vec<Evidence> {
        let is_presence = |question: &Question| matches!(question, Question::Presence(..));
        let with_last = questions.iter().any(is_presence).then(|| {
            let mut setup = self.setup.with_rows(self.rows(plan, sensors, |rows| rows / max_rows));
            let model = extended(&setup, self.last);
            let planned = self.setup.recordings();
            set_fields(&mut setup, &model, planned);
            (setup, model)
        });
        let test = with_last
            .as_ref()
            .map(|(setup, model)| ScoreTest::new(setup, &model.effects, &model.fit, self.block_s));
        // The search has some of the rows of some of the sensors; noise is independent between them.
        let fraction =
            (sensors.len() * max_rows) as f64 / (self.setup.rows.len() * FINAL_ROWS).max(1) as f64;
        let evidence = |question: &Question| match question {
            Question::Presence(effect, column) => {
                let is_testable = column.as_ref().is_none_or(|column| {
                    with_last.as_ref().is_some_and(|(setup, _)| has_variation(setup, column))
                });
                let score =
                    test.as_ref().filter(|_| is_testable).and_then(|test| test.score(effect));
                let z = score.map_or(0.0, |score| score.z_typical) / fraction.sqrt();
                let wanted = MIN_Z.max(DETECTED + self.noise.inverse_cdf(WANTED));
                Evidence { share: (z / wanted).min(1.0), power: self.noise.cdf(z - DETECTED) }
            }
            Question::Equivalent { truth, rival, effects } => {
                let stride = (longest(self.setup) / max_rows).max(1);
                let setup = self.setup.with_rows(self.rows(plan, sensors, |_| stride));
                self.difference(setup, (truth, rival), effects, stride)
            }
        };
        questions.iter().map(evidence).collect()
    }

    /// Evidence on the difference of two models, on rows of which every `stride`-th is present. Only the planned recordings count:
    /// those at hand do not distinguish the two, and the noise of their forces would be computed as if it moved the magnet.
    fn difference(
        &self,
        mut setup: FitSetup,
        (truth, rival): (&FittedModel, &FittedModel),
        effects: &[String; 2],
        stride: usize,
    ) -> Evidence {
        if hides_the_difference(&setup, effects) {
            return Evidence { share: 0.0, power: 0.0 };
        }
        let truth = extended(&setup, truth);
        set_fields(&mut setup, &truth, 0);
        let recorded = self.setup.recordings();
        let rival = extended(&setup, rival);
        let test = ScoreTest::new(&setup, &rival.effects, &rival.fit, self.block_s);
        let difference =
            test.mean_square_in(|recording, time_s| recording >= recorded && time_s >= SETTLED_S);
        let rows: usize = setup.rows.iter().map(|rows| stride * rows.len()).sum();
        let sensors = self.setup.rows.len() as f64 / setup.rows.len().max(1) as f64;
        let sigma = 2.0 * (difference * CORRELATED / (3.0 * rows as f64 * sensors)).sqrt();
        let z = (difference - DISTINGUISHABLE) / sigma.max(f64::MIN_POSITIVE);
        let power = self.noise.cdf(z);
        let share = (0.5 * difference / DISTINGUISHABLE).min(1.0 - MIN_PROGRESS);
        Evidence { share: if power >= WANTED { 1.0 } else { share }, power }
    }

    /// Rows of some sensors, thinned by the stride of their number, with those of the planned recordings, without fields.
    fn rows(
        &self,
        plan: Option<&RecordingPlan>,
        sensors: &[usize],
        stride: impl Fn(usize) -> usize,
    ) -> Vec<SensorRows> {
        let numbers =
            plan.into_iter().flat_map(|plan| (1..=plan.recordings).map(move |n| (plan, n)));
        let planned = numbers.filter_map(|(plan, number)| plan.recording(number));
        let excitations: Vec<Excitation> =
            planned.map(|plan| Excitation::planned(&plan, self.limits.rotor_rad)).collect();
        let of_sensor = |&s: &usize| {
            let (rows, mut template) = (self.setup.rows.get(s)?, self.templates.get(s)?.clone());
            let mut parts: Vec<RecordingRows> =
                rows.parts.iter().map(|part| part.thinned(stride(part.len()))).collect();
            for excitation in &excitations {
                let planned = template.rows(rows, excitation);
                let sampled = planned.len() / self.rows_per_sampled;
                parts.push(planned.thinned(self.rows_per_sampled * stride(sampled)));
            }
            Some(SensorRows { forces: rows.forces.clone(), parts, ..*rows })
        };
        sensors.iter().filter_map(of_sensor).collect()
    }
}

/// Rows of the longest recording.
fn longest(setup: &FitSetup) -> usize {
    let parts = setup.rows.iter().flat_map(|rows| &rows.parts);
    parts.map(RecordingRows::len).max().unwrap_or(0)
}

/// Whether the excitation gives both effects nearly the same response, by the rule of the diagnosis.
fn hides_the_difference(setup: &FitSetup, effects: &[String; 2]) -> bool {
    let named = |name: &String| find(name).ok().map(EffectTerm::Catalogue);
    let pair = named(&effects[0]).zip(named(&effects[1]));
    pair.is_some_and(|(one, other)| Collinearity::of(setup).hides_the_difference(&one, &other))
}

/// Whether a column varies over all recordings, as the diagnosis demands.
fn has_variation(setup: &FitSetup, column: &str) -> bool {
    let parts = setup.rows.iter().flat_map(|rows| &rows.parts);
    let columns: Vec<Vec<f64>> =
        parts.map(|part| part.track.covariate(column).unwrap_or_default()).collect();
    varies(&columns)
}

/// What planned recordings of a sensor take from the recordings before them.
#[derive(Clone)]
struct Template {
    /// Index of the next recording, its start and the time before it in seconds.
    recording: usize,
    start_s: f64,
    before_s: f64,
    /// Period of the rows in seconds.
    period_s: f64,
    cycles: LoadCycleCounter,
    has_temperature: bool,
    /// Means of the covariates of the gripper.
    covariates: BTreeMap<String, f64>,
    field_noise_g: Vector3<f64>,
    force_noise_n: Vec<f64>,
}

impl Template {
    fn of(rows: &SensorRows) -> Self {
        let mut cycles = LoadCycleCounter::default();
        for part in &rows.parts {
            cycles.update(&mut part.track.clone());
        }
        let duration_s = |part: &RecordingRows| {
            part.time_s.first().zip(part.time_s.last()).map_or(0.0, |(first, last)| last - first)
        };
        let last = rows.parts.last();
        let mean = |values: &Vec<f64>| values.iter().sum::<f64>() / values.len().max(1) as f64;
        Self {
            recording: rows.parts.len(),
            start_s: last.map_or(0.0, |part| part.track.start_s) + PAUSE_S,
            before_s: rows.parts.iter().map(duration_s).sum(),
            period_s: last
                .map_or(0.01, |part| duration_s(part) / part.len().max(2) as f64)
                .max(1e-4),
            cycles,
            has_temperature: last.is_some_and(|part| !part.track.temperature_c.is_empty()),
            covariates: last.map_or_else(BTreeMap::new, |part| {
                let columns = part.track.covariates.iter();
                columns.map(|(name, values)| (name.clone(), mean(values))).collect()
            }),
            field_noise_g: last.map_or_else(Vector3::zeros, |part| part.field_noise_g),
            force_noise_n: last.map_or_else(Vec::new, |part| part.force_noise_n.clone()),
        }
    }

    /// Rows of the next recording of `sensor`, without fields.
    fn rows(&mut self, sensor: &SensorRows, excitation: &Excitation) -> RecordingRows {
        let count = (excitation.seconds() / self.period_s) as usize;
        let time_s: Vec<f64> = (0..count).map(|row| row as f64 * self.period_s).collect();
        let load = |time_s: &f64, (place, axis): &(u32, Axis)| {
            excitation.load(*place as usize, *time_s)[usize::from(*axis == Axis::Z)]
        };
        let pair =
            [Axis::X, Axis::Z].map(|axis| sensor.forces.iter().find(|(_, own)| *own == axis));
        let force_n: Vec<[f64; 2]> = time_s
            .iter()
            .map(|time_s| pair.map(|force| force.map_or(0.0, |force| load(time_s, force))))
            .collect();
        let temperature = |time_s: &f64| excitation.temperature_c(sensor.sensor as usize, *time_s);
        let mut track = ExcitationSeries {
            recording: self.recording,
            start_s: self.start_s,
            before_s: self.before_s,
            smoother: Smoother::new(HALF_WINDOW, &time_s),
            temperature_c: match self.has_temperature {
                true => time_s.iter().map(temperature).collect(),
                false => Vec::new(),
            },
            covariates: covariates(&self.covariates, excitation, &time_s),
            time_s: time_s.clone(),
            ..ExcitationSeries::default()
        }
        .with_forces(force_n);
        self.cycles.update(&mut track);
        self.recording += 1;
        self.start_s += PAUSE_S;
        self.before_s += excitation.seconds();
        RecordingRows {
            force_n: time_s
                .iter()
                .map(|time_s| sensor.forces.iter().map(|force| load(time_s, force)).collect())
                .collect(),
            field_g: vec![Vector3::zeros(); count],
            field_noise_g: self.field_noise_g,
            force_noise_n: self.force_noise_n.clone(),
            jitter_n: Vec::new(),
            precision: Vec::new(),
            track,
            time_s,
        }
    }
}

/// Columns of a planned recording, of the same names as `recorded`; one that a plan does not have keeps its recorded mean.
fn covariates(
    recorded: &BTreeMap<String, f64>,
    excitation: &Excitation,
    time_s: &[f64],
) -> BTreeMap<String, Vec<f64>> {
    let mut columns: BTreeMap<String, Vec<f64>> =
        recorded.iter().map(|(name, mean)| (name.clone(), vec![*mean; time_s.len()])).collect();
    for (row, time_s) in time_s.iter().enumerate() {
        let currents = motor_currents(&excitation.motion(*time_s));
        let names = COVARIATES.iter().chain(&STATOR_CURRENTS);
        let values = excitation.covariates(*time_s).into_iter().chain(currents.iter().copied());
        for (name, value) in names.zip(values) {
            if let Some(column) = columns.get_mut(*name) {
                column[row] = value;
            }
        }
    }
    columns
}

/// A model with values for the recordings of `setup`; initial states of further recordings have their start values.
fn extended(setup: &FitSetup, model: &FittedModel) -> FittedModel {
    let mut model = model.clone();
    model.effects.sort_by_key(EffectTerm::stage);
    let mut sensors = Vec::new();
    for (rows, base) in setup.rows.iter().zip(&setup.bases) {
        let Some(old) = model.fit.sensors.iter().find(|fit| fit.sensor == rows.sensor) else {
            continue;
        };
        let problem = SensorProblem::new(rows, base.as_ref(), &model.effects);
        let mut known = old.parameters.iter().zip(&old.values).peekable();
        let values = problem.parameters.iter().map(|parameter| {
            match known.next_if(|(old, _)| old.name == parameter.name) {
                Some((_, value)) => *value,
                None => parameter.start,
            }
        });
        let values = values.collect();
        sensors.push(SensorFit { values, ..old.clone() });
    }
    model.fit.sensors = sensors;
    model
}

/// Sets the fields of the recordings from the index `first` to those of a model.
fn set_fields(setup: &mut FitSetup, model: &FittedModel, first: usize) {
    let fields: Vec<Vec<Vec<Vector3<f64>>>> = setup
        .rows
        .iter()
        .zip(&setup.bases)
        .zip(&model.fit.sensors)
        .map(|((rows, base), fit)| {
            let problem = SensorProblem::new(rows, base.as_ref(), &model.effects);
            let scaled = problem.to_scaled(&fit.values);
            (first..rows.parts.len()).map(|part| problem.fields(part, &scaled)).collect()
        })
        .collect();
    for (rows, fields) in setup.rows.iter_mut().zip(fields) {
        for (part, field_g) in rows.parts.iter_mut().skip(first).zip(fields) {
            part.field_g = field_g;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> Limits {
        Limits { load_n: [150.0, 140.0], opening_mm: [10.0, 40.0], rotor_rad: 0.0 }
    }

    #[test]
    fn steps_vary_only_what_the_effects_depend_on() {
        let empty = RecordingPlan::new(Vec::new());
        let of = |needs: &[&str]| {
            let needs: Vec<String> = needs.iter().map(|need| (*need).to_owned()).collect();
            limits().steps(&empty, &needs)
        };
        // Four patterns of loads.
        assert_eq!(of(&[]).len(), 4);
        assert_eq!(of(&["opening_mm"]).len(), 8);
        // Warming or none: it is not colder than at the start.
        assert_eq!(of(&["temp_c"]).len(), 8);
        assert_eq!(of(&["accel_x_mps2", "roll_rad"]).len(), 12);
        let warm = RecordingPlan::new(vec![of(&["temp_c"])[1].clone()]);
        assert_eq!(warm.warming_k(warm.seconds()), CHANGE_K);
        let next = limits().steps(&warm, &["temp_c".to_owned()]);
        assert!(next.iter().all(|step| [0.0, -CHANGE_K].contains(&step.temperature_k)));
    }

    #[test]
    fn covariates_of_a_plan_are_those_of_its_motion() {
        let plan = RecordingPlan::new(vec![PlanStep {
            seconds: 10.0,
            load: LoadPattern::None,
            load_n: [0.0; 2],
            opening_mm: [10.0, 40.0],
            temperature_k: 0.0,
            attitude: AttitudePattern::Level,
        }]);
        let excitation = Excitation::planned(&plan, 0.5);
        let names = ["opening_mm", "accel_z_mps2", "motor_angle_rad", "hose_pressure_kpa"];
        let recorded = names.map(|name| (name.to_owned(), 3.0)).into();
        // The first stroke takes 1.6 s, the second one begins at 2 s and ends at a quarter.
        let found = covariates(&recorded, &excitation, &[0.0, 1.8, 3.9]);
        assert_eq!(found["opening_mm"], [10.0, 40.0, 17.5]);
        assert_eq!(found["accel_z_mps2"], [9.81; 3]);
        assert_eq!(found["motor_angle_rad"][1], 0.5 + TAU * 40.0 / LEAD_MM);
        assert_eq!(found["hose_pressure_kpa"], [3.0; 3]);
        assert_eq!(found.len(), 4);
    }
}

//! A recording by a plan: the step that a person carries out now, and what of it is covered.

use device::recorder::{Coverage, SensorRow};
use model_export::recordings::columns::Axis;
use sim::campaign::plan::{PlanStep, RecordingPlan};

/// Covered share of each range from which a step is enough.
const ENOUGH: f64 = 0.8;
/// A step that is not covered ends after this multiple of its duration.
const PATIENCE: f64 = 3.0;

#[derive(Clone, Debug, PartialEq)]
pub struct StepResult {
    /// Duration in seconds.
    pub seconds: f64,
    /// Ranges of which less than [`ENOUGH`] was covered, with the covered share.
    pub uncovered: Vec<(String, f64)>,
}

/// The steps of a plan while they are recorded.
pub struct Guide {
    plan: RecordingPlan,
    /// Of the steps that have ended.
    pub results: Vec<StepResult>,
    /// Without rows.
    empty: Coverage,
    /// Of the present step.
    coverage: Coverage,
    /// Start of the present step in microseconds of the board.
    start_us: Option<u64>,
    elapsed_s: f64,
}

impl Guide {
    /// Before the first row; `empty` has no rows either.
    pub fn new(plan: RecordingPlan, empty: Coverage) -> Self {
        Self {
            plan,
            results: Vec::new(),
            coverage: empty.clone(),
            empty,
            start_us: None,
            elapsed_s: 0.0,
        }
    }

    /// Adds a row of the board; returns whether a step has ended.
    pub fn update(&mut self, row: &SensorRow) -> bool {
        let start_us = *self.start_us.get_or_insert(row.time_us);
        self.elapsed_s = 1e-6 * row.time_us.saturating_sub(start_us) as f64;
        self.coverage.update(row);
        let Some(step) = self.step().filter(|step| self.elapsed_s >= step.seconds) else {
            return false;
        };
        let uncovered = self.uncovered(step);
        if !uncovered.is_empty() && self.elapsed_s < PATIENCE * step.seconds {
            return false;
        }
        self.results.push(StepResult { seconds: self.elapsed_s, uncovered });
        self.coverage = self.empty.clone();
        self.start_us = None;
        self.elapsed_s = 0.0;
        true
    }

    /// Adds a force of the reference in newtons.
    pub fn update_force(&mut self, key: (u32, Axis), newtons: f64) {
        self.coverage.update_force(key, newtons);
    }

    /// Whether all steps have ended.
    pub fn is_finished(&self) -> bool {
        self.results.len() >= self.plan.steps.len()
    }

    /// What to do now; empty at the end.
    pub fn instruction(&self) -> String {
        let (number, count) = (self.results.len() + 1, self.plan.steps.len());
        self.step().map_or_else(String::new, |step| {
            format!("Step {number} of {count}, {:.0} s: {}.", step.seconds, step.instruction())
        })
    }

    /// Time left in the present step, and covered shares.
    pub fn status(&self) -> String {
        let Some(step) = self.step() else { return String::new() };
        let left_s = step.seconds - self.elapsed_s;
        let mut parts = vec![match left_s {
            left if left > 0.0 => format!("{left:.0} s left"),
            _ => "go on until all is covered".to_owned(),
        }];
        let shares = self.shares(step);
        parts.extend(shares.iter().map(|(name, share)| format!("{name} {:.0} %", 100.0 * share)));
        parts.join(", ")
    }

    fn step(&self) -> Option<&PlanStep> {
        self.plan.steps.get(self.results.len())
    }

    /// Covered share of each range of a step, at most 1.
    fn shares(&self, step: &PlanStep) -> Vec<(String, f64)> {
        let covered = self.coverage.ranges();
        let share = |(quantity, width): (&'static str, f64)| {
            let range = covered.iter().find(|range| range.quantity == quantity);
            let covered = range.map_or(0.0, |range| range.max - range.min);
            (quantity.to_owned(), (covered / width).min(1.0))
        };
        step.ranges().into_iter().map(share).collect()
    }

    fn uncovered(&self, step: &PlanStep) -> Vec<(String, f64)> {
        self.shares(step).into_iter().filter(|(_, share)| *share < ENOUGH).collect()
    }
}

#[cfg(test)]
mod tests {
    use firmware::compensation::covariates::{AccelerationSample, AttitudeSample, Covariates};
    use firmware::sensors::hall::{HallReading, SENSORS};
    use sim::campaign::plan::{AttitudePattern, LoadPattern};

    use super::*;

    fn row(ms: u64, opening_um: i32) -> SensorRow {
        let reading = HallReading { field: [1; 3], temperature: 0 };
        SensorRow {
            time_us: 1000 * ms,
            readings: [Some(reading); SENSORS],
            force_n: [None; SENSORS],
            covariates: Covariates { opening_um: Some(opening_um), ..Covariates::default() },
        }
    }

    fn guide() -> Guide {
        let step = PlanStep {
            seconds: 2.0,
            load: LoadPattern::None,
            load_n: [0.0; 2],
            opening_mm: [10.0, 30.0],
            temperature_k: 0.0,
            attitude: AttitudePattern::Level,
        };
        let still = PlanStep { opening_mm: [10.0; 2], ..step.clone() };
        Guide::new(RecordingPlan::new(vec![step, still]), Coverage::new(250.0, Vec::new()))
    }

    #[test]
    fn step_ends_after_its_time_when_covered() {
        let mut guide = guide();
        assert!(guide.instruction().starts_with("Step 1 of 2, 2 s: do not load the fingers; open"));
        let ended: Vec<u64> =
            (0..=4001).filter(|ms| guide.update(&row(*ms, 10_000 + 8 * *ms as i32))).collect();
        // 16 mm of 20 are covered at its end. The second step begins with the next row.
        assert_eq!(ended, [2000, 4001]);
        assert!(guide.is_finished() && guide.results.iter().all(|one| one.uncovered.is_empty()));
    }

    #[test]
    fn every_range_of_a_step_is_a_covered_quantity() {
        let turning = PlanStep {
            seconds: 10.0,
            load: LoadPattern::Cycles,
            load_n: [100.0, 100.0],
            opening_mm: [10.0, 30.0],
            temperature_k: 5.0,
            attitude: AttitudePattern::Turning,
        };
        let shaken = PlanStep { attitude: AttitudePattern::Shaken, ..turning.clone() };
        for step in [turning, shaken] {
            let ranges = step.ranges();
            let reference = vec![(0, Axis::X), (0, Axis::Z)];
            let mut guide =
                Guide::new(RecordingPlan::new(vec![step]), Coverage::new(250.0, reference.clone()));
            for place in 0..2_i16 {
                let covariates = Covariates {
                    opening_um: Some(10_000 * i32::from(place)),
                    acceleration: Some(AccelerationSample {
                        age_us: 0,
                        mm_s2: [5000 * i32::from(place); 3],
                    }),
                    attitude: Some(AttitudeSample { age_ms: 0, euler: [5000 * place; 3] }),
                    ..Covariates::default()
                };
                let mut row = SensorRow { covariates, ..row(place as u64, 0) };
                let reading = HallReading { field: [1; 3], temperature: 100 * place };
                row.readings = [Some(reading); SENSORS];
                guide.update(&row);
                for key in &reference {
                    guide.update_force(*key, 50.0 * f64::from(place));
                }
            }
            let step = guide.step().unwrap();
            let shares = guide.shares(step);
            assert_eq!(shares.len(), ranges.len());
            assert!(shares.iter().all(|(_, share)| *share > 0.0), "{shares:?}");
        }
    }

    #[test]
    fn uncovered_step_is_prolonged_and_then_reported() {
        let mut guide = guide();
        let ended = (0..10_000).find(|ms| guide.update(&row(*ms, 10_000 + (*ms as i32).min(5000))));
        assert_eq!(ended, Some(6000));
        assert_eq!(guide.results[0].uncovered, [("opening".to_owned(), 0.25)]);
        assert!(!guide.is_finished());
    }
}

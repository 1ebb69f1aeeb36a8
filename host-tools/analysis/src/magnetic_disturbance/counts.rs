//! Detection rate, latency, false alarms and operating characteristics.

use crate::magnetic_disturbance::event::{DisturbanceEvent, MAX_LATENCY};
use statrs::distribution::{Beta, ChiSquared, ContinuousCDF};

/// Names of the detector's measures, as in JSON.
pub const MEASURES: [&str; 4] = ["parity", "common", "sigma", "split"];
/// Units of their thresholds; the first two are squares of ratios.
pub const UNITS: [&str; 4] = ["", "", " N", " N"];

/// Measures are pooled in blocks of one second, so a persistent one is one alarm.
const BLOCK_FRAMES: u32 = 1000;
/// False alarms are reported per ten hours.
pub const PER_S: f64 = 36_000.0;
/// Required detection rate.
const MIN_DETECTED: f64 = 0.99;
/// Required upper limit of false alarms in ten hours.
const MAX_FALSE_PER_10H: f64 = 1.0;
/// Points of an operating characteristic per decade of false alarms.
const PER_DECADE: f64 = 8.0;

/// Counts over any number of runs.
#[derive(Clone, Debug, Default)]
pub struct DetectionCounts {
    /// Force error above which detection is required, in newtons.
    pub alarm_error_n: f64,
    /// Disturbance-free time.
    pub seconds: f64,
    /// Rising edges of the flag in that time.
    pub false_alarms: usize,
    /// Magnets that passed.
    pub events: Vec<DisturbanceEvent>,
    /// Maxima of the measures in every disturbance-free second.
    blocks: Vec<[f64; 4]>,
}

/// Performance of a threshold on one measure alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OperatingPoint {
    /// Threshold of the measure.
    pub threshold: f64,
    /// Seconds above the threshold in ten disturbance-free hours.
    pub false_per_10h: f64,
    /// Fraction of the magnets that exceed it in time.
    pub detected: f64,
}

impl DetectionCounts {
    /// Zero counts; detection is required above a force error of `alarm_error_n` newtons.
    pub fn new(alarm_error_n: f64) -> Self {
        Self { alarm_error_n, ..Self::default() }
    }

    /// Adds a disturbance-free frame; `rose` on a rising edge of the flag.
    pub fn add_clean_frame(&mut self, frame: u32, measures: [f64; 4], rose: bool) {
        self.false_alarms += usize::from(rose);
        if frame.is_multiple_of(BLOCK_FRAMES) {
            self.blocks.push([0.0; 4]);
        }
        if let Some(block) = self.blocks.last_mut() {
            for (max, now) in block.iter_mut().zip(measures) {
                *max = max.max(now);
            }
        }
    }

    /// Sum of both.
    pub fn with(mut self, mut other: Self) -> Self {
        self.alarm_error_n = self.alarm_error_n.max(other.alarm_error_n);
        self.seconds += other.seconds;
        self.false_alarms += other.false_alarms;
        self.events.append(&mut other.events);
        self.blocks.append(&mut other.blocks);
        self
    }

    /// Disturbance-free hours.
    pub fn hours(&self) -> f64 {
        self.seconds / 3600.0
    }

    /// Magnets with a force error above the limit.
    fn relevant(&self) -> impl Iterator<Item = &DisturbanceEvent> {
        self.events.iter().filter(|event| event.error_at.is_some())
    }

    /// Number of magnets with a force error above the limit.
    pub fn relevant_count(&self) -> usize {
        self.relevant().count()
    }

    /// Frames from the force error to the flag in rising order: negative if the flag was first, infinite if
    /// it was never set.
    pub fn latencies(&self) -> Vec<f64> {
        let mut all: Vec<f64> = self.relevant().map(DisturbanceEvent::latency).collect();
        all.sort_by(f64::total_cmp);
        all
    }

    /// Quantile of the latency; `None` without magnets or where it is infinite.
    pub fn latency(&self, share: f64) -> Option<f64> {
        let latencies = self.latencies();
        let place = (share * latencies.len() as f64) as usize;
        let latency = latencies.get(place.min(latencies.len().checked_sub(1)?))?;
        latency.is_finite().then_some(*latency)
    }

    fn in_time(&self) -> usize {
        let limit = f64::from(MAX_LATENCY);
        self.relevant().filter(|p| p.latency() <= limit).count()
    }

    /// Fraction detected in time; `None` without magnets.
    pub fn detected(&self) -> Option<f64> {
        let relevant = self.relevant_count();
        (relevant > 0).then(|| self.in_time() as f64 / relevant as f64)
    }

    /// 95 % Clopper-Pearson interval of the detection rate.
    pub fn detected_interval(&self) -> [f64; 2] {
        binomial(self.in_time() as f64, self.relevant_count() as f64)
    }

    fn per_10h(&self, alarms: f64) -> f64 {
        alarms * PER_S / self.seconds
    }

    /// False alarms per ten hours.
    pub fn false_per_10h(&self) -> f64 {
        self.per_10h(self.false_alarms as f64)
    }

    /// 95 % upper bound of the false alarms per ten hours.
    pub fn false_upper(&self) -> f64 {
        self.per_10h(poisson_upper(self.false_alarms as f64))
    }

    /// True if detection rate and false alarms meet the requirements.
    pub fn meets_requirements(&self) -> bool {
        self.detected().is_some_and(|share| share >= MIN_DETECTED)
            && self.false_per_10h() < MAX_FALSE_PER_10H
    }

    /// Operating characteristic of one measure, from the highest threshold down; empty where the measure was
    /// always zero.
    pub fn characteristic(&self, measure: usize) -> Vec<OperatingPoint> {
        let mut clean: Vec<f64> = self.blocks.iter().map(|block| block[measure]).collect();
        clean.sort_by(|a, b| b.total_cmp(a));
        if clean.first().is_none_or(|max| *max <= 0.0) {
            return Vec::new();
        }
        let relevant = self.relevant_count().max(1) as f64;
        let point = |place: usize| {
            let threshold = clean[place];
            let detected = self.relevant().filter(|event| event.max_measures[measure] > threshold);
            OperatingPoint {
                threshold,
                false_per_10h: self.per_10h(place as f64),
                detected: detected.count() as f64 / relevant,
            }
        };
        places(clean.len()).map(point).collect()
    }
}

/// Zero, and logarithmically spaced indices below `count`.
fn places(count: usize) -> impl Iterator<Item = usize> {
    let steps = (PER_DECADE * (count.max(1) as f64).log10()).floor() as u32;
    let mut places = vec![0];
    for step in 0..=steps {
        let place = 10.0_f64.powf(f64::from(step) / PER_DECADE).round() as usize;
        if place < count && !places.contains(&place) {
            places.push(place);
        }
    }
    places.into_iter()
}

/// 95 % Clopper-Pearson interval of a proportion.
fn binomial(count: f64, all: f64) -> [f64; 2] {
    let beta = |a: f64, b: f64, at: f64| Beta::new(a, b).map_or(f64::NAN, |b| b.inverse_cdf(at));
    let lower = match count {
        0.0 => 0.0,
        _ => beta(count, all - count + 1.0, 0.025),
    };
    let upper = if count == all { 1.0 } else { beta(count + 1.0, all - count, 0.975) };
    [lower, upper]
}

/// 95 % upper bound of a Poisson mean: 3.0 for a count of zero.
fn poisson_upper(count: f64) -> f64 {
    let chi = ChiSquared::new(2.0 * count + 2.0);
    chi.map_or(f64::NAN, |chi| 0.5 * chi.inverse_cdf(0.95))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(error_at: Option<u32>, flag_at: Option<u32>, parity: f64) -> DisturbanceEvent {
        DisturbanceEvent { error_at, flag_at, max_measures: [parity, 0.0, 0.0, 0.0] }
    }

    /// A disturbance-free hour with a parity of 0 to 9 in turn, and five magnets: one without a force error,
    /// one detected early, one after 20 ms, one after 21 ms, one never.
    fn hour() -> DetectionCounts {
        let mut counts = DetectionCounts::default();
        for second in 0..3600_u32 {
            for frame in [0, 1] {
                let parity = f64::from(second % 10);
                counts.add_clean_frame(
                    1000 * second + frame,
                    [parity, 0.0, 0.0, 0.0],
                    second == 7 && frame == 0,
                );
            }
        }
        counts.seconds = 3600.0;
        counts.events = vec![
            event(None, Some(3), 99.0),
            event(Some(100), Some(90), 20.0),
            event(Some(100), Some(120), 8.5),
            event(Some(100), Some(121), 4.0),
            event(Some(100), None, 0.0),
        ];
        counts
    }

    #[test]
    fn detection_rate_counts_only_magnets_with_a_force_error() {
        let counts = hour();
        assert_eq!((counts.relevant_count(), counts.detected()), (4, Some(0.5)));
        assert_eq!(counts.latencies()[..3], [-10.0, 20.0, 21.0]);
        assert_eq!((counts.latency(0.5), counts.latency(0.99)), (Some(21.0), None));
        // Two of four by Clopper and Pearson: 6.8 to 93.2 %.
        let [least, most] = counts.detected_interval();
        assert!((least - 0.0676).abs() < 1e-3 && (most - 0.9324).abs() < 1e-3);
        assert_eq!(DetectionCounts::default().detected(), None);
        assert!(!counts.meets_requirements());
    }

    #[test]
    fn false_alarm_bound_follows_the_rule_of_three() {
        let mut counts = hour();
        assert_eq!(counts.false_per_10h(), 10.0);
        // The upper bound of a mean with a count of one is 4.74.
        assert!((counts.false_upper() - 47.44).abs() < 0.01);
        counts.false_alarms = 0;
        assert!((counts.false_upper() - 29.96).abs() < 0.01);
    }

    #[test]
    fn lower_thresholds_detect_more_at_more_false_alarms() {
        let curve = hour().characteristic(0);
        let first = OperatingPoint { threshold: 9.0, false_per_10h: 0.0, detected: 0.25 };
        assert_eq!(curve[0], first);
        assert!(curve.windows(2).all(|two| {
            two[1].false_per_10h > two[0].false_per_10h && two[1].detected >= two[0].detected
        }));
        let last = curve.last().unwrap();
        assert!(last.threshold < 4.0 && last.detected == 0.75, "{last:?}");
        assert_eq!(hour().characteristic(1), []);
    }
}

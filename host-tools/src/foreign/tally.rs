//! The counts: detection, latency, false alarms, operating characteristics.

use statrs::distribution::{Beta, ChiSquared, ContinuousCDF};

use super::passage::{IN_TIME, Passage};

/// The measures of which signals are made, by their names.
pub const MEASURES: [&str; 4] = ["parity", "common", "sigma", "split"];
/// Units of their thresholds: squares of shares have none.
pub const UNITS: [&str; 4] = ["", "", " N", " N"];

/// Signals count in blocks of a second: one that stays up is one alarm.
const BLOCK_FRAMES: u32 = 1000;
/// What false alarms are told for: ten hours.
pub const PER_S: f64 = 36_000.0;
/// What is to be reached.
const DETECTED: f64 = 0.99;
const FALSE_PER_10H: f64 = 1.0;
/// Points of a curve of operating characteristics for each decade of false alarms.
const PER_DECADE: f64 = 8.0;

/// What was counted.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Error of a force that is worth an alarm, in newtons.
    pub worth_n: f64,
    /// Time without a magnet.
    pub seconds: f64,
    /// Times that the flag rose in it.
    pub false_alarms: usize,
    /// Magnets.
    pub passages: Vec<Passage>,
    /// The greatest measures of every second without a magnet.
    blocks: Vec<[f64; 4]>,
}

/// What a threshold of one measure alone would do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Operating {
    /// The threshold.
    pub threshold: f64,
    /// Seconds in which the measure is above it, in ten hours without a magnet.
    pub false_per_10h: f64,
    /// Share of the magnets that bring it above in time.
    pub noticed: f64,
}

impl Tally {
    /// Nothing yet; an error of `worth_n` newtons is worth an alarm.
    pub fn new(worth_n: f64) -> Self {
        Self {
            worth_n,
            ..Self::default()
        }
    }

    /// One frame without a magnet.
    pub fn frame(&mut self, frame: u32, measures: [f64; 4], rose: bool) {
        self.false_alarms += usize::from(rose);
        if frame.is_multiple_of(BLOCK_FRAMES) {
            self.blocks.push([0.0; 4]);
        }
        if let Some(block) = self.blocks.last_mut() {
            for (greatest, now) in block.iter_mut().zip(measures) {
                *greatest = greatest.max(now);
            }
        }
    }

    /// Both.
    pub fn with(mut self, mut other: Self) -> Self {
        self.worth_n = self.worth_n.max(other.worth_n);
        self.seconds += other.seconds;
        self.false_alarms += other.false_alarms;
        self.passages.append(&mut other.passages);
        self.blocks.append(&mut other.blocks);
        self
    }

    /// Hours without a magnet.
    pub fn hours(&self) -> f64 {
        self.seconds / 3600.0
    }

    /// Those that moved a force by more than that.
    fn worth(&self) -> impl Iterator<Item = &Passage> {
        self.passages.iter().filter(|p| p.off_at.is_some())
    }

    /// How many magnets moved a force by more than that.
    pub fn judged(&self) -> usize {
        self.worth().count()
    }

    /// Frames from the force's error to the flag, the shortest first; negative where it was noticed
    /// before, infinite where it never was.
    pub fn latencies(&self) -> Vec<f64> {
        let mut all: Vec<f64> = self.worth().map(Passage::latency).collect();
        all.sort_by(f64::total_cmp);
        all
    }

    /// The latency within which this share of the magnets was noticed; `None` where it was not, or
    /// where there were none.
    pub fn latency(&self, share: f64) -> Option<f64> {
        let latencies = self.latencies();
        let place = (share * latencies.len() as f64) as usize;
        let latency = latencies.get(place.min(latencies.len().checked_sub(1)?))?;
        latency.is_finite().then_some(*latency)
    }

    /// How many were noticed in time.
    fn in_time(&self) -> usize {
        let limit = f64::from(IN_TIME);
        self.worth().filter(|p| p.latency() <= limit).count()
    }

    /// Share noticed in time; `None` where there were none.
    pub fn detected(&self) -> Option<f64> {
        let judged = self.judged();
        (judged > 0).then(|| self.in_time() as f64 / judged as f64)
    }

    /// Its interval of 95 %, by Clopper and Pearson.
    pub fn detected_interval(&self) -> [f64; 2] {
        binomial(self.in_time() as f64, self.judged() as f64)
    }

    fn per_10h(&self, alarms: f64) -> f64 {
        alarms * PER_S / self.seconds
    }

    /// False alarms in ten hours.
    pub fn false_per_10h(&self) -> f64 {
        self.per_10h(self.false_alarms as f64)
    }

    /// What these are below with 95 %: three times ten hours over the time, where there was none.
    pub fn false_upper(&self) -> f64 {
        self.per_10h(poisson_upper(self.false_alarms as f64))
    }

    /// True where the figures are reached.
    pub fn reached(&self) -> bool {
        self.detected().is_some_and(|share| share >= DETECTED)
            && self.false_per_10h() < FALSE_PER_10H
    }

    /// What thresholds of one measure do: from the one that is never passed on, as far as every second
    /// passes it; empty where the measure never was above zero.
    pub fn characteristic(&self, measure: usize) -> Vec<Operating> {
        let mut clean: Vec<f64> = self.blocks.iter().map(|block| block[measure]).collect();
        clean.sort_by(|a, b| b.total_cmp(a));
        if clean.first().is_none_or(|greatest| *greatest <= 0.0) {
            return Vec::new();
        }
        let judged = self.judged().max(1) as f64;
        let point = |place: usize| {
            let threshold = clean[place];
            let noticed = self.worth().filter(|p| p.greatest[measure] > threshold);
            Operating {
                threshold,
                false_per_10h: self.per_10h(place as f64),
                noticed: noticed.count() as f64 / judged,
            }
        };
        places(clean.len()).map(point).collect()
    }
}

/// Zero, and numbers below `count` that grow by the same factor.
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

/// Clopper and Pearson's interval of a share, 95 %.
fn binomial(count: f64, all: f64) -> [f64; 2] {
    let beta = |a: f64, b: f64, at: f64| Beta::new(a, b).map_or(f64::NAN, |b| b.inverse_cdf(at));
    let least = match count {
        0.0 => 0.0,
        _ => beta(count, all - count + 1.0, 0.025),
    };
    let most = match count == all {
        true => 1.0,
        false => beta(count + 1.0, all - count, 0.975),
    };
    [least, most]
}

/// What a mean is below with 95 % where so many were counted: 3.0 where none was.
fn poisson_upper(count: f64) -> f64 {
    let chi = ChiSquared::new(2.0 * count + 2.0);
    chi.map_or(f64::NAN, |chi| 0.5 * chi.inverse_cdf(0.95))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn passage(off_at: Option<u32>, flag_at: Option<u32>, parity: f64) -> Passage {
        Passage {
            off_at,
            flag_at,
            greatest: [parity, 0.0, 0.0, 0.0],
        }
    }

    /// An hour without a magnet in which the parity reached 0 to 9 in turn, and four magnets: one that
    /// moved nothing, one noticed before, one 20 ms late, one 21 ms, one never.
    fn hour() -> Tally {
        let mut tally = Tally::default();
        for second in 0..3600_u32 {
            for frame in [0, 1] {
                let parity = f64::from(second % 10);
                tally.frame(
                    1000 * second + frame,
                    [parity, 0.0, 0.0, 0.0],
                    second == 7 && frame == 0,
                );
            }
        }
        tally.seconds = 3600.0;
        tally.passages = vec![
            passage(None, Some(3), 99.0),
            passage(Some(100), Some(90), 20.0),
            passage(Some(100), Some(120), 8.5),
            passage(Some(100), Some(121), 4.0),
            passage(Some(100), None, 0.0),
        ];
        tally
    }

    #[test]
    fn the_share_in_time_counts_those_that_moved_a_force_alone() {
        let tally = hour();
        assert_eq!((tally.judged(), tally.detected()), (4, Some(0.5)));
        assert_eq!(tally.latencies()[..3], [-10.0, 20.0, 21.0]);
        assert_eq!(
            (tally.latency(0.5), tally.latency(0.99)),
            (Some(21.0), None)
        );
        // Two of four by Clopper and Pearson: 6.8 to 93.2 %.
        let [least, most] = tally.detected_interval();
        assert!((least - 0.0676).abs() < 1e-3 && (most - 0.9324).abs() < 1e-3);
        assert_eq!(Tally::default().detected(), None);
        assert!(!tally.reached());
    }

    #[test]
    fn one_alarm_in_an_hour_is_ten_in_ten_and_none_is_below_thirty_by_the_rule_of_three() {
        let mut tally = hour();
        assert_eq!(tally.false_per_10h(), 10.0);
        // The upper end of a mean of which one was counted is 4.74.
        assert!((tally.false_upper() - 47.44).abs() < 0.01);
        tally.false_alarms = 0;
        assert!((tally.false_upper() - 29.96).abs() < 0.01);
    }

    #[test]
    fn a_lower_threshold_never_notices_less_and_the_highest_has_no_false_alarm() {
        let curve = hour().characteristic(0);
        let first = Operating {
            threshold: 9.0,
            false_per_10h: 0.0,
            noticed: 0.25,
        };
        assert_eq!(curve[0], first);
        assert!(curve.windows(2).all(|two| {
            two[1].false_per_10h > two[0].false_per_10h && two[1].noticed >= two[0].noticed
        }));
        // 360 of 3600 seconds reach 9, so that at 3600 a threshold of 8 is passed.
        let last = curve.last().unwrap();
        assert!(last.threshold < 4.0 && last.noticed == 0.75, "{last:?}");
        assert_eq!(hour().characteristic(1), []);
    }
}

//! Ranges that a recording covers so far, relative to those of the recommended recordings of the effects, and the forces
//! that the board estimated.

use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

use device_run::channel_map::covariate_values;
use firmware::config::constants;
use model_export::recordings::columns::{Axis, COVARIATES};
use serde::Serialize;

use super::rows::SensorRow;
use crate::format::degrees;

/// Period of the averaged forces in microseconds.
const FORCE_PERIOD_US: u64 = 10_000;
/// Time over which the speed of the opening is measured, in microseconds.
const SPEED_US: u64 = 50_000;
/// Warming for the effects of temperature in kelvin.
const WARMING_K: f64 = 10.0;
/// Change of the acceleration in a half turn against gravity, in m/s^2.
const HALF_TURN_MPS2: f64 = 2.0 * 9.806_65;

/// Covered range of one quantity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CoveredRange {
    pub quantity: &'static str,
    pub unit: &'static str,
    /// Width of the range that recordings need.
    pub needed: f64,
    /// Minimum so far.
    pub min: f64,
    /// Maximum so far.
    pub max: f64,
}

impl CoveredRange {
    /// Covered share of the needed range, at most 1.
    pub fn share(&self) -> f64 {
        ((self.max - self.min) / self.needed).min(1.0)
    }
}

/// Estimated forces by sensor and axis: time in seconds since the first row, newtons.
pub type ForceEstimates = BTreeMap<(u32, Axis), Vec<[f64; 2]>>;

/// Covered ranges of a recording.
#[derive(Clone, Debug)]
pub struct Coverage {
    force_range_n: f64,
    reference: Vec<(u32, Axis)>,
    /// Ranges with the sensor, 0 for the whole gripper.
    ranges: Vec<(u32, CoveredRange)>,
    first_us: Option<u64>,
    /// Last covariates, angles unwrapped.
    last: [Option<f64>; COVARIATES.len()],
    /// Time in microseconds and opening in millimetres from which the speed is measured.
    speed_from: Option<(u64, f64)>,
    /// Number of the averaging period, sum of its forces in newtons and their count.
    averages: BTreeMap<(u32, Axis), (u64, f64, u32)>,
    /// None where they are not kept.
    estimates: Option<BTreeMap<(u32, Axis), BoundedSeries>>,
}

/// Maximum number of samples of a force, 10 min at the period of the averages; even.
const MAX_ESTIMATES: usize = 1 << 16;

/// Samples of a force in bounded memory: of longer recordings means over longer times.
#[derive(Clone, Debug)]
struct BoundedSeries {
    samples: Vec<[f64; 2]>,
    /// Samples that one mean is of.
    averaged: u32,
    /// Sum of the samples of the next mean, and their count.
    sum: ([f64; 2], u32),
}

impl BoundedSeries {
    const EMPTY: Self = Self { samples: Vec::new(), averaged: 1, sum: ([0.0; 2], 0) };

    fn push(&mut self, [time_s, newtons]: [f64; 2]) {
        let ([sum_s, sum_n], count) = self.sum;
        self.sum = ([sum_s + time_s, sum_n + newtons], count + 1);
        if self.sum.1 < self.averaged {
            return;
        }
        if self.samples.len() >= MAX_ESTIMATES {
            let mean = |pair: &[[f64; 2]]| match pair {
                [a, b] => [0, 1].map(|part| 0.5 * (a[part] + b[part])),
                other => other.first().copied().unwrap_or_default(),
            };
            self.samples = self.samples.chunks(2).map(mean).collect();
            self.averaged = self.averaged.saturating_mul(2);
            // The present sample is the first half of a mean.
            return;
        }
        self.complete();
    }

    /// Adds the mean of the samples since the last one.
    fn complete(&mut self) {
        let (sum, count) = std::mem::take(&mut self.sum);
        if count > 0 {
            self.samples.push(sum.map(|sum| sum / f64::from(count)));
        }
    }
}

impl Coverage {
    /// Without rows. Forces need the design's range in newtons, either sign; those in `reference` count as added by
    /// [`Self::update_force`], all others as estimated by the board.
    pub fn new(force_range_n: f64, reference: Vec<(u32, Axis)>) -> Self {
        Self {
            force_range_n,
            reference,
            ranges: Vec::new(),
            first_us: None,
            last: [None; COVARIATES.len()],
            speed_from: None,
            averages: BTreeMap::new(),
            estimates: None,
        }
    }

    /// Keeps the board's estimates, at most 65,536 means of each force.
    pub fn with_estimates(self) -> Self {
        Self { estimates: Some(BTreeMap::new()), ..self }
    }

    /// Adds a row of the board.
    pub fn update(&mut self, row: &SensorRow) {
        let time_us = row.time_us.saturating_sub(*self.first_us.get_or_insert(row.time_us));
        for (sensor, (reading, force_n)) in (0..).zip(row.readings.iter().zip(&row.force_n)) {
            if let Some(reading) = reading {
                self.add(("temperature", "K", WARMING_K), sensor, degrees(reading.temperature));
            }
            for (axis, newtons) in [Axis::X, Axis::Z].into_iter().zip(force_n.iter().flatten()) {
                self.add_estimate((sensor, axis), time_us, *newtons);
            }
        }
        let values = covariate_values(&row.covariates);
        for (place, (name, value)) in COVARIATES.iter().zip(values).enumerate() {
            let (Some(value), Some(last)) = (value, self.last.get_mut(place)) else {
                continue;
            };
            let unwrapped = match *last {
                Some(last) if name.ends_with("_rad") => {
                    last + (value - last + PI).rem_euclid(TAU) - PI
                }
                _ => value,
            };
            *last = Some(unwrapped);
            if let Some(quantity) = quantity(name) {
                self.add(quantity, 0, unwrapped);
            }
        }
        let [opening_mm, ..] = values;
        self.update_speed(time_us, opening_mm);
    }

    /// Adds a force of the reference in newtons.
    pub fn update_force(&mut self, (sensor, axis): (u32, Axis), newtons: f64) {
        let name = if axis == Axis::X { "lateral force" } else { "longitudinal force" };
        self.add((name, "N", 2.0 * self.force_range_n), sensor, newtons);
    }

    /// Covered ranges; of quantities of each sensor that of the sensor with the smallest one.
    pub fn ranges(&self) -> Vec<CoveredRange> {
        let mut ranges: Vec<CoveredRange> = Vec::new();
        for (_, range) in &self.ranges {
            match ranges.iter_mut().find(|other| other.quantity == range.quantity) {
                None => ranges.push(*range),
                Some(other) if range.share() < other.share() => *other = *range,
                Some(_) => {}
            }
        }
        ranges
    }

    /// Means of the board's estimates over 10 ms, or longer in long recordings; none without [`Self::with_estimates`].
    pub fn estimates(self) -> ForceEstimates {
        let series = self.estimates.into_iter().flatten();
        series
            .map(|(key, mut series)| {
                series.complete();
                (key, series.samples)
            })
            .collect()
    }

    fn add(
        &mut self,
        (quantity, unit, needed): (&'static str, &'static str, f64),
        sensor: u32,
        value: f64,
    ) {
        let mut ranges = self.ranges.iter_mut();
        match ranges.find(|(of, range)| *of == sensor && range.quantity == quantity) {
            Some((_, range)) => {
                (range.min, range.max) = (range.min.min(value), range.max.max(value));
            }
            None => {
                let range = CoveredRange { quantity, unit, needed, min: value, max: value };
                self.ranges.push((sensor, range));
            }
        }
    }

    /// Adds an estimate of the board. Periods are centred on the multiples of their length, where a recording without
    /// reference has its rows.
    fn add_estimate(&mut self, key: (u32, Axis), time_us: u64, newtons: f64) {
        let now = (time_us + FORCE_PERIOD_US / 2) / FORCE_PERIOD_US;
        let (period, sum_n, count) = self.averages.entry(key).or_insert((now, 0.0, 0));
        if *period == now {
            *sum_n += newtons;
            *count += 1;
            return;
        }
        let sample = [1e-6 * (*period * FORCE_PERIOD_US) as f64, *sum_n / f64::from(*count)];
        (*period, *sum_n, *count) = (now, newtons, 1);
        if let Some(estimates) = &mut self.estimates {
            estimates.entry(key).or_insert(BoundedSeries::EMPTY).push(sample);
        }
        if !self.reference.contains(&key) {
            let [_, mean_n] = sample;
            self.update_force(key, mean_n);
        }
    }

    fn update_speed(&mut self, time_us: u64, opening_mm: Option<f64>) {
        self.speed_from = match (opening_mm, self.speed_from) {
            (None, _) => None,
            (Some(_), Some((from_us, from_mm))) if time_us < from_us + SPEED_US => {
                Some((from_us, from_mm))
            }
            (Some(opening_mm), from) => {
                if let Some((from_us, from_mm)) = from {
                    let speed = 1e6 * (opening_mm - from_mm).abs() / (time_us - from_us) as f64;
                    let needed = constants::CLOSING_SPEED.value;
                    self.add(("speed of the opening", "mm/s", needed), 0, speed);
                }
                Some((time_us, opening_mm))
            }
        };
    }
}

/// Name, unit and needed range of a covariate; `None` where no effect needs a range.
fn quantity(column: &str) -> Option<(&'static str, &'static str, f64)> {
    match column {
        "opening_mm" => Some(("opening", "mm", constants::STROKE.value)),
        "motor_iq_a" => {
            let rated_a = constants::RATED_TORQUE.value / constants::TORQUE_CONSTANT.value;
            Some(("motor current", "A", rated_a))
        }
        "motor_angle_rad" => Some(("rotor angle", "rad", TAU)),
        "accel_x_mps2" => Some(("acceleration along x", "m/s2", HALF_TURN_MPS2)),
        "accel_z_mps2" => Some(("acceleration along z", "m/s2", HALF_TURN_MPS2)),
        "roll_rad" => Some(("roll", "rad", FRAC_PI_2)),
        "pitch_rad" => Some(("pitch", "rad", FRAC_PI_2)),
        "yaw_rad" => Some(("yaw", "rad", FRAC_PI_2)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use firmware::compensation::covariates::{AttitudeSample, Covariates};
    use firmware::sensors::hall::{HallReading, SENSORS};

    use super::*;

    fn row(ms: u64, force_n: f64, covariates: Covariates) -> SensorRow {
        let reading = HallReading { field: [1; 3], temperature: 0 };
        SensorRow {
            time_us: 5_000_000 + 1000 * ms,
            readings: [Some(reading); SENSORS],
            force_n: [None, None, None, Some([force_n, 200.0 * force_n])],
            covariates,
        }
    }

    fn found(coverage: &Coverage, quantity: &str) -> CoveredRange {
        let ranges = coverage.ranges();
        *ranges.iter().find(|range| range.quantity == quantity).unwrap()
    }

    #[test]
    fn covered_share_is_relative_to_the_needed_range() {
        let mut coverage = Coverage::new(250.0, vec![(1, Axis::Z), (2, Axis::Z)]);
        for ms in 0..1000 {
            let covariates = Covariates {
                opening_um: Some(60_000 - 20 * ms as i32),
                // Beyond half a turn the angle wraps.
                attitude: Some(AttitudeSample {
                    age_ms: 0,
                    euler: [0, 0, if ms < 500 { 31_000 } else { -31_000 }],
                }),
                ..Covariates::default()
            };
            coverage.update(&row(ms, ms as f64, covariates));
        }
        assert!((found(&coverage, "opening").share() - 19.98 / 80.0).abs() < 1e-6);
        let speed = found(&coverage, "speed of the opening");
        assert!((speed.min - 20.0).abs() < 1e-6 && (speed.max - 20.0).abs() < 1e-6, "{speed:?}");
        assert!((found(&coverage, "yaw").max - found(&coverage, "yaw").min - 0.0832).abs() < 1e-3);
        assert_eq!(found(&coverage, "temperature").share(), 0.0);
        coverage.update_force((2, Axis::Z), -100.0);
        coverage.update_force((2, Axis::Z), 25.0);
        coverage.update_force((1, Axis::Z), -500.0);
        coverage.update_force((1, Axis::Z), 500.0);
        // The sensor with the smallest range counts; the third has the board's own, which is wider.
        assert_eq!(found(&coverage, "longitudinal force").share(), 0.25);
    }

    #[test]
    fn estimated_forces_are_means_over_ten_milliseconds() {
        let mut coverage = Coverage::new(250.0, Vec::new()).with_estimates();
        for ms in 0..30 {
            coverage.update(&row(ms, ms as f64, Covariates::default()));
        }
        let estimates = coverage.estimates();
        // 0 to 4 ms, 5 to 14, 15 to 24.
        assert_eq!(estimates[&(3, Axis::X)], [[0.0, 2.0], [0.01, 9.5], [0.02, 19.5]]);
    }

    #[test]
    fn estimates_of_ten_hours_are_bounded_means_without_a_gap() {
        // A row for each mean; the force in newtons is the time in seconds.
        let rows_of = |coverage: &mut Coverage| {
            for tick in 0..3_600_000_u64 {
                coverage.update(&row(10 * tick, 1e-2 * tick as f64, Covariates::default()));
            }
        };
        let mut coverage = Coverage::new(250.0, Vec::new()).with_estimates();
        rows_of(&mut coverage);
        let estimates = coverage.estimates();
        let counts: usize = estimates.values().map(Vec::len).sum();
        assert!(estimates.len() == 2 && counts <= 2 * (MAX_ESTIMATES + 1), "{counts}");
        let samples = &estimates[&(3, Axis::X)];
        assert!(samples.len() >= MAX_ESTIMATES / 2, "{}", samples.len());
        assert!(samples.iter().all(|[time_s, newtons]| (time_s - newtons).abs() < 1e-6));
        // 64 averages in one mean.
        let steps_s = samples.windows(2).map(|pair| pair[1][0] - pair[0][0]);
        assert!(steps_s.clone().all(|step_s| step_s > 0.0 && step_s <= 0.641));
        assert!(samples[samples.len() - 1][0] > 35_999.0);
        let mut coverage = Coverage::new(250.0, Vec::new());
        coverage.update(&row(0, 1.0, Covariates::default()));
        coverage.update(&row(10, 1.0, Covariates::default()));
        assert!(coverage.estimates().is_empty());
    }
}

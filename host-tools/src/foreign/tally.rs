//! The counts: detection, latency, false alarms, operating characteristics.

use std::fmt::Write;

use plotters::prelude::*;
use statrs::distribution::{Beta, ChiSquared, ContinuousCDF};

use super::passage::{IN_TIME, Passage};

/// The measures, and what they stand for.
const MEASURES: [&str; 4] = ["parity", "common", "sigma N", "split N"];
/// Signals count in blocks of a second: one that stays up is one alarm.
const BLOCK_FRAMES: u32 = 1000;
/// False alarms in ten hours at which the operating characteristics are told.
const RATES: [f64; 5] = [0.0, 1.0, 10.0, 100.0, 1000.0];
/// What is to be reached.
const DETECTED: f64 = 0.99;
const FALSE_PER_10H: f64 = 1.0;

/// What was counted.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Simulated time without a magnet.
    pub seconds: f64,
    /// Times that the flag rose in it.
    pub false_alarms: usize,
    /// Magnets.
    pub passages: Vec<Passage>,
    /// The greatest measures of every second without a magnet.
    blocks: Vec<[f64; 4]>,
}

impl Tally {
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
        self.seconds += other.seconds;
        self.false_alarms += other.false_alarms;
        self.passages.append(&mut other.passages);
        self.blocks.append(&mut other.blocks);
        self
    }

    /// Those that moved a force by more than 20 N.
    fn worth(&self) -> Vec<&Passage> {
        self.passages
            .iter()
            .filter(|p| p.off_at.is_some())
            .collect()
    }

    /// Frames from the force's error to the flag; negative where it was noticed before.
    fn latencies(&self) -> Vec<f64> {
        let latency = |p: &&Passage| match (p.off_at, p.flag_at) {
            (Some(off), Some(flag)) => f64::from(flag) - f64::from(off),
            _ => f64::INFINITY,
        };
        let mut all: Vec<f64> = self.worth().iter().map(latency).collect();
        all.sort_by(f64::total_cmp);
        all
    }

    fn per_10h(&self, alarms: f64) -> f64 {
        alarms * 36_000.0 / self.seconds
    }

    /// Share noticed in time, and false alarms in ten hours.
    fn figures(&self) -> (f64, f64) {
        let latencies = self.latencies();
        let in_time = latencies
            .iter()
            .filter(|l| **l <= f64::from(IN_TIME))
            .count();
        let share = in_time as f64 / latencies.len().max(1) as f64;
        (share, self.per_10h(self.false_alarms as f64))
    }

    /// True where the figures are reached.
    pub fn reached(&self) -> bool {
        let (share, alarms) = self.figures();
        share >= DETECTED && alarms < FALSE_PER_10H
    }

    /// Of one measure: threshold, false alarms in ten hours, share noticed in time.
    fn characteristic(&self, measure: usize) -> Vec<[f64; 3]> {
        let mut clean: Vec<f64> = self.blocks.iter().map(|block| block[measure]).collect();
        clean.sort_by(|a, b| b.total_cmp(a));
        let worth = self.worth();
        let point = |alarms: f64| {
            let place = (alarms * self.seconds / 36_000.0).round() as usize;
            let threshold = clean.get(place).copied().unwrap_or(0.0);
            let noticed = worth.iter().filter(|p| p.greatest[measure] > threshold);
            let share = noticed.count() as f64 / worth.len().max(1) as f64;
            [threshold, alarms, share]
        };
        RATES.map(point).to_vec()
    }

    /// The page.
    pub fn text(&self) -> String {
        let (worth, latencies) = (self.worth().len(), self.latencies());
        let (share, alarms) = self.figures();
        let count = (share * worth as f64).round();
        let [least, most] = binomial(count, worth as f64);
        let (low, high) = poisson(self.false_alarms as f64);
        let quantile = |share: f64| {
            let place = ((share * latencies.len() as f64) as usize).min(latencies.len().max(1) - 1);
            latencies.get(place).copied().unwrap_or(f64::NAN)
        };
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{} magnets passed, {worth} moved a force by more than 20 N.\n\
             Noticed within {IN_TIME} ms of that: {:.2} % ({:.2} to {:.2}, binomial, 95 %); \
             latency p50 {:.0}, p90 {:.0}, p99 {:.0} ms, greatest {:.0}\n\
             (negative: before the force was off by 20 N).\n\
             {:.2} h without a magnet: {} false alarms, {alarms:.2} in 10 h ({:.2} to {:.2}, Poisson, 95 %).",
            self.passages.len(),
            100.0 * share,
            100.0 * least,
            100.0 * most,
            quantile(0.5),
            quantile(0.9),
            quantile(0.99),
            latencies.last().copied().unwrap_or(f64::NAN),
            self.seconds / 3600.0,
            self.false_alarms,
            self.per_10h(low),
            self.per_10h(high),
        );
        let _ = writeln!(
            text,
            "Each measure alone: threshold, and share noticed in time"
        );
        let _ = write!(text, "{:<12}", "false / 10 h");
        RATES.iter().for_each(|rate| {
            let _ = write!(text, "{rate:>16.0}");
        });
        for (measure, name) in MEASURES.iter().enumerate() {
            let _ = write!(text, "\n{name:<12}");
            for [threshold, _, share] in self.characteristic(measure) {
                let _ = write!(text, "{threshold:>8.1} {:>5.1} %", 100.0 * share);
            }
        }
        text + "\n"
    }

    /// The operating characteristics as a picture.
    pub fn plot(&self) -> String {
        let mut text = String::new();
        let drawn = self.draw(SVGBackend::with_string(&mut text, (640, 440)));
        drawn.map_or_else(|error| error.to_string(), |()| text)
    }

    fn draw<'a>(
        &self,
        backend: SVGBackend<'a>,
    ) -> Result<(), DrawingAreaErrorKind<std::io::Error>> {
        let paper = backend.into_drawing_area();
        paper.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&paper)
            .margin(12)
            .x_label_area_size(42)
            .y_label_area_size(56)
            .build_cartesian_2d(-0.2..3.2_f64, 0.0..100.5_f64)?;
        chart
            .configure_mesh()
            .x_desc("false alarms in 10 h")
            .y_desc("noticed within 20 ms, %")
            .x_label_formatter(&|x| format!("{:.0}", 10.0_f64.powf(*x)))
            .draw()?;
        let colours = [BLUE, GREEN, MAGENTA, CYAN];
        for ((measure, name), colour) in MEASURES.iter().enumerate().zip(colours) {
            let points = self.characteristic(measure).into_iter();
            let points = points.filter(|[_, rate, _]| *rate > 0.0);
            let points: Vec<(f64, f64)> = points
                .map(|[_, rate, share]| (rate.log10(), 100.0 * share))
                .collect();
            chart
                .draw_series([PathElement::new(points, colour.stroke_width(2))])?
                .label(*name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 14, y)], colour));
        }
        let (share, alarms) = self.figures();
        let at = (alarms.max(0.7).log10(), 100.0 * share);
        chart
            .draw_series([Circle::new(at, 5, RED.filled())])?
            .label("the vote")
            .legend(|(x, y)| Circle::new((x + 7, y), 4, RED.filled()));
        chart
            .configure_series_labels()
            .border_style(BLACK)
            .background_style(WHITE)
            .draw()?;
        paper.present()
    }
}

/// Clopper and Pearson's interval of a share.
fn binomial(count: f64, all: f64) -> [f64; 2] {
    let beta = |a: f64, b: f64, at: f64| Beta::new(a, b).map_or(f64::NAN, |b| b.inverse_cdf(at));
    let least = if count == 0.0 {
        0.0
    } else {
        beta(count, all - count + 1.0, 0.025)
    };
    let most = if count == all {
        1.0
    } else {
        beta(count + 1.0, all - count, 0.975)
    };
    [least, most]
}

/// Garwood's interval of a mean.
fn poisson(count: f64) -> (f64, f64) {
    let chi = |freedom: f64, at: f64| {
        ChiSquared::new(freedom).map_or(f64::NAN, |chi| 0.5 * chi.inverse_cdf(at))
    };
    let least = if count == 0.0 {
        0.0
    } else {
        chi(2.0 * count, 0.025)
    };
    (least, chi(2.0 * count + 2.0, 0.975))
}

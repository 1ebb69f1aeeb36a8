//! Rates, their intervals, and the figures that they are held against.

use statrs::distribution::{Beta, ContinuousCDF};

use super::cases::Group;
use super::run::Outcome;

/// Minimum magnitude in standard errors of a detectable effect.
const ASKED_FROM_Z: f64 = 4.0;

/// A rate and the figure that it must reach.
struct Rate {
    words: &'static str,
    hits: usize,
    of: usize,
    /// At least (true) or at most this share.
    at_least: bool,
    figure: f64,
}

impl Rate {
    fn share(&self) -> f64 {
        self.hits as f64 / self.of.max(1) as f64
    }

    fn is_reached(&self) -> bool {
        if self.at_least { self.share() >= self.figure } else { self.share() <= self.figure }
    }

    fn line(&self) -> String {
        let (low, high) = interval(self.hits, self.of);
        format!(
            "  {:<34} {:>4} of {:<4} {:5.1} % ({:.1} to {:.1} %), asked {} {} %{}",
            self.words,
            self.hits,
            self.of,
            100.0 * self.share(),
            100.0 * low,
            100.0 * high,
            if self.at_least { "at least" } else { "at most" },
            100.0 * self.figure,
            if self.is_reached() { "" } else { "   NOT REACHED" },
        )
    }
}

/// Exact binomial interval of 95 % (Clopper and Pearson 1934).
fn interval(hits: usize, of: usize) -> (f64, f64) {
    let bound = |a: usize, b: usize, level: f64| {
        let beta = Beta::new(a as f64, b as f64).ok();
        beta.map(|beta| beta.inverse_cdf(level))
    };
    let low = bound(hits, of - hits + 1, 0.025).unwrap_or(0.0);
    let high = bound(hits + 1, of - hits, 0.975).unwrap_or(1.0);
    (low, high)
}

/// Prints the rates of a group; true where every figure is reached.
pub fn report(group: Group, outcomes: &[Outcome]) -> bool {
    let asked: Vec<&Outcome> =
        outcomes.iter().filter(|outcome| outcome.z.is_nan() || outcome.z >= ASKED_FROM_Z).collect();
    let count = |is: &dyn Fn(&Outcome) -> bool| asked.iter().filter(|outcome| is(outcome)).count();
    let right = count(&|outcome| outcome.evaluation.right);
    let wrong = count(&|outcome| outcome.evaluation.wrong_alone);
    let rate =
        |words, hits, at_least, figure| Rate { words, hits, of: asked.len(), at_least, figure };
    let mut rates = match group {
        Group::Typical => vec![
            rate("right, alone or tied", right, true, 0.96),
            rate("a wrong name alone", wrong, false, 0.02),
        ],
        Group::Small => vec![
            rate("right, alone or tied", right, true, 0.85),
            rate("a wrong name alone", wrong, false, 0.03),
        ],
        Group::Nothing => vec![rate("something named", asked.len() - right, false, 0.03)],
        Group::Pairs => vec![rate("both right", right, true, 0.9)],
        Group::Outside => vec![rate("no wrong name alone", asked.len() - wrong, true, 0.92)],
        Group::Always => vec![rate("as it must be output", right, true, 1.0)],
    };
    let located: Vec<bool> = outcomes.iter().filter_map(|o| o.evaluation.located).collect();
    if !located.is_empty() {
        rates.push(Rate {
            words: "located where one covariate holds it",
            hits: located.iter().filter(|located| **located).count(),
            of: located.len(),
            at_least: true,
            figure: 0.85,
        });
    }
    rates.iter().for_each(|rate| println!("{}", rate.line()));
    let tied: Vec<usize> = asked.iter().filter_map(|outcome| outcome.evaluation.tied).collect();
    let mean = tied.iter().sum::<usize>() as f64 / tied.len().max(1) as f64;
    let ties_hold = group != Group::Typical || mean <= 1.5;
    if group == Group::Typical {
        println!("  mean size of tied sets {mean:.2}, asked at most 1.5");
    }
    ties_hold && rates.iter().all(Rate::is_reached)
}

//! Confidence intervals of 95 %, both limits.

use statrs::distribution::{Beta, Binomial, ChiSquared, ContinuousCDF, DiscreteCDF};

/// Proportion (Clopper and Pearson 1934).
pub fn proportion(hits: usize, of: usize) -> [f64; 2] {
    let bound = |a: usize, b: usize, level: f64| {
        let beta = Beta::new(a as f64, b as f64).ok();
        beta.map(|beta| beta.inverse_cdf(level))
    };
    let lower = bound(hits, of - hits + 1, 0.025).unwrap_or(0.0);
    let upper = bound(hits + 1, of - hits, 0.975).unwrap_or(1.0);
    [lower, upper]
}

/// Mean of a Poisson count (Garwood 1936).
pub fn poisson(count: usize) -> [f64; 2] {
    let bound = |freedom: usize, level: f64| {
        let chi = ChiSquared::new(freedom as f64).ok();
        chi.map_or(0.0, |chi| 0.5 * chi.inverse_cdf(level))
    };
    [bound(2 * count, 0.025), bound(2 * count + 2, 0.975)]
}

/// Quantile of sorted values by order statistics; the upper limit is infinite with too few values.
pub fn quantile(sorted: &[f64], share: f64) -> [f64; 2] {
    let Ok(below) = Binomial::new(share, sorted.len() as u64) else {
        return [f64::NEG_INFINITY, f64::INFINITY];
    };
    // With [lower, upper) ranks from 1: at least `lower` values are below the quantile.
    let lower = below.inverse_cdf(0.025) as usize;
    let upper = below.inverse_cdf(0.975) as usize + 1;
    let at = |rank: usize| rank.checked_sub(1).and_then(|place| sorted.get(place)).copied();
    [at(lower).unwrap_or(f64::NEG_INFINITY), at(upper).unwrap_or(f64::INFINITY)]
}

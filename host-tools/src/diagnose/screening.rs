//! Every candidate around one fitted model, each against all the others' chance.

use model_export::effects::Addition;
use model_export::fit::evidence::{Around, Evidence};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Draws of signs.
const DRAWS: usize = 499;
/// Probability, over all candidates together, below which chance is not believed.
pub const LEVEL: f64 = 0.05;
/// Share of the squared error left out that must go, or nothing is said.
pub const LEAST_GAIN: f64 = 0.001;

/// One candidate.
pub struct Screened {
    /// The candidate.
    pub candidate: Addition,
    /// What speaks for it.
    pub evidence: Evidence,
    /// Probability of as much by chance in the best of all candidates.
    pub p_adjusted: f64,
}

impl Screened {
    /// Whether chance is not believed: it explains more than chance would in the best of all, and the
    /// error falls in every part left out.
    pub fn is_significant(&self) -> bool {
        self.p_adjusted < LEVEL
            && self.evidence.wins() == self.evidence.folds.len()
            && self.evidence.gain() > LEAST_GAIN
    }
}

/// Screens the candidates, the one that takes most away first.
pub fn screen(around: &Around, candidates: &[Addition], seed: u64) -> Vec<Screened> {
    let evidence: Vec<(Addition, Evidence)> = candidates
        .par_iter()
        .filter_map(|candidate| Some((candidate.clone(), around.evidence(candidate)?)))
        .collect();
    let Some(best) = evidence
        .iter()
        .max_by(|a, b| a.1.gain().total_cmp(&b.1.gain()))
    else {
        return Vec::new();
    };
    let draws = signs(around.blocks, seed);
    let mut most = vec![f64::NEG_INFINITY; DRAWS];
    let mut standing = Vec::new();
    for (_, one) in &evidence {
        let drawn = around.drawn(one, &best.1, &draws);
        let mean = drawn.iter().sum::<f64>() / DRAWS as f64;
        let squares: f64 = drawn.iter().map(|d| (d - mean).powi(2)).sum();
        let spread = (squares / DRAWS as f64).sqrt().max(1e-9);
        for (most, drawn) in most.iter_mut().zip(&drawn) {
            *most = most.max((drawn - mean) / spread);
        }
        standing.push((one.explained - mean) / spread);
    }
    let probability = |z: f64| {
        let beyond = most.iter().filter(|most| **most >= z).count();
        (1 + beyond) as f64 / (1 + DRAWS) as f64
    };
    let mut screened: Vec<Screened> = evidence
        .into_iter()
        .zip(standing)
        .map(|((candidate, evidence), z)| Screened {
            candidate,
            evidence,
            p_adjusted: probability(z),
        })
        .collect();
    screened.sort_by(|a, b| b.evidence.gain().total_cmp(&a.evidence.gain()));
    screened
}

/// Signs of the blocks, one list for each draw.
fn signs(blocks: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut sign = || if rng.random::<bool>() { 1.0 } else { -1.0 };
    (0..DRAWS)
        .map(|_| (0..blocks).map(|_| sign()).collect())
        .collect()
}

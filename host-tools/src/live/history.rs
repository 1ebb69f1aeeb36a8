//! Forces of the last seconds, for the plots.

use std::collections::VecDeque;

/// How far back it goes, in seconds.
pub const SECONDS: f64 = 10.0;
/// Time between two points.
const STEP_S: f64 = 0.05;

/// Forces of one sensor over time.
#[derive(Clone, Debug, Default)]
pub struct History {
    points: VecDeque<(f64, [f64; 2])>,
}

impl History {
    /// Takes the forces at a time in seconds that only grows.
    pub fn push(&mut self, at_s: f64, force_n: [f64; 2]) {
        if self
            .points
            .back()
            .is_none_or(|(last_s, _)| at_s - last_s >= STEP_S)
        {
            self.points.push_back((at_s, force_n));
        }
        while self
            .points
            .front()
            .is_some_and(|(first_s, _)| at_s - first_s > SECONDS)
        {
            self.points.pop_front();
        }
    }

    /// One force over the seconds before now.
    pub fn curve(&self, force: usize, now_s: f64) -> Vec<(f64, f64)> {
        let points = self.points.iter();
        points
            .map(|(at_s, force_n)| (at_s - now_s, force_n[force.min(1)]))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_holds_the_last_seconds_and_no_more() {
        let mut history = History::default();
        for tick in 0..30_000 {
            let at_s = f64::from(tick) * 1e-3;
            history.push(at_s, [at_s, -at_s]);
        }
        let curve = history.curve(1, 30.0);
        assert!(
            (curve.len() as f64 - SECONDS / STEP_S).abs() <= 2.0,
            "{}",
            curve.len()
        );
        let (first, last) = (curve[0], curve[curve.len() - 1]);
        assert!(first.0 >= -SECONDS - STEP_S && last.0 <= 0.0 && last.0 >= -2.0 * STEP_S);
        assert!((last.1 + 30.0 + last.0).abs() < 1e-9);
    }
}

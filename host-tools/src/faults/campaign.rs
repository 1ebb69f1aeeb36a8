//! All rows in all situations, on all cores, and the table of what became of them.

use firmware::grip::states::{Power, TASK_CODE, Task};
use model_export::inverse::quantise::TableSet;
use rayon::prelude::*;

use super::row::Row;
use super::run::{Case, Outcome};
use super::situation::Situation;
use crate::drive::gripped::Gripped;
use crate::plant::parameters::Lead;

/// Newtons to the millimetre of what there is to grip.
pub const CONTACTS: [f64; 3] = [333.0, 50.0, 20.0];

/// All cases of so many seeds from `first` on. Where nothing is gripped, one stiffness is enough.
pub fn cases(first: u64, seeds: u64) -> Vec<Case> {
    let mut cases = Vec::new();
    for row in Row::ALL {
        for &situation in row.facts().shows {
            let is_gripped = matches!(situation, Situation::Force | Situation::Hold);
            let contacts = if is_gripped {
                &CONTACTS[..]
            } else {
                &CONTACTS[..1]
            };
            for lead in Lead::BOTH {
                for &contact_n_per_mm in contacts {
                    cases.extend((first..first + seeds).map(|seed| Case {
                        row,
                        situation,
                        lead,
                        contact_n_per_mm,
                        seed,
                    }));
                }
            }
        }
    }
    cases
}

/// Runs cases on all cores; calls `done` after each.
pub fn run(cases: &[Case], tables: &TableSet, done: impl Fn() + Sync) -> Vec<(Case, Outcome)> {
    let one = |case: &Case| {
        let outcome = case.run(tables, None);
        done();
        (*case, outcome)
    };
    cases.par_iter().map(one).collect()
}

/// What became of a row in a situation.
#[derive(Clone, Debug, PartialEq)]
pub struct Tally {
    /// The row.
    pub row: Row,
    /// The situation.
    pub situation: Situation,
    /// Runs.
    pub runs: usize,
    /// Runs in which it was found.
    pub found: usize,
    /// Milliseconds until it was: median, 99 in 100, the greatest.
    pub latency_ms: [f64; 3],
    /// Greatest true force after it, in N.
    pub peak_n: f64,
    /// Runs that ended where the reaction leads.
    pub specified: usize,
    /// Steps that are forbidden.
    pub forbidden: u32,
    /// Runs after which a fault of one sensor had let the force grow too much.
    pub too_much: usize,
    /// States at the end, with how often.
    pub ends: Vec<(u8, usize)>,
}

impl Tally {
    fn of(row: Row, situation: Situation, outcomes: &[&(Case, Outcome)]) -> Self {
        let mut latencies: Vec<f64> = outcomes.iter().filter_map(|(_, o)| o.found_ms).collect();
        latencies.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let place = (share * latencies.len() as f64).ceil() as usize;
            let place = place.clamp(1, latencies.len().max(1)) - 1;
            latencies.get(place).copied().unwrap_or(f64::NAN)
        };
        let mut ends: Vec<(u8, usize)> = Vec::new();
        for (_, outcome) in outcomes {
            match ends.iter_mut().find(|(end, _)| *end == outcome.end) {
                Some((_, count)) => *count += 1,
                None => ends.push((outcome.end, 1)),
            }
        }
        ends.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        let count = |is_so: &dyn Fn(&Case, &Outcome) -> bool| {
            let counted = outcomes
                .iter()
                .filter(|(case, outcome)| is_so(case, outcome));
            counted.count()
        };
        Self {
            row,
            situation,
            runs: outcomes.len(),
            found: latencies.len(),
            latency_ms: [at(0.5), at(0.99), at(1.0)],
            peak_n: outcomes.iter().map(|(_, o)| o.peak_n).fold(0.0, f64::max),
            specified: count(&|_, outcome| outcome.is_as_specified),
            forbidden: outcomes.iter().map(|(_, o)| o.forbidden).sum(),
            too_much: count(&|case, outcome| case.is_too_much(outcome)),
            ends,
        }
    }

    /// Found always, in time and by its detector; ended where it should, and nothing forbidden on the way.
    pub fn is_met(&self) -> bool {
        let [_, most_ms, _] = self.latency_ms;
        self.found == self.runs
            && self.specified == self.runs
            && most_ms <= self.row.facts().within_ms
            && self.forbidden == 0
            && self.too_much == 0
    }

    /// The states at the end in words, the most frequent first.
    pub fn ends_words(&self) -> String {
        let one = |(end, count): &(u8, usize)| match self.ends.len() {
            1 => state_words(*end),
            _ => format!("{} {count}", state_words(*end)),
        };
        self.ends.iter().map(one).collect::<Vec<_>>().join(", ")
    }
}

/// A state by the heartbeat's number, in words.
fn state_words(state: u8) -> String {
    let task = state.checked_sub(TASK_CODE);
    let task = task.and_then(|code| Task::ALL.iter().find(|task| **task as u8 == code));
    let power = Power::ALL.iter().find(|power| **power as u8 == state);
    match (power, task) {
        (_, Some(task)) => Gripped::state_name((Power::Enabled, *task)),
        (Some(power), None) => Gripped::state_name((*power, Task::Idle)),
        (None, None) => state.to_string(),
    }
}

/// Each row in each situation.
pub fn tallies(outcomes: &[(Case, Outcome)]) -> Vec<Tally> {
    let mut tallies = Vec::new();
    for row in Row::ALL {
        for &situation in row.facts().shows {
            let of_both = outcomes.iter();
            let of_both = of_both.filter(|(c, _)| c.row == row && c.situation == situation);
            let of_both: Vec<_> = of_both.collect();
            if !of_both.is_empty() {
                tallies.push(Tally::of(row, situation, &of_both));
            }
        }
    }
    tallies
}

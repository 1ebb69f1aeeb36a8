//! Fault campaign: all faults in all operating states on all cores, and the false alarm rate without faults.

use crate::closed_loop::ClosedLoopSetup;
use crate::closed_loop::grasp_result::GraspResult;
use crate::closed_loop::requirements::quantile;
use crate::drivetrain::parameters::Lead;
use crate::faults::injection::InjectedFault;
use crate::faults::operating_state::OperatingState;
use crate::faults::run::{FaultCase, FaultOutcome, power_of, task_of};
use firmware::grip::states::{PowerState, TaskState};
use firmware::system::faults::Event;
use model_export::inverse::quantise::TableSet;
use rayon::prelude::*;

/// Contact stiffnesses in N/mm.
pub const CONTACTS: [f64; 3] = [333.0, 50.0, 20.0];

/// All cases of `seeds` seeds from `first` on; one stiffness where nothing is gripped.
pub fn cases(first: u64, seeds: u64) -> Vec<FaultCase> {
    let mut cases = Vec::new();
    for fault in InjectedFault::ALL {
        for &state in fault.specification().states {
            // The backdrive test needs a stiff part.
            let is_gripped = state.has_object()
                && !matches!(state, OperatingState::Approach | OperatingState::Calibrating);
            let contacts = if is_gripped { &CONTACTS[..] } else { &CONTACTS[..1] };
            for lead in Lead::BOTH {
                for &contact_n_per_mm in contacts {
                    cases.extend((first..first + seeds).map(|seed| FaultCase {
                        fault,
                        state,
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

/// Runs cases on all cores; `done` is called after each.
pub fn run(
    cases: &[FaultCase],
    tables: &TableSet,
    done: impl Fn() + Sync,
) -> Vec<(FaultCase, FaultOutcome)> {
    let one = |case: &FaultCase| {
        let outcome = case.run(tables, None);
        done();
        (*case, outcome)
    };
    cases.par_iter().map(one).collect()
}

/// Result of a fault campaign.
#[derive(Clone, Debug)]
pub struct CampaignResult {
    /// The first seed, and the number of seeds.
    pub seeds: (u64, u64),
    /// Statistics of each fault in each operating state.
    pub summaries: Vec<FaultSummary>,
    /// Number of runs.
    pub runs: usize,
    /// Number of runs that did not reach their operating state.
    pub unreached: usize,
    /// False alarms without faults.
    pub fault_free: FalseAlarms,
    /// Computing time in seconds.
    pub seconds: f64,
}

/// Statistics of one fault in one operating state.
#[derive(Clone, Debug, PartialEq)]
pub struct FaultSummary {
    /// Injected fault.
    pub fault: InjectedFault,
    /// Operating state.
    pub state: OperatingState,
    /// Number of runs.
    pub runs: usize,
    /// Number of runs with detection.
    pub found: usize,
    /// Detection latency in ms: median, 99th percentile, maximum.
    pub latency_ms: [f64; 3],
    /// Peak true force after the fault, in N.
    pub peak_n: f64,
    /// Number of runs with the specified final state.
    pub specified: usize,
    /// Number of forbidden events.
    pub forbidden: u32,
    /// Number of runs with excessive force after a fault of one sensor.
    pub too_much: usize,
    /// Final states with their counts.
    pub ends: Vec<(u8, usize)>,
}

impl FaultSummary {
    fn of(
        fault: InjectedFault,
        state: OperatingState,
        outcomes: &[&(FaultCase, FaultOutcome)],
    ) -> Self {
        let mut latencies: Vec<f64> = outcomes.iter().filter_map(|(_, o)| o.found_ms).collect();
        latencies.sort_by(f64::total_cmp);
        let mut ends: Vec<(u8, usize)> = Vec::new();
        for (_, outcome) in outcomes {
            match ends.iter_mut().find(|(end, _)| *end == outcome.end) {
                Some((_, count)) => *count += 1,
                None => ends.push((outcome.end, 1)),
            }
        }
        ends.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        let count = |condition: &dyn Fn(&FaultCase, &FaultOutcome) -> bool| {
            let counted = outcomes.iter().filter(|(case, outcome)| condition(case, outcome));
            counted.count()
        };
        Self {
            fault,
            state,
            runs: outcomes.len(),
            found: latencies.len(),
            latency_ms: [0.5, 0.99, 1.0].map(|share| quantile(&latencies, share)),
            peak_n: outcomes.iter().map(|(_, o)| o.peak_n).fold(0.0, f64::max),
            specified: count(&|_, outcome| outcome.is_as_specified),
            forbidden: outcomes.iter().map(|(_, o)| o.forbidden).sum(),
            too_much: count(&|case, outcome| case.is_too_much(outcome)),
            ends,
        }
    }

    /// Always detected in time by its detector, with the specified final state and no forbidden event.
    pub fn is_met(&self) -> bool {
        let [_, p99_ms, _] = self.latency_ms;
        self.found == self.runs
            && self.specified == self.runs
            && p99_ms <= self.fault.specification().within_ms
            && self.forbidden == 0
            && self.too_much == 0
    }

    /// Final states as text, the most frequent first.
    pub fn ends_words(&self) -> String {
        let one = |(end, count): &(u8, usize)| match self.ends.len() {
            1 => state_name(*end),
            _ => format!("{} {count}", state_name(*end)),
        };
        self.ends.iter().map(one).collect::<Vec<_>>().join(", ")
    }
}

/// Readable name of a heartbeat code.
fn state_name(code: u8) -> String {
    match (power_of(code), task_of(code)) {
        (_, Some(task)) => GraspResult::state_name((PowerState::Enabled, task)),
        (Some(power), None) => GraspResult::state_name((power, TaskState::Idle)),
        (None, None) => code.to_string(),
    }
}

/// Statistics of each fault in each operating state.
pub fn summarize(outcomes: &[(FaultCase, FaultOutcome)]) -> Vec<FaultSummary> {
    let mut summaries = Vec::new();
    for fault in InjectedFault::ALL {
        for &state in fault.specification().states {
            let matching: Vec<_> = outcomes
                .iter()
                .filter(|(case, _)| case.fault == fault && case.state == state)
                .collect();
            if !matching.is_empty() {
                summaries.push(FaultSummary::of(fault, state, &matching));
            }
        }
    }
    summaries
}

/// Simulated seconds of one gripper in one operating state.
const SECONDS: f64 = 60.0;
/// Contact stiffness in N/mm.
const CONTACT: f64 = 333.0;

/// False alarms of fault-free runs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FalseAlarms {
    /// Simulated hours.
    pub hours: f64,
    /// Number of reported faults.
    pub alarms: usize,
}

/// Simulates grippers in hold, as a foot and idle, one minute each.
pub fn run_fault_free(
    first: u64,
    hours: f64,
    tables: &TableSet,
    done: impl Fn() + Sync,
) -> FalseAlarms {
    let minutes: Vec<(f64, usize)> = (0..fault_free_minutes(hours))
        .into_par_iter()
        .map(|index| {
            let minutes = minute(index, first + index as u64, tables);
            done();
            minutes
        })
        .collect();
    minutes.iter().fold(FalseAlarms::default(), |sum, (seconds, alarms)| FalseAlarms {
        hours: sum.hours + seconds / 3600.0,
        alarms: sum.alarms + alarms,
    })
}

/// Number of one-minute runs for a number of hours.
pub fn fault_free_minutes(hours: f64) -> usize {
    (3600.0 * hours / SECONDS).ceil() as usize
}

/// Simulated seconds and false alarms of one run.
fn minute(index: usize, seed: u64, tables: &TableSet) -> (f64, usize) {
    let situations = [OperatingState::Hold, OperatingState::Foot, OperatingState::Idle];
    let lead = Lead::BOTH[index % 2];
    let setup = ClosedLoopSetup::scattered(lead, seed);
    let Some(mut cell) = situations[index / 2 % 3].reach(&setup, CONTACT, tables) else {
        return (0.0, 1);
    };
    let start_us = cell.time_us();
    cell.run(SECONDS);
    let events = cell.board.events.borrow();
    let alarms = events
        .iter()
        .filter(|(_, event)| matches!(event, Event::Fault(fault) if fault.active != 0));
    (1e-6 * (cell.time_us() - start_us) as f64, alarms.count())
}

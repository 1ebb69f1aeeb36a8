//! Hours without a fault: every fault that is told is a false alarm.

use firmware::events::Event;
use model_export::inverse::quantise::TableSet;
use rayon::prelude::*;

use super::situation::Situation;
use crate::drive::workcell::Plan;
use crate::plant::parameters::{Lead, Parameters};

/// Virtual seconds of one gripper in one situation.
const SECONDS: f64 = 60.0;
/// What is uncertain is off by up to this share.
const SCATTER: f64 = 0.2;
/// Newtons to the millimetre.
const CONTACT: f64 = 333.0;

/// What was looked at, and what was told.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quiet {
    /// Virtual hours.
    pub hours: f64,
    /// Faults that came.
    pub alarms: usize,
}

/// Grippers in a hold, as a foot, and at rest, for a minute each.
pub fn run(first: u64, hours: f64, tables: &TableSet, done: impl Fn() + Sync) -> Quiet {
    let told: Vec<(f64, usize)> = (0..minutes(hours))
        .into_par_iter()
        .map(|index| {
            let told = minute(index, first + index as u64, tables);
            done();
            told
        })
        .collect();
    told.iter()
        .fold(Quiet::default(), |sum, (seconds, alarms)| Quiet {
            hours: sum.hours + seconds / 3600.0,
            alarms: sum.alarms + alarms,
        })
}

/// How many minutes are run for so many hours.
pub fn minutes(hours: f64) -> usize {
    (3600.0 * hours / SECONDS).ceil() as usize
}

/// Seconds, and faults that came in them.
fn minute(index: usize, seed: u64, tables: &TableSet) -> (f64, usize) {
    let situations = [Situation::Hold, Situation::Foot, Situation::Idle];
    let lead = Lead::BOTH[index % 2];
    let plan = Plan {
        plant: Parameters::scattered(lead, SCATTER, seed),
        ..Plan::nominal(lead, 0.0, seed)
    };
    let Some(mut cell) = situations[index / 2 % 3].reach(&plan, CONTACT, tables) else {
        return (0.0, 1);
    };
    let start_us = cell.time_us();
    cell.run(SECONDS);
    let events = cell.board.events.borrow();
    let came = events
        .iter()
        .filter(|(_, event)| matches!(event, Event::Fault(fault) if fault.active != 0));
    (1e-6 * (cell.time_us() - start_us) as f64, came.count())
}

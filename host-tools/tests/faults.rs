//! Faults thrown at the whole gripper in virtual time, one run of each; campaigns of thousands are
//! `cargo magpie faults`.

use std::sync::LazyLock;

use host_tools::drive::tables;
use host_tools::faults::row::Row;
use host_tools::faults::run::{Case, Outcome};
use host_tools::faults::situation::Situation;
use host_tools::plant::parameters::Lead;
use model_export::inverse::quantise::TableSet;
use rayon::prelude::*;

static TABLES: LazyLock<TableSet> = LazyLock::new(|| tables::as_drawn().unwrap());

/// Newtons to the millimetre.
const RIGID: f64 = 333.0;

fn case(row: Row, situation: Situation, lead: Lead) -> Case {
    Case {
        row,
        situation,
        lead,
        contact_n_per_mm: RIGID,
        seed: 7,
    }
}

/// Found in time, as specified at the end, and nothing forbidden on the way.
fn is_met(case: &Case, outcome: &Outcome) -> bool {
    let within_ms = case.row.facts().within_ms;
    let in_time = outcome.found_ms.is_some_and(|ms| ms <= within_ms);
    in_time && outcome.is_as_specified && outcome.forbidden == 0 && !case.is_too_much(outcome)
}

#[test]
fn every_fault_is_found_in_time_and_leads_where_the_matrix_says() {
    let cases: Vec<Case> = Row::ALL
        .iter()
        .zip(Lead::BOTH.iter().cycle())
        .flat_map(|(row, lead)| {
            let shows = row.facts().shows.iter();
            shows.map(|situation| case(*row, *situation, *lead))
        })
        .collect();
    let missed: Vec<String> = cases
        .par_iter()
        .filter_map(|case| {
            let outcome = case.run(&TABLES, None);
            (!is_met(case, &outcome)).then(|| format!("{case:?}: {outcome:?}"))
        })
        .collect();
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}

#[test]
fn with_its_detector_out_of_reach_a_fault_is_missed() {
    let rows = Row::ALL.par_iter().filter(|row| row.facts().off.is_some());
    rows.for_each(|row| {
        let facts = row.facts();
        let case = case(*row, facts.shows[0], Lead::A);
        let outcome = case.run(&TABLES, facts.off);
        assert!(outcome.was_reached, "{row:?}");
        assert!(!is_met(&case, &outcome), "{row:?}: {outcome:?}");
    });
}

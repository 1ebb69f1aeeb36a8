//! Faults thrown at the whole gripper in virtual time, one run of each; campaigns of thousands are
//! `cargo magpie faults`.

use std::sync::LazyLock;

use firmware::crash::Kind;
use firmware::events::Event;
use firmware::grip::states::Power;
use firmware::motor::State;
use firmware::status::Fault;
use host_tools::board::i2c::Sensor;
use host_tools::drive::tables;
use host_tools::drive::workcell::{Plan, Workcell};
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
    // Grippers of which the last two are noisier at rest, and quicker away from what presses, than most.
    let grippers = [(7, Lead::A), (10, Lead::B), (1, Lead::A)];
    let cases: Vec<Case> = Row::ALL
        .iter()
        .flat_map(|row| row.facts().shows.iter().map(move |shows| (*row, *shows)))
        .flat_map(|(row, situation)| {
            grippers.map(|(seed, lead)| Case {
                seed,
                ..case(row, situation, lead)
            })
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

#[test]
fn what_presses_too_much_is_given_way_to_and_not_let_go() {
    for (lead, seed) in [(Lead::A, 1), (Lead::A, 2), (Lead::B, 2), (Lead::B, 3)] {
        for situation in [Situation::Force, Situation::Hold] {
            let outcome = Case {
                seed,
                ..case(Row::OverForce, situation, lead)
            }
            .run(&TABLES, None);
            // It is backed off to 50 N.
            assert!((40.0..60.0).contains(&outcome.end_n), "{outcome:?}");
        }
    }
}

/// Of a nominal gripper on a screw that locks itself.
fn reached(situation: Situation) -> Workcell {
    let plan = Plan::nominal(Lead::A, 0.0, 7);
    situation.reach(&plan, RIGID, &TABLES).unwrap()
}

#[test]
fn a_sensor_without_its_configuration_counts_again_once_it_is_back() {
    let mut cell = reached(Situation::Idle);
    let change = |cell: &Workcell, change: fn(&mut Sensor)| {
        change(&mut cell.board.connections.buses[1].borrow_mut().sensors[0]);
    };
    let is_lost = |cell: &Workcell| cell.board.exchange.is_active(Fault::SensorLost);
    assert!(!is_lost(&cell));
    change(&cell, Sensor::brown_out);
    cell.run(0.1);
    assert!(is_lost(&cell));
    cell.run(0.5);
    assert!(is_lost(&cell));
    change(&cell, Sensor::power_up);
    cell.run(0.1);
    assert!(!is_lost(&cell));
}

#[test]
fn a_bit_that_turns_in_the_grasp_s_memory_ends_in_a_restart_that_tells_it_and_a_screw_that_locks_keeps_its_load()
 {
    let mut cell = reached(Situation::Hold);
    // The exponent of the force that is asked for.
    cell.board.grip.borrow_mut().spoil(32 + 26);
    cell.tick();
    let motor = |cell: &Workcell| cell.gripper.borrow().rig.motor.telling();
    assert_eq!(motor(&cell).state, State::Disarmed);
    cell.run(0.3);
    assert_eq!(cell.state(), Power::Safe as u8);
    assert_eq!(
        (motor(&cell).state, motor(&cell).opening_mm),
        (State::Disarmed, None)
    );
    assert!(cell.force_n() > 90.0, "{}", cell.force_n());
    let events = cell.board.events.borrow();
    let told = events.iter().find_map(|(_, event)| match event {
        Event::Fault(told) if told.code == Fault::Crashed as u16 => Some(told.detail),
        _ => None,
    });
    assert_eq!(told, Some(Kind::Corruption.number() << 24));
}

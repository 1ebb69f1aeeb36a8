use super::table::Range;
use super::*;
use crate::wire::{STOP_ALL, identifier};
use std::vec::Vec;

fn asked(parameters: &mut Parameters, op: u8, id: u16, value: i32, armed: bool) -> (u8, i32) {
    let request = ParamRequest {
        op,
        id,
        status: 0,
        value: value as u32,
    };
    let reply = answer(parameters, &request, armed);
    assert_eq!((reply.op, reply.id), (op, id));
    (reply.status, reply.value as i32)
}

#[test]
fn every_identifier_and_name_is_one_parameter_and_its_default_is_in_its_range() {
    for (place, parameter) in TABLE.iter().enumerate() {
        assert!(
            parameter.range.holds(parameter.default),
            "{}",
            parameter.name
        );
        for other in &TABLE[..place] {
            assert_ne!(parameter.id, other.id, "{}", parameter.name);
            assert_ne!(parameter.name, other.name);
        }
    }
}

#[test]
fn without_a_host_the_gripper_is_as_it_was_built() {
    let all = Parameters::DEFAULT;
    assert_eq!((all.node(), all.command_timeout_ms()), (0x10, 100));
    assert_eq!(all.force_rate_hz(), 100);
    assert_eq!(
        [all.raw(), all.foot(), all.telemetry()],
        [false, false, true]
    );
    assert_eq!(all.addresses(), [0x60, 0x63, 0x6C, 0x6F]);
    assert_eq!((all.tare(), all.screw()), (Tare::NONE, Screw::Unknown));
}

#[test]
fn what_is_written_is_read_and_nothing_else_has_changed() {
    for parameter in &TABLE {
        let values: Vec<i32> = match parameter.range {
            Range::Between(least, greatest) => [least, greatest].into(),
            Range::OneOf(choices) => choices.into(),
        };
        for value in values {
            let mut changed = Parameters::DEFAULT;
            let written = asked(&mut changed, op::WRITE, parameter.id, value, false);
            assert_eq!(written, (status::DONE, value), "{}", parameter.name);
            let read = asked(&mut changed, op::READ, parameter.id, 0, true);
            assert_eq!(read, (status::DONE, value));
            for ((id, now), (_, before)) in changed.all().zip(Parameters::DEFAULT.all()) {
                assert_eq!(now, if id == parameter.id { value } else { before });
            }
        }
    }
}

#[test]
fn a_value_one_beyond_its_range_is_refused_and_changes_nothing() {
    for parameter in &TABLE {
        let beyond: Vec<i32> = match parameter.range {
            Range::Between(least, greatest) => [least - 1, greatest + 1, i32::MIN, i32::MAX].into(),
            Range::OneOf(choices) => choices.iter().map(|choice| choice + 1).collect(),
        };
        for value in beyond {
            let mut same = Parameters::DEFAULT;
            let said = asked(&mut same, op::WRITE, parameter.id, value, false);
            assert_eq!(said, (status::OUT_OF_RANGE, parameter.default));
            assert_eq!(same, Parameters::DEFAULT);
        }
    }
}

#[test]
fn while_somebody_is_armed_only_what_moves_nothing_is_written() {
    let open: Vec<&str> = TABLE
        .iter()
        .filter(|parameter| {
            let value = parameter.default;
            let mut same = Parameters::DEFAULT;
            let said = asked(&mut same, op::WRITE, parameter.id, value, true);
            assert!(said == (status::DONE, value) || said == (status::ARMED, value));
            said.0 == status::DONE
        })
        .map(|parameter| parameter.name)
        .collect();
    assert_eq!(open, ["force_rate", "raw", "foot", "telemetry"]);
}

#[test]
fn what_nobody_knows_is_said_so() {
    let mut same = Parameters::DEFAULT;
    let unknown = (status::UNKNOWN, 0);
    assert_eq!(asked(&mut same, op::READ, 0, 0, false), unknown);
    assert_eq!(asked(&mut same, op::WRITE, 0x38, 1, false), unknown);
    let no_op = (status::NO_SUCH_OP, 16);
    assert_eq!(asked(&mut same, 2, id::NODE, 17, false), no_op);
    assert_eq!(same, Parameters::DEFAULT);
}

#[test]
fn no_node_owns_the_identifier_of_the_stop_for_all() {
    let row = TABLE.iter().find(|row| row.id == id::NODE).unwrap();
    let nodes = (0..=i32::from(u16::MAX)).filter(|node| row.range.holds(*node));
    for node in nodes {
        assert_ne!(identifier(node as u16, 0) >> 5, STOP_ALL >> 5);
    }
}

#[test]
fn a_tare_is_eight_parameters_and_stays_in_their_range() {
    let mut all = Parameters::DEFAULT;
    let mut tare = Tare::NONE;
    tare.0[2] = [Force(-5), Force(i32::MAX)];
    all.set_tare(&tare);
    assert_eq!(all.get(id::TARE + 4), Some(-5));
    assert_eq!(all.get(id::TARE + 5), Some(250 << 10));
    assert_eq!(all.tare().0[2], [Force(-5), Force(250 << 10)]);
}

#[test]
fn without_a_measurement_the_motor_is_the_assumed_one() {
    use crate::motor::{Settings, screw::Screw as Known};
    let settings = Parameters::DEFAULT.settings();
    let assumed = Settings::assumed(Known::A);
    let near = |a: f32, b: f32| (a / b - 1.0).abs() < 1e-6;
    assert!(near(
        settings.machine.resistance_ohm,
        assumed.machine.resistance_ohm
    ));
    assert!(near(
        settings.machine.inductance_h,
        assumed.machine.inductance_h
    ));
    let mut coarse = Parameters::DEFAULT;
    coarse.set(id::LEAD, 1).unwrap();
    assert_eq!(coarse.settings().screw, Known::B);
    assert_eq!(settings.screw, Known::A);
}

#[test]
fn what_was_measured_of_motor_and_screw_comes_back_at_the_next_start() {
    use crate::motor::calibration::Outcome;
    use crate::motor::commission::Found;
    use crate::motor::settings::Wiring;
    let mut parameters = Parameters::DEFAULT;
    let wiring = Wiring {
        offset: 0xF001_0000,
        is_swapped: true,
    };
    parameters.set_measured(&Outcome::Motor(Found {
        resistance_ohm: 0.375,
        inductance_h: 0.000_5,
        pole_pairs: 11,
        wiring,
    }));
    let settings = parameters.settings();
    assert_eq!((settings.wiring, settings.machine.pole_pairs), (wiring, 11));
    assert_eq!(settings.machine.resistance_ohm, 0.375);
    assert!((settings.machine.inductance_h - 0.000_5).abs() < 1e-9);
    for (locks, screw) in [(true, Screw::SelfLocking), (false, Screw::BackDriven)] {
        parameters.set_measured(&Outcome::Screw { locks });
        assert_eq!(parameters.screw(), screw);
    }
}

mod samples;
mod turn;

use core::array;
use std::vec::Vec;

use super::*;
use crate::compensate::map::Covariate;
use crate::compensate::{Compensation, OnForce, neighbour_magnet};
use crate::model::network::{Source, Target};
use crate::model::table::{AxisScale, EXP_ENTRIES, SensorTable};
use samples::{Numbers, compensations, network, sensor};
use turn::every_turn_is_noticed;

/// Everything that tables refer to.
struct Owned {
    id: u16,
    exp: [u32; EXP_ENTRIES],
    sensors: Vec<SensorTable>,
    knots: [[i16; 3]; neighbour_magnet::KNOTS],
    values: [i32; 10],
}

impl Owned {
    fn new() -> Self {
        Self {
            id: 0x1234,
            exp: array::from_fn(|entry| Numbers(entry as u32).next() as u32),
            sensors: (0..4).map(sensor).collect(),
            knots: array::from_fn(|knot| [1, -1, 3].map(|times| times * knot as i16)),
            values: array::from_fn(|value| 100 + value as i32),
        }
    }

    /// The tables, `check` as it is stated.
    fn tables<'a>(&'a self, compensations: &'a [Compensation<'a>], check: u32) -> Tables<'a> {
        Tables {
            id: self.id,
            exp: &self.exp,
            sensors: &self.sensors,
            compensations,
            check,
        }
    }

    fn is_sound(&self, check: u32) -> bool {
        let compensations = compensations(&self.knots, &self.values);
        self.tables(&compensations, check).is_sound()
    }

    fn check(&self) -> u32 {
        let compensations = compensations(&self.knots, &self.values);
        self.tables(&compensations, 0).checked().check
    }
}

#[test]
fn any_single_bit_of_the_ideal_model_that_turns_is_noticed() {
    let mut owned = Owned::new();
    let check = owned.tables(&[], 0).checked().check;
    let mut sensor = owned.sensors[2];
    let bits = every_turn_is_noticed(&mut sensor, |sensor| {
        owned.sensors[2] = *sensor;
        owned.tables(&[], check).is_sound()
    });
    // Bytes: 1 + 24 + 2 + 32 + 50 * 20 + 1 + 2 + 1 + 112 + 4.
    assert_eq!(bits, 8 * 1179);
    // The other sensors and the entries of the exponential are walked alike: a bit of each.
    for number in [0, 1, 3] {
        owned.sensors[number].parity.spread ^= 1;
        assert!(!owned.tables(&[], check).is_sound());
        owned.sensors[number].parity.spread ^= 1;
    }
    for entry in 0..EXP_ENTRIES {
        owned.exp[entry] ^= 1 << (entry % 32);
        assert!(!owned.tables(&[], check).is_sound(), "entry {entry}");
        owned.exp[entry] ^= 1 << (entry % 32);
    }
    every_turn_is_noticed(&mut owned.id.clone(), |id| {
        owned.id = *id;
        owned.tables(&[], check).is_sound()
    });
}

#[test]
fn any_single_bit_of_what_is_undone_that_turns_is_noticed() {
    let mut owned = Owned::new();
    owned.sensors.clear();
    let check = owned.check();
    for knot in 0..neighbour_magnet::KNOTS {
        owned.knots[knot][knot % 3] ^= 1 << (knot % 16);
        assert!(!owned.is_sound(check), "knot {knot}");
        owned.knots[knot][knot % 3] ^= 1 << (knot % 16);
    }
    let mut values = owned.values;
    every_turn_is_noticed(&mut values, |values| {
        owned.values = *values;
        owned.is_sound(check)
    });
    let mut list: [_; 4] = compensations(&owned.knots, &owned.values)
        .try_into()
        .unwrap();
    let bits = every_turn_is_noticed(&mut list, |list| owned.tables(list, check).is_sound());
    assert!(bits > 5000, "{bits}");
    // What is there, and of which kind.
    let taken = list[0].field[0].take();
    assert!(taken.is_some() && !owned.tables(&list, check).is_sound());
    list[0].field[0] = taken;
    let Some(OnForce::Map([map, _])) = &mut list[0].force[5] else {
        panic!("no map");
    };
    map.sides[0].as_mut().unwrap().covariate = Covariate::Opening;
    assert!(!owned.tables(&list, check).is_sound());
}

#[test]
fn any_single_bit_of_a_network_that_turns_is_noticed() {
    let mut network = network();
    let bits = every_turn_is_noticed(&mut network, Network::is_sound);
    // Words of 32 bits: inputs 8, force 2, guard 6, first 4 * (6 + 12 + 2 + 24), second 4 * (6 + 24 + 2
    // + 24), head 4 + 16; a sensor in a byte and the steps in two.
    assert_eq!(bits, 32 * (8 + 2 + 6 + 176 + 224 + 20) + 8 + 16);
    let spoilt: [fn(&mut Network<2, 4, 1>); 5] = [
        |network| network.target = Target::Force,
        |network| network.inputs[1][0].source = Source::Field { sensor: 0, axis: 0 },
        |network| network.inputs[0][0].source = Source::Ideal { sensor: 2, axis: 1 },
        |network| network.inputs[0][1].source = Source::Ideal { sensor: 2, axis: 1 },
        |network| network.check ^= 1,
    ];
    for spoil in spoilt {
        let mut network = network.clone();
        spoil(&mut network);
        assert!(!network.is_sound());
    }
}

#[test]
fn a_scrub_walks_through_all_in_a_thousand_calls_and_finds_a_bit_that_turned() {
    let mut owned = Owned::new();
    let check = owned.check();
    let mut scrub = Scrub::default();
    let mut walk = |owned: &Owned| {
        let compensations = compensations(&owned.knots, &owned.values);
        let tables = owned.tables(&compensations, check);
        (1..=CALLS)
            .map(|call| (call, scrub.step(&tables)))
            .find(|(_, found)| *found != Found::Nothing)
    };
    for _ in 0..2 {
        assert!(matches!(walk(&owned), Some((501..=CALLS, Found::Sound))));
    }
    owned.sensors[3].parity.spread ^= 1 << 30;
    assert!(matches!(walk(&owned), Some((501..=CALLS, Found::Broken))));
    owned.sensors[3].parity.spread ^= 1 << 30;
    assert!(matches!(walk(&owned), Some((501..=CALLS, Found::Sound))));
}

#[test]
fn a_scrub_of_little_takes_a_word_at_a_call() {
    struct Little;
    impl Walk for Little {
        const FIXED: usize = 3;
        fn visit(&self, window: &mut Window) {
            [0_u32, 1, 2].visit(window);
        }
    }
    impl Checked for Little {
        fn check(&self) -> u32 {
            sum(self)
        }
    }
    let mut scrub = Scrub::default();
    let found: [Found; 6] = array::from_fn(|_| scrub.step(&Little));
    let [a, b, c] = [Found::Nothing, Found::Nothing, Found::Sound];
    assert_eq!(found, [a, b, c, a, b, c]);
}

/// The generated text and the struct from which its checksum was computed are the same.
#[cfg(target_os = "linux")]
#[test]
fn the_tables_of_this_build_are_sound() {
    use crate::model::tables::{NETWORKS, TABLES};
    assert!(TABLES.is_sound(), "export the tables again");
    for network in &NETWORKS {
        assert!(network.is_sound(), "export the tables again");
    }
}

#[test]
fn the_checksum_is_that_of_zip_over_the_words() {
    // Python: zlib.crc32(struct.pack("<ii", 1, -2)).
    assert_eq!(
        sum(&AxisScale {
            offset: 1,
            gain: -2
        }),
        0xCF8F_9871
    );
}

#[test]
fn a_sensor_has_549_words_and_a_walk_ends_behind_them() {
    // Number 1, scale 6, limit 1, linear 8, pairs 50 * 10, used 1, shift 2, parity 1 + 28 + 1.
    let sensor = sensor(3);
    assert_eq!((words(&sensor), SensorTable::FIXED), (549, 549));
    // Windows of a word at either end, and behind it.
    let at = |skip| {
        let mut window = Window::new(skip, 1, CRC32.digest());
        walk(&sensor, &mut window);
        window.digest.finalize()
    };
    let [number, offset, spread] = [
        3,
        sensor.scale[0].offset as u32,
        sensor.parity.spread as u32,
    ]
    .map(|word| sum(&word));
    assert_eq!(
        [0, 1, 548, 549].map(at),
        [number, offset, spread, CRC32.digest().finalize()]
    );
}

/// Windows side by side give the checksum of the whole, wherever they meet.
#[test]
fn a_walk_in_parts_takes_every_word_once() {
    let owned = Owned::new();
    let compensations = compensations(&owned.knots, &owned.values);
    let tables = owned.tables(&compensations, 0);
    let all = words(&tables);
    for count in [1, 7, 549, 1000, all] {
        let mut digest = CRC32.digest();
        for from in (0..all).step_by(count) {
            let mut window = Window::new(from, count, digest);
            walk(&tables, &mut window);
            assert_eq!(
                (window.skip, window.left),
                (0, (from + count).saturating_sub(all))
            );
            digest = window.digest;
        }
        assert_eq!(digest.finalize(), sum(&tables), "{count} words at a time");
    }
}

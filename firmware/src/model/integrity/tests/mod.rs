mod bit_flips;

use core::array;
use std::vec::Vec;

use crate::compensation::crosstalk::{
    EarthFieldTable, KNOTS, MotorLeakageTable, NeighbourMagnetTable,
};
use crate::compensation::flexure::{
    CreepTable, FingertipMassTable, HardStopTable, ViscousLagTable,
};
use crate::compensation::hysteresis::{HysteresisTable, Slider};
use crate::compensation::lookup_table::{
    Covariate, CovariateFilter, FieldMap, ForceMap, LookupAxis, LookupTable,
};
use crate::compensation::thermal::{
    MagnetTemperatureTable, SensorTemperatureTable, ThermalGapTable,
};
use crate::compensation::{Compensation, FieldEffect, ForceEffect, MAX_EFFECTS};
use crate::fixed_point::{Field, Force};
use crate::model::axis_map::AxisMap;
use crate::model::calibration::{CalibrationMemory, CompensationMemory, POOL_INTEGERS, Payload};
use crate::model::encoding::*;
use crate::model::formats::*;
use crate::model::integrity::*;
use bit_flips::assert_flips_detected;

/// Numbers that differ from each other, so that an omitted or repeated word changes the checksum.
struct Numbers(u32);

impl Numbers {
    fn next(&mut self) -> i32 {
        self.0 = self.0.wrapping_mul(0x9E37_79B1).wrapping_add(0x7F4A_7C15);
        self.0 as i32
    }

    fn many<const N: usize>(&mut self) -> [i32; N] {
        array::from_fn(|_| self.next())
    }

    fn rows<const N: usize, const M: usize>(&mut self) -> [[i32; N]; M] {
        array::from_fn(|_| self.many())
    }

    fn pair(&mut self) -> [i16; 2] {
        [self.next() as i16, self.next() as i16]
    }

    fn pairs<const N: usize, const M: usize>(&mut self) -> [[[i16; 2]; N]; M] {
        array::from_fn(|_| array::from_fn(|_| self.pair()))
    }

    fn units<const I: usize, const H: usize>(&mut self) -> UnitPair<I, H> {
        UnitPair {
            bias: self.rows(),
            input: array::from_fn(|_| self.pairs()),
            state_bias: self.many(),
            state: array::from_fn(|_| self.pairs()),
        }
    }
}

fn sensor(number: u8) -> SensorTable {
    let mut numbers = Numbers(number.into());
    SensorTable {
        number,
        axes: AxisMap(0o016),
        scale: array::from_fn(|_| AxisScale { offset: numbers.next(), gain: numbers.next() }),
        limit_counts: numbers.next() as i16,
        linear: Linear { bias: numbers.many(), slope: numbers.rows() },
        pairs: array::from_fn(|_| CentrePair {
            xy: [numbers.pair(), numbers.pair()],
            z: numbers.pair(),
            weight: [numbers.pair(), numbers.pair()],
        }),
        used_pairs: 50,
        shift: [11, 12],
        parity: Parity { axis: 1, terms: numbers.many(), sigma: numbers.next() },
    }
}

/// All effects on the field and on the forces, two of each per sensor.
fn compensations<'a>(knots: &'a [[i32; 3]; KNOTS], values: &'a [i32]) -> [Compensation<'a>; 4] {
    let numbers = &mut Numbers(7);
    let side = |covariate| Some(LookupAxis { covariate, from: 3, step: 5, knots: 2 });
    let table = |one, other| LookupTable { sides: [side(one), side(other), None], values };
    let field = [
        FieldEffect::SensorTemperature(SensorTemperatureTable { offset: numbers.many(), gain: 5 }),
        FieldEffect::MotorLeakage(MotorLeakageTable { per_ma: numbers.rows() }),
        FieldEffect::EarthField(EarthFieldTable { world: numbers.many(), element: numbers.rows() }),
        FieldEffect::NeighbourMagnet(NeighbourMagnetTable { knots }),
        FieldEffect::Map(FieldMap {
            table: table(Covariate::Force(1), Covariate::Acceleration(2)),
            along: numbers.many(),
            matrix: numbers.rows(),
        }),
        FieldEffect::MagnetTemperature(MagnetTemperatureTable {
            without: numbers.many(),
            per_count: 9,
        }),
        FieldEffect::ThermalGap(ThermalGapTable {
            at: numbers.many(),
            rest: numbers.many(),
            bend: numbers.rows(),
        }),
    ];
    let force = [
        ForceEffect::ViscousLag(ViscousLagTable { lead: numbers.many(), rate: 1 }),
        ForceEffect::Creep(CreepTable { share: numbers.rows(), rate: numbers.many() }),
        ForceEffect::HardStop(HardStopTable { knee: numbers.many(), beyond: numbers.rows() }),
        ForceEffect::Hysteresis(HysteresisTable {
            sliders: array::from_fn(|_| {
                array::from_fn(|_| Slider { reach: numbers.next(), share: numbers.next() })
            }),
        }),
        ForceEffect::FingertipMass(FingertipMassTable { mass: 8 }),
        ForceEffect::Map(ForceMap {
            table: table(Covariate::Lagged(0), Covariate::Rate(1)),
            along: numbers.many(),
        }),
    ];
    array::from_fn(|number| Compensation {
        number: number as u8,
        filters: [
            Some(CovariateFilter { covariate: Covariate::Temperature, gain: 77 }),
            Some(CovariateFilter { covariate: Covariate::Force(0), gain: 99 }),
            None,
            None,
        ],
        field: array::from_fn(|at| field.get(at + 2 * number).copied()),
        force: array::from_fn(|at| force.get(at + 2 * number).copied()),
    })
}

fn network<const INPUTS: usize, const HIDDEN: usize, const HEADS: usize>()
-> Network<INPUTS, HIDDEN, HEADS> {
    let numbers = &mut Numbers(3);
    let input = |source, numbers: &mut Numbers| Input {
        source,
        offset: numbers.next(),
        gain: numbers.next(),
    };
    Network {
        sensors: [2; HEADS],
        target: Target::Rest,
        inputs: array::from_fn(|pair| match pair {
            0 => [
                input(InputSource::Field { sensor: 2, axis: 1 }, numbers),
                input(InputSource::Ideal { sensor: 2, axis: 0 }, numbers),
            ],
            _ => [input(InputSource::None, numbers), input(InputSource::None, numbers)],
        }),
        force: numbers.many(),
        warm_up: 77,
        guards: array::from_fn(|_| Guard {
            residual: numbers.many().map(Field),
            force: numbers.many(),
            deviation: numbers.many().map(Force),
        }),
        weights: Weights {
            first: array::from_fn(|_| numbers.units()),
            second: array::from_fn(|_| numbers.units()),
            heads: array::from_fn(|_| Head { bias: numbers.many(), weights: numbers.pairs() }),
        },
        check: 0,
    }
    .checked()
}

/// Data that the tables refer to.
struct OwnedTables {
    id: u16,
    exp: [u32; EXP_ENTRIES],
    sensors: Vec<SensorTable>,
    knots: [[i32; 3]; KNOTS],
    values: [i32; 10],
}

impl OwnedTables {
    fn new() -> Self {
        Self {
            id: 0x1234,
            exp: array::from_fn(|entry| Numbers(entry as u32).next() as u32),
            sensors: (0..4).map(sensor).collect(),
            knots: array::from_fn(|knot| [1, -1, 3].map(|times| times * knot as i32)),
            values: array::from_fn(|value| 100 + value as i32),
        }
    }

    /// Calls `f` with all tables, their checksum zero.
    fn with<T>(&self, f: impl FnOnce(Tables) -> T) -> T {
        f(Tables {
            id: self.id,
            exp: &self.exp,
            sensors: &self.sensors,
            compensations: &compensations(&self.knots, &self.values),
            check: 0,
        })
    }

    fn checksum(&self) -> u32 {
        self.with(|tables| tables.checked().check)
    }
}

#[test]
fn every_flipped_bit_of_the_ideal_model_is_detected() {
    let mut owned = OwnedTables::new();
    let intact = owned.checksum();
    let mut sensor = owned.sensors[2];
    let bits = assert_flips_detected(&mut sensor, |sensor| {
        owned.sensors[2] = *sensor;
        owned.checksum() == intact
    });
    // Bytes: 1 + 2 + 24 + 2 + 32 + 50 * 20 + 1 + 2 + 1 + 112 + 4.
    assert_eq!(bits, 8 * 1181);
    // The other sensors and the entries of the exponential are traversed alike: one bit of each.
    type Flip = fn(&mut OwnedTables, usize);
    let flips: [(usize, Flip); 4] = [
        (16, |o, bit| o.id ^= 1 << bit),
        (4, |o, sensor| o.sensors[sensor].parity.sigma ^= 1),
        (EXP_ENTRIES, |o, entry| o.exp[entry] ^= 1 << (entry % 32)),
        (KNOTS, |o, knot| o.knots[knot][knot % 3] ^= 1 << (knot % 16)),
    ];
    for (kind, (count, flip)) in flips.into_iter().enumerate() {
        for place in 0..count {
            flip(&mut owned, place);
            assert_ne!(owned.checksum(), intact, "{kind}: {place}");
            flip(&mut owned, place);
        }
    }
    let mut values = owned.values;
    assert_flips_detected(&mut values, |values| {
        owned.values = *values;
        owned.checksum() == intact
    });
}

#[test]
fn every_flipped_bit_of_the_compensation_is_detected() {
    let owned = OwnedTables::new();
    let mut list = compensations(&owned.knots, &owned.values);
    let intact = checksum(&list);
    let bits = assert_flips_detected(&mut list, |list| checksum(list) == intact);
    assert!(bits > 5000, "{bits}");
}

#[test]
fn every_flipped_bit_of_a_network_is_detected() {
    let bits = assert_flips_detected(&mut network::<2, 4, 1>(), Network::is_intact);
    // Words of 32 bits: inputs 8, force 2, guard 6, first 4 * (6 + 12 + 2 + 24), second 4 * (6 + 24 + 2
    // + 24), head 4 + 16; a sensor in a byte and the steps in two.
    assert_eq!(bits, 32 * (8 + 2 + 6 + 176 + 224 + 20) + 8 + 16);
}

#[test]
fn changed_effects_of_a_compensation_are_detected() {
    let owned = OwnedTables::new();
    let original = compensations(&owned.knots, &owned.values);
    let intact = checksum(&original);
    for sensor in 0..original.len() {
        for place in 0..MAX_EFFECTS {
            let mut changed = original;
            if changed[sensor].field[place].take().is_some() {
                assert_ne!(checksum(&changed), intact, "{sensor} {place}");
            }
            let mut changed = original;
            if changed[sensor].force[place].take().is_some() {
                assert_ne!(checksum(&changed), intact, "{sensor} {place}");
            }
        }
    }
    let mut changed = original;
    let Some(ForceEffect::Map(map)) = &mut changed[0].force[5] else {
        panic!("no map");
    };
    map.table.sides[0].as_mut().unwrap().covariate = Covariate::Opening;
    assert_ne!(checksum(&changed), intact);
}

#[test]
fn changed_sources_of_a_network_are_detected() {
    assert!(network::<2, 4, 1>().is_intact());
    let changes: [fn(&mut Network<2, 4, 1>); 5] = [
        |network| network.target = Target::Force,
        |network| network.inputs[1][0].source = InputSource::Field { sensor: 0, axis: 0 },
        |network| network.inputs[0][0].source = InputSource::Ideal { sensor: 2, axis: 1 },
        |network| network.inputs[0][1].source = InputSource::Ideal { sensor: 2, axis: 1 },
        |network| network.check ^= 1,
    ];
    for (number, change) in changes.into_iter().enumerate() {
        let mut network = network();
        change(&mut network);
        assert!(!network.is_intact(), "{number}");
    }
}

fn assert_passes(mut scrubber: Scrubber, calls: usize) {
    let mut owned = OwnedTables::new();
    let check = owned.checksum();
    for (flip, expected) in [
        (0, ScrubResult::Intact),
        (0, ScrubResult::Intact),
        (1 << 30, ScrubResult::Corrupt),
        (1 << 30, ScrubResult::Intact),
    ] {
        owned.sensors[3].parity.sigma ^= flip;
        let (steps, result) = owned.with(|tables| {
            let tables = Tables { check, ..tables };
            (1..=calls)
                .map(|step| (step, scrubber.step(&tables)))
                .find(|(_, result)| *result != ScrubResult::Pending)
                .unwrap()
        });
        assert!(steps > calls / 2, "{steps}");
        assert_eq!(result, expected);
    }
}

#[test]
fn a_scrub_pass_has_its_number_of_steps_and_finds_a_flipped_bit() {
    assert_passes(Scrubber::NEW, 100);
    assert_passes(Scrubber::UNPAUSED, 1000);
}

/// Copies tables with networks of one size, and decodes them from bytes; both have the same content.
fn assert_copied<const I: usize, const H: usize, const S: usize>(networks: &[Network<I, H, S>]) {
    let owned = OwnedTables::new();
    owned.with(|tables| {
        let tables = tables.checked();
        let payload = Payload { tables: &tables, networks };
        let assert_same = |memory: &CalibrationMemory| {
            let copy = memory.calibration::<I, H, S>();
            assert!(copy.tables.is_intact());
            assert_eq!(std::format!("{:?}", copy.tables), std::format!("{tables:?}"));
            let (copied, expected) =
                (std::format!("{:?}", copy.networks), std::format!("({networks:?})"));
            assert!(copied.ends_with(&expected), "{copied}");
        };
        let mut compensations = CompensationMemory::EMPTY;
        let mut memory = std::boxed::Box::new(CalibrationMemory::EMPTY);
        let copied = memory.copy(&payload, &mut compensations);
        // Networks of another size stay in flash.
        if [I, H, S] == [2, 8, 1] || networks.is_empty() {
            copied.unwrap();
            assert_same(&memory);
            decoded(&payload, POOL_INTEGERS, assert_same).unwrap();
        } else {
            assert_eq!(copied, None);
        }
    });
}

/// Decodes an encoded calibration with memory for so many integers; `None` if it does not fit.
fn decoded<const I: usize, const H: usize, const S: usize>(
    payload: &Payload<I, H, S>,
    integers: usize,
    check: impl Fn(&CalibrationMemory),
) -> Option<()> {
    let mut bytes = std::vec::Vec::new();
    encode(payload, &mut |part| bytes.extend_from_slice(part));
    let mut left = &bytes[..];
    let mut source = |to: &mut [u8]| {
        let (next, rest) = left.split_at_checked(to.len())?;
        to.copy_from_slice(next);
        left = rest;
        Some(())
    };
    let mut pool = std::vec![0; integers];
    let mut compensations = CompensationMemory::EMPTY;
    let mut memory = std::boxed::Box::new(CalibrationMemory::EMPTY);
    memory.read(&mut Reader::new(&mut source, &mut pool), &mut compensations)?;
    check(&memory);
    Some(())
}

#[test]
fn a_copied_calibration_is_the_same() {
    assert_copied::<2, 8, 1>(&array::from_fn::<_, 4, _>(|_| network()));
    assert_copied::<2, 8, 1>(&[]);
    assert_copied::<1, 4, 1>(&[]);
    assert_copied::<1, 4, 1>(&[network()]);
}

#[test]
fn what_does_not_fit_is_not_loaded() {
    let owned = OwnedTables::new();
    let loaded = |integers: usize, networks: &[Network<2, 8, 1>]| {
        owned.with(|tables| decoded(&Payload { tables: &tables, networks }, integers, |_| ()))
    };
    // A table over the opening at sensors 0 and 1; two maps of ten values at three sensors.
    let needed = 2 * 3 * KNOTS + 10 * (2 + 2 + 2);
    assert_eq!(loaded(needed - 1, &[]), None);
    assert_eq!(loaded(needed, &[]), Some(()));
    let five = array::from_fn::<_, 5, _>(|_| network());
    assert_eq!(loaded(needed, &five[..4]), Some(()));
    assert_eq!(loaded(needed, &five), None);
}

#[test]
fn a_scrub_step_checks_at_least_one_word() {
    struct ThreeWords;
    impl Encode for ThreeWords {
        const WORDS: usize = 3;
        fn visit(&self, window: &mut Window) {
            [0_u32, 1, 2].visit(window);
        }
    }
    impl Checksummed for ThreeWords {
        fn check(&self) -> u32 {
            checksum(self)
        }
    }
    let mut scrubber = Scrubber::NEW;
    let results = [(); 6].map(|()| scrubber.step(&ThreeWords));
    let [a, b, c] = [ScrubResult::Pending, ScrubResult::Pending, ScrubResult::Intact];
    assert_eq!(results, [a, b, c, a, b, c]);
}

/// The generated source agrees with the structs of which its checksum was computed.
#[cfg(target_os = "linux")]
#[test]
fn the_tables_of_this_build_are_intact() {
    use crate::model::tables::{NETWORKS, TABLES};
    assert!(TABLES.is_intact(), "export the tables again");
    for network in &NETWORKS {
        assert!(network.is_intact(), "export the tables again");
    }
}

#[test]
fn the_checksum_is_the_zlib_crc32_of_the_words() {
    // Python: zlib.crc32(struct.pack("<ii", 1, -2)).
    let scale = AxisScale { offset: 1, gain: -2 };
    assert_eq!(checksum(&scale), 0xCF8F_9871);
}

#[test]
fn a_window_of_one_word_covers_that_word() {
    // Number 1, axes 1, scale 6, limit 1, linear 8, pairs 50 * 10, used 1, shift 2, parity 1 + 28 + 1.
    let sensor = sensor(3);
    assert_eq!((word_count(&sensor), SensorTable::WORDS), (550, 550));
    for (skip, word) in [
        (0, Some(3)),
        (1, Some(sensor.axes.0.into())),
        (2, Some(sensor.scale[0].offset as u32)),
        (549, Some(sensor.parity.sigma as u32)),
        (550, None),
    ] {
        let mut seen = Vec::new();
        visit(&sensor, &mut Window::new(skip, 1, &mut |word, _| seen.push(word)));
        assert_eq!(seen, Vec::from_iter(word), "{skip}");
    }
}

#[test]
fn consecutive_windows_give_the_checksum_of_the_whole() {
    OwnedTables::new().with(|tables| {
        let words = word_count(&tables);
        for count in [1, 7, 550, 1000, words] {
            let mut digest = CRC32.digest();
            for from in (0..words).step_by(count) {
                digest = update(&tables, from, count, digest);
            }
            assert_eq!(digest.finalize(), checksum(&tables), "{count}");
        }
    });
}

use super::memory::{Cut, Memory, PAGES, Torn, now};
use super::record::{decode, encode, encode_as};
use super::*;
use crate::parameters::table::{TABLE, id};
use crate::units::Force;

/// Parameters that differ from those of any other number in every tare and in the time-out.
fn parameters(number: u32) -> Parameters {
    let mut all = Parameters::DEFAULT;
    let number = number as i32;
    all.set(id::COMMAND_TIMEOUT, 20 + number % 400).unwrap();
    let mut tare = all.tare();
    for (place, force) in (1_i32..).zip(tare.0.as_flattened_mut()) {
        *force = Force(if place % 2 == 0 { 1 } else { -1 } * (1000 * number + place) % 256_000);
    }
    all.set_tare(&tare);
    all
}

fn store(memory: &mut Memory) -> Store<&mut Memory> {
    Store::new(memory, 0)
}

fn load(memory: &mut Memory) -> Loaded {
    now(store(memory).load())
}

fn save(memory: &mut Memory, parameters: &Parameters) -> Result<(), NotSaved> {
    now(store(memory).save(parameters))
}

/// A memory after so many saves, numbered from one.
fn saved(saves: u32) -> Memory {
    let mut memory = Memory::new(u64::from(saves));
    for number in 1..=saves {
        save(&mut memory, &parameters(number)).unwrap();
    }
    memory
}

/// Every way in which an operation may end when the power goes.
const CUTS: [Cut; 10] = [
    Cut::Before,
    Cut::After,
    Cut::Half(true),
    Cut::Half(false),
    Cut::Torn(Torn::Erased),
    Cut::Torn(Torn::Right),
    Cut::Torn(Torn::Mixed(0x0123_4567_89AB_CDEF)),
    Cut::Torn(Torn::Mixed(0xFFFF_FFFF_0000_0000)),
    Cut::Torn(Torn::Unreadable),
    Cut::Torn(Torn::Wavering),
];

/// Operations of one save.
fn operations(memory: &Memory, next: &Parameters) -> u32 {
    let mut memory = memory.clone();
    let before = memory.operations;
    save(&mut memory, next).unwrap();
    memory.operations - before
}

/// Saves with a cut in the operation of this number; the power is back afterwards.
fn cut_short(memory: &mut Memory, next: &Parameters, operation: u32, cut: Cut) {
    memory.cut = Some((memory.operations + operation, cut));
    assert_eq!(save(memory, next), Err(NotSaved));
    memory.power_on();
}

/// A start: old or new, the same at every start that follows, and the next save counts.
fn starts_with_either(memory: &mut Memory, [old, new]: [Parameters; 2], case: &str) {
    let loaded = load(memory);
    let found = loaded.parameters;
    assert!(found == old || found == new, "{case}: a third state");
    if !loaded.is_settled {
        assert_eq!(save(memory, &found), Ok(()), "{case}");
    }
    for _ in 0..4 {
        let again = load(memory);
        assert_eq!(again.parameters, found, "{case}: it did not stay");
    }
    let next = parameters(999);
    assert_eq!(save(memory, &next), Ok(()), "{case}");
    let last = load(memory);
    assert_eq!(last.parameters, next, "{case}");
    assert!(last.is_settled, "{case}");
}

#[test]
fn a_cut_at_every_write_and_erasure_leaves_old_or_new_and_never_a_third() {
    let mut cases = 0;
    // The first page, its end, and the round after, where pages hold older records.
    for saves in (0..3).chain(6..10).chain(30..42) {
        let memory = saved(saves);
        let old = load(&mut memory.clone()).parameters;
        let new = parameters(saves + 1);
        for operation in 0..operations(&memory, &new) {
            for cut in CUTS {
                let mut memory = memory.clone();
                cut_short(&mut memory, &new, operation, cut);
                let case = std::format!("after {saves} saves, operation {operation}, {cut:?}");
                starts_with_either(&mut memory, [old, new], &case);
                cases += 1;
            }
        }
    }
    assert!(cases > 1500, "{cases}");
}

#[test]
fn a_second_cut_while_the_first_is_mended_leaves_old_or_new_too() {
    for saves in [5, 7, 8, 39, 40] {
        let memory = saved(saves);
        let (old, new) = (parameters(saves), parameters(saves + 1));
        for operation in 0..operations(&memory, &new) {
            for first in [Cut::Half(false), Cut::Torn(Torn::Wavering)] {
                let mut torn = memory.clone();
                cut_short(&mut torn, &new, operation, first);
                let loaded = load(&mut torn);
                if loaded.is_settled {
                    continue;
                }
                for second in 0..operations(&torn, &loaded.parameters) {
                    for cut in CUTS {
                        let mut torn = torn.clone();
                        torn.cut = Some((torn.operations + second, cut));
                        // A word that wavers may have let the save take another way, past the cut.
                        let _ = save(&mut torn, &loaded.parameters);
                        torn.power_on();
                        let case = std::format!("{saves}: {operation} {first:?}, {second} {cut:?}");
                        starts_with_either(&mut torn, [old, new], &case);
                    }
                }
            }
        }
    }
}

#[test]
fn ten_thousand_saves_erase_no_page_more_than_313_times() {
    let memory = saved(10_000);
    assert_eq!(memory.erasures, [313, 313, 312, 312]);
    assert_eq!(load(&mut memory.clone()).parameters, parameters(10_000));
}

#[test]
fn where_nothing_was_saved_the_defaults_hold_and_it_is_said_so() {
    let expected = Loaded {
        parameters: Parameters::DEFAULT,
        origin: Origin::Empty,
        is_settled: true,
    };
    assert_eq!(load(&mut Memory::new(0)), expected);
}

#[test]
fn any_bit_of_a_record_that_turns_gives_the_record_before() {
    let memory = saved(2);
    let (_, used) = encode(1, &parameters(2));
    for byte in 0..used {
        for bit in 0..8 {
            let mut memory = memory.clone();
            memory.flip(SLOT + byte, bit);
            let loaded = load(&mut memory);
            assert_eq!(loaded.parameters, parameters(1), "byte {byte}, bit {bit}");
            assert!(!loaded.is_settled);
        }
    }
    let mut only = saved(1);
    only.flip(9, 0);
    let loaded = load(&mut only);
    assert_eq!(loaded.origin, Origin::Spoilt);
    assert_eq!(loaded.parameters, Parameters::DEFAULT);
}

#[test]
fn an_older_record_keeps_what_it_knows_and_a_newer_one_is_refused() {
    let written = |version, pairs: &[(u16, i32)]| {
        let mut memory = saved(3);
        let (body, _) = encode_as(version, 3, pairs.iter().copied());
        now(memory.write(3 * SLOT as u32, &body)).unwrap();
        now(memory.write((3 * SLOT + BODY) as u32, &END)).unwrap();
        load(&mut memory)
    };
    // Known, out of its range of today, and known no more.
    let pairs = [(id::NODE, 17), (id::FORCE_RATE, 123), (0xFFF0, -1)];
    let older = written(VERSION - 1, &pairs);
    let mut expected = Parameters::DEFAULT;
    expected.set(id::NODE, 17).unwrap();
    assert_eq!((older.parameters, older.origin), (expected, Origin::Older));
    let newer = written(VERSION + 1, &pairs);
    assert_eq!(newer.parameters, Parameters::DEFAULT);
    assert_eq!(newer.origin, Origin::Newer);
    // Nothing is written over it unasked.
    assert!(older.is_settled && newer.is_settled);
}

#[test]
fn the_greatest_record_fits_its_slot_and_comes_back() {
    let mut all = Parameters::DEFAULT;
    for row in TABLE {
        let widest = [i32::from(u8::MAX), 500, 256_000, 0x77, 0x3F, 2, 1];
        let _ = widest.iter().find(|value| all.set(row.id, **value).is_ok());
    }
    let (body, used) = encode(u32::MAX, &all);
    assert!(used <= BODY);
    let record = decode(&body).unwrap();
    assert_eq!(
        (record.sequence, record.parameters()),
        (u32::MAX, all),
        "{used}"
    );
}

#[test]
fn a_page_that_cannot_be_erased_any_more_is_passed_over() {
    for worn in 0..PAGES {
        let mut memory = saved(40);
        memory.worn[worn] = true;
        for number in 41..150 {
            assert_eq!(save(&mut memory, &parameters(number)), Ok(()), "{number}");
            assert_eq!(load(&mut memory).parameters, parameters(number));
        }
    }
}

#[test]
fn where_no_other_page_can_be_erased_the_newest_record_stays_and_nothing_is_saved() {
    // The newest stands in the last slot of the first page.
    let mut memory = saved(40);
    memory.worn = [false, true, true, true];
    assert_eq!(save(&mut memory, &parameters(41)), Err(NotSaved));
    assert_eq!(load(&mut memory).parameters, parameters(40));
}

#[test]
fn a_memory_that_refuses_keeps_what_was_saved_before() {
    let mut memory = saved(8);
    memory.cut = Some((memory.operations, Cut::Before));
    assert_eq!(save(&mut memory, &parameters(9)), Err(NotSaved));
    memory.power_on();
    assert_eq!(load(&mut memory).parameters, parameters(8));
}

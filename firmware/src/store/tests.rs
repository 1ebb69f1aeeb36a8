use std::vec::Vec;

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

/// A start.
fn store(memory: &mut Memory) -> Store<&mut Memory> {
    memory.power_on();
    Store::new(memory, 0)
}

fn load(memory: &mut Memory) -> Loaded {
    now(store(memory).load())
}

/// The first save after a start.
fn save(memory: &mut Memory, parameters: &Parameters) -> Result<(), NotSaved> {
    now(store(memory).save(parameters))
}

/// Saves these without a start between them.
fn saves(memory: &mut Memory, all: &[Parameters]) {
    let mut store = store(memory);
    for next in all {
        now(store.save(next)).unwrap();
    }
}

/// A memory after so many saves without a start between them, numbered from one.
fn saved(count: u32) -> Memory {
    let mut memory = Memory::new(u64::from(count));
    saves(
        &mut memory,
        &(1..=count).map(parameters).collect::<Vec<_>>(),
    );
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

/// Operations of some work.
fn operations(memory: &Memory, work: impl Fn(&mut Memory)) -> u32 {
    let mut memory = memory.clone();
    let before = memory.operations;
    work(&mut memory);
    memory.operations - before
}

/// Saves these one behind the other; whether the power went in the operation of this number.
fn cut_short(memory: &mut Memory, (operation, cut): (u32, Cut), all: &[Parameters]) -> bool {
    let mut store = store(memory);
    store.flash.cut = Some((store.flash.operations + operation, cut));
    let is_saved = all.iter().all(|next| now(store.save(next)).is_ok());
    assert_eq!(is_saved, !memory.is_off());
    !is_saved
}

/// A start, what is not settled saved again, and four more: found is what may be found, it stays, and the
/// next save counts.
fn starts_with_one_of(memory: &mut Memory, possible: &[Parameters], case: &str) {
    let loaded = load(memory);
    let found = loaded.parameters;
    assert!(possible.contains(&found), "{case}: a third state");
    if !loaded.is_settled {
        assert_eq!(save(memory, &found), Ok(()), "{case}");
    }
    for _ in 0..4 {
        let again = load(memory);
        assert_eq!(again.parameters, found, "{case}: it did not stay");
    }
    let next = parameters(399);
    assert_eq!(save(memory, &next), Ok(()), "{case}");
    for _ in 0..4 {
        let last = load(memory);
        assert_eq!(last.parameters, next, "{case}: a save was lost");
        assert!(last.is_settled, "{case}");
    }
    let rewritten = memory.rewritten;
    assert_eq!(
        rewritten, 0,
        "{case}: nobody knows whether these words hold"
    );
}

#[test]
fn a_cut_at_every_write_and_erasure_leaves_old_or_new_and_never_a_third() {
    let mut cases = 0;
    // The first page, its end, and the round after, where pages hold older records.
    for count in (0..3).chain(6..10).chain(30..42) {
        let old = load(&mut saved(count)).parameters;
        let new = parameters(count + 1);
        // The first save after a start, and one that follows others.
        for before in [0, count] {
            let memory = saved(count - before);
            let all: Vec<_> = (count - before + 1..=count + 1).map(parameters).collect();
            let others = operations(&memory, |memory| saves(memory, &all[..all.len() - 1]));
            let end = operations(&memory, |memory| saves(memory, &all));
            for operation in others..end {
                for cut in CUTS {
                    let mut memory = memory.clone();
                    assert!(cut_short(&mut memory, (operation, cut), &all));
                    let case = std::format!("{before} and {count}, operation {operation}, {cut:?}");
                    starts_with_one_of(&mut memory, &[old, new], &case);
                    cases += 1;
                }
            }
        }
    }
    assert!(cases > 4000, "{cases}");
}

#[test]
fn a_second_cut_leaves_what_was_there_or_was_begun_whatever_is_saved_after_the_first() {
    let (mut cases, other) = (0, parameters(398));
    for count in [0, 7, 39] {
        let memory = saved(count);
        let (old, new) = (load(&mut memory.clone()).parameters, parameters(count + 1));
        let all = operations(&memory, |memory| save(memory, &new).unwrap());
        for (operation, first) in (0..all).flat_map(|at| CUTS.map(|cut| (at, cut))) {
            let mut torn = memory.clone();
            assert!(cut_short(&mut torn, (operation, first), &[new]));
            let loaded = load(&mut torn);
            let found = loaded.parameters;
            let mut mended = torn.clone();
            if !loaded.is_settled {
                save(&mut mended, &found).unwrap();
            }
            // What is not settled is saved as it is: the power goes meanwhile, or in the save after it.
            for (memory, next, known) in
                [(torn, found, [old, new]), (mended, other, [found, other])]
            {
                if loaded.is_settled && next == found {
                    continue;
                }
                for second in (0..all).flat_map(|at| CUTS.map(|cut| (at, cut))) {
                    let mut memory = memory.clone();
                    let is_off = cut_short(&mut memory, second, &[next]);
                    let known = if is_off { &known[..] } else { &[next] };
                    let case = std::format!("{count}: {operation} {first:?}, {second:?}");
                    starts_with_one_of(&mut memory, known, &case);
                    cases += 1;
                }
            }
        }
    }
    assert!(cases > 50_000, "{cases}");
}

#[test]
fn cut_after_cut_in_a_mark_the_one_record_that_counts_for_sure_is_not_erased() {
    let known = parameters(1);
    let first = operations(&Memory::new(0), |memory| save(memory, &known).unwrap());
    let mut refused = 0;
    for seed in 0..400 {
        let mut memory = Memory::new(seed);
        // In its second mark, then again and again in the first of what is saved as it is.
        for operation in [first - 1].into_iter().chain([first - 2; 12]) {
            let mut store = store(&mut memory);
            let cut = Cut::Torn(Torn::Wavering);
            store.flash.cut = Some((store.flash.operations + operation, cut));
            let saved = now(store.save(&known));
            // Without a page that may be erased nothing is done, so nothing is cut short.
            refused += u32::from(saved.is_err() && !memory.is_off());
            assert_eq!(load(&mut memory).parameters, known, "{seed}");
        }
    }
    std::println!("refused: {refused} of 5200");
    assert!((1..1000).contains(&refused), "{refused}");
}

#[test]
fn ten_thousand_saves_erase_no_page_more_than_313_times() {
    let mut memory = saved(10_000);
    assert_eq!(memory.erasures, [313, 313, 312, 312]);
    assert_eq!(load(&mut memory).parameters, parameters(10_000));
}

#[test]
fn ten_thousand_starts_with_a_save_each_erase_no_page_more_than_2500_times() {
    let mut memory = Memory::new(0);
    for number in 1..=10_000 {
        save(&mut memory, &parameters(number)).unwrap();
    }
    assert_eq!(memory.erasures, [2500; PAGES]);
    assert_eq!(load(&mut memory).parameters, parameters(10_000));
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
        let marks = [WRITTEN, END].concat();
        now(memory.write((3 * SLOT + BODY) as u32, &marks)).unwrap();
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
    assert!(cut_short(&mut memory, (0, Cut::Before), &[parameters(9)]));
    assert_eq!(load(&mut memory).parameters, parameters(8));
}

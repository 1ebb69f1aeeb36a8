use std::vec::Vec;

use super::*;
use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};

use crate::fixed_point::Force;
use crate::parameters::schema::{PARAMETERS, id};
use crate::protocol::authentication::Key;
use crate::system::nv_storage::flash_model::{Cut, FlashModel, PAGE, PAGES, Torn, block};
use crate::system::nv_storage::record::{KEY, decode, encode, encode_as};

/// Parameters unique to this number in every tare and in the time-out.
fn parameters(number: u32) -> Parameters {
    let mut all = Parameters::DEFAULT;
    let number = number as i32;
    all.set(id::COMMAND_TIMEOUT, 20 + number % 400).unwrap();
    let mut tare = all.tare();
    for (index, force) in (1_i32..).zip(tare.0.as_flattened_mut()) {
        *force = Force(if index % 2 == 0 { 1 } else { -1 } * (1000 * number + index) % 256_000);
    }
    all.set_tare(&tare);
    all
}

/// The store after a boot.
fn store(flash: &mut FlashModel) -> ParameterStore<&mut FlashModel> {
    flash.power_on();
    ParameterStore::new(flash, 0)
}

fn load(flash: &mut FlashModel) -> LoadedParameters {
    block(store(flash).load())
}

/// The first save after a boot.
fn save(flash: &mut FlashModel, parameters: &Parameters) -> Result<(), SaveError> {
    block(store(flash).save(parameters))
}

/// Saves these without a reboot in between.
fn saves(flash: &mut FlashModel, all: &[Parameters]) {
    let mut store = store(flash);
    for next in all {
        block(store.save(next)).unwrap();
    }
}

/// A boot as [`crate::tasks::host_service`] does it: unsettled values are saved again.
fn boot(flash: &mut FlashModel) -> LoadedParameters {
    let mut store = store(flash);
    let loaded = block(store.load());
    if !loaded.is_settled {
        let _ = block(store.save(&loaded.parameters));
    }
    loaded
}

/// A flash after `count` saves without a reboot in between, numbered from one.
fn saved(count: u32) -> FlashModel {
    let mut flash = FlashModel::new(u64::from(count));
    saves(&mut flash, &(1..=count).map(parameters).collect::<Vec<_>>());
    flash
}

/// All effects of a power cut on an operation.
const CUTS: [Cut; 10] = [
    Cut::Before,
    Cut::After,
    Cut::Half(true),
    Cut::Half(false),
    Cut::Torn(Torn::Erased),
    Cut::Torn(Torn::Intended),
    Cut::Torn(Torn::Mixed(0x0123_4567_89AB_CDEF)),
    Cut::Torn(Torn::Mixed(0xFFFF_FFFF_0000_0000)),
    Cut::Torn(Torn::Unreadable),
    Cut::Torn(Torn::Varying),
];

/// Count of flash operations of `work`.
fn operations(flash: &FlashModel, work: impl Fn(&mut FlashModel)) -> u32 {
    let mut flash = flash.clone();
    let before = flash.operations;
    work(&mut flash);
    flash.operations - before
}

/// Saves these in order with a power cut in the given operation; whether it was reached.
fn save_with_cut(flash: &mut FlashModel, (operation, cut): (u32, Cut), all: &[Parameters]) -> bool {
    let mut store = store(flash);
    store.flash.cut = Some((store.flash.operations + operation, cut));
    let is_saved = all.iter().all(|next| block(store.save(next)).is_ok());
    // One of two records may have been written.
    assert!(is_saved || flash.is_off());
    flash.is_off()
}

/// Boots, saves unsettled values again, and boots four more times: the loaded values are possible and stay, and the next
/// save succeeds.
fn check_loads_one_of(flash: &mut FlashModel, possible: &[Parameters], case: &str) {
    let loaded = load(flash);
    let found = loaded.parameters;
    assert!(possible.contains(&found), "{case}: neither old nor new");
    if !loaded.is_settled {
        assert_eq!(save(flash, &found), Ok(()), "{case}");
    }
    for _ in 0..4 {
        let again = load(flash);
        assert_eq!(again.parameters, found, "{case}: values changed");
    }
    let next = parameters(399);
    assert_eq!(save(flash, &next), Ok(()), "{case}");
    // What a cut has left next to the new values may read as a record or not, until the save of one more boot replaces it.
    let is_unsettled = |_: &u32| {
        let last = boot(flash);
        assert_eq!(last.parameters, next, "{case}: save lost");
        !last.is_settled
    };
    let unsettled = (0..4).filter(is_unsettled).count();
    assert!(unsettled <= 1, "{case}: {unsettled} boots");
    let rewritten = flash.rewritten;
    assert_eq!(rewritten, 0, "{case}: writes to torn words");
}

#[test]
fn power_cut_in_any_operation_leaves_old_or_new_values() {
    let mut cases = 0;
    // First page, its end, and the next round, in which pages have older records.
    for count in (0..3).chain(6..10).chain(30..42) {
        let old = load(&mut saved(count)).parameters;
        let new = parameters(count + 1);
        // First save after a boot, and one that follows others.
        for before in [0, count] {
            let flash = saved(count - before);
            let all: Vec<_> = (count - before + 1..=count + 1).map(parameters).collect();
            let others = operations(&flash, |flash| saves(flash, &all[..all.len() - 1]));
            let end = operations(&flash, |flash| saves(flash, &all));
            for operation in others..end {
                for cut in CUTS {
                    let mut flash = flash.clone();
                    assert!(save_with_cut(&mut flash, (operation, cut), &all));
                    let case = std::format!("{before} and {count}, operation {operation}, {cut:?}");
                    check_loads_one_of(&mut flash, &[old, new], &case);
                    cases += 1;
                }
            }
        }
    }
    assert!(cases > 4000, "{cases}");
}

#[test]
fn second_power_cut_leaves_old_or_new_values() {
    let (mut cases, other) = (0, parameters(398));
    for count in [0, 7, 39] {
        let flash = saved(count);
        let (old, new) = (load(&mut flash.clone()).parameters, parameters(count + 1));
        let all = operations(&flash, |flash| save(flash, &new).unwrap());
        let pairs = || (0..all).flat_map(|at| CUTS.map(|cut| (at, cut)));
        for (index, (operation, first)) in pairs().enumerate() {
            let mut torn = flash.clone();
            assert!(save_with_cut(&mut torn, (operation, first), &[new]));
            let loaded = load(&mut torn);
            let found = loaded.parameters;
            let mut settled = torn.clone();
            if !loaded.is_settled {
                save(&mut settled, &found).unwrap();
            }
            // Unsettled values are saved again: a cut in that save, or in the next one.
            for (flash, next, possible) in
                [(torn, found, [old, new]), (settled, other, [found, other])]
            {
                if loaded.is_settled && next == found {
                    continue;
                }
                // Every 13th, another one for each first cut: all operations with all kinds, within 13 first cuts.
                for second in pairs().skip(index % 13).step_by(13) {
                    let mut flash = flash.clone();
                    let is_off = save_with_cut(&mut flash, second, &[next]);
                    let possible = if is_off { &possible[..] } else { &[next] };
                    let case = std::format!("{count}: {operation} {first:?}, {second:?}");
                    check_loads_one_of(&mut flash, possible, &case);
                    cases += 1;
                }
            }
        }
    }
    assert!(cases > 12_000, "{cases}");
}

#[test]
fn repeated_cuts_in_marks_never_erase_the_valid_record() {
    let possible = parameters(1);
    let first = operations(&FlashModel::new(0), |flash| save(flash, &possible).unwrap());
    // An erasure, then two records of as many operations.
    let second_mark = (first - 1) / 2;
    let mut refused = 0;
    for seed in 0..400 {
        let mut flash = FlashModel::new(seed);
        // A cut in the second mark, then repeated cuts in the first mark of the next saves.
        for operation in [second_mark].into_iter().chain([second_mark - 1; 12]) {
            let mut store = store(&mut flash);
            let cut = Cut::Torn(Torn::Varying);
            store.flash.cut = Some((store.flash.operations + operation, cut));
            let saved = block(store.save(&possible));
            // Without an erasable page there is no operation to interrupt.
            refused += u32::from(saved.is_err() && !flash.is_off());
            assert_eq!(load(&mut flash).parameters, possible, "{seed}");
        }
    }
    std::println!("refused: {refused} of 5200");
    assert!((1..1000).contains(&refused), "{refused}");
}

#[test]
fn saves_10000_erase_a_page_625_times() {
    let mut flash = saved(10_000);
    assert_eq!(flash.erasures, [625; PAGES]);
    assert_eq!(load(&mut flash).parameters, parameters(10_000));
}

#[test]
fn boots_10000_with_save_erase_a_page_2500_times() {
    let mut flash = FlashModel::new(0);
    for number in 1..=10_000 {
        save(&mut flash, &parameters(number)).unwrap();
    }
    assert_eq!(flash.erasures, [2500; PAGES]);
    assert_eq!(load(&mut flash).parameters, parameters(10_000));
}

#[test]
fn empty_flash_loads_defaults_with_origin_empty() {
    let expected = LoadedParameters {
        parameters: Parameters::DEFAULT,
        key: Key::NONE,
        origin: ParameterOrigin::Empty,
        is_settled: true,
    };
    assert_eq!(load(&mut FlashModel::new(0)), expected);
}

#[test]
fn origins_have_the_details_of_the_protocol() {
    use ParameterOrigin::{Corrupt, Empty, Newer, Older, Previous, Stored};
    let all = [Stored, Older, Newer, Empty, Corrupt, Previous];
    assert_eq!(all.map(ParameterOrigin::code), [0, 1, 2, 3, 4, 5]);
    assert_eq!(all.map(ParameterOrigin::is_doubtful), [false, false, false, false, true, true]);
}

/// As a flash with another division would have it.
#[test]
fn record_in_another_slot_does_not_count() {
    let flash = saved(1);
    let mut moved = FlashModel::new(2);
    let mut slot = [0; SLOT_BYTES];
    block(flash.clone().read(0, &mut slot)).unwrap();
    block(moved.write(5 * SLOT_BYTES as u32, &slot)).unwrap();
    let loaded = load(&mut moved);
    assert_eq!((loaded.parameters, loaded.origin), (Parameters::DEFAULT, ParameterOrigin::Corrupt));
}

/// The key before the last save, and the last one.
const KEYS: [Key; 2] = [Key(*b"the revoked keyy"), Key(*b"the present key.")];

/// A flash after `count` saves with the first key, of which some are followed by a boot, and one of the second.
fn with_keys(count: u32, boots: u32) -> FlashModel {
    let mut flash = FlashModel::new(u64::from(count));
    for number in 1..=boots {
        save(&mut flash, &parameters(number)).unwrap();
    }
    let mut store = store(&mut flash);
    block(store.load());
    block(store.save_key(KEYS[0])).unwrap();
    for number in 1..=count {
        block(store.save(&parameters(number))).unwrap();
    }
    block(store.save_key(KEYS[1])).unwrap();
    flash
}

/// Boots twice: the present key counts, or the fault stays.
fn check_not_silent(flash: &mut FlashModel, case: &str) -> ParameterOrigin {
    let [first, second] = [0; 2].map(|_| boot(flash));
    for loaded in [first, second] {
        assert!(loaded.key == KEYS[1] || loaded.origin.is_doubtful(), "{case}: {loaded:?}");
    }
    assert_eq!(first.origin.is_doubtful(), second.origin.is_doubtful(), "{case}");
    first.origin
}

#[test]
fn flip_of_any_bit_loses_no_key() {
    // In the middle of a page, over its end, in the next round, and one save a boot.
    let mut cases = 0;
    for (count, boots) in [(0, 0), (3, 0), (16, 0), (2, 5)] {
        let flash = with_keys(count, boots);
        let expected = load(&mut flash.clone()).parameters;
        for at in 0..8 * PAGES * PAGE {
            let mut flash = flash.clone();
            flash.flip(at / 8, at % 8);
            let case = std::format!("{count} {boots}, bit {at}");
            assert_eq!(check_not_silent(&mut flash, &case), ParameterOrigin::Stored, "{case}");
            assert_eq!(load(&mut flash).parameters, expected, "{case}");
            cases += 1;
        }
    }
    assert_eq!(cases, 262_144);
}

#[test]
fn flips_of_both_records_are_no_older_key() {
    for (count, boots) in [(0, 0), (3, 0), (16, 0), (2, 5)] {
        let flash = with_keys(count, boots);
        let last = block(ParameterStore::new(flash.clone(), 0).scan()).last.unwrap();
        let slots = 32;
        let slot = |sequence: u32| (sequence % slots) as usize * SLOT_BYTES;
        // Of a word in each record: a bit, or all of it, over the whole record.
        for (first, second) in (0..BODY_BYTES).flat_map(|at| [(at, at), (at, 0), (0, at)]) {
            for is_unreadable in [false, true] {
                let mut flash = flash.clone();
                for at in [slot(last - 1) + first, slot(last) + second] {
                    if is_unreadable { flash.damage(at) } else { flash.flip(at, 3) }
                }
                let case = std::format!("{count} {boots}, {first} {second}, {is_unreadable}");
                check_not_silent(&mut flash, &case);
            }
        }
    }
}

#[test]
fn doubtful_store_stays_so_until_somebody_saves() {
    let mut flash = with_keys(0, 0);
    for slot in [2, 3] {
        flash.flip(slot * SLOT_BYTES + 9, 0);
    }
    for _ in 0..4 {
        let loaded = boot(&mut flash);
        let expected = (ParameterOrigin::Previous, KEYS[0], true);
        assert_eq!((loaded.origin, loaded.key, loaded.is_settled), expected);
    }
    for slot in [0, 1] {
        flash.flip(slot * SLOT_BYTES + 9, 0);
    }
    for _ in 0..4 {
        let loaded = boot(&mut flash);
        assert_eq!((loaded.origin, loaded.key), (ParameterOrigin::Corrupt, Key::NONE));
        assert_eq!(loaded.parameters, Parameters::DEFAULT);
    }
    let mut accepted = store(&mut flash);
    block(accepted.load());
    block(accepted.save_key(KEYS[1])).unwrap();
    let loaded = boot(&mut flash);
    assert_eq!((loaded.origin, loaded.key), (ParameterOrigin::Stored, KEYS[1]));
}

/// In each operation of a new key's save, and over boots: the old key counts only if the save was not done.
#[test]
fn power_cut_in_a_save_of_a_key_is_no_fault() {
    let mut cases = 0;
    for (count, boots) in [(0, 0), (3, 0), (16, 0), (2, 5)] {
        let flash = with_keys(count, boots);
        let replace = |flash: &mut FlashModel| {
            let mut store = store(flash);
            block(store.load());
            block(store.save_key(KEYS[0]))
        };
        for operation in 0..operations(&flash, |flash| replace(flash).unwrap()) {
            for cut in CUTS {
                let mut flash = flash.clone();
                let mut store = store(&mut flash);
                block(store.load());
                store.flash.cut = Some((store.flash.operations + operation, cut));
                let _ = block(store.save_key(KEYS[0]));
                assert!(flash.is_off());
                let found = boot(&mut flash);
                let case = std::format!("{count} {boots}, {operation}, {cut:?}");
                assert_eq!(found.origin, ParameterOrigin::Stored, "{case}");
                assert!(KEYS.contains(&found.key), "{case}");
                for _ in 0..4 {
                    let again = boot(&mut flash);
                    assert_eq!((again.key, again.origin), (found.key, found.origin), "{case}");
                }
                cases += 1;
            }
        }
    }
    assert!(cases > 1000, "{cases}");
}

#[test]
fn store_of_earlier_firmware_keeps_its_key_and_is_written_twice() {
    let mut flash = FlashModel::new(1);
    let parts = KEYS[1].0.as_chunks::<4>().0.iter().map(|part| i32::from_le_bytes(*part));
    let pairs: Vec<_> = parameters(1).all().chain((KEY..).zip(parts)).collect();
    let (body, _) = encode_as(VERSION, 0, pairs.into_iter());
    block(flash.write(0, &body)).unwrap();
    block(flash.write(BODY_BYTES as u32, &[FIRST_MARK, SECOND_MARK].concat())).unwrap();
    let loaded = boot(&mut flash);
    assert_eq!((loaded.origin, loaded.key), (ParameterOrigin::Stored, KEYS[1]));
    assert!(!loaded.is_settled);
    let loaded = boot(&mut flash);
    assert!(loaded.is_settled && (loaded.key, loaded.parameters) == (KEYS[1], parameters(1)));
}

#[test]
fn key_stays_over_saves_of_parameters_and_its_own_saves_keep_them() {
    let mut flash = saved(1);
    let key = Key(*b"\x80\xFFkey of 14 byte");
    let mut store = store(&mut flash);
    block(store.load());
    block(store.save_key(key)).unwrap();
    block(store.save(&parameters(2))).unwrap();
    let loaded = load(&mut flash);
    assert_eq!((loaded.key, loaded.parameters), (key, parameters(2)));
    save(&mut flash, &parameters(3)).unwrap();
    let mut again = self::store(&mut flash);
    assert_eq!(block(again.load()).key, Key::NONE);
}

#[test]
fn older_version_is_migrated_and_newer_is_ignored() {
    let written = |version, pairs: &[(u16, i32)]| {
        let mut flash = saved(1);
        let (body, _) = encode_as(version, 2, pairs.iter().copied());
        block(flash.write(2 * SLOT_BYTES as u32, &body)).unwrap();
        let marks = [FIRST_MARK, SECOND_MARK].concat();
        block(flash.write((2 * SLOT_BYTES + BODY_BYTES) as u32, &marks)).unwrap();
        load(&mut flash)
    };
    // Valid, out of range, and unknown.
    let pairs = [(id::NODE, 17), (id::FORCE_RATE, 123), (0xFFF0, -1)];
    let older = written(VERSION - 1, &pairs);
    let mut expected = Parameters::DEFAULT;
    expected.set(id::NODE, 17).unwrap();
    assert_eq!((older.parameters, older.origin), (expected, ParameterOrigin::Older));
    let newer = written(VERSION + 1, &pairs);
    assert_eq!(newer.parameters, Parameters::DEFAULT);
    assert_eq!(newer.origin, ParameterOrigin::Newer);
    // Not overwritten without a request.
    assert!(older.is_settled && newer.is_settled);
}

#[test]
fn longest_record_fits_slot_and_round_trips() {
    let mut all = Parameters::DEFAULT;
    for row in PARAMETERS {
        let widest = [i32::from(u8::MAX), 500, 256_000, 0x77, 0x3F, 2, 1];
        let _ = widest.iter().find(|value| all.set(row.id, **value).is_ok());
    }
    let (body, used) = encode((u32::MAX, 7), &all, Key([0xFF; 16]));
    assert!(used <= BODY_BYTES);
    let record = decode(&body).unwrap();
    let found = (record.sequence, record.save, record.parameters());
    assert_eq!(found, (u32::MAX, 7, all), "{used}");
}

#[test]
fn worn_page_is_skipped() {
    for worn in 0..PAGES {
        let mut flash = saved(40);
        flash.worn[worn] = true;
        for number in 41..150 {
            assert_eq!(save(&mut flash, &parameters(number)), Ok(()), "{number}");
            assert_eq!(load(&mut flash).parameters, parameters(number));
        }
    }
}

#[test]
fn save_fails_without_erasable_page_and_keeps_record() {
    // The newest record is in the last slot of the first page.
    let mut flash = saved(20);
    flash.worn = [false, true, true, true];
    assert_eq!(save(&mut flash, &parameters(21)), Err(SaveError));
    assert_eq!(load(&mut flash).parameters, parameters(20));
}

#[test]
fn failing_flash_keeps_the_previous_record() {
    let mut flash = saved(8);
    assert!(save_with_cut(&mut flash, (0, Cut::Before), &[parameters(9)]));
    assert_eq!(load(&mut flash).parameters, parameters(8));
}

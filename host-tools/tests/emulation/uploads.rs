//! Calibrations that are uploaded to the image over its serial line, over power cuts at many moments.

use device::calibration_client;
use device::emulation::line::EmulatedLine;
use device::session::{Credentials, SessionSource, with_session};
use device::source::Source;
use device_run::networks::NetworkSet;
use emulator::Halt;
use emulator::peripherals::flash::{BASE, PowerCut, Remains};
use firmware::system::faults::Fault;
use firmware::system::nv_storage::calibration::SLOT_BYTES;
use libtest_mimic::{Failed, Trial};
use model_export::gru::network::Network;
use model_export::inverse::build::DeviceModel;
use model_export::inverse::calibration::{CalibrationDescription, encode_calibration};

use crate::Effort;
use crate::boards::{TYPICAL, WORST_TICK_US, board, image, violations};
use crate::images::{self, Variant};
use crate::motion::{Cell, cell};
use crate::replay::{assert_replays, recorded};

/// Longest upload with networks at four sensors, in seconds of the board.
const UPLOAD_S: f64 = 10.0;
/// Place of the calibrations in memory: `_calibrations` in `memory.x`.
const CALIBRATIONS: u32 = 0x0805_E000;
/// Longest start with an uploaded calibration.
const START_MS: u64 = 50;
/// Time until the tables have been checked after a boot.
const READY_S: f64 = 0.3;

pub fn trials(effort: Effort) -> Vec<Trial> {
    let cuts: u32 = if effort == Effort::Acceptance { 200 } else { 12 };
    let of_remains = [Remains::Half, Remains::Everything, Remains::Unreadable];
    let mut trials: Vec<Trial> = of_remains
        .into_iter()
        .map(|leaves| {
            let name = format!("uploads_power_cut_leaves_{leaves:?}");
            Trial::test(name, move || power_cuts(leaves, cuts.div_ceil(of_remains.len() as u32)))
        })
        .collect();
    trials.push(Trial::test("uploads_with_networks", with_networks));
    trials.push(Trial::test("uploads_damaged_in_flash", damaged));
    trials.push(Trial::test("uploads_pass_old_flash_errors", old_errors));
    trials
}

fn encoded(built: &DeviceModel, networks: &[Network], campaign: &str) -> Vec<u8> {
    let description = CalibrationDescription {
        campaign: campaign.to_owned(),
        ..CalibrationDescription::of(built, networks)
    };
    encode_calibration(built, networks, &description).expect("it fits the board")
}

/// Runs a client on the board's line.
fn on_line<T>(
    cell: &mut Cell,
    run: impl FnOnce(&mut dyn Source) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    let line = cell.board.connections.line.clone();
    run(&mut EmulatedLine::new(line, || cell.step()))
}

/// As [`on_line`] in a session.
fn in_session<T>(
    cell: &mut Cell,
    run: impl FnOnce(&mut SessionSource<'_>) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    on_line(cell, |line| with_session(line, Credentials::UNPROTECTED, run))
}

fn upload(cell: &mut Cell, bytes: &[u8]) -> anyhow::Result<u32> {
    in_session(cell, |session| calibration_client::upload(session, bytes, |_| ()))
}

/// Campaign of the running calibration; none for that of the image.
fn running(cell: &mut Cell) -> Result<Option<String>, Failed> {
    let running = on_line(cell, calibration_client::running)?;
    let description = running.description.filter(|_| running.slot.is_some());
    Ok(description.map(|description| description.campaign))
}

/// Networks and model of the sensors are uploaded while the board works; from then on it runs them, bit for bit.
fn with_networks() -> Result<(), Failed> {
    let made = images::get(Variant::Networks)?;
    let networks: &NetworkSet = made.networks.as_ref().ok_or("no networks")?;
    let bytes = encoded(&made.built, &networks.file.networks, "with networks");
    assert!(bytes.len() > 25_000 && bytes.len() < SLOT_BYTES as usize, "{}", bytes.len());
    let mut cell = cell(3.0)?;
    cell.run(READY_S);
    let begun_us = cell.time_us();
    upload(&mut cell, &bytes)?;
    let took_s = 1e-6 * (cell.time_us() - begun_us) as f64;
    let worst_us = cell.host.received.worst_tick_us;
    println!("{} bytes in {took_s:.2} s, worst tick {worst_us} us", bytes.len());
    assert!(took_s < UPLOAD_S, "{took_s}");
    assert!((1..WORST_TICK_US).contains(&worst_us), "{worst_us} us");
    let tables = made.built.chosen.tables.id;
    in_session(&mut cell, |session| calibration_client::reboot_into(session, tables))?;
    assert_eq!(running(&mut cell)?, Some("with networks".to_owned()));
    assert_eq!(violations(&cell.board), [""; 0]);
    let flash = cell.board.chip.soc.memory(CALIBRATIONS, 2 * SLOT_BYTES as usize);
    let flash = flash.ok_or("no flash")?.to_vec();
    let linked = image(Variant::Default)?;
    let mut board = board(&linked, TYPICAL, recorded(&made));
    board.chip.soc.load_flash((CALIBRATIONS - BASE) as usize, &flash);
    assert_replays(&made, board, START_MS)
}

/// A damaged calibration is reported, and the previous one runs.
fn damaged() -> Result<(), Failed> {
    let made = images::get(Variant::Clean)?;
    let mut cell = cell(40.0)?;
    cell.run(READY_S);
    for campaign in ["old", "new"] {
        upload(&mut cell, &encoded(&made.built, &[], campaign))?;
    }
    let place = CALIBRATIONS + SLOT_BYTES + 1000;
    let word = cell.board.chip.soc.memory(place, 8).ok_or("no flash")?;
    let changed: Vec<u8> = word.iter().map(|byte| byte ^ 1).collect();
    cell.board.chip.soc.load_flash((place - BASE) as usize, &changed);
    cell.board.chip.power_cycle()?;
    cell.host.received.faults.clear();
    cell.run(READY_S);
    assert_eq!(running(&mut cell)?.as_deref(), Some("old"));
    let faults: Vec<_> =
        cell.host.received.faults.iter().map(|(_, event)| (event.code, event.source)).collect();
    assert_eq!(faults, [(Fault::StoreUnsound as u16, 1)]);
    Ok(())
}

/// Errors that something else has left in the flash controller, each alone, prevent no upload.
fn old_errors() -> Result<(), Failed> {
    const PGSERR: u32 = 1 << 7;
    const PROGERR: u32 = 1 << 3;
    let made = images::get(Variant::Clean)?;
    let mut cell = cell(40.0)?;
    cell.run(READY_S);
    for (campaign, error) in [("sequence", PGSERR), ("program", PROGERR)] {
        cell.board.chip.soc.set_flash_errors(error);
        upload(&mut cell, &encoded(&made.built, &[], campaign))?;
    }
    assert_eq!(violations(&cell.board), [""; 0]);
    cell.board.chip.power_cycle()?;
    cell.run(READY_S);
    assert_eq!(running(&mut cell)?.as_deref(), Some("program"));
    Ok(())
}

/// After a power cut at any moment of an upload the board starts with the old or the new calibration.
fn power_cuts(leaves: Remains, count: u32) -> Result<(), Failed> {
    let made = images::get(Variant::Clean)?;
    let mut cell = cell(40.0)?;
    cell.run(READY_S);
    let [old, new] = ["old", "new"].map(|campaign| encoded(&made.built, &[], campaign));
    upload(&mut cell, &old)?;
    // Double words and pages of an upload, with its two marks.
    let operations = (new.len().div_ceil(8) + new.len().div_ceil(2048) + 2) as u32;
    let mut outcomes = [0; 2];
    for number in 0..count {
        // The last operations one by one, the others evenly.
        let last = count / 3;
        let after = match number.checked_sub(count - last) {
            Some(number) => operations - last + number,
            None => number * (operations - last) / (count - last),
        };
        cell.board.chip.soc.cut_power(PowerCut { after, leaves });
        let result = upload(&mut cell, &new);
        match result.as_ref().map_err(|error| error.downcast_ref()) {
            Err(Some(Halt::PowerLost)) => {}
            _ => return Err(format!("no cut after {after} operations: {result:?}").into()),
        }
        cell.board.chip.power_cycle()?;
        cell.run(READY_S);
        match running(&mut cell)?.as_deref() {
            Some("old") => outcomes[0] += 1,
            Some("new") => {
                outcomes[1] += 1;
                // From the same beginning again.
                upload(&mut cell, &old)?;
            }
            other => return Err(format!("after {after} operations: {other:?}").into()),
        }
    }
    println!("{leaves:?}: {count} cuts in {operations} operations, {outcomes:?} old and new");
    Ok(())
}

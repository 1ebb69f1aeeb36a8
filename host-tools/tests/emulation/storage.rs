//! Parameters and tare in flash, over a power cut at any operation of the flash memory.

use emulator::Halt;
use emulator::peripherals::flash::{PowerCut, Remains};
use firmware::grip::states::PowerState;
use firmware::parameters::op as parameter_op;
use firmware::parameters::schema::id;
use firmware::protocol::messages::ParamRequest;
use firmware::protocol::session::{op, status};
use firmware::system::faults::Fault;
use libtest_mimic::{Failed, Trial};

use crate::motion::{Cell, cell};

/// Rates of the force messages, before and after.
const RATES: [u32; 2] = [250, 500];
/// The checks of the tables have ended.
const READY_S: f64 = 0.2;
/// Longest save: two pages erased, and programmed.
const SAVE_S: f64 = 0.2;

pub fn trials() -> Vec<Trial> {
    [Remains::Half, Remains::Everything, Remains::Unreadable]
        .into_iter()
        .map(|leaves| {
            Trial::test(format!("storage_power_cut_leaves_{leaves:?}"), move || power_cuts(leaves))
        })
        .collect()
}

/// Reads a parameter or a counter.
pub fn read(cell: &mut Cell, id: u16) -> Result<u32, Failed> {
    cell.host.received.parameters.clear();
    cell.host.request_parameter(ParamRequest {
        op: parameter_op::READ,
        id,
        ..ParamRequest::default()
    });
    cell.until(0.1, |cell| !cell.host.received.parameters.is_empty());
    let (_, reply) = cell.host.received.parameters.first().ok_or("no answer")?;
    Ok(reply.value)
}

fn write_rate(cell: &mut Cell, value: u32) {
    let (op, id) = (parameter_op::WRITE, id::FORCE_RATE);
    cell.host.request_parameter(ParamRequest { op, id, value, ..ParamRequest::default() });
}

/// Sets the rate and takes the present forces as zero, without saving.
fn change(cell: &mut Cell, rate: u32) -> Result<(), Failed> {
    write_rate(cell, rate);
    serve(cell, op::TARE)?;
    assert_eq!(read(cell, id::FORCE_RATE)?, rate);
    Ok(())
}

fn serve(cell: &mut Cell, op: u8) -> Result<(), Failed> {
    cell.host.received.replies.clear();
    cell.host.service(op, 0);
    let answered = cell.until(2.0, |cell| !cell.host.received.replies.is_empty());
    let reply = cell.host.received.replies.first().map(|(_, reply)| *reply);
    match (answered, reply) {
        (Some(_), Some(reply)) if (reply.op, reply.status) == (op, status::DONE) => Ok(()),
        _ => Err(format!("service {op}: {reply:?}").into()),
    }
}

/// After any cut the board starts with what was saved before, or with what was being saved, and with nothing else.
fn power_cuts(leaves: Remains) -> Result<(), Failed> {
    let mut cell = cell(40.0)?;
    cell.run(READY_S);
    change(&mut cell, RATES[0])?;
    serve(&mut cell, op::SAVE)?;
    let tare = read(&mut cell, id::TARE)?;
    let mut outcomes = [0; 2];
    for after in 0.. {
        change(&mut cell, RATES[1])?;
        let changed_tare = read(&mut cell, id::TARE)?;
        cell.board.chip.soc.cut_power(PowerCut { after, leaves });
        cell.host.service(op::SAVE, 0);
        let end_us = cell.time_us() + (1e6 * SAVE_S) as u64;
        let mut is_cut = false;
        while cell.time_us() < end_us && !is_cut {
            is_cut = step(&mut cell)?;
        }
        if !is_cut {
            assert!(after > 2, "saving took {after} operations");
            println!("{leaves:?}: {after} cuts, {outcomes:?} with the values before and after");
            return Ok(());
        }
        cell.board.chip.power_cycle()?;
        cell.run(READY_S);
        let found = [read(&mut cell, id::FORCE_RATE)?, read(&mut cell, id::TARE)?];
        let place = match found {
            [rate, zero] if [rate, zero] == [RATES[0], tare] => 0,
            [rate, zero] if [rate, zero] == [RATES[1], changed_tare] => 1,
            _ => return Err(format!("cut after {after} operations: {found:?}").into()),
        };
        outcomes[place] += 1;
        assert!(cell.state() < PowerState::Armed as u8, "{}", cell.state());
        let unsound = cell
            .host
            .received
            .faults
            .iter()
            .any(|(_, event)| event.code == Fault::StoreUnsound as u16);
        assert!(!unsound, "cut after {after} operations: {:?}", cell.host.received.faults);
        // From the same beginning again.
        if place == 1 {
            write_rate(&mut cell, RATES[0]);
            serve(&mut cell, op::SAVE)?;
        }
    }
    Ok(())
}

/// A millisecond; whether the supply was cut in it.
fn step(cell: &mut Cell) -> Result<bool, Failed> {
    match cell.try_tick() {
        Ok(()) => Ok(false),
        Err(error) if error.downcast_ref() == Some(&Halt::PowerLost) => Ok(true),
        Err(error) => Err(error.into()),
    }
}

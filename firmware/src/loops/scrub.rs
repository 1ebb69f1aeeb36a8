//! Walks the tables over and over: a bit that turns in memory is found, and then nobody may arm.

use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::{Exchange, Finder};
use crate::clock::{Clock, pause};
use crate::model::check::{CALLS_PER_S, Checked, Found, Scrub};
use crate::status::{Fault, Faults};

/// What is wrong with which, as the source of a fault.
const TABLES: u8 = 0;
/// Likewise.
const NETWORKS: u8 = 1;
/// Between two steps.
const STEP_US: u64 = 1_000_000 / CALLS_PER_S as u64;

/// Walks tables and networks for ever. The first walk takes no pauses, but every step of it lets the other loops of its
/// level run, which must feed the watchdog meanwhile. What is broken stays so until the next start.
pub async fn scrub<T: Checked, N: Checked, const COUNT: usize, C: Clock, M: RawMutex>(
    tables: &T,
    networks: &[N; COUNT],
    clock: &C,
    exchange: &Exchange<M>,
) -> ! {
    let mut faults = Faults::default();
    let mut report = |source, found| {
        if found == Found::Broken {
            let fault = (Fault::TablesUnsound, source);
            exchange.note(Finder::Scrub, &mut faults, fault, true, 0);
        }
    };
    report(TABLES, first_walk(tables).await);
    for network in networks {
        report(NETWORKS, first_walk(network).await);
    }
    exchange.checked.signal(());
    let mut walk = Scrub::default();
    let mut walks = [const { Scrub::NEW }; COUNT];
    loop {
        pause(clock, STEP_US).await;
        report(TABLES, walk.step(tables));
        for (walk, network) in walks.iter_mut().zip(networks) {
            report(NETWORKS, walk.step(network));
        }
    }
}

/// One whole walk.
async fn first_walk(of: &impl Checked) -> Found {
    let mut walk = Scrub::default();
    loop {
        match walk.step(of) {
            Found::Nothing => yield_now().await,
            found => return found,
        }
    }
}

//! Checks the checksums of tables and networks continuously: after a bit error arming is refused.

use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::clock::{Clock, delay_us};
use crate::model::integrity::{CALLS_PER_S, Scrub, ScrubResult, Scrubber};
use crate::system::faults::{Fault, FaultSet};
use crate::tasks::{FaultReporter, SharedState};

/// Fault source: tables.
const TABLES: u8 = 0;
/// Fault source: networks.
const NETWORKS: u8 = 1;
/// Period in which the tables and each network are given a step.
const PERIOD_US: u64 = 1_000_000 / CALLS_PER_S as u64;

/// Checks tables and networks. The first pass has no pauses, but yields after each step to the other tasks of its level,
/// which must feed the watchdog meanwhile. A fault stays until the next boot.
pub async fn scrub<const NETWORK_COUNT: usize, C: Clock, M: RawMutex>(
    tables: &dyn Scrub,
    networks: [Option<&dyn Scrub>; NETWORK_COUNT],
    clock: &C,
    shared: &SharedState<M>,
) -> ! {
    let mut faults = FaultSet::default();
    let mut report = |source, found| {
        if found == ScrubResult::Corrupt {
            let fault = (Fault::TablesUnsound, source);
            shared.update_fault(FaultReporter::Scrub, &mut faults, fault, true, 0);
        }
    };
    report(TABLES, first_pass(tables).await);
    for network in networks.into_iter().flatten() {
        report(NETWORKS, first_pass(network).await);
    }
    shared.tables_checked.signal(());
    let mut walk = Scrubber::NEW;
    let mut walks = [const { Scrubber::NEW }; NETWORK_COUNT];
    // One step at a time: together they would delay the other tasks of the level by a fifth of a millisecond.
    let step_us = PERIOD_US.div_ceil(NETWORK_COUNT as u64 + 1);
    loop {
        delay_us(clock, step_us).await;
        report(TABLES, tables.scrub(&mut walk));
        for (walk, network) in walks.iter_mut().zip(networks) {
            delay_us(clock, step_us).await;
            if let Some(network) = network {
                report(NETWORKS, network.scrub(walk));
            }
        }
    }
}

/// One complete pass.
async fn first_pass(of: &dyn Scrub) -> ScrubResult {
    let mut walk = Scrubber::UNPAUSED;
    loop {
        match of.scrub(&mut walk) {
            ScrubResult::Pending => yield_now().await,
            found => return found,
        }
    }
}

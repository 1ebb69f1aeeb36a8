//! Walks the tables over and over: a bit that turns in memory is found, and then nobody may arm.

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

/// Walks tables and networks for ever, all of them at the start. What is broken stays so until the next start.
pub async fn scrub<T: Checked, N: Checked, const COUNT: usize, C: Clock, M: RawMutex>(
    tables: &T,
    networks: &[N; COUNT],
    clock: &C,
    exchange: &Exchange<M>,
) -> ! {
    let mut faults = Faults::default();
    let mut broken = |source, is_broken: bool| {
        if is_broken {
            let fault = (Fault::TablesUnsound, source);
            exchange.note(Finder::Scrub, &mut faults, fault, true, 0);
        }
    };
    broken(TABLES, !tables.is_sound());
    broken(NETWORKS, !networks.iter().all(N::is_sound));
    exchange.checked.signal(());
    let mut walk = Scrub::default();
    let mut walks = [const { Scrub::NEW }; COUNT];
    loop {
        pause(clock, STEP_US).await;
        broken(TABLES, walk.step(tables) == Found::Broken);
        for (walk, network) in walks.iter_mut().zip(networks) {
            broken(NETWORKS, walk.step(network) == Found::Broken);
        }
    }
}

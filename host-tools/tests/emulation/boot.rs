//! Every image starts, feeds its watchdog, and keeps its deadlines, with every model of time.

use emulator::{CycleModel, Time};
use firmware::config::constants::TICK_US;
use firmware::protocol::messages::Message;
use firmware::protocol::serial::{Packet, PacketDecoder};
use firmware::system::faults::Fault;
use libtest_mimic::{Failed, Trial};
use sim::board::SimulatedBoard;

use crate::Effort;
use crate::boards::{
    CONDITIONS, LOAD, LOAD_WITHOUT_CACHES, WORST_TICK_US, board, image, overload, pressed,
    violations,
};
use crate::images::Variant;
use sim::closed_loop::emulated_board::ChipConditions;

/// From the watchdog's start to its first feed.
const FIRST_FEED: Time = Time::from_ms(5);
/// Longest time between feeds: the period and what is more urgent.
const FEED_GAP: Time = Time::from_ms(7);

pub fn trials(effort: Effort) -> Vec<Trial> {
    let mut trials = Vec::new();
    for variant in Variant::ALL {
        for (name, conditions) in CONDITIONS {
            trials.push(Trial::test(format!("boot_{}_{name}", variant.name()), move || {
                boots(variant, conditions, effort)
            }));
        }
    }
    trials
}

fn boots(variant: Variant, conditions: ChipConditions, effort: Effort) -> Result<(), Failed> {
    let made = image(variant)?;
    let seconds = if effort == Effort::Acceptance { 60 } else { 1 };
    let mut board = board(&made, conditions, pressed(&made.built));
    let (mut receiver, mut ticks, mut worst_us, mut worst_estimate_us) =
        (PacketDecoder::default(), 0, 0, 0);
    let (mut last_us, mut gaps) = (None, 0);
    for step in 1..=10 * seconds {
        board.run_until(100_000 * step)?;
        for (_, packet) in board.take_packets(&mut receiver) {
            match packet {
                Packet::Tick(tick) => {
                    ticks += 1;
                    let before_us = last_us.replace(tick.time_us);
                    let step_us = before_us.map_or(TICK_US as u32, |before| tick.time_us - before);
                    // A tick may begin late by 50 us.
                    gaps += u32::from(step_us > TICK_US as u32 + 60);
                }
                Packet::Message { message: Message::Timing(timing), .. } => {
                    worst_us = timing.worst_loop.max(worst_us);
                    worst_estimate_us = timing.worst_inference.max(worst_estimate_us);
                    assert_eq!((timing.missed_ticks, timing.i2c_errors), (0, 0));
                }
                Packet::Message { .. } => {}
            }
        }
    }
    let feeds = *board.chip.feeds();
    let profile = board.chip.profile();
    println!(
        "{} {profile}worst tick {worst_us} us, worst estimate {worst_estimate_us} us, {ticks} ticks, first fed after {:?}",
        variant.name(),
        feeds.first_after.map(|time| time.as_ms())
    );
    let mut wrong = violations(&board);
    let mut check = |is_right: bool, what: String| {
        if !is_right {
            wrong.push(what);
        }
    };
    check(board.chip.resets.is_empty(), format!("resets: {:?}", board.chip.resets));
    check(
        feeds.first_after.is_some_and(|time| time <= FIRST_FEED),
        format!("first fed {:?}", feeds.first_after),
    );
    check(feeds.longest_gap <= FEED_GAP, format!("not fed for {:?}", feeds.longest_gap));
    let has_caches = conditions.model != CycleModel::SLOW;
    let (most_us, load) =
        if has_caches { (WORST_TICK_US, LOAD) } else { (TICK_US as u16, LOAD_WITHOUT_CACHES) };
    check((1..=most_us).contains(&worst_us), format!("worst tick {worst_us} us"));
    // The first 10 ms are the start, and some ticks are on their way at the end.
    check(ticks >= 1000 * seconds - 14, format!("{ticks} ticks on the serial line"));
    check(gaps == 0, format!("{gaps} gaps between the ticks on the serial line"));
    let faults: Vec<_> = board
        .chip
        .log()
        .iter()
        .filter(|line| line.text.contains("fault"))
        .filter(|line| !(variant.has_networks() && is_of_networks(&line.text)))
        .map(|line| &line.text)
        .collect();
    check(faults.is_empty(), format!("faults: {faults:?}"));
    wrong.extend(overload(&profile, load));
    if wrong.is_empty() { Ok(()) } else { Err(wrong.join("\n").into()) }
}

/// A disagreement between networks and model, or what follows from it.
fn is_of_networks(line: &str) -> bool {
    let faults = [Fault::NetworkDiverged, Fault::Disturbed, Fault::Unbalanced];
    let begins = |fault| format!("fault {} of", fault as u16);
    faults.into_iter().any(|fault| line.contains(&begins(fault)))
}

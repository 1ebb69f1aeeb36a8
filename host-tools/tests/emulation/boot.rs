//! Every image starts, feeds its watchdog, and keeps its deadlines, with every model of time.

use device::emulation::deadlines::{Clocks, FrameDelays};
use device::source::packet;
use embedded_can::Frame as _;
use emulator::Time;
use firmware::config::constants::TICK_US;
use firmware::protocol::DEFAULT_NODE;
use firmware::protocol::messages::Message;
use firmware::protocol::serial::{Packet, PacketDecoder};
use firmware::system::faults::Fault;
use libtest_mimic::{Failed, Trial};
use sim::board::SimulatedBoard;

use crate::Effort;
use crate::boards::{
    CONDITIONS, TIME_LIMITS, TimeLimits, board, image, overload, pressed, violations,
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
        for ((name, conditions), limits) in CONDITIONS.into_iter().zip(TIME_LIMITS) {
            // Usually each image at the slow end, and those with the most to compute at the others, too.
            let is_long =
                matches!(variant, Variant::Default | Variant::Effects | Variant::Networks);
            if effort == Effort::Usual && !is_long && name != "slow" {
                continue;
            }
            trials.push(Trial::test(format!("boot_{}_{name}", variant.name()), move || {
                boots(variant, conditions, limits, effort)
            }));
        }
    }
    trials
}

fn boots(
    variant: Variant,
    conditions: ChipConditions,
    limits: TimeLimits,
    effort: Effort,
) -> Result<(), Failed> {
    let made = image(variant)?;
    let seconds = if effort == Effort::Acceptance { 60 } else { 2 };
    let mut board = board(&made, conditions, pressed(&made.built));
    let (mut receiver, mut ticks, mut worst_us, mut worst_estimate_us) =
        (PacketDecoder::default(), 0, 0, 0);
    let (mut last_us, mut gaps) = (None, 0);
    let (mut frames, mut asleep) = (FrameDelays::default(), [0.0; 2]);
    // Shorter than the period of the firmware's timer, 65 ms.
    for step in 1..=50 * seconds {
        board.run_until(20_000 * step)?;
        let clocks = Clocks { now: board.chip.now(), firmware_us: board.chip.soc.time_base() };
        for (time_us, frame) in board.connections.can.borrow_mut().board_frames.drain(..) {
            let message = packet(DEFAULT_NODE, frame.identifier(), frame.data());
            if let Some(Packet::Message { copy, message: Message::Force(_) }) = message {
                frames.push_frame(copy, Time::from_us(time_us));
            }
        }
        for (_, packet) in board.take_packets(&mut receiver) {
            match packet {
                Packet::Tick(tick) => {
                    ticks += 1;
                    let before_us = last_us.replace(tick.time_us);
                    let step_us = before_us.map_or(TICK_US as u32, |before| tick.time_us - before);
                    // A tick may begin late by 50 us.
                    gaps += u32::from(step_us > TICK_US as u32 + 60);
                    frames.push_tick(clocks.time(tick.time_us));
                }
                Packet::Message { message: Message::Timing(timing), .. } => {
                    worst_us = timing.worst_loop.max(worst_us);
                    worst_estimate_us = timing.worst_inference.max(worst_estimate_us);
                    assert_eq!((timing.missed_ticks, timing.i2c_errors), (0, 0));
                }
                Packet::Message { .. } => {}
            }
        }
        if step % 50 == 0 {
            let profile = board.chip.profile();
            let [first_s, _] = asleep;
            let all_s = profile.idle * profile.duration.as_s();
            asleep = [if step == 50 { all_s } else { first_s }, all_s];
        }
    }
    // Of the time after the first second.
    let [first_s, all_s] = asleep;
    let busy = 1.0 - (all_s - first_s) / (seconds - 1) as f64;
    let feeds = *board.chip.feeds();
    let profile = board.chip.profile();
    println!(
        "{} {profile}{:.1} % busy after the start, worst tick {worst_us} us, worst estimate {worst_estimate_us} us, force \
         frames {:?} us, {ticks} ticks, first fed after {:?}",
        variant.name(),
        100.0 * busy,
        frames.longest.map(Time::us),
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
    check((1..=limits.estimate_us).contains(&worst_us), format!("worst tick {worst_us} us"));
    let [frame, ..] = frames.longest;
    check((1..=limits.frame_us).contains(&frame.us()), format!("force frame {} us", frame.us()));
    // The first 12 ms are the start, and some ticks are on their way at the end.
    check(ticks >= 1000 * seconds - 16, format!("{ticks} ticks on the serial line"));
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
    wrong.extend(overload(&profile, busy, limits.load));
    if wrong.is_empty() { Ok(()) } else { Err(wrong.join("\n").into()) }
}

/// A disagreement between networks and model, or what follows from it.
fn is_of_networks(line: &str) -> bool {
    let faults = [Fault::NetworkDiverged, Fault::Disturbed, Fault::Unbalanced];
    let begins = |fault| format!("fault {} of", fault as u16);
    faults.into_iter().any(|fault| line.contains(&begins(fault)))
}

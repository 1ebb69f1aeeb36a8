//! What an emulation measured, for people and for programs.

use serde_json::{Value, json};
use sim_board::{Profile, Time};

use super::Args;
use super::run::{End, Setup, fault_words, replayed, reset_words};
use crate::live::emulation::Emulation;
use crate::live::emulation::deadlines::{BIN_US, Deadlines};
use crate::live::emulation::pace::Pace;
use crate::show;

/// Characters of the longest bar of the histogram.
const BAR: usize = 40;
/// Lines of each list of problems; JSON has all of them.
const LINES: usize = 20;
/// Functions in JSON.
const FUNCTIONS: usize = 50;

/// The page.
pub fn text(args: &Args, emulation: &mut Emulation, pace: &Pace, end: &End) -> String {
    let (now, elapsed_s) = (emulation.now(), pace.elapsed_s());
    let mut page = format!(
        "Emulated {:.3} s in {elapsed_s:.1} s: {:.2} of real time.",
        now.as_s(),
        now.as_s() / elapsed_s
    );
    page += match end {
        End::Recording => " The recording has ended.\n",
        _ => "\n",
    };
    if !pace.keeps_up() {
        let asked = args.speed.0.unwrap_or(1.0);
        page += &format!("This machine did not keep up with --speed {asked}.\n");
    }
    let profile = emulation.board.chip.profile();
    page += &format!("\nExecution\n{profile}");
    page += &levels(&profile);
    page += &deadlines(&emulation.deadlines);
    page += &problems(emulation);
    page
}

fn levels(profile: &Profile) -> String {
    let levels = profile.by_level().into_iter().map(|(level, share)| {
        let level = level.map_or("thread".to_owned(), |level| format!("level {level}"));
        format!("{level} {:.1} %", 100.0 * share)
    });
    let levels: Vec<_> = levels.collect();
    format!(
        "load by priority, most urgent first: {}\n",
        levels.join(", ")
    )
}

fn deadlines(deadlines: &Deadlines) -> String {
    let mut page = "\nFrom a tick to the end of its packet on the serial line\n".to_owned();
    let bins = deadlines.bins();
    let most = bins.iter().map(|(_, ticks)| *ticks).max().unwrap_or(0);
    if most == 0 {
        return page + "no tick came\n";
    }
    let mut next_us = None;
    for (from_us, ticks) in bins {
        if next_us
            .replace(from_us + BIN_US)
            .is_some_and(|next_us| next_us < from_us)
        {
            page += &format!("{:>12}\n", "...");
        }
        let length = (BAR as u64 * ticks).div_ceil(most) as usize;
        let range = match Deadlines::is_last_bin(from_us) {
            true => format!("{from_us}.."),
            false => format!("{from_us}..{}", from_us + BIN_US),
        };
        page += &format!("{range:>12} us {ticks:>9}  {}\n", "#".repeat(length));
    }
    let quantile = |share| deadlines.quantile_us(share).unwrap_or(0);
    page + &format!(
        "{} ticks, {} missed, {} later than the next tick; half within {} us, 99.9 % within {} us, longest {:.1} us\n",
        deadlines.ticks,
        deadlines.missed,
        deadlines.late,
        quantile(0.5),
        quantile(0.999),
        us(deadlines.longest)
    )
}

fn problems(emulation: &Emulation) -> String {
    let image = emulation.board.chip.image();
    let violations = emulation.board.chip.soc.violations.iter();
    let violations: Vec<_> = violations
        .map(|violation| format!("{violation}, {}", image.place(violation.pc)))
        .collect();
    let resets = emulation.board.chip.resets.iter();
    let resets: Vec<_> = resets
        .map(|record| reset_words(record, emulation))
        .collect();
    let faults = emulation.faults.iter();
    let faults: Vec<_> = faults
        .map(|(time_us, event)| {
            format!(
                "{:>12.6} {}",
                *time_us as f64 / 1e6,
                fault_words(event, emulation)
            )
        })
        .collect();
    let mut page = "\n".to_owned();
    for (what, lines) in [
        ("violations of the chip's rules", violations),
        ("resets", resets),
        ("faults that the image reported", faults),
    ] {
        match lines.is_empty() {
            true => page += &format!("No {what}.\n"),
            false => {
                let (first, rest) = what.split_at(1);
                page += &format!("{}{rest}:\n", first.to_uppercase());
                for line in lines.iter().take(LINES) {
                    page += &show::paragraph(&format!("  {}", line.trim_start()));
                }
                if let Some(more @ 1..) = lines.len().checked_sub(LINES) {
                    page += &format!("  and {more} more\n");
                }
            }
        }
    }
    for (what, count) in [
        (
            "Frames from other nodes dropped, for the bus was full",
            emulation.dropped_frames,
        ),
        (
            "Frames that the interface did not take",
            emulation.unsent_frames(),
        ),
    ] {
        if count > 0 {
            page += &format!("{what}: {count}.\n");
        }
    }
    page
}

/// The object.
pub fn json(
    setup: &Setup,
    args: &Args,
    emulation: &mut Emulation,
    pace: &Pace,
    end: &End,
) -> Value {
    let (now, elapsed_s) = (emulation.now(), pace.elapsed_s());
    let profile = profile(&emulation.board.chip.profile());
    let image = emulation.board.chip.image();
    let violations = emulation.board.chip.soc.violations.iter().map(|violation| {
        json!({
            "kind": format!("{:?}", violation.kind),
            "detail": violation.detail,
            "text": violation.to_string(),
            "address": violation.address,
            "count": violation.count,
            "first_s": violation.time.as_s(),
            "pc": violation.pc,
            "place": image.place(violation.pc),
        })
    });
    let resets = emulation.board.chip.resets.iter().map(|record| {
        json!({
            "time_s": record.time.as_s(),
            "cause": record.cause.to_string(),
            "pc": record.pc,
            "place": image.place(record.pc),
            "longest_watchdog_gap_ms": record.feeds.longest_gap.as_ms(),
        })
    });
    let faults = emulation.faults.iter().map(|(time_us, event)| {
        json!({
            "time_s": *time_us as f64 / 1e6,
            "code": event.code,
            "source": event.source,
            "active": event.active != 0,
            "detail": event.detail,
            "text": fault_words(event, emulation),
        })
    });
    let (ended_by, error) = match end {
        End::Seconds => ("seconds", None),
        End::Interrupted => ("interrupt", None),
        End::Recording => ("recording", None),
        End::Failed(error) => ("failure", Some(format!("{error:#}"))),
    };
    json!({
        "image": setup.path,
        "image_bytes": setup.length,
        "serial": setup.serial,
        "can": setup.can,
        "replay": replayed(args),
        "timing": format!("{:?}", args.timing).to_lowercase(),
        "seed": args.seed,
        "virtual_s": now.as_s(),
        "elapsed_s": elapsed_s,
        "share_of_real_time": now.as_s() / elapsed_s,
        "speed": args.speed.0,
        "kept_up": pace.keeps_up(),
        "ended_by": ended_by,
        "error": error,
        "profile": profile,
        "deadlines": deadlines_json(&emulation.deadlines),
        "violations": violations.collect::<Vec<_>>(),
        "resets": resets.collect::<Vec<_>>(),
        "faults": faults.collect::<Vec<_>>(),
        "dropped_frames": emulation.dropped_frames,
        "unsent_frames": emulation.unsent_frames(),
    })
}

fn profile(profile: &Profile) -> Value {
    let levels = profile.by_level().into_iter();
    let loads = profile.loads.iter().map(|load| {
        json!({
            "name": load.name,
            "level": load.level,
            "load": load.share,
            "instructions_per_ms": load.instructions_per_ms,
            "entries_per_s": load.entries_per_s,
            "longest_us": us(load.longest),
            "latency_us": us(load.latency),
        })
    });
    let functions = profile.functions.iter().take(FUNCTIONS);
    json!({
        "duration_s": profile.duration.as_s(),
        "clock_hz": profile.clock.0,
        "idle": profile.idle,
        "by_level": levels.map(|(level, load)| json!({ "level": level, "load": load })).collect::<Vec<_>>(),
        "exceptions": loads.collect::<Vec<_>>(),
        "stack": profile.stack.map(|[used, available]| json!({ "used": used, "available": available })),
        "functions": functions.map(|(name, load)| json!({ "name": name, "load": load })).collect::<Vec<_>>(),
    })
}

fn deadlines_json(deadlines: &Deadlines) -> Value {
    let bins = deadlines.bins().into_iter().map(|(from_us, ticks)| {
        let to_us = (!Deadlines::is_last_bin(from_us)).then_some(from_us + BIN_US);
        json!({ "from_us": from_us, "to_us": to_us, "ticks": ticks })
    });
    json!({
        "ticks": deadlines.ticks,
        "missed": deadlines.missed,
        "late": deadlines.late,
        "median_us": deadlines.quantile_us(0.5),
        "p99_9_us": deadlines.quantile_us(0.999),
        "longest_us": us(deadlines.longest),
        "bins": bins.collect::<Vec<_>>(),
    })
}

fn us(time: Time) -> f64 {
    time.ns() as f64 / 1e3
}

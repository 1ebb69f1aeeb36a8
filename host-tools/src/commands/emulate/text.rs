//! Report of `magpie dev emulate`.

use std::path::PathBuf;

use emulator::{Profile, ResetRecord, Time};
use firmware::protocol::messages::FaultEvent;
use firmware::system::faults::Fault;
use serde_json::{Value, json};

use crate::commands::emulate::args::Args;
use device::emulation::Emulation;
use device::emulation::deadlines::{BIN_US, Deadlines};
use device::emulation::pace::Pace;
use device::format;
use report::text::terminal;

/// Maximum bar length of the histogram in characters.
const BAR_LENGTH: usize = 40;
/// Maximum lines per list of problems; JSON has all of them.
const MAX_LINES: usize = 20;
/// Number of functions in JSON.
const MAX_FUNCTIONS: usize = 50;

/// Why the emulation ended.
pub enum End {
    /// The time limit.
    Seconds,
    /// Ctrl-C or SIGTERM.
    Interrupted,
    /// The end of the recording.
    Recording,
    /// An error of the chip or of a port.
    Failed(anyhow::Error),
}

/// The image and the interfaces of the emulated board.
pub struct Setup {
    /// The ELF file.
    pub path: PathBuf,
    /// Flash usage in bytes.
    pub length: usize,
    /// Path of the serial line.
    pub serial: PathBuf,
    /// Name of the CAN bus.
    pub can: String,
}

/// The report as text.
pub fn format_report(args: &Args, emulation: &mut Emulation, pace: &Pace, end: &End) -> String {
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
        let target = args.speed.0.unwrap_or(1.0);
        page += &format!("This machine did not keep up with --speed {target}.\n");
    }
    let profile = emulation.board.chip.profile();
    page += &format!("\nExecution\n{profile}");
    page += &load_by_priority(&profile);
    page += &latency_histogram(&emulation.deadlines);
    page += &frame_latency(emulation);
    page += &problems(emulation);
    page
}

fn load_by_priority(profile: &Profile) -> String {
    let levels = profile.by_level().into_iter().map(|(level, share)| {
        let level = level.map_or("thread".to_owned(), |level| format!("level {level}"));
        format!("{level} {:.1} %", 100.0 * share)
    });
    let levels: Vec<_> = levels.collect();
    format!("load by priority, highest first: {}\n", levels.join(", "))
}

fn latency_histogram(deadlines: &Deadlines) -> String {
    let mut page = "\nLatency from tick to end of packet on the serial line\n".to_owned();
    let bins = deadlines.bins();
    let max = bins.iter().map(|(_, ticks)| *ticks).max().unwrap_or(0);
    if max == 0 {
        return page + "no ticks\n";
    }
    let mut next_us = None;
    for (from_us, ticks) in bins {
        if next_us.replace(from_us + BIN_US).is_some_and(|next_us| next_us < from_us) {
            page += &format!("{:>12}\n", "...");
        }
        let length = (BAR_LENGTH as u64 * ticks).div_ceil(max) as usize;
        let range = if Deadlines::is_last_bin(from_us) {
            format!("{from_us}..")
        } else {
            format!("{from_us}..{}", from_us + BIN_US)
        };
        page += &format!("{range:>12} us {ticks:>9}  {}\n", "#".repeat(length));
    }
    let quantile = |share| deadlines.quantile_us(share).unwrap_or(0);
    page + &format!(
        "{} ticks, {} missed, {} later than the next tick; median {} us, 99.9 % quantile {} us, max {:.1} us\n",
        deadlines.ticks,
        deadlines.missed,
        deadlines.late,
        quantile(0.5),
        quantile(0.999),
        us(deadlines.longest)
    )
}

fn frame_latency(emulation: &Emulation) -> String {
    let delays = &emulation.force_frames;
    let longest = delays.longest.map(|delay| format!("{:.0}", us(delay)));
    format!(
        "\nLatency from tick to estimate: max {} us\n\
         Latency from tick to end of CAN frame with the forces at sensors 0 to 3: max {} us ({} frames)\n",
        emulation.worst_tick_us,
        longest.join(", "),
        delays.frames
    )
}

fn problems(emulation: &Emulation) -> String {
    let image = emulation.board.chip.image();
    let violations = emulation.board.chip.soc.violations.iter();
    let violations: Vec<_> =
        violations.map(|violation| format!("{violation}, {}", image.place(violation.pc))).collect();
    let resets = emulation.board.chip.resets.iter();
    let resets: Vec<_> = resets.map(|record| format_reset(record, emulation)).collect();
    let faults = emulation.faults.iter();
    let faults: Vec<_> = faults
        .map(|(time_us, event)| {
            format!("{:>12.6} {}", *time_us as f64 / 1e6, format_fault(event, emulation))
        })
        .collect();
    let mut page = "\n".to_owned();
    for (title, lines) in [
        ("violations of chip rules", violations),
        ("resets", resets),
        ("faults reported by the image", faults),
    ] {
        if lines.is_empty() {
            page += &format!("No {title}.\n")
        } else {
            let (first, rest) = title.split_at(1);
            page += &format!("{}{rest}:\n", first.to_uppercase());
            for line in lines.iter().take(MAX_LINES) {
                page += &terminal::paragraph(&format!("  {}", line.trim_start()));
            }
            if let Some(more @ 1..) = lines.len().checked_sub(MAX_LINES) {
                page += &format!("  and {more} more\n");
            }
        }
    }
    for (title, count) in [
        ("Frames from other nodes dropped (bus full)", emulation.dropped_frames),
        ("Frames not accepted by the interface", emulation.unsent_frames()),
    ] {
        if count > 0 {
            page += &format!("{title}: {count}.\n");
        }
    }
    page
}

/// The object of `--json`.
pub fn to_json(
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
            "text": format_fault(event, emulation),
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
        "replay": args.replay,
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
        "worst_tick_us": emulation.worst_tick_us,
        "force_frames": {
            "frames": emulation.force_frames.frames,
            "longest_us": emulation.force_frames.longest.map(us),
        },
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
    let functions = profile.functions.iter().take(MAX_FUNCTIONS);
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

/// A reset with its cause and code location.
pub fn format_reset(record: &ResetRecord, emulation: &Emulation) -> String {
    let place = emulation.board.chip.image().place(record.pc);
    format!("{:>12.6} reset: {}, at {place}", record.time.as_s(), record.cause)
}

/// A fault; a crash before the last reset with its code location.
pub fn format_fault(event: &FaultEvent, emulation: &Emulation) -> String {
    let words = format::fault_event_line(event);
    match crash_address(event) {
        Some(address) => {
            let place = emulation.board.chip.image().place(address);
            format!(
                "fault: {}: before the last reset, at {place}",
                format::fault_name(Fault::Crashed)
            )
        }
        None => format!("fault: {words}"),
    }
}

/// Address of a crash: the event's detail has its lower three bytes.
fn crash_address(event: &FaultEvent) -> Option<u32> {
    const FLASH: u32 = 0x0800_0000;
    let is_crash = event.code == Fault::Crashed as u16 && event.active != 0;
    is_crash.then_some(FLASH | event.detail & 0x00FF_FFFF)
}

//! Whether what was seen is what a scenario expects, and nothing else.

use firmware::status::Fault;
use firmware::units::Force;
use firmware::wire::messages::FaultEvent;
use firmware::wire::serial::Tick;

use super::bench::Seen;
use super::file::{Expect, Moment, Scenario};

/// Everything that differs, in words; and how long after its cause each expected fault was told, in milliseconds. The times of
/// a scenario are those of loops that compute in no time: `execution_ms` is what an image may take beyond them.
pub fn judge(
    scenario: &Scenario,
    seen: &Seen,
    execution_ms: f64,
) -> (Vec<String>, Vec<(String, f64)>) {
    let mut wrong = Vec::new();
    let mut latencies = Vec::new();
    let mut explained = vec![false; seen.faults.len()];
    for expect in &scenario.expect {
        match expect {
            Expect::Comes(moment) | Expect::Goes(moment) => {
                let active = matches!(expect, Expect::Comes(_));
                let told = seen.faults.iter().enumerate().find(|(place, (ms, fault))| {
                    !explained[*place] && is(fault, moment, active) && *ms >= moment.after_ms
                });
                match told {
                    Some((place, (ms, _))) => {
                        explained[place] = true;
                        let after_ms = ms - moment.after_ms;
                        if after_ms > moment.within_ms + execution_ms {
                            wrong.push(format!("{moment:?}: told after {after_ms} ms"));
                        }
                        if active {
                            latencies.push((moment.fault.clone(), after_ms));
                        }
                    }
                    None => wrong.push(format!("{moment:?}: not told")),
                }
            }
            Expect::May { fault, source } => {
                for ((_, event), explained) in seen.faults.iter().zip(&mut explained) {
                    *explained |= is_of(event, fault, *source);
                }
            }
            Expect::Valid {
                sensors,
                from_ms,
                to_ms,
            } => wrong.extend(validity(seen, sensors, *from_ms, *to_ms, true)),
            Expect::NotValid {
                sensors,
                from_ms,
                to_ms,
            } => wrong.extend(validity(seen, sensors, *from_ms, *to_ms, false)),
            Expect::Force {
                sensors,
                newtons,
                within_n,
                from_ms,
                to_ms,
            } => wrong.extend(forces(
                seen,
                sensors,
                [*newtons, *within_n],
                [*from_ms, *to_ms],
            )),
            Expect::Missed { ticks } if seen.missed > *ticks => {
                wrong.push(format!("{} ticks were missed", seen.missed));
            }
            Expect::Dropped { frames } if seen.dropped != *frames => {
                wrong.push(format!("{} frames were dropped", seen.dropped));
            }
            Expect::Cleared { times } if seen.bus_clearings != *times => {
                wrong.push(format!("buses were cleared {} times", seen.bus_clearings));
            }
            Expect::Missed { .. } | Expect::Dropped { .. } | Expect::Cleared { .. } => {}
        }
    }
    for ((ms, fault), explained) in seen.faults.iter().zip(explained) {
        if !explained {
            wrong.push(format!("unexpected at {ms} ms: {fault:?}"));
        }
    }
    (wrong, latencies)
}

fn is(fault: &FaultEvent, moment: &Moment, active: bool) -> bool {
    is_of(fault, &moment.fault, moment.source) && (fault.active == 1) == active
}

fn is_of(event: &FaultEvent, fault: &str, source: u8) -> bool {
    let name = Fault::of_code(event.code).map(|kind| format!("{kind:?}"));
    name.as_deref() == Some(fault) && event.source == source
}

/// Milliseconds from the first tick.
fn tick_ms(seen: &Seen, tick: &Tick) -> f64 {
    f64::from(tick.time_us.wrapping_sub(seen.origin_us)) / 1000.0
}

fn stretch(seen: &Seen, [from_ms, to_ms]: [f64; 2]) -> impl Iterator<Item = (f64, &Tick)> {
    let ticks = seen.ticks.iter().map(|tick| (tick_ms(seen, tick), tick));
    ticks.filter(move |(ms, _)| *ms >= from_ms && *ms < to_ms)
}

fn forces(
    seen: &Seen,
    sensors: &[usize],
    [newtons, within_n]: [f64; 2],
    from_to_ms: [f64; 2],
) -> Vec<String> {
    let mut wrong = Vec::new();
    for (ms, tick) in stretch(seen, from_to_ms) {
        for &sensor in sensors {
            let force_n = f64::from(tick.sensors[sensor].force[0]) / Force::PER_NEWTON;
            if (force_n.abs() - newtons).abs() > within_n {
                wrong.push(format!("sensor {sensor} at {ms} ms: {force_n:.1} N"));
            }
        }
    }
    wrong
}

fn validity(seen: &Seen, sensors: &[usize], from_ms: f64, to_ms: f64, wanted: bool) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut ticks = 0;
    for (ms, tick) in stretch(seen, [from_ms, to_ms]) {
        ticks += 1;
        for &sensor in sensors {
            let valid = tick.sensors[sensor].validity == 0;
            if valid != wanted {
                wrong.push(format!("sensor {sensor} at {ms} ms: valid {valid}"));
            }
        }
    }
    // Every tick arrives.
    if f64::from(ticks) < (to_ms - from_ms).floor() {
        wrong.push(format!(
            "only {ticks} ticks between {from_ms} and {to_ms} ms"
        ));
    }
    wrong
}

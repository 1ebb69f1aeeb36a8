//! Compares the observed behaviour with the expectations of a scenario.

use firmware::fixed_point::Force;
use firmware::protocol::messages::FaultEvent;
use firmware::protocol::serial::Tick;
use firmware::system::faults::Fault;

use super::file::{Expect, Moment, Scenario};
use super::rig::Observed;

/// Differences as text, and the detection latency of each expected fault in milliseconds. Scenario times assume
/// tasks without execution time: `execution_ms` is the allowance of an image.
pub fn evaluate(
    scenario: &Scenario,
    observed: &Observed,
    execution_ms: f64,
) -> (Vec<String>, Vec<(String, f64)>) {
    let mut wrong = Vec::new();
    let mut latencies = Vec::new();
    let mut explained = vec![false; observed.faults.len()];
    for expect in &scenario.expect {
        match expect {
            Expect::Comes(moment) | Expect::Goes(moment) => {
                let active = matches!(expect, Expect::Comes(_));
                let reported = observed.faults.iter().enumerate().find(|(place, (ms, fault))| {
                    !explained[*place] && is(fault, moment, active) && *ms >= moment.after_ms
                });
                match reported {
                    Some((place, (ms, _))) => {
                        explained[place] = true;
                        let after_ms = ms - moment.after_ms;
                        if after_ms > moment.within_ms + execution_ms {
                            wrong.push(format!("{moment:?}: reported after {after_ms} ms"));
                        }
                        if active {
                            latencies.push((moment.fault.clone(), after_ms));
                        }
                    }
                    None => wrong.push(format!("{moment:?}: not reported")),
                }
            }
            Expect::May { fault, source } => {
                for ((_, event), explained) in observed.faults.iter().zip(&mut explained) {
                    *explained |= is_of(event, fault, *source);
                }
            }
            Expect::Valid { sensors, from_ms, to_ms } => {
                wrong.extend(validity(observed, sensors, *from_ms, *to_ms, true))
            }
            Expect::NotValid { sensors, from_ms, to_ms } => {
                wrong.extend(validity(observed, sensors, *from_ms, *to_ms, false))
            }
            Expect::Force { sensors, newtons, within_n, from_ms, to_ms } => {
                wrong.extend(forces(observed, sensors, [*newtons, *within_n], [*from_ms, *to_ms]))
            }
            Expect::Missed { ticks } if observed.missed > *ticks => {
                wrong.push(format!("{} ticks were missed", observed.missed));
            }
            Expect::Dropped { frames } if observed.dropped != *frames => {
                wrong.push(format!("{} frames were dropped", observed.dropped));
            }
            Expect::Cleared { times } if observed.bus_clearings != *times => {
                wrong.push(format!("buses were cleared {} times", observed.bus_clearings));
            }
            Expect::Missed { .. } | Expect::Dropped { .. } | Expect::Cleared { .. } => {}
        }
    }
    for ((ms, fault), explained) in observed.faults.iter().zip(explained) {
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
    let name = Fault::from_code(event.code).map(|kind| format!("{kind:?}"));
    name.as_deref() == Some(fault) && event.source == source
}

/// Milliseconds from the first tick.
fn tick_ms(observed: &Observed, tick: &Tick) -> f64 {
    f64::from(tick.time_us.wrapping_sub(observed.origin_us)) / 1000.0
}

fn stretch(observed: &Observed, [from_ms, to_ms]: [f64; 2]) -> impl Iterator<Item = (f64, &Tick)> {
    let ticks = observed.ticks.iter().map(|tick| (tick_ms(observed, tick), tick));
    ticks.filter(move |(ms, _)| *ms >= from_ms && *ms < to_ms)
}

fn forces(
    observed: &Observed,
    sensors: &[usize],
    [newtons, within_n]: [f64; 2],
    from_to_ms: [f64; 2],
) -> Vec<String> {
    let mut wrong = Vec::new();
    for (ms, tick) in stretch(observed, from_to_ms) {
        for &sensor in sensors {
            let force_n = f64::from(tick.sensors[sensor].force[0]) / Force::PER_NEWTON;
            if (force_n.abs() - newtons).abs() > within_n {
                wrong.push(format!("sensor {sensor} at {ms} ms: {force_n:.1} N"));
            }
        }
    }
    wrong
}

fn validity(
    observed: &Observed,
    sensors: &[usize],
    from_ms: f64,
    to_ms: f64,
    expected: bool,
) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut ticks = 0;
    for (ms, tick) in stretch(observed, [from_ms, to_ms]) {
        ticks += 1;
        for &sensor in sensors {
            let valid = tick.sensors[sensor].validity == 0;
            if valid != expected {
                wrong.push(format!("sensor {sensor} at {ms} ms: valid {valid}"));
            }
        }
    }
    // Every tick arrives.
    if f64::from(ticks) < (to_ms - from_ms).floor() {
        wrong.push(format!("only {ticks} ticks between {from_ms} and {to_ms} ms"));
    }
    wrong
}

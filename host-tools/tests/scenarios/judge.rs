//! Whether what was seen is what a scenario expects, and nothing else.

use firmware::loops::FIRST_TICK_US;
use firmware::status::Fault;
use firmware::wire::messages::FaultEvent;

use super::bench::Seen;
use super::file::{Expect, Moment, Scenario};

/// Everything that differs, in words; and how long after its cause each expected fault was told, in
/// milliseconds.
pub fn judge(scenario: &Scenario, seen: &Seen) -> (Vec<String>, Vec<(String, f64)>) {
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
                        if after_ms > moment.within_ms {
                            wrong.push(format!("{moment:?}: told after {after_ms} ms"));
                        }
                        if active {
                            latencies.push((moment.fault.clone(), after_ms));
                        }
                    }
                    None => wrong.push(format!("{moment:?}: not told")),
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
    let name = Fault::of_code(fault.code).map(|kind| format!("{kind:?}"));
    name.as_deref() == Some(&moment.fault)
        && fault.source == moment.source
        && (fault.active == 1) == active
}

fn validity(seen: &Seen, sensors: &[usize], from_ms: f64, to_ms: f64, wanted: bool) -> Vec<String> {
    let ms = |time_us: u32| (f64::from(time_us) - FIRST_TICK_US as f64) / 1000.0;
    let stretch = seen.ticks.iter().filter(|tick| {
        let ms = ms(tick.time_us);
        ms >= from_ms && ms < to_ms
    });
    let mut wrong = Vec::new();
    let mut ticks = 0;
    for tick in stretch {
        ticks += 1;
        for &sensor in sensors {
            let valid = tick.sensors[sensor].validity == 0;
            if valid != wanted {
                let ms = ms(tick.time_us);
                wrong.push(format!("sensor {sensor} at {ms} ms: valid {valid}"));
            }
        }
    }
    // The line has room for every tick where nothing else is told.
    if f64::from(ticks) < 0.9 * (to_ms - from_ms).floor() {
        wrong.push(format!(
            "only {ticks} ticks between {from_ms} and {to_ms} ms"
        ));
    }
    wrong
}

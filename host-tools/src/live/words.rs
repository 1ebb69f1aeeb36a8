//! The state as a line of text, for a pipe or a file.

use firmware::force::Validity;
use firmware::status::Fault;
use firmware::wire::messages::FaultEvent;

use super::faults::{detail, name, place};
use super::state::{Active, SensorState, State};

/// The heads over the lines.
pub fn head() -> String {
    let mut text = format!("{:>7}", "s");
    for sensor in 0..State::default().sensors.len() {
        text += &format!("  {:>14}", format!("Fx, Fz {sensor} / N"));
    }
    text
}

/// One line about the state.
pub fn line(state: &State, now_s: f64) -> String {
    let mut text = format!("{now_s:>7.1}");
    for sensor in &state.sensors {
        text += &format!("  {:>14}", forces(sensor));
    }
    let faults: Vec<String> = state.faults.iter().map(fault).collect();
    if !faults.is_empty() {
        text += &format!("  {}", faults.join("; "));
    }
    match state.heard_s {
        None => text + "  nothing heard yet",
        Some(heard_s) if now_s - heard_s > 1.0 => {
            text + &format!("  silent for {:.0} s", now_s - heard_s)
        }
        Some(_) => text,
    }
}

fn forces(sensor: &SensorState) -> String {
    match sensor.validity {
        Validity::Missing => "-".to_owned(),
        validity => {
            let [x, z] = sensor.force_n;
            let mark = if validity == Validity::Valid { "" } else { "?" };
            format!("{x:.2} {z:.2}{mark}")
        }
    }
}

/// A fault with its place and measure.
pub fn fault((&(code, source), active): (&(u16, Option<u8>), &Active)) -> String {
    let Some(kind) = Fault::of_code(code) else {
        return format!("fault {code}, which this tool does not know");
    };
    let place = source.map_or("of unknown source".to_owned(), |source| place(kind, source));
    let measure = active
        .detail
        .map_or(String::new(), |measure| detail(kind, measure));
    let mut text = name(kind);
    for part in [place, measure] {
        if !part.is_empty() {
            text += &format!(", {part}");
        }
    }
    text
}

/// A fault that comes or goes.
pub fn fault_event(event: &FaultEvent) -> String {
    let is_active = event.active != 0;
    let active = Active {
        since_s: 0.0,
        since_board_s: None,
        detail: is_active.then_some(event.detail),
    };
    let words = fault((&(event.code, Some(event.source)), &active));
    match is_active {
        true => words,
        false => words + ": gone",
    }
}

/// What did not arrive; `None` where everything did.
pub fn lost(state: &State) -> Option<String> {
    let lost = &state.lost;
    let counts = [
        (lost.ticks, "ticks"),
        (lost.messages, "messages"),
        (u64::from(lost.broken), "broken packets"),
        (u64::from(lost.restarts), "restarts"),
    ];
    let told = counts.iter().filter(|(count, _)| *count > 0);
    let told: Vec<String> = told.map(|(count, of)| format!("{count} {of}")).collect();
    (!told.is_empty()).then(|| told.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_tells_forces_marks_what_is_no_number_and_names_faults() {
        let mut state = State::default();
        state.heard_s = Some(2.0);
        state.sensors[0].force_n = [12.345, -3.0];
        state.sensors[0].validity = Validity::Valid;
        state.sensors[1].force_n = [200.0, 0.0];
        state.sensors[1].validity = Validity::OutsideModel;
        let active = Active {
            since_s: 1.0,
            since_board_s: None,
            detail: Some(2),
        };
        state.faults.insert((100, Some(3)), active);
        assert_eq!(
            line(&state, 2.0),
            "    2.0     12.35 -3.00    200.00 0.00?               -               -  sensor lost, \
             sensor 3, 2 ticks old"
        );
        assert!(line(&state, 5.0).ends_with("  silent for 3 s"));
        assert!(line(&State::default(), 5.0).ends_with("  nothing heard yet"));
    }
}

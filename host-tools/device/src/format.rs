//! State and faults as text and JSON.

use crate::state::{ActiveFault, GripperState, OtherProtocol, SensorState};
use device_run::channel_map::turn_rad;
use firmware::compensation::covariates::Covariates;
use firmware::estimator::Validity;
use firmware::fixed_point::Force;
use firmware::grip::states::{PowerState, TaskState};
use firmware::protocol::SERIAL;
use firmware::protocol::messages::{FaultEvent, GripStatus, Power};
use firmware::protocol::{TEMPERATURE_UNKNOWN, opening_mm};
use firmware::sensors::hall;
use firmware::system::faults::Fault;
use firmware::system::nv_storage::ParameterOrigin;
use firmware::tasks::calibration::CalibrationDefect;
use serde::Serialize;
use serde_json::{Value, json};
use std::fmt::Debug;

/// Legend and column headings of the status lines.
pub fn status_header() -> String {
    let mut text = String::from(
        "~ an effect is not compensated, for lack of an input; ? not valid; - no reading\n",
    );
    text += &format!("{:>7}", "s");
    for sensor in 0..GripperState::default().sensors.len() {
        text += &format!("  {:>14}", format!("Fx, Fz {sensor} / N"));
    }
    text
}

/// State as one line of text.
pub fn status_line(state: &GripperState, now_s: f64) -> String {
    let mut text = format!("{now_s:>7.1}");
    for sensor in &state.sensors {
        text += &format!("  {:>14}", forces(sensor));
    }
    let power = state.heartbeat.map(|beat| state_name(beat.value.state));
    let stopped = state.is_stopped().then(|| "a stop is latched".to_owned());
    let faults = state.faults.iter().map(fault_line);
    let notes: Vec<String> = power.into_iter().chain(stopped).chain(faults).collect();
    if !notes.is_empty() {
        text += &format!("  {}", notes.join("; "));
    }
    match state.received_s {
        None => text + "  no message yet",
        Some(received_s) if now_s - received_s > 1.0 => {
            text + &format!("  silent for {:.0} s", now_s - received_s)
        }
        Some(_) => text,
    }
}

fn forces(sensor: &SensorState) -> String {
    match sensor.validity {
        Validity::Missing => "-".to_owned(),
        validity => {
            let [x, z] = sensor.force_n;
            let mark = match validity {
                Validity::Valid => "",
                Validity::MissingInputs => "~",
                _ => "?",
            };
            format!("{x:.2} {z:.2}{mark}")
        }
    }
}

/// Active fault with its source and detail.
pub fn fault_line((&(code, source), active): (&(u16, Option<u8>), &ActiveFault)) -> String {
    let Some(kind) = Fault::from_code(code) else {
        return format!("fault {code}, unknown to this tool");
    };
    let origin = source.map_or("of unknown source".to_owned(), |source| fault_source(kind, source));
    let detail = active
        .detail
        .map_or(String::new(), |detail| fault_detail(kind, source.unwrap_or_default(), detail));
    let mut text = fault_name(kind);
    for part in [origin, detail] {
        if !part.is_empty() {
            text += &format!(", {part}");
        }
    }
    text
}

/// Fault that appears or disappears.
pub fn fault_event_line(event: &FaultEvent) -> String {
    let is_active = event.active != 0;
    let active = ActiveFault {
        since_s: 0.0,
        since_board_s: None,
        detail: is_active.then_some(event.detail),
    };
    let words = fault_line((&(event.code, Some(event.source)), &active));
    if is_active { words } else { words + ": cleared" }
}

/// Lost messages as text; `None` if there are none.
pub fn loss_line(state: &GripperState) -> Option<String> {
    let lost = &state.lost;
    let counts = [
        (lost.ticks, "ticks"),
        (lost.messages, "messages"),
        (u64::from(lost.broken), "broken packets"),
        (u64::from(lost.restarts), "restarts"),
    ];
    let nonzero = counts.iter().filter(|(count, _)| *count > 0);
    let parts: Vec<String> = nonzero.map(|(count, of)| format!("{count} {of}")).collect();
    (!parts.is_empty()).then(|| parts.join(", "))
}

/// What a stranger sent under the gripper's number; `None` if there is nothing.
pub fn stranger_line(state: &GripperState) -> Option<String> {
    let OtherProtocol { messages, major, .. } = state.other_protocol;
    (messages > 0).then(|| {
        format!(
            "{messages} ignored messages of protocol version {major} under the number of this gripper: another device or host on \
             its bus sends them"
        )
    })
}

/// State as JSON, `now_s` seconds after the start of reception.
pub fn state_json(state: &GripperState, now_s: f64) -> Value {
    let sensors = state.sensors.iter().enumerate();
    json!({
        "time_s": rounded(now_s),
        "board_s": state.board_s(),
        "silent_s": state.received_s.map(|received_s| rounded(now_s - received_s)),
        "sensors": sensors.map(|(number, latest)| sensor(number, latest, now_s)).collect::<Vec<_>>(),
        "faults": state.faults.iter().map(fault_json).collect::<Vec<_>>(),
        "heartbeat": state.heartbeat.map(|latest| json!({
            "age_s": rounded(now_s - latest.at_s),
            "state": state_name(latest.value.state),
            "stopped": latest.value.stopped,
            "command_alive": latest.value.command_alive,
            "sensors_ok": latest.value.sensors_ok,
            "unprotected": latest.value.unprotected,
            "counter": latest.value.counter,
        })),
        "load": state.timing.map(|latest| json!({
            "worst_tick_us": latest.value.worst_loop,
            "worst_estimate_us": latest.value.worst_inference,
            "failed_transfers": latest.value.i2c_errors,
            "missed_ticks": latest.value.missed_ticks,
        })),
        "grip": state.grip.map(|latest| GripValues::of(&latest.value)),
        "covariates": state.covariates.map(|latest| covariates_json(&latest.value)),
        "power": state.power.map(|latest| power_json(&latest.value)),
        "ticks_hz": state.ticks_hz,
        "lost": {
            "ticks": state.lost.ticks,
            "messages": state.lost.messages,
            "broken_packets": state.lost.broken,
            "restarts": state.lost.restarts,
            "other_protocol": state.other_protocol.messages,
        },
        "version": state.version.map(|version| json!({
            "firmware": [version.firmware_major, version.firmware_minor, version.firmware_patch],
            "protocol": [version.protocol_major, version.protocol_minor],
            "hardware": version.hardware,
            "tables": format!("{:04x}", version.tables),
        })),
    })
}

fn sensor(number: usize, sensor: &SensorState, now_s: f64) -> Value {
    json!({
        "sensor": number,
        "fx_n": sensor.force_n[0],
        "fz_n": sensor.force_n[1],
        "sigma_x_n": sensor.sigma_n[0],
        "sigma_z_n": sensor.sigma_n[1],
        "validity": validity_name(sensor.validity),
        "disturbed": sensor.disturbed,
        "network": sensor.network,
        "field_lsb": sensor.reading.map(|latest| latest.value.field),
        "temp_c": sensor.reading.map(|latest| degrees(latest.value.temperature)),
        "age_s": sensor.reading.map(|latest| rounded(now_s - latest.at_s)),
    })
}

pub fn fault_json((&(code, source), active): (&(u16, Option<u8>), &ActiveFault)) -> Value {
    json!({
        "code": code,
        "name": Fault::from_code(code).map(fault_name),
        "source": source,
        "detail": active.detail,
        "since_s": rounded(active.since_s),
        "since_board_s": active.since_board_s,
    })
}

pub const fn validity_name(validity: Validity) -> &'static str {
    match validity {
        Validity::Valid => "valid",
        Validity::Saturated => "saturated",
        Validity::OutsideModel => "outside model",
        Validity::Missing => "no reading",
        Validity::MissingInputs => "effect not compensated",
    }
}

/// Covariates as text.
pub fn covariates_line(covariates: &Covariates) -> String {
    let unknown = |what: &str| format!("{what} unknown");
    let opening = covariates
        .opening_um
        .map_or_else(|| unknown("opening"), |um| format!("opening {:.2} mm", 1e-3 * f64::from(um)));
    let motor = covariates.motor.map_or_else(
        || unknown("rotor"),
        |motor| {
            let angle_rad = turn_rad(motor.turn);
            format!("{:.2} A, rotor {angle_rad:.2} rad", 1e-3 * f64::from(motor.iq_ma))
        },
    );
    let acceleration = covariates.acceleration.map_or_else(
        || unknown("acceleration"),
        |sample| {
            let [x, y, z] = sample.mm_s2.map(|mm_s2| 1e-3 * f64::from(mm_s2));
            format!("accel. {x:.1} {y:.1} {z:.1} m/s²")
        },
    );
    let attitude = covariates.attitude.map_or_else(
        || unknown("attitude"),
        |sample| {
            let [roll, pitch, yaw] = sample.radians();
            format!("attitude {roll:.2} {pitch:.2} {yaw:.2} rad")
        },
    );
    [opening, motor, acceleration, attitude].join(", ")
}

/// Covariates as JSON, by the columns of a recording.
fn covariates_json(covariates: &Covariates) -> Value {
    json!({
        "opening_mm": covariates.opening_um.map(|um| 1e-3 * f64::from(um)),
        "motor_iq_a": covariates.motor.map(|motor| 1e-3 * f64::from(motor.iq_ma)),
        "motor_angle_rad": covariates.motor.map(|motor| turn_rad(motor.turn)),
        "motor_age_us": covariates.motor.map(|motor| motor.age_us),
        "accel_mps2": covariates.acceleration.map(|sample| sample.mm_s2.map(|a| 1e-3 * f64::from(a))),
        "accel_age_us": covariates.acceleration.map(|sample| sample.age_us),
        "roll_pitch_yaw_rad": covariates.attitude.map(|sample| sample.radians()),
        "attitude_age_ms": covariates.attitude.map(|sample| sample.age_ms),
    })
}

/// Status of the grip in SI units and millimetres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GripValues {
    /// Grasping force in newtons.
    pub force_n: f64,
    /// Opening in mm, if it is known.
    pub opening_mm: Option<f64>,
    /// Speed of the opening in mm/s.
    pub opening_mm_s: f64,
    /// Quadrature current in amperes.
    pub current_a: f64,
}

impl GripValues {
    /// Values of a message, without the noise of the conversion.
    pub fn of(grip: &GripStatus) -> Self {
        Self {
            force_n: rounded(0.1 * f64::from(grip.force)),
            opening_mm: opening_mm(grip).map(rounded),
            opening_mm_s: rounded(0.01 * f64::from(grip.speed)),
            current_a: rounded(0.01 * f64::from(grip.current)),
        }
    }

    /// As text.
    pub fn line(&self) -> String {
        let Self { force_n, current_a, .. } = self;
        let opening =
            self.opening_mm.map_or_else(|| "unknown".to_owned(), |mm| format!("{mm:>6.2} mm"));
        format!("force {force_n:>6.1} N  opening {opening}  current {current_a:>6.2} A")
    }
}

/// Supply and temperatures as text.
pub fn power_line(power: &Power) -> String {
    let degrees = |value: i8| match value {
        TEMPERATURE_UNKNOWN => "?".to_owned(),
        value => value.to_string(),
    };
    format!(
        "{:.1} V {:.2} A, MCU {}, motor {}, sensors {} °C",
        0.01 * f64::from(power.bus),
        0.01 * f64::from(power.current),
        degrees(power.mcu),
        degrees(power.motor),
        degrees(power.sensor),
    )
}

fn power_json(power: &Power) -> Value {
    let degrees = |value: i8| (value != TEMPERATURE_UNKNOWN).then_some(value);
    json!({
        "bus_v": 0.01 * f64::from(power.bus),
        "current_a": 0.01 * f64::from(power.current),
        "mcu_c": degrees(power.mcu),
        "motor_c": degrees(power.motor),
        "sensor_c": degrees(power.sensor),
    })
}

/// Temperature of a sensor in degrees Celsius, by the assumed scale of its word.
pub fn degrees(counts: i16) -> f64 {
    hall::celsius(counts).into()
}

/// Rounds to three decimals, the resolution of times and messages.
pub(crate) fn rounded(value: f64) -> f64 {
    (1e3 * value).round() / 1e3
}

/// Name of a fault: "sensor lost".
pub fn fault_name(fault: Fault) -> String {
    spaced(fault)
}

/// Name of a variant with spaces: "hold active" for `HoldActive`.
pub fn spaced(variant: impl Debug) -> String {
    let mut words = String::new();
    for letter in format!("{variant:?}").chars() {
        if letter.is_uppercase() && !words.is_empty() {
            words.push(' ');
        }
        words.extend(letter.to_lowercase());
    }
    words
}

/// State code of the heartbeat as text: "armed", "hold active".
pub fn state_name(code: u8) -> String {
    let power = PowerState::of_code(code).filter(|power| *power != PowerState::Enabled);
    match (power, TaskState::of_code(code)) {
        (Some(power), _) => spaced(power),
        (None, Some(task)) => spaced(task),
        (None, None) => format!("state {code}"),
    }
}

/// Source of a fault; empty where only one exists.
pub fn fault_source(fault: Fault, source: u8) -> String {
    match fault {
        Fault::SensorLost
        | Fault::SensorFrozen
        | Fault::SensorSaturated
        | Fault::OutsideModel
        | Fault::NetworkDiverged => format!("sensor {source}"),
        Fault::BusStuck => format!("sensors' bus {source}"),
        Fault::StoreUnsound => match source {
            0 => "parameters",
            CALIBRATION => "uploaded calibration",
            _ => "option bytes of the chip",
        }
        .to_owned(),
        Fault::Flooded if source == SERIAL => "serial line".to_owned(),
        Fault::Flooded => "CAN bus".to_owned(),
        _ => String::new(),
    }
}

/// Source of [`Fault::StoreUnsound`] for an uploaded calibration.
const CALIBRATION: u8 = 1;
/// Source of [`Fault::StoreUnsound`] for the chip's option bytes.
const OPTION_BYTES: u8 = 2;

/// Which option byte is unsuitable, and what to program.
const fn option_byte_defect(detail: u32) -> &'static str {
    match detail {
        1 => "the flash has one bank: set DBANK = 1",
        2 => "the boot loader may choose bank 2, where settings are stored: set BFB2 = 0",
        _ => "unknown reason",
    }
}

/// Why an uploaded calibration does not run, and what to do ([`CalibrationDefect`]).
const fn calibration_defect(detail: u32) -> &'static str {
    const INVALID: u32 = CalibrationDefect::Invalid as u32;
    const UNDECODABLE: u32 = CalibrationDefect::Undecodable as u32;
    match detail {
        INVALID => "damaged, or of the format of another firmware: upload the model again",
        UNDECODABLE => "larger than this firmware's memory: upload a smaller one",
        _ => "unknown reason",
    }
}

/// Why stored parameters and key are not in use, and what to do ([`ParameterOrigin`]).
const fn parameter_defect(detail: u32) -> &'static str {
    const NEWER: u32 = ParameterOrigin::Newer.code();
    const CORRUPT: u32 = ParameterOrigin::Corrupt.code();
    const PREVIOUS: u32 = ParameterOrigin::Previous.code();
    match detail {
        NEWER => {
            "saved by newer firmware, defaults are in use: install that firmware, or save them again"
        }
        CORRUPT => {
            "parameters and key are lost, defaults are in use and nothing moves: write the key with the button of the board \
             pressed, or press it to accept the defaults without a key"
        }
        PREVIOUS => {
            "the last save is damaged, what was saved before is in use and nothing moves: write the key, or press the button \
             of the board to accept the parameters and key before"
        }
        _ => "unknown reason",
    }
}

/// Detail of a fault; empty where there is none.
pub fn fault_detail(fault: Fault, source: u8, detail: u32) -> String {
    match fault {
        Fault::StoreUnsound if source == OPTION_BYTES => option_byte_defect(detail).to_owned(),
        Fault::SensorLost | Fault::SensorFrozen => format!("{detail} ticks old"),
        Fault::Unbalanced => format!("by {:.1} N", f64::from(detail) / Force::PER_NEWTON),
        Fault::StoreUnsound if source == CALIBRATION => calibration_defect(detail).to_owned(),
        Fault::StoreUnsound => parameter_defect(detail).to_owned(),
        Fault::TicksMissed => format!("{detail} since its start"),
        Fault::Crashed => format!("at {detail:#010x}"),
        Fault::Flooded | Fault::StrangeFrames => format!("{detail} dropped"),
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use firmware::grip::states::state_code;

    use super::*;

    #[test]
    fn line_shows_forces_marks_invalid_ones_and_names_faults() {
        let mut state = GripperState::default();
        state.received_s = Some(2.0);
        state.sensors[0].force_n = [12.345, -3.0];
        state.sensors[0].validity = Validity::Valid;
        state.sensors[1].force_n = [200.0, 0.0];
        state.sensors[1].validity = Validity::OutsideModel;
        let active = ActiveFault { since_s: 1.0, since_board_s: None, detail: Some(2) };
        state.faults.insert((100, Some(3)), active);
        assert_eq!(
            status_line(&state, 2.0),
            "    2.0     12.35 -3.00    200.00 0.00?               -               -  sensor lost, \
             sensor 3, 2 ticks old"
        );
        assert!(status_line(&state, 5.0).ends_with("  silent for 3 s"));
        assert!(status_line(&GripperState::default(), 5.0).ends_with("  no message yet"));
    }

    #[test]
    fn each_state_has_a_unique_name() {
        assert_eq!(state_name(state_code(PowerState::QuickStop, TaskState::Idle)), "quick stop");
        assert_eq!(
            state_name(state_code(PowerState::Enabled, TaskState::HoldActive)),
            "hold active"
        );
        assert_eq!(
            TaskState::of_code(state_code(PowerState::Enabled, TaskState::Foot)),
            Some(TaskState::Foot)
        );
        assert_eq!(TaskState::of_code(state_code(PowerState::Armed, TaskState::Foot)), None);
        assert_eq!(state_name(99), "state 99");
    }

    #[test]
    fn fault_shows_source_and_detail() {
        assert_eq!(fault_name(Fault::SensorLost), "sensor lost");
        assert_eq!(fault_source(Fault::SensorLost, 2), "sensor 2");
        assert_eq!(fault_detail(Fault::SensorLost, 2, 2), "2 ticks old");
        assert_eq!(fault_name(Fault::BusOff), "bus off");
        assert_eq!(fault_source(Fault::BusOff, 0), "");
        assert_eq!(fault_detail(Fault::Unbalanced, 0, 17 << 10), "by 17.0 N");
        assert_eq!(fault_source(Fault::Flooded, SERIAL), "serial line");
        assert_eq!(fault_source(Fault::StoreUnsound, OPTION_BYTES), "option bytes of the chip");
        for (detail, remedy) in [(2, "newer firmware"), (4, "pressed"), (5, "write the key")] {
            assert!(fault_detail(Fault::StoreUnsound, 0, detail).contains(remedy), "{detail}");
        }
        let calibration = fault_detail(Fault::StoreUnsound, CALIBRATION, 1);
        assert!(
            calibration.contains("of another firmware: upload the model again"),
            "{calibration}"
        );
        let bank = fault_detail(Fault::StoreUnsound, OPTION_BYTES, 1);
        assert_eq!(bank, "the flash has one bank: set DBANK = 1");
    }
}

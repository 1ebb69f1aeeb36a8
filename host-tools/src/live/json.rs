//! The state as an object for programs.

use firmware::force::Validity;
use firmware::params;
use firmware::status::Fault;
use model_export::effects::REFERENCE_C;
use serde_json::{Value, json};

use super::faults::name;
use super::state::{Active, SensorState, State};

/// The state `now_s` seconds after hearing began.
pub fn object(state: &State, now_s: f64) -> Value {
    let sensors = state.sensors.iter().enumerate();
    json!({
        "time_s": rounded(now_s),
        "board_s": state.board_s(),
        "silent_s": state.heard_s.map(|heard_s| rounded(now_s - heard_s)),
        "sensors": sensors.map(|(number, told)| sensor(number, told, now_s)).collect::<Vec<_>>(),
        "faults": state.faults.iter().map(fault).collect::<Vec<_>>(),
        "heartbeat": state.heartbeat.map(|told| json!({
            "age_s": rounded(now_s - told.at_s),
            "command_alive": told.value.command_alive,
            "sensors_ok": told.value.sensors_ok,
            "counter": told.value.counter,
        })),
        "load": state.timing.map(|told| json!({
            "worst_tick_us": told.value.worst_loop,
            "worst_estimate_us": told.value.worst_inference,
            "failed_transfers": told.value.i2c_errors,
            "missed_ticks": told.value.missed_ticks,
        })),
        "ticks_hz": state.ticks_hz,
        "lost": {
            "ticks": state.lost.ticks,
            "messages": state.lost.messages,
            "broken_packets": state.lost.broken,
            "restarts": state.lost.restarts,
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
        "validity": validity(sensor.validity),
        "disturbed": sensor.disturbed,
        "network": sensor.network,
        "field_lsb": sensor.reading.map(|told| told.value.field),
        "temp_c": sensor.reading.map(|told| degrees(told.value.temperature)),
        "age_s": sensor.reading.map(|told| rounded(now_s - told.at_s)),
    })
}

/// An active fault.
pub fn fault((&(code, source), active): (&(u16, Option<u8>), &Active)) -> Value {
    json!({
        "code": code,
        "name": Fault::of_code(code).map(name),
        "source": source,
        "detail": active.detail,
        "since_s": rounded(active.since_s),
        "since_board_s": active.since_board_s,
    })
}

/// A word for programs and people.
pub const fn validity(validity: Validity) -> &'static str {
    match validity {
        Validity::Valid => "valid",
        Validity::Saturated => "saturated",
        Validity::OutsideModel => "outside model",
        Validity::Missing => "no reading",
    }
}

/// A sensor's temperature in degrees, by the assumed scale of its word.
pub fn degrees(counts: i16) -> f64 {
    REFERENCE_C + f64::from(counts) / params::TEMPERATURE_SCALE.value
}

/// To milliseconds.
fn rounded(seconds: f64) -> f64 {
    (1e3 * seconds).round() / 1e3
}

//! Client that uploads calibrations to a gripper, reads what is on it, and writes its key.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use firmware::motor::calibration::{CalibrationFailure, CalibrationKind};
use firmware::protocol::authentication::Key;
use firmware::protocol::firmware_version;
use firmware::protocol::host_session::service;
use firmware::protocol::messages::{CalibrationChunk, KeyPart, Message, ServiceReply, Version};
use firmware::protocol::session::{UNLOADED, op, status};
use firmware::system::nv_storage::calibration::{
    CHUNK_BYTES, CHUNKS_PER_GROUP, MAX_BYTES, UploadError,
};
use model_export::inverse::calibration::CalibrationDescription;
use serde::Serialize;

use crate::session::SessionSource;
use crate::source::{self, Source, receive_messages, request_once};

/// Timeout of a request and number of attempts.
const TIMEOUT: Duration = Duration::from_millis(500);
const ATTEMPTS: u32 = 6;
/// The gripper erases two pages and verifies all bytes in this time.
const SLOW_TIMEOUT: Duration = Duration::from_secs(2);
/// Timeout of a measurement of motor or screw, with a margin for slow emulations.
const IDENTIFICATION: Duration = Duration::from_secs(60);
/// Time without an acknowledgement after which chunks are repeated.
const REPEAT: Duration = Duration::from_millis(100);
/// Repetitions without progress until the upload is given up.
const REPETITIONS: u32 = 50;
/// Chunks sent before the first of them is acknowledged: what the gripper can queue.
const WINDOW: u32 = 2 * CHUNKS_PER_GROUP as u32;
/// Time for each chunk: the gripper admits 20 messages in 10 ms, and those of a busy computer come in bursts.
const CHUNK_TIME: Duration = Duration::from_micros(800);
/// Time for each part of a key: the gripper checks four codes in 10 ms.
const KEY_PART_TIME: Duration = Duration::from_millis(20);
/// Time for a reboot with the first check of the tables.
const REBOOT: Duration = Duration::from_secs(5);

/// Calibration that runs on a gripper.
#[derive(Clone, Debug, Serialize)]
pub struct RunningCalibration {
    /// Identifier of the tables on the bus.
    pub tables: String,
    /// Slot in flash, from 0; none for the calibration of the image.
    pub slot: Option<u8>,
    /// Version of the firmware.
    pub firmware: String,
    /// Origin of model and networks; none where the board has no description.
    #[serde(flatten)]
    pub description: Option<CalibrationDescription>,
}

impl RunningCalibration {
    /// The calibration as lines of text.
    pub fn text(&self) -> String {
        let origin = match self.slot {
            None => "from the image".to_owned(),
            Some(slot) => format!("uploaded, slot {slot}"),
        };
        let mut text = format!("calibration  {}, {origin}\n", self.tables);
        let mut line = |name: &str, value: &str| text += &format!("{name:<13}{value}\n");
        match &self.description {
            None => line("origin", "not described"),
            Some(description) => {
                let list = |values: &[String], none: &str| match values {
                    [] => none.to_owned(),
                    values => values.join(", "),
                };
                line("model", &format!("SHA-256 {}", description.model_sha256));
                if !description.variant.is_empty() {
                    line("", &description.variant);
                }
                match &description.network_sha256 {
                    Some(sha256) => line("networks", &format!("SHA-256 {sha256}")),
                    None => line("networks", "none"),
                }
                line("campaign", &description.campaign);
                line("recorded", &list(&description.recorded, "not stated in recording.toml"));
                if let Some(date) = &description.uploaded {
                    line("uploaded", date);
                }
                line("effects", &list(&description.effects, "none"));
                for (effect, conditions) in &description.conditions {
                    line("", &format!("{effect}: compensated {}", conditions.join("; ")));
                }
            }
        }
        line("firmware", &self.firmware);
        text
    }
}

/// Uploads an encoded calibration and activates it for the next boot; `progress` is called with the bytes received by the
/// gripper. Returns the sequence number of the upload.
///
/// # Errors
/// The connection is lost, or the gripper refuses the calibration: the previous one stays.
pub fn upload(
    source: &mut SessionSource<'_>,
    bytes: &[u8],
    mut progress: impl FnMut(usize),
) -> Result<u32> {
    let length = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
    if length > MAX_BYTES {
        bail!("{length} bytes do not fit the gripper's {MAX_BYTES}");
    }
    let reply = request(source, op::UPLOAD, length, SLOW_TIMEOUT)?;
    done(source, reply)?;
    let chunks: Vec<[u8; CHUNK_BYTES]> = bytes
        .chunks(CHUNK_BYTES)
        .map(|part| {
            let mut chunk = [0; CHUNK_BYTES];
            chunk[..part.len()].copy_from_slice(part);
            chunk
        })
        .collect();
    let count = chunks.len() as u32;
    let (mut sent, mut acknowledged) = (0, 0);
    let mut repeated = None;
    let (mut heard, mut silences) = (source.now(), 0);
    while acknowledged < count {
        while sent < count.min(acknowledged + WINDOW) {
            let number = u16::try_from(sent).context("too many chunks")?;
            let chunk = CalibrationChunk::new(number, chunks[sent as usize]);
            source.send(Message::CalibrationChunk(chunk))?;
            sent += 1;
            source.pause(CHUNK_TIME)?;
        }
        for reply in replies(source, op::UPLOAD)? {
            let next = done(source, reply)?;
            heard = source.now();
            if next > acknowledged && next <= sent {
                (acknowledged, repeated, silences) = (next, None, 0);
                progress(bytes.len().min(next as usize * CHUNK_BYTES));
            } else if next == acknowledged && repeated != Some(next) {
                // A chunk was lost: what follows was ignored.
                (sent, repeated) = (next, Some(next));
            }
        }
        if source.now() > heard + REPEAT {
            silences += 1;
            if silences > REPETITIONS {
                bail!("{}: the gripper does not acknowledge the calibration", source.name());
            }
            (heard, sent, repeated) = (source.now(), acknowledged, None);
        }
    }
    let mut code = source.digest().context("no session is open")?;
    code.update(bytes);
    let reply = request(source, op::FINISH_UPLOAD, code.finish(), SLOW_TIMEOUT)?;
    // The code of the bytes is checked before: they arrived as they were sent.
    if (reply.status, reply.detail) == (status::FAILED, UploadError::Corrupt as u32) {
        let why = unknown_format(&version(source)?, &firmware_version(0, 0));
        bail!("{}: the gripper refuses: {why}; its calibration is unchanged", source.name());
    }
    done(source, reply)
}

/// Why the firmware of this version does not know the format, or a table, of a calibration of a tool of another.
fn unknown_format(board: &Version, own: &Version) -> String {
    let order = |version: &Version| {
        let Version { firmware_major, firmware_minor, firmware_patch, protocol_minor, .. } =
            *version;
        [firmware_major, firmware_minor, firmware_patch, protocol_minor]
    };
    let firmware = format!("the firmware on the board (version {})", firmware_text(board));
    match order(board).cmp(&order(own)) {
        Ordering::Less => format!(
            "{firmware} is too old for this calibration: flash a newer one with `cargo flash-image`"
        ),
        Ordering::Equal => format!(
            "{firmware} is of other sources than this tool, or for other sensors: flash that of this tool with `cargo flash-image`"
        ),
        Ordering::Greater => {
            format!(
                "{firmware} is newer than this tool (version {}): update it",
                firmware_text(own)
            )
        }
    }
}

fn firmware_text(version: &Version) -> String {
    let Version { firmware_major, firmware_minor, firmware_patch, .. } = version;
    format!("{firmware_major}.{firmware_minor}.{firmware_patch}")
}

/// Reboots the gripper and waits until it runs tables with this identifier.
///
/// # Errors
/// It runs other tables, or does not answer.
pub fn reboot_into(source: &mut SessionSource<'_>, tables: u16) -> Result<()> {
    source.send(service(op::REBOOT, 0))?;
    let rebooted = source.now();
    let mut found = None;
    while source.now() < rebooted + REBOOT {
        match version(source) {
            Ok(version) if version.tables == tables => return Ok(()),
            Ok(version) => found = Some(version),
            Err(_) => {}
        }
    }
    match found {
        Some(version) => bail!(
            "{}: after its reboot the gripper runs tables {:04x} instead of {tables:04x}: {}",
            source.name(),
            version.tables,
            unknown_format(&version, &firmware_version(0, 0))
        ),
        None => bail!("{}: the gripper does not answer after its reboot", source.name()),
    }
}

/// Reads which calibration runs.
///
/// # Errors
/// No reply, or an unreadable description.
pub fn running(source: &mut dyn Source) -> Result<RunningCalibration> {
    let version = version(source)?;
    let head = describe(source, 0)?;
    if head.status == status::UNKNOWN {
        bail!("{}: the firmware is older than this tool: it has no uploads", source.name());
    }
    let head = done(source, head)?;
    let (length, origin) = (head & 0xFFFF, (head >> 16) as u8);
    let mut text = Vec::new();
    for place in 0..length.div_ceil(4) {
        let reply = describe(source, place + 1)?;
        text.extend_from_slice(&done(source, reply)?.to_le_bytes());
    }
    text.truncate(length as usize);
    let text = String::from_utf8(text).context("the description is not text")?;
    let description = match text.as_str() {
        "" => None,
        text => Some(toml::from_str(text).context("the description cannot be read")?),
    };
    Ok(RunningCalibration {
        tables: format!("{:04x}", version.tables),
        slot: origin.checked_sub(1),
        firmware: firmware_text(&version),
        description,
    })
}

/// Defines the present forces as zero, and saves that with all other parameters if wanted.
///
/// # Errors
/// No reply, or the gripper refuses: the previous tare stays.
pub fn tare(source: &mut SessionSource<'_>, is_unloaded: bool, saves: bool) -> Result<()> {
    let argument = if is_unloaded { UNLOADED } else { 0 };
    let reply = request(source, op::TARE, argument, SLOW_TIMEOUT)?;
    let sensor = reply.detail & 0xFF;
    let why = match (reply.status, reply.detail >> 8) {
        (status::DONE, _) => {
            if saves {
                save(source).context("the tare is in effect, but not saved")?;
            }
            return Ok(());
        }
        (status::ARMED, _) => "a host is armed or the motor is driven".to_owned(),
        (status::GRIPPING, _) if is_unloaded => {
            "an object is gripped: open the fingers first (`cargo magpie grasp --release`)".to_owned()
        }
        (status::GRIPPING, _) => "both fingers press on something, or seem to: remove it; if nothing is there, the tables \
                                  do not fit and --unloaded tares nevertheless"
            .to_owned(),
        (_, 1) => format!("no reading of sensor {sensor}"),
        (_, 2) => format!("sensor {sensor} is saturated, or its field is outside the model"),
        (_, 3) => format!("a magnet disturbs sensor {sensor}"),
        (_, 4) => format!("the force at sensor {sensor} is not constant: keep the gripper at rest"),
        (_, 5) => format!(
            "the force at sensor {sensor} is larger than the model's range: remove the load, or upload tables of this gripper"
        ),
        _ => "another tare or calibration is in progress".to_owned(),
    };
    bail!("{}: the gripper refuses the tare: {why}", source.name())
}

/// Saves all parameters in flash.
///
/// # Errors
/// No reply, or the gripper refuses: the flash holds the previous ones.
pub fn save(source: &mut SessionSource<'_>) -> Result<()> {
    let reply = request(source, op::SAVE, 0, SLOW_TIMEOUT)?;
    done(source, reply).map(|_| ())
}

/// Measures motor or screw, and saves the result with all other parameters if wanted; the fingers move. Returns whether the
/// screw is self-locking. The request is sent only once.
///
/// # Errors
/// No reply, or the gripper refuses or fails: the previous parameters stay.
pub fn identify(
    source: &mut SessionSource<'_>,
    kind: CalibrationKind,
    saves: bool,
) -> Result<bool> {
    let (op, argument) = (op::MEASURE, kind as u32);
    let reply_of = |message: &Message| reply(message, op);
    let reply = request_once(source, service(op, argument), IDENTIFICATION, reply_of)?;
    let Some(ServiceReply { status, detail, .. }) = reply else {
        bail!("{}: no reply; the fingers may have moved", source.name());
    };
    let failure = CalibrationFailure::ALL.iter().find(|failure| **failure as u32 == detail);
    match (status, failure) {
        (status::DONE, _) => {}
        (status::FAILED, Some(failure)) => {
            bail!("{}: the measurement failed: {}", source.name(), failure_text(*failure))
        }
        (status::ARMED, _) => bail!(
            "{}: the gripper refuses: a host is armed, the motor is driven, or a calibration is in progress",
            source.name()
        ),
        (status, _) => bail!("{}: the gripper refuses with status {status}", source.name()),
    }
    if saves {
        save(source).context("the result is in effect, but not saved")?;
    }
    Ok(detail == 1)
}

const fn failure_text(failure: CalibrationFailure) -> &'static str {
    match failure {
        CalibrationFailure::NotAllowed => {
            "a session is armed, a fault is latched, or a tare is in progress"
        }
        CalibrationFailure::NotReady => {
            "the motor does not begin: see the faults in `cargo magpie monitor`"
        }
        CalibrationFailure::Tripped => {
            "the motor's protection tripped: see the faults in `cargo magpie monitor`"
        }
        CalibrationFailure::Stopped => {
            "a stop frame ended it, or a stop is latched: clear it first (`cargo magpie grasp` with --clear-faults)"
        }
        CalibrationFailure::NothingGripped => {
            "nothing was gripped: put a rigid part between the fingers, at most 20 mm narrower than their opening"
        }
        CalibrationFailure::NoCurrent => "no current flows: check the motor's wires",
        CalibrationFailure::Resistance => {
            "the resistance is not plausible: check the motor's wires"
        }
        CalibrationFailure::Inductance => {
            "the inductance is not plausible: check the motor's wires"
        }
        CalibrationFailure::Stuck => {
            "the rotor does not turn: give the fingers room, and check the rotor sensor"
        }
        CalibrationFailure::PolePairs => {
            "the number of pole pairs is not plausible: check the rotor sensor's magnet"
        }
        CalibrationFailure::Slipped => "the rotor did not follow the field: nothing may be gripped",
        CalibrationFailure::Fault => "a fault stopped it: see the faults in `cargo magpie monitor`",
        CalibrationFailure::Force => "something presses on the fingers: remove it",
        CalibrationFailure::SoftPart => "the part is too soft; it might be a hand: use a rigid one",
        CalibrationFailure::CurrentSense => {
            "the measured currents do not turn with the field: exchange the current senses of V and W, or the poles of a shunt"
        }
        CalibrationFailure::TorqueConstant => {
            "the torque constant is not plausible: check the motor's type and the rotor sensor's magnet"
        }
        CalibrationFailure::Inertia => {
            "the inertia is not plausible: check the coupling, and that nothing brakes the rotor"
        }
    }
}

/// Stores a key on the gripper, or erases the one that is there; the session is over then. False if this host may not: it has
/// no session, and nobody presses the button.
///
/// # Errors
/// No reply, or the gripper cannot: the previous key stays.
pub fn write_key(source: &mut dyn Source, key: Key) -> Result<bool> {
    let (op, check) = match key {
        Key::NONE => (op::ERASE_KEY, 0),
        key => (op::WRITE_KEY, key.check_number()),
    };
    let (parts, _) = key.0.as_chunks::<4>();
    for (number, part) in (0..).zip(parts).filter(|_| key != Key::NONE) {
        let part = u32::from_le_bytes(*part);
        source.send(Message::KeyPart(KeyPart { number, part }))?;
        source.pause(KEY_PART_TIME)?;
    }
    let reply =
        request_once(source, service(op, check), SLOW_TIMEOUT, |message| reply(message, op))?;
    let why = match reply.map(|reply| reply.status) {
        Some(status::DONE) => return Ok(true),
        Some(status::NOT_PRESENT) => return Ok(false),
        Some(status::ARMED) => "a host is armed, or the motor is driven",
        Some(status::UNKNOWN) => "its firmware is older than this tool",
        Some(_) => {
            "the key did not arrive as it was sent, or the flash cannot be written: try again"
        }
        None => "it does not reply",
    };
    bail!("{}: the gripper does not change its key: {why}", source.name())
}

fn version(source: &mut dyn Source) -> Result<Version> {
    let limits = (TIMEOUT, ATTEMPTS);
    source::request(source, service(op::VERSION, 0), limits, |message| match message {
        Message::Version(version) => Some(*version),
        _ => None,
    })
}

/// Part of the description; a late reply for another part is ignored.
fn describe(source: &mut dyn Source, argument: u32) -> Result<ServiceReply> {
    let limits = (TIMEOUT, ATTEMPTS);
    source::request(source, service(op::DESCRIPTION, argument), limits, |message| {
        let reply = reply(message, op::DESCRIPTION)?;
        (u32::from(reply.extra) == argument || reply.status == status::UNKNOWN).then_some(reply)
    })
}

/// Requests a service up to [`ATTEMPTS`] times and waits for a reply for `timeout` each time.
fn request(
    source: &mut dyn Source,
    op: u8,
    argument: u32,
    timeout: Duration,
) -> Result<ServiceReply> {
    source::request(source, service(op, argument), (timeout, ATTEMPTS), |message| {
        reply(message, op)
    })
}

fn replies(source: &mut dyn Source, op: u8) -> Result<Vec<ServiceReply>> {
    Ok(receive_messages(source)?.iter().filter_map(|message| reply(message, op)).collect())
}

fn reply(message: &Message, op: u8) -> Option<ServiceReply> {
    match message {
        Message::ServiceReply(reply) if reply.op == op => Some(*reply),
        _ => None,
    }
}

/// Detail of a reply to a completed request.
fn done(source: &dyn Source, reply: ServiceReply) -> Result<u32> {
    let reasons: BTreeMap<u32, &str> = [
        (UploadError::NotBegun, "the upload was interrupted, perhaps by a reboot: try again"),
        (UploadError::Length, "it does not fit the flash"),
        (UploadError::Flash, "the flash cannot be erased or written: it may be worn out"),
        (UploadError::Code, "another host has inserted data: find it, then try again"),
    ]
    .map(|(error, why)| (error as u32, why))
    .into();
    let why = match reply.status {
        status::DONE => return Ok(reply.detail),
        status::ARMED => {
            "a host is armed or the motor is driven: end that program, or the session of one that was killed with `cargo magpie grasp --position`"
        }
        status::UNKNOWN => "the firmware is older than this tool",
        status::UNAUTHENTICATED => "the session has ended: try again",
        _ => reasons.get(&reply.detail).copied().unwrap_or("no reason known to this tool"),
    };
    bail!("{}: the gripper refuses: {why}; its calibration is unchanged", source.name())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_format_is_due_to_the_version_that_is_behind() {
        let of = |[major, minor, messages]: [u8; 3]| Version {
            firmware_major: major,
            firmware_minor: minor,
            protocol_minor: messages,
            ..Version::default()
        };
        let own = of([1, 1, 4]);
        let too_old = "too old for this calibration: flash a newer one with `cargo flash-image`";
        for (board, expected) in [
            ([1, 1, 4], "of other sources than this tool"),
            ([1, 0, 5], too_old),
            ([1, 1, 3], too_old),
            ([0, 9, 9], too_old),
            ([1, 1, 5], "newer than this tool"),
            ([2, 0, 0], "newer than this tool"),
        ] {
            let why = unknown_format(&of(board), &own);
            let version = format!("on the board (version {}.{}.", board[0], board[1]);
            assert!(why.contains(expected) && why.contains(&version), "{why}");
        }
    }
}

//! Client that reads and writes parameters of a gripper.

use std::time::Duration;

use anyhow::{Result, bail};
use firmware::parameters::schema::PARAMETERS;
use firmware::parameters::{op, status};
use firmware::protocol::messages::{Message, ParamReply, ParamRequest};

use crate::session::SessionSource;
use crate::source::{self, Source};

/// Timeout of a request and number of attempts.
const TIMEOUT: Duration = Duration::from_millis(250);
const ATTEMPTS: u32 = 8;

/// Reads a parameter.
///
/// # Errors
/// No reply, or an unknown parameter.
pub fn read(source: &mut dyn Source, id: u16) -> Result<i32> {
    request(source, op::READ, id, 0)
}

/// Sets a parameter until the next restart.
///
/// # Errors
/// No reply, or refused.
pub fn write(source: &mut SessionSource<'_>, id: u16, value: i32) -> Result<()> {
    request(source, op::WRITE, id, value).map(|_| ())
}

fn request(source: &mut dyn Source, op: u8, id: u16, value: i32) -> Result<i32> {
    let message = ParamRequest { op, id, value: value as u32, ..ParamRequest::default() };
    let message = Message::ParamRequest(message);
    let reply = source::request(source, message, (TIMEOUT, ATTEMPTS), |message| {
        let Message::ParamReply(reply) = message else { return None };
        (reply.op == op && reply.id == id).then_some(*reply)
    })?;
    match reply.status {
        status::DONE => Ok(reply.value as i32),
        _ => bail!("{}", refused(source, &reply)),
    }
}

fn refused(source: &dyn Source, reply: &ParamReply) -> String {
    let row = PARAMETERS.iter().find(|row| row.id == reply.id);
    let name = row.map_or("?", |row| row.name);
    let why = match reply.status {
        status::UNKNOWN => "unknown parameter: the firmware is older than this tool",
        status::OUT_OF_RANGE => "the value is out of range",
        status::ARMED => "a host is armed: disarm first",
        status::UNAUTHENTICATED => "the session has ended: try again",
        _ => "no reason known to this tool",
    };
    format!("{}: the gripper refuses parameter {name}: {why}", source.name())
}

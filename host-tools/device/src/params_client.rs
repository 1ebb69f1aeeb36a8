//! Client that reads and writes parameters of a gripper.

use std::time::Duration;

use anyhow::{Result, bail};
use firmware::parameters::schema::PARAMETERS;
use firmware::parameters::{op, status};
use firmware::protocol::messages::{Message, ParamReply, ParamRequest};
use firmware::protocol::serial::Packet;

use crate::session::SessionSource;
use crate::source::{ConnectionLost, Source};

/// Timeout of a request and number of attempts.
const PATIENCE: Duration = Duration::from_millis(250);
const TIMES: u32 = 8;

/// Reads a parameter.
///
/// # Errors
/// No reply, or an unknown parameter.
pub fn read(source: &mut dyn Source, id: u16) -> Result<i32> {
    ask(source, op::READ, id, 0)
}

/// Sets a parameter until the next restart.
///
/// # Errors
/// No reply, or refused.
pub fn write(source: &mut SessionSource<'_>, id: u16, value: i32) -> Result<()> {
    ask(source, op::WRITE, id, value).map(|_| ())
}

fn ask(source: &mut dyn Source, op: u8, id: u16, value: i32) -> Result<i32> {
    let request = ParamRequest { op, id, value: value as u32, ..ParamRequest::default() };
    for _ in 0..TIMES {
        source.send(Message::ParamRequest(request))?;
        let asked = source.now();
        while source.now() < asked + PATIENCE {
            let mut packets = Vec::new();
            let goes_on = source.receive(&mut packets)?;
            let answer = packets.iter().find_map(|packet| reply(packet, op, id));
            match answer {
                Some(reply) if reply.status == status::DONE => return Ok(reply.value as i32),
                Some(reply) => bail!("{}", refused(source, &reply)),
                None if goes_on => {}
                None => bail!("{}: connection closed before the reply", source.name()),
            }
        }
    }
    Err(ConnectionLost::unreachable(&source.name()).into())
}

fn reply(packet: &Packet, op: u8, id: u16) -> Option<ParamReply> {
    match packet {
        Packet::Message { message: Message::ParamReply(reply), .. }
            if reply.op == op && reply.id == id =>
        {
            Some(*reply)
        }
        _ => None,
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

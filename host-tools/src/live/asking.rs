//! Parameters of a gripper, read and written over its line or bus.

use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use firmware::parameters::table::TABLE;
use firmware::parameters::{op, status};
use firmware::wire::messages::{Message, ParamReply, ParamRequest};
use firmware::wire::serial::Packet;

use super::source::Source;

/// How long an answer may take before the question is repeated, and how often it is put.
const PATIENCE: Duration = Duration::from_millis(250);
const TIMES: u32 = 8;

/// The value of a parameter.
///
/// # Errors
/// Nobody answers, or the gripper does not know it.
pub fn read(source: &mut dyn Source, id: u16) -> Result<i32> {
    ask(source, op::READ, id, 0)
}

/// Sets a parameter until the next start.
///
/// # Errors
/// Nobody answers, or the gripper refuses.
pub fn write(source: &mut dyn Source, id: u16, value: i32) -> Result<()> {
    ask(source, op::WRITE, id, value).map(|_| ())
}

fn ask(source: &mut dyn Source, op: u8, id: u16, value: i32) -> Result<i32> {
    let request = ParamRequest {
        op,
        id,
        value: value as u32,
        ..ParamRequest::default()
    };
    for _ in 0..TIMES {
        source.say(Message::ParamRequest(request))?;
        let asked = Instant::now();
        while asked.elapsed() < PATIENCE {
            let mut packets = Vec::new();
            let goes_on = source.hear(&mut packets)?;
            let answer = packets.iter().find_map(|packet| reply(packet, op, id));
            match answer {
                Some(reply) if reply.status == status::DONE => return Ok(reply.value as i32),
                Some(reply) => bail!("{}", refused(source, &reply)),
                None if goes_on => {}
                None => bail!("{}: it ended before it answered", source.name()),
            }
        }
    }
    bail!(
        "{}: no gripper answers; is it this line or bus, is the board supplied, and does its firmware run?",
        source.name()
    )
}

fn reply(packet: &Packet, op: u8, id: u16) -> Option<ParamReply> {
    match packet {
        Packet::Message {
            message: Message::ParamReply(reply),
            ..
        } if reply.op == op && reply.id == id => Some(*reply),
        _ => None,
    }
}

fn refused(source: &dyn Source, reply: &ParamReply) -> String {
    let row = TABLE.iter().find(|row| row.id == reply.id);
    let name = row.map_or("?", |row| row.name);
    let why = match reply.status {
        status::UNKNOWN => "it does not know it: its firmware is older than this tool",
        status::OUT_OF_RANGE => "the value is beyond its range",
        status::ARMED => "somebody is armed: disarm first",
        _ => "it gives no reason that this tool knows",
    };
    format!(
        "{}: the gripper refuses parameter {name}: {why}",
        source.name()
    )
}

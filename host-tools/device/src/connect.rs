//! Opens the transport that a user names.

use anyhow::Result;

use crate::serial_port::SerialLine;
use crate::socket_can::CanBus;
use crate::socketcand::client::RemoteBus;
use crate::source::Source;

/// Opens a serial port, or a CAN bus: an interface of this machine, or HOST:PORT of a server; `None` without both.
///
/// # Errors
/// It cannot be opened.
pub fn open(
    port: Option<&str>,
    bus: Option<&str>,
    node: u16,
) -> Result<Option<Box<dyn Source + Send>>> {
    Ok(match (port, bus) {
        (Some(port), _) => Some(Box::new(SerialLine::open(port)?)),
        (None, Some(bus)) if bus.contains(':') => Some(Box::new(RemoteBus::open(bus, node)?)),
        (None, Some(interface)) => Some(Box::new(CanBus::open(interface, node)?)),
        (None, None) => None,
    })
}

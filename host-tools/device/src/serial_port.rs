//! Gripper on a serial port.

use std::io::{self, ErrorKind, Read, Write};

use anyhow::{Result, anyhow, bail};
use firmware::protocol::messages::Message;
use firmware::protocol::serial::{BAUD_RATE, MAX_PACKET_BYTES, Packet, PacketDecoder, encode};
use serialport::{ClearBuffer, SerialPort};

use crate::source::{ConnectionLost, Source, WAIT, is_pending};

pub struct SerialLine {
    port: Box<dyn SerialPort>,
    path: String,
    receiver: PacketDecoder,
    bytes: Vec<u8>,
}

impl SerialLine {
    /// Opens a port and discards earlier data.
    ///
    /// # Errors
    /// The port does not exist, access is denied, or it is in use.
    pub fn open(path: &str) -> Result<Self> {
        let port = serialport::new(path, BAUD_RATE).timeout(WAIT).open();
        let port = port.map_err(|error| refused(path, error.kind(), &error.description))?;
        // Without discarding, the first packet may be invalid.
        let _ = port.clear(ClearBuffer::Input);
        Ok(Self {
            port,
            path: path.to_owned(),
            receiver: PacketDecoder::default(),
            bytes: vec![0; 4096],
        })
    }
}

impl Source for SerialLine {
    fn receive(&mut self, packets: &mut Vec<Packet>) -> Result<bool> {
        let count = match self.port.read(&mut self.bytes) {
            Ok(0) => bail!(gone(&self.path, &io::Error::from(ErrorKind::UnexpectedEof))),
            Ok(count) => count,
            Err(error) if is_pending(&error) => 0,
            Err(error) => bail!(gone(&self.path, &error)),
        };
        let bytes = self.bytes.iter().take(count);
        packets.extend(bytes.filter_map(|byte| self.receiver.push(*byte)));
        Ok(true)
    }

    fn send(&mut self, message: Message) -> Result<()> {
        let packet = Packet::Message { copy: 0, message };
        let mut buffer = [0; MAX_PACKET_BYTES];
        let bytes = encode(&packet, &mut buffer)
            .ok_or_else(|| anyhow!("{packet:?} is too long for the line"))?;
        let written = self.port.write_all(bytes);
        written.map_err(|error| gone(&self.path, &error).into())
    }

    fn broken(&self) -> u32 {
        self.receiver.broken
    }

    fn name(&self) -> String {
        self.path.clone()
    }
}

fn gone(path: &str, error: &io::Error) -> ConnectionLost {
    ConnectionLost(format!("{path}: {error}; check the plug and the board's supply"))
}

/// Reason why a port cannot be opened, with a remedy.
fn refused(path: &str, kind: serialport::ErrorKind, description: &str) -> anyhow::Error {
    use serialport::ErrorKind::{Io, NoDevice};
    match kind {
        Io(ErrorKind::NotFound) => anyhow!("{path}: there is no such port; {}", ports()),
        Io(ErrorKind::PermissionDenied) => anyhow!(
            "{path}: permission denied; on Linux, run `sudo usermod -aG dialout $USER` and log in \
             again"
        ),
        NoDevice => anyhow!(
            "{path}: in use by another program, and a serial port serves one at a time ({description}): close that program \
             (`fuser {path}` names it), or use the CAN bus, which also carries --stop and --release meanwhile"
        ),
        _ => anyhow!("{path}: cannot be opened as a serial port ({description}); {}", ports()),
    }
}

/// Available ports.
fn ports() -> String {
    let ports = serialport::available_ports().unwrap_or_default();
    let names: Vec<String> = ports.into_iter().map(|port| port.port_name).collect();
    if names.is_empty() {
        "this computer has none: is the board plugged in?".to_owned()
    } else {
        format!("this computer has {}", names.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_open_error_has_a_remedy() {
        use serialport::ErrorKind::{Io, NoDevice, Unknown};
        let message = |kind| refused("/dev/ttyACM0", kind, "because").to_string();
        assert!(
            message(Io(ErrorKind::NotFound)).contains("there is no such port; this computer has")
        );
        assert!(message(Io(ErrorKind::PermissionDenied)).contains("usermod -aG dialout $USER"));
        assert!(message(NoDevice).contains("`fuser /dev/ttyACM0` names it"));
        assert!(message(Unknown).contains("as a serial port (because)"));
    }
}

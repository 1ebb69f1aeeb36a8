//! A gripper on a serial port.

use std::io::{self, ErrorKind, Read, Write};

use anyhow::{Result, anyhow, bail};
use firmware::wire::messages::Message;
use firmware::wire::serial::{BAUD, LONGEST, Packet, Receiver, encode};
use serialport::{ClearBuffer, SerialPort};

use super::source::{Source, WAIT};

/// The line.
pub struct SerialLine {
    port: Box<dyn SerialPort>,
    path: String,
    receiver: Receiver,
    bytes: Vec<u8>,
}

impl SerialLine {
    /// Opens a port and forgets what had come before.
    ///
    /// # Errors
    /// There is no such port, nobody may open it, or somebody has.
    pub fn open(path: &str) -> Result<Self> {
        let port = serialport::new(path, BAUD).timeout(WAIT).open();
        let port = port.map_err(|error| refused(path, error.kind(), &error.description))?;
        // A port that cannot forget gives a broken packet first.
        let _ = port.clear(ClearBuffer::Input);
        Ok(Self {
            port,
            path: path.to_owned(),
            receiver: Receiver::default(),
            bytes: vec![0; 4096],
        })
    }
}

impl Source for SerialLine {
    fn hear(&mut self, packets: &mut Vec<Packet>) -> Result<bool> {
        let count = match self.port.read(&mut self.bytes) {
            Ok(0) => bail!(
                "{}",
                gone(&self.path, &io::Error::from(ErrorKind::UnexpectedEof))
            ),
            Ok(count) => count,
            Err(error) if is_silence(&error) => 0,
            Err(error) => bail!("{}", gone(&self.path, &error)),
        };
        let bytes = self.bytes.iter().take(count);
        packets.extend(bytes.filter_map(|byte| self.receiver.take(*byte)));
        Ok(true)
    }

    fn say(&mut self, message: Message) -> Result<()> {
        let packet = Packet::Message { copy: 0, message };
        let mut buffer = [0; LONGEST];
        let bytes = encode(&packet, &mut buffer)
            .ok_or_else(|| anyhow!("{packet:?} is too long for the line"))?;
        let written = self.port.write_all(bytes);
        written.map_err(|error| anyhow!("{}", gone(&self.path, &error)))
    }

    fn broken(&self) -> u32 {
        self.receiver.broken
    }

    fn name(&self) -> String {
        self.path.clone()
    }
}

fn is_silence(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::TimedOut | ErrorKind::Interrupted | ErrorKind::WouldBlock
    )
}

fn gone(path: &str, error: &io::Error) -> String {
    format!("{path}: the line is gone ({error}); look at the plug and at the board's supply")
}

/// Why a port does not open, and what to do.
fn refused(path: &str, kind: serialport::ErrorKind, description: &str) -> anyhow::Error {
    use serialport::ErrorKind::{Io, NoDevice};
    match kind {
        Io(ErrorKind::NotFound) => anyhow!("{path}: there is no such port; {}", ports()),
        Io(ErrorKind::PermissionDenied) => anyhow!(
            "{path}: you may not open it; on Linux, `sudo usermod -aG dialout $USER` and a new login give \
             you the right"
        ),
        NoDevice => anyhow!(
            "{path}: another program has it open ({description}); close that one (`fuser {path}` names it)"
        ),
        _ => anyhow!(
            "{path}: cannot be opened as a serial port ({description}); {}",
            ports()
        ),
    }
}

/// What this computer has.
fn ports() -> String {
    let ports = serialport::available_ports().unwrap_or_default();
    let names: Vec<String> = ports.into_iter().map(|port| port.port_name).collect();
    match names.is_empty() {
        true => "this computer has none: is the board plugged in?".to_owned(),
        false => format!("this computer has {}", names.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_reason_why_a_port_does_not_open_comes_with_what_to_do() {
        use serialport::ErrorKind::{Io, NoDevice, Unknown};
        let said = |kind| refused("/dev/ttyACM0", kind, "because").to_string();
        assert!(said(Io(ErrorKind::NotFound)).contains("there is no such port; this computer has"));
        assert!(said(Io(ErrorKind::PermissionDenied)).contains("usermod -aG dialout $USER"));
        assert!(said(NoDevice).contains("`fuser /dev/ttyACM0` names it"));
        assert!(said(Unknown).contains("as a serial port (because)"));
    }
}

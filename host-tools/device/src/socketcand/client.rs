//! A gripper on a CAN bus that a program offers over TCP: `socketcand`, or `magpie dev emulate`.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow, bail};
use embedded_can::Frame;
use firmware::protocol::can::CanFrame;
use firmware::protocol::frame_id;
use firmware::protocol::messages::Message;
use firmware::protocol::serial::Packet;

use crate::socketcand::{Element, Elements};
use crate::source::{ConnectionLost, Source, WAIT, is_pending, packet};

/// Timeout of each step of the connection.
const ANSWER: Duration = Duration::from_secs(5);
/// Requested bus.
const BUS: &str = "can0";

/// TCP connection to a node on the bus.
pub struct RemoteBus {
    stream: TcpStream,
    address: String,
    node: u16,
    elements: Elements,
    /// Elements received together with the last reply.
    early: Vec<Element>,
    broken: u32,
}

impl RemoteBus {
    /// Connects to HOST:PORT in raw mode.
    ///
    /// # Errors
    /// No server, or a different protocol.
    pub fn open(address: &str, node: u16) -> Result<Self> {
        let stream = TcpStream::connect(address).map_err(|error| {
            anyhow!(
                "{address}: no connection ({error}); --can takes HOST:PORT of a running `cargo magpie dev emulate` (it prints \
                 them) or socketcand, or the name of an interface such as can0"
            )
        })?;
        stream.set_read_timeout(Some(WAIT))?;
        stream.set_nodelay(true)?;
        let mut bus = Self {
            stream,
            address: address.to_owned(),
            node,
            elements: Elements::default(),
            early: Vec::new(),
            broken: 0,
        };
        bus.expect(&Element::Hi)?;
        for request in [Element::Open(BUS.to_owned()), Element::RawMode] {
            bus.put(&request)?;
            bus.expect(&Element::Ok)?;
        }
        Ok(bus)
    }

    /// Waits for a reply.
    fn expect(&mut self, answer: &Element) -> Result<()> {
        let begun = Instant::now();
        while begun.elapsed() < ANSWER {
            let mut elements = Vec::new();
            // A server of another protocol may close the connection.
            let is_closed = self.read(&mut elements).is_err();
            if let Some(place) = elements.iter().position(|element| element == answer) {
                self.early.extend(elements.split_off(place + 1));
                return Ok(());
            }
            if let Some(Element::Error(reason)) = elements.first() {
                bail!("{}: the bus cannot be opened: {reason}", self.address);
            }
            if is_closed {
                break;
            }
        }
        bail!(
            "{}: no answer {answer}; is a server of the socketcand protocol at this address?",
            self.address
        )
    }

    /// Appends received elements.
    fn read(&mut self, elements: &mut Vec<Element>) -> Result<(), ConnectionLost> {
        elements.append(&mut self.early);
        let mut bytes = [0; 4096];
        let count = match self.stream.read(&mut bytes) {
            Ok(0) => return Err(self.gone(&ErrorKind::UnexpectedEof.into())),
            Ok(count) => count,
            Err(error) if is_pending(&error) => 0,
            Err(error) => return Err(self.gone(&error)),
        };
        for byte in bytes.iter().take(count) {
            match self.elements.take(*byte) {
                Some(Ok(element)) => elements.push(element),
                Some(Err(_)) => self.broken += 1,
                None => {}
            }
        }
        Ok(())
    }

    fn put(&mut self, element: &Element) -> Result<(), ConnectionLost> {
        let written = self.stream.write_all(element.to_string().as_bytes());
        written.map_err(|error| self.gone(&error))
    }

    fn gone(&self, error: &std::io::Error) -> ConnectionLost {
        ConnectionLost(format!("{}: {error}; is the server still running?", self.address))
    }
}

impl Source for RemoteBus {
    fn receive(&mut self, packets: &mut Vec<Packet>) -> Result<bool> {
        let mut elements = Vec::new();
        self.read(&mut elements)?;
        for element in elements {
            match element {
                Element::Frame(frame, _) => {
                    packets.extend(packet(self.node, frame.identifier(), frame.data()));
                }
                Element::Error(reason) => bail!("{}: {reason}", self.address),
                _ => {}
            }
        }
        Ok(true)
    }

    fn send(&mut self, message: Message) -> Result<()> {
        let id = frame_id(self.node, message.number());
        Ok(self.put(&Element::Send(CanFrame::from_bytes(id, message.to_bytes())))?)
    }

    fn broken(&self) -> u32 {
        self.broken
    }

    fn name(&self) -> String {
        format!("{}, node {}", self.address, self.node)
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;
    use std::thread;

    use firmware::protocol::DEFAULT_NODE;
    use firmware::protocol::messages::Heartbeat;

    use super::*;
    use crate::socketcand::server::Server;

    #[test]
    fn messages_pass_both_ways_until_the_server_closes() {
        let mut server = Server::open(0).unwrap();
        let address = server.address().to_string();
        let serving = thread::spawn(move || {
            let beat = Heartbeat { counter: 5, ..Heartbeat::default() };
            let frame = CanFrame::from_bytes(frame_id(DEFAULT_NODE, 1), beat.to_bytes());
            loop {
                server.exchange(&[(7, frame)], &[]);
                if let Some(frame) = server.next_frame() {
                    return frame;
                }
                thread::sleep(Duration::from_millis(1));
            }
        });
        let mut bus = RemoteBus::open(&address, DEFAULT_NODE).unwrap();
        let mut packets = Vec::new();
        while packets.is_empty() {
            bus.receive(&mut packets).unwrap();
        }
        let Packet::Message { message: Message::Heartbeat(beat), .. } = packets[0] else {
            panic!("{packets:?}");
        };
        assert_eq!(beat.counter, 5);
        let message = firmware::protocol::host_session::service(1, 2);
        bus.send(message).unwrap();
        let frame = serving.join().unwrap();
        assert_eq!(frame, CanFrame::from_bytes(frame_id(DEFAULT_NODE, 4), message.to_bytes()));
        let lost = loop {
            if let Err(error) = bus.receive(&mut packets) {
                break error;
            }
        };
        assert!(lost.is::<ConnectionLost>(), "{lost}");
    }

    #[test]
    fn connection_errors_name_a_remedy() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let other = thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            stream.write_all(b"220 mail.example.org ready\r\n").unwrap();
        });
        let error = RemoteBus::open(&address, DEFAULT_NODE).err().unwrap().to_string();
        assert!(error.contains("socketcand protocol"), "{error}");
        other.join().unwrap();
        let error = RemoteBus::open(&address, DEFAULT_NODE).err().unwrap().to_string();
        assert!(error.contains("cargo magpie dev emulate"), "{error}");
    }
}

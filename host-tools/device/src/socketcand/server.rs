//! Server: clients on this machine, each a node of the bus.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};

use anyhow::{Context, Result};
use firmware::protocol::can::CanFrame;

use crate::socketcand::{Element, Elements};

/// Maximum number of unread bytes before a client is disconnected.
const UNREAD: usize = 1 << 20;

/// Server state.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    clients: Vec<Client>,
    /// Client events since the last call of [`Self::take_notices`].
    notices: Vec<String>,
}

struct Client {
    stream: TcpStream,
    address: SocketAddr,
    elements: Elements,
    /// Phase: frames are exchanged after the bus is opened; received frames only in raw mode.
    is_open: bool,
    is_raw: bool,
    unsent: Vec<u8>,
}

impl Server {
    /// Listens on this machine; port 0 selects a free one.
    ///
    /// # Errors
    /// The port is in use.
    pub fn open(port: u16) -> Result<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).with_context(|| {
            format!("port {port} of 127.0.0.1 cannot be opened; choose another, or 0 for any")
        })?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        Ok(Self { listener, address, clients: Vec::new(), notices: Vec::new() })
    }

    /// Address for clients.
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Sends the bus's frames, with times in microseconds, to the clients and returns the clients' frames.
    /// Does not block.
    pub fn exchange(&mut self, sent: &[(u64, CanFrame)]) -> Vec<CanFrame> {
        self.accept();
        let mut text = String::new();
        for &(time_us, frame) in sent {
            text += &Element::Frame(frame, time_us).to_string();
        }
        for client in self.clients.iter_mut().filter(|client| client.is_raw) {
            client.unsent.extend_from_slice(text.as_bytes());
        }
        let time_us = sent.last().map_or(0, |(time_us, _)| *time_us);
        let mut received = Vec::new();
        let mut place = 0;
        while let Some(client) = self.clients.get_mut(place) {
            let first = received.len();
            let ended = client.read(&mut received, &mut self.notices).and_then(|()| client.write());
            // The other clients are nodes of the same bus.
            let others: String = received
                .iter()
                .skip(first)
                .map(|&frame| Element::Frame(frame, time_us).to_string())
                .collect();
            for (number, other) in self.clients.iter_mut().enumerate() {
                if number != place && other.is_raw {
                    other.unsent.extend_from_slice(others.as_bytes());
                }
            }
            match ended {
                Ok(()) => place += 1,
                Err(reason) => {
                    let client = self.clients.remove(place);
                    self.notices.push(format!("CAN client {} left: {reason}", client.address));
                }
            }
        }
        received
    }

    /// Client events since the last call.
    pub fn take_notices(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notices)
    }

    fn accept(&mut self) {
        // A client that disconnects before it is accepted is not an error.
        while let Ok((stream, address)) = self.listener.accept() {
            if stream.set_nonblocking(true).is_err() {
                continue;
            }
            // Send each short frame immediately, without waiting for acknowledgements.
            let _ = stream.set_nodelay(true);
            self.notices.push(format!("CAN client {address} connected"));
            self.clients.push(Client {
                stream,
                address,
                elements: Elements::default(),
                is_open: false,
                is_raw: false,
                unsent: Element::Hi.to_string().into_bytes(),
            });
        }
    }
}

impl Client {
    /// Handles received bytes; appends frames. The error is the reason for disconnecting the client.
    fn read(
        &mut self,
        received: &mut Vec<CanFrame>,
        notices: &mut Vec<String>,
    ) -> Result<(), String> {
        let mut bytes = [0; 1024];
        let count = match self.stream.read(&mut bytes) {
            Ok(0) => return Err("it closed the connection".to_owned()),
            Ok(count) => count,
            Err(error) if is_pending(&error) => return Ok(()),
            Err(error) => return Err(error.to_string()),
        };
        for &byte in bytes.iter().take(count) {
            let answer = match self.elements.take(byte) {
                None => continue,
                Some(Ok(element)) => self.handle(element, received),
                Some(Err(reason)) => Some(Element::Error(reason)),
            };
            if let Some(Element::Error(reason)) = &answer {
                notices.push(format!("CAN client {}: {reason}", self.address));
            }
            self.unsent.extend(answer.iter().flat_map(|answer| answer.to_string().into_bytes()));
        }
        Ok(())
    }

    /// Reply to an element.
    fn handle(&mut self, element: Element, received: &mut Vec<CanFrame>) -> Option<Element> {
        match element {
            // There is one bus; its name is ignored.
            Element::Open(_) => {
                self.is_open = true;
                Some(Element::Ok)
            }
            Element::Echo => Some(Element::Echo),
            Element::RawMode | Element::Send(_) if !self.is_open => {
                Some(Element::Error("no bus is open: send < open can0 > first".to_owned()))
            }
            Element::RawMode => {
                self.is_raw = true;
                Some(Element::Ok)
            }
            Element::Send(frame) => {
                received.push(frame);
                None
            }
            Element::Hi | Element::Ok | Element::Frame(..) | Element::Error(_) => {
                Some(Element::Error("only a server sends this".to_owned()))
            }
        }
    }

    fn write(&mut self) -> Result<(), String> {
        while !self.unsent.is_empty() {
            match self.stream.write(&self.unsent) {
                Ok(0) => return Err("it closed the connection".to_owned()),
                Ok(count) => {
                    self.unsent.drain(..count);
                }
                Err(error) if is_pending(&error) => break,
                Err(error) => return Err(error.to_string()),
            }
        }
        if self.unsent.len() <= UNREAD {
            Ok(())
        } else {
            Err("it does not read its data".to_owned())
        }
    }
}

fn is_pending(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// Next text from the server, which runs meanwhile.
    fn reply(server: &mut Server, stream: &mut TcpStream) -> String {
        stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        let mut bytes = [0; 1024];
        loop {
            server.exchange(&[]);
            if let Ok(count) = stream.read(&mut bytes) {
                return String::from_utf8_lossy(&bytes[..count]).into_owned();
            }
        }
    }

    fn ask(server: &mut Server, stream: &mut TcpStream, text: &str) -> String {
        stream.write_all(text.as_bytes()).unwrap();
        reply(server, stream)
    }

    #[test]
    fn client_opens_the_bus_and_frames_pass_both_ways() {
        let mut server = Server::open(0).unwrap();
        let mut stream = TcpStream::connect(server.address()).unwrap();
        assert_eq!(reply(&mut server, &mut stream), "< hi >");
        assert_eq!(ask(&mut server, &mut stream, "< open can0 >"), "< ok >");
        assert_eq!(ask(&mut server, &mut stream, "< rawmode >"), "< ok >");
        let frame = CanFrame::from_bytes(0x201, [1, 2, 3, 4, 5, 6, 7, 8]);
        server.exchange(&[(1_500_000, frame)]);
        assert_eq!(reply(&mut server, &mut stream), "< frame 201 1.500000 0102030405060708 >");
        stream.write_all(b"< send 203 8 1 2 3 4 5 6 7 8 >").unwrap();
        let mut received = Vec::new();
        while received.is_empty() {
            received = server.exchange(&[]);
        }
        assert_eq!(received, [CanFrame::from_bytes(0x203, [1, 2, 3, 4, 5, 6, 7, 8])]);
    }

    #[test]
    fn malformed_input_gets_an_error_reply() {
        let mut server = Server::open(0).unwrap();
        let mut stream = TcpStream::connect(server.address()).unwrap();
        reply(&mut server, &mut stream);
        let early = ask(&mut server, &mut stream, "< send 203 0 >");
        assert!(early.contains("< open can0 > first"), "{early}");
        let unknown = ask(&mut server, &mut stream, "\0\u{ff} >> < nonsense 1 2 >");
        assert!(unknown.starts_with("< error unknown command"), "{unknown}");
        assert_eq!(ask(&mut server, &mut stream, "< echo >"), "< echo >");
        drop(stream);
        while !server.clients.is_empty() {
            server.exchange(&[]);
        }
        let notices = server.take_notices().join("\n");
        assert!(notices.contains("nonsense") && notices.contains("left"), "{notices}");
    }

    #[test]
    fn clients_receive_frames_of_others_only() {
        let mut server = Server::open(0).unwrap();
        let mut streams = [(); 2].map(|()| TcpStream::connect(server.address()).unwrap());
        for stream in &mut streams {
            reply(&mut server, stream);
            ask(&mut server, stream, "< open can0 >");
            ask(&mut server, stream, "< rawmode >");
        }
        let [first, second] = &mut streams;
        first.write_all(b"< send 123 1 7 >").unwrap();
        assert_eq!(reply(&mut server, second), "< frame 123 0.000000 07 >");
        assert_eq!(ask(&mut server, first, "< echo >"), "< echo >");
    }
}

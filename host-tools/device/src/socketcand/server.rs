//! Server: clients on this machine, each a node of the bus.

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};

use anyhow::{Context, Result};
use firmware::protocol::can::CanFrame;

use crate::socketcand::{Element, Elements};
use crate::source::is_pending;

/// Maximum number of unread bytes before a client is disconnected.
const UNREAD: usize = 1 << 20;
/// Frames of a client that wait for the bus; then it is not read until some are sent.
const WAITING: usize = 64;
/// Clients at a time.
const MAX_CLIENTS: usize = 64;

/// Server state.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    clients: Vec<Client>,
    /// Senders of the frames that the bus has taken and not sent yet.
    on_bus: VecDeque<SocketAddr>,
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
    /// Frames that wait for the bus.
    received: VecDeque<CanFrame>,
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
        Ok(Self {
            listener,
            address,
            clients: Vec::new(),
            on_bus: VecDeque::new(),
            notices: Vec::new(),
        })
    }

    /// Address for clients.
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Sends what was on the bus, frames of the board and of clients, with times in microseconds, and reads the clients. Does not
    /// block.
    pub fn exchange(&mut self, board: &[(u64, CanFrame)], of_clients: &[(u64, CanFrame)]) {
        self.accept();
        for &(time_us, frame) in board {
            self.send(None, frame, time_us);
        }
        for &(time_us, frame) in of_clients {
            // The bus keeps the order of its frames.
            let sender = self.on_bus.pop_front();
            self.send(sender, frame, time_us);
        }
        let notices = &mut self.notices;
        self.clients.retain_mut(|client| {
            let ended = client.read(notices).and_then(|()| client.write());
            if let Err(reason) = &ended {
                notices.push(format!("CAN client {} left: {reason}", client.address));
            }
            ended.is_ok()
        });
    }

    /// Sends a frame to all clients but its sender.
    fn send(&mut self, sender: Option<SocketAddr>, frame: CanFrame, time_us: u64) {
        let text = Element::Frame(frame, time_us).to_string();
        let receive = |client: &&mut Client| client.is_raw && Some(client.address) != sender;
        for client in self.clients.iter_mut().filter(receive) {
            client.unsent.extend_from_slice(text.as_bytes());
        }
    }

    /// Frame with which a client's node wins the bus: that of the highest priority.
    pub fn next_frame(&mut self) -> Option<CanFrame> {
        let waiting = self.clients.iter_mut().filter(|client| !client.received.is_empty());
        let first =
            waiting.min_by_key(|client| client.received.front().map(CanFrame::identifier))?;
        self.on_bus.push_back(first.address);
        first.received.pop_front()
    }

    /// Client events since the last call.
    pub fn take_notices(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notices)
    }

    fn accept(&mut self) {
        // A client that disconnects before it is accepted is not an error.
        while let Ok((stream, address)) = self.listener.accept() {
            if self.clients.len() >= MAX_CLIENTS || stream.set_nonblocking(true).is_err() {
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
                received: VecDeque::new(),
            });
        }
    }
}

impl Client {
    /// Handles received bytes, unless frames wait for the bus. The error is the reason for disconnecting the client.
    fn read(&mut self, notices: &mut Vec<String>) -> Result<(), String> {
        if self.received.len() >= WAITING {
            return Ok(());
        }
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
                Some(Ok(element)) => self.handle(element),
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
    fn handle(&mut self, element: Element) -> Option<Element> {
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
                self.received.push_back(frame);
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

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use emulator::Time;
    use emulator::devices::CanBus as _;
    use sim::board::can::CanBus;

    use super::*;

    /// A bus that sends each frame at once.
    fn exchange(server: &mut Server) -> Vec<CanFrame> {
        let sent: Vec<CanFrame> = std::iter::from_fn(|| server.next_frame()).collect();
        let on_bus: Vec<(u64, CanFrame)> = sent.iter().map(|frame| (0, *frame)).collect();
        server.exchange(&[], &on_bus);
        sent
    }

    /// Next text from the server, which runs meanwhile.
    fn reply(server: &mut Server, stream: &mut TcpStream) -> String {
        stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        let mut bytes = [0; 1024];
        loop {
            exchange(server);
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
        server.exchange(&[(1_500_000, frame)], &[]);
        assert_eq!(reply(&mut server, &mut stream), "< frame 201 1.500000 0102030405060708 >");
        stream.write_all(b"< send 203 8 1 2 3 4 5 6 7 8 >").unwrap();
        let mut received = Vec::new();
        while received.is_empty() {
            received = exchange(&mut server);
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
            exchange(&mut server);
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
    #[test]
    fn frames_of_clients_take_their_time_on_the_bus() {
        let mut server = Server::open(0).unwrap();
        let mut streams = [(); 3].map(|()| TcpStream::connect(server.address()).unwrap());
        for stream in &mut streams {
            reply(&mut server, stream);
            ask(&mut server, stream, "< open can0 >");
            ask(&mut server, stream, "< rawmode >");
        }
        let [flood, other, urgent] = streams;
        // Until the server does not take more.
        flood.set_nonblocking(true).unwrap();
        let _ = (&flood).write_all("< send 223 8 1 2 3 4 5 6 7 8 >".repeat(1 << 17).as_bytes());
        other.set_nonblocking(true).unwrap();
        let mut bus = CanBus::default();
        bus.other_frames = Some(Vec::new());
        let mut text = Vec::new();
        let mut urgent_ms = None;
        // A second of the bus.
        for ms in 1..=1000 {
            let now = Time::from_ms(ms);
            while bus.next_event() <= now {
                let at = bus.next_event().max(Time::from_ms(ms - 1));
                while bus.take_event(at).is_some() {}
            }
            if ms == 500 {
                (&urgent).write_all(b"< send 001 0 >").unwrap();
            }
            let received = std::mem::take(bus.other_frames.as_mut().unwrap());
            if received.iter().any(|(_, frame)| frame.identifier() == 1) {
                urgent_ms = Some(ms);
            }
            server.exchange(&[], &received);
            while bus.waiting() < 32
                && let Some(frame) = server.next_frame()
            {
                bus.put(frame);
            }
            let _ = (&other).read_to_end(&mut text);
        }
        let count = String::from_utf8_lossy(&text).matches("< frame 223").count();
        // 135 bits a frame at 1 Mbit/s: 7407 a second.
        assert!((6000..=7410).contains(&count), "{count} frames in a second");
        // A frame of a higher priority waits for those that the bus has taken.
        assert!(urgent_ms.is_some_and(|ms| ms <= 600), "{urgent_ms:?}");
        assert!(server.clients.iter().all(|client| client.received.len() < 256));
    }
}

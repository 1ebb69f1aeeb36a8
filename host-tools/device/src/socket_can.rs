//! CAN bus of this machine (Linux SocketCAN): a gripper on it, and a bridge to a simulated bus.

#[cfg(target_os = "linux")]
pub use linux::{Bridge, CanBus};

#[cfg(target_os = "linux")]
mod linux {
    use std::io;
    use std::time::{Duration, Instant};

    use anyhow::{Result, anyhow, bail};
    use embedded_can::{Frame, Id, StandardId};
    use firmware::protocol::messages::Message;
    use firmware::protocol::serial::Packet;
    use firmware::protocol::{can as wire, frame_id};
    use socketcan::{CanFilter, CanFrame, CanSocket, Socket, SocketOptions};

    use crate::source::{ConnectionLost, Source, WAIT, is_pending, packet};

    /// Maximum number of frames per batch.
    const BATCH: usize = 64;
    /// Error number of a full queue.
    const ENOBUFS: i32 = rustix::io::Errno::NOBUFS.raw_os_error();

    /// Maximum duration of a batch, so that a steady stream does not delay commands.
    const BATCH_TIME: Duration = Duration::from_millis(5);

    /// Bus and node.
    pub struct CanBus {
        socket: CanSocket,
        interface: String,
        node: u16,
    }

    impl CanBus {
        /// Opens an interface.
        ///
        /// # Errors
        /// The interface does not exist or is down.
        pub fn open(interface: &str, node: u16) -> Result<Self> {
            let refused = |error| refused(interface, &error);
            let socket = CanSocket::open(interface).map_err(refused)?;
            let of_node = CanFilter::new(frame_id(node, 0).into(), frame_id(0x3F, 0).into());
            socket.set_filters(&[of_node]).map_err(refused)?;
            socket.set_read_timeout(WAIT).map_err(refused)?;
            Ok(Self { socket, interface: interface.to_owned(), node })
        }
    }

    fn refused(interface: &str, error: &io::Error) -> anyhow::Error {
        anyhow!(
            "{interface}: there is no such CAN bus ({error}); `ip -brief link show type can` and `... type vcan` list \
             them, `sudo ip link set can0 up type can bitrate 1000000` brings one up, `sudo ip link add vcan0 type \
             vcan && sudo ip link set vcan0 up` creates a virtual one"
        )
    }

    fn gone(interface: &str, error: &io::Error) -> anyhow::Error {
        let text = format!(
            "{interface}: {error}; `ip -details link show {interface}` states the reason, `sudo ip link set {interface} \
             up` starts the bus again"
        );
        ConnectionLost(text).into()
    }

    impl Source for CanBus {
        fn receive(&mut self, packets: &mut Vec<Packet>) -> Result<bool> {
            let begun = Instant::now();
            for number in 0..BATCH {
                if number > 0 && begun.elapsed() > BATCH_TIME {
                    break;
                }
                let frame = match self.socket.read_frame() {
                    Ok(frame) => frame,
                    Err(error) if is_pending(&error) => break,
                    Err(error) => return Err(gone(&self.interface, &error)),
                };
                if let Id::Standard(id) = frame.id() {
                    packets.extend(packet(self.node, id.as_raw(), frame.data()));
                }
            }
            Ok(true)
        }

        fn send(&mut self, message: Message) -> Result<()> {
            let id = frame_id(self.node, message.layout().number);
            let id = StandardId::new(id).ok_or_else(|| anyhow!("{id:#x} is no identifier"))?;
            let Some(frame) = CanFrame::new(id, &message.to_bytes()) else {
                bail!("{message:?} is no frame");
            };
            let written = self.socket.write_frame(&frame);
            written.map_err(|error| gone(&self.interface, &error))
        }

        /// The controller drops invalid frames.
        fn broken(&self) -> u32 {
            0
        }

        fn name(&self) -> String {
            format!("{}, node {}", self.interface, self.node)
        }
    }

    /// All frames of an interface, for a simulated bus.
    pub struct Bridge {
        socket: CanSocket,
        interface: String,
        /// Frames dropped because the interface's queue was full.
        dropped: u64,
    }

    impl Bridge {
        /// Opens an interface.
        ///
        /// # Errors
        /// The interface does not exist or is down.
        pub fn open(interface: &str) -> Result<Self> {
            let socket = CanSocket::open(interface).map_err(|error| refused(interface, &error))?;
            let set = socket.set_nonblocking(true);
            set.map_err(|error| refused(interface, &error))?;
            Ok(Self { socket, interface: interface.to_owned(), dropped: 0 })
        }

        /// Sends frames to the interface and returns received standard data frames. Does not block.
        ///
        /// # Errors
        /// The interface was removed or is down.
        pub fn exchange(
            &mut self,
            sent: impl Iterator<Item = wire::CanFrame>,
        ) -> Result<Vec<wire::CanFrame>> {
            for frame in sent {
                let frame = CanFrame::new(frame.id(), frame.data());
                let Some(frame) = frame else { continue };
                match self.socket.write_frame(&frame) {
                    Ok(()) => {}
                    // The queue is full: no acknowledgement, or the bus is slower than the frames.
                    Err(error) if is_pending(&error) || error.raw_os_error() == Some(ENOBUFS) => {
                        self.dropped += 1;
                    }
                    Err(error) => return Err(gone(&self.interface, &error)),
                }
            }
            let mut received = Vec::new();
            for _ in 0..BATCH {
                match self.socket.read_frame() {
                    Ok(CanFrame::Data(frame)) => {
                        received.extend(wire::CanFrame::new(frame.id(), frame.data()));
                    }
                    Ok(_) => {}
                    Err(error) if is_pending(&error) => break,
                    Err(error) => return Err(gone(&self.interface, &error)),
                }
            }
            Ok(received)
        }

        /// Frames dropped because the interface's queue was full.
        pub const fn dropped(&self) -> u64 {
            self.dropped
        }
    }
}

#[cfg(not(target_os = "linux"))]
pub use elsewhere::{Bridge, CanBus};

#[cfg(not(target_os = "linux"))]
mod elsewhere {
    use anyhow::{Result, bail};
    use firmware::protocol::can::CanFrame;
    use firmware::protocol::messages::Message;
    use firmware::protocol::serial::Packet;

    use crate::source::Source;

    /// Not available: SocketCAN exists on Linux only.
    pub enum CanBus {}

    impl CanBus {
        /// Returns the error.
        ///
        /// # Errors
        /// Always.
        pub fn open(interface: &str, _: u16) -> Result<Self> {
            bail!("{interface}: only Linux has SocketCAN; use the serial line, --port")
        }
    }

    impl Source for CanBus {
        fn receive(&mut self, _: &mut Vec<Packet>) -> Result<bool> {
            match *self {}
        }

        fn send(&mut self, _: Message) -> Result<()> {
            match *self {}
        }

        fn broken(&self) -> u32 {
            match *self {}
        }

        fn name(&self) -> String {
            match *self {}
        }
    }

    /// Not available: SocketCAN exists on Linux only.
    pub enum Bridge {}

    impl Bridge {
        /// Returns the error.
        ///
        /// # Errors
        /// Always.
        pub fn open(interface: &str) -> Result<Self> {
            bail!(
                "{interface}: only Linux has SocketCAN; leave --can out, and clients connect over TCP"
            )
        }

        /// Not reached.
        ///
        /// # Errors
        /// Never.
        pub fn exchange(&mut self, _: impl Iterator<Item = CanFrame>) -> Result<Vec<CanFrame>> {
            match *self {}
        }

        /// Not reached.
        pub const fn dropped(&self) -> u64 {
            match *self {}
        }
    }
}

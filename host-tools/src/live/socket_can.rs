//! A gripper on a CAN bus, as Linux has them.

#[cfg(target_os = "linux")]
pub use linux::CanBus;

#[cfg(target_os = "linux")]
mod linux {
    use std::io::{self, ErrorKind};

    use anyhow::{Result, anyhow, bail};
    use embedded_can::{Frame, Id, StandardId};
    use firmware::wire::identifier;
    use firmware::wire::messages::Message;
    use firmware::wire::serial::Packet;
    use socketcan::{CanFilter, CanFrame, CanSocket, Socket, SocketOptions};

    use crate::live::source::{Source, WAIT, packet};

    /// Frames that are taken at once.
    const BATCH: usize = 64;

    /// The bus and the node on it.
    pub struct CanBus {
        socket: CanSocket,
        interface: String,
        node: u16,
    }

    impl CanBus {
        /// Joins the bus of an interface.
        ///
        /// # Errors
        /// There is no such interface, or it is down.
        pub fn open(interface: &str, node: u16) -> Result<Self> {
            let refused = |error: io::Error| {
                anyhow!(
                    "{interface}: there is no such CAN bus ({error}); `ip -brief link show type can` lists \
                     them, `sudo ip link set can0 up type can bitrate 1000000` brings one up"
                )
            };
            let socket = CanSocket::open(interface).map_err(refused)?;
            let of_node = CanFilter::new(identifier(node, 0).into(), identifier(0x3F, 0).into());
            socket.set_filters(&[of_node]).map_err(refused)?;
            socket.set_read_timeout(WAIT).map_err(refused)?;
            Ok(Self {
                socket,
                interface: interface.to_owned(),
                node,
            })
        }

        fn gone(&self, error: &io::Error) -> anyhow::Error {
            anyhow!(
                "{0}: the bus is gone ({error}); `ip -details link show {0}` says why, `sudo ip link set {0} \
                 up` brings it back",
                self.interface
            )
        }
    }

    impl Source for CanBus {
        fn hear(&mut self, packets: &mut Vec<Packet>) -> Result<bool> {
            for _ in 0..BATCH {
                let frame = match self.socket.read_frame() {
                    Ok(frame) => frame,
                    Err(error) => match error.kind() {
                        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted => {
                            break;
                        }
                        _ => return Err(self.gone(&error)),
                    },
                };
                if let Id::Standard(id) = frame.id() {
                    packets.extend(packet(self.node, id.as_raw(), frame.data()));
                }
            }
            Ok(true)
        }

        fn say(&mut self, message: Message) -> Result<()> {
            let id = identifier(self.node, message.layout().number);
            let id = StandardId::new(id).ok_or_else(|| anyhow!("{id:#x} is no identifier"))?;
            let Some(frame) = CanFrame::new(id, &message.to_bytes()) else {
                bail!("{message:?} is no frame");
            };
            let written = self.socket.write_frame(&frame);
            written.map_err(|error| self.gone(&error))
        }

        /// The controller drops what is broken.
        fn broken(&self) -> u32 {
            0
        }

        fn name(&self) -> String {
            format!("{}, node {}", self.interface, self.node)
        }
    }
}

#[cfg(not(target_os = "linux"))]
pub use elsewhere::CanBus;

#[cfg(not(target_os = "linux"))]
mod elsewhere {
    use anyhow::{Result, bail};
    use firmware::wire::messages::Message;
    use firmware::wire::serial::Packet;

    use crate::live::source::Source;

    /// No bus: only Linux has SocketCAN.
    pub enum CanBus {}

    impl CanBus {
        /// Says so.
        ///
        /// # Errors
        /// Always.
        pub fn open(interface: &str, _: u16) -> Result<Self> {
            bail!("{interface}: only Linux has SocketCAN; use the serial line, --port")
        }
    }

    impl Source for CanBus {
        fn hear(&mut self, _: &mut Vec<Packet>) -> Result<bool> {
            match *self {}
        }

        fn say(&mut self, _: Message) -> Result<()> {
            match *self {}
        }

        fn broken(&self) -> u32 {
            match *self {}
        }

        fn name(&self) -> String {
            match *self {}
        }
    }
}

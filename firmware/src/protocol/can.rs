//! CAN frames, and the interface of a CAN controller.

use embedded_can::{Frame, Id, StandardId};

use crate::protocol::messages::BYTES;

/// A classic frame with an identifier of 11 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanFrame {
    id: StandardId,
    bytes: [u8; BYTES],
    length: u8,
}

impl CanFrame {
    /// A frame of eight bytes with the lower 11 bits of `id`.
    pub fn from_bytes(id: u16, bytes: [u8; BYTES]) -> Self {
        let id = StandardId::new(id & StandardId::MAX.as_raw()).unwrap_or(StandardId::ZERO);
        Self { id, bytes, length: BYTES as u8 }
    }

    /// The identifier.
    pub fn identifier(&self) -> u16 {
        self.id.as_raw()
    }
}

impl Frame for CanFrame {
    fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        let Id::Standard(id) = id.into() else {
            return None;
        };
        let mut bytes = [0; BYTES];
        bytes.get_mut(..data.len())?.copy_from_slice(data);
        Some(Self { id, bytes, length: data.len() as u8 })
    }

    fn new_remote(_: impl Into<Id>, _: usize) -> Option<Self> {
        None
    }

    fn is_extended(&self) -> bool {
        false
    }

    fn is_remote_frame(&self) -> bool {
        false
    }

    fn id(&self) -> Id {
        self.id.into()
    }

    fn dlc(&self) -> usize {
        usize::from(self.length)
    }

    fn data(&self) -> &[u8] {
        self.bytes.get(..self.dlc()).unwrap_or(&self.bytes)
    }
}

/// Why a frame was not sent or received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CanError {
    /// The controller has disconnected after too many errors.
    BusOff,
    /// Any other error on the bus; communication continues.
    Transient,
}

/// Transmitting half of a controller.
pub trait CanSender {
    /// Sends a frame; completes when it is on the bus.
    ///
    /// # Errors
    /// Errors of the controller.
    fn send(&mut self, frame: &CanFrame) -> impl Future<Output = Result<(), CanError>>;

    /// Starts the recovery after [`CanError::BusOff`].
    fn rejoin(&mut self);
}

/// Receiving half of a controller.
pub trait CanReceiver {
    /// The next frame for this node.
    ///
    /// # Errors
    /// Errors of the controller.
    fn receive(&mut self) -> impl Future<Output = Result<CanFrame, CanError>>;
}

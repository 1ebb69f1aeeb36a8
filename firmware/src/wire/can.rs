//! The CAN bus as the loops see it.

use embedded_can::{Frame, Id, StandardId};

use super::messages::BYTES;

/// A classic frame with an identifier of 11 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanFrame {
    id: StandardId,
    bytes: [u8; BYTES],
    length: u8,
}

impl CanFrame {
    /// A frame of eight bytes; the identifier's upper bits are cut off.
    pub fn of(id: u16, bytes: [u8; BYTES]) -> Self {
        let id = StandardId::new(id & StandardId::MAX.as_raw()).unwrap_or(StandardId::ZERO);
        Self {
            id,
            bytes,
            length: BYTES as u8,
        }
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
        Some(Self {
            id,
            bytes,
            length: data.len() as u8,
        })
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

/// Why a frame did not go out or come in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CanError {
    /// The controller has left the bus: too many errors.
    BusOff,
    /// Something else on the bus; it goes on.
    Passing,
}

/// Frames out.
pub trait CanSender {
    /// Hands a frame over for the bus; ends when it has gone.
    ///
    /// # Errors
    /// The controller's.
    fn send(&mut self, frame: &CanFrame) -> impl Future<Output = Result<(), CanError>>;

    /// Joins the bus again after [`CanError::BusOff`].
    fn rejoin(&mut self);
}

/// Frames in.
pub trait CanReceiver {
    /// The next frame for this node.
    ///
    /// # Errors
    /// The controller's.
    fn receive(&mut self) -> impl Future<Output = Result<CanFrame, CanError>>;
}

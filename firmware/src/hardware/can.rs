//! The CAN controller behind the traits of the loops.

use embassy_stm32::can::enums::BusErrorMode;
use embassy_stm32::can::filter::{Action, FilterType, StandardFilter, StandardFilterSlot};
use embassy_stm32::can::frame::Frame;
use embassy_stm32::can::{CanRx, CanTx, Properties};
use embassy_stm32::pac;
use embedded_can::{Frame as _, Id, StandardId};

use crate::wire::can::{CanError, CanFrame, CanReceiver, CanSender};
use crate::wire::{STOP_ALL, identifier};

/// Frames out.
pub struct Sender {
    /// The driver's half.
    pub half: CanTx<'static>,
    /// What the controller says of itself.
    pub properties: Properties,
}

impl Sender {
    /// Lets the frames for this node in, and the stop for all. Masks, since the driver's ranges are swapped.
    pub fn listen_as(&self, node: u16) {
        let id = |id| StandardId::new(id).unwrap_or(StandardId::ZERO);
        let own = FilterType::BitMask {
            filter: identifier(node, 0),
            mask: identifier(u16::MAX, 0),
        };
        let all = FilterType::DedicatedSingle(id(STOP_ALL));
        for (slot, filter) in [(StandardFilterSlot::_0, own), (StandardFilterSlot::_1, all)] {
            let action = Action::StoreInFifo0;
            let filter = StandardFilter { filter, action };
            self.properties.set_standard_filter(slot, filter);
        }
    }
}

impl CanSender for Sender {
    async fn send(&mut self, frame: &CanFrame) -> Result<(), CanError> {
        let mut next = Frame::new_standard(frame.identifier(), frame.data()).ok();
        while let Some(frame) = next {
            if matches!(self.properties.bus_error_mode(), BusErrorMode::BusOff) {
                return Err(CanError::BusOff);
            }
            // The driver takes a frame of less priority back out for a more important one.
            next = self.half.write(&frame).await;
        }
        Ok(())
    }

    fn rejoin(&mut self) {
        // The controller counts 128 times eleven recessive bits by itself then.
        pac::FDCAN1.cccr().modify(|w| w.set_init(false));
    }
}

/// Frames in.
pub struct Receiver(pub CanRx<'static>);

impl CanReceiver for Receiver {
    async fn receive(&mut self) -> Result<CanFrame, CanError> {
        let envelope = self.0.read().await.map_err(|_| {
            // The driver's error does not say so.
            match pac::FDCAN1.psr().read().bo() {
                true => CanError::BusOff,
                false => CanError::Passing,
            }
        })?;
        let id: Id = (*envelope.frame.id()).into();
        CanFrame::new(id, envelope.frame.data()).ok_or(CanError::Passing)
    }
}

//! CAN controller: implements [`CanSender`] and [`CanReceiver`].

use embassy_stm32::can::enums::BusErrorMode;
use embassy_stm32::can::filter::{Action, FilterType, StandardFilter, StandardFilterSlot};
use embassy_stm32::can::frame::Frame;
use embassy_stm32::can::{CanRx, CanTx, Properties};
use embassy_stm32::pac;
use embedded_can::{Frame as _, Id, StandardId};

use crate::protocol::can::{CanError, CanFrame, CanReceiver, CanSender};
use crate::protocol::{ESTOP_ALL_ID, frame_id};

/// Transmitting half of the controller.
pub struct Sender {
    /// Transmitting half of the driver.
    pub half: CanTx<'static>,
    /// Status and filters of the controller.
    pub properties: Properties,
}

impl Sender {
    /// Accepts the frames for this node and the emergency stop for all nodes. Uses masks because the ranges of the driver
    /// are swapped.
    pub fn accept_node(&self, node: u16) {
        let id = |id| StandardId::new(id).unwrap_or(StandardId::ZERO);
        let own = FilterType::BitMask { filter: frame_id(node, 0), mask: frame_id(u16::MAX, 0) };
        let all = FilterType::DedicatedSingle(id(ESTOP_ALL_ID));
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
            // Waits for room; the driver returns no pending frame in the mode of a FIFO.
            next = self.half.write(&frame).await;
        }
        Ok(())
    }

    fn rejoin(&mut self) {
        // The controller then counts 128 times eleven recessive bits by itself.
        pac::FDCAN1.cccr().modify(|w| w.set_init(false));
    }
}

/// Receiving half of the driver.
pub struct Receiver(pub CanRx<'static>);

impl CanReceiver for Receiver {
    async fn receive(&mut self) -> Result<CanFrame, CanError> {
        let envelope = self.0.read().await.map_err(|_| {
            // The error of the driver does not distinguish bus-off.
            if pac::FDCAN1.psr().read().bo() { CanError::BusOff } else { CanError::Transient }
        })?;
        let id: Id = (*envelope.frame.id()).into();
        CanFrame::new(id, envelope.frame.data()).ok_or(CanError::Transient)
    }
}

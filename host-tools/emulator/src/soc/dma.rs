//! Transfers of DMA between peripherals and memories.

use super::Soc;
use super::map::{Block, Request};
use super::memory::{CCM, CCM_ALIAS, SRAM};
use crate::peripherals::dma::Transfer;
use crate::violations::Kind;

impl Soc {
    /// Makes every transfer for which a request line is high.
    pub(super) fn serve_dma(&mut self) {
        let mut has_moved = false;
        while let Some(channel) = self.requested_channel() {
            let transfer = self.dma.next_transfer(channel);
            self.transfer(&transfer);
            has_moved = true;
        }
        if has_moved {
            self.refresh(Block::Dma(0));
        }
    }

    fn requested_channel(&self) -> Option<usize> {
        let mut waiting = self.dma.waiting();
        let is_high = |request: &Request| match request.block {
            Block::I2c(number) => self.i2c[number].dma_requests()[request.line],
            Block::Spi(number) => self.spi[number].dma_requests()[request.line],
            _ => self.usart.dma_requests()[request.line],
        };
        waiting
            .find(|(_, id)| self.requests[usize::from(*id)].as_ref().is_some_and(is_high))
            .map(|(channel, _)| channel)
    }

    fn transfer(&mut self, transfer: &Transfer) {
        let peripheral = transfer.peripheral;
        let is_done = if transfer.to_peripheral {
            let value = self.dma_read(transfer.memory, transfer.memory_width);
            value.is_some_and(|value| {
                self.access(peripheral, transfer.peripheral_width, Some(value)).is_some()
            })
        } else {
            let value = self.access(peripheral, transfer.peripheral_width, None);
            value.is_some_and(|value| self.dma_write(transfer.memory, transfer.memory_width, value))
        };
        if !is_done {
            let address = transfer.memory;
            self.violations.report(Kind::DmaAddress, address, "no memory that DMA reaches");
            self.dma.fail(transfer.channel);
        }
    }

    /// DMA reads SRAM, CCM by the system bus's address, and flash.
    fn dma_read(&mut self, address: u32, width: u32) -> Option<u32> {
        let bytes = match address {
            CCM_ALIAS.. => self.memory(address - CCM_ALIAS + CCM, width as usize),
            CCM..SRAM => None,
            _ => self.memory(address, width as usize),
        }?;
        Some(bytes.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte)))
    }

    fn dma_write(&mut self, address: u32, width: u32, value: u32) -> bool {
        let bytes = value.to_le_bytes();
        let bytes = &bytes[..width as usize];
        match address {
            CCM_ALIAS.. => self.write_memory(address - CCM_ALIAS + CCM, bytes),
            SRAM.. => {
                let offset = (address - SRAM) as usize;
                let place = self.sram.get_mut(offset..offset + bytes.len());
                place.is_some_and(|place| {
                    place.copy_from_slice(bytes);
                    true
                })
            }
            _ => false,
        }
    }
}

//! A bus of the chip that can be cleared: the driver is dropped, the lines are clocked by hand, and it
//! is made anew.

use embassy_stm32::gpio::{Flex, Level, Speed};
use embassy_stm32::i2c::{self, I2c, Master};
use embassy_stm32::mode::Async;
use embedded_hal_async::i2c::{ErrorType, I2c as Transfers, Operation};

use super::clock::BoardClock;
use crate::hall::bus::{Lines, SensorBus, clear};

/// The driver of the chip.
pub type Driver = I2c<'static, Async, Master>;

/// A bus with sensors.
pub struct BoardBus {
    driver: Option<Driver>,
    open: fn() -> Driver,
    pins: fn() -> [Flex<'static>; 2],
}

impl BoardBus {
    /// `open` makes the driver, `pins` gives clock and data while there is none.
    pub fn new(open: fn() -> Driver, pins: fn() -> [Flex<'static>; 2]) -> Self {
        Self {
            driver: Some(open()),
            open,
            pins,
        }
    }
}

impl ErrorType for BoardBus {
    type Error = i2c::Error;
}

impl Transfers for BoardBus {
    async fn write_read(
        &mut self,
        address: u8,
        write: &[u8],
        read: &mut [u8],
    ) -> Result<(), Self::Error> {
        match &mut self.driver {
            Some(driver) => driver.write_read(address, write, read).await,
            None => Err(i2c::Error::Bus),
        }
    }

    /// Reads in it have no time-out in this driver: the loops use [`Transfers::write_read`] only.
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), Self::Error> {
        match &mut self.driver {
            Some(driver) => driver.transaction(address, operations).await,
            None => Err(i2c::Error::Bus),
        }
    }
}

impl SensorBus for BoardBus {
    async fn recover(&mut self) -> bool {
        self.driver = None;
        let [clock, data] = (self.pins)();
        let free = {
            let mut pins = Pins { clock, data };
            for pin in [&mut pins.clock, &mut pins.data] {
                pin.set_high();
                pin.set_as_input_output(Speed::VeryHigh);
            }
            clear(&mut pins, &BoardClock).await
        };
        self.driver = Some((self.open)());
        free
    }
}

/// The lines as open-drain pins.
struct Pins {
    clock: Flex<'static>,
    data: Flex<'static>,
}

impl Lines for Pins {
    fn set_clock(&mut self, high: bool) {
        self.clock.set_level(level(high));
    }

    fn set_data(&mut self, high: bool) {
        self.data.set_level(level(high));
    }

    fn levels(&mut self) -> [bool; 2] {
        [self.clock.is_high(), self.data.is_high()]
    }
}

fn level(high: bool) -> Level {
    match high {
        true => Level::High,
        false => Level::Low,
    }
}

//! The rotor's angle sensor, an AS5047P on SPI1 at 10 MHz: a frame in each period, which nobody waits for. Its
//! answer is read in the next period.

use core::mem::forget;

use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::spi::{self, MODE_1, Spi};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Peri, pac, peripherals};

use crate::motor::as5047::{READ_ANGLE, angle};
use crate::motor::stage::{Encoder, EncoderError};

const PORT: pac::spi::Spi = pac::SPI1;
/// Of the angle when the currents are sensed, in periods: a frame asks, the next one brings the answer, and
/// that is read a period later. Assumed, to be measured on a board.
pub const AGE_PERIODS: f32 = 2.0;

/// Clock, data out, data in, select.
pub type Pins = (
    Peri<'static, peripherals::PA5>,
    Peri<'static, peripherals::PA7>,
    Peri<'static, peripherals::PA6>,
    Peri<'static, peripherals::PA4>,
);

/// The sensor.
pub struct RotorSensor {
    select: Output<'static>,
}

impl RotorSensor {
    /// Takes the port; nothing is asked yet.
    pub fn new(port: Peri<'static, peripherals::SPI1>, pins: Pins) -> Self {
        let (clock, out, into, select) = pins;
        let mut config = spi::Config::default();
        config.mode = MODE_1;
        config.frequency = Hertz(10_000_000);
        // The driver waits for its transfers: it sets up the port, and its registers are used from then on.
        forget(Spi::new_blocking(port, clock, out, into, config));
        PORT.cr1().modify(|w| w.set_spe(false));
        PORT.cr2().modify(|w| {
            w.set_ds(pac::spi::vals::Ds::BITS16);
            w.set_frxth(pac::spi::vals::Frxth::HALF);
        });
        PORT.cr1().modify(|w| w.set_spe(true));
        Self {
            select: Output::new(select, Level::High, Speed::VeryHigh),
        }
    }

    /// Selects the sensor. It wants 350 ns from here to [`Self::ask`].
    pub fn select(&mut self) {
        self.select.set_low();
    }

    /// Starts a frame, 1.6 us.
    pub fn ask(&mut self) {
        PORT.dr16().write_value(READ_ANGLE);
    }
}

impl Encoder for RotorSensor {
    /// The answer of the last frame, which ends with it.
    fn angle(&mut self) -> Result<u16, EncoderError> {
        self.select.set_high();
        match PORT.sr().read().rxne() {
            true => angle(PORT.dr16().read()),
            false => Err(EncoderError::Silent),
        }
    }
}

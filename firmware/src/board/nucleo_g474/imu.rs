//! Inertial sensor: an LSM6DS3TR-C on SPI3, with DMA.

use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::mode::Async;
use embassy_stm32::spi::mode::Master;
use embassy_stm32::spi::{Config, MODE_3, Spi};
use embassy_stm32::{Peri, bind_interrupts, dma, peripherals};
use embassy_time::Delay;
use embedded_hal_bus::spi::ExclusiveDevice;

use crate::board::selected::peripherals::bus_frequency;
use crate::sensors::imu::Lsm6ds3;

/// The sensor on its bus.
pub type InertialSensor =
    Lsm6ds3<ExclusiveDevice<Spi<'static, Async, Master>, Output<'static>, Delay>>;

bind_interrupts!(struct Interrupts {
    DMA1_CHANNEL3 => dma::InterruptHandler<peripherals::DMA1_CH3>;
    DMA1_CHANNEL4 => dma::InterruptHandler<peripherals::DMA1_CH4>;
});

/// Port, pins and DMA channels.
pub struct Parts {
    /// SPI port.
    pub port: Peri<'static, peripherals::SPI3>,
    /// SCK.
    pub clock: Peri<'static, peripherals::PC10>,
    /// MOSI.
    pub out: Peri<'static, peripherals::PC12>,
    /// MISO.
    pub into: Peri<'static, peripherals::PC11>,
    /// CS.
    pub select: Peri<'static, peripherals::PD2>,
    /// Transmit and receive channel.
    pub channels: (Peri<'static, peripherals::DMA1_CH3>, Peri<'static, peripherals::DMA1_CH4>),
}

/// Configures the port; the sensor is not accessed yet.
pub fn inertial_sensor(parts: Parts) -> InertialSensor {
    let Parts { port, clock, out, into, select, channels: (transmit, receive) } = parts;
    let mut config = Config::default();
    config.mode = MODE_3;
    config.frequency = bus_frequency(5_000_000);
    let bus = Spi::new(port, clock, out, into, transmit, receive, Interrupts, config);
    let select = Output::new(select, Level::High, Speed::VeryHigh);
    let Ok(device) = ExclusiveDevice::new(bus, select, Delay);
    Lsm6ds3::new(device)
}

//! The reference board, a NUCLEO-G474RE: clocks, pins, buses. Another board is one more such file.
//!
//! The paper's own board is not public: every pin here is assumed.
//!
//! | what | pins |
//! | --- | --- |
//! | sensors 0 and 1 | I2C1: SCL PB8, SDA PB9 |
//! | sensors 2 and 3 | I2C3: SCL PC8, SDA PC9 |
//! | CAN | FDCAN1: RX PA11, TX PA12, to a transceiver |

use embassy_stm32::can::config::{FdCanConfig, NominalBitTiming};
use embassy_stm32::can::{self, Can, CanConfigurator};
use embassy_stm32::i2c::{self, I2c, Master};
use embassy_stm32::mode::Async;
use embassy_stm32::time::Hertz;
use embassy_stm32::{bind_interrupts, dma, peripherals, rcc};
use embassy_time::Duration;

/// A bus with two sensors.
pub type SensorBus = I2c<'static, Async, Master>;

bind_interrupts!(struct Interrupts {
    I2C1_EV => i2c::EventInterruptHandler<peripherals::I2C1>;
    I2C1_ER => i2c::ErrorInterruptHandler<peripherals::I2C1>;
    I2C3_EV => i2c::EventInterruptHandler<peripherals::I2C3>;
    I2C3_ER => i2c::ErrorInterruptHandler<peripherals::I2C3>;
    DMA1_CHANNEL1 => dma::InterruptHandler<peripherals::DMA1_CH1>;
    DMA1_CHANNEL2 => dma::InterruptHandler<peripherals::DMA1_CH2>;
    DMA1_CHANNEL3 => dma::InterruptHandler<peripherals::DMA1_CH3>;
    DMA1_CHANNEL4 => dma::InterruptHandler<peripherals::DMA1_CH4>;
    FDCAN1_IT0 => can::IT0InterruptHandler<peripherals::FDCAN1>;
    FDCAN1_IT1 => can::IT1InterruptHandler<peripherals::FDCAN1>;
});

/// The board's parts, ready to be handed to the tasks.
pub struct Board {
    /// Sensors 0 and 1, then 2 and 3.
    pub sensor_buses: [SensorBus; 2],
    /// Classic CAN at 1 Mbit/s.
    pub can: Can<'static>,
}

/// Starts clocks and buses.
pub fn bring_up() -> Board {
    let p = embassy_stm32::init(clocks());
    Board {
        sensor_buses: [
            I2c::new(
                p.I2C1,
                p.PB8,
                p.PB9,
                p.DMA1_CH1,
                p.DMA1_CH2,
                Interrupts,
                sensor_bus(),
            ),
            I2c::new(
                p.I2C3,
                p.PC8,
                p.PC9,
                p.DMA1_CH3,
                p.DMA1_CH4,
                Interrupts,
                sensor_bus(),
            ),
        ],
        can: {
            let mut can = CanConfigurator::new(p.FDCAN1, p.PA11, p.PA12, Interrupts);
            can.set_config(can_timing());
            can.into_normal_mode()
        },
    }
}

/// Crystal 24 MHz / 6 * 80 = 320 MHz: 160 MHz for the core, 80 MHz for CAN. The I2C kernels run on
/// the 16 MHz oscillator: the driver's timing calculation overflows above 40 MHz.
fn clocks() -> embassy_stm32::Config {
    let mut config = embassy_stm32::Config::default();
    config.rcc.hsi = true;
    config.rcc.hse = Some(rcc::Hse {
        freq: Hertz(24_000_000),
        mode: rcc::HseMode::Oscillator,
    });
    config.rcc.pll = Some(rcc::Pll {
        source: rcc::PllSource::HSE,
        prediv: rcc::PllPreDiv::DIV6,
        mul: rcc::PllMul::MUL80,
        divp: None,
        divq: Some(rcc::PllQDiv::DIV4),
        divr: Some(rcc::PllRDiv::DIV2),
    });
    config.rcc.sys = rcc::Sysclk::PLL1_R;
    config.rcc.boost = true;
    config.rcc.mux.fdcansel = rcc::mux::Fdcansel::PLL1_Q;
    config.rcc.mux.i2c1sel = rcc::mux::I2csel::HSI;
    config.rcc.mux.i2c3sel = rcc::mux::I2csel::HSI;
    config
}

/// 400 kHz: two sensors take 510 us of a millisecond. A sensor that does not answer holds the bus
/// for a quarter of a millisecond, not for the driver's default of a second.
fn sensor_bus() -> i2c::Config {
    let mut config = i2c::Config::default();
    config.frequency = Hertz(400_000);
    config.timeout = Duration::from_micros(250);
    config
}

/// 80 MHz / 4 / (1 + 15 + 4) = 1 Mbit/s, sampled at 80 %.
fn can_timing() -> FdCanConfig {
    let non_zero = |n: u8| core::num::NonZeroU8::new(n).unwrap_or(core::num::NonZeroU8::MIN);
    FdCanConfig::default().set_nominal_bit_timing(NominalBitTiming {
        prescaler: core::num::NonZeroU16::new(4).unwrap_or(core::num::NonZeroU16::MIN),
        seg1: non_zero(15),
        seg2: non_zero(4),
        sync_jump_width: non_zero(4),
    })
}

//! The reference board, a NUCLEO-G474RE: clocks, pins, buses. Another board is one more such file.
//!
//! The paper's own board is not public: every pin here is assumed.
//!
//! | what | pins |
//! | --- | --- |
//! | sensors 0 and 1 | I2C1: SCL PB8, SDA PB9 |
//! | sensors 2 and 3 | I2C3: SCL PC8, SDA PC9 |
//! | CAN | FDCAN1: RX PA11, TX PA12, to a transceiver |
//! | serial line | USART2: TX PA2, RX PA3, to the debugger's virtual port |
//! | half bridges | TIM1: high sides PA8, PA9, PA10, low sides PB13, PB14, PB15; break PB12, low |
//! | phases' currents, bus | ADC1: PC0, PC1, PC2; PC3 |
//! | rotor's angle | SPI1: clock PA5, out PA7, in PA6, select PA4 |
//!
//! The sensors' buses have pull-ups of 1 kOhm (assumed): 1 MHz needs rising edges within 120 ns.

use embassy_stm32::can::config::{FdCanConfig, NominalBitTiming};
use embassy_stm32::can::{self, CanConfigurator};
use embassy_stm32::gpio::Flex;
use embassy_stm32::i2c::{self, I2c};
use embassy_stm32::interrupt::Priority;
use embassy_stm32::mode::Async;
use embassy_stm32::rng::{self, Rng};
use embassy_stm32::time::Hertz;
use embassy_stm32::usart::{self, RingBufferedUartRx, Uart, UartTx};
use embassy_stm32::{Peri, Peripherals, bind_interrupts, dma, pac, peripherals, rcc};
use embassy_time::Duration;
use static_cell::ConstStaticCell;

use super::can::{Receiver, Sender};
use super::flash::{self, Pages};
use super::sensor_bus::{BoardBus, Driver};
use super::{critical, drive, power_stage};
use crate::bus_timing::{Edges, Mode, timing};
use crate::params::TRANSFER_LIMIT_US;
use crate::store::Store;
use crate::wire::serial::BAUD;

/// Clock of the I2C peripherals: the oscillator of 16 MHz. The driver's own calculation overflows above
/// 40 MHz.
const I2C_HZ: u32 = 16_000_000;
/// Edges of the sensors' buses in nanoseconds, assumed: 1 kOhm, 100 pF.
const EDGES: Edges = Edges { rise: 85, fall: 20 };
/// What the register of a sensor bus holds.
const TIMING: u32 = match timing(I2C_HZ, Mode::FastPlus, EDGES) {
    Some(timing) => timing.word(),
    None => panic!("no timing for these edges"),
};
/// Bytes that wait between two looks at the serial line: 2.5 ms of them.
const LINE_BYTES: usize = 256;
/// This board in [`crate::wire::messages::Version`].
pub const HARDWARE: u8 = 1;

bind_interrupts!(struct Interrupts {
    I2C1_EV => i2c::EventInterruptHandler<peripherals::I2C1>;
    I2C1_ER => i2c::ErrorInterruptHandler<peripherals::I2C1>;
    I2C3_EV => i2c::EventInterruptHandler<peripherals::I2C3>;
    I2C3_ER => i2c::ErrorInterruptHandler<peripherals::I2C3>;
    USART2 => usart::InterruptHandler<peripherals::USART2>;
    RNG => rng::InterruptHandler<peripherals::RNG>;
    DMA1_CHANNEL1 => dma::InterruptHandler<peripherals::DMA1_CH1>;
    DMA1_CHANNEL2 => dma::InterruptHandler<peripherals::DMA1_CH2>;
    DMA1_CHANNEL3 => dma::InterruptHandler<peripherals::DMA1_CH3>;
    DMA1_CHANNEL4 => dma::InterruptHandler<peripherals::DMA1_CH4>;
    DMA1_CHANNEL5 => dma::InterruptHandler<peripherals::DMA1_CH5>;
    DMA1_CHANNEL6 => dma::InterruptHandler<peripherals::DMA1_CH6>;
    FDCAN1_IT0 => can::IT0InterruptHandler<peripherals::FDCAN1>;
    FDCAN1_IT1 => can::IT1InterruptHandler<peripherals::FDCAN1>;
});

/// The board's parts, ready to be handed to the tasks.
pub struct Board {
    /// Sensors 0 and 1, then 2 and 3.
    pub sensor_buses: [BoardBus; 2],
    /// Classic CAN at 1 Mbit/s: out and in.
    pub can: (Sender, Receiver),
    /// The serial line: out and in.
    pub line: (UartTx<'static, Async>, RingBufferedUartRx<'static>),
    /// Random numbers.
    pub rng: Rng<'static, peripherals::RNG>,
    /// Where parameters are kept.
    pub store: Store<Pages>,
    /// The motor's power stage and sensors, not yet started.
    pub drive: drive::Parts,
    /// The watchdog, not yet started.
    pub watchdog: Peri<'static, peripherals::IWDG>,
}

/// Starts clocks and buses.
pub fn bring_up() -> Board {
    critical::lower_all();
    let p = embassy_stm32::init(clocks());
    // Drivers of 20 mA for 1 MHz.
    pac::SYSCFG.cfgr1().modify(|w| {
        w.set_i2c1_fmp(true);
        w.set_i2c3_fmp(true);
    });
    let mut can = CanConfigurator::new(p.FDCAN1, p.PA11, p.PA12, Interrupts);
    can.set_config(can_config());
    let (sender, receiver, properties) = can.into_normal_mode().split();
    let mut config = usart::Config::default();
    config.baudrate = BAUD;
    static LINE: ConstStaticCell<[u8; LINE_BYTES]> = ConstStaticCell::new([0; LINE_BYTES]);
    let line = Uart::new(
        p.USART2, p.PA3, p.PA2, p.DMA1_CH5, p.DMA1_CH6, Interrupts, config,
    );
    // Pins and channels belong to this file, and this configuration is one that exists.
    let Ok(line) = line else {
        defmt::panic!("no such serial line")
    };
    let (out, into) = line.split();
    Board {
        sensor_buses: [
            BoardBus::new(open_first, first_pins),
            BoardBus::new(open_second, second_pins),
        ],
        can: (
            Sender {
                half: sender,
                properties,
            },
            Receiver(receiver),
        ),
        line: (out, into.into_ring_buffered(LINE.take())),
        rng: Rng::new(p.RNG, Interrupts),
        store: flash::store(p.FLASH),
        drive: drive::Parts {
            timer: p.TIM1,
            bridges: power_stage::Pins {
                high: (p.PA8, p.PA9, p.PA10),
                low: (p.PB13, p.PB14, p.PB15),
                stop: p.PB12,
            },
            converter: p.ADC1,
            inputs: (p.PC0, p.PC1, p.PC2, p.PC3),
            port: p.SPI1,
            sensor: (p.PA5, p.PA7, p.PA6, p.PA4),
        },
        watchdog: p.IWDG,
    }
}

/// Sensors 0 and 1.
fn open_first() -> Driver {
    let p = parts();
    let bus = I2c::new(
        p.I2C1,
        p.PB8,
        p.PB9,
        p.DMA1_CH1,
        p.DMA1_CH2,
        Interrupts,
        sensor_bus(),
    );
    set_timing(pac::I2C1);
    bus
}

/// Sensors 2 and 3.
fn open_second() -> Driver {
    let p = parts();
    let bus = I2c::new(
        p.I2C3,
        p.PC8,
        p.PC9,
        p.DMA1_CH3,
        p.DMA1_CH4,
        Interrupts,
        sensor_bus(),
    );
    set_timing(pac::I2C3);
    bus
}

fn first_pins() -> [Flex<'static>; 2] {
    let p = parts();
    [Flex::new(p.PB8), Flex::new(p.PB9)]
}

fn second_pins() -> [Flex<'static>; 2] {
    let p = parts();
    [Flex::new(p.PC8), Flex::new(p.PC9)]
}

/// The chip's parts once more, for a bus that is made anew.
fn parts() -> Peripherals {
    // Sound because the buses' pins, channels and peripherals are used by their `BoardBus` alone, which
    // holds either the driver or the pins.
    #[allow(unsafe_code)]
    unsafe {
        Peripherals::steal()
    }
}

/// Crystal 24 MHz / 6 * 80 = 320 MHz: 160 MHz for the core, 80 MHz for CAN.
fn clocks() -> embassy_stm32::Config {
    let mut config = embassy_stm32::Config::default();
    config.rcc.hsi = true;
    config.rcc.hsi48 = Some(rcc::Hsi48Config::default());
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
    config.rcc.mux.adc12sel = rcc::mux::Adcsel::SYS;
    // Below the motor's interrupt, as all others are.
    config.bdma_interrupt_priority = Priority::P1;
    config.rcc.mux.fdcansel = rcc::mux::Fdcansel::PLL1_Q;
    config.rcc.mux.i2c1sel = rcc::mux::I2csel::HSI;
    config.rcc.mux.i2c3sel = rcc::mux::I2csel::HSI;
    config.rcc.mux.clk48sel = rcc::mux::Clk48sel::HSI48;
    config
}

/// The driver's own timing is replaced; its time-out ends a little before that of the loops, so that it
/// clears up after itself.
fn sensor_bus() -> i2c::Config {
    let mut config = i2c::Config::default();
    config.frequency = Hertz(400_000);
    config.timeout = Duration::from_micros(TRANSFER_LIMIT_US - 10);
    config
}

/// 1 MHz. The register may be written only while the peripheral is off.
fn set_timing(bus: pac::i2c::I2c) {
    bus.cr1().modify(|w| w.set_pe(false));
    bus.timingr().write_value(pac::i2c::regs::Timingr(TIMING));
    bus.cr1().modify(|w| w.set_pe(true));
}

/// 80 MHz / 4 / (1 + 15 + 4) = 1 Mbit/s, sampled at 80 %. The controller does not join the bus again by
/// itself: the loops wait longer each time.
fn can_config() -> FdCanConfig {
    let non_zero = |n: u8| core::num::NonZeroU8::new(n).unwrap_or(core::num::NonZeroU8::MIN);
    FdCanConfig::default()
        .set_automatic_bus_off_recovery(false)
        .set_nominal_bit_timing(NominalBitTiming {
            prescaler: core::num::NonZeroU16::new(4).unwrap_or(core::num::NonZeroU16::MIN),
            seg1: non_zero(15),
            seg2: non_zero(4),
            sync_jump_width: non_zero(4),
        })
}

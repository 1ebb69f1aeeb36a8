//! The reference board, a NUCLEO-G474RE: clocks, pins, buses. Another board is one more such file.
//!
//! The paper's own board is not public: every pin here is assumed.
//!
//! | what | pins |
//! | --- | --- |
//! | sensors 0 and 1 | I2C1: SCL PA15, SDA PB9 |
//! | sensors 2 and 3 | I2C3: SCL PC8, SDA PC9 |
//! | CAN | FDCAN1: RX PA11, TX PA12, to a transceiver |
//! | serial line | USART2: TX PA2, RX PA3, to the debugger's virtual port |
//! | half bridges | TIM1: high sides PA8, PA9, PA10, low sides PB13, PB14, PB15; break PB12, low |
//! | phases' currents, bus | ADC1: PC0, PC1, PC2; PC3 |
//! | rotor's angle | SPI1: clock PA5, out PA7, in PA6, select PA4 |
//!
//! PB8, which is SCL of I2C1 as well, is BOOT0: a pull-up there starts the boot loader at each reset of a chip with its
//! option bytes as shipped (RM0440 2.6.1). So the clock is at PA15.
//!
//! The sensors' buses have pull-ups of 1 kOhm (assumed): 1 MHz needs rising edges within 120 ns.

use embassy_stm32::can::config::{FdCanConfig, GlobalFilter, NominalBitTiming};
use embassy_stm32::can::{self, CanConfigurator};
use embassy_stm32::interrupt::Priority;
use embassy_stm32::mode::Async;
use embassy_stm32::rng::{self, Rng};
use embassy_stm32::time::Hertz;
use embassy_stm32::usart::{self, RingBufferedUartRx, Uart, UartTx};
use embassy_stm32::{Peri, bind_interrupts, dma, pac, peripherals, rcc};
use static_cell::ConstStaticCell;

use super::can::{Receiver, Sender};
use super::flash::{self, Pages};
use super::sensor_bus::BoardBus;
use super::{critical, drive, power_stage};
use crate::bus_timing::{Edges, Mode, timing};
use crate::store::Store;
use crate::wire::serial::BAUD;

/// Clock of the I2C peripherals: the oscillator of 16 MHz.
const I2C_HZ: u32 = 16_000_000;
/// Edges of the sensors' buses in nanoseconds, assumed: 1 kOhm, 100 pF.
const EDGES: Edges = Edges { rise: 85, fall: 20 };
/// What the register of a sensor bus holds.
const TIMING: u32 = match timing(I2C_HZ, Mode::FastPlus, EDGES) {
    Some(timing) => timing.word(),
    None => panic!("no timing for these edges"),
};
/// Bytes that wait between two reads of the serial line: 2.5 ms of them.
const LINE_BYTES: usize = 512;
/// This board in [`crate::wire::messages::Version`].
pub const HARDWARE: u8 = 1;

bind_interrupts!(struct Interrupts {
    USART2 => usart::InterruptHandler<peripherals::USART2>;
    RNG => rng::InterruptHandler<peripherals::RNG>;
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
    let mut config = embassy_stm32::Config::default();
    // Below the motor's interrupt, as all others are.
    config.bdma_interrupt_priority = Priority::P1;
    let mut p = embassy_stm32::init(config);
    // The driver library resets PWR and knows nothing of the right bit: its clocks come after.
    boost();
    rcc::reinit(clocks(), &mut p.RCC);
    // A crystal that fails breaks the motor's outputs and raises the NMI; the driver library has no option for it.
    pac::RCC.cr().modify(|w| w.set_csson(true));
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
            BoardBus::first(p.I2C1, p.PA15, p.PB9, TIMING),
            BoardBus::second(p.I2C3, p.PC8, p.PC9, TIMING),
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

/// Voltage range 1 boost, which a core above 150 MHz needs (RM0440 6.1.5), while the core still runs on 16 MHz. The driver
/// library's own option does nothing: stm32-metapac 21.0.0 has R1MODE at bit 0 of PWR_CR5, RM0440 and ST's header have bit
/// 8.
fn boost() {
    const R1MODE: u32 = 1 << 8;
    pac::PWR.cr5().modify(|w| w.0 &= !R1MODE);
}

/// Crystal 24 MHz / 6 * 80 = 320 MHz: 160 MHz for the core, 80 MHz for CAN.
fn clocks() -> rcc::Config {
    let mut config = rcc::Config::default();
    config.hsi = true;
    config.hsi48 = Some(rcc::Hsi48Config::default());
    config.hse = Some(rcc::Hse {
        freq: Hertz(24_000_000),
        mode: rcc::HseMode::Oscillator,
    });
    config.pll = Some(rcc::Pll {
        source: rcc::PllSource::HSE,
        prediv: rcc::PllPreDiv::DIV6,
        mul: rcc::PllMul::MUL80,
        divp: None,
        divq: Some(rcc::PllQDiv::DIV4),
        divr: Some(rcc::PllRDiv::DIV2),
    });
    config.sys = rcc::Sysclk::PLL1_R;
    config.boost = true;
    config.mux.adc12sel = rcc::mux::Adcsel::SYS;
    config.mux.fdcansel = rcc::mux::Fdcansel::PLL1_Q;
    config.mux.i2c1sel = rcc::mux::I2csel::HSI;
    config.mux.i2c3sel = rcc::mux::I2csel::HSI;
    config.mux.clk48sel = rcc::mux::Clk48sel::HSI48;
    config
}

/// 80 MHz / 4 / (1 + 15 + 4) = 1 Mbit/s, sampled at 80 %. The controller does not join the bus again by
/// itself: the loops wait longer each time.
fn can_config() -> FdCanConfig {
    let non_zero = |n: u8| core::num::NonZeroU8::new(n).unwrap_or(core::num::NonZeroU8::MIN);
    FdCanConfig::default()
        // What no filter lets in would interrupt the core, up to eight thousand times a second.
        .set_global_filter(GlobalFilter::reject_all())
        .set_automatic_bus_off_recovery(false)
        .set_nominal_bit_timing(NominalBitTiming {
            prescaler: core::num::NonZeroU16::new(4).unwrap_or(core::num::NonZeroU16::MIN),
            seg1: non_zero(15),
            seg2: non_zero(4),
            sync_jump_width: non_zero(4),
        })
}

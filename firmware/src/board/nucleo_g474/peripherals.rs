//! Initialisation of clocks, pins and buses.

use embassy_stm32::can::config::{FdCanConfig, GlobalFilter, NominalBitTiming, TxBufferMode};
use embassy_stm32::can::{self, CanConfigurator};
use embassy_stm32::gpio::{Input, Pull};
use embassy_stm32::interrupt::Priority;
use embassy_stm32::mode::Async;
use embassy_stm32::pac::flash::vals::Latency;
use embassy_stm32::pac::timer::vals::Urs;
use embassy_stm32::time::Hertz;
use embassy_stm32::usart::{self, RingBufferedUartRx, Uart, UartTx};
use embassy_stm32::{Peri, bind_interrupts, dma, pac, peripherals, rcc};
use embassy_time::{Duration, Instant};
use static_cell::ConstStaticCell;

use crate::board::i2c_timing::{EdgeTimes, I2cMode, i2c_timing};
use crate::board::selected::can::{Receiver, Sender};
use crate::board::selected::clock::BoardClock;
use crate::board::selected::crash::IndependentWatchdog;
use crate::board::selected::flash::{self, SettingsFlash};
use crate::board::selected::i2c::I2cBus;
use crate::board::selected::imu::{self, InertialSensor};
use crate::board::selected::random::RandomNumbers;
use crate::board::selected::thermometer::{self, BoardThermometer};
use crate::board::selected::{NucleoG474, crash, drive, pwm, sync, table};
use crate::board::{Bsp, Peripherals};
use crate::model::kernel;
use crate::protocol::serial::BAUD_RATE;
use crate::system::crash::CrashKind;

/// Clock of the I2C peripherals: that of the system. HSI16 would be below the 17 MHz of Fast-mode Plus.
const I2C_HZ: u32 = 160_000_000;
const EDGES: EdgeTimes = {
    let [rise, fall] = table::EDGES_NS;
    EdgeTimes { rise, fall }
};
/// TIMINGR of the sensor buses.
const TIMING: u32 = match i2c_timing(I2C_HZ, I2cMode::FastPlus, EDGES) {
    Some(timing) => timing.word(),
    None => panic!("no timing for these edges"),
};
/// Receive buffer of the serial line: 1.7 ms.
const SERIAL_RX_BYTES: usize = 512;

bind_interrupts!(struct Interrupts {
    USART2 => usart::InterruptHandler<peripherals::USART2>;
    DMA1_CHANNEL5 => dma::InterruptHandler<peripherals::DMA1_CH5>;
    DMA1_CHANNEL6 => dma::InterruptHandler<peripherals::DMA1_CH6>;
    FDCAN1_IT0 => can::IT0InterruptHandler<peripherals::FDCAN1>;
    FDCAN1_IT1 => can::IT1InterruptHandler<peripherals::FDCAN1>;
});

impl Bsp for NucleoG474 {
    const HARDWARE: u8 = 1;
    type Clock = BoardClock;
    type SensorBus = I2cBus;
    type Imu = InertialSensor;
    type CanTx = Sender;
    type CanRx = Receiver;
    type SerialTx = UartTx<'static, Async>;
    type SerialRx = RingBufferedUartRx<'static>;
    type Flash = SettingsFlash;
    type Rng = RandomNumbers;
    type Button = Input<'static>;
    type Thermometer = BoardThermometer;
    type Drive = drive::Parts;
    type Watchdog = IndependentWatchdog;

    fn init() -> Peripherals<Self> {
        sync::lower_all_interrupts();
        crash::guard_stack();
        let mut config = embassy_stm32::Config::default();
        // Below the motor interrupt.
        config.bdma_interrupt_priority = Priority::P1;
        let mut p = embassy_stm32::init(config);
        let has_crystal = start_clocks(&mut p.RCC);
        if !kernel::copy_to_ccm() {
            crash::reset(CrashKind::Corruption);
        }
        // A failing crystal breaks the motor outputs and raises the NMI; the driver library has no option for it.
        pac::RCC.cr().modify(|w| w.set_csson(has_crystal));
        break_on_chip_faults();
        stop_with_debugger();
        // 20 mA drivers for 1 MHz.
        pac::SYSCFG.cfgr1().modify(|w| {
            w.set_i2c1_fmp(true);
            w.set_i2c3_fmp(true);
        });
        let mut can = CanConfigurator::new(p.FDCAN1, p.PA11, p.PA12, Interrupts);
        can.set_config(can_config());
        let (sender, receiver, properties) = can.into_normal_mode().split();
        let mut config = usart::Config::default();
        config.baudrate = BAUD_RATE;
        static BUFFER: ConstStaticCell<[u8; SERIAL_RX_BYTES]> =
            ConstStaticCell::new([0; SERIAL_RX_BYTES]);
        let uart = Uart::new(p.USART2, p.PA3, p.PA2, p.DMA1_CH5, p.DMA1_CH6, Interrupts, config);
        // The configuration is constant and valid.
        let uart = crash::once(uart.ok());
        let (serial_tx, serial_rx) = uart.split();
        let (flash, flash_offsets) = flash::settings_flash(p.FLASH);
        Peripherals {
            sensor_buses: [
                I2cBus::first(p.I2C1, p.PA15, p.PB9, TIMING),
                I2cBus::second(p.I2C3, p.PC8, p.PC9, TIMING),
            ],
            imu: imu::inertial_sensor(imu::Parts {
                port: p.SPI3,
                clock: p.PC10,
                out: p.PC12,
                into: p.PC11,
                select: p.PD2,
                channels: (p.DMA1_CH3, p.DMA1_CH4),
            }),
            can_tx: Sender { half: sender, properties },
            can_rx: Receiver(receiver),
            serial_tx,
            serial_rx: serial_rx.into_ring_buffered(crash::once(BUFFER.try_take()).as_mut_slice()),
            rng: RandomNumbers::new(p.RNG),
            button: Input::new(p.PC13, Pull::Down),
            flash,
            flash_offsets,
            configuration_defect: if has_crystal { option_byte_defect() } else { Some(NO_CRYSTAL) },
            thermometer: BoardThermometer::new(thermometer::Parts {
                thermistors: p.ADC3,
                motor: p.PB1,
                stage: p.PB0,
                chip: p.ADC5,
            }),
            drive: drive::Parts {
                timer: p.TIM1,
                bridges: pwm::Pins {
                    high: (p.PA8, p.PA9, p.PA10),
                    low: (p.PB13, p.PB14, p.PB15),
                    stop: p.PB12,
                },
                converter: p.ADC1,
                inputs: (p.PC0, p.PC1, p.PC2, p.PC3),
                port: p.SPI1,
                sensor: (p.PA5, p.PA7, p.PA6, p.PA4),
            },
            watchdog: IndependentWatchdog::new(p.IWDG),
        }
    }
}

/// Starts the clocks; false where the crystal does not start within [`CRYSTAL_START`], and the chip runs from HSI16.
///
/// It works around three defects of the libraries (`firmware/UPSTREAM.md`): a wait for the crystal without a limit; R1MODE (range 1
/// boost, required above 150 MHz, RM0440 6.1.5) at bit 0 of PWR_CR5 instead of 8; a step from 16 to 160 MHz without the
/// microsecond at half speed (RM0440 6.1.5, as in ST's `HAL_RCC_ClockConfig`). Therefore embassy-stm32 switches to half speed, and
/// the rest follows here. It computes with buses of 80 MHz from then on ([`bus_frequency`]).
fn start_clocks(rcc: &mut Peri<'static, peripherals::RCC>) -> bool {
    pac::RCC.cr().modify(|w| w.set_hseon(true));
    let end = Instant::now() + CRYSTAL_START;
    let has_crystal = loop {
        match pac::RCC.cr().read().hserdy() {
            false if Instant::now() < end => {}
            is_ready => break is_ready,
        }
    };
    pac::RCC.cr().modify(|w| w.set_hseon(has_crystal));
    // After the initialisation of the library, which resets PWR.
    const R1MODE: u32 = 1 << 8;
    pac::PWR.cr5().modify(|w| w.0 &= !R1MODE);
    rcc::reinit(half_speed(has_crystal), rcc);
    pac::FLASH.acr().modify(|w| w.set_latency(Latency::WS4));
    // 2 us at 80 MHz.
    cortex_m::asm::delay(160);
    pac::RCC.cfgr().modify(|w| w.set_hpre(rcc::AHBPrescaler::DIV1));
    // The time base counts microseconds of 160 cycles; the update that loads the prescaler is no overflow.
    pac::TIM5.psc().write_value(159);
    pac::TIM5.cr1().modify(|w| w.set_urs(Urs::COUNTER_ONLY));
    pac::TIM5.egr().write(|w| w.set_ug(true));
    pac::TIM5.cr1().modify(|w| w.set_urs(Urs::ANY_EVENT));
    has_crystal
}

/// What a driver that divides the clock of a bus is to be asked for: see [`start_clocks`].
pub(super) const fn bus_frequency(hertz: u32) -> Hertz {
    Hertz(hertz / 2)
}

/// Connects lock-up of the core, parity error of SRAM and a flash word with two wrong bits to the break of the motor timer, which
/// switches the outputs off without software, and watches the supply ([`break_on_low_supply`]). The connections stay until a
/// reset. Parity is not checked by a chip as shipped (option SRAM_PE = 1), and must not be: memory that survives a reset is read
/// before it is written.
fn break_on_chip_faults() {
    const LEVEL_2_8_V: u8 = 5;
    pac::PWR.cr2().modify(|w| {
        w.set_pls(LEVEL_2_8_V);
        w.set_pvde(true);
    });
    pac::SYSCFG.cfgr2().modify(|w| {
        w.set_cll(true);
        w.set_spl(true);
        w.set_eccl(true);
    });
}

/// Connects a supply below 2.8 V to the break as well. To be confirmed on a board: a weak regulator must not dip so far.
pub fn break_on_low_supply() {
    pac::SYSCFG.cfgr2().modify(|w| w.set_pvdl(true));
}

/// A halt by a debugger stops the motor timer, which then drives all six pins low (RM0440 28.3.32): else its last duties would stay on
/// the bridges. With the feature `debug` the watchdog waits as well.
fn stop_with_debugger() {
    pac::DBGMCU.apb2fzr().modify(|w| w.set_tim1(true));
    #[cfg(feature = "debug")]
    pac::DBGMCU.apb1fzr1().modify(|w| w.set_iwdg(true));
}

/// Longest start of a crystal.
const CRYSTAL_START: Duration = Duration::from_millis(100);
/// Code of a crystal that does not start, after those of [`option_byte_defect`].
const NO_CRYSTAL: u32 = 3;

/// The code where the option bytes are unsuitable: 1, the flash has a single bank, so that the image would stop while
/// a page is written; 2, each start goes through the boot loader, which may choose the second bank, where settings are stored.
/// The brown-out level may be as shipped, 1.7 V, as the outputs are off below 2.8 V; nSWBOOT0 and nBOOT0 as well, as this
/// board does not use PB8.
fn option_byte_defect() -> Option<u32> {
    let options = pac::FLASH.optr().read();
    match (options.dbank(), options.bfb2()) {
        (false, _) => Some(1),
        (true, true) => Some(2),
        (true, false) => None,
    }
}

/// Crystal 24 MHz / 6 * 80 or HSI16 / 4 * 80 = 320 MHz: 160 MHz for the system, 80 MHz for CAN, and at first for the core.
fn half_speed(has_crystal: bool) -> rcc::Config {
    let mut config = rcc::Config::default();
    config.hsi = true;
    config.hsi48 = Some(rcc::Hsi48Config::default());
    let crystal = rcc::Hse { freq: Hertz(table::CRYSTAL_HZ), mode: rcc::HseMode::Oscillator };
    config.hse = has_crystal.then_some(crystal);
    let (source, prediv) = if has_crystal {
        (rcc::PllSource::HSE, rcc::PllPreDiv::DIV6)
    } else {
        (rcc::PllSource::HSI, rcc::PllPreDiv::DIV4)
    };
    config.pll = Some(rcc::Pll {
        source,
        prediv,
        mul: rcc::PllMul::MUL80,
        divp: None,
        divq: Some(rcc::PllQDiv::DIV4),
        divr: Some(rcc::PllRDiv::DIV2),
    });
    config.sys = rcc::Sysclk::PLL1_R;
    config.ahb_pre = rcc::AHBPrescaler::DIV2;
    config.mux.usart2sel = rcc::mux::Uartsel::SYS;
    config.mux.adc12sel = rcc::mux::Adcsel::SYS;
    config.mux.adc345sel = rcc::mux::Adcsel::SYS;
    config.mux.fdcansel = rcc::mux::Fdcansel::PLL1_Q;
    config.mux.i2c1sel = rcc::mux::I2csel::SYS;
    config.mux.i2c3sel = rcc::mux::I2csel::SYS;
    config.mux.clk48sel = rcc::mux::Clk48sel::HSI48;
    config
}

/// 80 MHz / 4 / (1 + 15 + 4) = 1 Mbit/s, sampled at 80 %. No automatic recovery
/// from bus-off: the transmit task waits longer after each.
fn can_config() -> FdCanConfig {
    let non_zero = |n: u8| core::num::NonZeroU8::new(n).unwrap_or(core::num::NonZeroU8::MIN);
    FdCanConfig::default()
        // An unfiltered frame would interrupt the core, up to 8000 times a second.
        .set_global_filter(GlobalFilter::reject_all())
        .set_automatic_bus_off_recovery(false)
        // In the other mode a frame that finds the memory full makes the driver (embassy-stm32 0.6.0) wait, without yielding,
        // for the end of one of *higher* priority.
        .set_tx_buffer_mode(TxBufferMode::Fifo)
        .set_nominal_bit_timing(NominalBitTiming {
            prescaler: core::num::NonZeroU16::new(4).unwrap_or(core::num::NonZeroU16::MIN),
            seg1: non_zero(15),
            seg2: non_zero(4),
            sync_jump_width: non_zero(4),
        })
}

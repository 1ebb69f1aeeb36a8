//! The system on chip: memories, address map, clocks, interrupts, DMA, and the connections of peripherals to each other
//! and to the board.

use std::ops::Range;

use crate::core::{Bus, BusError, SystemControl, Width};
use crate::devices::Devices;
use crate::mpu::Mpu;
use crate::peripherals::Context;
use crate::peripherals::adc::{self, Adc, Inputs, Trigger};
use crate::peripherals::clocks::{Rcc, ResetCause};
use crate::peripherals::dma::{Dma, Transfer};
use crate::peripherals::exti::Exti;
use crate::peripherals::fdcan::{self, Fdcan};
use crate::peripherals::flash::{self, Flash, PowerCut};
use crate::peripherals::gpio::{Gpio, Mode, Pin};
use crate::peripherals::i2c::I2c;
use crate::peripherals::motor_timer::{Moment, MotorTimer};
use crate::peripherals::power::Pwr;
use crate::peripherals::rng::Rng;
use crate::peripherals::spi::{self, Spi};
use crate::peripherals::syscfg::{BreakSource, Dbgmcu, Syscfg};
use crate::peripherals::timer::Timer;
use crate::peripherals::usart::Usart;
use crate::peripherals::watchdog::Watchdog;
use crate::registers::{RccBit, base, dma_request, interrupt, rcc_bits};
use crate::time::{Frequency, Time};
use crate::violations::{Kind, Violations};
use crate::wiring::Wiring;

/// SRAM1 and SRAM2, one behind the other (RM0440 2.4).
pub const SRAM: u32 = 0x2000_0000;
const SRAM_SIZE: usize = 96 * 1024;
/// Reserved addresses directly below SRAM, behind the system memory.
const BELOW_SRAM: u32 = 0x1FFF_8000;
/// Where SRAM2 begins; it, SRAM1 and core-coupled memory are the cuts of SRAM.
const SRAM_2: u32 = SRAM + 80 * 1024;
const ALL_CUTS: u8 = 7;
/// Core-coupled memory, where the core fetches without waiting; the system bus shows it behind SRAM2 as well.
const CCM: u32 = 0x1000_0000;
const CCM_SIZE: usize = 32 * 1024;
const CCM_ALIAS: u32 = SRAM + SRAM_SIZE as u32;
/// The memory that the chip starts from is at address 0 as well (2.6).
const BOOT_SIZE: u32 = flash::SIZE as u32;
/// Peripherals are told apart by blocks of 1 KiB.
const BLOCK: u32 = 1024;
/// The region of the core's own peripherals.
const PRIVATE: u32 = 0xE000_0000;
/// The debug unit is in that region, and ST's.
const DBGMCU: u32 = 0xE004_2000;

/// Factory calibration of the temperature sensor at a reference of 3.0 V (datasheet, table 5), and typical counts: 0.76 V at
/// 30 degrees Celsius and 2.5 mV per kelvin.
const CALIBRATION_30_C: u32 = 0x1FFF_75A8;
const CALIBRATION_130_C: u32 = 0x1FFF_75CA;
/// Shortest time from an edge of the rotor sensor's select.
const SELECT: Time = Time::from_ns(350);
/// Counts at both addresses.
pub const TEMPERATURE_CALIBRATION: [u32; 2] = [1037, 1379];

/// What answers in a block of addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Block {
    Adc12,
    Adc345,
    Dma(usize),
    DmaMux,
    Exti,
    Fdcan,
    FdcanRam,
    Flash,
    Gpio(usize),
    I2c(usize),
    Iwdg,
    Pwr,
    Rcc,
    Rng,
    Spi(usize),
    Syscfg,
    Tim1,
    Tim5,
    Usart,
}

/// The blocks, by their names in the metadata.
const BLOCKS: [(&str, Block); 29] = [
    ("TIM5", Block::Tim5),
    ("TIM1", Block::Tim1),
    ("ADC1", Block::Adc12),
    ("ADC3", Block::Adc345),
    ("GPIOA", Block::Gpio(0)),
    ("GPIOB", Block::Gpio(1)),
    ("GPIOC", Block::Gpio(2)),
    ("GPIOD", Block::Gpio(3)),
    ("GPIOE", Block::Gpio(4)),
    ("GPIOF", Block::Gpio(5)),
    ("GPIOG", Block::Gpio(6)),
    ("I2C1", Block::I2c(0)),
    ("I2C2", Block::I2c(1)),
    ("I2C3", Block::I2c(2)),
    ("USART2", Block::Usart),
    ("FDCAN1", Block::Fdcan),
    ("FDCANRAM1", Block::FdcanRam),
    ("DMA1", Block::Dma(0)),
    ("DMA2", Block::Dma(1)),
    ("DMAMUX1", Block::DmaMux),
    ("SPI1", Block::Spi(0)),
    ("SPI3", Block::Spi(1)),
    ("FLASH", Block::Flash),
    ("IWDG", Block::Iwdg),
    ("RCC", Block::Rcc),
    ("PWR", Block::Pwr),
    ("RNG", Block::Rng),
    ("SYSCFG", Block::Syscfg),
    ("EXTI", Block::Exti),
];

/// A block with its clock gate and reset, where it has them.
#[derive(Clone, Copy, Debug)]
struct Entry {
    block: Block,
    base: u32,
    bits: Option<[RccBit; 2]>,
}

/// A request line of DMA: the peripheral and which of its two, receive or transmit.
#[derive(Clone, Copy, Debug)]
struct Request {
    block: Block,
    line: usize,
}

/// Numbers of the interrupts.
#[derive(Clone)]
struct Interrupts {
    i2c: [[usize; 2]; 3],
    fdcan: [usize; 2],
    tim1: [usize; 2],
    usart: usize,
    tim5: usize,
    adc: usize,
    rng: usize,
    flash: usize,
}

/// What varies from board to board, and with the model of time.
#[derive(Clone, Debug)]
pub struct Options {
    /// The circuit board.
    pub wiring: Wiring,
    /// What edges and the analogue filter add to a bit on the sensor buses (RM0440 41.4.9): the filter delays both phases by
    /// 50 to 260 ns (datasheet, table 84), and the edges of a bus of 1 kOhm and 100 pF take 105 ns.
    pub i2c_delay: Time,
    /// What the amplifier of a phase current takes to settle after its low side is switched on (DRV8316: 1 us).
    pub amplifier_settling: Time,
    /// The watchdog's oscillator: 32 kHz, 29.5 to 34 over temperature and supply (datasheet table 46).
    pub lsi: Frequency,
    /// Of the random numbers, and of what the memories hold at power-on.
    pub seed: u64,
}

/// Frames on the CAN bus that a program has not seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UnseenFrames {
    /// No filter lets them in.
    pub refused: u64,
    /// Their FIFO was full.
    pub lost: u64,
}

/// The chip without its core.
#[derive(Clone)]
pub struct Soc {
    /// Time since power-on.
    now: Time,
    /// The next event of a peripheral.
    next: Time,
    /// Where the core pauses: the next event, or the end of what the caller wants to run.
    pause_at: Time,
    end: Time,
    cycle: Time,
    system: SystemControl,
    sram: Vec<u8>,
    ccm: Vec<u8>,
    pub(crate) flash: Flash,
    pub(crate) rcc: Rcc,
    pwr: Pwr,
    syscfg: Syscfg,
    dbgmcu: Dbgmcu,
    mpu: Mpu,
    exti: Exti,
    gpio: [Gpio; 7],
    dma: Dma,
    tim5: Timer,
    pub(crate) tim1: MotorTimer,
    pub(crate) iwdg: Watchdog,
    i2c: [I2c; 3],
    usart: Usart,
    pub(crate) fdcan: Fdcan,
    pub(crate) adc: Adc,
    /// ADC3 and ADC5.
    slow_adcs: [Adc; 2],
    pub(crate) spi: [Spi; 2],
    rng: Rng,
    /// What is outside.
    pub devices: Devices,
    /// Misuse.
    pub violations: Violations,
    options: Options,
    entries: Vec<Entry>,
    /// Entry of each block of addresses from 0x4000_0000, 0x4800_0000 and 0x5000_0000 on.
    map: [Vec<u8>; 3],
    requests: [Option<Request>; 128],
    interrupts: Interrupts,
    /// Sensor bus that each I2C peripheral is connected to.
    buses: [Option<usize>; 3],
    modified: Option<Range<u32>>,
    reset: Option<ResetCause>,
    /// Level of the gate drivers' output.
    gate_fault: bool,
    /// The wire from the gate drivers is open.
    is_break_wire_open: bool,
    /// The PWM trigger of the ADC is connected.
    has_motor_trigger: bool,
    /// Cuts of SRAM that were not accessed since the reset: bits of SRAM1, SRAM2, CCM.
    untouched: u8,
    /// Last edge of the rotor sensor's select.
    encoder_edge: Time,
    /// Alternate functions of the six bridge pins, the break, the serial line, CAN, both SPI devices, and the sensor buses.
    functions: Functions,
}

#[derive(Clone)]
struct Functions {
    bridges: [(Pin, u8); 6],
    break_input: (Pin, u8),
    serial: [(Pin, u8); 2],
    can: [(Pin, u8); 2],
    spi: [[(Pin, u8); 3]; 2],
    /// Of each I2C peripheral at each bus, where it can be there.
    i2c: [[Option<[u8; 2]>; 2]; 3],
}

impl Functions {
    fn new(wiring: &Wiring) -> Self {
        fn with<const N: usize>(name: &str, signals: [&str; N], pins: [Pin; N]) -> [(Pin, u8); N] {
            let functions = Wiring::functions(name, signals, pins);
            let functions =
                functions.unwrap_or_else(|| panic!("{name} cannot have these pins: {pins:?}"));
            std::array::from_fn(|place| (pins[place], functions[place]))
        }
        let [[u, v, w], [un, vn, wn]] = wiring.bridges;
        let spi = |name: &str, [clock, out, into, _]: [Pin; 4]| {
            with(name, ["SCK", "MOSI", "MISO"], [clock, out, into])
        };
        let [break_input] = with("TIM1", ["BKIN"], [wiring.gate_fault]);
        let i2c = ["I2C1", "I2C2", "I2C3"].map(|name| {
            wiring.sensor_buses.map(|pins| Wiring::functions(name, ["SCL", "SDA"], pins))
        });
        Self {
            bridges: with(
                "TIM1",
                ["CH1", "CH2", "CH3", "CH1N", "CH2N", "CH3N"],
                [u, v, w, un, vn, wn],
            ),
            break_input,
            serial: with("USART2", ["RX", "TX"], wiring.serial),
            can: with("FDCAN1", ["RX", "TX"], wiring.can),
            spi: [spi("SPI1", wiring.encoder), spi("SPI3", wiring.inertial)],
            i2c,
        }
    }
}

/// Calls a peripheral with its context.
macro_rules! context {
    ($soc:ident, $base:expr) => {
        &mut Context {
            now: $soc.now,
            clocks: $soc.rcc.clocks(),
            violations: &mut $soc.violations,
            base: $base,
        }
    };
}

impl Soc {
    /// A chip at power-on, before its first instruction.
    pub fn new(options: Options, devices: Devices) -> Self {
        let pairs = |names: [&str; 2]| names.map(interrupt);
        let interrupts = Interrupts {
            i2c: [["I2C1_EV", "I2C1_ER"], ["I2C2_EV", "I2C2_ER"], ["I2C3_EV", "I2C3_ER"]]
                .map(pairs),
            fdcan: pairs(["FDCAN1_IT0", "FDCAN1_IT1"]),
            tim1: pairs(["TIM1_BRK_TIM15", "TIM1_UP_TIM16"]),
            usart: interrupt("USART2"),
            tim5: interrupt("TIM5"),
            adc: interrupt("ADC1_2"),
            rng: interrupt("RNG"),
            flash: interrupt("FLASH"),
        };
        let entries: Vec<_> = BLOCKS
            .into_iter()
            .map(|(name, block)| Entry { block, base: base(name), bits: gate(name, block) })
            .collect();
        let functions = Functions::new(&options.wiring);
        let crystal = options.wiring.crystal;
        let mut soc = Self {
            now: Time::ZERO,
            next: Time::ZERO,
            pause_at: Time::ZERO,
            end: Time::ZERO,
            cycle: Time::ZERO,
            system: SystemControl::new(),
            sram: noise(SRAM_SIZE, options.seed),
            ccm: noise(CCM_SIZE, options.seed + 1),
            flash: Flash::new(),
            rcc: Rcc::new(crystal, options.lsi),
            pwr: Pwr::new(),
            syscfg: Syscfg::default(),
            dbgmcu: Dbgmcu::default(),
            mpu: Mpu::default(),
            exti: Exti::new(),
            gpio: std::array::from_fn(Gpio::new),
            dma: Dma::new(),
            tim5: Timer::new(),
            tim1: MotorTimer::new(),
            iwdg: Watchdog::new(),
            i2c: std::array::from_fn(|_| I2c::new()),
            usart: Usart::new(),
            fdcan: Fdcan::new(),
            adc: Adc::new(Inputs::Motor(Wiring::adc_channels("ADC1", options.wiring.analog))),
            slow_adcs: slow_adcs(&options.wiring),
            // The AS5047P takes data on the falling edge, clock idle low; the LSM6DS3 on the rising one.
            spi: [Spi::new(&[1]), Spi::new(&[0, 3])],
            rng: Rng::new(options.seed),
            devices,
            violations: Violations::default(),
            map: map(&entries),
            entries,
            requests: requests(),
            interrupts,
            buses: [None; 3],
            modified: None,
            reset: None,
            gate_fault: false,
            is_break_wire_open: false,
            has_motor_trigger: true,
            untouched: 0,
            encoder_edge: Time::ZERO,
            functions,
            options,
        };
        soc.power_on();
        soc
    }

    /// A copy in its present state, with other devices.
    pub(crate) fn copy(&self, devices: Devices) -> Self {
        Self { devices, ..self.clone() }
    }

    /// Registers take their reset values, memories hold what they happen to.
    pub(crate) fn power_on(&mut self) {
        self.sram = noise(SRAM_SIZE, self.options.seed);
        self.ccm = noise(CCM_SIZE, self.options.seed + 1);
        self.modify(CCM..CCM_ALIAS + CCM_SIZE as u32);
        self.reset(ResetCause::PowerOn);
    }

    /// A reset of everything but the memories.
    pub(crate) fn reset(&mut self, cause: ResetCause) {
        self.reset = None;
        self.untouched = ALL_CUTS;
        self.rcc.reset(self.now, cause);
        self.system.reset();
        self.pwr.reset();
        self.syscfg = Syscfg::default();
        self.dbgmcu = Dbgmcu::default();
        self.mpu = Mpu::default();
        self.exti = Exti::new();
        for (port, gpio) in self.gpio.iter_mut().enumerate() {
            gpio.reset(port);
        }
        self.dma = Dma::new();
        self.tim5 = Timer::new();
        self.tim1.reset(self.now);
        self.iwdg = Watchdog::new();
        self.i2c = std::array::from_fn(|_| I2c::new());
        self.usart = Usart::new();
        self.fdcan.reset();
        self.adc.reset();
        self.slow_adcs.iter_mut().for_each(Adc::reset);
        self.spi.iter_mut().for_each(Spi::reset);
        self.rng.reset();
        self.flash.reset();
        for block in BLOCKS.map(|(_, block)| block) {
            self.refresh(block);
        }
        self.connect_board();
        self.update_clocks();
        self.update_connections();
        self.update_supply_break();
        self.plan();
    }

    /// Levels that the board brings to the pins.
    fn connect_board(&mut self) {
        for bus in self.options.wiring.sensor_buses {
            for pin in bus {
                self.gpio[pin.port].drive_externally(pin.number, Some(true));
            }
        }
        self.connect_gate_drivers();
    }

    fn connect_gate_drivers(&mut self) {
        let pin = self.options.wiring.gate_fault;
        let level = (!self.is_break_wire_open).then_some(!self.gate_fault);
        self.gpio[pin.port].drive_externally(pin.number, level);
    }

    /// Whether the chip starts from flash, by BOOT0 at this moment.
    pub(crate) fn boots_from_flash(&self) -> bool {
        self.flash.boots(self.options.wiring.is_pulled_up(Wiring::BOOT0))
    }

    /// Time since power-on.
    pub fn now(&self) -> Time {
        self.now
    }

    /// Counter of TIM5, the firmware's time base, and the period after which it starts at zero again: microseconds since
    /// the firmware started it, modulo that period.
    pub fn time_base(&self) -> (u64, u64) {
        (u64::from(self.tim5.counter(self.now())), self.tim5.period())
    }

    /// The core's clock.
    pub fn core_clock(&self) -> Frequency {
        self.rcc.clocks().core
    }

    /// Lets the core run until this time; devices outside may have something new.
    pub(crate) fn run_to(&mut self, end: Time) {
        self.end = end;
        self.plan();
    }

    /// Lets the time pass to where the core would pause; how long that was.
    pub(crate) fn skip(&mut self) -> Time {
        let passed = self.pause_at.since(self.now);
        self.now += passed;
        passed
    }

    /// Priority level of an interrupt or exception, 0 the most urgent; none of one that has a fixed one.
    pub(crate) fn priority_level(&self, exception: u16) -> Option<u8> {
        u8::try_from(self.system.priority(exception)).ok().map(|priority| priority >> 4)
    }

    /// A reset that a peripheral or the program has asked for.
    pub(crate) fn take_reset(&mut self) -> Option<ResetCause> {
        self.reset.take()
    }

    /// Asks for a reset.
    pub(crate) fn request_reset(&mut self, cause: ResetCause) {
        self.reset = self.reset.or(Some(cause));
    }

    /// The gate drivers report a fault, or no more: their output is low where they do.
    pub fn set_gate_fault(&mut self, is_active: bool) {
        self.gate_fault = is_active;
        self.connect_gate_drivers();
        self.update_connections();
        self.plan();
    }

    /// The wire between gate drivers and break input opens, or is connected again: the level of an open one is that of the
    /// chip's own pull resistor, low without any.
    pub fn set_break_wire_open(&mut self, is_open: bool) {
        self.is_break_wire_open = is_open;
        self.connect_gate_drivers();
        self.update_connections();
        self.plan();
    }

    /// Disconnects (or reconnects) the PWM trigger of the ADC; PWM keeps running.
    pub fn set_motor_trigger(&mut self, reaches_converter: bool) {
        self.has_motor_trigger = reaches_converter;
    }

    /// Duties of the motor's half bridges in use, as shares of the period; none where all switches are off.
    pub fn motor_duties(&self) -> Option<[f64; 3]> {
        self.tim1.duties()
    }

    /// Changes the supply (VDD), 3300 millivolts at first: below the threshold of its detector, and below the brown-out level
    /// of the option bytes, where the chip is held in reset (6.2).
    pub fn set_supply(&mut self, millivolts: u32) {
        self.pwr.set_supply(millivolts);
        self.update_supply_break();
        if self.is_browned_out() {
            self.request_reset(ResetCause::PowerOn);
        }
        self.plan();
    }

    /// The supply is too low for the chip.
    pub(crate) fn is_browned_out(&self) -> bool {
        self.pwr.supply_mv() < self.flash.brown_out_mv()
    }

    fn update_supply_break(&mut self) {
        let is_low = self.pwr.is_supply_low() && self.syscfg.breaks_on(BreakSource::Supply);
        self.tim1.set_supply_break(is_low, self.now);
    }

    /// The option bytes (OPTR).
    pub fn option_bytes(&self) -> u32 {
        self.flash.options()
    }

    /// Programs the option bytes (OPTR) as a debugger does; the chip loads them at its next start.
    pub fn set_option_bytes(&mut self, options: u32) {
        self.flash.set_options(options);
    }

    /// The crystal stops.
    pub fn fail_crystal(&mut self) {
        if self.rcc.fail_crystal() {
            self.system.pend_nmi();
            self.tim1.system_break(None, self.now);
        }
        self.update_clocks();
        self.plan();
    }

    /// It oscillates again.
    pub fn restore_crystal(&mut self) {
        self.rcc.restore_crystal(self.options.wiring.crystal);
        self.update_clocks();
        self.plan();
    }

    /// The core has locked up: a break of the outputs where the program has enabled it.
    pub(crate) fn lock_up(&mut self) {
        if self.syscfg.breaks_on(BreakSource::LockUp) {
            self.tim1.system_break(Some(BreakSource::LockUp), self.now);
        }
    }

    /// A debugger halts the core, or lets it run again.
    pub(crate) fn set_halted(&mut self, is_halted: bool) {
        self.tim1.set_stopped(is_halted && self.dbgmcu.stops_motor_timer(), self.now);
    }

    /// Takes the supply away in the middle of an operation of the flash memory: [`crate::chip::Halt::PowerLost`].
    pub fn cut_power(&mut self, cut: PowerCut) {
        self.flash.cut_power(cut);
    }

    /// Sets error flags of the flash controller (FLASH_SR).
    pub fn set_flash_errors(&mut self, errors: u32) {
        self.flash.set_errors(errors);
        self.refresh(Block::Flash);
    }

    /// Lets stops on a sensor bus come late, until a reset of its peripheral.
    pub fn delay_stops(&mut self, bus: usize, delay: Time) {
        let number = self.buses.iter().position(|connected| *connected == Some(bus));
        if let Some(number) = number {
            self.i2c[number].delay_stops(delay);
        }
    }

    /// Flips two bits of the double word at an offset in flash: an uncorrectable ECC error.
    pub fn corrupt_flash(&mut self, offset: usize) {
        self.flash.corrupt(offset);
    }

    /// Frames on the CAN bus that the program has not seen since the last reset.
    pub fn unseen_frames(&self) -> UnseenFrames {
        UnseenFrames { refused: self.fdcan.refused, lost: self.fdcan.lost }
    }

    /// Leaves a byte in the data register of the I2C peripheral at a sensor bus, as an aborted transfer does; false where
    /// none is at it.
    pub fn leave_received_byte(&mut self, bus: usize, byte: u8) -> bool {
        let number = self.buses.iter().position(|connected| *connected == Some(bus));
        if let Some(number) = number {
            self.i2c[number].leave_byte(byte);
            self.refresh(Block::I2c(number));
        }
        number.is_some()
    }

    /// Detects a bus error during a transfer on a sensor bus, though there is none; false where no peripheral is at it.
    pub fn raise_bus_error(&mut self, bus: usize) -> bool {
        let number = self.buses.iter().position(|connected| *connected == Some(bus));
        if let Some(number) = number {
            self.i2c[number].raise_bus_error();
            self.refresh(Block::I2c(number));
        }
        number.is_some()
    }

    /// Bytes of memory at an address, as a debugger reads them. None outside of SRAM, CCM and flash.
    pub fn memory(&self, address: u32, length: usize) -> Option<&[u8]> {
        let within = |start: u32, bytes: &[u8]| {
            let offset = address.wrapping_sub(start) as usize;
            (offset.checked_add(length)? <= bytes.len()).then_some(offset..offset + length)
        };
        if let Some(range) = within(SRAM, &self.sram) {
            return self.sram.get(range);
        }
        if let Some(range) = within(CCM, &self.ccm) {
            return self.ccm.get(range);
        }
        within(flash::BASE, self.flash.bytes()).and_then(|range| self.flash.bytes().get(range))
    }

    /// Writes into SRAM or CCM, as a debugger does; false where neither is.
    pub fn write_memory(&mut self, address: u32, bytes: &[u8]) -> bool {
        let (start, memory) = match address {
            CCM..SRAM => (CCM, &mut self.ccm),
            _ => (SRAM, &mut self.sram),
        };
        let offset = address.wrapping_sub(start) as usize;
        let Some(place) =
            offset.checked_add(bytes.len()).and_then(|end| memory.get_mut(offset..end))
        else {
            return false;
        };
        place.copy_from_slice(bytes);
        let end = address + bytes.len() as u32;
        self.modify(address..end);
        true
    }

    /// Writes into flash, as a programmer does.
    pub fn load_flash(&mut self, offset: usize, bytes: &[u8]) {
        self.flash.load(offset, bytes);
        let start = flash::BASE + offset as u32;
        self.modify(start..start + bytes.len() as u32);
    }

    fn modify(&mut self, range: Range<u32>) {
        self.modified = Some(match self.modified.take() {
            None => range,
            Some(known) => known.start.min(range.start)..known.end.max(range.end),
        });
    }

    /// Handles every event that is due.
    pub(crate) fn advance(&mut self) {
        self.violations.now = self.now;
        loop {
            let due = self.now;
            if self.tim5.next_event() <= due {
                self.tim5.advance(due);
                self.refresh(Block::Tim5);
            } else if self.tim1.next_event() <= due {
                self.advance_motor();
            } else if self.adc.next_event() <= due {
                self.adc.advance(due, &mut *self.devices.drivetrain.borrow_mut());
                self.refresh(Block::Adc12);
            } else if let Some(adc) = self.slow_adcs.iter_mut().find(|adc| adc.next_event() <= due)
            {
                adc.advance(due, &mut *self.devices.drivetrain.borrow_mut());
            } else if let Some(number) = (0..2).find(|number| self.spi[*number].next_event() <= due)
            {
                self.spi[number].advance(due, &mut *self.devices.spi[number].borrow_mut());
                self.refresh(Block::Spi(number));
            } else if let Some(number) = (0..3).find(|number| self.i2c[*number].next_event() <= due)
            {
                let bus = self.devices.sensor_bus(self.buses[number]);
                self.i2c[number].advance(due, self.options.i2c_delay, &mut *bus.borrow_mut());
                self.refresh(Block::I2c(number));
            } else if self.usart.next_event(&*self.devices.serial.borrow()) <= due {
                let usart_base = base_of(&self.entries, Block::Usart);
                self.usart
                    .advance(&mut *self.devices.serial.borrow_mut(), context!(self, usart_base));
                self.refresh(Block::Usart);
            } else if self.fdcan.next_event(&*self.devices.can.borrow()) <= due {
                let fdcan_base = base_of(&self.entries, Block::Fdcan);
                self.fdcan.advance(&mut *self.devices.can.borrow_mut(), context!(self, fdcan_base));
                self.refresh(Block::Fdcan);
            } else if self.flash.next_event() <= due {
                if let Some(range) = self.flash.advance(due) {
                    self.modify(flash::BASE + range.start as u32..flash::BASE + range.end as u32);
                }
                self.refresh(Block::Flash);
            } else if self.rng.next_event() <= due {
                self.refresh(Block::Rng);
                break;
            } else if self.iwdg.next_event() <= due {
                self.request_reset(ResetCause::Watchdog);
                break;
            } else {
                break;
            }
        }
        self.plan();
    }

    fn advance_motor(&mut self) {
        let (duties, half) = (self.tim1.duties(), self.tim1.half_period());
        match self.tim1.advance(self.now) {
            Some(Moment::Trigger) if self.has_motor_trigger && self.tim1.triggers_converter() => {
                let adc_base = base_of(&self.entries, Block::Adc12);
                if self.adc.trigger(Trigger::Tim1Trgo2, context!(self, adc_base)) {
                    self.check_sampling(adc_base);
                }
            }
            Some(Moment::Trigger) | None => {}
            Some(moment @ (Moment::Top | Moment::Bottom)) => {
                self.devices.drivetrain.borrow_mut().half_period(half, duties);
                if moment == Moment::Bottom && self.tim1.triggers_on_update() {
                    let adc_base = base_of(&self.entries, Block::Adc345);
                    for adc in &mut self.slow_adcs {
                        adc.trigger(Trigger::Tim1Trgo, context!(self, adc_base));
                    }
                }
            }
        }
        self.disturb_converters();
        self.refresh(Block::Tim1);
    }

    /// Conversions of ADC1 overlap those of other converters.
    fn disturb_converters(&mut self) {
        if self.adc.is_converting() && self.slow_adcs.iter().any(Adc::is_converting) {
            self.adc.disturb();
            let address = base_of(&self.entries, Block::Adc12);
            let detail = "currents are converted while another converter converts";
            self.violations.report(Kind::Misconfigured, address, detail);
        }
    }

    /// A current is valid where its low side is on, and has been for as long as its amplifier takes to settle.
    fn check_sampling(&mut self, adc_base: u32) {
        let Some(windows) = self.tim1.low_side_windows() else { return };
        let context = context!(self, adc_base);
        for (channel, begins, ends) in self.adc.sampling_times(context) {
            let Some(phase) = self.adc.phase(channel) else { continue };
            let [opens, closes] = windows[phase];
            let settled = opens + self.options.amplifier_settling;
            if self.now + begins < settled || self.now + ends > closes {
                context.report(Kind::Misconfigured, 0, "a current is sampled before it is valid");
            }
        }
    }

    pub(crate) fn plan(&mut self) {
        let rng = if self.rng.interrupt(self.now) { Time::NEVER } else { self.rng.next_event() };
        let [first, second, third] = self.i2c.each_ref().map(I2c::next_event);
        let [encoder, inertial] = self.spi.each_ref().map(Spi::next_event);
        let [third_adc, fifth_adc] = self.slow_adcs.each_ref().map(Adc::next_event);
        let times = [
            self.tim5.next_event(),
            self.tim1.next_event(),
            self.adc.next_event(),
            third_adc,
            fifth_adc,
            encoder,
            inertial,
            first,
            second,
            third,
            self.usart.next_event(&*self.devices.serial.borrow()),
            self.fdcan.next_event(&*self.devices.can.borrow()),
            self.flash.next_event(),
            rng,
            self.iwdg.next_event(),
        ];
        self.next = times.into_iter().min().unwrap_or(Time::NEVER);
        self.pause_at = self.next.min(self.end);
    }

    /// Interrupt lines of a peripheral follow its flags; DMA serves its requests.
    fn refresh(&mut self, block: Block) {
        match block {
            Block::I2c(_) | Block::Usart | Block::Spi(1) if !self.dma.is_idle() => self.serve_dma(),
            _ => {}
        }
        let (system, numbers) = (&mut self.system, &self.interrupts);
        match block {
            Block::Tim5 => system.set_line(numbers.tim5, self.tim5.interrupt()),
            Block::Tim1 => {
                for (number, level) in numbers.tim1.into_iter().zip(self.tim1.interrupts()) {
                    system.set_line(number, level);
                }
            }
            Block::Adc12 => system.set_line(numbers.adc, self.adc.interrupt()),
            Block::I2c(place) => {
                for (number, level) in
                    numbers.i2c[place].into_iter().zip(self.i2c[place].interrupts())
                {
                    system.set_line(number, level);
                }
            }
            Block::Usart => system.set_line(numbers.usart, self.usart.interrupt()),
            Block::Fdcan => {
                for (number, level) in numbers.fdcan.into_iter().zip(self.fdcan.interrupts()) {
                    system.set_line(number, level);
                }
            }
            Block::Flash => system.set_line(numbers.flash, self.flash.interrupt()),
            Block::Rng => system.set_line(numbers.rng, self.rng.interrupt(self.now)),
            Block::Dma(_) | Block::DmaMux => {
                for (number, level) in self.dma.interrupts() {
                    system.set_line(number, level);
                }
            }
            Block::Exti => {
                for (number, level) in self.exti.interrupts() {
                    system.set_line(number, level);
                }
            }
            Block::Adc345
            | Block::FdcanRam
            | Block::Gpio(_)
            | Block::Iwdg
            | Block::Pwr
            | Block::Rcc
            | Block::Spi(_)
            | Block::Syscfg => {}
        }
    }

    /// Makes every transfer for which a request line is high.
    fn serve_dma(&mut self) {
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

    fn entry(&self, address: u32) -> Option<Entry> {
        let (map, start) = match address {
            0x4000_0000..0x4800_0000 => (&self.map[0], 0x4000_0000),
            0x4800_0000..0x5000_0000 => (&self.map[1], 0x4800_0000),
            0x5000_0000..0x6000_0000 => (&self.map[2], 0x5000_0000),
            _ => return None,
        };
        let place = *map.get(((address - start) / BLOCK) as usize)?;
        let entry = self.entries.get(usize::from(place))?;
        // Comparators and amplifiers lie behind SYSCFG, the other controllers' message RAM behind that of the first.
        match (entry.block, address & (BLOCK - 1)) {
            (Block::Syscfg, 0x30..) => None,
            (Block::FdcanRam, offset) if offset as usize / 4 >= fdcan::RAM_WORDS => None,
            _ => Some(*entry),
        }
    }

    /// An access to a peripheral: a store of a value, or a load. None where nothing answers.
    fn access(&mut self, address: u32, width: u32, store: Option<u32>) -> Option<u32> {
        self.violations.now = self.now;
        let Some(entry) = self.entry(address) else {
            self.violations.report(Kind::UnmodelledRegister, address & !3, "not emulated");
            return Some(0);
        };
        if let Some([enable, _]) = entry.bits
            && !self.rcc.is_set(enable)
        {
            self.violations.report(Kind::ClockGated, entry.base, "its clock is off");
            return Some(0);
        }
        let value = match store {
            Some(value) => {
                self.store(entry, (address & !3) - entry.base, value, width);
                0
            }
            None => lanes(self.load(entry, (address & !3) - entry.base), address, width),
        };
        self.refresh(entry.block);
        self.plan();
        Some(value)
    }

    fn load(&mut self, entry: Entry, offset: u32) -> u32 {
        let context = context!(self, entry.base);
        match entry.block {
            Block::Adc12 => self.adc.read(offset, context),
            Block::Adc345 => {
                let (converter, offset) = slow_adc(offset);
                match self.slow_adcs.get_mut(converter) {
                    Some(adc) => adc.read(offset, context),
                    None => context.unmodelled(offset),
                }
            }
            Block::Dma(controller) => self.dma.read(controller, offset, context),
            Block::DmaMux => self.dma.read_mux(offset, context),
            Block::Exti => self.exti.read(offset, context),
            Block::Fdcan => self.fdcan.read(offset, context),
            Block::FdcanRam => self.fdcan.read_ram(offset).unwrap_or(0),
            Block::Flash => self.flash.read_register(offset, context),
            Block::Gpio(port) => {
                for (bus, pins) in
                    self.devices.sensor_buses.iter().zip(self.options.wiring.sensor_buses)
                {
                    for (pin, is_released) in pins.into_iter().zip(bus.borrow().released(self.now))
                    {
                        self.gpio[pin.port].drive_externally(pin.number, Some(is_released));
                    }
                }
                self.gpio[port].read(offset, context)
            }
            Block::I2c(number) => {
                let bus = self.devices.sensor_bus(self.buses[number]);
                self.i2c[number].read(offset, self.options.i2c_delay, &*bus.borrow(), context)
            }
            Block::Iwdg => self.iwdg.read(offset, context),
            Block::Pwr => self.pwr.read(offset, context),
            Block::Rcc => {
                let clocks = *self.rcc.clocks();
                let violations = &mut self.violations;
                self.rcc.read(
                    offset,
                    &mut Context { now: self.now, clocks: &clocks, violations, base: entry.base },
                )
            }
            Block::Rng => self.rng.read(offset, context),
            Block::Spi(number) => self.spi[number].read(offset, context),
            Block::Syscfg => self.syscfg.read(offset, context),
            Block::Tim1 => self.tim1.read(offset, context),
            Block::Tim5 => self.tim5.read(offset, context),
            Block::Usart => self.usart.read(offset, context),
        }
    }

    fn store(&mut self, entry: Entry, offset: u32, value: u32, width: u32) {
        if entry.block == Block::Spi(0) && offset == spi::DATA {
            self.check_encoder_edge("the rotor sensor is clocked within 350 ns of its select");
        }
        let functions = &self.functions;
        let has = |pins: &[(Pin, u8)]| {
            pins.iter().all(|(pin, function)| {
                self.gpio[pin.port].mode(pin.number) == Mode::Alternate(*function)
            })
        };
        let context = context!(self, entry.base);
        match entry.block {
            Block::Adc12 => {
                let mut inputs = self.options.wiring.analog.into_iter();
                let has_pins =
                    inputs.all(|pin| self.gpio[pin.port].mode(pin.number) == Mode::Analog);
                self.adc.write(offset, value, has_pins, context);
            }
            Block::Adc345 => {
                let mut inputs = self.options.wiring.thermistors.into_iter();
                let has_pins =
                    inputs.all(|pin| self.gpio[pin.port].mode(pin.number) == Mode::Analog);
                match (slow_adc(offset), &mut self.slow_adcs) {
                    ((_, adc::COMMON_CCR), adcs) => {
                        for adc in adcs {
                            adc.write(adc::COMMON_CCR, value, has_pins, context);
                        }
                    }
                    ((converter, offset), adcs) => match adcs.get_mut(converter) {
                        Some(adc) => adc.write(offset, value, has_pins, context),
                        None => {
                            context.unmodelled_write(offset);
                        }
                    },
                }
            }
            Block::Dma(controller) => {
                self.dma.write(controller, offset, value, context);
                if !self.dma.is_idle() {
                    self.serve_dma();
                    self.refresh(Block::I2c(0));
                    self.refresh(Block::I2c(1));
                    self.refresh(Block::I2c(2));
                    self.refresh(Block::Spi(1));
                    self.refresh(Block::Usart);
                }
            }
            Block::DmaMux => self.dma.write_mux(offset, value, context),
            Block::Exti => self.exti.write(offset, value, context),
            Block::Fdcan => {
                let has_pins = has(&functions.can);
                let is_sending = self.devices.can.borrow().is_sending();
                self.fdcan.write(offset, value, [has_pins, is_sending], context);
                self.fdcan.check_timing(&*self.devices.can.borrow(), context);
                self.fdcan.offer(&mut *self.devices.can.borrow_mut(), self.now);
            }
            Block::FdcanRam => self.fdcan.write_ram(offset, value, width, context),
            Block::Flash => self.flash.write_register(offset, value, context),
            Block::Gpio(port) => self.store_gpio(port, offset, value, entry.base),
            Block::I2c(number) => {
                let pads =
                    [self.buses[number].is_some(), self.syscfg.fast_mode_plus(number as u32 + 1)];
                self.i2c[number].write(offset, value, pads, self.options.i2c_delay, context);
            }
            Block::Iwdg => {
                if self.iwdg.write(offset, value, context) {
                    self.rcc.start_lsi(self.now);
                }
            }
            Block::Pwr => {
                self.pwr.write(offset, value, context);
                self.update_supply_break();
            }
            Block::Rcc => self.store_rcc(offset, value, entry.base),
            Block::Rng => self.rng.write(offset, value, context),
            Block::Spi(number) => {
                let [.., select] = self.options.wiring.spi(number);
                let is_selected = self.gpio[select.port].driven(select.number) == Some(false);
                let pins = [has(&self.functions.spi[number]), is_selected];
                let clocks = *self.rcc.clocks();
                let bus = if number == 0 { clocks.apb2 } else { clocks.apb1 };
                let cycles = |count| bus.cycles(count);
                self.spi[number].write(offset, value, width, pins, cycles, context);
            }
            Block::Syscfg => {
                self.syscfg.write(offset, value, context);
                self.update_supply_break();
            }
            Block::Tim1 => {
                let has_pins = has(&functions.bridges);
                self.tim1.write(offset, value, has_pins, context);
            }
            Block::Tim5 => self.tim5.write(offset, value, context),
            Block::Usart => {
                let has_pins = has(&functions.serial);
                self.usart.write(offset, value, has_pins, context);
            }
        }
    }

    fn store_rcc(&mut self, offset: u32, value: u32, base: u32) {
        let clocks = *self.rcc.clocks();
        let before: Vec<_> = if Rcc::is_reset_register(offset) {
            self.entries
                .iter()
                .filter(|entry| self.is_held_in_reset(entry))
                .map(|entry| entry.base)
                .collect()
        } else {
            Vec::new()
        };
        let violations = &mut self.violations;
        self.rcc.write(
            offset,
            value,
            &mut Context { now: self.now, clocks: &clocks, violations, base },
        );
        if Rcc::is_reset_register(offset) {
            let held: Vec<_> =
                self.entries.iter().filter(|entry| self.is_held_in_reset(entry)).copied().collect();
            for entry in held.into_iter().filter(|entry| !before.contains(&entry.base)) {
                self.reset_block(entry.block);
            }
        }
        self.update_clocks();
    }

    fn is_held_in_reset(&self, entry: &Entry) -> bool {
        entry.bits.is_some_and(|[_, reset]| self.rcc.is_set(reset))
    }

    fn reset_block(&mut self, block: Block) {
        match block {
            Block::Adc12 => self.adc.reset(),
            Block::Adc345 => self.slow_adcs.iter_mut().for_each(Adc::reset),
            Block::Dma(controller) => self.dma.reset(controller),
            Block::Fdcan => self.fdcan.reset(),
            Block::Gpio(port) => self.gpio[port].reset(port),
            Block::I2c(number) => self.i2c[number] = I2c::new(),
            Block::Rng => self.rng.reset(),
            Block::Spi(number) => self.spi[number].reset(),
            Block::Syscfg => self.syscfg = Syscfg::default(),
            Block::Tim1 => self.tim1.reset(self.now),
            Block::Tim5 => self.tim5 = Timer::new(),
            Block::Usart => self.usart = Usart::new(),
            Block::Pwr => self.pwr.reset(),
            Block::DmaMux
            | Block::Exti
            | Block::FdcanRam
            | Block::Flash
            | Block::Iwdg
            | Block::Rcc => {}
        }
        self.refresh(block);
        self.update_clocks();
        self.update_connections();
        self.update_supply_break();
    }

    fn update_clocks(&mut self) {
        let clocks = *self.rcc.clocks();
        self.cycle = clocks.core.period();
        for (i2c, clock) in self.i2c.iter_mut().zip(clocks.i2c) {
            i2c.set_clock(clock);
        }
        self.tim1.set_clock(clocks.apb2_timers, self.now);
        self.usart.set_clock(clocks.usart2);
        self.fdcan.set_clock(clocks.fdcan);
        let limit = self.pwr.limit();
        let address = base_of(&self.entries, Block::Rcc);
        if clocks.system > limit {
            self.violations.report(
                Kind::ClockLimit,
                address,
                "system clock above the limit of the voltage range",
            );
        }
        let needed = Flash::needed_wait_states(clocks.core, limit.0 > 150_000_000);
        if self.flash.wait_states() < needed {
            self.violations.report(Kind::ClockLimit, address, "too few wait states of flash");
        }
    }

    fn store_gpio(&mut self, port: usize, offset: u32, value: u32, base: u32) {
        let wiring = &self.options.wiring;
        let [encoder, inertial] = [0, 1].map(|number| {
            let [.., select] = wiring.spi(number);
            select
        });
        let watched = [encoder, inertial, wiring.sensor_buses[0][0], wiring.sensor_buses[1][0]];
        let levels = |gpio: &[Gpio; 7]| watched.map(|pin| gpio[pin.port].driven(pin.number));
        let before = levels(&self.gpio);
        let all_before = self.port_levels(port);
        self.gpio[port].write(offset, value, context!(self, base));
        let after = levels(&self.gpio);
        let [encoder_before, inertial_before, clocks_before @ ..] = before;
        let [encoder_after, inertial_after, clocks_after @ ..] = after;
        for (number, before, after) in
            [(0, encoder_before, encoder_after), (1, inertial_before, inertial_after)]
        {
            if before != after
                && let Some(is_high) = after
            {
                if is_high {
                    self.spi[number].deselect();
                }
                if number == 0 {
                    if !is_high {
                        self.check_encoder_edge(
                            "the rotor sensor's select is high for less than 350 ns",
                        );
                    }
                    self.encoder_edge = self.now;
                }
                self.devices.spi[number].borrow_mut().select(self.now, !is_high);
            }
        }
        for ((bus, before), after) in
            self.devices.sensor_buses.iter().zip(clocks_before).zip(clocks_after)
        {
            // Let go, the clock line rises by its pull-up.
            if before == Some(false) && after != Some(false) {
                bus.borrow_mut().pulse();
            }
        }
        let changed = all_before ^ self.port_levels(port);
        for line in
            (0..16).filter(|line| changed >> line & 1 != 0 && self.syscfg.exti_port(*line) == port)
        {
            self.exti.edge(line, self.gpio[port].level(line));
        }
        self.refresh(Block::Exti);
        self.update_connections();
    }

    /// The AS5047P needs 350 ns from each edge of its select to what follows (datasheet, table 14: tL, tCSn).
    fn check_encoder_edge(&mut self, detail: &'static str) {
        if self.now.since(self.encoder_edge) < SELECT {
            let address = base_of(&self.entries, Block::Spi(0));
            self.violations.report(Kind::Misconfigured, address, detail);
        }
    }

    fn port_levels(&self, port: usize) -> u16 {
        (0..16).fold(0, |levels, pin| levels | u16::from(self.gpio[port].level(pin)) << pin)
    }

    /// Which sensor bus each I2C peripheral is at, and the level at the break input.
    fn update_connections(&mut self) {
        let gpio = &self.gpio;
        let buses = self.options.wiring.sensor_buses;
        self.buses = self.functions.i2c.map(|functions| {
            buses.iter().zip(functions).position(|(pins, functions)| {
                functions.is_some_and(|functions| {
                    pins.iter().zip(functions).all(|(pin, function)| {
                        let port = &gpio[pin.port];
                        port.mode(pin.number) == Mode::Alternate(function)
                            && port.is_open_drain(pin.number)
                    })
                })
            })
        });
        let (pin, function) = self.functions.break_input;
        let port = &self.gpio[pin.port];
        let level = port.mode(pin.number) == Mode::Alternate(function) && port.level(pin.number);
        self.tim1.set_break_input(0, level, self.now);
    }

    /// Reading or storing in SRAM or flash failed: what the core does elsewhere.
    #[cold]
    fn read_elsewhere(&mut self, address: u32, width: Width) -> Result<u32, BusError> {
        let bytes = width.bytes();
        match address {
            // Flash, from which the chip started.
            0..BOOT_SIZE => self.read(address + flash::BASE, width),
            CCM_ALIAS..=0x2001_FFFF => {
                let bytes =
                    self.memory(address - CCM_ALIAS + CCM, bytes as usize).ok_or(BusError)?;
                Ok(little_endian(bytes))
            }
            CALIBRATION_30_C | CALIBRATION_130_C if bytes == 2 => {
                let [cold, hot] = TEMPERATURE_CALIBRATION;
                Ok(if address == CALIBRATION_30_C { cold } else { hot })
            }
            DBGMCU..=0xE004_23FF => Ok(self.dbgmcu.read(address - DBGMCU, context!(self, DBGMCU))),
            BELOW_SRAM..SRAM => self.access_gap(address).map(|()| 0),
            PRIVATE..=0xE00F_FFFF => match self.mpu.read(address).or(self.system.read(address)) {
                Some(value) => Ok(lanes(value, address, bytes)),
                None => {
                    self.violations.report(Kind::UnmodelledRegister, address, "not emulated");
                    Ok(0)
                }
            },
            0x4000_0000..0x6000_0000 => self.access(address, bytes, None).ok_or(BusError),
            _ => Err(BusError),
        }
    }

    #[cold]
    fn write_elsewhere(&mut self, address: u32, width: Width, value: u32) -> Result<(), BusError> {
        let bytes = width.bytes();
        match address {
            CCM_ALIAS..=0x2001_FFFF => {
                let stored = self.write_memory(
                    address - CCM_ALIAS + CCM,
                    &value.to_le_bytes()[..bytes as usize],
                );
                if stored { Ok(()) } else { Err(BusError) }
            }
            DBGMCU..=0xE004_23FF => {
                self.dbgmcu.write(address - DBGMCU, value, context!(self, DBGMCU));
                Ok(())
            }
            BELOW_SRAM..SRAM => self.access_gap(address),
            PRIVATE..=0xE00F_FFFF => {
                if !self.mpu.write(address, value) && !self.system.write(address, width, value) {
                    self.violations.report(Kind::UnmodelledRegister, address, "not emulated");
                }
                Ok(())
            }
            0x4000_0000..0x6000_0000 => {
                self.access(address, bytes, Some(value)).map(|_| ()).ok_or(BusError)
            }
            flash::BASE..0x0808_0000 => {
                let flash_base = base_of(&self.entries, Block::Flash);
                self.flash.store(
                    (address - flash::BASE) as usize,
                    value,
                    bytes,
                    context!(self, flash_base),
                );
                self.refresh(Block::Flash);
                self.plan();
                Ok(())
            }
            _ => Err(BusError),
        }
    }

    /// Nothing is there, and whether an access faults is not stated: here a store is lost, and a load gives zero.
    fn access_gap(&mut self, address: u32) -> Result<(), BusError> {
        if self.mpu.forbids(address) {
            return Err(BusError);
        }
        self.violations.report(
            Kind::UnmodelledRegister,
            BELOW_SRAM,
            "reserved addresses below SRAM",
        );
        Ok(())
    }

    /// The first access to a cut of SRAM after a reset: a write is lost (ES0430 2.2.7). Whether this is one.
    #[cold]
    fn touch(&mut self, address: u32) -> bool {
        let cut = match address {
            SRAM..SRAM_2 => 1,
            SRAM_2..CCM_ALIAS => 2,
            CCM_ALIAS..=0x2001_FFFF | CCM..=0x1000_7FFF => 4,
            _ => 0,
        };
        let is_first = self.untouched & cut != 0;
        self.untouched &= !cut;
        is_first
    }

    /// A word with two wrong bits was read.
    #[cold]
    fn fail_flash(&mut self) {
        self.system.pend_nmi();
        if self.syscfg.breaks_on(BreakSource::FlashEcc) {
            self.tim1.system_break(Some(BreakSource::FlashEcc), self.now);
        }
    }
}

impl Bus for Soc {
    fn fetch(&mut self, address: u32) -> Result<u16, BusError> {
        let bytes = self.memory(address, 2).ok_or(BusError)?;
        Ok(little_endian(bytes) as u16)
    }

    #[inline]
    fn read(&mut self, address: u32, width: Width) -> Result<u32, BusError> {
        let length = width.bytes() as usize;
        if self.untouched != 0 {
            self.touch(address);
        }
        let offset = address.wrapping_sub(SRAM) as usize;
        if let Some(bytes) = self.sram.get(offset..offset.wrapping_add(length)) {
            return Ok(little_endian(bytes));
        }
        let offset = address.wrapping_sub(flash::BASE) as usize;
        if offset < flash::SIZE {
            let had_failed = self.flash.has_failed();
            let value = self.flash.read(offset, length).map(little_endian).ok_or(BusError);
            if self.flash.has_failed() && !had_failed {
                self.fail_flash();
            }
            return value;
        }
        let offset = address.wrapping_sub(CCM) as usize;
        if let Some(bytes) = self.ccm.get(offset..offset.wrapping_add(length)) {
            return Ok(little_endian(bytes));
        }
        self.read_elsewhere(address, width)
    }

    #[inline]
    fn write(&mut self, address: u32, width: Width, value: u32) -> Result<(), BusError> {
        let length = width.bytes() as usize;
        if self.untouched != 0 && self.touch(address) {
            return Ok(());
        }
        for (start, memory) in [(SRAM, &mut self.sram), (CCM, &mut self.ccm)] {
            let offset = address.wrapping_sub(start) as usize;
            if let Some(place) = memory.get_mut(offset..offset.wrapping_add(length)) {
                place.copy_from_slice(&value.to_le_bytes()[..length]);
                return Ok(());
            }
        }
        self.write_elsewhere(address, width, value)
    }

    fn set_program_counter(&mut self, pc: u32) {
        self.violations.pc = pc;
    }

    #[inline]
    fn system(&mut self) -> &mut SystemControl {
        &mut self.system
    }

    #[inline]
    fn elapse(&mut self, cycles: u32) {
        self.now += Time::from_ps(u64::from(cycles) * self.cycle.ps());
    }

    #[inline]
    fn event_due(&self) -> bool {
        self.now >= self.pause_at
    }

    fn take_modified_code(&mut self) -> Option<Range<u32>> {
        self.modified.take()
    }
}

/// The bytes of a register's word that an access to an address within it reads.
const fn lanes(word: u32, address: u32, bytes: u32) -> u32 {
    let shifted = word >> (8 * (address & 3));
    match bytes {
        4 => shifted,
        _ => shifted & ((1 << (8 * bytes)) - 1),
    }
}

fn little_endian(bytes: &[u8]) -> u32 {
    match *bytes {
        [a, b, c, d] => u32::from_le_bytes([a, b, c, d]),
        [a, b] => u16::from_le_bytes([a, b]).into(),
        [a] => a.into(),
        _ => 0,
    }
}

/// ADC3 with both thermistors and ADC5 with the chip's own sensor (RM0440 table 163).
fn slow_adcs(wiring: &Wiring) -> [Adc; 2] {
    const CHIP: u32 = 4;
    let [motor, stage] = Wiring::adc_channels("ADC3", wiring.thermistors);
    [vec![(motor, 1), (stage, 2)], vec![(CHIP, 0)]]
        .map(|inputs| Adc::new(Inputs::Temperatures(inputs)))
}

/// Which of [`slow_adcs`] an offset behind ADC3 belongs to, and the offset in its registers. ADC4 is between them; the
/// common registers are those of both.
const fn slow_adc(offset: u32) -> (usize, u32) {
    match offset {
        0x000..0x100 => (0, offset),
        0x200..0x300 => (1, offset - 0x200),
        0x300.. => (0, offset),
        _ => (usize::MAX, offset),
    }
}

/// Clock gate and reset of a block; some have neither, or share those of another.
fn gate(name: &str, block: Block) -> Option<[RccBit; 2]> {
    match block {
        Block::FdcanRam => rcc_bits("FDCAN1"),
        _ => rcc_bits(name),
    }
}

fn map(entries: &[Entry]) -> [Vec<u8>; 3] {
    [(0x4000_0000_u32, 0x2_4000_u32), (0x4800_0000, 0x1C00), (0x5000_0000, 0x6_0C00)].map(
        |(start, length)| {
            let mut map = vec![u8::MAX; (length / BLOCK) as usize];
            for (place, entry) in entries.iter().enumerate() {
                let block = entry.base.wrapping_sub(start) / BLOCK;
                if let Some(slot) = map.get_mut(block as usize) {
                    *slot = place as u8;
                }
            }
            map
        },
    )
}

fn base_of(entries: &[Entry], block: Block) -> u32 {
    entries.iter().find(|entry| entry.block == block).map_or(0, |entry| entry.base)
}

fn requests() -> [Option<Request>; 128] {
    let mut requests = [None; 128];
    let names = [
        ("I2C1", Block::I2c(0)),
        ("I2C2", Block::I2c(1)),
        ("I2C3", Block::I2c(2)),
        ("USART2", Block::Usart),
        ("SPI3", Block::Spi(1)),
    ];
    for (name, block) in names {
        for (line, signal) in ["RX", "TX"].into_iter().enumerate() {
            requests[usize::from(dma_request(name, signal))] = Some(Request { block, line });
        }
    }
    requests
}

/// RAM contents at power-on (pseudo-random).
fn noise(length: usize, seed: u64) -> Vec<u8> {
    let mut state = seed;
    let next = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    };
    std::iter::repeat_with(next).take(length).collect()
}

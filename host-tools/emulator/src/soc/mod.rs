//! The system on chip: memories, address map, clocks, interrupts, DMA, and the connections of peripherals to each other
//! and to the board.
//!
//! - this file: the parts of the chip, resets, and the order of their events.
//! - `map`: blocks of addresses, pins and DMA requests.
//! - `access`: loads and stores of registers, with their effects on other peripherals.
//! - `memory`: SRAM, CCM and flash; the core's bus.
//! - `dma`: transfers.
//! - `board`: faults and conditions from outside.

mod access;
mod board;
mod dma;
mod map;
mod memory;

use std::ops::Range;

use crate::core::SystemControl;
use crate::devices::Devices;
use crate::mpu::Mpu;
use crate::peripherals::adc::{Adc, Inputs, Trigger};
use crate::peripherals::clocks::{Rcc, ResetCause};
use crate::peripherals::dma::Dma;
use crate::peripherals::fdcan::Fdcan;
use crate::peripherals::flash::{self, Flash};
use crate::peripherals::gpio::{Gpio, Mode};
use crate::peripherals::i2c::I2c;
use crate::peripherals::motor_timer::{Moment, MotorTimer};
use crate::peripherals::power::Pwr;
use crate::peripherals::rng::Rng;
use crate::peripherals::spi::Spi;
use crate::peripherals::syscfg::{BreakSource, Dbgmcu, Syscfg};
use crate::peripherals::timer::Timer;
use crate::peripherals::usart::Usart;
use crate::peripherals::watchdog::Watchdog;
use crate::time::{Frequency, Time};
use crate::violations::{Kind, Violations};
use crate::wiring::Wiring;
pub use board::UnseenFrames;
use map::{BLOCKS, Block, Entry, Functions, Interrupts, Request, base_of, entries, map, requests};
use memory::{ALL_CUTS, CCM, CCM_ALIAS, CCM_SIZE, SRAM_SIZE, noise};
pub use memory::{SRAM, TEMPERATURE_CALIBRATION};

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

/// Calls a peripheral with its context.
macro_rules! context {
    ($soc:ident, $base:expr) => {
        &mut $crate::peripherals::Context {
            now: $soc.now,
            clocks: $soc.rcc.clocks(),
            violations: &mut $soc.violations,
            base: $base,
        }
    };
}
use context;

impl Soc {
    /// A chip at power-on, before its first instruction.
    pub fn new(options: Options, devices: Devices) -> Self {
        let entries = entries();
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
            interrupts: Interrupts::new(),
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

    fn update_supply_break(&mut self) {
        let is_low = self.pwr.is_supply_low() && self.syscfg.breaks_on(BreakSource::Supply);
        self.tim1.set_supply_break(is_low, self.now);
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
}

/// ADC3 with both thermistors and ADC5 with the chip's own sensor (RM0440 table 163).
fn slow_adcs(wiring: &Wiring) -> [Adc; 2] {
    const CHIP: u32 = 4;
    let [motor, stage] = Wiring::adc_channels("ADC3", wiring.thermistors);
    [vec![(motor, 1), (stage, 2)], vec![(CHIP, 0)]]
        .map(|inputs| Adc::new(Inputs::Temperatures(inputs)))
}

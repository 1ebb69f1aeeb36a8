//! An I2C peripheral as a controller, RM0440 section 41: transfers byte by byte, with what an aborted one leaves behind.
//!
//! A transfer that the program drops half-way stays half-way: SCL is held low (BUSY), a received byte waits in RXDR and
//! is the first that the next transfer's DMA reads. Only PE = 0 ends that state (41.4.6).

use stm32_metapac::i2c::regs::{Cr1, Cr2, Isr, Timingr};

use crate::devices::I2cBus;
use crate::peripherals::{Context, bit};
use crate::registers::registers;
use crate::time::{Frequency, Time};
use crate::violations::Kind;

registers! { "I2C1":
    CR1 = 0x00, CR2 = 0x04, OAR1 = 0x08, OAR2 = 0x0C, TIMINGR = 0x10, TIMEOUTR = 0x14, ISR = 0x18, ICR = 0x1C,
    PECR = 0x20, RXDR = 0x24, TXDR = 0x28,
}

/// Bits on the bus: start and an address with its acknowledgement; a byte; a stop.
const ADDRESS_BITS: u64 = 10;
const BYTE_BITS: u64 = 9;
const STOP_BITS: u64 = 1;
/// The shortest bit that ordinary pads drive: 400 kHz.
const FAST_MODE_BIT: Time = Time::from_ns(2400);
/// Kernel cycles that synchronisation adds to a bit.
const SYNCHRONISATION: u64 = 4;
/// The slowest kernel clock of Fast-mode Plus (RM0440 41.4.2; embassy-stm32 asserts it; ES0430 2.15.1 has 20 MHz): a slower one
/// samples data wrongly.
const FAST_MODE_PLUS_CLOCK: Frequency = Frequency(17_000_000);
/// How often lines that a device holds are looked at again.
const BLOCKED: Time = Time::from_us(5);
/// Flags that ICR clears.
const CLEARABLE: u32 = 0x3F38;
/// Enables of events in CR1 are one bit next to the flags in ISR, but for these (41.9.1, 41.9.7).
const TXIE: u32 = 1;
const RXIE: u32 = 2;
const NACKIE: u32 = 4;
const STOPIE: u32 = 5;
const TCIE: u32 = 6;
const ERRIE: u32 = 7;

/// Where the controller is in a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Idle,
    /// Start and address are on the bus.
    Address,
    /// A byte to send is awaited, SCL is held low.
    AwaitByte,
    /// It is on the bus.
    Send(u8),
    /// A byte comes in.
    Receive,
    /// RXDR is full: SCL is held low until it is read.
    AwaitRead,
    /// NBYTES have passed: SCL is held low until a restart, a stop, or more bytes.
    Hold,
    /// A stop is on the bus.
    Stop,
}

/// The peripheral.
#[derive(Clone)]
pub struct I2c {
    cr1: Cr1,
    cr2: Cr2,
    isr: Isr,
    timing: u32,
    own_addresses: [u32; 2],
    timeout: u32,
    received: u8,
    /// TXDR, where TXE = 0.
    transmit: u8,
    left: u8,
    phase: Phase,
    /// Until when the phase takes; [`Time::NEVER`] where it waits.
    due: Time,
    /// A device has acknowledged its address and hears.
    is_addressed: bool,
    /// Kernel clock; PE = 0 stops it all the same.
    clock: Frequency,
    /// By which a stop comes late.
    stop_delay: Time,
}

impl I2c {
    pub(crate) fn new() -> Self {
        let mut isr = Isr(0);
        isr.set_txe(true);
        Self {
            cr1: Cr1(0),
            cr2: Cr2(0),
            isr,
            timing: 0,
            own_addresses: [0; 2],
            timeout: 0,
            received: 0,
            transmit: 0,
            left: 0,
            phase: Phase::Idle,
            due: Time::NEVER,
            is_addressed: false,
            clock: Frequency(0),
            stop_delay: Time::ZERO,
        }
    }

    pub(crate) fn next_event(&self) -> Time {
        self.due
    }

    /// A bit: low and high time by TIMINGR, what edges and filter add to both, and two cycles of synchronisation for each
    /// (41.4.9).
    fn bits(&self, count: u64, delay: Time) -> Time {
        let timing = Timingr(self.timing);
        let cycles = u64::from(timing.scll()) + u64::from(timing.sclh()) + 2;
        let cycles = cycles * (u64::from(timing.presc()) + 1) + SYNCHRONISATION;
        let bit = self.clock.cycles(cycles) + delay;
        Time::from_ps(bit.ps().saturating_mul(count))
    }

    /// The lines are held by a device: nothing goes on until it lets them go.
    fn is_blocked(bus: &dyn I2cBus, now: Time) -> bool {
        bus.released(now) != [true; 2]
    }

    /// What is due has happened. `delay` is what edges and filter add to a bit.
    pub(crate) fn advance(&mut self, now: Time, delay: Time, bus: &mut dyn I2cBus) {
        if self.due > now {
            return;
        }
        self.due = Time::NEVER;
        if Self::is_blocked(bus, now) {
            self.due = now + BLOCKED;
            return;
        }
        match self.phase {
            Phase::Address => self.end_address(now, delay, bus),
            Phase::Send(byte) => {
                let is_acknowledged = bus.write(byte);
                self.left = self.left.saturating_sub(1);
                match (is_acknowledged, self.left) {
                    (false, _) => self.refuse(now, delay),
                    (true, 0) => self.end_bytes(now, delay),
                    (true, _) => self.send_or_await_byte(now, delay),
                }
            }
            Phase::Receive => {
                self.received = bus.read();
                self.isr.set_rxne(true);
                self.left = self.left.saturating_sub(1);
                match self.left {
                    0 => self.end_bytes(now, delay),
                    _ => self.phase = Phase::AwaitRead,
                }
            }
            Phase::Stop => {
                if std::mem::take(&mut self.is_addressed) {
                    bus.stop();
                }
                self.isr.set_stopf(true);
                self.isr.set_busy(false);
                self.cr2.set_stop(false);
                self.isr.set_txis(false);
                self.phase = Phase::Idle;
                // A start that was asked for meanwhile (41.4.9).
                if self.cr2.start() {
                    self.start(now, delay);
                }
            }
            Phase::Idle | Phase::AwaitByte | Phase::AwaitRead | Phase::Hold => {}
        }
    }

    fn end_address(&mut self, now: Time, delay: Time, bus: &mut dyn I2cBus) {
        self.cr2.set_start(false);
        let address = (self.cr2.sadd() >> 1) as u8 & 0x7F;
        let is_read = self.cr2.dir().to_bits() == 1;
        if !bus.address(now, address, is_read) {
            self.is_addressed = false;
            self.refuse(now, delay);
            return;
        }
        self.is_addressed = true;
        self.left = self.cr2.nbytes();
        match (is_read, self.left) {
            (_, 0) => self.end_bytes(now, delay),
            (true, _) if self.isr.rxne() => self.phase = Phase::AwaitRead,
            (true, _) => self.receive(now, delay),
            (false, _) => self.send_or_await_byte(now, delay),
        }
    }

    /// A NACK ends the transfer with a stop, whatever AUTOEND says (41.4.9).
    fn refuse(&mut self, now: Time, delay: Time) {
        self.isr.set_nackf(true);
        self.stop(now, delay);
    }

    fn start(&mut self, now: Time, delay: Time) {
        self.isr.set_busy(true);
        self.isr.set_tc(false);
        self.isr.set_tcr(false);
        self.phase = Phase::Address;
        self.due = now + self.bits(ADDRESS_BITS, delay);
    }

    fn stop(&mut self, now: Time, delay: Time) {
        self.isr.set_tc(false);
        self.phase = Phase::Stop;
        self.due = now + self.bits(STOP_BITS, delay) + self.stop_delay;
    }

    fn receive(&mut self, now: Time, delay: Time) {
        self.phase = Phase::Receive;
        self.due = now + self.bits(BYTE_BITS, delay);
    }

    /// TXDR may be written before it is asked for.
    fn send_or_await_byte(&mut self, now: Time, delay: Time) {
        if self.isr.txe() {
            self.phase = Phase::AwaitByte;
            self.isr.set_txis(true);
        } else {
            self.phase = Phase::Send(self.transmit);
            self.isr.set_txe(true);
            self.due = now + self.bits(BYTE_BITS, delay);
        }
    }

    fn end_bytes(&mut self, now: Time, delay: Time) {
        if self.cr2.reload().to_bits() == 1 {
            self.isr.set_tcr(true);
            self.phase = Phase::Hold;
        } else if self.cr2.autoend().to_bits() == 1 {
            self.stop(now, delay);
        } else {
            self.isr.set_tc(true);
            self.phase = Phase::Hold;
        }
    }

    /// Leaves a byte in the data register, as an aborted transfer does.
    pub(crate) fn leave_byte(&mut self, byte: u8) {
        self.received = byte;
        self.isr.set_rxne(true);
    }

    /// Lets each stop come late.
    pub(crate) fn delay_stops(&mut self, delay: Time) {
        self.stop_delay = delay;
    }

    /// Detects a bus error that is none: the transfer goes on (ES0430 2.15.2).
    pub(crate) fn raise_bus_error(&mut self) {
        self.isr.set_berr(true);
    }

    /// Levels of the interrupts: event, error.
    pub(crate) fn interrupts(&self) -> [bool; 2] {
        let enabled = |place| bit(self.cr1.0, place);
        let event = enabled(TXIE) && self.isr.txis()
            || enabled(RXIE) && self.isr.rxne()
            || enabled(NACKIE) && self.isr.nackf()
            || enabled(STOPIE) && self.isr.stopf()
            || enabled(TCIE) && (self.isr.tc() || self.isr.tcr());
        let error = enabled(ERRIE) && self.isr.0 & 0x3F00 != 0;
        [event, error]
    }

    /// Levels of the DMA requests: receive, transmit.
    pub(crate) fn dma_requests(&self) -> [bool; 2] {
        [self.cr1.rxdmaen() && self.isr.rxne(), self.cr1.txdmaen() && self.isr.txis()]
    }

    pub(crate) fn read(
        &mut self,
        offset: u32,
        delay: Time,
        bus: &dyn I2cBus,
        context: &mut Context,
    ) -> u32 {
        match offset {
            CR1 => self.cr1.0,
            CR2 => self.cr2.0,
            OAR1 | OAR2 => self.own_addresses[(offset - OAR1) as usize / 4],
            TIMINGR => self.timing,
            TIMEOUTR => self.timeout,
            // A line that a device holds low looks like a transfer of somebody else.
            ISR => {
                self.isr.0 | u32::from(self.cr1.pe() && Self::is_blocked(bus, context.now)) << 15
            }
            ICR | PECR => 0,
            RXDR => {
                self.isr.set_rxne(false);
                if self.phase == Phase::AwaitRead {
                    self.receive(context.now, delay);
                }
                self.received.into()
            }
            TXDR => 0,
            _ => context.unmodelled(offset),
        }
    }

    /// `has_pins`: clock and data are connected to pins, open drain.
    /// `is_fast_mode_plus`: their pads drive 20 mA.
    pub(crate) fn write(
        &mut self,
        offset: u32,
        value: u32,
        [has_pins, is_fast_mode_plus]: [bool; 2],
        delay: Time,
        context: &mut Context,
    ) {
        match offset {
            CR1 => {
                self.write_cr1(value, has_pins, context);
                if self.cr1.pe() && !is_fast_mode_plus && self.bits(1, delay) < FAST_MODE_BIT {
                    context.misconfigured(
                        CR1,
                        "more than 400 kHz without the drivers of 20 mA (SYSCFG_CFGR1)",
                    );
                }
                if self.cr1.pe()
                    && self.bits(1, delay) < FAST_MODE_BIT
                    && self.clock < FAST_MODE_PLUS_CLOCK
                {
                    context.misconfigured(CR1, "Fast-mode Plus with a kernel clock below 17 MHz");
                }
            }
            CR2 => self.write_cr2(value, delay, context),
            TIMINGR if self.cr1.pe() => {
                context.write_protected(offset, "the timing while the peripheral is on")
            }
            TIMINGR => self.timing = value,
            OAR1 | OAR2 => {
                if bit(value, 15) {
                    context.unmodelled_setting(offset, "an address of its own");
                }
                self.own_addresses[(offset - OAR1) as usize / 4] = value;
            }
            TIMEOUTR => {
                if value & 0x8000_8000 != 0 {
                    context.unmodelled_setting(offset, "a time-out of the bus");
                }
                self.timeout = value;
            }
            // Writing 1 to TXE flushes the transmit register, and TXIS with it.
            ISR if value & 1 != 0 => self.isr.set_txe(true),
            ISR => {}
            ICR => self.isr.0 &= !(value & CLEARABLE),
            TXDR => {
                self.isr.set_txis(false);
                self.isr.set_txe(false);
                self.transmit = value as u8;
                if self.phase == Phase::AwaitByte {
                    self.send_or_await_byte(context.now, delay);
                }
            }
            _ => context.unmodelled_write(offset),
        }
    }

    fn write_cr1(&mut self, value: u32, has_pins: bool, context: &mut Context) {
        let was_on = self.cr1.pe();
        self.cr1 = Cr1(value);
        if value & 0x00FB_0000 != 0 {
            context.unmodelled_setting(CR1, "a target's or SMBus's option");
        }
        match (was_on, self.cr1.pe()) {
            (false, true) => {
                if self.timing == 0 {
                    context.misconfigured(CR1, "switched on without a timing");
                }
                if !has_pins {
                    context.report(
                        Kind::PinNotConnected,
                        CR1,
                        "clock or data is not at a pin, open drain",
                    );
                }
            }
            // The state machine and the flags are reset, both lines let go.
            (true, false) => {
                let (cr1, timing, clock) = (self.cr1, self.timing, self.clock);
                let stop_delay = self.stop_delay;
                let (own_addresses, timeout) = (self.own_addresses, self.timeout);
                let mut cr2 = self.cr2;
                cr2.set_start(false);
                cr2.set_stop(false);
                let kept = Self { cr1, cr2, timing, clock, ..Self::new() };
                *self = Self { own_addresses, timeout, stop_delay, ..kept };
            }
            _ => {}
        }
    }

    fn write_cr2(&mut self, value: u32, delay: Time, context: &mut Context) {
        let old = self.cr2;
        // Start and stop are set by software and cleared by hardware.
        self.cr2 = Cr2(value | old.0 & 0x6000);
        if self.cr2.add10().to_bits() == 1 {
            context.unmodelled_setting(CR2, "addresses of ten bits");
        }
        if !self.cr1.pe() {
            self.cr2.set_start(false);
            self.cr2.set_stop(false);
            return;
        }
        if self.isr.tcr() && self.cr2.nbytes() > 0 {
            self.isr.set_tcr(false);
            self.left = self.cr2.nbytes();
            match self.cr2.dir().to_bits() {
                1 if self.isr.rxne() => self.phase = Phase::AwaitRead,
                1 => self.receive(context.now, delay),
                _ => self.send_or_await_byte(context.now, delay),
            }
        }
        if self.cr2.start() && !old.start() && matches!(self.phase, Phase::Idle | Phase::Hold) {
            self.start(context.now, delay);
        }
        if self.cr2.stop()
            && matches!(self.phase, Phase::Hold | Phase::AwaitByte | Phase::AwaitRead)
        {
            self.isr.set_txis(false);
            self.stop(context.now, delay);
        }
    }

    /// The kernel clock changes with RCC.
    pub(crate) fn set_clock(&mut self, clock: Frequency) {
        self.clock = clock;
    }
}

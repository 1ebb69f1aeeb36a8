//! I2C bus with Hall sensors: register reads with two interrupts and one wake-up of the task, and bus recovery.
//!
//! The driver of embassy-stm32 is not used: it wakes the task three times in a transfer, which took a fifth of the core's
//! time, and it does not abort a transfer that is dropped or times out. Then SCL stays low, or a received byte stays in the
//! data register and is read first by the next transfer's DMA: every later reading is shifted by one byte, without an
//! error. Only PE = 0 ends that state (RM0440 41.4.6), so [`Transfer`] resets the peripheral unless it was successful.

use core::future::poll_fn;
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering, fence};
use core::task::Poll;

use embassy_stm32::gpio::{AfType, Flex, OutputType, Speed};
use embassy_stm32::i2c::{Instance, SclPin, SdaPin};
use embassy_stm32::interrupt::{self, InterruptExt};
use embassy_stm32::pac::i2c::regs::{Cr2, Isr, Timingr};
use embassy_stm32::pac::{self, bdma, dmamux};
use embassy_stm32::{Peri, rcc};
use embassy_sync::waitqueue::AtomicWaker;
use embedded_hal_async::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};

use crate::board::selected::clock::BoardClock;
use crate::clock::delay_us;
use crate::sensors::hall::{BusLines, SensorBus, clear_bus};

/// Polling interval of a busy bus.
const BUSY_POLL_US: u64 = 10;
/// Polls until the bus counts as stuck: 50 us.
const BUSY_POLLS: u32 = 5;
/// Longest read in bytes.
const MAX_READ_BYTES: usize = 16;

/// Why a transfer failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// Not acknowledged.
    NoAcknowledge,
    /// A line is stuck, or a byte was lost.
    Bus,
    /// Arbitration lost.
    Arbitration,
    /// Wrong number of bytes received.
    Length,
    /// Not a write of one byte followed by a read of up to 16 bytes.
    Unsupported,
}

impl embedded_hal_async::i2c::Error for Error {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::NoAcknowledge => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown),
            Self::Bus => ErrorKind::Bus,
            Self::Arbitration => ErrorKind::ArbitrationLoss,
            Self::Length => ErrorKind::Overrun,
            Self::Unsupported => ErrorKind::Other,
        }
    }
}

/// Receive channel of DMA1. Its number is a constant where it is used: the register blocks panic for one out of range.
#[derive(Clone, Copy)]
enum Channel {
    /// Channel 1.
    First,
    /// Channel 2.
    Second,
}

/// State shared with the interrupts and the DMA channel.
pub struct Controller {
    registers: pac::i2c::I2c,
    channel: Channel,
    /// Request number at the DMA multiplexer (RM0440 table 91).
    request: u8,
    waker: AtomicWaker,
    /// CR2 of the read phase.
    read: AtomicU32,
    /// Receive buffer of the DMA channel.
    bytes: [AtomicU8; MAX_READ_BYTES],
}

impl Controller {
    const fn new(registers: pac::i2c::I2c, channel: Channel, request: u8) -> Self {
        Self {
            registers,
            channel,
            request,
            waker: AtomicWaker::new(),
            read: AtomicU32::new(0),
            bytes: [const { AtomicU8::new(0) }; MAX_READ_BYTES],
        }
    }

    fn dma(&self) -> bdma::Ch {
        match self.channel {
            Channel::First => pac::DMA1.ch(0),
            Channel::Second => pac::DMA1.ch(1),
        }
    }

    fn multiplexer(&self) -> pac::common::Reg<dmamux::regs::Ccr, pac::common::RW> {
        match self.channel {
            Channel::First => pac::DMAMUX1.ccr(0),
            Channel::Second => pac::DMAMUX1.ccr(1),
        }
    }

    /// Starts the read phase after the register number was sent, or wakes the task at the end of the transfer.
    ///
    /// One task waits for both buses, whose transfers begin together: while `other` transfers, that bus wakes it for both.
    fn on_interrupt(&self, other: &Self) {
        let status = self.registers.isr().read();
        // A controller may detect a bus error where none is: it is cleared, and the transfer goes on (ES0430 2.15.2). After a real one
        // the transfer loses the arbitration, is not acknowledged, or times out.
        if status.berr() {
            self.registers.icr().write(|w| w.set_berrcf(true));
        }
        if has_ended(status) {
            self.registers.cr1().modify(|w| {
                w.set_tcie(false);
                w.set_stopie(false);
                w.set_errie(false);
            });
            if !other.registers.cr1().read().stopie() {
                self.waker.wake();
            }
        } else if status.tc() {
            let read = Cr2(self.read.load(Ordering::Relaxed));
            self.registers.cr2().write_value(read);
        }
    }
}

/// A missing acknowledge also ends with a stop.
fn has_ended(status: Isr) -> bool {
    status.stopf() || status.arlo() || status.ovr()
}

static FIRST: Controller = Controller::new(pac::I2C1, Channel::First, 16);
static SECOND: Controller = Controller::new(pac::I2C3, Channel::Second, 20);

#[embassy_stm32::interrupt]
fn I2C1_EV() {
    FIRST.on_interrupt(&SECOND);
}

#[embassy_stm32::interrupt]
fn I2C1_ER() {
    FIRST.on_interrupt(&SECOND);
}

#[embassy_stm32::interrupt]
fn I2C3_EV() {
    SECOND.on_interrupt(&FIRST);
}

#[embassy_stm32::interrupt]
fn I2C3_ER() {
    SECOND.on_interrupt(&FIRST);
}

/// I2C bus with two Hall sensors.
pub struct I2cBus {
    controller: &'static Controller,
    /// SCL and SDA.
    pins: [Flex<'static>; 2],
    /// Alternate functions of the pins.
    functions: [u8; 2],
}

impl I2cBus {
    /// I2C1; `timing` is the value of TIMINGR.
    pub fn first<T: Instance>(
        peripheral: Peri<'static, T>,
        clock: Peri<'static, impl SclPin<T>>,
        data: Peri<'static, impl SdaPin<T>>,
        timing: u32,
    ) -> Self {
        let bus = Self::new(&FIRST, peripheral, clock, data, timing);
        enable(interrupt::I2C1_EV, interrupt::I2C1_ER);
        bus
    }

    /// I2C3; `timing` is the value of TIMINGR.
    pub fn second<T: Instance>(
        peripheral: Peri<'static, T>,
        clock: Peri<'static, impl SclPin<T>>,
        data: Peri<'static, impl SdaPin<T>>,
        timing: u32,
    ) -> Self {
        let bus = Self::new(&SECOND, peripheral, clock, data, timing);
        enable(interrupt::I2C3_EV, interrupt::I2C3_ER);
        bus
    }

    fn new<T: Instance>(
        controller: &'static Controller,
        _peripheral: Peri<'static, T>,
        clock: Peri<'static, impl SclPin<T>>,
        data: Peri<'static, impl SdaPin<T>>,
        timing: u32,
    ) -> Self {
        rcc::enable_and_reset::<T>();
        // Writable only while the peripheral is disabled.
        controller.registers.timingr().write_value(Timingr(timing));
        controller.multiplexer().modify(|w| w.set_dmareq_id(controller.request));
        let channel = controller.dma();
        channel.par().write_value(controller.registers.rxdr().as_ptr() as u32);
        channel.mar().write_value(controller.bytes.as_ptr() as u32);
        let functions = [clock.af_num(), data.af_num()];
        let mut bus = Self { controller, pins: [Flex::new(clock), Flex::new(data)], functions };
        bus.connect();
        bus
    }

    /// Assigns the pins to the peripheral and enables it.
    fn connect(&mut self) {
        for (pin, function) in self.pins.iter_mut().zip(self.functions) {
            let open_drain = AfType::output(OutputType::OpenDrain, Speed::VeryHigh);
            pin.set_as_af_unchecked(function, open_drain);
        }
        self.controller.registers.cr1().write(|w| w.set_pe(true));
    }

    /// Waits until the bus is idle: after an aborted transfer a sensor may release its line late.
    async fn wait_idle(&self) -> Result<(), Error> {
        for _ in 0..BUSY_POLLS {
            if !self.controller.registers.isr().read().busy() {
                return Ok(());
            }
            delay_us(&BoardClock, BUSY_POLL_US).await;
        }
        Err(Error::Bus)
    }
}

impl ErrorType for I2cBus {
    type Error = Error;
}

impl I2c for I2cBus {
    /// Writes one byte, then reads up to 16 bytes. No time-out of its own; cancellation-safe.
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), Self::Error> {
        match operations {
            [Operation::Write([register]), Operation::Read(bytes)]
                if (1..=MAX_READ_BYTES).contains(&bytes.len()) =>
            {
                self.wait_idle().await?;
                let transfer = Transfer::begin(self.controller, address, *register, bytes.len());
                poll_fn(|context| {
                    self.controller.waker.register(context.waker());
                    if has_ended(self.controller.registers.isr().read()) {
                        Poll::Ready(())
                    } else {
                        Poll::Pending
                    }
                })
                .await;
                transfer.end(bytes)
            }
            _ => Err(Error::Unsupported),
        }
    }
}

/// A transfer in progress.
struct Transfer {
    controller: &'static Controller,
    is_successful: bool,
}

impl Transfer {
    /// Starts to read `length` bytes from a register.
    fn begin(controller: &'static Controller, address: u8, register: u8, length: usize) -> Self {
        let transfer = Self { controller, is_successful: false };
        let registers = controller.registers;
        let channel = controller.dma();
        channel.ndtr().write(|w| w.set_ndt(length as u16));
        channel.cr().write(|w| {
            w.set_minc(true);
            w.set_en(true);
        });
        let mut phase = Cr2(0);
        phase.set_sadd(u16::from(address) << 1);
        phase.set_start(true);
        let mut read = phase;
        read.set_dir(pac::i2c::vals::Dir::READ);
        read.set_nbytes(length as u8);
        read.set_autoend(pac::i2c::vals::Autoend::AUTOMATIC);
        controller.read.store(read.0, Ordering::Relaxed);
        // Flags of the previous transfer.
        registers.icr().write(|w| {
            w.set_stopcf(true);
            w.set_nackcf(true);
            w.set_berrcf(true);
            w.set_arlocf(true);
            w.set_ovrcf(true);
        });
        registers.txdr().write(|w| w.set_txdata(register));
        registers.cr1().write(|w| {
            w.set_pe(true);
            w.set_rxdmaen(true);
            w.set_tcie(true);
            w.set_stopie(true);
            w.set_errie(true);
        });
        phase.set_nbytes(1);
        // The DMA buffer is ready before the transfer starts.
        fence(Ordering::SeqCst);
        registers.cr2().write_value(phase);
        transfer
    }

    /// Copies the received bytes after the end of the transfer.
    fn end(mut self, bytes: &mut [u8]) -> Result<(), Error> {
        let status = self.controller.registers.isr().read();
        // DMA has read every byte and the data register is empty.
        let is_complete = self.controller.dma().ndtr().read().ndt() == 0 && !status.rxne();
        let result = if status.arlo() {
            Err(Error::Arbitration)
        } else if status.ovr() {
            Err(Error::Bus)
        } else if status.nackf() {
            Err(Error::NoAcknowledge)
        } else if is_complete {
            Ok(())
        } else {
            Err(Error::Length)
        };
        fence(Ordering::SeqCst);
        for (byte, from) in bytes.iter_mut().zip(&self.controller.bytes) {
            *byte = from.load(Ordering::Relaxed);
        }
        self.is_successful = result.is_ok();
        result
    }
}

impl Drop for Transfer {
    fn drop(&mut self) {
        self.controller.dma().cr().write(|w| w.set_en(false));
        if !self.is_successful {
            let registers = self.controller.registers;
            registers.cr1().write(|w| w.set_pe(false));
            // PE must stay low for three APB cycles: each read takes more than one.
            for _ in 0..3 {
                let _ = registers.cr1().read();
            }
            registers.cr1().write(|w| w.set_pe(true));
        }
    }
}

impl SensorBus for I2cBus {
    async fn recover(&mut self) -> bool {
        self.controller.registers.cr1().write(|w| w.set_pe(false));
        for pin in &mut self.pins {
            pin.set_high();
            pin.set_as_input_output(Speed::VeryHigh);
        }
        let free = clear_bus(&mut self.pins, &BoardClock).await;
        self.connect();
        free
    }
}

impl BusLines for [Flex<'static>; 2] {
    fn set_clock(&mut self, high: bool) {
        let [clock, _] = self;
        clock.set_level(high.into());
    }

    fn set_data(&mut self, high: bool) {
        let [_, data] = self;
        data.set_level(high.into());
    }

    fn levels(&mut self) -> [bool; 2] {
        let [clock, data] = self;
        [clock.is_high(), data.is_high()]
    }
}

/// Enables both interrupts of a bus.
fn enable(event: interrupt::Interrupt, error: interrupt::Interrupt) {
    for number in [event, error] {
        number.unpend();
        // SAFETY: the bus is initialised, and nothing relies on these interrupts being masked.
        #[allow(unsafe_code)]
        unsafe {
            number.enable();
        }
    }
}

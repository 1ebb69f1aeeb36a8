//! A sensor bus of the chip: one transfer of a register's number and of what is read from there on, with two interrupts and
//! one wake of the task, and a way out of every state in which a sensor leaves the lines.
//!
//! The peripheral's library driver is not used: it wakes the task three times in a transfer, which took the core a fifth of
//! its time, and it leaves a transfer that is dropped or times out where it is. SCL stays held then, or a received byte
//! stays in the data register, from where the next transfer's DMA takes it first: every later reading is shifted by one byte,
//! with no error. Only PE = 0 ends that (RM0440 41.4.6), so [`Transfer`] resets the peripheral unless it has ended well.

use core::future::poll_fn;
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering, fence};
use core::task::Poll;

use embassy_stm32::gpio::{AfType, Flex, Level, OutputType, Speed};
use embassy_stm32::i2c::{Instance, SclPin, SdaPin};
use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::pac::i2c::regs::{Cr2, Isr, Timingr};
use embassy_stm32::pac::{bdma, dmamux};
use embassy_stm32::{Peri, interrupt, pac, rcc};
use embassy_sync::waitqueue::AtomicWaker;
use embedded_hal_async::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};

use super::clock::BoardClock;
use crate::clock::pause;
use crate::hall::bus::{Lines, SensorBus, clear};

/// A busy bus is looked at this often, and given up after so many looks: 50 us.
const BUSY_US: u64 = 10;
const BUSY_LOOKS: u32 = 5;
/// Bytes that a transfer reads at the most.
const MOST_BYTES: usize = 16;

/// Why a transfer has failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// No sensor has this address, or it does not acknowledge.
    NoAcknowledge,
    /// A line is held, or a start or stop came where none belongs.
    Bus,
    /// Somebody else drives the data line.
    Arbitration,
    /// Fewer or more bytes than were asked for have come.
    Length,
    /// Anything but a write of one byte and a read of up to 16 bytes.
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

/// What a bus shares with its interrupts and its DMA channel.
pub struct Controller {
    registers: pac::i2c::I2c,
    /// Receives; counted from 0.
    channel: u8,
    /// Its request at the multiplexer (RM0440 table 91).
    request: u8,
    waker: AtomicWaker,
    /// CR2 of the transfer's second part, the read.
    read: AtomicU32,
    /// Where the DMA channel writes to.
    bytes: [AtomicU8; MOST_BYTES],
}

impl Controller {
    const fn new(registers: pac::i2c::I2c, channel: u8, request: u8) -> Self {
        Self {
            registers,
            channel,
            request,
            waker: AtomicWaker::new(),
            read: AtomicU32::new(0),
            bytes: [const { AtomicU8::new(0) }; MOST_BYTES],
        }
    }

    fn dma(&self) -> bdma::Ch {
        pac::DMA1.ch(self.channel.into())
    }

    fn multiplexer(&self) -> pac::common::Reg<dmamux::regs::Ccr, pac::common::RW> {
        pac::DMAMUX1.ccr(self.channel.into())
    }

    /// The register's number has been sent: the read begins. Or the transfer has ended: the task goes on.
    fn on_interrupt(&self) {
        let status = self.registers.isr().read();
        if has_ended(status) {
            self.registers.cr1().modify(|w| {
                w.set_tcie(false);
                w.set_stopie(false);
                w.set_errie(false);
            });
            self.waker.wake();
        } else if status.tc() {
            let read = Cr2(self.read.load(Ordering::Relaxed));
            self.registers.cr2().write_value(read);
        }
    }
}

/// A stop follows what is not acknowledged as well.
fn has_ended(status: Isr) -> bool {
    status.stopf() || status.berr() || status.arlo() || status.ovr()
}

static FIRST: Controller = Controller::new(pac::I2C1, 0, 16);
static SECOND: Controller = Controller::new(pac::I2C3, 1, 20);

#[embassy_stm32::interrupt]
fn I2C1_EV() {
    FIRST.on_interrupt();
}

#[embassy_stm32::interrupt]
fn I2C1_ER() {
    FIRST.on_interrupt();
}

#[embassy_stm32::interrupt]
fn I2C3_EV() {
    SECOND.on_interrupt();
}

#[embassy_stm32::interrupt]
fn I2C3_ER() {
    SECOND.on_interrupt();
}

/// A bus with sensors.
pub struct BoardBus {
    controller: &'static Controller,
    /// Clock and data.
    pins: [Flex<'static>; 2],
    /// Functions of the pins at which they belong to the peripheral.
    functions: [u8; 2],
}

impl BoardBus {
    /// I2C1, with the word of its timing register.
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

    /// I2C3, with the word of its timing register.
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
        // May be written only while the peripheral is off.
        controller.registers.timingr().write_value(Timingr(timing));
        controller
            .multiplexer()
            .modify(|w| w.set_dmareq_id(controller.request));
        let channel = controller.dma();
        channel
            .par()
            .write_value(controller.registers.rxdr().as_ptr() as u32);
        channel.mar().write_value(controller.bytes.as_ptr() as u32);
        let functions = [clock.af_num(), data.af_num()];
        let mut bus = Self {
            controller,
            pins: [Flex::new(clock), Flex::new(data)],
            functions,
        };
        bus.connect();
        bus
    }

    /// Gives the pins to the peripheral and switches it on.
    fn connect(&mut self) {
        for (pin, function) in self.pins.iter_mut().zip(self.functions) {
            let open_drain = AfType::output(OutputType::OpenDrain, Speed::VeryHigh);
            pin.set_as_af_unchecked(function, open_drain);
        }
        self.controller.registers.cr1().write(|w| w.set_pe(true));
    }

    /// Waits for the bus: a sensor that holds a line after a transfer was cut may let it go in time.
    async fn idle(&self) -> Result<(), Error> {
        for _ in 0..BUSY_LOOKS {
            if !self.controller.registers.isr().read().busy() {
                return Ok(());
            }
            pause(&BoardClock, BUSY_US).await;
        }
        Err(Error::Bus)
    }
}

impl ErrorType for BoardBus {
    type Error = Error;
}

impl I2c for BoardBus {
    /// A write of one byte, then a read of up to 16 bytes. Has no time limit of its own; may be dropped at any time.
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), Self::Error> {
        match operations {
            [Operation::Write([register]), Operation::Read(bytes)]
                if (1..=MOST_BYTES).contains(&bytes.len()) =>
            {
                self.idle().await?;
                let transfer = Transfer::begin(self.controller, address, *register, bytes.len());
                poll_fn(|context| {
                    self.controller.waker.register(context.waker());
                    match has_ended(self.controller.registers.isr().read()) {
                        true => Poll::Ready(()),
                        false => Poll::Pending,
                    }
                })
                .await;
                transfer.end(bytes)
            }
            _ => Err(Error::Unsupported),
        }
    }
}

/// A transfer under way.
struct Transfer {
    controller: &'static Controller,
    has_ended_well: bool,
}

impl Transfer {
    /// Asks for so many bytes from a register on.
    fn begin(controller: &'static Controller, address: u8, register: u8, length: usize) -> Self {
        let transfer = Self {
            controller,
            has_ended_well: false,
        };
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
        // All that the transfer before may have left.
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
        // What is written before stays before.
        fence(Ordering::SeqCst);
        registers.cr2().write_value(phase);
        transfer
    }

    /// What has come, once the transfer has ended.
    fn end(mut self, bytes: &mut [u8]) -> Result<(), Error> {
        let status = self.controller.registers.isr().read();
        // Every byte was taken from the data register, and none is left there.
        let is_complete = self.controller.dma().ndtr().read().ndt() == 0 && !status.rxne();
        let result = match () {
            () if status.arlo() => Err(Error::Arbitration),
            () if status.berr() || status.ovr() => Err(Error::Bus),
            () if status.nackf() => Err(Error::NoAcknowledge),
            () if !is_complete => Err(Error::Length),
            () => Ok(()),
        };
        fence(Ordering::SeqCst);
        for (byte, from) in bytes.iter_mut().zip(&self.controller.bytes) {
            *byte = from.load(Ordering::Relaxed);
        }
        self.has_ended_well = result.is_ok();
        result
    }
}

impl Drop for Transfer {
    fn drop(&mut self) {
        self.controller.dma().cr().write(|w| w.set_en(false));
        if !self.has_ended_well {
            let registers = self.controller.registers;
            registers.cr1().write(|w| w.set_pe(false));
            // It must stay off for three cycles of the bus: each read takes more than one.
            for _ in 0..3 {
                let _ = registers.cr1().read();
            }
            registers.cr1().write(|w| w.set_pe(true));
        }
    }
}

impl SensorBus for BoardBus {
    async fn recover(&mut self) -> bool {
        self.controller.registers.cr1().write(|w| w.set_pe(false));
        for pin in &mut self.pins {
            pin.set_high();
            pin.set_as_input_output(Speed::VeryHigh);
        }
        let free = clear(&mut self.pins, &BoardClock).await;
        self.connect();
        free
    }
}

impl Lines for [Flex<'static>; 2] {
    fn set_clock(&mut self, high: bool) {
        let [clock, _] = self;
        clock.set_level(level(high));
    }

    fn set_data(&mut self, high: bool) {
        let [_, data] = self;
        data.set_level(level(high));
    }

    fn levels(&mut self) -> [bool; 2] {
        let [clock, data] = self;
        [clock.is_high(), data.is_high()]
    }
}

fn level(high: bool) -> Level {
    match high {
        true => Level::High,
        false => Level::Low,
    }
}

/// Both interrupts of a bus.
fn enable(event: interrupt::Interrupt, error: interrupt::Interrupt) {
    for number in [event, error] {
        number.unpend();
        // Sound: the bus is made before, and nothing relies on this interrupt to be masked.
        #[allow(unsafe_code)]
        unsafe {
            number.enable();
        }
    }
}

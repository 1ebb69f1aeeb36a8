//! Inertial sensor on SPI: registers of an LSM6DS3TR-C, by bytes, as the datasheet describes its bus.

use crate::board::clock::VirtualClock;
use crate::board::world::WorldClock;
use embedded_hal_async::spi::{ErrorType, Operation, SpiDevice};
use firmware::clock::Clock;
use std::cell::RefCell;
use std::convert::Infallible;
use std::rc::Rc;

/// Bit of the first byte of a transfer that makes it a read.
const READ: u8 = 1 << 7;
const WHO_AM_I: u8 = 0x0F;
const IDENTITY: u8 = 0x6A;
/// Controls of acceleration and rate; their upper half is the output data rate, 0 off.
const CONTROLS: [u8; 2] = [0x10, 0x11];
/// First and last output register.
const OUTPUTS: [u8; 2] = [0x22, 0x2D];
/// Level of the data line without a sensor.
const PULLED_UP: u8 = 0xFF;

/// Registers of the sensor.
#[derive(Clone)]
pub struct InertialSensor {
    now: Rc<RefCell<WorldClock>>,
    settings: [u8; 128],
    /// Register of the next byte and whether it is read; none before the first byte of a transfer.
    next: Option<(u8, bool)>,
    /// Outputs at the beginning of the transfer (block data update).
    outputs: [u8; 12],
    /// The sensor does not answer.
    pub unplugged: bool,
    /// The sensor repeats its outputs.
    pub frozen: bool,
}

impl InertialSensor {
    /// A copy in its present state, in another world.
    pub(crate) fn copy(&self, now: &Rc<RefCell<WorldClock>>) -> Self {
        Self { now: now.clone(), ..self.clone() }
    }

    /// At power-on.
    pub fn new(now: Rc<RefCell<WorldClock>>) -> Self {
        Self {
            now,
            settings: [0; 128],
            next: None,
            outputs: [0; 12],
            unplugged: false,
            frozen: false,
        }
    }

    /// The select line falls (true) or rises.
    pub fn select(&mut self, _: bool) {
        self.next = None;
    }

    /// Byte that the sensor shifts out while `byte` comes in.
    pub fn exchange(&mut self, time_us: u64, byte: u8) -> u8 {
        let sample = self.now.borrow_mut().at(time_us).inertial;
        let Some(outputs) = sample.filter(|_| !self.unplugged) else {
            return PULLED_UP;
        };
        let Some((register, is_read)) = self.next else {
            self.next = Some((byte & !READ, byte & READ != 0));
            let [acceleration, rate] = CONTROLS.map(|at| self.settings[usize::from(at)] >> 4);
            if acceleration != 0 && rate != 0 && !self.frozen {
                self.outputs = outputs;
            }
            return 0;
        };
        self.next = Some(((register + 1) & !READ, is_read));
        let [first, last] = OUTPUTS;
        match (is_read, register) {
            (false, _) => {
                self.settings[usize::from(register)] = byte;
                0
            }
            (true, WHO_AM_I) => IDENTITY,
            (true, output) if (first..=last).contains(&output) => {
                self.outputs[usize::from(output - first)]
            }
            (true, _) => self.settings[usize::from(register)],
        }
    }
}

/// The sensor at the connections of a board.
pub type SharedInertialSensor = Rc<RefCell<InertialSensor>>;

/// At the port of an emulated chip.
pub struct InertialPins(pub SharedInertialSensor);

impl emulator::devices::SpiDevice for InertialPins {
    fn select(&mut self, _: emulator::Time, is_selected: bool) {
        self.0.borrow_mut().select(is_selected);
    }

    fn transfer(&mut self, time: emulator::Time, frame: u16) -> u16 {
        self.0.borrow_mut().exchange(time.us(), frame as u8).into()
    }
}

/// At the tasks in virtual time; a transfer takes no time.
pub struct SimulatedSpi {
    /// The sensor.
    pub sensor: SharedInertialSensor,
    /// Virtual time.
    pub clock: VirtualClock,
}

impl ErrorType for SimulatedSpi {
    type Error = Infallible;
}

impl SpiDevice for SimulatedSpi {
    async fn transaction(
        &mut self,
        operations: &mut [Operation<'_, u8>],
    ) -> Result<(), Infallible> {
        let time_us = self.clock.now_us();
        let mut sensor = self.sensor.borrow_mut();
        sensor.select(true);
        for operation in operations {
            match operation {
                Operation::Read(bytes) => {
                    bytes.iter_mut().for_each(|byte| *byte = sensor.exchange(time_us, 0));
                }
                Operation::Write(bytes) => {
                    bytes.iter().for_each(|byte| {
                        sensor.exchange(time_us, *byte);
                    });
                }
                Operation::Transfer(read, write) => {
                    for place in 0..read.len().max(write.len()) {
                        let out = write.get(place).copied().unwrap_or_default();
                        let into = sensor.exchange(time_us, out);
                        if let Some(byte) = read.get_mut(place) {
                            *byte = into;
                        }
                    }
                }
                Operation::TransferInPlace(bytes) => {
                    bytes.iter_mut().for_each(|byte| *byte = sensor.exchange(time_us, *byte));
                }
                Operation::DelayNs(_) => {}
            }
        }
        sensor.select(false);
        Ok(())
    }
}

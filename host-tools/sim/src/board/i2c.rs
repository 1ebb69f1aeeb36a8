//! Sensor buses: sensors with registers, lines with levels. The emulated chip accesses them by pins, the firmware's
//! tasks in virtual time by [`SimulatedI2c`]. Faults are injected into sensors and lines, never
//! reported to the firmware.

use crate::board::clock::VirtualClock;
use crate::board::world::WorldClock;
use embedded_hal_async::i2c::{
    Error, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation, SevenBitAddress,
};
use emulator::Time;
use emulator::devices::I2cBus;
use firmware::clock::{Clock, delay_us};
use firmware::sensors::hall::a31301::{self, CONFIGURATION, READING_BYTES, TEMPERATURE};
use firmware::sensors::hall::{BusLines, HallReading, SensorBus, clear_bus};
use std::cell::{Cell, RefCell};
use std::future::pending;
use std::rc::Rc;

/// Bit time at 1 MHz.
const BIT_US: u64 = 1;
/// Bits per byte with acknowledge.
const BYTE_BITS: u64 = 9;

/// Configuration register after power-up (assumed).
const CONFIGURED: u16 = 0x0140;

/// A Hall sensor on a bus.
#[derive(Clone, Debug)]
pub struct I2cSensor {
    /// Number on the gripper.
    pub number: usize,
    /// I2C address.
    pub address: u8,
    /// Disconnected.
    pub unplugged: bool,
    /// Number of further transfers without acknowledge.
    pub refuses: u32,
    /// The registers do not change.
    pub frozen: bool,
    /// Gain of the element; one if healthy.
    pub gain: f64,
    /// Additional field at the element, in counts.
    pub extra_field: [f64; 3],
    /// Clock stretching in the next transfer.
    pub stretches: Option<Time>,
    /// Lost bit in the next transfer: it pulls the data line low for this many clocks.
    pub slips: Option<u32>,
    /// Configuration register.
    configuration: u16,
    /// Measurement registers.
    registers: [u8; READING_BYTES],
    /// Next register; none while its address is awaited.
    pointer: Option<u8>,
}

impl I2cSensor {
    /// A healthy sensor.
    pub fn new(number: usize, address: u8) -> Self {
        Self {
            number,
            address,
            unplugged: false,
            refuses: 0,
            frozen: false,
            gain: 1.0,
            extra_field: [0.0; 3],
            slips: None,
            stretches: None,
            configuration: CONFIGURED,
            registers: [0; READING_BYTES],
            pointer: None,
        }
    }

    /// Brown-out: the registers have their defaults, with an assumed doubled range.
    pub const fn brown_out(&mut self) {
        self.configuration = 0;
    }

    /// Power cycle: the configuration is restored.
    pub const fn power_up(&mut self) {
        self.configuration = CONFIGURED;
    }

    /// Updates the registers.
    fn measure(&mut self, reading: HallReading) {
        if self.frozen {
            return;
        }
        let (min, max) = a31301::FIELD_LIMITS;
        let range = if self.configuration == CONFIGURED { 1.0 } else { 2.0 };
        let counts_of = |counts: i16, extra_field: f64| {
            let scaled = ((f64::from(counts) * self.gain + extra_field) / range).round();
            scaled.clamp(f64::from(min), f64::from(max)) as i16
        };
        let [x, y, z] = reading.field;
        let [dx, dy, dz] = self.extra_field;
        let field = [counts_of(x, dx), counts_of(y, dy), counts_of(z, dz)];
        self.registers = a31301::encode(HallReading { field, ..reading });
    }

    fn register(&self, address: u8) -> u8 {
        let [upper, lower] = self.configuration.to_be_bytes();
        let place = usize::from(address.wrapping_sub(TEMPERATURE));
        match address.wrapping_sub(CONFIGURATION) {
            0 => upper,
            1 => lower,
            _ => self.registers.get(place).copied().unwrap_or(0),
        }
    }
}

/// Lines of a bus and its sensors.
#[derive(Clone)]
pub struct SensorBusWires {
    /// Sensors on the bus.
    pub sensors: Vec<I2cSensor>,
    /// Clocks until the data line is released; [`u32::MAX`]: shorted to ground.
    pub data_low_clocks: u32,
    clock_high: bool,
    /// End of clock stretching.
    stretched_until: Time,
    /// Number of started transfers.
    pub transfers: u64,
    /// Index of the addressed sensor.
    addressed: Option<usize>,
    now: Rc<RefCell<WorldClock>>,
}

impl SensorBusWires {
    /// A copy in its present state, in another world.
    pub(crate) fn copy(&self, now: &Rc<RefCell<WorldClock>>) -> Self {
        Self { now: now.clone(), ..self.clone() }
    }

    /// An idle bus.
    pub fn new(sensors: Vec<I2cSensor>, now: Rc<RefCell<WorldClock>>) -> Self {
        Self {
            sensors,
            data_low_clocks: 0,
            clock_high: true,
            stretched_until: Time::ZERO,
            transfers: 0,
            addressed: None,
            now,
        }
    }

    fn sensor(&mut self) -> Option<&mut I2cSensor> {
        self.sensors.get_mut(self.addressed?)
    }
}

impl I2cBus for SensorBusWires {
    fn address(&mut self, time: Time, address: u8, is_read: bool) -> bool {
        self.transfers += 1;
        self.addressed = None;
        let readings = self.now.borrow_mut().at_transfer(time.us()).readings;
        let mut sensors = self.sensors.iter_mut().enumerate();
        let found = sensors.find(|(_, sensor)| sensor.address == address && !sensor.unplugged);
        let Some((place, sensor)) = found else {
            return false;
        };
        if sensor.refuses > 0 {
            sensor.refuses -= 1;
            return false;
        }
        if let Some(length) = sensor.stretches.take() {
            self.stretched_until = time + length;
        }
        if let Some(clocks) = sensor.slips.take() {
            // It lost a clock: it acknowledges, then sends a low bit that is not clocked.
            self.data_low_clocks = clocks;
            return true;
        }
        if let Some(reading) = readings.get(sensor.number).copied().flatten() {
            sensor.measure(reading);
        }
        if !is_read {
            sensor.pointer = None;
        }
        self.addressed = Some(place);
        true
    }

    fn write(&mut self, byte: u8) -> bool {
        if let Some(sensor) = self.sensor() {
            // The firmware never writes to registers.
            sensor.pointer.get_or_insert(byte);
        }
        true
    }

    fn read(&mut self) -> u8 {
        let Some(sensor) = self.sensor() else {
            return 0xFF;
        };
        let pointer = sensor.pointer.unwrap_or_default();
        sensor.pointer = Some(pointer.wrapping_add(1));
        sensor.register(pointer)
    }

    fn stop(&mut self) {
        self.addressed = None;
    }

    fn released(&self, time: Time) -> [bool; 2] {
        [time >= self.stretched_until, self.data_low_clocks == 0]
    }

    fn pulse(&mut self) {
        if self.data_low_clocks != u32::MAX {
            self.data_low_clocks = self.data_low_clocks.saturating_sub(1);
        }
    }
}

/// I2C controller in virtual time.
pub struct SimulatedI2c {
    /// Lines of the bus.
    pub wires: Rc<RefCell<SensorBusWires>>,
    /// Virtual time.
    pub clock: VirtualClock,
    /// Byte of an aborted transfer in the data register, which the next transfer reads first.
    pub residue: Rc<Cell<Option<u8>>>,
}

/// A transfer without acknowledge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotAcknowledged;

impl Error for NotAcknowledged {
    fn kind(&self) -> ErrorKind {
        ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown)
    }
}

impl ErrorType for SimulatedI2c {
    type Error = NotAcknowledged;
}

impl SimulatedI2c {
    async fn bytes(&self, count: usize) {
        delay_us(&self.clock, BIT_US * BYTE_BITS * count as u64).await;
    }

    /// Start condition and address.
    async fn begin(&mut self, address: u8, is_read: bool) -> Result<(), NotAcknowledged> {
        self.released().await;
        delay_us(&self.clock, BIT_US).await;
        self.bytes(1).await;
        let time = Time::from_us(self.clock.now_us());
        let is_acknowledged = self.wires.borrow_mut().address(time, address, is_read);
        if !is_acknowledged {
            return Err(NotAcknowledged);
        }
        self.released().await;
        Ok(())
    }

    /// Waits for a line that a sensor pulls low: forever, without further clocks.
    async fn released(&self) {
        let (is_held, stretched_until) = {
            let wires = self.wires.borrow();
            (wires.data_low_clocks > 0, wires.stretched_until)
        };
        if is_held {
            pending::<()>().await;
        }
        self.clock.until(stretched_until.us()).await;
    }
}

impl I2c<SevenBitAddress> for SimulatedI2c {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), Self::Error> {
        for operation in operations {
            let is_read = matches!(operation, Operation::Read(_));
            self.begin(address, is_read).await?;
            match operation {
                Operation::Write(bytes) => {
                    self.bytes(bytes.len()).await;
                    let mut wires = self.wires.borrow_mut();
                    bytes.iter().for_each(|byte| {
                        wires.write(*byte);
                    });
                }
                Operation::Read(bytes) => {
                    self.bytes(bytes.len()).await;
                    let mut wires = self.wires.borrow_mut();
                    for byte in bytes.iter_mut() {
                        let received = wires.read();
                        *byte = match self.residue.get() {
                            Some(before) => {
                                self.residue.set(Some(received));
                                before
                            }
                            None => received,
                        };
                    }
                }
            }
        }
        self.wires.borrow_mut().stop();
        delay_us(&self.clock, BIT_US).await;
        Ok(())
    }
}

impl SensorBus for SimulatedI2c {
    async fn recover(&mut self) -> bool {
        let clock = self.clock.clone();
        // Recovery resets the peripheral.
        self.residue.set(None);
        clear_bus(&mut Pins(self.wires.clone(), clock.clone()), &clock).await
    }
}

/// The lines as GPIO pins.
struct Pins(Rc<RefCell<SensorBusWires>>, VirtualClock);

impl BusLines for Pins {
    fn set_clock(&mut self, high: bool) {
        let mut wires = self.0.borrow_mut();
        let was_high = std::mem::replace(&mut wires.clock_high, high);
        if high && !was_high {
            wires.pulse();
        }
    }

    fn set_data(&mut self, _: bool) {}

    fn levels(&mut self) -> [bool; 2] {
        let wires = self.0.borrow();
        let [clock, data] = wires.released(Time::from_us(self.1.now_us()));
        [wires.clock_high && clock, data]
    }
}

//! The sensor buses: sensors with registers, lines with levels. The emulated chip reaches them by its pins, the firmware's
//! loops in virtual time by [`SimulatedBus`], which is a controller of its own. What goes wrong is done to sensors and
//! lines, never reported to the firmware.

use std::cell::{Cell, RefCell};
use std::future::pending;
use std::rc::Rc;

use embedded_hal_async::i2c::{
    Error, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation, SevenBitAddress,
};
use firmware::clock::{Clock, pause};
use firmware::hall::bus::{Lines, SensorBus, clear};
use firmware::hall::registers::a31301::{CONFIGURATION, READING_BYTES, TEMPERATURE};
use firmware::hall::{Reading, a31301};
use sim_board::Time;
use sim_board::devices::I2cBus;

use super::time::VirtualClock;
use super::world::Now;

/// A bit at 1 MHz.
const BIT_US: u64 = 1;
/// Bits of a byte with its acknowledgement.
const BYTE_BITS: u64 = 9;

/// What a sensor's configuration is as its power comes, from its own memory; the number is assumed.
const CONFIGURED: u16 = 0x0140;

/// A sensor on a bus.
#[derive(Clone, Debug)]
pub struct Sensor {
    /// Its number on the gripper.
    pub number: usize,
    /// Its address.
    pub address: u8,
    /// Its connector is off.
    pub unplugged: bool,
    /// It does not acknowledge so many further transfers.
    pub refuses: u32,
    /// Its registers stand still.
    pub frozen: bool,
    /// What its element makes of the field; one in health.
    pub gain: f64,
    /// A field of somebody else at its element, in counts.
    pub beside: [f64; 3],
    /// In the next transfer it holds the clock line low for so long.
    pub stretches: Option<Time>,
    /// In the next transfer it misses a clock and holds the data line for so many clocks.
    pub slips: Option<u32>,
    /// What it is configured as.
    configuration: u16,
    /// Contents of its registers.
    registers: [u8; READING_BYTES],
    /// Address of the next byte; none while it is awaited.
    pointer: Option<u8>,
}

impl Sensor {
    /// A healthy one.
    pub fn new(number: usize, address: u8) -> Self {
        Self {
            number,
            address,
            unplugged: false,
            refuses: 0,
            frozen: false,
            gain: 1.0,
            beside: [0.0; 3],
            slips: None,
            stretches: None,
            configuration: CONFIGURED,
            registers: [0; READING_BYTES],
            pointer: None,
        }
    }

    /// Takes its voltage away and gives too little of it back for its memory: it wakes with its registers' defaults,
    /// of which one is assumed to be twice the range.
    pub const fn brown_out(&mut self) {
        self.configuration = 0;
    }

    /// Takes its voltage away and gives it back.
    pub const fn power_up(&mut self) {
        self.configuration = CONFIGURED;
    }

    /// Brings the registers up to date.
    fn measure(&mut self, reading: Reading) {
        if self.frozen {
            return;
        }
        let (least, greatest) = a31301::FIELD_LIMITS;
        let range = if self.configuration == CONFIGURED {
            1.0
        } else {
            2.0
        };
        let seen = |counts: i16, beside: f64| {
            let scaled = ((f64::from(counts) * self.gain + beside) / range).round();
            scaled.clamp(f64::from(least), f64::from(greatest)) as i16
        };
        let [x, y, z] = reading.field;
        let [dx, dy, dz] = self.beside;
        let field = [seen(x, dx), seen(y, dy), seen(z, dz)];
        self.registers = a31301::encode(Reading { field, ..reading });
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

/// The lines and the sensors on them.
pub struct Wires {
    /// The sensors.
    pub sensors: Vec<Sensor>,
    /// Clocks until whoever holds the data line lets go; [`u32::MAX`]: it is shorted to ground.
    pub held: u32,
    clock_high: bool,
    /// A sensor holds the clock line low until then.
    stretched_until: Time,
    /// Transfers that were begun.
    pub transfers: u64,
    /// Place of the sensor that was addressed.
    addressed: Option<usize>,
    now: Rc<RefCell<Now>>,
}

impl Wires {
    /// A bus at rest, with sensors in this world.
    pub fn new(sensors: Vec<Sensor>, now: Rc<RefCell<Now>>) -> Self {
        Self {
            sensors,
            held: 0,
            clock_high: true,
            stretched_until: Time::ZERO,
            transfers: 0,
            addressed: None,
            now,
        }
    }

    fn sensor(&mut self) -> Option<&mut Sensor> {
        self.sensors.get_mut(self.addressed?)
    }
}

impl I2cBus for Wires {
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
            // It has lost count: it acknowledges, and then sends a low bit that nobody clocks.
            self.held = clocks;
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
            // Further bytes would be written to registers, which the firmware never does.
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
        [time >= self.stretched_until, self.held == 0]
    }

    fn pulse(&mut self) {
        if self.held != u32::MAX {
            self.held = self.held.saturating_sub(1);
        }
    }
}

/// The controller of a bus in virtual time.
pub struct SimulatedBus {
    /// The lines.
    pub wires: Rc<RefCell<Wires>>,
    /// Time.
    pub clock: VirtualClock,
    /// A byte that an aborted transfer has left in the data register: it is the first that each transfer reads.
    pub residue: Rc<Cell<Option<u8>>>,
}

/// A transfer that did not end as it should.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotAcknowledged;

impl Error for NotAcknowledged {
    fn kind(&self) -> ErrorKind {
        ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown)
    }
}

impl ErrorType for SimulatedBus {
    type Error = NotAcknowledged;
}

impl SimulatedBus {
    async fn bytes(&self, count: usize) {
        pause(&self.clock, BIT_US * BYTE_BITS * count as u64).await;
    }

    /// Start and address.
    async fn begin(&mut self, address: u8, is_read: bool) -> Result<(), NotAcknowledged> {
        self.released().await;
        pause(&self.clock, BIT_US).await;
        self.bytes(1).await;
        let time = Time::from_us(self.clock.now_us());
        let is_acknowledged = self.wires.borrow_mut().address(time, address, is_read);
        if !is_acknowledged {
            return Err(NotAcknowledged);
        }
        self.released().await;
        Ok(())
    }

    /// Waits for a line that a sensor holds: for ever, since nobody else clocks it.
    async fn released(&self) {
        let (is_held, stretched_until) = {
            let wires = self.wires.borrow();
            (wires.held > 0, wires.stretched_until)
        };
        if is_held {
            pending::<()>().await;
        }
        self.clock.until(stretched_until.us()).await;
    }
}

impl I2c<SevenBitAddress> for SimulatedBus {
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
        pause(&self.clock, BIT_US).await;
        Ok(())
    }
}

impl SensorBus for SimulatedBus {
    async fn recover(&mut self) -> bool {
        let clock = self.clock.clone();
        // The peripheral is initialised anew.
        self.residue.set(None);
        clear(&mut Pins(self.wires.clone(), clock.clone()), &clock).await
    }
}

/// The lines as pins.
struct Pins(Rc<RefCell<Wires>>, VirtualClock);

impl Lines for Pins {
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

//! A simulated bus with sensors: registers, levels, and time. What goes wrong is done to the sensors and
//! to the lines, never told to the firmware.

use std::cell::RefCell;
use std::future::pending;
use std::rc::Rc;

use embedded_hal_async::i2c::{
    Error, ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation, SevenBitAddress,
};
use firmware::clock::{Clock, pause};
use firmware::hall::bus::{Lines, SensorBus, clear};
use firmware::hall::registers::a31301::{CONFIGURATION, READING_BYTES, TEMPERATURE};
use firmware::hall::{Reading, a31301};

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
    /// In the next transfer it misses a clock and holds the data line for so many clocks.
    pub slips: Option<u32>,
    /// What it is configured as.
    configuration: u16,
    /// What stands in its registers.
    registers: [u8; READING_BYTES],
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
            configuration: CONFIGURED,
            registers: [0; READING_BYTES],
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

/// The lines and who is on them.
pub struct Wires {
    /// The sensors.
    pub sensors: Vec<Sensor>,
    /// Clocks until whoever holds the data line lets go; [`u32::MAX`]: it is shorted to ground.
    pub held: u32,
    clock_high: bool,
    /// Transfers that were begun.
    pub transfers: u64,
}

impl Wires {
    /// A bus at rest.
    pub fn new(sensors: Vec<Sensor>) -> Self {
        Self {
            sensors,
            held: 0,
            clock_high: true,
            transfers: 0,
        }
    }

    /// Clocks that pass on the line.
    fn clocks(&mut self, count: u32) {
        if self.held != u32::MAX {
            self.held = self.held.saturating_sub(count);
        }
    }
}

/// The board's end of a bus.
pub struct SimulatedBus {
    /// The lines.
    pub wires: Rc<RefCell<Wires>>,
    /// What the sensors feel.
    pub now: Rc<RefCell<Now>>,
    /// Time.
    pub clock: VirtualClock,
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

    /// Start and address; the sensor's place on the bus.
    async fn begin(&mut self, address: u8) -> Result<usize, NotAcknowledged> {
        if self.wires.borrow().held > 0 {
            // No start is possible: the peripheral waits for a line that does not rise.
            return pending().await;
        }
        self.wires.borrow_mut().transfers += 1;
        pause(&self.clock, BIT_US).await;
        self.bytes(1).await;
        match self.answer(address) {
            Answer::Place(place) => Ok(place),
            Answer::None => Err(NotAcknowledged),
            Answer::Slipped => pending().await,
        }
    }

    /// What becomes of an address on the bus.
    fn answer(&mut self, address: u8) -> Answer {
        let time_us = self.clock.now_us();
        let readings = self.now.borrow_mut().at(time_us).readings;
        let wires = &mut *self.wires.borrow_mut();
        let mut sensors = wires.sensors.iter_mut().enumerate();
        let found = sensors.find(|(_, sensor)| sensor.address == address && !sensor.unplugged);
        let Some((place, sensor)) = found else {
            return Answer::None;
        };
        if sensor.refuses > 0 {
            sensor.refuses -= 1;
            return Answer::None;
        }
        if let Some(clocks) = sensor.slips.take() {
            wires.held = clocks;
            return Answer::Slipped;
        }
        if let Some(reading) = readings.get(sensor.number).copied().flatten() {
            sensor.measure(reading);
        }
        Answer::Place(place)
    }
}

/// What becomes of an address.
enum Answer {
    /// The sensor at this place acknowledges.
    Place(usize),
    /// Nobody does.
    None,
    /// The sensor has lost count and holds the data line.
    Slipped,
}

impl I2c<SevenBitAddress> for SimulatedBus {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), Self::Error> {
        let mut pointer = 0_u8;
        for operation in operations {
            let place = self.begin(address).await?;
            match operation {
                Operation::Write(bytes) => {
                    self.bytes(bytes.len()).await;
                    pointer = bytes.first().copied().unwrap_or(pointer);
                }
                Operation::Read(bytes) => {
                    self.bytes(bytes.len()).await;
                    let wires = self.wires.borrow();
                    for byte in bytes.iter_mut() {
                        *byte = wires.sensors[place].register(pointer);
                        pointer = pointer.wrapping_add(1);
                    }
                }
            }
        }
        // The stop.
        pause(&self.clock, BIT_US).await;
        Ok(())
    }
}

impl SensorBus for SimulatedBus {
    async fn recover(&mut self) -> bool {
        let clock = self.clock.clone();
        clear(&mut Pins(self.wires.clone()), &clock).await
    }
}

/// The lines as pins.
struct Pins(Rc<RefCell<Wires>>);

impl Lines for Pins {
    fn set_clock(&mut self, high: bool) {
        let mut wires = self.0.borrow_mut();
        if high && !std::mem::replace(&mut wires.clock_high, high) {
            wires.clocks(1);
        }
        wires.clock_high = high;
    }

    fn set_data(&mut self, _: bool) {}

    fn levels(&mut self) -> [bool; 2] {
        let wires = self.0.borrow();
        [wires.clock_high, wires.held == 0]
    }
}

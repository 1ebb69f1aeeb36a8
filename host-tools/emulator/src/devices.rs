//! What is connected to the chip's pins: one trait for each kind of connection, implemented by simulations of the
//! sensors, the drivetrain and the buses, which the emulator does not contain.

use std::cell::RefCell;
use std::rc::Rc;

use crate::time::Time;

/// Everything outside of the chip. Clones are the same devices.
#[derive(Clone)]
pub struct Devices {
    /// Both sensor buses.
    pub sensor_buses: [Rc<RefCell<dyn I2cBus>>; 2],
    /// The rotor's angle sensor, then the inertial sensor.
    pub spi: [Rc<RefCell<dyn SpiDevice>>; 2],
    /// Half bridges and what is measured at them.
    pub drivetrain: Rc<RefCell<dyn Drivetrain>>,
    /// The CAN bus.
    pub can: Rc<RefCell<dyn CanBus>>,
    /// The serial line.
    pub serial: Rc<RefCell<dyn SerialLine>>,
}

impl Devices {
    /// A sensor bus, or one without devices where a peripheral is at none.
    pub(crate) fn sensor_bus(&self, place: Option<usize>) -> Rc<RefCell<dyn I2cBus>> {
        match place {
            Some(place) => self.sensor_buses[place].clone(),
            None => Rc::new(RefCell::new(EmptyI2cBus)),
        }
    }
}

/// Devices on an I2C bus, byte by byte, and the levels of its lines.
pub trait I2cBus {
    /// A start or repeated start with an address of seven bits; true where a device acknowledges it.
    fn address(&mut self, time: Time, address: u8, is_read: bool) -> bool;

    /// A byte from the controller; true where the addressed device acknowledges it.
    fn write(&mut self, byte: u8) -> bool;

    /// The next byte of the addressed device.
    fn read(&mut self) -> u8;

    /// A stop condition.
    fn stop(&mut self);

    /// Whether the devices let clock and data lines go at this time; a device that stretches the clock holds that line low,
    /// one that has lost count the data line.
    fn released(&self, time: Time) -> [bool; 2];

    /// A rising edge of the clock line while no transfer is under way: bus clear by hand.
    fn pulse(&mut self);
}

/// No device: nothing acknowledges, both lines are pulled up.
struct EmptyI2cBus;

impl I2cBus for EmptyI2cBus {
    fn address(&mut self, _: Time, _: u8, _: bool) -> bool {
        false
    }

    fn write(&mut self, _: u8) -> bool {
        false
    }

    fn read(&mut self) -> u8 {
        0xFF
    }

    fn stop(&mut self) {}

    fn released(&self, _: Time) -> [bool; 2] {
        [true; 2]
    }

    fn pulse(&mut self) {}
}

/// A device on SPI with a select line of its own and frames of 8 or 16 bits.
pub trait SpiDevice {
    /// The select line falls (true) or rises.
    fn select(&mut self, time: Time, is_selected: bool);

    /// A frame: what the device shifts out while `frame` comes in.
    fn transfer(&mut self, time: Time, frame: u16) -> u16;
}

/// The three half bridges, what they drive, and what the converter's inputs measure.
pub trait Drivetrain {
    /// Half a period of the pulses passes: with these shares of it in which the high sides are on (0 to 1), or with all
    /// switches off. `duration` is that of the half.
    fn half_period(&mut self, duration: Time, duties: Option<[f64; 3]>);

    /// Counts of 12 bits of the four inputs at this moment: phases U, V, W, then the bus voltage.
    fn sample(&mut self) -> [u16; 4];

    /// Counts of 12 bits of the temperature inputs at this moment: the chip's own sensor, the thermistors of motor and power
    /// stage.
    fn temperatures(&mut self) -> [u16; 3];
}

/// A classic CAN frame with an identifier of 11 bits, or 29 where extended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanFrame {
    /// The identifier.
    pub id: u32,
    /// The identifier has 29 bits.
    pub is_extended: bool,
    /// A remote frame: it asks for data and carries none.
    pub is_remote: bool,
    /// Number of bytes, 0 to 8.
    pub length: u8,
    /// The bytes; those beyond `length` are zero.
    pub data: [u8; 8],
}

impl CanFrame {
    /// A data frame with an identifier of 11 bits; takes at most eight bytes.
    pub fn standard(id: u16, bytes: &[u8]) -> Self {
        let mut data = [0; 8];
        let length = bytes.len().min(8);
        data[..length].copy_from_slice(&bytes[..length]);
        Self { id: id.into(), is_extended: false, is_remote: false, length: length as u8, data }
    }

    /// Its bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.data[..usize::from(self.length)]
    }

    /// Order in arbitration: the least goes first (ISO 11898-1, 10.3).
    pub fn priority(&self) -> u32 {
        let (base, rest) =
            if self.is_extended { (self.id >> 18, self.id & 0x3_FFFF) } else { (self.id, 0) };
        // Base identifier, then SRR/RTR and IDE, recessive in an extended frame, then its other bits.
        base << 21 | u32::from(self.is_extended) << 20 | rest << 1 | u32::from(self.is_remote)
    }
}

/// What became of a frame that the controller sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transmission {
    /// Another node acknowledged it.
    Acknowledged,
    /// Nobody did.
    NotAcknowledged,
    /// Another bit than the one sent was on the bus.
    BitError,
}

/// What happens on the bus at the controller's end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CanEvent {
    /// The controller's frame has ended.
    Sent(CanFrame, Transmission),
    /// A frame of another node has ended.
    Received(CanFrame),
}

/// A CAN bus with other nodes on it. Arbitration is the bus's: the controller offers the frame that it would send next.
pub trait CanBus {
    /// The frame that the controller wants to send from this time on; none where it has none or is off the bus. It may
    /// change with each call; a frame that is under way ends all the same.
    fn offer(&mut self, time: Time, frame: Option<CanFrame>);

    /// A frame of the controller is under way: it ends before it can be cancelled.
    fn is_sending(&self) -> bool;

    /// When something happens next; [`Time::NEVER`] where nothing is under way.
    fn next_event(&self) -> Time;

    /// What has happened by this time, once each.
    fn take_event(&mut self, time: Time) -> Option<CanEvent>;

    /// Length of a bit of the other nodes.
    fn bit_time(&self) -> Time;
}

/// The other end of the serial line.
pub trait SerialLine {
    /// A byte of the chip has been shifted out.
    fn receive(&mut self, time: Time, byte: u8);

    /// When the next byte to the chip may begin; [`Time::NEVER`] where none waits.
    fn next_byte(&self) -> Time;

    /// The byte whose transmission to the chip begins at this time, if there is one.
    fn transmit(&mut self, time: Time) -> Option<u8>;

    /// Bits per second of the other end.
    fn baud_rate(&self) -> u32;
}

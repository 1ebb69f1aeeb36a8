//! The printed circuit board: which connection is at which pin of the chip. The emulator connects a peripheral to it
//! only where the program has given it that pin.

use crate::peripherals::gpio::Pin;
use crate::registers::{alternate_function, peripheral};
use crate::time::Frequency;

/// Pins of each connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wiring {
    /// Clock and data of both sensor buses, with pull-ups.
    pub sensor_buses: [[Pin; 2]; 2],
    /// From and to the CAN transceiver.
    pub can: [Pin; 2],
    /// Serial line: into the chip, out of it.
    pub serial: [Pin; 2],
    /// Rotor sensor: clock, into the sensor, out of it, select.
    pub encoder: [Pin; 4],
    /// Inertial sensor: clock, into the sensor, out of it, select.
    pub inertial: [Pin; 4],
    /// High sides and low sides of the half bridges U, V, W.
    pub bridges: [[Pin; 3]; 2],
    /// From the gate drivers: low where they have found something wrong.
    pub gate_fault: Pin,
    /// Phase currents U, V, W, and bus voltage.
    pub analog: [Pin; 4],
    /// Thermistors of motor and power stage.
    pub thermistors: [Pin; 2],
    /// Crystal.
    pub crystal: Frequency,
}

impl Wiring {
    /// The pin that is BOOT0 during a reset.
    pub const BOOT0: Pin = Pin::named("PB8");

    /// Pins of an SPI device: clock, into the device, out of it, select.
    pub(crate) const fn spi(&self, number: usize) -> [Pin; 4] {
        if number == 0 { self.encoder } else { self.inertial }
    }

    /// Whether something outside pulls a pin high.
    pub fn is_pulled_up(&self, pin: Pin) -> bool {
        self.sensor_buses.as_flattened().contains(&pin)
    }

    /// Channels of a converter at analog pins.
    ///
    /// # Panics
    /// A pin is no input of the converter.
    pub(crate) fn adc_channels<const N: usize>(converter: &str, inputs: [Pin; N]) -> [u32; N] {
        inputs.map(|pin| {
            let name = pin.name();
            let mut pins =
                peripheral(converter).pins.iter().filter(|candidate| candidate.pin == name);
            let channel =
                pins.find_map(|candidate| candidate.signal.strip_prefix("IN")?.parse().ok());
            channel.unwrap_or_else(|| panic!("{name} is no input of {converter}"))
        })
    }

    /// Alternate functions by which these pins are these signals of a peripheral; none where one is not.
    pub(crate) fn functions<const N: usize>(
        name: &str,
        signals: [&str; N],
        pins: [Pin; N],
    ) -> Option<[u8; N]> {
        let mut functions = [0; N];
        for ((function, signal), pin) in functions.iter_mut().zip(signals).zip(pins) {
            *function = alternate_function(name, signal, &pin.name())?;
        }
        Some(functions)
    }
}

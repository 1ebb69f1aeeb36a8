//! The board as data: what is at which pin, gains, limits, what the board must provide, each with its basis. The tables of
//! `firmware/BOARD.md`, the wiring of the emulated board and the limits of the bring-up are generated from it.

use crate::config::constants::{self, Basis, Constant, assumed, stated};
use crate::config::limits::FROZEN_AXES;
use crate::motor::settings::STUCK_PERIODS;
use crate::sensors::hall::{GripperHallSensor, HallSensor};

/// A function of the board and its pins.
#[derive(Clone, Copy, Debug)]
pub struct Function {
    /// What is connected.
    pub name: &'static str,
    /// Peripheral of the chip.
    pub peripheral: &'static str,
    /// Signals and pins.
    pub pins: &'static [(&'static str, &'static str)],
    /// Polarity.
    pub level: &'static str,
    /// Basis of the choice.
    pub basis: Basis,
    /// Source.
    pub source: &'static str,
}

const fn function(
    [name, peripheral, level, source]: [&'static str; 4],
    pins: &'static [(&'static str, &'static str)],
) -> Function {
    Function { name, peripheral, pins, level, basis: Basis::Assumed, source }
}

const PAPER: &str = "the paper's board is not public";
const OPEN_DRAIN: &str = "open drain";

/// Hall sensors 0 and 1; SCL is not at PB8, which is BOOT0 (RM0440 2.6.1).
pub const FIRST_BUS: Function = function(
    ["Hall sensors 0, 1", "I2C1", OPEN_DRAIN, "not PB8: BOOT0"],
    &[("SCL", "PA15"), ("SDA", "PB9")],
);
/// Hall sensors 2 and 3.
pub const SECOND_BUS: Function =
    function(["Hall sensors 2, 3", "I2C3", OPEN_DRAIN, PAPER], &[("SCL", "PC8"), ("SDA", "PC9")]);
/// CAN transceiver.
pub const CAN: Function = function(
    ["CAN transceiver", "FDCAN1", "dominant low", PAPER],
    &[("RX", "PA11"), ("TX", "PA12")],
);
/// Serial line.
pub const SERIAL: Function = Function {
    basis: Basis::Stated,
    ..function(
        ["serial line of the debugger", "USART2", "idle high", "UM2505 (NUCLEO-G474RE)"],
        &[("RX", "PA3"), ("TX", "PA2")],
    )
};
/// Rotor sensor AS5047P.
pub const ENCODER: Function = function(
    ["rotor sensor AS5047P", "SPI1", "mode 1, CS low", PAPER],
    &[("SCK", "PA5"), ("MOSI", "PA7"), ("MISO", "PA6"), ("CS", "PA4")],
);
/// Inertial sensor LSM6DS3TR-C.
pub const INERTIAL: Function = function(
    ["inertial sensor LSM6DS3TR-C, optional", "SPI3", "mode 3, CS low", PAPER],
    &[("SCK", "PC10"), ("MOSI", "PC12"), ("MISO", "PC11"), ("CS", "PD2")],
);
/// High sides of the half bridges.
pub const HIGH_SIDES: Function = function(
    ["half bridges U, V, W, high sides", "TIM1", "on while high", PAPER],
    &[("CH1", "PA8"), ("CH2", "PA9"), ("CH3", "PA10")],
);
/// Low sides of the half bridges.
pub const LOW_SIDES: Function = function(
    ["half bridges U, V, W, low sides", "TIM1", "on while high", PAPER],
    &[("CH1N", "PB13"), ("CH2N", "PB14"), ("CH3N", "PB15")],
);
/// Break input.
pub const BREAK: Function = function(
    ["fault of the power stage", "TIM1", "low: fault", "an open wire reads as a fault"],
    &[("BKIN", "PB12")],
);
/// Phase currents and bus voltage.
pub const ANALOG: Function = function(
    ["currents U, V, W; bus voltage", "ADC1", "mid-scale: no current", PAPER],
    &[("U", "PC0"), ("V", "PC1"), ("W", "PC2"), ("bus", "PC3")],
);
/// Thermistors.
pub const THERMISTORS: Function = function(
    ["thermistors", "ADC3", "falls with the temperature", PAPER],
    &[("motor", "PB1"), ("power stage", "PB0")],
);
/// Button.
pub const BUTTON: Function = Function {
    basis: Basis::Stated,
    ..function(
        ["button B1", "GPIO", "high while pressed", "UM2505 (NUCLEO-G474RE)"],
        &[("", "PC13")],
    )
};

/// All functions.
pub const FUNCTIONS: [Function; 12] = [
    FIRST_BUS,
    SECOND_BUS,
    CAN,
    SERIAL,
    HIGH_SIDES,
    LOW_SIDES,
    BREAK,
    ANALOG,
    THERMISTORS,
    ENCODER,
    INERTIAL,
    BUTTON,
];

/// Crystal in hertz.
pub const CRYSTAL_HZ: u32 = 24_000_000;
/// Rise and fall times of the sensor buses in nanoseconds.
pub const EDGES_NS: [u32; 2] = [85, 20];

/// Gains and times of what is connected. The firmware computes with the same constants.
pub const VALUES: [Constant; 13] = [
    stated("crystal", 1e-6 * CRYSTAL_HZ as f64, "MHz", "UM2505, X3 of a NUCLEO-G474RE"),
    assumed("rise time of the sensor buses", EDGES_NS[0] as f64, "ns", "1 kOhm, 100 pF"),
    assumed("fall time of the sensor buses", EDGES_NS[1] as f64, "ns", "drivers of 20 mA"),
    constants::SENSOR_SCALE,
    constants::CURRENT_SCALE,
    constants::BUS_SCALE,
    constants::ENCODER_BITS,
    constants::THERMISTOR_RESISTANCE,
    constants::THERMISTOR_B,
    constants::THERMISTOR_PULL_UP,
    constants::PWM_RATE,
    constants::DEAD_TIME,
    constants::AMPLIFIER_SETTLING,
];

/// Addresses of sensors 0 to 3 by their straps; the parameters `address_0` to `address_3` change them.
pub const ADDRESSES: [u8; 4] = GripperHallSensor::ADDRESSES;

/// A range that the bring-up checks.
#[derive(Clone, Copy, Debug)]
pub struct Range {
    /// Name for display.
    pub name: &'static str,
    /// Lowest and highest value.
    pub limits: [f64; 2],
    /// Unit.
    pub unit: &'static str,
    /// Basis.
    pub basis: Basis,
    /// Source.
    pub source: &'static str,
}

const fn range([name, unit, source]: [&'static str; 3], limits: [f64; 2]) -> Range {
    Range { name, limits, unit, basis: Basis::Assumed, source }
}

/// Chip at rest.
pub const CHIP_C: Range = range(["chip at rest", "°C", "a room"], [0.0, 70.0]);
/// An open or shorted thermistor is outside.
pub const MOTOR_C: Range = range(["motor at rest", "°C", "a room"], [-20.0, 60.0]);
/// Bus without the motor supply.
pub const UNSUPPLIED_V: Range = range(["bus without supply", "V", "discharged"], [0.0, 1.0]);
/// Each axis.
pub const NOISE: Range =
    range(["noise of a Hall sensor", "counts", "A31301 at full rate: 2.8"], [0.3, 10.0]);
/// One less than the detector of frozen sensors permits.
pub const EQUAL_READINGS: Range = range(
    ["equal readings in a row", "", "noise, detector of frozen sensors"],
    [1.0, (FROZEN_AXES / 3 - 1) as f64],
);
/// Automatic gain, 0 to 255.
pub const ENCODER_GAIN: Range =
    range(["gain of the rotor sensor", "", "AS5047P: 0 to 255"], [20.0, 235.0]);
/// Fewer than the detector of stuck sensors permits.
pub const EQUAL_ANGLES: Range = range(
    ["equal angles in a row", "", "noise, detector of stuck sensors"],
    [1.0, (STUCK_PERIODS - 1) as f64],
);
/// Gate inputs of a bridge that is off.
pub const GATES_OFF_V: Range = range(["gates that are off", "V", "any gate driver"], [0.0, 0.5]);
/// Supply of the bench.
pub const BENCH_V: Range = range(["supply of the bench", "V", "12 V"], [11.0, 13.0]);
/// Of the supply.
pub const REST_A: Range = range(["current at rest", "A", "noise and offset"], [-0.3, 0.3]);

/// All ranges.
pub const RANGES: [Range; 10] = [
    CHIP_C,
    MOTOR_C,
    UNSUPPLIED_V,
    NOISE,
    EQUAL_READINGS,
    ENCODER_GAIN,
    EQUAL_ANGLES,
    GATES_OFF_V,
    BENCH_V,
    REST_A,
];

/// What the board must provide.
#[derive(Clone, Copy, Debug)]
pub struct Requirement {
    /// Pins or part.
    pub place: &'static str,
    /// The requirement.
    pub text: &'static str,
    /// Basis.
    pub basis: Basis,
    /// Source.
    pub source: &'static str,
}

const fn requires([place, text, source]: [&'static str; 3], basis: Basis) -> Requirement {
    Requirement { place, text, basis, source }
}

/// All requirements.
pub const REQUIREMENTS: [Requirement; 13] = {
    use Basis::{Assumed, Stated};
    [
        requires(
            [
                "PC0 to PC3",
                "source impedance of at most 1 kOhm; amplifiers that settle within 1 us",
                "sampled for 162 ns; data sheet, ADC",
            ],
            Stated,
        ),
        requires(
            [
                "PB0, PB1",
                "thermistors of 10 kOhm to ground, pull-ups of 10 kOhm to VREF+",
                "common",
            ],
            Assumed,
        ),
        requires(
            [
                "VREF+",
                "connected to 3.3 V: the chip's own reference buffer is off",
                "RM0440, VREFBUF",
            ],
            Stated,
        ),
        requires(
            [
                "PA8 to PA10, PB13 to PB15",
                "pull-downs at the gate drivers",
                "no program drives the pins during a reset",
            ],
            Stated,
        ),
        requires(
            [
                "PB12",
                "pull-up of at most 4.7 kOhm to 3.3 V, open drain outputs of the gate drivers",
                "data sheet: pull-down of 25 to 55 kOhm",
            ],
            Stated,
        ),
        requires(
            [
                "gate drivers",
                "enabled and configured by the board: no pin and no SPI frame of this firmware does",
                "no driver is named",
            ],
            Assumed,
        ),
        requires(
            [
                "PA11, PA12",
                "transceiver with STB low, 120 Ohm at both ends of the bus",
                "ISO 11898-2",
            ],
            Stated,
        ),
        requires(
            [
                "PA15, PB9; PC8, PC9",
                "pull-ups of 1 kOhm to 3.3 V, at most 100 pF: edges within 120 ns",
                "UM10204, Fast-mode Plus",
            ],
            Stated,
        ),
        requires(
            [
                "straps of the Hall sensors",
                "addresses 0x60 and 0x63 on the first bus, 0x6C and 0x6F on the second",
                "0x63 was observed, 0x6C is inferred",
            ],
            Assumed,
        ),
        requires(
            [
                "magnet of the rotor sensor",
                "0.5 to 3 mm from the sensor, centred",
                "AS5047P data sheet",
            ],
            Stated,
        ),
        requires(
            [
                "PA5",
                "the LED LD2 of a Nucleo is at SCK as well: disconnect it if the edges are slow",
                "UM2505",
            ],
            Stated,
        ),
        requires(
            ["rotor", "can be turned by hand", "to free what is held without a supply"],
            Assumed,
        ),
        requires(
            ["option bytes", "DBANK = 1, BFB2 = 0, SRAM_PE = 1, as shipped", "RM0440 3.7.8"],
            Stated,
        ),
    ]
};

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::vec::Vec;

    use super::*;

    fn pins() -> Vec<&'static str> {
        FUNCTIONS.iter().flat_map(|row| row.pins.iter().map(|(_, pin)| *pin)).collect()
    }

    #[test]
    fn no_pin_is_used_twice() {
        let pins = pins();
        assert_eq!(pins.iter().collect::<BTreeSet<_>>().len(), pins.len());
    }

    /// The code that initialises the board takes each pin and peripheral from the structure `p`.
    #[test]
    fn board_takes_the_pins_and_peripherals_of_the_table() {
        let code = include_str!("peripherals.rs");
        let taken: BTreeSet<_> = code
            .split("p.")
            .skip(1)
            .filter_map(|rest| {
                rest.split(|c: char| !c.is_ascii_uppercase() && !c.is_ascii_digit()).next()
            })
            .collect();
        let is_pin = |name: &&str| {
            name.len() <= 4 && matches!(name.as_bytes(), [b'P', b'A'..=b'F', b'0'..=b'9', ..])
        };
        let (found, others): (BTreeSet<_>, BTreeSet<_>) = taken.iter().copied().partition(is_pin);
        assert_eq!(found, pins().into_iter().collect());
        for row in FUNCTIONS.iter().filter(|row| row.peripheral != "GPIO") {
            assert!(others.contains(row.peripheral), "{} is not taken", row.peripheral);
        }
    }

    #[test]
    fn straps_are_those_of_the_requirement() {
        let row = REQUIREMENTS.iter().find(|row| row.place.starts_with("straps")).unwrap();
        for address in ADDRESSES {
            assert!(
                row.text.contains(&std::format!("{address:#X}").replace("0X", "0x")),
                "{address:#x}"
            );
        }
    }
}

//! Schema of the parameters: identifiers, names, units, defaults, ranges.

use crate::config::constants;
use crate::estimator::tare::MAX_OFFSET;
use crate::motor::settings::MotorParameters;
use crate::protocol::DEFAULT_NODE;
use crate::sensors::hall::{GripperHallSensor, HallSensor, SENSORS};

/// Definition of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// Identifier on the bus and in flash; never changes.
    pub id: u16,
    /// Name on the host.
    pub name: &'static str,
    /// Unit of a count; empty for a plain number.
    pub unit: &'static str,
    /// Default value.
    pub default: i32,
    /// Permitted values.
    pub range: ValueRange,
    /// Whether it affects motion; then it is not writable while armed.
    pub affects_motion: bool,
    /// Description for the host.
    pub description: &'static str,
}

/// Permitted values of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ValueRange {
    /// Minimum and maximum.
    Between(i32, i32),
    /// One of these.
    OneOf(&'static [i32]),
}

impl ValueRange {
    /// Whether a value is permitted.
    pub fn contains(&self, value: i32) -> bool {
        match self {
            Self::Between(min, max) => (*min..=*max).contains(&value),
            Self::OneOf(choices) => choices.contains(&value),
        }
    }
}

/// The part of a definition that the device needs: without text, to save flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParameterRule {
    /// See [`Parameter::id`].
    pub id: u16,
    /// See [`Parameter::range`].
    pub range: ValueRange,
    /// See [`Parameter::affects_motion`].
    pub affects_motion: bool,
}

/// The rules in the order of [`PARAMETERS`].
pub static RULES: [ParameterRule; COUNT] = {
    let none = ParameterRule { id: 0, range: ValueRange::OneOf(&[]), affects_motion: false };
    let mut rules = [none; COUNT];
    let (mut to, mut from): (&mut [ParameterRule], &[Parameter]) = (&mut rules, &PARAMETERS);
    while let (Some((rule, rules)), Some((row, others))) =
        (to.split_first_mut(), from.split_first())
    {
        *rule = ParameterRule { id: row.id, range: row.range, affects_motion: row.affects_motion };
        (to, from) = (rules, others);
    }
    rules
};

/// Index of the parameter with this identifier; in a constant, an unknown one does not compile.
pub const fn index_of(id: u16) -> usize {
    let (mut index, mut rest): (usize, &[Parameter]) = (0, &PARAMETERS);
    while let Some((row, others)) = rest.split_first() {
        if row.id == id {
            return index;
        }
        (index, rest) = (index + 1, others);
    }
    assert!(index < COUNT, "no such parameter");
    index
}

/// Identifiers of counters since boot and of what the board is, which are read like parameters and cannot be written.
pub mod counter {
    /// Failed transfers from sensors.
    pub const TRANSFERS_FAILED: u16 = 0x200;
    /// Skipped ticks.
    pub const TICKS_MISSED: u16 = 0x201;
    /// Rejected frames and packets for this node: wrong checksum, replayed, unknown.
    pub const FRAMES_REFUSED: u16 = 0x202;
    /// Serial packets that could not be decoded.
    pub const PACKETS_BROKEN: u16 = 0x203;
    /// Frames and packets dropped by the receive queue.
    pub const RECEIVE_OVERRUN: u16 = 0x204;
    /// Frames without acknowledge.
    pub const FRAMES_UNSENT: u16 = 0x205;
    /// Packets dropped by the serial line.
    pub const PACKETS_UNSENT: u16 = 0x206;
    /// Answers at addresses 0x60 to 0x6F at boot, one bit each: first bus in the lower half.
    pub const BUS_ANSWERS: u16 = 0x207;
    /// DIAAGC of the rotor sensor at boot ([`crate::motor::as5047::diagnosis`]); all ones without an answer.
    pub const ROTOR_SENSOR: u16 = 0x208;
    /// Level of the break input: 1 if the power stage is ready.
    pub const BREAK_INPUT: u16 = 0x209;
    /// Device and revision of the chip (DBGMCU_IDCODE).
    pub const CHIP: u16 = 0x20A;
    /// Option bytes (FLASH_OPTR).
    pub const OPTION_BYTES: u16 = 0x20B;
    /// Flags of the last reset (RCC_CSR).
    pub const RESET_CAUSE: u16 = 0x20C;
    /// Longest repetition of a reading of a Hall sensor in ticks, saturating at 255.
    pub const REPEATED_READINGS: u16 = 0x20D;
    /// Longest repetition of an angle of the rotor sensor in PWM periods, saturating.
    pub const REPEATED_ANGLES: u16 = 0x20E;
    /// Hall sensors with a constant configuration word, one bit each; deviations from it in the upper half.
    pub const CONFIGURATIONS: u16 = 0x20F;
    /// Samples, twenty a second, in which the supply of the chip was low or had switched the motor off.
    pub const LOW_SUPPLY: u16 = 0x210;
}

/// Identifiers; those of the sensors are consecutive.
pub mod id {
    /// See [`crate::parameters::Parameters::node`].
    pub const NODE: u16 = 0x01;
    /// See [`crate::parameters::Parameters::command_timeout_ms`].
    pub const COMMAND_TIMEOUT: u16 = 0x02;
    /// See [`crate::parameters::Parameters::backdrivability`].
    pub const SELF_LOCKING: u16 = 0x03;
    /// See [`crate::parameters::Parameters::force_rate_hz`].
    pub const FORCE_RATE: u16 = 0x10;
    /// See [`crate::parameters::Parameters::raw`].
    pub const RAW: u16 = 0x11;
    /// See [`crate::parameters::Parameters::ground_contact`].
    pub const FOOT: u16 = 0x12;
    /// See [`crate::parameters::Parameters::telemetry`].
    pub const TELEMETRY: u16 = 0x13;
    /// Torque constant of the motor.
    pub const TORQUE_CONSTANT: u16 = 0x14;
    /// Inertia of rotor and what turns with it.
    pub const INERTIA: u16 = 0x15;
    /// Dry friction without load.
    pub const DRY_FRICTION: u16 = 0x16;
    /// See [`crate::parameters::Parameters::is_on_bench`].
    pub const BENCH: u16 = 0x17;
    /// See [`crate::parameters::Parameters::settings`].
    pub const LEAD: u16 = 0x18;
    /// Pole pairs of the motor.
    pub const POLE_PAIRS: u16 = 0x19;
    /// Phase resistance.
    pub const RESISTANCE: u16 = 0x1A;
    /// Phase inductance.
    pub const INDUCTANCE: u16 = 0x1B;
    /// Electrical offset of the rotor sensor.
    pub const ROTOR_OFFSET: u16 = 0x1C;
    /// Exchange of phases V and W.
    pub const SWAPPED: u16 = 0x1D;
    /// Whether the motor's parameters were measured.
    pub const COMMISSIONED: u16 = 0x1E;
    /// Detectors that are on ([`super::detector`]).
    pub const DETECTORS: u16 = 0x1F;
    /// First sensor; see [`crate::parameters::Parameters::addresses`].
    pub const ADDRESS: u16 = 0x20;
    /// Fx of the first sensor, then Fz; see [`crate::parameters::Parameters::tare`].
    pub const TARE: u16 = 0x30;
}

/// Bits of [`id::DETECTORS`]: detectors whose thresholds only a board can confirm; a counter of [`counter`] decides each.
pub mod detector {
    /// Frozen Hall sensors, by [`super::counter::REPEATED_READINGS`].
    pub const FROZEN: i32 = 1;
    /// Stuck rotor sensor, by [`super::counter::REPEATED_ANGLES`].
    pub const STUCK: i32 = 2;
    /// Read-back of the Hall sensors' configuration, by [`super::counter::CONFIGURATIONS`].
    pub const CONFIGURATION: i32 = 4;
    /// Low supply of the chip as a break of the motor, by [`super::counter::LOW_SUPPLY`].
    pub const LOW_SUPPLY: i32 = 8;
    /// All of them.
    pub const ALL: i32 = 15;
}

/// Microohms in an ohm, and micronewton metres in a newton metre.
pub(super) const MICRO: f64 = 1e6;
/// 10^-9 kg m^2 in kg m^2.
pub(super) const NANO: f64 = 1e9;

/// Count of the parameters.
pub const COUNT: usize = 19 + SENSORS + 2 * SENSORS;

/// All parameters.
pub const PARAMETERS: [Parameter; COUNT] = {
    let [address_0, address_1, address_2, address_3] = GripperHallSensor::ADDRESSES;
    [
        Parameter {
            id: id::NODE,
            name: "node",
            unit: "",
            default: DEFAULT_NODE as i32,
            // Node 0 would own the identifier of the emergency stop.
            range: ValueRange::Between(1, 0x3F),
            affects_motion: true,
            description: "node number on the CAN bus; takes effect at the next boot",
        },
        Parameter {
            id: id::COMMAND_TIMEOUT,
            name: "command_timeout",
            unit: "ms",
            default: 100,
            range: ValueRange::Between(20, 500),
            affects_motion: true,
            description: "time without a command after which the gripper holds",
        },
        Parameter {
            id: id::SELF_LOCKING,
            name: "self_locking",
            unit: "",
            default: 0,
            range: ValueRange::Between(0, 2),
            affects_motion: true,
            description: "whether the screw is self-locking: 0 unknown, 1 yes, 2 no",
        },
        Parameter {
            id: id::FORCE_RATE,
            name: "force_rate",
            unit: "Hz",
            default: 100,
            range: ValueRange::OneOf(&[0, 100, 250, 500]),
            affects_motion: false,
            description: "rate of the force messages; 0: off",
        },
        switch(id::RAW, "raw", "raw readings on the CAN bus"),
        switch(id::FOOT, "foot", "ground contact messages on the CAN bus"),
        Parameter {
            default: 1,
            ..switch(id::TELEMETRY, "telemetry", "every tick on the serial line")
        },
        Parameter {
            id: id::LEAD,
            name: "lead",
            unit: "",
            default: 0,
            range: ValueRange::Between(0, 1),
            affects_motion: true,
            description: "lead of the screws: 0 fine (58.3 mm/s of the opening), 1 coarse (of each finger); takes effect at the next boot",
        },
        Parameter {
            id: id::POLE_PAIRS,
            name: "pole_pairs",
            unit: "",
            default: constants::POLE_PAIRS.value as i32,
            range: ValueRange::Between(1, 30),
            affects_motion: true,
            description: "pole pairs of the motor; measured by the device, takes effect at the next boot",
        },
        Parameter {
            id: id::RESISTANCE,
            name: "resistance",
            unit: "uohm",
            default: (constants::PHASE_RESISTANCE.value * MICRO) as i32,
            range: plausible(constants::PHASE_RESISTANCE.value * MICRO),
            affects_motion: true,
            description: "phase resistance; measured by the device, takes effect at the next boot",
        },
        Parameter {
            id: id::INDUCTANCE,
            name: "inductance",
            unit: "nH",
            default: (constants::PHASE_INDUCTANCE.value * 1e6) as i32,
            range: plausible(constants::PHASE_INDUCTANCE.value * 1e6),
            affects_motion: true,
            description: "phase inductance; measured by the device, takes effect at the next boot",
        },
        Parameter {
            id: id::ROTOR_OFFSET,
            name: "rotor_offset",
            unit: "2^-16 turns",
            default: 0,
            range: ValueRange::Between(0, 0xFFFF),
            affects_motion: true,
            description: "electrical offset of the rotor sensor; measured by the device, takes effect at the next boot",
        },
        Parameter {
            id: id::SWAPPED,
            description: "phases V and W are swapped; measured by the device, takes effect at the next boot",
            affects_motion: true,
            ..switch(id::SWAPPED, "swapped", "")
        },
        Parameter {
            id: id::COMMISSIONED,
            description: "the motor's parameters were measured by a calibration; else they are assumed",
            affects_motion: true,
            ..switch(id::COMMISSIONED, "commissioned", "")
        },
        Parameter {
            id: id::TORQUE_CONSTANT,
            name: "torque_constant",
            unit: "uN m/A",
            default: (constants::TORQUE_CONSTANT.value * MICRO) as i32,
            range: plausible(constants::TORQUE_CONSTANT.value * MICRO),
            affects_motion: true,
            description: "torque constant of the motor, along q; measured by the device, takes effect at the next boot",
        },
        Parameter {
            id: id::INERTIA,
            name: "inertia",
            unit: "1e-9 kg m^2",
            default: (constants::ROTOR_INERTIA.value * NANO) as i32,
            range: plausible(constants::ROTOR_INERTIA.value * NANO),
            affects_motion: true,
            description: "inertia of rotor, screws and coupling; measured by the device, takes effect at the next boot",
        },
        Parameter {
            id: id::DRY_FRICTION,
            name: "dry_friction",
            unit: "uN m",
            default: (constants::DRY_FRICTION.value * MICRO) as i32,
            range: ValueRange::Between(0, (constants::RATED_TORQUE.value * MICRO) as i32),
            affects_motion: true,
            description: "dry friction without load; measured by the device, takes effect at the next boot",
        },
        Parameter {
            id: id::BENCH,
            default: 1,
            description: "limits of the bench: supply from 10.5 V, 2 A, 10 mm/s, 20 N; the end of `magpie board bringup` removes them; takes effect at the next boot",
            affects_motion: true,
            ..switch(id::BENCH, "bench", "")
        },
        Parameter {
            id: id::DETECTORS,
            name: "detectors",
            unit: "",
            default: detector::ALL,
            range: ValueRange::Between(0, detector::ALL),
            affects_motion: true,
            description: "detectors that are on, the sum of: 1 frozen Hall sensors, 2 stuck rotor sensor, 4 changed configuration of a Hall sensor, 8 low 3.3 V as a break of the motor; takes effect at the next boot",
        },
        address(0, "address_0", address_0),
        address(1, "address_1", address_1),
        address(2, "address_2", address_2),
        address(3, "address_3", address_3),
        tare(0, "tare_0_x"),
        tare(1, "tare_0_z"),
        tare(2, "tare_1_x"),
        tare(3, "tare_1_z"),
        tare(4, "tare_2_x"),
        tare(5, "tare_2_z"),
        tare(6, "tare_3_x"),
        tare(7, "tare_3_z"),
    ]
};

/// Values that commissioning accepts: current control with others would oscillate.
const fn plausible(assumed: f64) -> ValueRange {
    ValueRange::Between(
        (assumed / MotorParameters::PLAUSIBLE_FACTOR as f64) as i32,
        (assumed * MotorParameters::PLAUSIBLE_FACTOR as f64) as i32,
    )
}

const fn switch(id: u16, name: &'static str, description: &'static str) -> Parameter {
    Parameter {
        id,
        name,
        unit: "",
        default: 0,
        range: ValueRange::Between(0, 1),
        affects_motion: false,
        description,
    }
}

const fn address(sensor: u16, name: &'static str, default: u8) -> Parameter {
    Parameter {
        id: id::ADDRESS + sensor,
        name,
        unit: "",
        default: default as i32,
        // The addresses at both ends are reserved by the bus.
        range: ValueRange::Between(0x08, 0x77),
        affects_motion: true,
        description: "7-bit address of the sensor on its bus; takes effect at the next boot",
    }
}

const fn tare(index: u16, name: &'static str) -> Parameter {
    Parameter {
        id: id::TARE + index,
        name,
        unit: "1/1024 N",
        default: 0,
        range: ValueRange::Between(-MAX_OFFSET.0, MAX_OFFSET.0),
        affects_motion: true,
        description: "offset subtracted from the force",
    }
}

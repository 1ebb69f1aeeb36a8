//! The table of parameters.

use crate::frame::SENSORS;
use crate::hall::Part;
use crate::hall::a31301::A31301;
use crate::params;
use crate::tare::GREATEST;
use crate::wire::DEFAULT_NODE;

/// One parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// Its identifier on the bus and in flash, for ever.
    pub id: u16,
    /// As it is called.
    pub name: &'static str,
    /// Unit of a count; empty for a plain number.
    pub unit: &'static str,
    /// Value if nobody gives another.
    pub default: i32,
    /// What it may be.
    pub range: Range,
    /// Whether motion depends on it: then it is not written while somebody is armed.
    pub moves: bool,
    /// What it is for.
    pub words: &'static str,
}

/// What a parameter may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Range {
    /// Anything from the least to the greatest.
    Between(i32, i32),
    /// One of these.
    OneOf(&'static [i32]),
}

impl Range {
    /// Whether the value is in it.
    pub fn holds(&self, value: i32) -> bool {
        match self {
            Self::Between(least, greatest) => (*least..=*greatest).contains(&value),
            Self::OneOf(choices) => choices.contains(&value),
        }
    }
}

/// What the device asks of a parameter: its texts stay out of the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rule {
    /// See [`Parameter::id`].
    pub id: u16,
    /// See [`Parameter::range`].
    pub range: Range,
    /// See [`Parameter::moves`].
    pub moves: bool,
}

/// Those of [`TABLE`], in its order.
pub static RULES: [Rule; COUNT] = {
    let none = Rule {
        id: 0,
        range: Range::OneOf(&[]),
        moves: false,
    };
    let mut rules = [none; COUNT];
    let (mut to, mut from): (&mut [Rule], &[Parameter]) = (&mut rules, &TABLE);
    while let (Some((rule, rules)), Some((row, others))) =
        (to.split_first_mut(), from.split_first())
    {
        *rule = Rule {
            id: row.id,
            range: row.range,
            moves: row.moves,
        };
        (to, from) = (rules, others);
    }
    rules
};

/// Where the parameter with this identifier stands; one that is none does not compile, in a constant.
pub const fn place_of(id: u16) -> usize {
    let (mut place, mut rest): (usize, &[Parameter]) = (0, &TABLE);
    while let Some((row, others)) = rest.split_first() {
        if row.id == id {
            return place;
        }
        (place, rest) = (place + 1, others);
    }
    assert!(place < COUNT, "no such parameter");
    place
}

/// Identifiers of counters since boot, which are read like parameters and cannot be written.
pub mod counter {
    /// Transfers from sensors that failed.
    pub const TRANSFERS_FAILED: u16 = 0x200;
    /// Ticks that were skipped.
    pub const TICKS_MISSED: u16 = 0x201;
    /// Frames and packets for this node that were refused: wrong tag, replayed, unknown.
    pub const FRAMES_REFUSED: u16 = 0x202;
    /// Packets on the serial line that could not be decoded.
    pub const PACKETS_BROKEN: u16 = 0x203;
    /// Frames and packets for which there was no time.
    pub const RECEIVE_OVERRUN: u16 = 0x204;
    /// Frames that no node acknowledged.
    pub const FRAMES_UNSENT: u16 = 0x205;
    /// Packets for which the serial line had no place.
    pub const PACKETS_UNSENT: u16 = 0x206;
}

/// Identifiers; those of the sensors stand behind each other.
pub mod id {
    /// See [`super::super::Parameters::node`].
    pub const NODE: u16 = 0x01;
    /// See [`super::super::Parameters::command_timeout_ms`].
    pub const COMMAND_TIMEOUT: u16 = 0x02;
    /// See [`super::super::Parameters::screw`].
    pub const SELF_LOCKING: u16 = 0x03;
    /// See [`super::super::Parameters::force_rate_hz`].
    pub const FORCE_RATE: u16 = 0x10;
    /// See [`super::super::Parameters::raw`].
    pub const RAW: u16 = 0x11;
    /// See [`super::super::Parameters::foot`].
    pub const FOOT: u16 = 0x12;
    /// See [`super::super::Parameters::telemetry`].
    pub const TELEMETRY: u16 = 0x13;
    /// See [`super::super::Parameters::settings`].
    pub const LEAD: u16 = 0x18;
    /// Likewise.
    pub const POLE_PAIRS: u16 = 0x19;
    /// Likewise.
    pub const RESISTANCE: u16 = 0x1A;
    /// Likewise.
    pub const INDUCTANCE: u16 = 0x1B;
    /// Likewise.
    pub const ROTOR_OFFSET: u16 = 0x1C;
    /// Likewise.
    pub const SWAPPED: u16 = 0x1D;
    /// Of the first sensor; see [`super::super::Parameters::addresses`].
    pub const ADDRESS: u16 = 0x20;
    /// Of the first sensor's Fx, then Fz; see [`super::super::Parameters::tare`].
    pub const TARE: u16 = 0x30;
}

/// How many parameters there are.
pub const COUNT: usize = 13 + SENSORS + 2 * SENSORS;

/// All parameters.
pub const TABLE: [Parameter; COUNT] = {
    let [address_0, address_1, address_2, address_3] = A31301::ADDRESSES;
    [
        Parameter {
            id: id::NODE,
            name: "node",
            unit: "",
            default: DEFAULT_NODE as i32,
            // Node 0 would own the identifier of the stop for all.
            range: Range::Between(1, 0x3F),
            moves: true,
            words: "number on the CAN bus; counts from the next start",
        },
        Parameter {
            id: id::COMMAND_TIMEOUT,
            name: "command_timeout",
            unit: "ms",
            default: 100,
            range: Range::Between(20, 500),
            moves: true,
            words: "without a command for this time the gripper holds",
        },
        Parameter {
            id: id::SELF_LOCKING,
            name: "self_locking",
            unit: "",
            default: 0,
            range: Range::Between(0, 2),
            moves: true,
            words: "whether the screw keeps its grip without current: 0 unknown, 1 yes, 2 no",
        },
        Parameter {
            id: id::FORCE_RATE,
            name: "force_rate",
            unit: "Hz",
            default: 100,
            range: Range::OneOf(&[0, 100, 250, 500]),
            moves: false,
            words: "rate of the force messages; 0: off",
        },
        switch(id::RAW, "raw", "raw readings on the CAN bus"),
        switch(id::FOOT, "foot", "messages of the foot on the CAN bus"),
        Parameter {
            default: 1,
            ..switch(id::TELEMETRY, "telemetry", "every tick on the serial line")
        },
        Parameter {
            id: id::LEAD,
            name: "lead",
            unit: "",
            default: 0,
            range: Range::Between(0, 1),
            moves: true,
            words: "the screws: 0 fine (58.3 mm/s of the opening), 1 coarse (of each finger); counts from the next start",
        },
        Parameter {
            id: id::POLE_PAIRS,
            name: "pole_pairs",
            unit: "",
            default: params::POLE_PAIRS.value as i32,
            range: Range::Between(1, 30),
            moves: true,
            words: "of the motor; measured by the device, counts from the next start",
        },
        Parameter {
            id: id::RESISTANCE,
            name: "resistance",
            unit: "uohm",
            default: (params::PHASE_RESISTANCE.value * 1e6) as i32,
            range: Range::Between(10_000, 10_000_000),
            moves: true,
            words: "of a phase; measured by the device, counts from the next start",
        },
        Parameter {
            id: id::INDUCTANCE,
            name: "inductance",
            unit: "nH",
            default: (params::PHASE_INDUCTANCE.value * 1e6) as i32,
            range: Range::Between(10_000, 10_000_000),
            moves: true,
            words: "of a phase; measured by the device, counts from the next start",
        },
        Parameter {
            id: id::ROTOR_OFFSET,
            name: "rotor_offset",
            unit: "2^-16 turns",
            default: 0,
            range: Range::Between(0, 0xFFFF),
            moves: true,
            words: "how the rotor's sensor sits, electrical; measured by the device, counts from the next start",
        },
        Parameter {
            id: id::SWAPPED,
            words: "phases V and W are swapped; measured by the device, counts from the next start",
            moves: true,
            ..switch(id::SWAPPED, "swapped", "")
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

const fn switch(id: u16, name: &'static str, words: &'static str) -> Parameter {
    Parameter {
        id,
        name,
        unit: "",
        default: 0,
        range: Range::Between(0, 1),
        moves: false,
        words,
    }
}

const fn address(sensor: u16, name: &'static str, default: u8) -> Parameter {
    Parameter {
        id: id::ADDRESS + sensor,
        name,
        unit: "",
        default: default as i32,
        // The bus keeps the addresses at both ends for itself.
        range: Range::Between(0x08, 0x77),
        moves: true,
        words: "7-bit address of the sensor on its bus; counts from the next start",
    }
}

const fn tare(place: u16, name: &'static str) -> Parameter {
    Parameter {
        id: id::TARE + place,
        name,
        unit: "1/1024 N",
        default: 0,
        range: Range::Between(-GREATEST.0, GREATEST.0),
        moves: true,
        words: "taken off the force",
    }
}

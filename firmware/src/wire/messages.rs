//! The table of messages: from it come the bytes on the bus, the `.dbc` that other tools read, and the
//! enum that travels over the serial line.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::layout::{Direction, Field, Layout, Malformed, Raw, put, take};

/// Bytes of every frame.
pub const BYTES: usize = 8;

/// On the serial line: the number and the same eight bytes as on the bus.
impl Serialize for Message {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        (self.number(), self.to_bytes()).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Message {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (number, bytes) = <(u8, [u8; BYTES])>::deserialize(deserializer)?;
        Self::from_frame(number, &bytes).map_err(|_| D::Error::custom("no message"))
    }
}

/// Declares messages: number (and copies), name, direction, period, then fields with their bits and what
/// one count means.
macro_rules! messages {
    ($(
        $(#[doc = $words:literal])+
        $number:literal $(($copies:literal sensors))? $name:ident $direction:ident every $period:literal
        $(multiplexed by $by:ident)? {
            $(
                $(#[doc = $about:literal])+
                $field:ident: $type:ident @ $first:literal .. $end:literal $(, $scale:literal $unit:literal)?;
            )*
        }
    )*) => {
        $(
            $(#[doc = $words])+
            #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
            pub struct $name {
                $($(#[doc = $about])+ pub $field: $type,)*
            }

            impl $name {
                /// Where it lies on the bus.
                pub const LAYOUT: Layout = Layout {
                    name: stringify!($name),
                    number: $number,
                    copies: { let copies = 1; $(let copies = { let _ = copies; $copies };)? copies },
                    direction: Direction::$direction,
                    period_ms: $period,
                    multiplexed: { let by = ""; $(let by = { let _ = by; stringify!($by) };)? !by.is_empty() },
                    fields: &[$(Field {
                        name: stringify!($field),
                        first: $first,
                        end: $end,
                        signed: <$type as Raw>::SIGNED,
                        scale: { let scale = 1.0; $(let scale = { let _ = scale; $scale };)? scale },
                        unit: { let unit = ""; $(let unit = { let _ = unit; $unit };)? unit },
                        words: concat!($($about, "\n"),+),
                    },)*],
                    words: concat!($($words, "\n"),+),
                };

                /// The eight bytes; what does not fit a field stays at the end of its range.
                pub fn to_bytes(&self) -> [u8; BYTES] {
                    let frame = 0_u64 $(| put($first..$end, self.$field))*;
                    frame.to_le_bytes()
                }

                /// The message in eight bytes.
                ///
                /// # Errors
                /// A bit is set that no field owns.
                pub fn from_bytes(bytes: [u8; BYTES]) -> Result<Self, Malformed> {
                    let frame = u64::from_le_bytes(bytes);
                    match frame & !const { Self::LAYOUT.used() } {
                        0 => Ok(Self { $($field: take(frame, $first..$end),)* }),
                        _ => Err(Malformed::Reserved),
                    }
                }
            }

            const _: () = assert!($name::LAYOUT.is_sound());
        )*

        /// Any message.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Message {
            $(
                $(#[doc = $words])+
                $name($name),
            )*
        }

        impl Message {
            /// Where it lies on the bus.
            pub const fn layout(&self) -> &'static Layout {
                match self {
                    $(Self::$name(_) => &$name::LAYOUT,)*
                }
            }

            /// The number of its layout. Of what the layout says, the image holds no more than it asks
            /// for: here, in the two that follow, and in constants.
            pub const fn number(&self) -> u8 {
                match self {
                    $(Self::$name(_) => const { $name::LAYOUT.number },)*
                }
            }

            /// How many copies its layout has.
            pub const fn copies(&self) -> u8 {
                match self {
                    $(Self::$name(_) => const { $name::LAYOUT.copies },)*
                }
            }

            /// Who sends it.
            pub const fn direction(&self) -> Direction {
                match self {
                    $(Self::$name(_) => const { $name::LAYOUT.direction },)*
                }
            }

            /// Its eight bytes.
            pub fn to_bytes(&self) -> [u8; BYTES] {
                match self {
                    $(Self::$name(message) => message.to_bytes(),)*
                }
            }

            /// The message with this number in the bytes of a frame.
            ///
            /// # Errors
            /// Nobody knows the number, a frame that is not eight bytes, or a bit that no field owns.
            pub fn from_frame(number: u8, bytes: &[u8]) -> Result<Self, Malformed> {
                let whole = bytes.try_into();
                let bytes: [u8; BYTES] = whole.unwrap_or_default();
                $(
                    if const { $name::LAYOUT.numbers() }.contains(&number) {
                        whole.map_err(|_| Malformed::Length)?;
                        return $name::from_bytes(bytes).map(Self::$name);
                    }
                )*
                Err(Malformed::Unknown)
            }
        }

        /// All messages, by number.
        pub const LAYOUTS: &[Layout] = &[$($name::LAYOUT,)*];

        /// The numbers of a host's messages, a bit each.
        const FROM_HOST: u32 = 0 $(| $name::LAYOUT.from_host())*;

        /// Whether a host sends messages with this number.
        pub const fn is_from_host(number: u8) -> bool {
            number < 32 && FROM_HOST & 1 << number != 0
        }
    };
}

messages! {
    /// What runs on the gripper: at boot and on request.
    0x00 Version Out every 0 {
        /// Version of these messages: another major number is another language.
        protocol_major: u8 @ 0..8;
        /// Grows with every message that is added.
        protocol_minor: u8 @ 8..16;
        /// Version of the firmware.
        firmware_major: u8 @ 16..24;
        /// Version of the firmware.
        firmware_minor: u8 @ 24..32;
        /// Version of the firmware.
        firmware_patch: u8 @ 32..40;
        /// Which board file it was built with.
        hardware: u8 @ 40..48;
        /// Identifier of the model's tables.
        tables: u16 @ 48..64;
    }

    /// The gripper lives.
    0x01 Heartbeat Out every 100 {
        /// Active faults, one bit each.
        faults: u32 @ 0..32;
        /// State of the state machine.
        state: u8 @ 32..40;
        /// 0 moving, 1 contact while opening, 2 contact while closing, 3 at position.
        object: u8 @ 40..42;
        /// Whether commands arrive in time.
        command_alive: bool @ 42..43;
        /// Sensors that answer, one bit each.
        sensors_ok: u8 @ 43..47;
        /// Version of these messages.
        protocol_major: u8 @ 48..56;
        /// Counts heartbeats.
        counter: u8 @ 56..64;
    }

    /// Stop at once, whoever sends it.
    0x02 EStop In every 0 {}

    /// What to do; without one for 100 ms the gripper holds.
    0x03 Command In every 50 {
        /// Mode asked for.
        mode: u8 @ 0..4;
        /// Goes on by one with every command.
        counter: u8 @ 4..8;
        /// Opening asked for.
        position: u16 @ 8..20, 0.05 "mm";
        /// Greatest speed.
        speed: u8 @ 20..28, 0.25 "mm/s";
        /// Greatest force.
        force: u16 @ 28..40, 0.1 "N";
        /// Flags of the mode.
        flags: u8 @ 40..48;
        /// Checksum over nonce, identifier and the bytes before it.
        crc: u16 @ 48..64;
    }

    /// A service: clear faults, tare, save, reboot, arm.
    0x04 Service In every 0 {
        /// Which one.
        op: u8 @ 0..8;
        /// A fixed number, so that a stray frame starts nothing.
        magic: u16 @ 8..24;
        /// The number that the gripper gave, where the service asks for one.
        nonce: u16 @ 24..40;
        /// Argument of the service.
        argument: u32 @ 40..64;
    }

    /// Reads or writes a parameter.
    0x05 ParamRequest In every 0 {
        /// 0 reads, 1 writes.
        op: u8 @ 0..8;
        /// Which parameter.
        id: u16 @ 8..24;
        /// Zero.
        status: u8 @ 24..32;
        /// Value to write.
        value: u32 @ 32..64;
    }

    /// The answer to a request.
    0x06 ParamReply Out every 0 {
        /// As asked.
        op: u8 @ 0..8;
        /// As asked.
        id: u16 @ 8..24;
        /// 0: done; else why not.
        status: u8 @ 24..32;
        /// Value now.
        value: u32 @ 32..64;
    }

    /// A fault comes or goes.
    0x07 FaultEvent Out every 0 {
        /// Which fault.
        code: u16 @ 0..16;
        /// Which sensor, bus or task.
        source: u8 @ 16..24;
        /// 1 where it comes, 0 where it goes.
        active: u8 @ 24..32;
        /// What was measured.
        detail: u32 @ 32..64;
    }

    /// The forces at one sensor.
    0x08 (4 sensors) Force Out every 10 {
        /// Lateral force.
        fx: i16 @ 0..16, 0.05 "N";
        /// Longitudinal force.
        fz: i16 @ 16..32, 0.05 "N";
        /// Standard deviation of the lateral force; 255: unknown.
        sigma_x: u8 @ 32..40, 0.25 "N";
        /// Standard deviation of the longitudinal force; 255: unknown.
        sigma_z: u8 @ 40..48, 0.25 "N";
        /// The forces may be used.
        valid: bool @ 48..49;
        /// A foreign magnet is near.
        disturbed: bool @ 49..50;
        /// An axis is at the end of its range.
        saturated: bool @ 50..51;
        /// No new reading.
        stale: bool @ 51..52;
        /// 0 the ideal model, 1 a network.
        model: u8 @ 52..54;
        /// Counts messages.
        counter: u8 @ 56..64;
    }

    /// The grip.
    0x0C GripStatus Out every 10 {
        /// Opening.
        position: u16 @ 0..14, 0.01 "mm";
        /// Speed, opening is positive.
        speed: i16 @ 14..28, 0.01 "mm/s";
        /// Grasping force.
        force: i16 @ 28..42, 0.1 "N";
        /// Current that makes torque.
        current: i16 @ 42..54, 0.01 "A";
        /// 0 moving, 1 contact while opening, 2 contact while closing, 3 at position.
        object: u8 @ 54..56;
        /// Counts messages.
        counter: u8 @ 56..60;
    }

    /// Supply and temperatures.
    0x0D Power Out every 100 {
        /// Voltage of the supply.
        bus: u16 @ 0..16, 0.01 "V";
        /// Current from the supply.
        current: i16 @ 16..32, 0.01 "A";
        /// Temperature of the microcontroller.
        mcu: i8 @ 32..40, 1.0 "degC";
        /// Temperature of the motor.
        motor: i8 @ 40..48, 1.0 "degC";
        /// Temperature of the warmest Hall sensor.
        sensor: i8 @ 48..56, 1.0 "degC";
        /// Counts messages.
        counter: u8 @ 56..64;
    }

    /// A raw reading; off if nobody asks for it.
    0x0E HallRaw Out every 0 multiplexed by sensor {
        /// Which sensor.
        sensor: u8 @ 0..2;
        /// Field along x in counts.
        x: i16 @ 2..17;
        /// Field along y in counts.
        y: i16 @ 17..32;
        /// Field along z in counts.
        z: i16 @ 32..47;
        /// Temperature in counts.
        temperature: i16 @ 47..59;
    }

    /// How busy the gripper is.
    0x0F Timing Out every 1000 {
        /// Longest tick of sensing in the last second.
        worst_loop: u16 @ 0..16, 1.0 "us";
        /// Longest estimate in the last second.
        worst_inference: u16 @ 16..32, 1.0 "us";
        /// Transfers from the sensors that failed since boot.
        i2c_errors: u16 @ 32..48;
        /// Ticks that were missed since boot.
        missed_ticks: u8 @ 48..56;
        /// Counts messages.
        counter: u8 @ 56..64;
    }

    /// The gripper as a foot; off if nobody asks for it.
    0x10 Foot Out every 0 {
        /// Fingertips that touch, one bit each.
        contacts: u8 @ 0..8;
        /// Sum of the longitudinal forces.
        total_fz: i16 @ 8..24, 0.1 "N";
        /// Centre of pressure along the line of contact.
        centre: i16 @ 24..40, 0.01 "mm";
        /// Standard deviation of the sum; 255: unknown.
        sigma: u8 @ 40..48, 0.25 "N";
        /// Counts messages.
        counter: u8 @ 48..56;
    }

    /// The answer to a service.
    0x11 ServiceReply Out every 0 {
        /// Which service.
        op: u8 @ 0..8;
        /// 0 done, 1 say this nonce, else why not.
        status: u8 @ 8..16;
        /// The number to say back.
        nonce: u16 @ 16..32;
        /// Detail of the service.
        detail: u32 @ 32..64;
    }
}

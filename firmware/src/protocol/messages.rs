//! Definition of the messages: source of the encoding on the bus, of the `.dbc`, and of the enum on the serial line.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::protocol::layout::{
    Direction, FrameError, MessageLayout, SignalLayout, SignalValue, decode, encode,
};

/// Length of every frame.
pub const BYTES: usize = 8;

/// On the serial line: number and data as on the bus.
impl Serialize for Message {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        (self.number(), self.to_bytes()).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Message {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (number, bytes) = <(u8, [u8; BYTES])>::deserialize(deserializer)?;
        Self::from_frame(number, &bytes).map_err(|_| D::Error::custom("invalid message"))
    }
}

/// Declares messages: number (and instances), name, direction, period, then signals with their bits and scale.
macro_rules! messages {
    ($(
        $(#[doc = $description:literal])+
        $number:literal $(($instances:literal sensors))? $name:ident $direction:ident every $period:literal
        $(multiplexed by $by:ident)? {
            $(
                $(#[doc = $comment:literal])+
                $field:ident: $type:ident @ $first:literal .. $end:literal $(, $scale:literal $unit:literal)?;
            )*
        }
    )*) => {
        $(
            $(#[doc = $description])+
            #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
            pub struct $name {
                $($(#[doc = $comment])+ pub $field: $type,)*
            }

            impl $name {
                /// Layout on the bus.
                pub const LAYOUT: MessageLayout = MessageLayout {
                    name: stringify!($name),
                    number: $number,
                    instances: { let instances = 1; $(let instances = { let _ = instances; $instances };)? instances },
                    direction: Direction::$direction,
                    period_ms: $period,
                    multiplexed: { let by = ""; $(let by = { let _ = by; stringify!($by) };)? !by.is_empty() },
                    signals: &[$(SignalLayout {
                        name: stringify!($field),
                        first_bit: $first,
                        end_bit: $end,
                        signed: <$type as SignalValue>::SIGNED,
                        scale: { let scale = 1.0; $(let scale = { let _ = scale; $scale };)? scale },
                        unit: { let unit = ""; $(let unit = { let _ = unit; $unit };)? unit },
                        description: concat!($($comment, "\n"),+),
                    },)*],
                    description: concat!($($description, "\n"),+),
                };

                /// Encodes the message; values saturate.
                pub fn to_bytes(&self) -> [u8; BYTES] {
                    let frame = 0_u64 $(| encode($first..$end, self.$field))*;
                    frame.to_le_bytes()
                }

                /// Decodes the message.
                ///
                /// # Errors
                /// A reserved bit is set.
                pub fn from_bytes(bytes: [u8; BYTES]) -> Result<Self, FrameError> {
                    let frame = u64::from_le_bytes(bytes);
                    match frame & !const { Self::LAYOUT.used() } {
                        0 => Ok(Self { $($field: decode(frame, $first..$end),)* }),
                        _ => Err(FrameError::Reserved),
                    }
                }
            }

            const _: () = assert!($name::LAYOUT.is_valid());
        )*

        /// Any message.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Message {
            $(
                $(#[doc = $description])+
                $name($name),
            )*
        }

        impl Message {
            /// Layout on the bus.
            pub const fn layout(&self) -> &'static MessageLayout {
                match self {
                    $(Self::$name(_) => &$name::LAYOUT,)*
                }
            }

            /// Number of the layout. Constants here and in the next two functions keep the other fields of the layouts out of the
            /// image.
            pub const fn number(&self) -> u8 {
                match self {
                    $(Self::$name(_) => const { $name::LAYOUT.number },)*
                }
            }

            /// Count of instances of the layout.
            pub const fn instances(&self) -> u8 {
                match self {
                    $(Self::$name(_) => const { $name::LAYOUT.instances },)*
                }
            }

            /// Sender.
            pub const fn direction(&self) -> Direction {
                match self {
                    $(Self::$name(_) => const { $name::LAYOUT.direction },)*
                }
            }

            /// Encodes the message.
            pub fn to_bytes(&self) -> [u8; BYTES] {
                match self {
                    $(Self::$name(message) => message.to_bytes(),)*
                }
            }

            /// Decodes the message with this number.
            ///
            /// # Errors
            /// Unknown number, not eight bytes, or a reserved bit is set.
            pub fn from_frame(number: u8, bytes: &[u8]) -> Result<Self, FrameError> {
                let whole = bytes.try_into();
                let bytes: [u8; BYTES] = whole.unwrap_or_default();
                $(
                    if const { $name::LAYOUT.numbers() }.contains(&number) {
                        whole.map_err(|_| FrameError::Length)?;
                        return $name::from_bytes(bytes).map(Self::$name);
                    }
                )*
                Err(FrameError::Unknown)
            }
        }

        /// All messages, by number.
        pub const LAYOUTS: &[MessageLayout] = &[$($name::LAYOUT,)*];

        /// Bit mask of the numbers of host messages.
        const FROM_HOST: u32 = 0 $(| $name::LAYOUT.from_host())*;

        /// Whether messages with this number are sent by hosts.
        pub const fn is_from_host(number: u8) -> bool {
            number < 32 && FROM_HOST & 1 << number != 0
        }
    };
}

messages! {
    /// Authentication of the next message of the same sender that needs one. Its identifier is below those of all requests:
    /// a controller that sends the lowest identifier first does not exchange the two.
    0x00 Authentication In every 0 {
        /// Lower 24 bits of the freshness counter.
        counter: u32 @ 0..24;
        /// First four bytes of the code, little-endian.
        tag_low: u32 @ 24..56;
        /// Its last byte.
        tag_high: u8 @ 56..64;
    }

    /// Heartbeat.
    0x01 Heartbeat Out every 100 {
        /// Active faults, one bit each.
        faults: u32 @ 0..32;
        /// State of the state machine.
        state: u8 @ 32..39;
        /// A stop is latched: nothing moves until it is cleared at rest.
        stopped: bool @ 39..40;
        /// 0 moving, 1 contact while opening, 2 contact while closing, 3 at position.
        object: u8 @ 40..42;
        /// Whether commands arrive in time.
        command_alive: bool @ 42..43;
        /// Sensors with valid readings, one bit each.
        sensors_ok: u8 @ 43..47;
        /// No key is stored: everybody on the bus may open a session.
        unprotected: bool @ 47..48;
        /// Major version of the messages.
        protocol_major: u8 @ 48..56;
        /// Counts heartbeats.
        counter: u8 @ 56..64;
    }

    /// Emergency stop, accepted from any sender.
    0x02 EStop In every 0 {}

    /// Command, authenticated; without one for 100 ms the gripper holds.
    0x03 Command In every 50 {
        /// Mode.
        mode: u8 @ 0..4;
        /// Set-point of the opening.
        position: u16 @ 8..20, 0.05 "mm";
        /// Speed limit.
        speed: u8 @ 20..28, 0.25 "mm/s";
        /// Force limit.
        force: u16 @ 28..40, 0.1 "N";
        /// Flags of the mode.
        flags: u8 @ 40..48;
    }

    /// Service request: sessions, clear faults, tare, save, reboot, calibrations; mostly authenticated.
    0x04 Service In every 0 {
        /// Operation.
        op: u8 @ 0..8;
        /// Argument of the operation.
        argument: u32 @ 8..40;
    }

    /// Request to read or write a parameter; writing is authenticated.
    0x05 ParamRequest In every 0 {
        /// 0 reads, 1 writes.
        op: u8 @ 0..8;
        /// Identifier of the parameter.
        id: u16 @ 8..24;
        /// Zero.
        status: u8 @ 24..32;
        /// Value to write.
        value: u32 @ 32..64;
    }

    /// Reply to a parameter request.
    0x06 ParamReply Out every 0 {
        /// As in the request.
        op: u8 @ 0..8;
        /// As in the request.
        id: u16 @ 8..24;
        /// 0: done; else the reason of the failure.
        status: u8 @ 24..32;
        /// Present value.
        value: u32 @ 32..64;
    }

    /// A fault is set or cleared.
    0x07 FaultEvent Out every 0 {
        /// Code of the fault.
        code: u16 @ 0..16;
        /// Sensor, bus or task.
        source: u8 @ 16..24;
        /// 1: set, 0: cleared.
        active: u8 @ 24..32;
        /// Detail of the fault.
        detail: u32 @ 32..64;
    }

    /// Forces at one sensor.
    0x08 (4 sensors) Force Out every 10 {
        /// Lateral force.
        fx: i16 @ 0..16, 0.05 "N";
        /// Longitudinal force.
        fz: i16 @ 16..32, 0.05 "N";
        /// Standard deviation of the lateral force; 255: unknown.
        sigma_x: u8 @ 32..40, 0.25 "N";
        /// Standard deviation of the longitudinal force; 255: unknown.
        sigma_z: u8 @ 40..48, 0.25 "N";
        /// Whether the forces are valid.
        valid: bool @ 48..49;
        /// Magnetic disturbance.
        disturbed: bool @ 49..50;
        /// An axis is saturated.
        saturated: bool @ 50..51;
        /// No new reading.
        stale: bool @ 51..52;
        /// 0: ideal model, 1: network.
        model: u8 @ 52..54;
        /// An effect is not compensated for lack of an input.
        missing_inputs: bool @ 54..55;
        /// Counts messages.
        counter: u8 @ 56..64;
    }

    /// State of the grip.
    0x0C GripStatus Out every 10 {
        /// Opening; 16383: unknown, before homing.
        position: u16 @ 0..14, 0.01 "mm";
        /// Speed, opening is positive.
        speed: i16 @ 14..28, 0.01 "mm/s";
        /// Grasping force.
        force: i16 @ 28..42, 0.1 "N";
        /// Quadrature current.
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
        /// Temperature of the microcontroller; -128: unknown.
        mcu: i8 @ 32..40, 1.0 "degC";
        /// Temperature of the motor; -128: unknown.
        motor: i8 @ 40..48, 1.0 "degC";
        /// Temperature of the warmest Hall sensor; -128: unknown.
        sensor: i8 @ 48..56, 1.0 "degC";
        /// Counts messages.
        counter: u8 @ 56..64;
    }

    /// Raw reading of a sensor; off by default.
    0x0E HallRaw Out every 0 multiplexed by sensor {
        /// Sensor.
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

    /// Execution times.
    0x0F Timing Out every 1000 {
        /// Longest tick of sensing in the last second.
        worst_loop: u16 @ 0..16, 1.0 "us";
        /// Longest estimate in the last second.
        worst_inference: u16 @ 16..32, 1.0 "us";
        /// Failed transfers from the sensors since boot.
        i2c_errors: u16 @ 32..48;
        /// Missed ticks since boot.
        missed_ticks: u8 @ 48..56;
        /// Counts messages.
        counter: u8 @ 56..64;
    }

    /// Ground contact; off by default.
    0x10 Foot Out every 0 {
        /// Fingertips with ground contact, one bit each.
        contacts: u8 @ 0..8;
        /// Sum of the longitudinal forces.
        total_fz: i16 @ 8..24, 0.1 "N";
        /// Centre of pressure along the fingers.
        centre: i16 @ 24..40, 0.01 "mm";
        /// Standard deviation of the sum; 255: unknown.
        sigma: u8 @ 40..48, 0.25 "N";
        /// Counts messages.
        counter: u8 @ 48..56;
        /// Centre of pressure across the fingers, from the left to the right; -64: unknown, before homing.
        across: i8 @ 56..64, 0.5 "mm";
    }

    /// Reply to a service request.
    0x11 ServiceReply Out every 0 {
        /// Operation.
        op: u8 @ 0..8;
        /// 0: done, 1: a challenge, else the reason of the failure.
        status: u8 @ 8..16;
        /// Upper 16 bits of the challenge; in the reply to a request for the description: its argument.
        extra: u16 @ 16..32;
        /// Detail of the operation; lower 32 bits of the challenge.
        detail: u32 @ 32..64;
    }

    /// Orientation of the gripper from gripper to world axes, as a host knows it: rotations about x, then y, then z.
    0x12 HostAttitude In every 0 {
        /// Roll; ignored where the gripper has an inertial sensor.
        roll: i16 @ 0..16, 0.0001 "rad";
        /// Pitch; ignored where the gripper has an inertial sensor.
        pitch: i16 @ 16..32, 0.0001 "rad";
        /// Yaw.
        yaw: i16 @ 32..48, 0.0001 "rad";
        /// Age of the measurement when the message was sent.
        age: u8 @ 48..56, 1.0 "ms";
        /// Roll and pitch are not known to the host.
        yaw_only: bool @ 56..57;
    }

    /// Acceleration of the gripper without gravity, in gripper axes, as a host knows it.
    0x13 HostAcceleration In every 0 {
        /// Along x.
        x: i16 @ 0..16, 0.002 "m/s^2";
        /// Along y.
        y: i16 @ 16..32, 0.002 "m/s^2";
        /// Along z.
        z: i16 @ 32..48, 0.002 "m/s^2";
        /// Age of the measurement when the message was sent.
        age: u8 @ 48..56, 1.0 "ms";
    }

    /// Part of a calibration during an upload.
    0x14 CalibrationChunk In every 0 {
        /// Number of the chunk, from 0.
        number: u16 @ 0..16;
        /// First four of six bytes, little-endian.
        low: u32 @ 16..48;
        /// The other two.
        high: u16 @ 48..64;
    }

    /// Versions of protocol, firmware, hardware and tables; sent at boot and on request.
    0x15 Version Out every 0 {
        /// Major version of the messages; different ones are incompatible.
        protocol_major: u8 @ 0..8;
        /// Minor version of the messages; incremented with every new message.
        protocol_minor: u8 @ 8..16;
        /// Version of the firmware.
        firmware_major: u8 @ 16..24;
        /// Version of the firmware.
        firmware_minor: u8 @ 24..32;
        /// Version of the firmware.
        firmware_patch: u8 @ 32..40;
        /// Identifier of the board.
        hardware: u8 @ 40..48;
        /// Identifier of the model tables.
        tables: u16 @ 48..64;
    }

    /// Part of a new key, on the serial line only.
    0x16 KeyPart In every 0 {
        /// Number of the part, from 0.
        number: u8 @ 0..8;
        /// Four bytes, little-endian.
        part: u32 @ 8..40;
    }
}

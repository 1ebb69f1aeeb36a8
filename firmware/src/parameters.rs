//! What a host may change at run time: one table of parameters, read and written one at a time
//! ([`answer`]), kept in flash together ([`crate::store`]).
//!
//! On the bus a value is the 32 bits of an `i32`. Values beyond a parameter's range are refused, never
//! bent into it. What motion depends on is written only while nobody is armed.

pub mod table;

use crate::frame::SENSORS;
use crate::hall::Part;
use crate::hall::a31301::A31301;
use crate::motor;
use crate::motor::calibration::Outcome;
use crate::motor::settings::{Settings, Wiring};
use crate::tare::{GREATEST, Tare};
use crate::units::Force;
use crate::wire::messages::{ParamReply, ParamRequest};
use table::{COUNT, Parameter, RULES, TABLE, id, place_of};

/// Microohms in an ohm.
const UOHM: f32 = 1e6;
/// From 2^-32 turns to the parameter's 2^-16: five thousandths of a degree.
const OFFSET_SHIFT: u32 = 16;
/// Nanohenries in a henry.
const NH: f32 = 1e9;

/// What a request asks for.
pub mod op {
    /// The value.
    pub const READ: u8 = 0;
    /// To take another.
    pub const WRITE: u8 = 1;
}

/// What a reply says.
pub mod status {
    /// Done.
    pub const DONE: u8 = 0;
    /// No parameter has this identifier; see [`super::table::TABLE`].
    pub const UNKNOWN: u8 = 1;
    /// The value is beyond the parameter's range; nothing has changed.
    pub const OUT_OF_RANGE: u8 = 2;
    /// Motion depends on it and somebody is armed; nothing has changed.
    pub const ARMED: u8 = 3;
    /// Neither reads nor writes.
    pub const NO_SUCH_OP: u8 = 4;
    /// It is a counter, which is read only.
    pub const READ_ONLY: u8 = 5;
}

/// Whether the screw holds its load without current.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Screw {
    /// Nobody has tried: what is safe for both holds.
    Unknown,
    /// It keeps its grip.
    SelfLocking,
    /// The load turns it back.
    BackDriven,
}

/// The values of all parameters, each in its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameters {
    /// In the order of [`TABLE`].
    values: [i32; COUNT],
}

impl Parameters {
    /// If nobody gives others.
    pub const DEFAULT: Self = {
        let mut values = [0; COUNT];
        let (mut to, mut from): (&mut [i32], &[Parameter]) = (&mut values, &TABLE);
        while let (Some((value, values)), Some((parameter, others))) =
            (to.split_first_mut(), from.split_first())
        {
            *value = parameter.default;
            (to, from) = (values, others);
        }
        Self { values }
    };

    /// Every identifier with its value.
    pub fn all(&self) -> impl Iterator<Item = (u16, i32)> {
        RULES.iter().map(|rule| rule.id).zip(self.values)
    }

    /// The value of the parameter with this identifier, if there is one.
    pub fn get(&self, id: u16) -> Option<i32> {
        self.all()
            .find_map(|(known, value)| (known == id).then_some(value))
    }

    /// The value of a parameter of the table.
    fn value<const ID: u16>(&self) -> i32 {
        let value = self.values.get(const { place_of(ID) });
        value.copied().unwrap_or_default()
    }

    /// Takes a value.
    ///
    /// # Errors
    /// [`status::UNKNOWN`] or [`status::OUT_OF_RANGE`]; then nothing has changed.
    pub fn set(&mut self, id: u16, value: i32) -> Result<(), u8> {
        let mut rows = RULES.iter().zip(&mut self.values);
        let (rule, place) = rows
            .find(|(rule, _)| rule.id == id)
            .ok_or(status::UNKNOWN)?;
        if !rule.range.holds(value) {
            return Err(status::OUT_OF_RANGE);
        }
        *place = value;
        Ok(())
    }

    /// Number on the CAN bus, for [`crate::wire::identifier`] and [`crate::session::Session::new`].
    pub fn node(&self) -> u16 {
        self.value::<{ id::NODE }>() as u16
    }

    /// Without a command for this time the gripper holds.
    pub fn command_timeout_ms(&self) -> u32 {
        self.value::<{ id::COMMAND_TIMEOUT }>() as u32
    }

    /// Rate of the force messages; 0: off.
    pub fn force_rate_hz(&self) -> u32 {
        self.value::<{ id::FORCE_RATE }>() as u32
    }

    /// Whether raw readings are sent on the CAN bus.
    pub fn raw(&self) -> bool {
        self.value::<{ id::RAW }>() == 1
    }

    /// Whether the foot's messages are sent.
    pub fn foot(&self) -> bool {
        self.value::<{ id::FOOT }>() == 1
    }

    /// Whether every tick is sent on the serial line.
    pub fn telemetry(&self) -> bool {
        self.value::<{ id::TELEMETRY }>() == 1
    }

    /// What the motor's control is set to.
    pub fn settings(&self) -> Settings {
        let mut settings = Settings::assumed(match self.value::<{ id::LEAD }>() {
            1 => motor::screw::Screw::B,
            _ => motor::screw::Screw::A,
        });
        let machine = &mut settings.machine;
        machine.pole_pairs = self.value::<{ id::POLE_PAIRS }>() as u8;
        machine.resistance_ohm = self.value::<{ id::RESISTANCE }>() as f32 / UOHM;
        machine.inductance_h = self.value::<{ id::INDUCTANCE }>() as f32 / NH;
        settings.wiring = Wiring {
            offset: (self.value::<{ id::ROTOR_OFFSET }>() as u32) << OFFSET_SHIFT,
            is_swapped: self.value::<{ id::SWAPPED }>() == 1,
        };
        settings
    }

    /// Takes what the device has measured of its motor, or of its screw; what is beyond a range is not taken.
    pub fn set_measured(&mut self, outcome: &Outcome) {
        match *outcome {
            Outcome::Motor(found) => {
                for (id, value) in [
                    (id::POLE_PAIRS, i32::from(found.pole_pairs)),
                    (id::RESISTANCE, (found.resistance_ohm * UOHM) as i32),
                    (id::INDUCTANCE, (found.inductance_h * NH) as i32),
                    (
                        id::ROTOR_OFFSET,
                        (found.wiring.offset >> OFFSET_SHIFT) as i32,
                    ),
                    (id::SWAPPED, i32::from(found.wiring.is_swapped)),
                ] {
                    // Plausible values are in their ranges.
                    let _ = self.set(id, value);
                }
            }
            Outcome::Screw { locks } => {
                let _ = self.set(id::SELF_LOCKING, if locks { 1 } else { 2 });
            }
            Outcome::Failed(_) => {}
        }
    }

    /// Whether the screw holds its load without current.
    pub fn screw(&self) -> Screw {
        match self.value::<{ id::SELF_LOCKING }>() {
            1 => Screw::SelfLocking,
            2 => Screw::BackDriven,
            _ => Screw::Unknown,
        }
    }

    /// 7-bit addresses of the sensors.
    pub fn addresses(&self) -> [u8; SENSORS] {
        let mut id = id::ADDRESS..;
        A31301::ADDRESSES.map(|default| {
            let stated = id.next().and_then(|id| self.get(id));
            stated.map_or(default, |address| address as u8)
        })
    }

    /// What is taken off the forces.
    pub fn tare(&self) -> Tare {
        let tare = self.values.get(const { place_of(id::TARE) }..);
        let mut values = tare.unwrap_or_default().iter().copied();
        Tare(
            [[(); 2]; SENSORS]
                .map(|forces| forces.map(|()| Force(values.next().unwrap_or_default()))),
        )
    }

    /// Takes a tare; what is beyond the range stays at its end.
    pub fn set_tare(&mut self, tare: &Tare) {
        for (id, force) in (id::TARE..).zip(tare.0.as_flattened()) {
            // An identifier of the table and a value in its range: there is nothing to refuse.
            let _ = self.set(id, force.0.clamp(-GREATEST.0, GREATEST.0));
        }
    }
}

/// The answer to a host's request, and what it changes. `is_armed` is whether a session is open
/// ([`crate::session::Session::is_open`]). A write counts at once and is lost at the next start unless the
/// host asks to save.
pub fn answer(parameters: &mut Parameters, request: &ParamRequest, is_armed: bool) -> ParamReply {
    let rule = RULES.iter().find(|rule| rule.id == request.id);
    let status = match (rule, request.op) {
        (None, _) => status::UNKNOWN,
        (_, op::READ) => status::DONE,
        (Some(rule), op::WRITE) if rule.moves && is_armed => status::ARMED,
        (_, op::WRITE) => match parameters.set(request.id, request.value as i32) {
            Ok(()) => status::DONE,
            Err(status) => status,
        },
        _ => status::NO_SUCH_OP,
    };
    ParamReply {
        op: request.op,
        id: request.id,
        status,
        value: parameters.get(request.id).unwrap_or_default() as u32,
    }
}

/// The answer to a host that asks for a counter ([`table::counter`]).
pub const fn answer_counter(count: u32, request: &ParamRequest) -> ParamReply {
    let status = match request.op {
        op::READ => status::DONE,
        op::WRITE => status::READ_ONLY,
        _ => status::NO_SUCH_OP,
    };
    ParamReply {
        op: request.op,
        id: request.id,
        status,
        value: count,
    }
}

#[cfg(test)]
mod tests;

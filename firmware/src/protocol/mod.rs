//! The messages on the CAN bus and on the serial line.
//!
//! CAN: classic frames of eight bytes at 1 Mbit/s, little-endian, reserved bits zero; an identifier is
//! `node << 5 | number`. [`messages`] defines them; `magpie dev dbc` exports the definition.
//! Serial line: [`serial`]. Sessions of hosts: [`session`], with the host's side in [`host_session`]; what a message needs:
//! [`rules`]; how it is authenticated: [`authentication`].

pub mod authentication;
pub mod can;
pub mod host_session;
pub mod layout;
pub mod messages;
pub mod rate_limiter;
pub mod rules;
pub mod serial;
pub mod session;

use crate::estimator::{Estimate, Validity};
use crate::fixed_point::Force;

/// Default node number: identifiers 0x200 to 0x21F.
pub const DEFAULT_NODE: u16 = 0x10;
/// Major and minor version of the messages.
pub const PROTOCOL_VERSION: (u8, u8) = (2, 0);

/// Versions of protocol and firmware on a board of this kind, with these tables.
pub const fn firmware_version(hardware: u8, tables: u16) -> messages::Version {
    const fn number(text: &str) -> u8 {
        match u8::from_str_radix(text, 10) {
            Ok(number) => number,
            Err(_) => u8::MAX,
        }
    }
    messages::Version {
        protocol_major: PROTOCOL_VERSION.0,
        protocol_minor: PROTOCOL_VERSION.1,
        firmware_major: const { number(env!("CARGO_PKG_VERSION_MAJOR")) },
        firmware_minor: const { number(env!("CARGO_PKG_VERSION_MINOR")) },
        firmware_patch: const { number(env!("CARGO_PKG_VERSION_PATCH")) },
        hardware,
        tables,
    }
}
/// [`messages::GripStatus::position`] of an unknown opening, as before homing.
pub const OPENING_UNKNOWN: u16 = 0x3FFF;
/// Value of an unknown temperature in [`messages::Power`].
pub const TEMPERATURE_UNKNOWN: i8 = i8::MIN;
/// Source of a frame: the CAN bus.
pub const CAN: u8 = 0;
/// Source of a frame: the serial line.
pub const SERIAL: u8 = 1;
/// Sources of frames.
pub const SOURCES: usize = 2;
/// Identifier of the emergency stop for all nodes.
pub const ESTOP_ALL_ID: u16 = 0x002;

/// Counts per newton of force and of standard deviation on the bus.
const COUNTS_PER_NEWTON: (i64, i64) = match messages::Force::LAYOUT.signals {
    [force, _, sigma, ..] => (force.counts_per_unit(), sigma.counts_per_unit()),
    _ => panic!("the layout needs a force and its sigma"),
};
/// Value of an unknown sigma.
const SIGMA_UNKNOWN: u8 = u8::MAX;
/// Value of `model` for an estimate by a network.
const NETWORK: u8 = 1;

/// The message with the forces at one sensor.
pub fn force_message(estimate: &Estimate, counter: u8) -> messages::Force {
    let [fx, fz] = estimate.force.map(|force| {
        let units = force_counts(force);
        units.clamp(i16::MIN.into(), i16::MAX.into()) as i16
    });
    let [sigma_x, sigma_z] =
        estimate.sigma.map_or([SIGMA_UNKNOWN; 2], |sigma| sigma.map(sigma_counts));
    messages::Force {
        fx,
        fz,
        sigma_x,
        sigma_z,
        valid: estimate.validity.is_in_range(),
        disturbed: estimate.disturbed,
        saturated: estimate.validity == Validity::Saturated,
        stale: estimate.validity == Validity::Missing,
        model: if estimate.sigma.is_some() { NETWORK } else { 0 },
        missing_inputs: estimate.missing_inputs,
        counter,
    }
}

/// A standard deviation in counts, rounded up and below [`SIGMA_UNKNOWN`].
fn sigma_counts(sigma: Force) -> u8 {
    let units = i64::from(sigma.0.max(0)) * COUNTS_PER_NEWTON.1;
    let up = (units + (1 << Force::BITS) - 1) >> Force::BITS;
    up.min(i64::from(SIGMA_UNKNOWN) - 1) as u8
}

/// Forces and standard deviations of a message in newtons, for the host; `None`: unknown.
pub fn force_newtons(message: &messages::Force) -> ([f64; 2], [Option<f64>; 2]) {
    let force = [message.fx, message.fz].map(|units| f64::from(units) / COUNTS_PER_NEWTON.0 as f64);
    let sigma = [message.sigma_x, message.sigma_z].map(|units| {
        (units != SIGMA_UNKNOWN).then_some(f64::from(units) / COUNTS_PER_NEWTON.1 as f64)
    });
    (force, sigma)
}

/// Opening of a message in millimetres, for the host; `None`: unknown.
pub fn opening_mm(status: &messages::GripStatus) -> Option<f64> {
    const MM_PER_COUNT: f64 = 0.01;
    (status.position != OPENING_UNKNOWN).then_some(MM_PER_COUNT * f64::from(status.position))
}

/// Identifier of a message of a node.
pub const fn frame_id(node: u16, number: u8) -> u16 {
    ((node << 5) | (number as u16 & 0x1F)) & 0x7FF
}

/// A force in counts, rounded.
fn force_counts(force: Force) -> i64 {
    let half = 1_i64 << (Force::BITS - 1);
    (i64::from(force.0) * COUNTS_PER_NEWTON.0 + half) >> Force::BITS
}

#[cfg(test)]
mod tests {
    use super::messages::{LAYOUTS, Message};
    use super::*;

    #[test]
    fn force_message_encodes_to_reference_bytes() {
        let estimate = Estimate {
            // 100 N and -50 N: 2000 and -1000 units of 0.05 N; 3 N of sigma: 12 of 0.25 N; 80 N: too many.
            force: [Force(100 << 10), Force(-(50 << 10))],
            sigma: Some([Force(3 << 10), Force(80 << 10)]),
            validity: Validity::Valid,
            ..Estimate::MISSING
        };
        let bytes = force_message(&estimate, 7).to_bytes();
        assert_eq!(frame_id(DEFAULT_NODE, messages::Force::LAYOUT.number + 2), 0x20A);
        assert_eq!(bytes, [0xD0, 0x07, 0x18, 0xFC, 0x0C, 0xFE, 0b1_0001, 0x07]);
    }

    #[test]
    fn force_newtons_decodes_forces_and_unknown_sigma() {
        let message = messages::Force {
            fx: 2000,
            fz: -1000,
            sigma_x: 12,
            sigma_z: SIGMA_UNKNOWN,
            ..messages::Force::default()
        };
        assert_eq!(force_newtons(&message), ([100.0, -50.0], [Some(3.0), None]));
    }

    #[test]
    fn unusable_estimate_is_not_flagged_valid() {
        let flags = |validity| {
            let estimate = Estimate { validity, ..Estimate::MISSING };
            force_message(&estimate, 0).to_bytes()[6]
        };
        assert_eq!(flags(Validity::Missing), 0b1000);
        assert_eq!(flags(Validity::Saturated), 0b0100);
        assert_eq!(flags(Validity::OutsideModel), 0b0000);
    }

    #[test]
    fn disturbed_force_is_flagged_and_sigma_is_rounded_up() {
        let estimate = Estimate {
            sigma: Some([Force(1), Force(80 << 10)]),
            validity: Validity::Valid,
            disturbed: true,
            ..Estimate::MISSING
        };
        let bytes = force_message(&estimate, 0).to_bytes();
        assert_eq!(bytes[4..7], [1, 254, 0b1_0011]);
    }

    #[test]
    fn force_beyond_range_saturates() {
        let at = |force: i32| {
            let estimate = Estimate { force: [Force(force); 2], ..Estimate::MISSING };
            super::force_message(&estimate, 0).fx
        };
        assert_eq!((at(i32::MAX), at(i32::MIN)), (i16::MAX, i16::MIN));
    }

    #[test]
    fn message_numbers_are_unique_and_messages_round_trip() {
        let mut used = 0_u32;
        for layout in LAYOUTS {
            for number in layout.numbers() {
                assert_eq!(used & (1 << number), 0, "{} shares its number", layout.name);
                used |= 1 << number;
                let bytes = (layout.used() & 0x5A5A_A5A5_1234_FEDC).to_le_bytes();
                let message = Message::from_frame(number, &bytes).unwrap();
                assert_eq!(message.layout(), layout);
                assert_eq!(message.to_bytes(), bytes, "{}", layout.name);
            }
        }
        assert!((used + 1).is_power_of_two(), "the numbers have a gap: {used:b}");
    }

    #[test]
    fn invalid_frame_is_rejected_with_reason() {
        use layout::FrameError;
        assert_eq!(Message::from_frame(0x1F, &[0; 8]), Err(FrameError::Unknown));
        assert_eq!(Message::from_frame(0x03, &[0; 7]), Err(FrameError::Length));
        // Bit 48 of a command is reserved.
        assert_eq!(Message::from_frame(0x03, &[0, 0, 0, 0, 0, 0, 1, 0]), Err(FrameError::Reserved));
    }
}

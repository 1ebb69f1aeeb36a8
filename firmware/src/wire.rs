//! The messages on the CAN bus: classic frames of eight bytes, little-endian, fields in order from
//! bit 0, reserved bits zero. An identifier is `node << 5 | message`.

use crate::force::{Estimate, Validity};
use crate::units::Force;

/// Node number if nobody gives another: identifiers 0x200 to 0x21F.
pub const DEFAULT_NODE: u16 = 0x10;

/// First of the four force messages.
const FORCE_0: u16 = 0x08;
/// Units of a force on the bus in a newton: 0.05 N each.
const FORCE_PER_NEWTON: i32 = 20;
/// Units of a standard deviation on the bus in a newton: 0.25 N each.
const SIGMA_PER_NEWTON: i64 = 4;
/// Says that sigma is not known.
const SIGMA_UNKNOWN: u8 = 255;

const VALID: u8 = 1 << 0;
const DISTURBED: u8 = 1 << 1;
const SATURATED: u8 = 1 << 2;
const STALE: u8 = 1 << 3;

/// Identifier and bytes of the message `ForceN`: the forces at sensor `sensor` (0 to 3).
///
/// Fx, Fz (i16, 0.05 N); sigma of both (u8, 0.25 N, rounded up, 254: that or more, 255: unknown);
/// valid, disturbed (by a foreign magnet), saturated, stale (4 bits); model (2), reserved (2); counter (8).
pub fn force(node: u16, sensor: u8, estimate: &Estimate, counter: u8) -> (u16, [u8; 8]) {
    let [x, z] = estimate.force.map(on_bus);
    let [x0, x1] = x.to_le_bytes();
    let [z0, z1] = z.to_le_bytes();
    let validity = match estimate.validity {
        Validity::Valid => VALID,
        Validity::Saturated => SATURATED,
        Validity::OutsideModel => 0,
        Validity::Missing => STALE,
    };
    let flags = match estimate.disturbed {
        true => validity | DISTURBED,
        false => validity,
    };
    let [sigma_x, sigma_z] = match estimate.sigma {
        Some(sigma) => sigma.map(sigma_on_bus),
        None => [SIGMA_UNKNOWN; 2],
    };
    let message = FORCE_0 + u16::from(sensor & 3);
    let bytes = [x0, x1, z0, z1, sigma_x, sigma_z, flags, counter];
    (identifier(node, message), bytes)
}

/// Identifier of a message of this node.
pub const fn identifier(node: u16, message: u16) -> u16 {
    ((node << 5) | (message & 0x1F)) & 0x7FF
}

/// Rounds to the bus's units; what does not fit stays at the end of the range.
fn on_bus(force: Force) -> i16 {
    let half = 1_i64 << (Force::BITS - 1);
    let units = (i64::from(force.0) * i64::from(FORCE_PER_NEWTON) + half) >> Force::BITS;
    units.clamp(i64::from(i16::MIN), i64::from(i16::MAX)) as i16
}

/// Rounds a standard deviation up to the bus's units: never better than it is.
fn sigma_on_bus(sigma: Force) -> u8 {
    let units = i64::from(sigma.0.max(0)) * SIGMA_PER_NEWTON;
    let up = (units + (1 << Force::BITS) - 1) >> Force::BITS;
    up.min(i64::from(SIGMA_UNKNOWN) - 1) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_force_message_is_these_eight_bytes() {
        let estimate = Estimate {
            // 100 N and -50 N: 2000 and -1000 units of 0.05 N.
            force: [Force(100 << 10), Force(-(50 << 10))],
            validity: Validity::Valid,
            ..Estimate::MISSING
        };
        let (id, bytes) = force(DEFAULT_NODE, 2, &estimate, 7);
        assert_eq!(id, 0x20A);
        assert_eq!(bytes, [0xD0, 0x07, 0x18, 0xFC, 0xFF, 0xFF, 0x01, 0x07]);
    }

    #[test]
    fn what_cannot_be_used_is_not_marked_valid() {
        let flags = |validity| {
            let estimate = Estimate {
                validity,
                ..Estimate::MISSING
            };
            force(DEFAULT_NODE, 0, &estimate, 0).1[6]
        };
        assert_eq!(flags(Validity::Missing), 0b1000);
        assert_eq!(flags(Validity::Saturated), 0b0100);
        assert_eq!(flags(Validity::OutsideModel), 0b0000);
    }

    #[test]
    fn a_disturbed_force_says_so_and_its_sigma_is_rounded_up() {
        let estimate = Estimate {
            sigma: Some([Force(1), Force(80 << 10)]),
            validity: Validity::Valid,
            disturbed: true,
            ..Estimate::MISSING
        };
        let (_, bytes) = force(DEFAULT_NODE, 0, &estimate, 0);
        assert_eq!(bytes[4..7], [1, 254, 0b0011]);
    }

    #[test]
    fn a_force_beyond_the_message_stays_at_its_end() {
        assert_eq!(on_bus(Force(i32::MAX)), i16::MAX);
        assert_eq!(on_bus(Force(i32::MIN)), i16::MIN);
    }
}

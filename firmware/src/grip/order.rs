//! What a host asks for: the fields of [`Command`] in newtons and millimetres.
//!
//! Hosts repeat a command as long as they mean it. The same one again is the same order; whoever wants to grip
//! anew after a failure turns [`flag::AGAIN`].

use super::profile::{CEILING_N, Profile};
use super::reason::Reason;
use crate::limits::Grasp;
use crate::params;
use crate::wire::messages::Command;

/// Modes of a [`Command`].
pub mod mode {
    /// Give the drive back.
    pub const DISABLE: u8 = 0;
    /// Take the drive; afterwards it only says that the host is there.
    pub const ENABLE: u8 = 1;
    /// Home on force.
    pub const HOME: u8 = 2;
    /// Go to an opening: position, speed.
    pub const MOVE: u8 = 3;
    /// Grip: force, speed (0: as the force allows), flags; the expected width as position where the flags give
    /// a window.
    pub const GRIP: u8 = 4;
    /// Open: position, speed.
    pub const RELEASE: u8 = 5;
    /// Stop; a hold goes on.
    pub const STOP: u8 = 6;
    /// Be a foot: flags.
    pub const FOOT: u8 = 7;
    /// Be a foot no more.
    pub const LEAVE: u8 = 8;
}

/// Flags of a [`Command`].
pub mod flag {
    /// Two bits: a [`super::Profile`].
    pub const PROFILE: u8 = 0b0000_0011;
    /// Three bits: 0 takes any width; n a window of 2^(n-1) mm to either side of the expected width.
    pub const WINDOW: u8 = 0b0001_1100;
    /// Fast until the window is near.
    pub const FAST: u8 = 0b0010_0000;
    /// A foot that stands on the line between open fingers; else flat on closed ones.
    pub const LINE: u8 = 0b0100_0000;
    /// Turned from one command to the next: this is another order.
    pub const AGAIN: u8 = 0b1000_0000;
}

/// Counts of the bus for one unit, from the table of messages: position, speed, force.
const PER_UNIT: [f32; 3] = match Command::LAYOUT.fields {
    [_, _, position, speed, force, ..] => [
        position.counts_per_unit() as f32,
        speed.counts_per_unit() as f32,
        force.counts_per_unit() as f32,
    ],
    _ => [0.0; 3],
};

/// Widths in millimetres at which an object is expected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// The narrowest.
    pub least_mm: f32,
    /// The widest.
    pub most_mm: f32,
}

/// How to grip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grip {
    /// Force in newtons.
    pub set_n: f32,
    /// Greatest speed of closing in mm/s.
    pub most_mm_s: f32,
    /// The greatest force that a slip may raise it to.
    pub cap_n: f32,
    /// Where the object is expected.
    pub window: Option<Window>,
    /// Fast until the window is near.
    pub is_fast: bool,
}

/// A way to an opening.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Way {
    /// In millimetres between the fingers.
    pub opening_mm: f32,
    /// In mm/s.
    pub speed_mm_s: f32,
}

/// An order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// See [`mode::DISABLE`].
    Disable,
    /// See [`mode::ENABLE`].
    Enable,
    /// See [`mode::HOME`].
    Home,
    /// See [`mode::MOVE`].
    Move(Way),
    /// See [`mode::GRIP`].
    Grip(Grip),
    /// See [`mode::RELEASE`].
    Release(Way),
    /// See [`mode::STOP`].
    Stop,
    /// See [`mode::FOOT`]; whether it stands on a line.
    Foot {
        /// See [`flag::LINE`].
        on_line: bool,
    },
    /// See [`mode::LEAVE`].
    Leave,
}

impl Order {
    /// What a command asks for.
    ///
    /// # Errors
    /// A mode or profile that means nothing, or a number beyond its range.
    pub fn of(command: &Command, limits: &Grasp) -> Result<Self, Reason> {
        match command.mode {
            mode::DISABLE => Ok(Self::Disable),
            mode::ENABLE => Ok(Self::Enable),
            mode::HOME => Ok(Self::Home),
            mode::MOVE => way(command).map(Self::Move),
            mode::GRIP => grip(command, limits).map(Self::Grip),
            mode::RELEASE => way(command).map(Self::Release),
            mode::STOP => Ok(Self::Stop),
            mode::FOOT => Ok(Self::Foot {
                on_line: command.flags & flag::LINE != 0,
            }),
            mode::LEAVE => Ok(Self::Leave),
            _ => Err(Reason::UnknownMode),
        }
    }
}

fn way(command: &Command) -> Result<Way, Reason> {
    let [per_mm, per_mm_s, _] = PER_UNIT;
    let opening_mm = f32::from(command.position) / per_mm;
    let speed_mm_s = f32::from(command.speed) / per_mm_s;
    let is_possible = opening_mm <= params::STROKE.value as f32 && command.speed > 0;
    is_possible
        .then_some(Way {
            opening_mm,
            speed_mm_s,
        })
        .ok_or(Reason::OutOfRange)
}

fn grip(command: &Command, limits: &Grasp) -> Result<Grip, Reason> {
    let [per_mm, per_mm_s, per_n] = PER_UNIT;
    let profile = Profile::of(command.flags & flag::PROFILE).ok_or(Reason::OutOfRange)?;
    let set_n = f32::from(command.force) / per_n;
    let cap_n = profile.most_n().min(CEILING_N);
    if set_n < limits.contact_n || set_n > cap_n {
        return Err(Reason::OutOfRange);
    }
    let width_mm = f32::from(command.position) / per_mm;
    let window = match (command.flags & flag::WINDOW) >> flag::WINDOW.trailing_zeros() {
        0 => None,
        n => {
            let half_mm = f32::from(1_u8 << (n - 1));
            Some(Window {
                least_mm: width_mm - half_mm,
                most_mm: width_mm + half_mm,
            })
        }
    };
    let asked_mm_s = match command.speed {
        0 => profile.most_mm_s(),
        speed => f32::from(speed) / per_mm_s,
    };
    Ok(Grip {
        set_n,
        most_mm_s: asked_mm_s.min(profile.most_mm_s()),
        cap_n,
        window,
        is_fast: command.flags & flag::FAST != 0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Grasp = Grasp::GRIPPER;

    #[test]
    fn a_command_is_read_in_newtons_and_millimetres() {
        // 35 mm, 10 mm/s, 80 N, normal, a window of 4 mm to either side.
        let command = Command {
            mode: mode::GRIP,
            position: 700,
            speed: 40,
            force: 800,
            flags: 3 << 2,
            ..Command::default()
        };
        let expected = Grip {
            set_n: 80.0,
            most_mm_s: 10.0,
            cap_n: 100.0,
            window: Some(Window {
                least_mm: 31.0,
                most_mm: 39.0,
            }),
            is_fast: false,
        };
        assert_eq!(Order::of(&command, &LIMITS), Ok(Order::Grip(expected)));
    }

    #[test]
    fn each_mode_is_an_order() {
        let of = |mode| {
            let command = Command {
                mode,
                ..Command::default()
            };
            Order::of(&command, &LIMITS)
        };
        for (mode, order) in [
            (mode::DISABLE, Order::Disable),
            (mode::ENABLE, Order::Enable),
            (mode::HOME, Order::Home),
            (mode::STOP, Order::Stop),
            (mode::FOOT, Order::Foot { on_line: false }),
            (mode::LEAVE, Order::Leave),
        ] {
            assert_eq!(of(mode), Ok(order));
        }
    }

    #[test]
    fn a_force_beyond_its_profile_and_below_a_contact_are_refused() {
        let of = |force, flags| {
            let command = Command {
                mode: mode::GRIP,
                force,
                flags,
                ..Command::default()
            };
            Order::of(&command, &LIMITS).err()
        };
        assert_eq!([of(1000, 0), of(1001, 0)], [None, Some(Reason::OutOfRange)]);
        assert_eq!([of(200, 1), of(201, 1)], [None, Some(Reason::OutOfRange)]);
        assert_eq!([of(3500, 2), of(3501, 2)], [None, Some(Reason::OutOfRange)]);
        assert_eq!([of(50, 0), of(49, 0)], [None, Some(Reason::OutOfRange)]);
        assert_eq!(of(50, 3), Some(Reason::OutOfRange));
    }

    #[test]
    fn a_way_beyond_the_stroke_or_without_speed_and_a_mode_without_meaning_are_refused() {
        let of = |mode, position, speed| {
            let command = Command {
                mode,
                position,
                speed,
                ..Command::default()
            };
            Order::of(&command, &LIMITS).err()
        };
        assert_eq!(
            [of(3, 1600, 1), of(3, 1601, 1)],
            [None, Some(Reason::OutOfRange)]
        );
        assert_eq!(of(5, 800, 0), Some(Reason::OutOfRange));
        assert_eq!(
            [of(8, 0, 0), of(9, 0, 0)],
            [None, Some(Reason::UnknownMode)]
        );
    }
}

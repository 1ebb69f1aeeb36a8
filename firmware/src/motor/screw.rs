//! Lead screw: conversion of rotation to opening and of torque to force, friction, self-locking and backlash.
//!
//! Each finger has a screw, and both turn with the rotor, so that a turn changes the opening by twice the lead.
//! Friction torque is proportional to the load in both directions; where it exceeds the torque of the load, the screw
//! is self-locking: no grasp turns the rotor back.

use core::f32::consts::TAU;

use crate::config::constants;
use crate::math::{greater, within};

/// A screw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Screw {
    /// Decrease of the opening in millimetres per radian of the rotor.
    pub ratio_mm: f32,
    /// Friction torque relative to the torque of the load.
    pub friction: f32,
    /// Backlash in millimetres of the opening.
    pub play_mm: f32,
    /// Whether a grasp holds without current by the assumed friction; the device measures it
    /// ([`super::backdrive_test`]).
    pub self_locking: bool,
}

impl Screw {
    /// The screw with which the opening closes at the paper's speed.
    pub const A: Self = Self::new(constants::LEAD_A, constants::EFFICIENCY_A);
    /// The screw with which each finger closes at the paper's speed.
    pub const B: Self = Self::new(constants::LEAD_B, constants::EFFICIENCY_B);

    const fn new(lead: constants::Constant, efficiency: constants::Constant) -> Self {
        // The efficiency at rated torque includes dry friction, which is independent of the load.
        let driving = 1.0 - constants::DRY_FRICTION.value / constants::RATED_TORQUE.value;
        let friction = driving / efficiency.value - 1.0;
        Self {
            ratio_mm: 2.0 * lead.value as f32 / TAU,
            friction: friction as f32,
            play_mm: constants::BACKLASH.value as f32,
            self_locking: friction > 1.0,
        }
    }

    /// Rotor speed in rad/s for a closing speed in mm/s.
    pub fn rotor_speed(&self, closing_mm_s: f32) -> f32 {
        closing_mm_s / self.ratio_mm
    }

    /// Closing speed in mm/s for a rotor speed in rad/s.
    pub fn closing_mm_s(&self, rotor_speed: f32) -> f32 {
        rotor_speed * self.ratio_mm
    }

    /// Grip force in newtons at rest after closing with a torque in N m; `dry_nm` is the rotor's dry friction.
    pub fn force_n(&self, torque_nm: f32, dry_nm: f32) -> f32 {
        greater(torque_nm - dry_nm, 0.0) / (self.ratio_mm * 1e-3 * (1.0 + self.friction))
    }

    /// Closing torque in N m for a grip force in newtons.
    pub fn torque_nm(&self, force_n: f32, dry_nm: f32) -> f32 {
        force_n * self.ratio_mm * 1e-3 * (1.0 + self.friction) + dry_nm
    }

    /// Torque in N m that prevents a force in newtons from turning the screw back; 0 where friction suffices.
    pub fn holding_nm(&self, force_n: f32, dry_nm: f32) -> f32 {
        let back_nm = force_n * self.ratio_mm * 1e-3 * (1.0 - self.friction);
        greater(back_nm - dry_nm, 0.0)
    }
}

/// Backlash (play operator): the fingers follow the rotor once the play is taken up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Backlash {
    /// Lag of the opening behind the rotor, 0 (closing) to the backlash (opening), in millimetres.
    lag_mm: f32,
    last_mm: f32,
}

impl Backlash {
    /// Starts at a rotor position with the closing flanks in contact.
    pub fn new(rotor_mm: f32) -> Self {
        Self { lag_mm: 0.0, last_mm: rotor_mm }
    }

    /// Opening in millimetres for the rotor position as an opening.
    pub fn opening_mm(&mut self, screw: &Screw, rotor_mm: f32) -> f32 {
        self.lag_mm = within(self.lag_mm + rotor_mm - self.last_mm, 0.0, screw.play_mm);
        self.last_mm = rotor_mm;
        rotor_mm - self.lag_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn screws_close_at_the_speed_of_the_paper() {
        // The lead of B is per finger: the opening closes at twice its speed.
        let speed = constants::RATED_SPEED.value as f32;
        for (screw, expected) in [(Screw::A, 58.3), (Screw::B, 116.6)] {
            let closing = screw.closing_mm_s(speed);
            assert!((closing / expected - 1.0).abs() < 0.002, "{closing}");
            assert!((screw.rotor_speed(closing) - speed).abs() < 1e-3);
        }
    }

    #[test]
    fn screws_press_with_350_n_at_rated_torque() {
        for screw in [Screw::A, Screw::B] {
            let force = screw.force_n(constants::RATED_TORQUE.value as f32, 0.02);
            assert!((force / 350.0 - 1.0).abs() < 0.005, "{force}");
            assert!((screw.torque_nm(force, 0.02) - 0.58).abs() < 1e-5);
        }
    }

    #[test]
    fn screw_a_is_self_locking_and_screw_b_needs_torque() {
        assert_eq!([Screw::A, Screw::B].map(|screw| screw.self_locking), [true, false]);
        assert_eq!(Screw::A.holding_nm(350.0, 0.02), 0.0);
        // Friction: 0.9655 / 0.617 - 1 = 0.565; 350 N * 1.0227e-3 m * 0.435 - 0.02 N m.
        assert!((Screw::B.friction - 0.5649).abs() < 1e-3);
        assert!((Screw::B.holding_nm(350.0, 0.02) - 0.1358).abs() < 1e-3);
    }

    #[test]
    fn backlash_is_taken_up_before_the_fingers_follow() {
        let screw = Screw { play_mm: 0.03, ..Screw::A };
        let mut play = Backlash::new(20.0);
        let near =
            |opening: f32, expected: f32| assert!((opening - expected).abs() < 1e-5, "{opening}");
        near(play.opening_mm(&screw, 19.0), 19.0);
        near(play.opening_mm(&screw, 19.02), 19.0);
        near(play.opening_mm(&screw, 19.13), 19.1);
        near(play.opening_mm(&screw, 19.11), 19.1);
        near(play.opening_mm(&screw, 19.0), 19.0);
    }
}

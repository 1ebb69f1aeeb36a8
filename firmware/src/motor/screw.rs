//! The lead screw: turns of the rotor into millimetres of the opening, torque into force, and what its
//! friction and its play do.
//!
//! Each finger hangs on a screw of its own; both turn with the rotor, so that the opening changes by twice a
//! lead in a turn. Friction takes torque in proportion to the load, whichever way the screw turns; where it
//! takes more than the load gives, the screw locks itself: no grasp turns the rotor back.

use core::f32::consts::TAU;

use super::number::{greater, within};
use crate::params;

/// A screw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Screw {
    /// What the opening falls by for one radian of the rotor, in millimetres.
    pub ratio_mm: f32,
    /// Torque of the friction for one newton metre that the load gives.
    pub friction: f32,
    /// Between the flanks, in millimetres of the opening.
    pub play_mm: f32,
    /// Whether a grasp holds without current: commissioned, not computed
    /// ([`super::selflock`]).
    pub self_locking: bool,
}

impl Screw {
    /// The screw with which the opening closes at the paper's speed.
    pub const A: Self = Self::new(params::LEAD_A, params::EFFICIENCY_A);
    /// The screw with which each finger closes at the paper's speed.
    pub const B: Self = Self::new(params::LEAD_B, params::EFFICIENCY_B);

    const fn new(lead: params::Constant, efficiency: params::Constant) -> Self {
        // The efficiency at rated torque counts dry friction, which no load changes.
        let driving = 1.0 - params::DRY_FRICTION.value / params::RATED_TORQUE.value;
        let friction = driving / efficiency.value - 1.0;
        Self {
            ratio_mm: 2.0 * lead.value as f32 / TAU,
            friction: friction as f32,
            play_mm: params::PLAY.value as f32,
            self_locking: friction > 1.0,
        }
    }

    /// Speed of the rotor in rad/s for a speed of closing in mm/s.
    pub fn rotor_speed(&self, closing_mm_s: f32) -> f32 {
        closing_mm_s / self.ratio_mm
    }

    /// Speed of closing in mm/s for a speed of the rotor in rad/s.
    pub fn closing_mm_s(&self, rotor_speed: f32) -> f32 {
        rotor_speed * self.ratio_mm
    }

    /// Force in newtons with which the fingers press at rest after a torque in newton metres that closed
    /// them; `dry_nm` is the rotor's dry friction.
    pub fn force_n(&self, torque_nm: f32, dry_nm: f32) -> f32 {
        greater(torque_nm - dry_nm, 0.0) / (self.ratio_mm * 1e-3 * (1.0 + self.friction))
    }

    /// Torque in newton metres that presses with a force in newtons.
    pub fn torque_nm(&self, force_n: f32, dry_nm: f32) -> f32 {
        force_n * self.ratio_mm * 1e-3 * (1.0 + self.friction) + dry_nm
    }

    /// Torque in newton metres that holds a force in newtons against turning back: nothing where friction
    /// is enough.
    pub fn holding_nm(&self, force_n: f32, dry_nm: f32) -> f32 {
        let back_nm = force_n * self.ratio_mm * 1e-3 * (1.0 - self.friction);
        greater(back_nm - dry_nm, 0.0)
    }
}

/// Where the fingers are between the flanks: they follow the rotor's place once the play is taken up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Play {
    /// How far the opening lags behind the rotor's place, 0 (closing) to the play (opening), millimetres.
    lag_mm: f32,
    last_mm: f32,
}

impl Play {
    /// The rotor's place is known anew, with the flanks that close touching.
    pub fn new(rotor_mm: f32) -> Self {
        Self {
            lag_mm: 0.0,
            last_mm: rotor_mm,
        }
    }

    /// The opening in millimetres for the rotor's place, both counted as opening.
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
    fn both_screws_close_at_the_papers_speed() {
        // B's lead is counted for each finger: the opening closes at twice that.
        let speed = params::RATED_SPEED.value as f32;
        for (screw, expected) in [(Screw::A, 58.3), (Screw::B, 116.6)] {
            let closing = screw.closing_mm_s(speed);
            assert!((closing / expected - 1.0).abs() < 0.002, "{closing}");
            assert!((screw.rotor_speed(closing) - speed).abs() < 1e-3);
        }
    }

    #[test]
    fn both_screws_press_with_350_n_at_rated_torque() {
        for screw in [Screw::A, Screw::B] {
            let force = screw.force_n(params::RATED_TORQUE.value as f32, 0.02);
            assert!((force / 350.0 - 1.0).abs() < 0.005, "{force}");
            assert!((screw.torque_nm(force, 0.02) - 0.58).abs() < 1e-5);
        }
    }

    #[test]
    fn screw_a_holds_by_itself_and_screw_b_needs_an_eighth_of_a_newton_metre() {
        assert_eq!(
            [Screw::A, Screw::B].map(|screw| screw.self_locking),
            [true, false]
        );
        assert_eq!(Screw::A.holding_nm(350.0, 0.02), 0.0);
        // Friction: 0.9655 / 0.617 - 1 = 0.565; 350 N * 1.0227e-3 m * 0.435 - 0.02 N m.
        assert!((Screw::B.friction - 0.5649).abs() < 1e-3);
        assert!((Screw::B.holding_nm(350.0, 0.02) - 0.1358).abs() < 1e-3);
    }

    #[test]
    fn the_play_is_passed_before_the_fingers_follow() {
        let screw = Screw {
            play_mm: 0.03,
            ..Screw::A
        };
        let mut play = Play::new(20.0);
        let near = |told: f32, expected: f32| assert!((told - expected).abs() < 1e-5, "{told}");
        near(play.opening_mm(&screw, 19.0), 19.0);
        near(play.opening_mm(&screw, 19.02), 19.0);
        near(play.opening_mm(&screw, 19.13), 19.1);
        near(play.opening_mm(&screw, 19.11), 19.1);
        near(play.opening_mm(&screw, 19.0), 19.0);
    }
}

//! One finger in time: from loads to where its magnet is and how it leans.

use model_export::physics::Magnet;
use nalgebra::{Rotation3, Vector3};

use super::effects::Effects;
use super::flexure::{Build, Flexure, REFERENCE_MM};
use super::scatter::Made;

/// Share of Fx that acts as Fz, in shares of Fz that acts as Fx.
const CROSS_BACK: f64 = -0.4;

/// A stop is met at this share of an axis' greatest load.
const KNEE: f64 = 0.6;

/// A cantilever of length L, bent by w at its end, is 0.6 w^2/L shorter and ends at a slope of
/// 1.5 w/L (small deflections of a beam under a load at its end).
const FORESHORTENING: f64 = 0.6;
const END_SLOPE: f64 = 1.5;

/// A finger with the memory of its flexures.
#[derive(Clone, Debug)]
pub struct Finger {
    made: Made,
    flexures: [Flexure; 2],
    coupling: f64,
    mass_kg: f64,
    foreshortening_mm: f64,
    gap_mm_per_k: f64,
    ripple_mm: f64,
}

/// Where a magnet is, and how it stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Its centre as seen from the Hall element, gripper's axes, in mm.
    pub centre_mm: Vector3<f64>,
    /// From the magnet's frame (its body's axis is z) to the gripper's.
    pub turn: Rotation3<f64>,
}

impl Pose {
    /// Field at the Hall element for each tesla of remanence, gripper's axes, in gauss.
    pub fn unit_field(&self, magnet: &Magnet) -> Vector3<f64> {
        self.turn * magnet.unit_field(self.turn.inverse() * -self.centre_mm)
    }
}

impl Finger {
    /// A finger that has never been loaded; `greatest_n` are the greatest loads that it will meet.
    pub fn new(made: &Made, effects: &Effects, greatest_n: [f64; 2]) -> Self {
        let of = |id: &str| effects.each(id, made.number);
        let friction_n = effects.friction_n(made.number);
        let lag_s = 1e-3 * of("viscous_lag");
        let flexure = |axis: usize, lag_s: f64| {
            Flexure::new(Build {
                stiffness_n_per_mm: made.stiffness_n_per_mm[axis],
                stiffening: 0.01 * of("geometric_stiffening"),
                stop: (KNEE * greatest_n[axis], 0.01 * of("hard_stop")),
                friction_n: friction_n[axis],
                lag_s,
                creep: (0.01 * of("creep"), effects.creep_s),
                softening: (0.01 * of("softening"), effects.softening_cycles),
            })
        };
        Self {
            made: made.clone(),
            flexures: [flexure(0, lag_s), flexure(1, 0.5 * lag_s)],
            coupling: 0.01 * of("cross_coupling"),
            mass_kg: of("fingertip_mass"),
            foreshortening_mm: 1e-3 * of("tip_slope"),
            gap_mm_per_k: 1e-3 * of("thermal_gap"),
            ripple_mm: 1e-3 * of("screw_ripple"),
        }
    }

    /// Goes on by `dt_s` to a moment with these loads in N and this specific force in m/s^2.
    pub fn step(&mut self, [fx, fz]: [f64; 2], specific_force: Vector3<f64>, dt_s: f64) {
        let inertia = self.mass_kg * specific_force;
        let [lateral, longitudinal] = &mut self.flexures;
        lateral.step(fx + self.coupling * fz + inertia.x, dt_s);
        longitudinal.step(fz + CROSS_BACK * self.coupling * fx + inertia.z, dt_s);
    }

    /// True if accelerations are felt.
    pub fn has_mass(&self) -> bool {
        self.mass_kg != 0.0
    }

    /// A pause without load.
    pub fn pause(&mut self, seconds: f64) {
        for flexure in &mut self.flexures {
            flexure.pause(seconds);
        }
    }

    /// Load cycles of the flexures since the campaign began.
    pub fn cycles(&self) -> [u32; 2] {
        [self.flexures[0].cycles(), self.flexures[1].cycles()]
    }

    /// The magnet's pose, so many kelvin from the reference temperature and with the screw turned
    /// by so many of its turns.
    pub fn magnet(&self, warm_k: f64, screw_turns: f64) -> Pose {
        let [x, z] = [self.flexures[0].at_mm(), self.flexures[1].at_mm()];
        let shorter = self.foreshortening_mm * ((x * x + z * z) / REFERENCE_MM.powi(2));
        let gap = self.made.gap_mm + self.gap_mm_per_k * warm_k - shorter;
        let ripple = self.ripple_mm * libm::sin(std::f64::consts::TAU * screw_turns);
        let [offset_x, offset_z] = self.made.offset_mm;
        let [tilt_x, tilt_z] = self.made.tilt_rad;
        Pose {
            centre_mm: Vector3::new(
                offset_x + x,
                gap + self.made.reach_mm,
                offset_z + z + ripple,
            ),
            turn: self.lean(x, z)
                * Rotation3::from_scaled_axis(Vector3::new(tilt_x, 0.0, tilt_z))
                * self.made.upright,
        }
    }

    /// The beams' ends turn with their deflection: the axis, y, leans towards where it goes.
    fn lean(&self, x: f64, z: f64) -> Rotation3<f64> {
        let per_length = self.foreshortening_mm / (FORESHORTENING * REFERENCE_MM.powi(2));
        let [slope_x, slope_z] = [x, z].map(|w| libm::atan(END_SLOPE * w * per_length));
        Rotation3::from_scaled_axis(Vector3::new(slope_z, 0.0, -slope_x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model_export::physics::ForwardModel;
    use model_export::recordings::description::Design;

    fn finger(wanted: &[&str], scatter: f64) -> (Made, Finger) {
        let made = Made::draw(&Design::magpie(), 0, 5, scatter);
        let wanted: Vec<_> = wanted.iter().map(|id| id.parse().unwrap()).collect();
        let effects = Effects::new(&wanted, 5, 1, 0.0).unwrap();
        let finger = Finger::new(&made, &effects, [200.0; 2]);
        (made, finger)
    }

    #[test]
    fn without_effects_the_field_is_that_of_the_forward_model_to_the_last_digits() {
        let (made, mut finger) = finger(&[], 1.0);
        let model = ForwardModel {
            stiffness_n_per_mm: made.stiffness_n_per_mm,
            gap_mm: made.gap_mm,
            offset_mm: made.offset_mm,
            tilt_rad: made.tilt_rad,
            ..ForwardModel::nominal(&Design::magpie())
        };
        for load in [[0.0, 0.0], [150.0, -80.0], [-200.0, 190.0]] {
            finger.step(load, Vector3::zeros(), 1e-3);
            let own = finger.magnet(0.0, 0.0).unit_field(&made.magnet) * 1.2;
            assert!((own - model.field(load)).amax() < 1e-6, "{own}");
        }
    }

    #[test]
    fn a_leaning_tip_is_five_micrometres_shorter_at_half_a_millimetre_and_slopes_by_a_fortieth() {
        let (_, mut finger) = finger(&["tip_slope"], 0.0);
        finger.step([250.0, 0.0], Vector3::zeros(), 1e-3);
        let pose = finger.magnet(0.0, 0.0);
        assert!((pose.centre_mm - Vector3::new(0.5, 2.495, 0.0)).amax() < 1e-9);
        let axis = pose.turn * Vector3::z();
        assert!((axis.x / axis.y - 1.5 * 0.5 / 30.0).abs() < 1e-9, "{axis}");
    }

    #[test]
    fn a_tenth_of_a_kilogram_on_a_level_gripper_is_a_newton_longitudinally() {
        let (_, mut finger) = finger(&["fingertip_mass"], 0.0);
        finger.step([0.0; 2], Vector3::new(0.0, 0.0, 9.81), 1e-3);
        let z = finger.magnet(0.0, 0.0).centre_mm.z;
        assert!((z * 800.0 - 0.981).abs() < 1e-9);
    }

    #[test]
    fn coupling_goes_both_ways() {
        let (_, mut finger) = finger(&["cross_coupling=2"], 0.0);
        finger.step([100.0, 50.0], Vector3::zeros(), 1e-3);
        let at = finger.magnet(0.0, 0.0).centre_mm;
        assert!((at.x * 500.0 - 101.0).abs() < 1e-9 && (at.z * 800.0 - 49.2).abs() < 1e-9);
    }

    #[test]
    fn the_gap_grows_with_temperature_and_the_screw_s_turn_moves_the_magnet() {
        let (_, finger) = finger(&["thermal_gap", "screw_ripple"], 0.0);
        let at = finger.magnet(10.0, 0.25).centre_mm;
        assert!((at - Vector3::new(0.0, 2.505, 0.002)).amax() < 1e-12);
    }
}

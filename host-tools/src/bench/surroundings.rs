//! Fields from outside the finger: the opposite finger's magnet, the motor, the Earth.

use model_export::physics::Magnet;
use nalgebra::{Matrix3, Rotation3, Vector3};

use super::attitude::Standing;
use super::draw::{Purpose, between, normal, stream};
use super::effects::Effects;
use super::finger::Pose;
use super::scatter::Made;
use super::stroke::{Drive, POLE_PAIRS};

/// Opening at which the neighbour's field is stated, in mm.
const STATED_OPENING_MM: f64 = 10.0;

/// Between the magnets when the gripper is closed, in mm, and how far they are out of line.
const CLOSED_MM: [f64; 2] = [9.0, 11.0];
const OUT_OF_LINE_MM: f64 = 1.0;

/// Current for which the leakage is stated, in A.
const STATED_CURRENT_A: f64 = 10.0;

/// Dip of the Earth's field below the horizon (a place in the middle latitudes).
const DIP_DEG: f64 = 60.0;

/// The magnet of the opposite finger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    magnet: Magnet,
    turn: Rotation3<f64>,
    remanence_t: f64,
    /// Towards which side the opposite finger is.
    side: f64,
    /// Its centre as seen from the element with the gripper closed; x is a distance.
    pub closed_mm: Vector3<f64>,
}

impl Neighbour {
    /// Draws where the neighbour is; `stated_g` is its field at 10 mm, in gauss.
    pub fn draw(made: &Made, seed: u64, scatter: f64, stated_g: f64) -> Self {
        let mut rng = stream(seed, Purpose::Neighbour, made.number);
        let mut out = || scatter * OUT_OF_LINE_MM * normal(&mut rng);
        let (y, z) = (made.gap_mm + made.reach_mm + out(), out());
        let mut neighbour = Self {
            magnet: made.magnet,
            turn: made.upright,
            remanence_t: 1.0,
            side: if made.number.is_multiple_of(2) {
                1.0
            } else {
                -1.0
            },
            closed_mm: Vector3::new(between(&mut rng, CLOSED_MM[0], CLOSED_MM[1]), y, z),
        };
        neighbour.remanence_t = stated_g / neighbour.field(STATED_OPENING_MM).norm();
        neighbour
    }

    /// Its field at the element, gripper's axes, in gauss.
    pub fn field(&self, opening_mm: f64) -> Vector3<f64> {
        if self.remanence_t == 0.0 {
            return Vector3::zeros();
        }
        let distance = self.closed_mm + Vector3::new(opening_mm, 0.0, 0.0);
        let pose = Pose {
            centre_mm: Vector3::new(self.side * distance.x, distance.y, distance.z),
            turn: self.turn,
        };
        pose.unit_field(&self.magnet) * self.remanence_t
    }
}

/// Nine coefficients in G/A: axes by alpha, beta and quadrature current.
pub fn leakage(made: &Made, effects: &Effects, seed: u64) -> Matrix3<f64> {
    let mut rng = stream(seed, Purpose::Leakage, made.number);
    let raw = Matrix3::from_fn(|_, _| normal(&mut rng));
    raw * (effects.each("motor_leakage", made.number) / (STATED_CURRENT_A * raw.norm()))
}

/// The motor's phase currents (alpha, beta) and its quadrature current, in A.
pub fn currents(drive: &Drive) -> Vector3<f64> {
    let (sin, cos) = libm::sincos(POLE_PAIRS * drive.angle_rad);
    Vector3::new(
        -drive.current_a * sin,
        drive.current_a * cos,
        drive.current_a,
    )
}

/// The Earth's field in the world's axes (z up), in gauss; its bearing is drawn.
pub fn earth(effects: &Effects, seed: u64) -> Vector3<f64> {
    let mut rng = stream(seed, Purpose::Earth, 0);
    let (sin, cos) = libm::sincos(between(&mut rng, 0.0, std::f64::consts::TAU));
    let (down, level) = libm::sincos(DIP_DEG.to_radians());
    Vector3::new(level * cos, level * sin, -down) * effects.size("earth_field")
}

/// A world's vector as the gripper sees it.
pub fn in_body(world: Vector3<f64>, standing: &Standing) -> Vector3<f64> {
    standing.to_world.inverse() * world
}

#[cfg(test)]
mod tests {
    use super::*;
    use model_export::recordings::description::Design;
    use nalgebra::Rotation3;

    fn made() -> Made {
        Made::draw(&Design::magpie(), 1, 5, 1.0)
    }

    #[test]
    fn the_neighbour_has_its_field_at_ten_millimetres_and_fades_like_a_dipole() {
        let neighbour = Neighbour::draw(&made(), 5, 1.0, 2.0);
        assert!((neighbour.field(10.0).norm() - 2.0).abs() < 1e-9);
        let r = |opening: f64| (neighbour.closed_mm + Vector3::new(opening, 0.0, 0.0)).norm();
        let dipole = 2.0 * (r(10.0) / r(40.0)).powi(3);
        let found = neighbour.field(40.0).norm();
        assert!((found / dipole - 1.0).abs() < 0.1, "{found} {dipole}");
    }

    #[test]
    fn leakage_is_stated_for_ten_amperes() {
        let effects = Effects::new(&["motor_leakage=1".parse().unwrap()], 5, 2, 0.0).unwrap();
        assert!((leakage(&made(), &effects, 5).norm() * 10.0 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_earth_s_field_dips_below_the_horizon_however_the_gripper_is_held() {
        let effects = Effects::new(&["earth_field".parse().unwrap()], 5, 1, 0.0).unwrap();
        let world = earth(&effects, 5);
        let down = -0.48 * libm::sin(60.0_f64.to_radians());
        let on_its_side = Standing {
            angles_rad: [0.0; 3],
            to_world: Rotation3::from_euler_angles(std::f64::consts::FRAC_PI_2, 0.0, 0.0),
            specific_force: Vector3::zeros(),
        };
        assert!((world.norm() - 0.48).abs() < 1e-12 && (world.z - down).abs() < 1e-12);
        // Rolled by a quarter turn, the body's y points up.
        assert!((in_body(world, &on_its_side).y - down).abs() < 1e-12);
    }

    #[test]
    fn phase_currents_turn_seven_times_with_the_motor() {
        let at = |angle_rad| {
            currents(&Drive {
                opening_mm: 0.0,
                angle_rad,
                current_a: 2.0,
            })
        };
        let quarter = std::f64::consts::FRAC_PI_2 / 7.0;
        assert!((at(0.0) - Vector3::new(0.0, 2.0, 2.0)).norm() < 1e-12);
        assert!((at(quarter) - Vector3::new(-2.0, 0.0, 2.0)).norm() < 1e-12);
    }
}

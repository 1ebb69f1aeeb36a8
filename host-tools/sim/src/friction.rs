//! Dry friction: presliding of the flexures (Jenkins elements), Coulomb and Stribeck friction of the drivetrain.

/// Share of the friction force and presliding travel in mm of each element: clamped steel, about a micrometre
/// (assumed).
const ELEMENTS: [(f64, f64); 3] = [(0.5, 0.0002), (0.3, 0.0005), (0.2, 0.001)];

/// Parallel Jenkins elements; their slip forces add up to the friction force.
#[derive(Clone, Debug, PartialEq)]
pub struct JenkinsFriction {
    elements: [Jenkins; 3],
}

/// A spring in series with a slider.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Jenkins {
    slip_n: f64,
    spring_n_per_mm: f64,
    slider_mm: f64,
}

impl JenkinsFriction {
    /// Elements that slip one after another, the last at `force_n`.
    pub fn new(force_n: f64) -> Self {
        Self {
            elements: ELEMENTS.map(|(share, travel_mm)| Jenkins {
                slip_n: share * force_n,
                spring_n_per_mm: share * force_n / travel_mm,
                slider_mm: 0.0,
            }),
        }
    }

    /// Friction force at a displacement in N, and its slope in N/mm.
    pub fn force(&self, at_mm: f64) -> (f64, f64) {
        let mut total = (0.0, 0.0);
        for element in &self.elements {
            let spring = element.spring_n_per_mm * (at_mm - element.slider_mm);
            if spring.abs() < element.slip_n {
                total.1 += element.spring_n_per_mm;
            }
            total.0 += spring.clamp(-element.slip_n, element.slip_n);
        }
        total
    }

    /// Moves the sliders after a step to this displacement.
    pub fn follow(&mut self, at_mm: f64) {
        for element in &mut self.elements {
            if element.spring_n_per_mm > 0.0 {
                let reach = element.slip_n / element.spring_n_per_mm;
                element.slider_mm = element.slider_mm.clamp(at_mm - reach, at_mm + reach);
            }
        }
    }
}

/// Speed after friction that can change it by at max `max`, in the same unit.
///
/// Coulomb friction as an impulse at the end of a step: a reversal stops at zero.
pub fn apply_coulomb(speed: f64, max: f64) -> f64 {
    if speed.abs() > max { speed - max.copysign(speed) } else { 0.0 }
}

/// Friction that falls from breakaway to Coulomb friction as the speed rises (Stribeck), in the Lorentzian
/// form of Hess and Soom (1990).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stribeck {
    /// At rest, in N m.
    pub breakaway_nm: f64,
    /// At speed, in N m.
    pub dry_nm: f64,
    /// Speed of half the decrease, in rad/s.
    pub half_rad_s: f64,
}

impl Stribeck {
    /// Maximum friction torque at this speed, in N m.
    pub fn torque_nm(&self, speed_rad_s: f64) -> f64 {
        let share = speed_rad_s / self.half_rad_s;
        self.dry_nm + (self.breakaway_nm - self.dry_nm) / (1.0 + share * share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sliding_friction_opposes_the_motion() {
        let mut friction = JenkinsFriction::new(2.5);
        for (at, expected) in [(0.1, 2.5), (0.3, 2.5), (0.297, -2.5)] {
            friction.follow(at);
            assert!((friction.force(at).0 - expected).abs() < 1e-9, "{at}");
        }
    }

    #[test]
    fn presliding_friction_is_elastic() {
        let friction = JenkinsFriction::new(2.0);
        let (force, slope) = friction.force(0.0001);
        assert!((force - 0.0001 * slope).abs() < 1e-12 && force < 2.0);
    }

    #[test]
    fn friction_stops_a_motion_and_never_reverses_it() {
        assert_eq!(apply_coulomb(3.0, 1.0), 2.0);
        assert_eq!(apply_coulomb(-3.0, 1.0), -2.0);
        assert_eq!(apply_coulomb(0.9, 1.0), 0.0);
        assert_eq!(apply_coulomb(-1.0, 1.0), 0.0);
    }

    #[test]
    fn stribeck_friction_is_halved_at_its_characteristic_speed() {
        let friction = Stribeck { breakaway_nm: 0.03, dry_nm: 0.02, half_rad_s: 2.0 };
        assert_eq!(friction.torque_nm(0.0), 0.03);
        assert_eq!(friction.torque_nm(-2.0), 0.025);
        assert!((friction.torque_nm(200.0) - 0.02).abs() < 1e-5);
    }
}

//! Dry friction: Jenkins elements, each a spring in series with a slider.

/// Share of the friction and travel before slipping, in mm, of each element. The travels are those
/// of clamped steel, below and about a micrometre (assumed).
const ELEMENTS: [(f64, f64); 3] = [(0.5, 0.0002), (0.3, 0.0005), (0.2, 0.001)];

/// Several elements side by side; together they hold up to the friction force.
#[derive(Clone, Debug, PartialEq)]
pub struct Friction {
    elements: [Jenkins; 3],
}

/// A spring whose other end sits on a slider.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Jenkins {
    slip_n: f64,
    spring_n_per_mm: f64,
    slider_mm: f64,
}

impl Friction {
    /// Elements that slip one after the other, the last at `force_n`.
    pub fn new(force_n: f64) -> Self {
        Self {
            elements: ELEMENTS.map(|(share, travel_mm)| Jenkins {
                slip_n: share * force_n,
                spring_n_per_mm: share * force_n / travel_mm,
                slider_mm: 0.0,
            }),
        }
    }

    /// Force against a displacement in N, and its slope in N/mm.
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

    /// Lets the sliders follow to a displacement that has been reached.
    pub fn follow(&mut self, at_mm: f64) {
        for element in &mut self.elements {
            if element.spring_n_per_mm > 0.0 {
                let reach = element.slip_n / element.spring_n_per_mm;
                element.slider_mm = element.slider_mm.clamp(at_mm - reach, at_mm + reach);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_holds_its_force_against_the_motion_and_turns_with_it() {
        let mut friction = Friction::new(2.5);
        for (at, expected) in [(0.1, 2.5), (0.3, 2.5), (0.297, -2.5)] {
            friction.follow(at);
            assert!((friction.force(at).0 - expected).abs() < 1e-9, "{at}");
        }
    }

    #[test]
    fn before_slipping_friction_is_a_spring() {
        let friction = Friction::new(2.0);
        let (force, slope) = friction.force(0.0001);
        assert!((force - 0.0001 * slope).abs() < 1e-12 && force < 2.0);
    }
}

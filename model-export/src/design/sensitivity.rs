//! How the field answers to a motion of the magnet: S = dB/dX, over the stroke.

use nalgebra::Vector3;

use super::axis::Axis;
use crate::physics::{ForwardModel, State};

/// Points of a stroke from rest to its end.
const POINTS: u32 = 20;

/// S of one axis over its stroke.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensitivity {
    /// The sensor's axis that answers most at rest: 0 to 2 for x, y, z.
    pub component: usize,
    /// S at rest in G/mm, of that component.
    pub rest_g_per_mm: f64,
    /// Least size of S over the stroke, either way, by the greatest; below zero where S changes its sign.
    pub constancy: f64,
}

/// S in G/mm of every component, the magnet displaced by `at_mm` along `direction` and no more.
pub fn slope(model: &ForwardModel, direction: Vector3<f64>, at_mm: f64) -> Vector3<f64> {
    let response = model.respond_in(&model.frames(), &State::displaced(direction * at_mm));
    response.per_mm * direction
}

impl Sensitivity {
    /// Of an axis of a perfectly made design, over `stroke_mm` either way.
    pub fn over(model: &ForwardModel, axis: &Axis, stroke_mm: f64) -> Self {
        let rest = slope(model, axis.direction(), 0.0);
        let component = rest.iamax();
        let sign = rest[component].signum();
        let along = |at_mm: f64| sign * slope(model, axis.direction(), at_mm)[component];
        // By symmetry, or nearly so, what one side shows the other does.
        let points = (0..=POINTS).map(|i| along(stroke_mm * f64::from(i) / f64::from(POINTS)));
        let (least, most) = points.fold((f64::INFINITY, 0.0_f64), |(least, most), slope| {
            (least.min(slope), most.max(slope.abs()))
        });
        Self {
            component,
            rest_g_per_mm: rest[component].abs(),
            constancy: least / most,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::Design;
    use crate::recordings::description::MagnetAxis;

    fn over(design: &Design, stroke_mm: f64) -> Sensitivity {
        let model = ForwardModel::nominal(&design.nominal());
        Sensitivity::over(&model, &Axis::of(design, 0), stroke_mm)
    }

    #[test]
    fn the_gripper_s_own_magnet_has_585_gauss_per_millimetre_and_loses_a_tenth_of_it() {
        // Bx = 584.95 d - 79.99 d^3: 60 of 585 at 0.5 mm.
        let found = over(&Design::magpie(), 0.5);
        assert_eq!(found.component, 0);
        assert!((found.rest_g_per_mm - 585.0).abs() < 0.5);
        assert!((found.constancy - (1.0 - 60.0 / 585.0)).abs() < 2e-3);
    }

    #[test]
    fn a_lying_magnet_is_told_by_the_axis_across_the_gap() {
        let mut design = Design::magpie();
        design.magnet.axis = MagnetAxis::X;
        assert_eq!(over(&design, 0.5).component, 1);
    }

    #[test]
    fn a_field_that_turns_back_has_no_constancy_above_zero() {
        assert!(over(&Design::magpie(), 2.5).constancy < 0.0);
    }
}

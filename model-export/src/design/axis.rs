//! Response of one axis of a design to a force, and its sensitivity S = dB/dX.

use crate::design::beam::{Beam, BeamResponse};
use crate::design::design_file::SensorDesign;
use crate::design::material::Strength;
use crate::physics::{ForwardModel, PhysicalState};
use nalgebra::Vector3;

/// Lateral or longitudinal axis.
#[derive(Clone, Copy, Debug)]
pub struct DesignAxis {
    /// 0 lateral, 1 longitudinal.
    pub number: usize,
    /// Beam.
    pub beam: Beam,
    /// Material.
    pub strength: Strength,
    /// Compliance of the mount in m/N.
    pub mount_m_per_n: f64,
}

/// Response to a force.
#[derive(Clone, Copy, Debug)]
pub struct AxisResponse {
    /// Displacement of the magnet along the force, beam and mount, in mm.
    pub motion_mm: f64,
    /// Tilt of the magnet in rad.
    pub tilt_rad: f64,
    /// Reduction of the gap in mm.
    pub gap_closure_mm: f64,
    /// The beam.
    pub beam: BeamResponse,
}

impl DesignAxis {
    /// Axis 0 (lateral) or 1 (longitudinal) of a design.
    pub fn of(design: &SensorDesign, number: usize) -> Self {
        let strength = design.strength(number);
        Self {
            number,
            beam: design.flexure(number).beam(&strength),
            strength,
            mount_m_per_n: design.mount_m_per_n(number),
        }
    }

    /// Response to a force in N. The beam is along the gap: a tip that moves down closes it (assumed, as in the
    /// effect `tip_slope`).
    pub fn response(&self, force_n: f64) -> AxisResponse {
        let beam = self.beam.bend(force_n);
        AxisResponse {
            motion_mm: 1e3 * (beam.deflection_m + self.mount_m_per_n * force_n),
            tilt_rad: beam.slope_rad,
            gap_closure_mm: 1e3 * beam.shortening_m,
            beam,
        }
    }

    /// Unit vector of the motion, gripper axes.
    pub fn direction(&self) -> Vector3<f64> {
        match self.number {
            0 => Vector3::x(),
            _ => Vector3::z(),
        }
    }

    /// Sensor state for that response.
    pub fn state(&self, moved: &AxisResponse) -> PhysicalState {
        let across = self.direction() * moved.motion_mm;
        let mut state = PhysicalState::displaced(across - Vector3::y() * moved.gap_closure_mm);
        // A motion along x tilts the magnet about z, and vice versa.
        state.extra_tilt_rad[1 - self.number] = moved.tilt_rad;
        state
    }
}

/// Evaluation points of a stroke.
const STROKE_POINTS: u32 = 20;

/// Sensitivity of one axis over its stroke.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensitivity {
    /// Sensor axis with the largest S at rest: 0 to 2 for x, y, z.
    pub component: usize,
    /// S at rest in G/mm, of that component.
    pub rest_g_per_mm: f64,
    /// Minimum of S over the stroke relative to its maximum; negative where S changes sign.
    pub constancy: f64,
}

/// S in G/mm of every component, with the magnet displaced by `at_mm` along `direction`.
pub fn slope(model: &ForwardModel, direction: Vector3<f64>, at_mm: f64) -> Vector3<f64> {
    let response = model.response_at(&model.frames(), &PhysicalState::displaced(direction * at_mm));
    response.per_mm * direction
}

impl Sensitivity {
    /// Of an axis of the nominal design, over `stroke_mm` either way.
    pub fn over(model: &ForwardModel, axis: &DesignAxis, stroke_mm: f64) -> Self {
        let rest = slope(model, axis.direction(), 0.0);
        let component = rest.iamax();
        let sign = rest[component].signum();
        let along = |at_mm: f64| sign * slope(model, axis.direction(), at_mm)[component];
        // Symmetric, or nearly so: one side is enough.
        let points =
            (0..=STROKE_POINTS).map(|i| along(stroke_mm * f64::from(i) / f64::from(STROKE_POINTS)));
        let (min, max) = points.fold((f64::INFINITY, 0.0_f64), |(min, max), slope| {
            (min.min(slope), max.max(slope.abs()))
        });
        Self { component, rest_g_per_mm: rest[component].abs(), constancy: min / max }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::SensorDesign;
    use crate::recordings::description::MagnetAxis;

    fn over(design: &SensorDesign, stroke_mm: f64) -> Sensitivity {
        let model = ForwardModel::nominal(&design.nominal());
        Sensitivity::over(&model, &DesignAxis::of(design, 0), stroke_mm)
    }

    #[test]
    fn magpie_sensitivity_is_585_g_per_mm_and_drops_by_a_tenth() {
        // Bx = 584.95 d - 79.99 d^3: 60 of 585 at 0.5 mm.
        let found = over(&SensorDesign::magpie(), 0.5);
        assert_eq!(found.component, 0);
        assert!((found.rest_g_per_mm - 585.0).abs() < 0.5);
        assert!((found.constancy - (1.0 - 60.0 / 585.0)).abs() < 2e-3);
    }

    #[test]
    fn magnet_along_the_motion_acts_on_the_gap_axis() {
        let mut design = SensorDesign::magpie();
        design.magnet.axis = MagnetAxis::X;
        assert_eq!(over(&design, 0.5).component, 1);
    }

    #[test]
    fn constancy_is_negative_beyond_the_field_maximum() {
        assert!(over(&SensorDesign::magpie(), 2.5).constancy < 0.0);
    }
}

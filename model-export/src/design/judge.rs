//! A design judged: what each axis measures, how finely, and what ends its range.

use super::axis::Axis;
use super::beam::MODERATE_SLOPE_RAD;
use super::design::Design;
use super::limits::Limits;
use super::sensitivity::Sensitivity;
use crate::physics::ForwardModel;

/// A design judged.
#[derive(Clone, Debug)]
pub struct Judged {
    /// The lateral and the longitudinal axis.
    pub axes: [JudgedAxis; 2],
    /// Field at rest in gauss, the greatest component.
    pub rest_g: f64,
}

/// An axis judged.
#[derive(Clone, Copy, Debug)]
pub struct JudgedAxis {
    /// Stiffness at rest in N/mm, beam and mount.
    pub stiffness_n_per_mm: f64,
    /// Stiffness of the beam alone in N/mm.
    pub beam_n_per_mm: f64,
    /// S over the stroke, or over the range where that is shorter.
    pub sensitivity: Sensitivity,
    /// Field for each newton at rest, in G/N.
    pub g_per_n: f64,
    /// What ends the range.
    pub limits: Limits,
    /// Noise of one reading in N.
    pub noise_n: f64,
    /// One count in N.
    pub resolution_n: f64,
    /// Stress by the yield stress at the end of the range.
    pub yield_share: f64,
    /// Lean of the magnet at the end of the range in rad.
    pub lean_rad: f64,
    /// How far the gap closes at the end of the range in mm.
    pub nearer_mm: f64,
}

impl JudgedAxis {
    /// Force that it measures, either sign, in N.
    pub fn range_n(&self) -> f64 {
        self.limits.binding().0
    }

    /// Whether the beam bends further than its equations hold.
    pub fn beyond_von_karman(&self) -> bool {
        self.lean_rad.abs() > MODERATE_SLOPE_RAD
    }

    fn of(design: &Design, model: &ForwardModel, number: usize) -> Self {
        let axis = Axis::of(design, number);
        let limits = Limits::of(design, model, &axis);
        let (range_n, _) = limits.binding();
        let end = axis.under(range_n);
        let stroke_mm = end.motion_mm.min(design.limits.stroke_mm);
        let sensitivity = Sensitivity::over(model, &axis, stroke_mm);
        let stiffness_n_per_mm = design.stiffness_n_per_mm(number);
        let g_per_n = sensitivity.rest_g_per_mm / stiffness_n_per_mm;
        Self {
            stiffness_n_per_mm,
            beam_n_per_mm: design.beam_n_per_mm(number),
            sensitivity,
            g_per_n,
            limits,
            noise_n: design.sensor.noise_gauss / g_per_n,
            resolution_n: design.sensor.gauss_per_lsb / g_per_n,
            yield_share: end.bent.stress_pa() / axis.strength.yield_pa,
            lean_rad: end.lean_rad,
            nearer_mm: end.nearer_mm,
        }
    }
}

impl Judged {
    /// A design judged.
    pub fn of(design: &Design) -> Self {
        let model = ForwardModel::nominal(&design.nominal());
        Self {
            axes: [0, 1].map(|axis| JudgedAxis::of(design, &model, axis)),
            rest_g: model.field([0.0; 2]).amax(),
        }
    }

    /// Whether both axes measure the force that is asked.
    pub fn reaches(&self, force_n: f64) -> bool {
        // A design that was picked for its force has it, but for the digits of its file.
        self.range_n() >= force_n * (1.0 - 1e-3)
    }

    /// Force that both axes measure in N.
    pub fn range_n(&self) -> f64 {
        self.shorter().range_n()
    }

    /// The axis with the lesser range.
    pub fn shorter(&self) -> &JudgedAxis {
        let [x, z] = &self.axes;
        if z.range_n() < x.range_n() { z } else { x }
    }

    /// The axis that answers less to a newton.
    pub fn blunter(&self) -> &JudgedAxis {
        let [x, z] = &self.axes;
        if z.g_per_n < x.g_per_n { z } else { x }
    }
}

//! Evaluation of a design: range and its limits, sensitivity and resolution of each axis.

use crate::design::axis::{DesignAxis, Sensitivity};
use crate::design::beam::MODERATE_SLOPE_RAD;
use crate::design::design_file::SensorDesign;
use crate::physics::ForwardModel;

/// Evaluation of a design.
#[derive(Clone, Debug)]
pub struct DesignEvaluation {
    /// Lateral and longitudinal axis.
    pub axes: [AxisEvaluation; 2],
    /// Maximum component of the field at rest in gauss.
    pub rest_g: f64,
}

/// Evaluation of one axis.
#[derive(Clone, Copy, Debug)]
pub struct AxisEvaluation {
    /// Stiffness at rest in N/mm, beam and mount.
    pub stiffness_n_per_mm: f64,
    /// Stiffness of the beam alone in N/mm.
    pub beam_n_per_mm: f64,
    /// S over the stroke, or over the range where it is shorter.
    pub sensitivity: Sensitivity,
    /// Sensitivity at rest in G/N.
    pub g_per_n: f64,
    /// Limits of the range.
    pub limits: RangeLimits,
    /// Noise of one reading in N.
    pub noise_n: f64,
    /// Force of one count in N.
    pub resolution_n: f64,
    /// Stress relative to yield at the end of the range.
    pub yield_share: f64,
    /// Tilt of the magnet at the end of the range in rad.
    pub tilt_rad: f64,
    /// Reduction of the gap at the end of the range in mm.
    pub gap_closure_mm: f64,
}

impl AxisEvaluation {
    /// Measurable force, either sign, in N.
    pub fn range_n(&self) -> f64 {
        self.limits.binding().0
    }

    /// Whether the force changes the field by more than its noise within the range: not along the axis of a lying magnet.
    pub fn is_measurable(&self) -> bool {
        self.noise_n.abs() <= self.range_n()
    }

    /// Whether the slope exceeds the validity of the beam equations.
    pub fn exceeds_beam_model(&self) -> bool {
        self.tilt_rad.abs() > MODERATE_SLOPE_RAD
    }

    fn of(design: &SensorDesign, model: &ForwardModel, number: usize) -> Self {
        let axis = DesignAxis::of(design, number);
        let limits = RangeLimits::of(design, model, &axis);
        let (range_n, _) = limits.binding();
        let end = axis.response(range_n);
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
            yield_share: end.beam.stress_pa() / axis.strength.yield_pa,
            tilt_rad: end.tilt_rad,
            gap_closure_mm: end.gap_closure_mm,
        }
    }
}

impl DesignEvaluation {
    /// A design evaluation.
    pub fn of(design: &SensorDesign) -> Self {
        let model = ForwardModel::nominal(&design.nominal());
        Self {
            axes: [0, 1].map(|axis| AxisEvaluation::of(design, &model, axis)),
            rest_g: model.field([0.0; 2]).amax(),
        }
    }

    /// Whether both axes measure `force_n`.
    pub fn covers_range(&self, force_n: f64) -> bool {
        // An optimised design meets its force up to rounding in the file.
        self.axes.iter().all(AxisEvaluation::is_measurable)
            && self.range_n() >= force_n * (1.0 - 1e-3)
    }

    /// Force that both axes bear and, where they are measurable, measure, in N.
    pub fn range_n(&self) -> f64 {
        self.limiting_axis().range_n()
    }

    /// The axis with the smaller range.
    pub(crate) fn limiting_axis(&self) -> &AxisEvaluation {
        let [x, z] = &self.axes;
        if z.range_n() < x.range_n() { z } else { x }
    }

    /// The axis with the lower sensitivity.
    pub(crate) fn least_sensitive_axis(&self) -> &AxisEvaluation {
        let [x, z] = &self.axes;
        if z.g_per_n < x.g_per_n { z } else { x }
    }
}

/// Cause of the end of a range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RangeLimit {
    /// Yield, with the required safety factor.
    Yield,
    /// Fatigue before the required life, with the same safety factor.
    Fatigue,
    /// Mechanical stop.
    Stroke,
    /// Saturation of the Hall sensor.
    SensorRange,
    /// The field is no longer monotonic in the motion: two forces have one field.
    Fold,
    /// Collision of the magnet with the sensor's package.
    Collision,
}

impl RangeLimit {
    /// All causes, in the order of [`RangeLimits`].
    pub const ALL: [Self; 6] =
        [Self::Yield, Self::Fatigue, Self::Stroke, Self::SensorRange, Self::Fold, Self::Collision];

    /// Name for reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Yield => "yield",
            Self::Fatigue => "fatigue",
            Self::Stroke => "stroke",
            Self::SensorRange => "sensor range",
            Self::Fold => "field turns back",
            Self::Collision => "collision",
        }
    }

    /// Remedy for reports.
    pub fn remedy(self) -> &'static str {
        match self {
            Self::Yield | Self::Fatigue => {
                "a longer and thicker beam, a stronger material, less safety or life"
            }
            Self::Stroke => "a stiffer beam, or a longer stroke",
            Self::SensorRange => "a wider gap, or a smaller magnet",
            Self::Fold => "a stiffer beam, a shorter stroke, a wider magnet or a wider gap",
            Self::Collision => "a wider gap, a longer beam, or a shorter stroke",
        }
    }
}

/// Force in N at which each cause ends the range; infinite where far beyond the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeLimits {
    /// In the order of [`RangeLimit::ALL`].
    pub force_n: [f64; 6],
}

/// Field evaluations up to the nearest mechanical limit.
const POINTS: u32 = 16;

/// Bisection steps: 1e-9 of the force.
const BISECTIONS: u32 = 30;

impl RangeLimits {
    /// Limits of one axis, with the other at rest. Field limits assume maximum remanence and minimum gap within
    /// tolerances, the collision minimum gap.
    pub fn of(design: &SensorDesign, model: &ForwardModel, axis: &DesignAxis) -> Self {
        let asked = design.limits;
        let allowed = |stress_pa: f64| stress_pa / asked.safety;
        let yields = allowed(axis.strength.yield_pa);
        let tires = allowed(axis.strength.fatigue_pa(asked.life_cycles));
        let clearance_mm = design.gap_mm - design.tolerances.gap_mm - design.sensor.package_mm;
        let reach_mm = model.magnet.half_width_mm();
        // Utilisation of each limit, non-decreasing in the force.
        let yielded = |force_n: f64| axis.beam.bend(force_n).stress_pa() / yields;
        let tired = |force_n: f64| axis.beam.bend(force_n).reversed_pa() / tires;
        let moved = |force_n: f64| axis.response(force_n).motion_mm / asked.stroke_mm;
        let closed = |force_n: f64| {
            let moved = axis.response(force_n);
            (moved.gap_closure_mm + reach_mm * moved.tilt_rad.abs()) / clearance_mm
        };
        let collision = if clearance_mm > 0.0 { force_at_limit(axis, closed) } else { 0.0 };
        let [yields, tires, stroke] = [
            force_at_limit(axis, yielded),
            force_at_limit(axis, tired),
            force_at_limit(axis, moved),
        ];
        let mechanical = yields.min(tires).min(stroke).min(collision);
        let [range, fold] = field_limits(design, model, axis, mechanical);
        Self { force_n: [yields, tires, stroke, range, fold, collision] }
    }

    /// Range in N and its cause.
    pub fn binding(&self) -> (f64, RangeLimit) {
        let limits = self.force_n.into_iter().zip(RangeLimit::ALL);
        limits.min_by(|(a, _), (b, _)| a.total_cmp(b)).unwrap_or((0.0, RangeLimit::Yield))
    }

    /// Causes within `share` beyond the range, nearest first.
    pub fn near(&self, share: f64) -> Vec<(f64, RangeLimit)> {
        let (range_n, _) = self.binding();
        let limits = self.force_n.into_iter().zip(RangeLimit::ALL);
        let mut near: Vec<_> =
            limits.filter(|(force_n, _)| *force_n <= (1.0 + share) * range_n).collect();
        near.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        near
    }
}

/// Force in N at which a non-decreasing utilisation reaches one; infinite if out of reach.
fn force_at_limit(axis: &DesignAxis, share: impl Fn(f64) -> f64) -> f64 {
    // Start: a deflection of one micrometre.
    let mut high_n = 1e-6 * axis.beam.stiffness_n_per_m();
    let mut low_n = 0.0;
    for _ in 0..40 {
        if share(high_n) >= 1.0 {
            return bisect(low_n, high_n, |force_n| share(force_n) >= 1.0);
        }
        (low_n, high_n) = (high_n, 2.0 * high_n);
    }
    f64::INFINITY
}

/// Onset of a condition between two forces.
fn bisect(mut low_n: f64, mut high_n: f64, beyond: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..BISECTIONS {
        let middle_n = 0.5 * (low_n + high_n);
        if beyond(middle_n) { high_n = middle_n } else { low_n = middle_n }
    }
    0.5 * (low_n + high_n)
}

/// Forces up to `max_n` at which the sensor saturates and the field turns back, either sign.
fn field_limits(
    design: &SensorDesign,
    model: &ForwardModel,
    axis: &DesignAxis,
    max_n: f64,
) -> [f64; 2] {
    let tolerances = design.tolerances;
    let worst = ForwardModel {
        gap_mm: model.gap_mm - tolerances.gap_mm,
        remanence_t: model.remanence_t * (1.0 + tolerances.remanence),
        ..*model
    };
    let frames = worst.frames();
    let at = |force_n: f64| axis.state(&axis.response(force_n));
    let saturated = |force_n: f64| {
        let reads = |force_n: f64| worst.field_at(&frames, &at(force_n)).amax();
        reads(force_n).max(reads(-force_n)) >= design.sensor.range_gauss
    };
    let rest = worst.response_at(&frames, &at(0.0)).per_mm * axis.direction();
    let component = rest.iamax();
    let turned = |force_n: f64| {
        let slope = worst.response_at(&frames, &at(force_n)).per_mm * axis.direction();
        slope[component] * rest[component] <= 0.0
    };
    [onset(max_n, &saturated), onset(max_n, &turned)]
}

/// First force at which a condition holds, searched in steps.
fn onset(max_n: f64, holds: &dyn Fn(f64) -> bool) -> f64 {
    if holds(0.0) {
        return 0.0;
    }
    let step_n = max_n / f64::from(POINTS);
    for i in 1..=POINTS {
        let high_n = step_n * f64::from(i);
        if holds(high_n) {
            return bisect(high_n - step_n, high_n, holds);
        }
    }
    f64::INFINITY
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::beam::Support;
    use crate::recordings::description::MagnetShape;

    fn limits(design: &SensorDesign, axis: usize) -> RangeLimits {
        let model = ForwardModel::nominal(&design.nominal());
        RangeLimits::of(design, &model, &DesignAxis::of(design, axis))
    }

    fn of(limits: &RangeLimits, cause: RangeLimit) -> f64 {
        let place = RangeLimit::ALL.iter().position(|one| *one == cause).unwrap();
        limits.force_n[place]
    }

    fn near(found: f64, expected: f64) {
        assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
    }

    #[test]
    fn magpie_limits_equal_hand_calculations() {
        let design = SensorDesign::magpie();
        let [lateral, longitudinal] = [0, 1].map(|axis| limits(&design, axis));
        // 0.5 mm at 500 and at 800 N/mm.
        near(of(&lateral, RangeLimit::Stroke), 250.0);
        near(of(&longitudinal, RangeLimit::Stroke), 400.0);
        // b t^2 / 6 L = 2.083 mm^2: of 1170 MPa, and of 2070 (2 10^7)^-0.074 = 597, by 1.5.
        near(of(&lateral, RangeLimit::Yield), 1625.0);
        near(of(&lateral, RangeLimit::Fatigue), 828.9);
        // 0.6 w^2 / L + 1.5 mm * 1.5 w / L = 1 mm where the beam bends by 5.44 mm, at 3403 N/mm.
        near(of(&lateral, RangeLimit::Collision), 18_514.0);
        assert_eq!(of(&lateral, RangeLimit::SensorRange), f64::INFINITY);
        assert_eq!(of(&lateral, RangeLimit::Fold), f64::INFINITY);
        assert_eq!(lateral.binding().1, RangeLimit::Stroke);
    }

    #[test]
    fn saturation_at_rest_gives_zero_range() {
        // 2000 G are at 1.02 mm: the tolerance may close 1.05 mm to 0.95.
        let mut design = SensorDesign::magpie();
        design.gap_mm = 1.05;
        assert_eq!(limits(&design, 0).binding(), (0.0, RangeLimit::SensorRange));
        design.gap_mm = 1.3;
        assert_eq!(of(&limits(&design, 0), RangeLimit::SensorRange), f64::INFINITY);
    }

    #[test]
    fn small_magnet_folds_before_the_end_of_its_stroke() {
        let mut design = SensorDesign::magpie();
        design.magnet.shape = MagnetShape::Cylinder { diameter_mm: 2.0, length_mm: 2.0 };
        design.limits.stroke_mm = 2.0;
        design.stiffness_x_n_per_mm = Some(50.0);
        let limits = limits(&design, 0);
        let fold_mm = of(&limits, RangeLimit::Fold) / 50.0;
        // A dipole's field off its axis turns back at half the distance: about 1.2 mm of 2.4.
        assert!((0.9..1.5).contains(&fold_mm), "{fold_mm}");
        assert_eq!(limits.binding().1, RangeLimit::Fold);
    }

    #[test]
    fn closed_gap_gives_zero_collision_force() {
        let mut design = SensorDesign::magpie();
        design.gap_mm = 0.5;
        assert_eq!(of(&limits(&design, 0), RangeLimit::Collision), 0.0);
    }

    #[test]
    fn clamped_beam_keeps_the_gap_and_is_stronger() {
        let mut design = SensorDesign::magpie();
        design.stiffness_x_n_per_mm = None;
        let free = limits(&design, 0);
        design.flexure_x.support = Support::ClampedClamped;
        let clamped = limits(&design, 0);
        assert_eq!(of(&clamped, RangeLimit::Collision), f64::INFINITY);
        // The moment at its clamps is an eighth of F L.
        let gain = of(&clamped, RangeLimit::Yield) / of(&free, RangeLimit::Yield);
        assert!((7.0..8.2).contains(&gain), "{gain}");
    }

    #[test]
    fn nearby_limits_are_sorted_by_force() {
        let limits = RangeLimits { force_n: [105.0, 100.0, 109.0, 300.0, f64::INFINITY, 120.0] };
        let causes: Vec<RangeLimit> = limits.near(0.1).iter().map(|(_, cause)| *cause).collect();
        assert_eq!(causes, [RangeLimit::Fatigue, RangeLimit::Yield, RangeLimit::Stroke]);
    }
}

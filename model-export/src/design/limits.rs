//! How much force an axis measures, and what ends its range.

use super::axis::Axis;
use super::design::Design;
use crate::physics::ForwardModel;

/// What ends a range.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Cause {
    /// The material yields, with the safety that is asked.
    Yield,
    /// The material tires before the life that is asked, with the same safety.
    Fatigue,
    /// The stop of the stroke.
    Stroke,
    /// A component of the field leaves the sensor's range.
    SensorRange,
    /// The field no longer grows with the motion: two forces have one field.
    Fold,
    /// The magnet touches the sensor's package.
    Collision,
}

impl Cause {
    /// All of them, in the order of [`Limits`].
    pub const ALL: [Self; 6] = [
        Self::Yield,
        Self::Fatigue,
        Self::Stroke,
        Self::SensorRange,
        Self::Fold,
        Self::Collision,
    ];

    /// In words.
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

    /// What moves it, in words.
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

/// Forces in N at which each of [`Cause::ALL`] ends the range; infinite where others come long before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// In the order of [`Cause::ALL`].
    pub force_n: [f64; 6],
}

/// Points from rest to the nearest mechanical limit at which the field is looked at.
const POINTS: u32 = 16;

/// Steps of a halving: a billionth of the force.
const HALVINGS: u32 = 30;

impl Limits {
    /// Of one axis, the other at rest. The field is judged with the magnet as strong and as near as the
    /// tolerances allow, the collision with it as near.
    pub fn of(design: &Design, model: &ForwardModel, axis: &Axis) -> Self {
        let asked = design.limits;
        let allowed = |stress_pa: f64| stress_pa / asked.safety;
        let yields = allowed(axis.strength.yield_pa);
        let tires = allowed(axis.strength.fatigue_pa(asked.life_cycles));
        let near_mm = design.gap_mm - design.tolerances.gap_mm - design.sensor.package_mm;
        let reach_mm = model.magnet.half_width_mm();
        // Shares of each limit that a force takes up; they never fall with the force.
        let yielded = |force_n: f64| axis.beam.bend(force_n).stress_pa() / yields;
        let tired = |force_n: f64| axis.beam.bend(force_n).reversed_pa() / tires;
        let moved = |force_n: f64| axis.under(force_n).motion_mm / asked.stroke_mm;
        let closed = |force_n: f64| {
            let moved = axis.under(force_n);
            (moved.nearer_mm + reach_mm * moved.lean_rad.abs()) / near_mm
        };
        let collision = match near_mm > 0.0 {
            true => first(axis, closed),
            false => 0.0,
        };
        let [yields, tires, stroke] =
            [first(axis, yielded), first(axis, tired), first(axis, moved)];
        let mechanical = yields.min(tires).min(stroke).min(collision);
        let [range, fold] = field(design, model, axis, mechanical);
        Self {
            force_n: [yields, tires, stroke, range, fold, collision],
        }
    }

    /// The force at which the range ends, in N, and why.
    pub fn binding(&self) -> (f64, Cause) {
        let limits = self.force_n.into_iter().zip(Cause::ALL);
        limits
            .min_by(|(a, _), (b, _)| a.total_cmp(b))
            .unwrap_or((0.0, Cause::Yield))
    }

    /// Every cause that ends it within `share` of the range, the nearest first.
    pub fn near(&self, share: f64) -> Vec<(f64, Cause)> {
        let (range_n, _) = self.binding();
        let limits = self.force_n.into_iter().zip(Cause::ALL);
        let mut near: Vec<_> = limits
            .filter(|(force_n, _)| *force_n <= (1.0 + share) * range_n)
            .collect();
        near.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        near
    }
}

/// The force in N at which a share that never falls reaches one; infinite where it does not within any
/// force that matters.
fn first(axis: &Axis, share: impl Fn(f64) -> f64) -> f64 {
    // A micrometre of the beam's own deflection to begin with.
    let mut high_n = 1e-6 * axis.beam.stiffness_n_per_m();
    let mut low_n = 0.0;
    for _ in 0..40 {
        if share(high_n) >= 1.0 {
            return halve(low_n, high_n, |force_n| share(force_n) >= 1.0);
        }
        (low_n, high_n) = (high_n, 2.0 * high_n);
    }
    f64::INFINITY
}

/// Where a condition begins between two forces.
fn halve(mut low_n: f64, mut high_n: f64, beyond: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..HALVINGS {
        let middle_n = 0.5 * (low_n + high_n);
        match beyond(middle_n) {
            true => high_n = middle_n,
            false => low_n = middle_n,
        }
    }
    0.5 * (low_n + high_n)
}

/// Forces up to `most_n` at which the sensor's range is left and the field turns back, either sign.
fn field(design: &Design, model: &ForwardModel, axis: &Axis, most_n: f64) -> [f64; 2] {
    let tolerances = design.tolerances;
    let worst = ForwardModel {
        gap_mm: model.gap_mm - tolerances.gap_mm,
        remanence_t: model.remanence_t * (1.0 + tolerances.remanence),
        ..*model
    };
    let frames = worst.frames();
    let at = |force_n: f64| axis.state(&axis.under(force_n));
    let saturated = |force_n: f64| {
        let reads = |force_n: f64| worst.field_in(&frames, &at(force_n)).amax();
        reads(force_n).max(reads(-force_n)) >= design.sensor.range_gauss
    };
    let rest = worst.respond_in(&frames, &at(0.0)).per_mm * axis.direction();
    let component = rest.iamax();
    let turned = |force_n: f64| {
        let slope = worst.respond_in(&frames, &at(force_n)).per_mm * axis.direction();
        slope[component] * rest[component] <= 0.0
    };
    [begins(most_n, &saturated), begins(most_n, &turned)]
}

/// The first force at which a condition holds, looked for in steps.
fn begins(most_n: f64, holds: &dyn Fn(f64) -> bool) -> f64 {
    if holds(0.0) {
        return 0.0;
    }
    let step_n = most_n / f64::from(POINTS);
    for i in 1..=POINTS {
        let high_n = step_n * f64::from(i);
        if holds(high_n) {
            return halve(high_n - step_n, high_n, holds);
        }
    }
    f64::INFINITY
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::beam::Support;
    use crate::recordings::description::Shape;

    fn limits(design: &Design, axis: usize) -> Limits {
        let model = ForwardModel::nominal(&design.nominal());
        Limits::of(design, &model, &Axis::of(design, axis))
    }

    fn of(limits: &Limits, cause: Cause) -> f64 {
        let place = Cause::ALL.iter().position(|one| *one == cause).unwrap();
        limits.force_n[place]
    }

    fn near(found: f64, expected: f64) {
        assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
    }

    #[test]
    fn the_gripper_s_own_limits_are_those_worked_by_hand() {
        let design = Design::magpie();
        let [lateral, longitudinal] = [0, 1].map(|axis| limits(&design, axis));
        // 0.5 mm at 500 and at 800 N/mm.
        near(of(&lateral, Cause::Stroke), 250.0);
        near(of(&longitudinal, Cause::Stroke), 400.0);
        // b t^2 / 6 L = 2.083 mm^2: of 1170 MPa, and of 2070 (2 10^7)^-0.074 = 597, by 1.5.
        near(of(&lateral, Cause::Yield), 1625.0);
        near(of(&lateral, Cause::Fatigue), 828.9);
        // 0.6 w^2 / L + 1.5 mm * 1.5 w / L = 1 mm where the beam bends by 5.44 mm, at 3403 N/mm.
        near(of(&lateral, Cause::Collision), 18_514.0);
        assert_eq!(of(&lateral, Cause::SensorRange), f64::INFINITY);
        assert_eq!(of(&lateral, Cause::Fold), f64::INFINITY);
        assert_eq!(lateral.binding().1, Cause::Stroke);
    }

    #[test]
    fn a_magnet_that_may_saturate_the_sensor_at_rest_leaves_no_range() {
        // 2000 G are at 1.02 mm: the tolerance may close 1.05 mm to 0.95.
        let mut design = Design::magpie();
        design.gap_mm = 1.05;
        assert_eq!(limits(&design, 0).binding(), (0.0, Cause::SensorRange));
        design.gap_mm = 1.3;
        assert_eq!(of(&limits(&design, 0), Cause::SensorRange), f64::INFINITY);
    }

    #[test]
    fn a_small_magnet_that_moves_far_folds_before_its_stroke_ends() {
        let mut design = Design::magpie();
        design.magnet.shape = Shape::Cylinder {
            diameter_mm: 2.0,
            length_mm: 2.0,
        };
        design.limits.stroke_mm = 2.0;
        design.stiffness_x_n_per_mm = Some(50.0);
        let limits = limits(&design, 0);
        let fold_mm = of(&limits, Cause::Fold) / 50.0;
        // A dipole's field beside its axis turns back at half the distance: about 1.2 mm of 2.4.
        assert!((0.9..1.5).contains(&fold_mm), "{fold_mm}");
        assert_eq!(limits.binding().1, Cause::Fold);
    }

    #[test]
    fn a_closed_gap_collides_at_once() {
        let mut design = Design::magpie();
        design.gap_mm = 0.5;
        assert_eq!(of(&limits(&design, 0), Cause::Collision), 0.0);
    }

    #[test]
    fn a_held_beam_neither_closes_the_gap_nor_bears_less_than_a_free_one() {
        let mut design = Design::magpie();
        design.stiffness_x_n_per_mm = None;
        let free = limits(&design, 0);
        design.flexure_x.support = Support::ClampedClamped;
        let held = limits(&design, 0);
        assert_eq!(of(&held, Cause::Collision), f64::INFINITY);
        // The moment at its clamps is an eighth of F L.
        let gain = of(&held, Cause::Yield) / of(&free, Cause::Yield);
        assert!((7.0..8.2).contains(&gain), "{gain}");
    }

    #[test]
    fn what_is_close_behind_is_told_in_order() {
        let limits = Limits {
            force_n: [105.0, 100.0, 109.0, 300.0, f64::INFINITY, 120.0],
        };
        let causes: Vec<Cause> = limits.near(0.1).iter().map(|(_, cause)| *cause).collect();
        assert_eq!(causes, [Cause::Fatigue, Cause::Yield, Cause::Stroke]);
    }
}

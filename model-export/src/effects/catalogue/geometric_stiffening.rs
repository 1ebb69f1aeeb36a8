//! Geometric stiffening of a flexure clamped at both ends.

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec,
    SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

/// Reference deflection of the magnitude in mm: the travel in the paper.
const REFERENCE_MM: f64 = 0.5;

pub const EFFECT: Effect = Effect {
    id: "geometric_stiffening",
    stage: EffectStage::Displacement,
    physics: "A flexure clamped at both ends elongates when it bends. The membrane tension increases with the \
              square of the deflection and stiffens the flexure: a beam of thickness t gains 0.75 (w/t)^2 \
              of its stiffness at a deflection w. A cantilever with a free end has no membrane tension. A \
              negative magnitude is a softening.",
    equation: "F = k w (1 + s (w / 0.5 mm)^2)",
    regressors: "dB/dF times F^3, each flexure",
    needs: &[],
    plot_against: &["fx_n", "fz_n"],
    parameters: &[
        EffectParameter::coefficient("stiffening_x", "%", 5.0),
        EffectParameter::coefficient("stiffening_z", "%", 5.0),
    ],
    size: MagnitudeSpec {
        description: "stiffness gained at 0.5 mm",
        unit: "%",
        typical: 5.0,
        plausible: (0.0, 40.0),
        possible: (-50.0, 200.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Load each flexure slowly over its whole range, both signs, one at a time.",
    confused_with: &[
        ("hard_stop", "where the load barely exceeds the knee"),
        ("sensor_compression", "where the field along the gap increases with the load"),
        ("tip_slope", "where both axes are always loaded together"),
    ],
    similar_outside: "a reference that is not linear",
    signatures: &[],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 0,
        range: (-20.0, 100.0),
        meaning: "growth of both flexures' stiffness at 0.5 mm",
        shared: false,
    }),
    device: DeviceForm::Tables,
    is_transient: false,
    has_memory: false,
    time: TimeDependence::None,
    reads: EffectStage::DISPLACEMENTS,
    apply,
};

fn apply(values: &[f64], _: &ExcitationSeries, series: &mut StateSeries) {
    let &[x, z] = values else { return };
    for state in &mut series.states {
        let d = &mut state.displacement_mm;
        d.x = deflection(d.x, 0.01 * x);
        d.z = deflection(d.z, 0.01 * z);
    }
}

/// Deflection of the stiffening flexure under a force that deflects the linear one by `linear_mm` (Newton's method).
fn deflection(linear_mm: f64, stiffening: f64) -> f64 {
    let mut w = linear_mm;
    for _ in 0..20 {
        let relative = stiffening * (w / REFERENCE_MM).powi(2);
        // A buckling flexure has no unique deflection: bound the derivative.
        let step = (w * (1.0 + relative) - linear_mm) / (1.0 + 3.0 * relative).max(0.1);
        w -= step;
        if step.abs() < 1e-12 {
            break;
        }
    }
    w
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deflection_solves_the_cubic_equation() {
        // s = 20 %: the force at 0.5 mm is that of the linear flexure at 0.5 * 1.2 mm.
        assert!((deflection(0.6, 0.2) - 0.5).abs() < 1e-12);
        assert!((deflection(-0.6, 0.2) + 0.5).abs() < 1e-12);
        assert_eq!(deflection(0.3, 0.0), 0.3);
    }
}

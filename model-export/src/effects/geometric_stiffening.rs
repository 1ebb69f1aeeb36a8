//! A flexure held at both ends stretches as it bends, and stiffens.

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The deflection at which the size is stated, in mm: the paper's travel.
const AT_MM: f64 = 0.5;

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "geometric_stiffening",
    stage: Stage::Displacement,
    physics: "A flexure that is held at both ends cannot bend without also getting longer. The stretched \
              beam pulls like a string, and this pull grows with the square of the deflection: the flexure \
              gets stiffer the further it moves. A beam of thickness t gains 0.75 (w/t)^2 of its stiffness \
              at a deflection w; a cantilever with a free end does not stretch and shows none of this. A \
              negative size means that it softens.",
    equation: "F = k w (1 + s (w / 0.5 mm)^2)",
    regressors: "dB/dF times F^3, each flexure",
    needs: &[],
    shows_against: &["fx_n", "fz_n"],
    parameters: &[
        Parameter::coefficient("stiffening_x", "%", 5.0),
        Parameter::coefficient("stiffening_z", "%", 5.0),
    ],
    size: Size {
        words: "stiffness gained at 0.5 mm",
        unit: "%",
        first: 0,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 5.0,
        plausible: (0.0, 40.0),
        possible: (-50.0, 200.0),
    },
    record: "Load each flexure slowly over its whole range, both signs, one at a time.",
    confused_with: &[
        ("hard_stop", "where the load hardly goes beyond the knee"),
        (
            "sensor_compression",
            "where the field along the gap grows with the load",
        ),
        (
            "tip_slope",
            "where the loads of both axes always come together",
        ),
    ],
    undone: Undone::Tables,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], _: &Track, series: &mut Series) {
    let &[x, z] = values else { return };
    for state in &mut series.states {
        let d = &mut state.displacement_mm;
        d.x = deflection(d.x, 0.01 * x);
        d.z = deflection(d.z, 0.01 * z);
    }
}

/// The deflection of a stiffening flexure where a linear one would deflect by `linear_mm`.
fn deflection(linear_mm: f64, stiffening: f64) -> f64 {
    let mut w = linear_mm;
    for _ in 0..20 {
        let relative = stiffening * (w / AT_MM).powi(2);
        // A flexure that softens so much that it buckles has no single deflection: stay finite.
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
    fn the_deflection_solves_the_cubic() {
        // 0.5 mm needs as much force as a linear flexure at 0.5 * 1.2 mm, where s is 20 %.
        assert!((deflection(0.6, 0.2) - 0.5).abs() < 1e-12);
        assert!((deflection(-0.6, 0.2) + 0.5).abs() < 1e-12);
        assert_eq!(deflection(0.3, 0.0), 0.3);
    }
}

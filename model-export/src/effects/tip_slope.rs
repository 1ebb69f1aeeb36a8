//! A bent flexure gets shorter and its tip leans.

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The deflection at which the size is stated, in mm: the paper's travel.
const AT_MM: f64 = 0.5;

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "tip_slope",
    stage: Stage::Displacement,
    physics: "The tip of a bent cantilever does not move on a straight line. It comes down a little, since \
              the arc is as long as the straight beam was (0.6 w^2 / L for a load at the tip), and it \
              leans by the slope 1.5 w / L. The magnet follows both: it moves along the gap, which the \
              sensor sees best of all, and its axis turns. The shift is even in the load, pushing or \
              pulling alike, and so shows in the gap axis where the forces themselves hardly do.",
    equation: "dy = -s (w / 0.5 mm)^2, lean = a (w / 0.5 mm); s = 0.6 (0.5 mm)^2 / L, a = 1.5 (0.5 mm) / L",
    regressors: "dB/dy times F^2, and the answer to a lean times F",
    needs: &[],
    shows_against: &["fx_n", "fz_n"],
    parameters: &[
        Parameter::coefficient("shortening_x", "um", 5.0),
        Parameter::coefficient("shortening_z", "um", 5.0),
        Parameter::coefficient("lean_x", "deg", 0.3),
        Parameter::coefficient("lean_z", "deg", 0.3),
    ],
    size: Size {
        words: "foreshortening at 0.5 mm",
        unit: "um",
        first: 2,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 5.0,
        plausible: (-30.0, 30.0),
        possible: (-250.0, 250.0),
    },
    record: "Load each flexure slowly over its whole range, both signs, one at a time.",
    confused_with: &[
        ("sensor_compression", "both are even in the load"),
        (
            "geometric_stiffening",
            "where only one sign of the load was recorded",
        ),
    ],
    undone: Undone::Tables,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], _: &Track, series: &mut Series) {
    let &[shortening_x, shortening_z, lean_x, lean_z] = values else {
        return;
    };
    for state in &mut series.states {
        let [x, z] = [state.displacement_mm.x, state.displacement_mm.z].map(|w| w / AT_MM);
        state.displacement_mm.y -= 1e-3 * (shortening_x * x * x + shortening_z * z * z);
        // Moving along x leans the axis about z, and the other way round.
        state.lean_rad[0] += (lean_z * z).to_radians();
        state.lean_rad[1] += (lean_x * x).to_radians();
    }
}

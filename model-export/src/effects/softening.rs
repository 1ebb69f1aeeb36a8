//! The flexure gets softer over its first load cycles.

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "softening",
    stage: Stage::Flexure,
    physics: "New polymer flexures and glued joints run in: over the first tens of cycles molecules and \
              surfaces settle, and the same force moves the finger further. It does not come back \
              overnight. Metals do not show it. A printed TPU lattice lost 6.5 % of its stiffness.",
    equation: "F' = F (1 + c (1 - exp(-n / N))), n load cycles since the campaign began",
    regressors: "dB/dF times F times the share run in",
    needs: &[],
    shows_against: &["session_s"],
    parameters: &[
        Parameter::coefficient("softening_x", "%", 3.0),
        Parameter::coefficient("softening_z", "%", 3.0),
        Parameter::shape("cycles", "", &[2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0]),
    ],
    size: Size {
        words: "compliance gained in the end",
        unit: "%",
        first: 2,
        of: SizeOf::Largest,
        factor: 1.0,
        resolution: 0.0,
        typical: 3.0,
        plausible: (-10.0, 20.0),
        possible: (-90.0, 500.0),
    },
    record: "Cycle a new flexure at least fifty times with the same load, recording from the very first.",
    confused_with: &[
        ("creep", "both grow under load"),
        (
            "demagnetisation",
            "the field weakens against stiffness, recording by recording",
        ),
        ("magnet_temperature", "where it warms up meanwhile"),
    ],
    undone: Undone::Settled,
    lives_in_one_recording: true,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let &[softening_x, softening_z, cycles] = values else {
        return;
    };
    for (axis, softening) in [(0, softening_x), (1, softening_z)] {
        let run_in = |row: usize| 1.0 - libm::exp(-track.cycles[row][axis] / cycles);
        for (row, force) in series.force_n.iter_mut().enumerate() {
            force[axis] *= 1.0 + 0.01 * softening * run_in(row);
        }
    }
}

//! A foreign magnet passes by, or is put down.

use nalgebra::Vector3;

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// Expected of a passage beside a step: the fit allows ten times this unless the data say more. Without it, a
/// step between two rows leaves the three shapes of a passage free to go anywhere in between.
const PASSING_G: f64 = 0.5;

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "external_magnet",
    stage: Stage::Outside,
    physics: "A screwdriver, a loudspeaker, a magnetic base: anything magnetic that comes near adds its \
              field to that of every sensor at once, for as long as it is there. A dipole on a straight \
              path gives a curve with three shapes, whatever its direction; one that is put down and stays \
              leaves a step. Two forces cannot explain a change of three field axes, which is how the \
              device may notice.",
    equation: "B + (a + b u + c u^2) / (1 + u^2)^(5/2) + d step(u), u = (t - t0) / width; B + e in later recordings",
    regressors: "the three shapes of a passing dipole, a step, and what is left of it in later recordings, each axis",
    needs: &[],
    shows_against: &["session_s"],
    parameters: &[
        Parameter::coefficient("near_x", "G", PASSING_G),
        Parameter::coefficient("near_y", "G", PASSING_G),
        Parameter::coefficient("near_z", "G", PASSING_G),
        Parameter::coefficient("tilt_x", "G", PASSING_G),
        Parameter::coefficient("tilt_y", "G", PASSING_G),
        Parameter::coefficient("tilt_z", "G", PASSING_G),
        Parameter::coefficient("far_x", "G", PASSING_G),
        Parameter::coefficient("far_y", "G", PASSING_G),
        Parameter::coefficient("far_z", "G", PASSING_G),
        Parameter::coefficient("stay_x", "G", 5.0),
        Parameter::coefficient("stay_y", "G", 5.0),
        Parameter::coefficient("stay_z", "G", 5.0),
        Parameter::coefficient("later_x", "G", 5.0),
        Parameter::coefficient("later_y", "G", 5.0),
        Parameter::coefficient("later_z", "G", 5.0),
        Parameter::instant("at", "s"),
        Parameter::shape("width", "s", &[0.1, 0.25, 0.6, 1.5, 4.0]),
    ],
    size: Size {
        words: "field at its closest",
        unit: "G",
        first: 0,
        of: SizeOf::Greatest(peak),
        factor: 1.0,
        resolution: 0.0,
        typical: 5.0,
        plausible: (0.0, 500.0),
        possible: (0.0, 20000.0),
    },
    record: "Nothing to record: keep magnets away, and record again.",
    confused_with: &[
        ("neighbour_magnet", "where the gripper closed only once"),
        ("demagnetisation", "a step that stays"),
    ],
    undone: Undone::Never("it happened once; the device can only notice it"),
    lives_in_one_recording: true,
    apply,
};

/// Nothing is seen of a passage faster than two rows of the reference, in seconds.
const LEAST_S: f64 = 0.02;

/// Three values from a place on, as a vector.
fn three(values: &[f64], i: usize) -> Vector3<f64> {
    let found = values.get(3 * i..3 * i + 3);
    found.map_or_else(Vector3::zeros, Vector3::from_column_slice)
}

/// Field at `u` widths from the closest approach, in gauss; `values` in the order of the parameters.
fn field(values: &[f64], u: f64) -> Vector3<f64> {
    let [near, tilt, far, stay] = [0, 1, 2, 3].map(|i| three(values, i));
    let nearness = 1.0 / (1.0 + u * u);
    let fall = nearness * nearness * nearness.sqrt();
    (near + tilt * u + far * (u * u)) * fall + stay * (0.5 + 0.5 * libm::tanh(u))
}

/// The greatest field in gauss.
fn peak(values: &[f64]) -> f64 {
    let fields = (-60..=60).map(|i| field(values, 0.1 * f64::from(i)).norm());
    fields.fold(0.0, f64::max)
}

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let &[.., at_s, width_s] = values else {
        return;
    };
    let end_s = track.time_s.last().copied().unwrap_or(0.0);
    let own_s = at_s - track.before_s;
    if own_s < 0.0 {
        // It may still lie there, or nearer, or be gone.
        let later = three(values, 4);
        series
            .states
            .iter_mut()
            .for_each(|state| state.outside_g += later);
    } else if own_s <= end_s {
        for (state, time_s) in series.states.iter_mut().zip(&track.time_s) {
            state.outside_g += field(values, (time_s - own_s) / width_s.max(LEAST_S));
        }
    }
}

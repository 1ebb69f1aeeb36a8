//! Field of a passing or newly placed external magnet.

use nalgebra::Vector3;

use crate::effects::{
    Aggregation, DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec,
    Signature, SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

/// Prior magnitude of the passage coefficients; the fit allows ten times this. Without it, a step between two
/// rows leaves the three shapes of a passage undetermined.
const PASSING_G: f64 = 0.5;

pub const EFFECT: Effect = Effect {
    id: "external_magnet",
    stage: EffectStage::Outside,
    physics: "A magnetic object nearby (a screwdriver, a loudspeaker, a magnetic base) adds its field to all \
              sensors simultaneously. A dipole on a straight path gives a superposition of three curve \
              shapes for any orientation; an object that is placed and remains gives a step. Two forces \
              cannot explain a change of three field axes, which allows detection on the device.",
    equation: "B + (a + b u + c u^2) / (1 + u^2)^(5/2) + d step(u), u = (t - t0) / width; B + e in later recordings",
    regressors: "the three shapes of a passing dipole, a step, and an offset in later recordings, each axis",
    needs: &[],
    plot_against: &["session_s"],
    parameters: &[
        EffectParameter::coefficient("near_x", "G", PASSING_G),
        EffectParameter::coefficient("near_y", "G", PASSING_G),
        EffectParameter::coefficient("near_z", "G", PASSING_G),
        EffectParameter::coefficient("tilt_x", "G", PASSING_G),
        EffectParameter::coefficient("tilt_y", "G", PASSING_G),
        EffectParameter::coefficient("tilt_z", "G", PASSING_G),
        EffectParameter::coefficient("far_x", "G", PASSING_G),
        EffectParameter::coefficient("far_y", "G", PASSING_G),
        EffectParameter::coefficient("far_z", "G", PASSING_G),
        EffectParameter::coefficient("stay_x", "G", 5.0),
        EffectParameter::coefficient("stay_y", "G", 5.0),
        EffectParameter::coefficient("stay_z", "G", 5.0),
        EffectParameter::coefficient("later_x", "G", 5.0),
        EffectParameter::coefficient("later_y", "G", 5.0),
        EffectParameter::coefficient("later_z", "G", 5.0),
        EffectParameter::instant("at", "s"),
        EffectParameter::shape("width", "s", &[0.1, 0.25, 0.6, 1.5, 4.0]),
    ],
    size: MagnitudeSpec {
        description: "field at its closest",
        unit: "G",
        aggregation: Aggregation::Max(peak),
        typical: 5.0,
        plausible: (0.0, 500.0),
        possible: (0.0, 20000.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "No recording identifies it: remove the magnet and repeat the recording.",
    confused_with: &[
        ("neighbour_magnet", "where the gripper closed only once"),
        ("demagnetisation", "a permanent step"),
    ],
    similar_outside: "iron that was moved near the gripper",
    signatures: &[Signature::Time],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 19,
        range: (0.0, 200.0),
        meaning: "peak field of an external magnet that passes once",
        shared: true,
    }),
    device: DeviceForm::Never("a single event; the device can only detect it"),
    is_transient: true,
    has_memory: false,
    time: TimeDependence::Rows,
    reads: &[],
    apply,
};

/// Minimum width in seconds: a faster passage is shorter than two rows of the reference.
const MIN_WIDTH_S: f64 = 0.02;

/// The `i`-th group of three values as a vector.
fn vector(values: &[f64], i: usize) -> Vector3<f64> {
    let found = values.get(3 * i..3 * i + 3);
    found.map_or_else(Vector3::zeros, Vector3::from_column_slice)
}

/// Field in gauss at `u` widths from the closest approach; `values` in the order of the parameters.
fn field(values: &[f64], u: f64) -> Vector3<f64> {
    let [near, tilt, far, stay] = [0, 1, 2, 3].map(|i| vector(values, i));
    let nearness = 1.0 / (1.0 + u * u);
    let decay = nearness * nearness * nearness.sqrt();
    (near + tilt * u + far * (u * u)) * decay + stay * (0.5 + 0.5 * libm::tanh(u))
}

/// Maximum of the field in gauss.
fn peak(values: &[f64]) -> f64 {
    let fields = (-60..=60).map(|i| field(values, 0.1 * f64::from(i)).norm());
    fields.fold(0.0, f64::max)
}

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let &[.., at_s, width_s] = values else {
        return;
    };
    let end_s = excitation.time_s.last().copied().unwrap_or(0.0);
    let own_s = at_s - excitation.before_s;
    if own_s < 0.0 {
        // In later recordings the object may have remained, moved or been removed.
        let later = vector(values, 4);
        series.states.iter_mut().for_each(|state| state.external_g += later);
    } else if own_s <= end_s {
        for (state, time_s) in series.states.iter_mut().zip(&excitation.time_s) {
            state.external_g += field(values, (time_s - own_s) / width_s.max(MIN_WIDTH_S));
        }
    }
}

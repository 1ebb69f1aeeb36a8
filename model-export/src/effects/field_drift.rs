//! The field creeps away over the session, each channel by its own amount.

use nalgebra::Vector3;

use super::{Effect, Parameter, Series, Size, SizeOf, Stage, Track, Undone};

/// The effect.
pub const EFFECT: Effect = Effect {
    id: "field_drift",
    stage: Stage::Sensor,
    physics: "Glue settles, a printed lattice relaxes, electronics warm through: over minutes to hours \
              each channel shifts to a new rest, fast at first and then more slowly. Part of it may start \
              anew whenever a recording does, with the current that is switched on. It does not follow the \
              load. Without a measured cause this is the honest description; a logged temperature may \
              explain it better.",
    equation: "B + A (1 - exp(-t / tau)) + C (1 - exp(-s / tau)), t since the campaign began, s since the recording did",
    regressors: "1 - exp(-t / tau) and 1 - exp(-s / tau) in each axis",
    needs: &[],
    shows_against: &["session_s"],
    parameters: &[
        Parameter::coefficient("shift_x", "G", 0.7),
        Parameter::coefficient("shift_y", "G", 0.7),
        Parameter::coefficient("shift_z", "G", 0.7),
        Parameter::coefficient("again_x", "G", 0.7),
        Parameter::coefficient("again_y", "G", 0.7),
        Parameter::coefficient("again_z", "G", 0.7),
        Parameter::shape(
            "time",
            "s",
            &[15.0, 30.0, 60.0, 150.0, 400.0, 1000.0, 3000.0],
        )
        .shared()
        .across_recordings(),
    ],
    size: Size {
        words: "final shift",
        unit: "G",
        first: 3,
        of: SizeOf::Norm,
        factor: 1.0,
        resolution: 0.0,
        typical: 0.7,
        plausible: (0.0, 10.0),
        possible: (0.0, 500.0),
    },
    record: "Record the unloaded gripper for a minute at the start and at the end of the session; log the \
              temperature.",
    confused_with: &[
        ("creep", "both are slow"),
        ("magnet_temperature", "where every recording warms up alike"),
        ("sensor_temperature", "where every recording warms up alike"),
        (
            "reference_drift",
            "both are slow; a drifting reference only moves along dB/dF",
        ),
        ("demagnetisation", "both change from recording to recording"),
    ],
    undone: Undone::Settled,
    lives_in_one_recording: false,
    apply,
};

fn apply(values: &[f64], track: &Track, series: &mut Series) {
    let &[x, y, z, again_x, again_y, again_z, tau_s] = values else {
        return;
    };
    let (once, again) = (
        Vector3::new(x, y, z),
        Vector3::new(again_x, again_y, again_z),
    );
    let settled = |time_s: f64| 1.0 - libm::exp(-time_s.max(0.0) / tau_s);
    for (state, time_s) in series.states.iter_mut().zip(&track.time_s) {
        state.offset_g += once * settled(track.start_s + time_s) + again * settled(*time_s);
    }
}

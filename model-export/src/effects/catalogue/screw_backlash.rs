//! Backlash between screw and nut: the opening lags behind the motor.

use crate::effects::operators::stop_operator;
use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec,
    SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

/// Minimum threshold of the operator in mm; avoids a division by zero.
const MIN_MM: f64 = 1e-3;

pub const EFFECT: Effect = Effect {
    id: "screw_backlash",
    stage: EffectStage::Opening,
    physics: "The nut has axial play on the screw. After a reversal of the motor the fingers do not move \
              until the play is traversed, so the opening computed from the motor's angle has an error of \
              half the play, with a sign given by the direction of travel. It affects the field only \
              through effects that depend on the opening, such as the neighbour's magnet: add that first.",
    equation: "opening = play operator of the measured opening",
    regressors: "d(neighbour field)/d(opening) times the direction of travel",
    needs: &["opening_mm"],
    plot_against: &["opening_mm"],
    parameters: &[
        EffectParameter::coefficient("play", "mm", 0.1),
        EffectParameter::initial_state("begin", "", 0.5),
    ],
    size: MagnitudeSpec {
        description: "play",
        unit: "mm",
        typical: 0.1,
        plausible: (0.0, 0.5),
        possible: (0.0, 5.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Close and open slowly around a small opening, where the neighbour's field is strongest, with \
              many reversals.",
    confused_with: &[("neighbour_magnet", "where the gripper does not reverse")],
    similar_outside: "",
    signatures: &[],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 17,
        range: (0.0, 5.0),
        meaning: "full play between the reported opening and the real one",
        shared: true,
    }),
    device: DeviceForm::Never(
        "the device measures the motor's angle, and the play is below its noise; home from one side",
    ),
    is_transient: false,
    has_memory: true,
    time: TimeDependence::None,
    reads: &[EffectStage::Opening],
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let Some((&play_mm, beginnings)) = values.split_first() else {
        return;
    };
    let half = 0.5 * play_mm;
    let begin = beginnings.get(excitation.recording).copied().unwrap_or(0.0);
    let slider = stop_operator(&series.opening_mm, half.abs().max(MIN_MM), begin);
    for (opening, slider) in series.opening_mm.iter_mut().zip(slider) {
        *opening -= half * slider;
    }
}

//! Gain compression of the sensor in strong fields.

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec,
    SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "sensor_compression",
    stage: EffectStage::Sensor,
    physics: "Hall elements and their amplifiers are slightly nonlinear: near the end of the range the gain \
              decreases. With 1272 G at rest along the gap the sensor always operates there, and a load \
              that moves the magnet closer reduces the gain further.",
    equation: "b (1 - c (b / 1300 G)^2), each axis b of B",
    regressors: "the cube of each axis' field",
    needs: &[],
    plot_against: &["fx_n", "fz_n"],
    parameters: &[EffectParameter::coefficient("loss", "%", 1.0)],
    size: MagnitudeSpec {
        description: "gain lost at 1300 G",
        unit: "%",
        typical: 1.0,
        plausible: (-1.0, 10.0),
        possible: (-20.0, 60.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Load over the whole range with two gaps that differ by some tenths of a millimetre.",
    confused_with: &[
        ("tip_slope", "both are even in the load"),
        ("geometric_stiffening", "where the field along the gap increases with the load"),
    ],
    similar_outside: "",
    signatures: &[],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 22,
        range: (-5.0, 10.0),
        meaning: "loss of gain at 1300 G",
        shared: false,
    }),
    device: DeviceForm::Tables,
    is_transient: false,
    has_memory: false,
    time: TimeDependence::None,
    reads: &[],
    apply,
};

fn apply(values: &[f64], _: &ExcitationSeries, series: &mut StateSeries) {
    let &[percent] = values else { return };
    for state in &mut series.states {
        state.compression += 0.01 * percent;
    }
}

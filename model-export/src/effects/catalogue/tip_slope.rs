//! Foreshortening and tip slope of a bent flexure.

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, MagnitudeSpec,
    SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

/// Reference deflection of the magnitude in mm: the travel in the paper.
const REFERENCE_MM: f64 = 0.5;

pub const EFFECT: Effect = Effect {
    id: "tip_slope",
    stage: EffectStage::Displacement,
    physics: "The tip of a bent cantilever does not move on a straight line: it is foreshortened by \
              0.6 w^2 / L (load at the tip, constant arc length) and tilted by the slope 1.5 w / L. The \
              magnet moves along the gap, to which the sensor is most sensitive, and its axis rotates. The \
              shift is even in the load and dominates in the gap axis, where the direct response to the \
              forces is of second order.",
    equation: "dy = -s (w / 0.5 mm)^2, tilt = a (w / 0.5 mm); s = 0.6 (0.5 mm)^2 / L, a = 1.5 (0.5 mm) / L",
    regressors: "dB/dy times F^2, and dB/d(tilt) times F",
    needs: &[],
    plot_against: &["fx_n", "fz_n"],
    parameters: &[
        EffectParameter::coefficient("shortening_x", "um", 5.0),
        EffectParameter::coefficient("shortening_z", "um", 5.0),
        EffectParameter::coefficient("lean_x", "deg", 0.3),
        EffectParameter::coefficient("lean_z", "deg", 0.3),
    ],
    size: MagnitudeSpec {
        description: "foreshortening at 0.5 mm",
        unit: "um",
        first: 2,
        typical: 5.0,
        plausible: (-30.0, 30.0),
        possible: (-250.0, 250.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Load each flexure slowly over its whole range, both signs, one at a time.",
    confused_with: &[
        ("sensor_compression", "both are even in the load"),
        ("geometric_stiffening", "where only one sign of the load was recorded"),
    ],
    similar_outside: "",
    signatures: &[],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 1,
        range: (-50.0, 50.0),
        meaning: "foreshortening of each flexure at 0.5 mm; the magnet leans",
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
    let &[shortening_x, shortening_z, tilt_x, tilt_z] = values else {
        return;
    };
    for state in &mut series.states {
        let [x, z] = [state.displacement_mm.x, state.displacement_mm.z].map(|w| w / REFERENCE_MM);
        state.displacement_mm.y -= 1e-3 * (shortening_x * x * x + shortening_z * z * z);
        // A displacement along x tilts about z, and vice versa.
        state.extra_tilt_rad[0] += (tilt_z * z).to_radians();
        state.extra_tilt_rad[1] += (tilt_x * x).to_radians();
    }
}

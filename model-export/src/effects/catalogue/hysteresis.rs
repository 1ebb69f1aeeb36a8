//! Friction parallel to the flexure: rate-independent hysteresis.

use crate::effects::operators::{stop_operators, turns_between};
use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, ForceForm, FrictionSliders,
    MagnitudeSpec, Signature, SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "hysteresis",
    stage: EffectStage::Flexure,
    physics: "Where the finger rubs on a guide, a cable drags or a screw joint slips, a friction force acts \
              parallel to the flexure and opposes its motion. At equal force the field therefore has two \
              values: a loop with a width of twice the friction force, independent of the speed of the \
              load. After a reversal the friction force first reverses elastically within its reach, then \
              slips.",
    equation: "F' = F - f (w1 s1 + w2 s2 + s3) / (w1 + w2 + 1), si = stop operator of F with reach i, from -1 to 1",
    regressors: "dB/dF times the stop operators of F",
    needs: &[],
    plot_against: &["loading_x", "loading_z"],
    parameters: &[
        EffectParameter::coefficient("friction_x", "N", 2.5),
        EffectParameter::coefficient("friction_z", "N", 2.5),
        EffectParameter::shape("reach1_x", "N", &[2.0, 4.0, 8.0, 16.0, 32.0]).slips_in_range(),
        EffectParameter::shape("reach2_x", "N", &[4.0, 8.0, 16.0, 32.0, 64.0]).slips_in_range(),
        EffectParameter::shape("reach3_x", "N", &[8.0, 16.0, 32.0, 64.0, 128.0]).slips_in_range(),
        EffectParameter::shape("weight1_x", "", &[0.1, 0.3, 1.0, 3.0]),
        EffectParameter::shape("weight2_x", "", &[0.1, 0.3, 1.0, 3.0]),
        EffectParameter::shape("reach1_z", "N", &[2.0, 4.0, 8.0, 16.0, 32.0]).slips_in_range(),
        EffectParameter::shape("reach2_z", "N", &[4.0, 8.0, 16.0, 32.0, 64.0]).slips_in_range(),
        EffectParameter::shape("reach3_z", "N", &[8.0, 16.0, 32.0, 64.0, 128.0]).slips_in_range(),
        EffectParameter::shape("weight1_z", "", &[0.1, 0.3, 1.0, 3.0]),
        EffectParameter::shape("weight2_z", "", &[0.1, 0.3, 1.0, 3.0]),
        EffectParameter::initial_state("begin_x", "", 0.5),
        EffectParameter::initial_state("begin_z", "", 0.5),
    ],
    size: MagnitudeSpec {
        description: "friction force (half the width of the loop)",
        unit: "N",
        first: 2,
        typical: 2.5,
        plausible: (0.0, 25.0),
        possible: (0.0, 250.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Load to the same peak at two speeds that differ by a factor of three, and dwell at the turning \
              points: hysteresis is independent of the speed, lag and skew are not.",
    confused_with: &[
        ("viscous_lag", "at a single frequency: the same ellipse"),
        ("clock_skew", "at a single frequency: the same ellipse"),
        ("creep", "where the load always returns at the same speed"),
    ],
    similar_outside: "hysteresis of the reference",
    signatures: &[Signature::LoadHistory],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 8,
        range: (0.0, 50.0),
        meaning: "Coulomb friction parallel to the flexure, half the loop width",
        shared: false,
    }),
    device: DeviceForm::Force(ForceForm::Hysteresis(sliders_of)),
    is_transient: false,
    has_memory: true,
    time: TimeDependence::None,
    reads: EffectStage::FORCES,
    apply,
};

/// Number of shapes of one axis.
const SHAPES: usize = 5;

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let Some((frictions, rest)) = values.split_at_checked(2) else {
        return;
    };
    let Some((shapes, beginnings)) = rest.split_at_checked(2 * SHAPES) else {
        return;
    };
    let recordings = beginnings.len() / 2;
    for (axis, (&friction, shapes)) in frictions.iter().zip(shapes.chunks_exact(SHAPES)).enumerate()
    {
        if friction == 0.0 {
            continue;
        }
        let begin =
            beginnings.get(axis * recordings + excitation.recording).copied().unwrap_or(0.0);
        let (force, rates) = series.history(excitation, axis);
        let turns = turns_between(&excitation.time_s, &force, &rates);
        let normalised = stop_operators(&force, &turns, sliders(shapes), begin);
        series.add_force(axis, |row| -friction * normalised[row]);
    }
}

/// Friction force in newtons and (weight, reach in newtons) of each slider of one axis (0 lateral, 1
/// longitudinal); `values` in the order of the parameters.
fn sliders_of(values: &[f64], axis: usize) -> FrictionSliders {
    let shapes = values.get(2 + axis * SHAPES..2 + (axis + 1) * SHAPES);
    let friction = values.get(axis).copied().unwrap_or(0.0);
    (friction, sliders(shapes.unwrap_or(&[])))
}

/// Relative weight and reach in newtons of each slider, from the shapes of one axis (Maxwell-slip model). With
/// three elements the residual of the recordings in `tests/data/friction` is at the noise floor, with one about
/// three times as large.
fn sliders(shapes: &[f64]) -> [(f64, f64); 3] {
    let [reach1, reach2, reach3, weight1, weight2] =
        std::array::from_fn(|i| shapes.get(i).copied().unwrap_or(1.0));
    let all = weight1 + weight2 + 1.0;
    [(weight1 / all, reach1), (weight2 / all, reach2), (1.0 / all, reach3)]
}

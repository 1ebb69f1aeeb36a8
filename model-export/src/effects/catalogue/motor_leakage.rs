//! Magnetic field of the motor's currents.

use nalgebra::Vector3;

use crate::effects::{
    Aggregation, DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, FieldForm,
    MagnitudeSpec, SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};
use crate::recordings::columns::STATOR_CURRENTS;

/// Current columns in the order of the parameters.
const COLUMNS: [&str; 3] = [STATOR_CURRENTS[0], STATOR_CURRENTS[1], "motor_iq_a"];

pub const EFFECT: Effect = Effect {
    id: "motor_leakage",
    stage: EffectStage::Outside,
    physics: "The motor is centimetres away from the sensors. Its phase currents generate a field that rotates \
              with the electrical angle, and its supply wires a field of constant direction. Both are \
              proportional to the current: 10 A at 20 mm give about a gauss.",
    equation: "B + K [i_alpha, i_beta] + k iq",
    regressors: "i_alpha, i_beta and iq in each axis",
    needs: &["motor_iq_a", "motor_angle_rad"],
    plot_against: &COLUMNS,
    parameters: &[
        EffectParameter::coefficient("alpha_x", "G/A", 0.05),
        EffectParameter::coefficient("alpha_y", "G/A", 0.05),
        EffectParameter::coefficient("alpha_z", "G/A", 0.05),
        EffectParameter::coefficient("beta_x", "G/A", 0.05),
        EffectParameter::coefficient("beta_y", "G/A", 0.05),
        EffectParameter::coefficient("beta_z", "G/A", 0.05),
        EffectParameter::coefficient("iq_x", "G/A", 0.05),
        EffectParameter::coefficient("iq_y", "G/A", 0.05),
        EffectParameter::coefficient("iq_z", "G/A", 0.05),
    ],
    size: MagnitudeSpec {
        description: "field at 10 A",
        unit: "G",
        first: 9,
        aggregation: Aggregation::Norm,
        factor: 10.0,
        typical: 1.0,
        plausible: (0.0, 20.0),
        possible: (0.0, 2000.0),
    },
    record: "With the gripper unloaded and at a fixed opening, press against a stop with 0, half and full \
              current; then rotate the motor slowly through several revolutions.",
    confused_with: &[("neighbour_magnet", "closing requires current")],
    similar_outside: "a supply that drops with the current",
    signatures: &[],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 3,
        range: (0.0, 50.0),
        meaning: "norm of the nine coefficients (axes by currents), times 10 A",
        shared: false,
    }),
    device: DeviceForm::Field(FieldForm::MotorLeakage),
    is_transient: false,
    has_memory: false,
    time: TimeDependence::None,
    reads: &[],
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    for (column, field) in COLUMNS.iter().zip(values.chunks_exact(3)) {
        let (Some(current), &[x, y, z]) = (excitation.covariates.get(*column), field) else {
            continue;
        };
        for (state, amperes) in series.states.iter_mut().zip(current) {
            state.external_g += Vector3::new(x, y, z) * *amperes;
        }
    }
}

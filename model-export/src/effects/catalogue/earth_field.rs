//! The Earth's field in the rotating axes of the gripper.

use nalgebra::{Rotation3, Vector3};

use crate::effects::{
    Aggregation, DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, FieldForm,
    MagnitudeSpec, Signature, SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "earth_field",
    stage: EffectStage::Outside,
    physics: "The Earth's field is 25 to 65 uT, 0.25 to 0.65 G (not 0.5 uT, as stated in the paper): five \
              steps of the sensor, or half a newton. It is constant in the room and therefore rotates in the \
              axes of a rotating gripper. With a fixed orientation it is confounded with the sensor's offset.",
    equation: "B + R' b, R from roll, pitch, yaw (ZYX, body to world)",
    regressors: "the rows of the rotation",
    needs: &["roll_rad", "pitch_rad", "yaw_rad"],
    plot_against: &["roll_rad", "pitch_rad", "yaw_rad"],
    parameters: &[
        EffectParameter::coefficient("world_x", "G", 0.3).shared(),
        EffectParameter::coefficient("world_y", "G", 0.3).shared(),
        EffectParameter::coefficient("world_z", "G", 0.3).shared(),
    ],
    size: MagnitudeSpec {
        description: "field",
        unit: "G",
        aggregation: Aggregation::Norm,
        typical: 0.48,
        // The steel of a building or robot changes it by up to a factor of two.
        plausible: (0.12, 1.3),
        possible: (0.0, 5.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Rotate the unloaded gripper through all orientations, at least 90 degrees about two axes.",
    confused_with: &[
        (
            "fingertip_mass",
            "both depend on the orientation: the Earth's field acts on all axes, weight through dB/dF",
        ),
        ("sensor_temperature", "where the temperature changes during the rotation"),
    ],
    similar_outside: "",
    signatures: &[Signature::AmbientField],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 4,
        range: (0.0, 5.0),
        meaning: "norm of the world's field",
        shared: true,
    }),
    device: DeviceForm::Field(FieldForm::EarthField),
    is_transient: false,
    has_memory: false,
    time: TimeDependence::None,
    reads: &[],
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let &[x, y, z] = values else { return };
    let columns = ["roll_rad", "pitch_rad", "yaw_rad"].map(|name| excitation.covariates.get(name));
    let [Some(roll), Some(pitch), Some(yaw)] = columns else {
        return;
    };
    for (row, state) in series.states.iter_mut().enumerate() {
        let to_world = Rotation3::from_euler_angles(roll[row], pitch[row], yaw[row]);
        state.external_g += to_world.inverse() * Vector3::new(x, y, z);
    }
}

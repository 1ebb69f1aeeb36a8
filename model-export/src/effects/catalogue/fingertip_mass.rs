//! Weight and inertia of the fingertip.

use crate::effects::{
    DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, ForceForm, MagnitudeSpec,
    SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

pub const EFFECT: Effect = Effect {
    id: "fingertip_mass",
    stage: EffectStage::Load,
    physics: "The flexure carries the fingertip, whose weight and inertia the reference does not measure. Both \
              are mass times specific force, the quantity that an accelerometer measures. A tenth of a \
              kilogram has a weight of 1 N and an inertial force of 1.5 N at 15 m/s^2.",
    equation: "F' = F + m a, a specific force along x and z",
    regressors: "dB/dFx times accel_x plus dB/dFz times accel_z",
    needs: &["accel_x_mps2", "accel_z_mps2"],
    plot_against: &["accel_x_mps2", "accel_z_mps2"],
    parameters: &[EffectParameter::coefficient("mass", "kg", 0.1)],
    size: MagnitudeSpec {
        description: "mass",
        unit: "kg",
        typical: 0.1,
        plausible: (0.0, 1.0),
        possible: (0.0, 20.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Rotate the unloaded gripper slowly through all orientations, then shake it along x and z.",
    confused_with: &[
        (
            "earth_field",
            "both depend on the orientation: the Earth's field acts on all axes, weight through dB/dF",
        ),
        ("cross_coupling", "where the load results from motion of the arm"),
    ],
    similar_outside: "",
    signatures: &[],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 16,
        range: (0.0, 2.0),
        meaning: "mass carried by the flexures",
        shared: false,
    }),
    device: DeviceForm::Force(ForceForm::FingertipMass),
    is_transient: false,
    has_memory: false,
    time: TimeDependence::None,
    reads: &[],
    apply,
};

fn apply(values: &[f64], excitation: &ExcitationSeries, series: &mut StateSeries) {
    let &[mass_kg] = values else { return };
    for (axis, column) in [(0, "accel_x_mps2"), (1, "accel_z_mps2")] {
        if let Some(acceleration) = excitation.covariates.get(column) {
            series.add_force(axis, |row| mass_kg * acceleration[row]);
        }
    }
}

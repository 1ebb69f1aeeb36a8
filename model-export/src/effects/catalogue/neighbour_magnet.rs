//! Field of the opposing finger's magnet, which depends on the opening.

use nalgebra::Vector3;

use crate::effects::{
    Aggregation, DeviceForm, Effect, EffectParameter, EffectStage, ExcitationSeries, FieldForm,
    MagnitudeSpec, SimulatedMagnitude, Simulation, StateSeries, TimeDependence,
};

/// Reference opening of the magnitude in mm.
const REFERENCE_MM: f64 = 10.0;

pub const EFFECT: Effect = Effect {
    id: "neighbour_magnet",
    stage: EffectStage::Outside,
    physics: "Each finger has a magnet, and a Hall sensor measures the sum of all fields. The far field is that \
              of a dipole and decreases with the third power of the distance: significant with closed \
              fingers, negligible with open ones. A magnet of 3 by 2 mm gives about 10 G at 10 mm and \
              0.3 G at 35 mm.",
    equation: "B + ((r0 + 10 mm) / r)^3 (3 (K e) e - K), r = (r0 + opening, aside, ahead), e = r / |r|",
    regressors: "the field of a dipole at r0 + opening, for each direction of the dipole",
    needs: &["opening_mm"],
    plot_against: &["opening_mm"],
    parameters: &[
        EffectParameter::coefficient("field_x", "G", 2.0),
        EffectParameter::coefficient("field_y", "G", 2.0),
        EffectParameter::coefficient("field_z", "G", 2.0),
        EffectParameter::shape("distance", "mm", &[2.0, 4.0, 7.0, 10.0, 14.0, 20.0, 30.0]),
        EffectParameter::shape("aside", "mm", &[-6.0, -3.0, 0.0, 3.0, 6.0]),
        EffectParameter::shape("ahead", "mm", &[-6.0, -3.0, 0.0, 3.0, 6.0]),
    ],
    size: MagnitudeSpec {
        description: "field at an opening of 10 mm",
        unit: "G",
        aggregation: Aggregation::Mean(field_at_reference),
        typical: 2.0,
        plausible: (0.0, 100.0),
        possible: (0.0, 2000.0),
        ..MagnitudeSpec::DEFAULT
    },
    record: "Open and close over the whole stroke without load, at two speeds; then keep the gripper closed \
              with the motor off.",
    confused_with: &[
        ("motor_leakage", "closing requires current"),
        ("external_magnet", "where the gripper closed only once"),
        ("screw_backlash", "both depend on the opening"),
    ],
    similar_outside: "iron that moves with the opening",
    signatures: &[],
    simulation: Simulation::Magnitude(SimulatedMagnitude {
        random_stream: 2,
        range: (-50.0, 50.0),
        meaning: "field of the opposite finger's magnet at an opening of 10 mm",
        shared: false,
    }),
    device: DeviceForm::Field(FieldForm::NeighbourMagnet(field)),
    is_transient: false,
    has_memory: false,
    time: TimeDependence::None,
    reads: &[EffectStage::Opening],
    apply,
};

fn apply(values: &[f64], _: &ExcitationSeries, series: &mut StateSeries) {
    for (state, opening_mm) in series.states.iter_mut().zip(&series.opening_mm) {
        state.external_g += field(values, *opening_mm);
    }
}

/// Magnitude of the field in gauss at the reference opening.
fn field_at_reference(values: &[f64]) -> f64 {
    field(values, REFERENCE_MM).norm()
}

/// Field of the neighbour in gauss, gripper's axes, at an opening in mm; `values` in the order of the parameters.
fn field(values: &[f64], opening_mm: f64) -> Vector3<f64> {
    let &[x, y, z, distance_mm, aside_mm, ahead_mm] = values else {
        return Vector3::zeros();
    };
    let moment = Vector3::new(x, y, z);
    // Negative openings are errors of the encoder's zero.
    let along = (distance_mm + opening_mm).max(0.1 * distance_mm);
    let to_neighbour = Vector3::new(along, aside_mm, ahead_mm);
    let distance = to_neighbour.norm();
    let direction = to_neighbour / distance;
    let decay = ((distance_mm + REFERENCE_MM) / distance).powi(3);
    (direction * (3.0 * moment.dot(&direction)) - moment) * decay
}

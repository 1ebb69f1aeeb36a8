//! Field changes at a sensor that are not caused by forces, each in gauss, in newtons and in resolutions.
//!
//! ```ignore
//! // Once: the sources, and the Monte Carlo samples of the mounting, by their seed.
//! let sources = InterferenceSources::assumed(1, DRAWS);
//! // For each design: about 0.2 ms.
//! for shift in field_shifts(&SensorUnderTest::of(ForwardModel::nominal(&design)), &sources) {
//!     println!("{}: {:.2} G, {:.2} N", shift.name, shift.gauss, shift.newtons);
//! }
//! ```
//!
//! A field change is converted to newtons by the local inverse of the design: least squares with the gap axis
//! weighted as in the tables ([`LocalInverse`]).
//!
//! Sources: the Earth's field, the mounting of the magnet ([`misalignment`], before and after a tare), the
//! opposite finger's magnet, demagnetisation, the motor's phase currents ([`motor`]), and the compliance of the
//! gripper as an error of the opening.

pub mod misalignment;
pub mod motor;

use firmware::config::constants::{self, Constant, assumed, stated};
use nalgebra::{Matrix2x3, Matrix3, Matrix3x2, Vector3};
use serde::Serialize;

pub use misalignment::{DRAWS, MountingSamples, MountingScatter};

use crate::physics::ForwardModel;
use crate::physics::sensor::{GAP_WEIGHT, reach_mm};

/// Minimum of the Earth's field, over the South Atlantic.
pub const EARTH_MIN: Constant = stated("Earth's field, least", 0.25, "G", "IGRF-13: 22 to 67 uT");
/// Maximum of the Earth's field, near the magnetic poles. The paper states 0.5 uT and calls it negligible.
pub const EARTH_MAX: Constant =
    stated("Earth's field, greatest", 0.65, "G", "IGRF-13: 22 to 67 uT");
/// Loss of remanence by demagnetisation or inhomogeneity, as a fraction.
pub(crate) const REMANENCE_LOSS: Constant =
    stated("magnet's inhomogeneity", 0.01, "", "paper IV-C, below 1 %");
/// Distance between the centres of opposite magnets with the gripper closed.
pub(crate) const CLOSED_DISTANCE: Constant = assumed(
    "opposite magnets, gripper closed",
    10.0,
    "mm",
    "the paper's 1.5 mm contradicts its three resolutions",
);
/// Load at which the paper measured the deflection.
pub const RIGIDITY_LOAD: Constant = stated("load on the whole gripper", 200.0, "N", "paper V-D");
/// Deflection of the whole gripper under [`RIGIDITY_LOAD`].
pub(crate) const RIGIDITY_DEFLECTION: Constant =
    stated("deflection of the whole gripper", 0.3, "mm", "paper V-D");

/// All constants of this module, with their sources.
pub const ASSUMED: [Constant; 17] = [
    EARTH_MIN,
    EARTH_MAX,
    misalignment::OFFSET,
    misalignment::GAP,
    misalignment::TILT,
    misalignment::REMANENCE,
    CLOSED_DISTANCE,
    REMANENCE_LOSS,
    motor::TURNS,
    motor::RADIUS,
    motor::WIDTH,
    motor::LENGTH,
    motor::ALONG,
    motor::ASIDE,
    motor::TEETH,
    RIGIDITY_LOAD,
    RIGIDITY_DEFLECTION,
];

/// A nominal sensor with its manufacturing scatter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorUnderTest {
    /// Magnet, gap, flexures and force range.
    pub model: ForwardModel,
    /// Resolution of the Hall sensor in gauss.
    pub resolution_g: f64,
    /// Standard deviations of the mounting.
    pub scatter: MountingScatter,
}

impl SensorUnderTest {
    /// With the gripper's Hall sensor and the assumed scatter.
    pub fn of(model: ForwardModel) -> Self {
        Self {
            model,
            resolution_g: constants::SENSOR_SCALE.value,
            scatter: MountingScatter::assumed(),
        }
    }
}

/// Sources of interference, the same for every design.
#[derive(Clone, Debug)]
pub struct InterferenceSources {
    /// Earth's field in gauss.
    pub earth_g: f64,
    /// Distance between the centres of opposite magnets with the gripper closed, in mm.
    pub closed_mm: f64,
    /// Loss of remanence, as a fraction.
    pub remanence_loss: f64,
    /// Leakage of the motor in G/A for the phase currents alpha and beta.
    pub leakage_g_per_a: Matrix3x2<f64>,
    /// Maximum motor current in A, peak of the phase.
    pub current_a: f64,
    /// Stiffness of the gripper against opening, in N/mm.
    pub rigidity_n_per_mm: f64,
    /// Monte Carlo samples of the mounting.
    pub draws: MountingSamples,
}

impl InterferenceSources {
    /// Values from the paper where it states them, assumed otherwise, with `draws` samples of `seed`.
    pub fn assumed(seed: u64, draws: usize) -> Self {
        Self {
            earth_g: EARTH_MAX.value,
            closed_mm: CLOSED_DISTANCE.value,
            remanence_loss: REMANENCE_LOSS.value,
            leakage_g_per_a: motor::leakage_g_per_a(motor::sensor_mm()),
            current_a: constants::PEAK_TORQUE.value / constants::TORQUE_CONSTANT.value,
            // 667 N/mm.
            rigidity_n_per_mm: RIGIDITY_LOAD.value / RIGIDITY_DEFLECTION.value,
            draws: MountingSamples::new(seed, draws),
        }
    }
}

/// Effect of one source on a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FieldShift {
    /// The source.
    pub name: &'static str,
    /// Condition under which the magnitude applies.
    pub meaning: &'static str,
    /// Norm of the added field in gauss.
    pub gauss: f64,
    /// Larger of the two apparent forces in newtons; infinite where the sensor cannot separate the forces.
    pub newtons: f64,
    /// [`FieldShift::gauss`] in resolutions of the Hall sensor.
    pub resolutions: f64,
}

impl FieldShift {
    fn new(
        (name, meaning): (&'static str, &'static str),
        (gauss, newtons): (f64, f64),
        sensor: &SensorUnderTest,
    ) -> Self {
        Self { name, meaning, gauss, newtons, resolutions: gauss / sensor.resolution_g }
    }

    /// The shift by a known field change in gauss.
    fn of_field(
        names: (&'static str, &'static str),
        shift_g: Vector3<f64>,
        inverse: &LocalInverse,
        sensor: &SensorUnderTest,
    ) -> Self {
        let sizes = (shift_g.norm(), inverse.max_force_n(shift_g));
        Self::new(names, sizes, sensor)
    }
}

/// Maximum shift by each source: Earth, mounting before and after a tare, opposite magnet, demagnetisation,
/// motor, compliance of the gripper.
pub(crate) fn field_shifts(
    sensor: &SensorUnderTest,
    sources: &InterferenceSources,
) -> Vec<FieldShift> {
    let rest = LocalInverse::at(&sensor.model, [0.0; 2]);
    let [mounted, tared] = misalignment::shifts(sensor, &rest, &sources.draws);
    let earth_n = sources.earth_g * rest.worst_case_n(&Matrix3::identity());
    let earth = FieldShift::new(
        ("Earth", "either way, from the worst side"),
        (sources.earth_g, earth_n),
        sensor,
    );
    let neighbour = |distance_mm| neighbour_field(&sensor.model, distance_mm);
    let closed_g = neighbour(sources.closed_mm);
    let opening_mm = sources.closed_mm + opening_error_mm(sensor, sources);
    vec![
        earth,
        mounted,
        tared,
        FieldShift::of_field(("neighbour magnet", "gripper closed"), closed_g, &rest, sensor),
        inhomogeneity_shift(sensor, sources),
        motor::shift(sensor, &rest, sources),
        FieldShift::of_field(
            ("rigidity", "neighbour magnet, opening wrong under the greatest force"),
            neighbour(opening_mm) - closed_g,
            &rest,
            sensor,
        ),
    ]
}

/// A weaker magnet: a tare removes the change at rest; what remains is maximal with both forces at the end of
/// their range.
fn inhomogeneity_shift(sensor: &SensorUnderTest, sources: &InterferenceSources) -> FieldShift {
    let model = &sensor.model;
    let full = [model.force_range_n; 2];
    let moved = model.field(full) - model.field([0.0; 2]);
    FieldShift::of_field(
        ("inhomogeneity", "at full load, after a tare"),
        moved * sources.remanence_loss,
        &LocalInverse::at(model, full),
        sensor,
    )
}

/// Field in gauss of the opposite finger's equal magnet, `distance_mm` away along the opening (`x`). At the
/// paper's 1.5 mm it is far above three resolutions: 0.3 G need 35 mm.
pub fn neighbour_field(model: &ForwardModel, distance_mm: f64) -> Vector3<f64> {
    let across_mm = model.gap_mm + reach_mm(&model.magnet, model.axis, model.body_axis);
    let turn = model.frames().magnet;
    let element_mm = -Vector3::new(distance_mm, across_mm, 0.0);
    turn * model.magnet.unit_field(turn.inverse() * element_mm) * model.remanence_t
}

/// Distance in mm beyond which the opposite magnet's field is below `limit_g`.
pub fn neighbour_distance_mm(model: &ForwardModel, limit_g: f64) -> f64 {
    // The field decreases with distance where the two magnets do not overlap.
    let (mut near, mut far) = (2.0 * model.magnet.half_width_mm(), 1e4);
    while far - near > 1e-6 * far {
        let middle = (near * far).sqrt();
        if neighbour_field(model, middle).norm() > limit_g {
            near = middle;
        } else {
            far = middle;
        }
    }
    far
}

/// Error of the opening in mm under the maximum force, by the compliance of the gripper.
pub(crate) fn opening_error_mm(sensor: &SensorUnderTest, sources: &InterferenceSources) -> f64 {
    sensor.model.force_range_n / sources.rigidity_n_per_mm
}

/// Local inverse sensitivity of a design in N/G.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalInverse {
    /// `None` where the field does not separate the two forces.
    n_per_g: Option<Matrix2x3<f64>>,
}

impl LocalInverse {
    /// At the forces `[Fx, Fz]` in newtons, by least squares with the gap axis weighted as in the tables.
    pub fn at(model: &ForwardModel, force_n: [f64; 2]) -> Self {
        let response = model.response(model.displacement(force_n));
        let slopes = Matrix3x2::from_columns(&model.per_newton(&response));
        let weight = Vector3::new(1.0, GAP_WEIGHT, 1.0);
        let weighted = Matrix2x3::from_fn(|i, j| slopes[(j, i)] * weight[j]);
        let normal = weighted * slopes;
        // Forces whose fields are collinear to 1e-6 are separated by noise alone.
        let singular = normal.determinant() <= 1e-12 * (normal[(0, 0)] * normal[(1, 1)]).abs();
        let inverse = if singular { None } else { normal.try_inverse() };
        Self { n_per_g: inverse.map(|inverse| inverse * weighted) }
    }

    /// Larger magnitude of the two forces that explain a field change in gauss.
    pub(crate) fn max_force_n(&self, shift_g: Vector3<f64>) -> f64 {
        self.n_per_g.map_or(f64::INFINITY, |n_per_g| (n_per_g * shift_g).amax())
    }

    /// The same for the worst field `basis * u` with `u` on the unit sphere; with the identity, for one gauss
    /// from any direction.
    pub(crate) fn worst_case_n<const N: usize>(&self, basis: &nalgebra::SMatrix<f64, 3, N>) -> f64 {
        let rows = |n_per_g: Matrix2x3<f64>| {
            let both = n_per_g * basis;
            both.row(0).norm().max(both.row(1).norm())
        };
        self.n_per_g.map_or(f64::INFINITY, rows)
    }
}

#[cfg(test)]
mod tests;

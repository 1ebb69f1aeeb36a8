//! Static forward model that the tables invert: effects that depend on present forces, and permanent changes in
//! their state at the end of the campaign. Everything else is neutral: reference temperature, no ambient field.

use crate::effects::{DeviceForm, EffectTerm, FinalState, StateSeries};
use crate::fit::base_model::{BaseModel, PolynomialBase};
use crate::fit::polynomial::Polynomial;
use crate::physics::sensor::CYLINDER_WEIGHTS;
use crate::physics::{FieldResponse, ForwardModel, ModelFrames, PhysicalState};
use crate::recordings::columns::Axis;
use firmware::config::constants;
use firmware::fixed_point::Field;
use firmware::model::formats::COORDINATE_LIMIT;
use nalgebra::{Rotation3, Vector3};

/// Half the step of numerical derivatives, relative to the force range.
const STEP: f64 = 0.002;

/// Centres along the line of one force for each along a side of the lattice of two.
pub const LINE_CENTRES: usize = 2;

/// Range of the forces in which a model is valid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForceRegion {
    /// Centre in newtons: lateral, longitudinal.
    pub centre_n: [f64; 2],
    /// Half the range in newtons; zero for a force that is no input of the model.
    pub half_n: [f64; 2],
}

impl ForceRegion {
    /// Both forces up to `limit_n` either way.
    pub fn symmetric(limit_n: f64) -> Self {
        Self { centre_n: [0.0; 2], half_n: [limit_n; 2] }
    }

    /// The same centre with `factor` times the range.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self { half_n: self.half_n.map(|half| factor * half), ..self }
    }

    /// The load at coordinates of -1 to 1.
    pub fn at(&self, coordinates: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| self.centre_n[axis] + self.half_n[axis] * coordinates[axis])
    }

    /// The nearest load within the range.
    pub fn clamped(&self, force_n: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| {
            let (centre, half) = (self.centre_n[axis], self.half_n[axis]);
            force_n[axis].clamp(centre - half, centre + half)
        })
    }

    /// Axes of the forces that are inputs of the model.
    pub fn inputs(&self) -> impl Iterator<Item = usize> + use<> {
        let half_n = self.half_n;
        (0..2).filter(move |axis| half_n[*axis] > 0.0)
    }

    /// The axis of the force of a model of one force.
    pub fn single(&self) -> Option<usize> {
        let mut inputs = self.inputs();
        inputs.next().filter(|_| inputs.next().is_none())
    }

    /// A square lattice of `n` by `n` loads; of one force as many along it.
    pub fn lattice(self, n: usize) -> impl Iterator<Item = [f64; 2]> {
        let single = self.single();
        let line = single.into_iter().flat_map(move |_| self.line(n * n));
        let at = move |i: usize| 2.0 * i as f64 / (n - 1) as f64 - 1.0;
        let count = if single.is_some() { 0 } else { n * n };
        line.chain((0..count).map(move |i| self.at([at(i % n), at(i / n)])))
    }

    /// `count` evenly spaced loads from the lowest to the highest of all forces.
    fn line(self, count: usize) -> impl Iterator<Item = [f64; 2]> {
        let at = move |i: usize| 2.0 * i as f64 / (count - 1) as f64 - 1.0;
        (0..count).map(move |i| self.at([at(i); 2]))
    }
}

/// Polynomial of one or two forces along different axes.
#[derive(Clone, Debug, PartialEq)]
pub struct ForcePolynomial {
    base: PolynomialBase,
    values: Vec<f64>,
    region: ForceRegion,
    /// Standard deviation of the noise of a reading in gauss.
    noise_g: f64,
}

impl ForcePolynomial {
    /// Valid in the fitted range of the forces. `None` without a force, or where several act along one axis.
    pub fn new(polynomial: Polynomial, noise_g: f64) -> Option<Self> {
        let mut region = ForceRegion { centre_n: [0.0; 2], half_n: [0.0; 2] };
        for ((_, axis), (low, high)) in polynomial.forces.iter().zip(&polynomial.spans_n) {
            let axis = usize::from(*axis == Axis::Z);
            region.centre_n[axis] = 0.5 * (low + high);
            region.half_n[axis] = 0.5 * (high - low);
        }
        let base = PolynomialBase::new(polynomial, 1.0)?;
        region.inputs().next()?;
        let values = base.parameters().iter().map(|parameter| parameter.start).collect();
        Some(Self { base, values, region, noise_g })
    }

    /// Response to displacements, which are forces here. Beyond the fitted range it is linear: a polynomial of high degree is
    /// arbitrary there.
    fn response(&self, state: &PhysicalState) -> FieldResponse {
        let force_n = [state.displacement_mm.x, state.displacement_mm.z];
        let [x, z] = self.region.clamped(force_n);
        let within = PhysicalState { displacement_mm: Vector3::new(x, 0.0, z), ..*state };
        let mut response = FieldResponse::default();
        self.base.linearise(&self.values, &[within], &mut |at, _| response = at);
        response.field_g += response.per_mm * (state.displacement_mm - within.displacement_mm);
        response
    }
}

/// Base of a [`StaticModel`].
#[derive(Clone, Debug, PartialEq)]
pub enum StaticBase {
    /// Magnet, flexures, sensor.
    Cylinder(ForwardModel, ModelFrames),
    /// Polynomial of the forces.
    Polynomial(ForcePolynomial),
}

impl From<ForwardModel> for StaticBase {
    fn from(model: ForwardModel) -> Self {
        Self::Cylinder(model, model.frames())
    }
}

impl From<ForcePolynomial> for StaticBase {
    fn from(polynomial: ForcePolynomial) -> Self {
        Self::Polynomial(polynomial)
    }
}

/// Static forward model of one sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct StaticModel {
    base: StaticBase,
    /// Static effects in the order of their stages, with their values.
    effects: Vec<(EffectTerm, Vec<f64>)>,
    /// Number of recordings of the campaign.
    recordings: usize,
    at: FinalState,
}

impl StaticModel {
    /// Without any effect.
    pub fn without_effects(base: impl Into<StaticBase>) -> Self {
        Self { base: base.into(), effects: Vec::new(), recordings: 1, at: FinalState::ENDED }
    }

    /// With the static ones of `effects`, fitted to this many recordings that ended in the state `at`.
    pub fn new(
        base: impl Into<StaticBase>,
        effects: &[(EffectTerm, Vec<f64>)],
        recordings: usize,
        at: FinalState,
    ) -> Self {
        let belongs = |effect: &EffectTerm| match effect {
            EffectTerm::Catalogue(effect) => {
                matches!(effect.device, DeviceForm::Tables | DeviceForm::Settled)
            }
            EffectTerm::Expression(formula) => formula.depends_on_forces_alone(),
        };
        let mut own: Vec<_> =
            effects.iter().filter(|(effect, _)| belongs(effect)).cloned().collect();
        own.sort_by_key(|(effect, _)| effect.stage());
        Self { base: base.into(), effects: own, recordings, at }
    }

    /// Forces in which the model is valid: those of the design, or those that a polynomial was fitted to.
    pub fn region(&self) -> ForceRegion {
        match &self.base {
            StaticBase::Cylinder(model, _) => ForceRegion::symmetric(model.force_range_n),
            StaticBase::Polynomial(polynomial) => polynomial.region,
        }
    }

    /// Lateral and longitudinal stiffness in N/mm; 1 where displacements are forces.
    pub fn stiffness_n_per_mm(&self) -> [f64; 2] {
        match &self.base {
            StaticBase::Cylinder(model, _) => model.stiffness_n_per_mm,
            StaticBase::Polynomial(polynomial) => polynomial.base.stiffness(&polynomial.values),
        }
    }

    /// Rotation from the gripper's to the sensor's axes; a polynomial is of the sensor's axes.
    pub fn element(&self) -> Rotation3<f64> {
        match &self.base {
            StaticBase::Cylinder(_, frames) => frames.element,
            StaticBase::Polynomial(_) => Rotation3::identity(),
        }
    }

    /// Reading without a magnet in gauss; of a polynomial it is unknown and not needed.
    pub fn bias_g(&self) -> Vector3<f64> {
        match &self.base {
            StaticBase::Cylinder(model, _) => model.bias_g,
            StaticBase::Polynomial(_) => Vector3::zeros(),
        }
    }

    /// Weights of the field axes in the inversion from field to forces.
    pub fn weights(&self) -> Vector3<f64> {
        match &self.base {
            StaticBase::Cylinder(..) => CYLINDER_WEIGHTS,
            StaticBase::Polynomial(polynomial) => polynomial.base.inverse_weights(),
        }
    }

    /// Standard deviation of the noise of a reading in gauss.
    pub fn noise_g(&self) -> f64 {
        match &self.base {
            StaticBase::Cylinder(..) => constants::SENSOR_NOISE.value,
            StaticBase::Polynomial(polynomial) => polynomial.noise_g,
        }
    }

    /// Field in gauss under the forces `[Fx, Fz]` in N.
    pub fn field(&self, force_n: [f64; 2]) -> Vector3<f64> {
        let state = self.state(force_n);
        match &self.base {
            StaticBase::Cylinder(model, frames) => model.field_at(frames, &state),
            StaticBase::Polynomial(polynomial) => polynomial.response(&state).field_g,
        }
    }

    /// Field in gauss under these forces, and `[dB/dFx, dB/dFz]` in G/N; zero for a force that is no input.
    pub fn linearised(&self, force_n: [f64; 2]) -> (Vector3<f64>, [Vector3<f64>; 2]) {
        if self.effects.is_empty() {
            let response = self.response(force_n);
            let [kx, kz] = self.stiffness_n_per_mm();
            let per_mm = response.per_mm;
            return (response.field_g, [per_mm.column(0) / kx, per_mm.column(2) / kz]);
        }
        let region = self.region();
        let per_newton = [0, 1].map(|axis| {
            let step_n = STEP * region.half_n[axis];
            if step_n == 0.0 {
                return Vector3::zeros();
            }
            let at = |by: f64| {
                let mut moved = force_n;
                moved[axis] += by;
                self.field(moved)
            };
            (at(step_n) - at(-step_n)) / (2.0 * step_n)
        });
        (self.field(force_n), per_newton)
    }

    /// `[dB/dFx, dB/dFz]` in G/N.
    pub fn per_newton(&self, force_n: [f64; 2]) -> [Vector3<f64>; 2] {
        self.linearised(force_n).1
    }

    /// Reading and derivatives under these forces; of a polynomial the forces are displacements.
    pub fn response(&self, force_n: [f64; 2]) -> FieldResponse {
        let state = self.state(force_n);
        match &self.base {
            StaticBase::Cylinder(model, frames) => model.response_at(frames, &state),
            StaticBase::Polynomial(polynomial) => polynomial.response(&state),
        }
    }

    fn state(&self, force_n: [f64; 2]) -> PhysicalState {
        let stiffness = self.stiffness_n_per_mm();
        if self.effects.is_empty() {
            let [kx, kz] = stiffness;
            let [x, z] = force_n;
            return PhysicalState::displaced(Vector3::new(x / kx, 0.0, z / kz));
        }
        let track = self.at.row(force_n, self.recordings);
        let effects: Vec<(&EffectTerm, &[f64])> =
            self.effects.iter().map(|(effect, values)| (effect, values.as_slice())).collect();
        let states = StateSeries::of(&track, stiffness, &effects).states;
        states.first().copied().unwrap_or(PhysicalState::displaced(Vector3::zeros()))
    }

    /// Directions in gauss in which training samples are offset from the fields of this load: the gap axis of a magnet, a normal
    /// of the surface of a polynomial's fields, two normals of the curve of one force.
    pub fn off_surface(&self, force_n: [f64; 2]) -> Vec<Vector3<f64>> {
        if matches!(self.base, StaticBase::Cylinder(..)) {
            return vec![Vector3::new(0.0, OFF_SURFACE_G, 0.0)];
        }
        let region = self.region();
        let [x, z] = self.per_newton(force_n);
        let [along_x, along_z] = [x * region.half_n[0], z * region.half_n[1]];
        let unit = |direction: Vector3<f64>| direction.try_normalize(0.0);
        let normals = match region.single() {
            None => vec![unit(along_x.cross(&along_z))],
            Some(_) => {
                let along = along_x + along_z;
                let mut least = Vector3::zeros();
                least[along.iamin()] = 1.0;
                let first = along.cross(&least);
                vec![unit(first), unit(along.cross(&first))]
            }
        };
        let span_g = self.span_g();
        normals.into_iter().flatten().map(|normal| normal * (OFF_SURFACE_SHARE * span_g)).collect()
    }

    /// Centres of radial basis functions: fields of a square lattice of loads, or of a line of [`LINE_CENTRES`] times as many loads
    /// as along a side of the lattice, since centres that are closer have large weights of opposite signs. Those of a polynomial are
    /// to both sides of the surface in turn: functions that are centred on it have no slope across it.
    pub fn centre_fields(&self, across: usize) -> Vec<Vector3<f64>> {
        let region = self.region();
        let loads: Vec<[f64; 2]> = match region.single() {
            Some(_) => region.line(LINE_CENTRES * across).collect(),
            None => region.lattice(across).collect(),
        };
        let displaced = |(place, load): (usize, &[f64; 2])| {
            let normals = if self.has_normal_offsets() { self.off_surface(*load) } else { vec![] };
            let turn = match normals.len() {
                2 => place / 2,
                _ => place + place / across,
            };
            let sign = if turn % 2 == 0 { 1.0 } else { -1.0 };
            let normal = normals.get(place % normals.len().max(1)).copied().unwrap_or_default();
            self.field(*load) + normal * (sign * CENTRE_OFFSETS)
        };
        loads.iter().enumerate().map(displaced).collect()
    }

    /// Whether [`StaticModel::off_surface`] is normal to the surface, so that the load is nearest to its offset samples.
    pub(crate) fn has_normal_offsets(&self) -> bool {
        matches!(self.base, StaticBase::Polynomial(_))
    }

    /// Norm of the field's span over the region in gauss.
    fn span_g(&self) -> f64 {
        let (low, high) = self.field_range();
        (high - low).norm()
    }

    /// Minimum and maximum field of each axis over the region in gauss.
    fn field_range(&self) -> (Vector3<f64>, Vector3<f64>) {
        let range = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
        self.region().lattice(21).fold(range, |(low, high), force| {
            let field = self.field(force);
            (low.inf(&field), high.sup(&field))
        })
    }

    /// Two loads of the region that the field does not distinguish; `None` where it determines the forces everywhere. That of a
    /// magnet does by its design.
    pub fn ambiguous_loads(&self) -> Option<[[f64; 2]; 2]> {
        if matches!(self.base, StaticBase::Cylinder(..)) {
            return None;
        }
        let region = self.region();
        let loads: Vec<LoadedField> =
            region.lattice(AMBIGUITY_LOADS).map(|load| (load, self.field(load))).collect();
        let slope = |(one, other): (&LoadedField, &LoadedField)| {
            let apart = region
                .inputs()
                .map(|axis| ((one.0[axis] - other.0[axis]) / region.half_n[axis]).powi(2));
            (one.1 - other.1).norm() / apart.sum::<f64>().sqrt()
        };
        let pairs = || {
            let first = loads.iter().enumerate();
            first.flat_map(|(i, one)| loads[i + 1..].iter().map(move |other| (one, other)))
        };
        let steepest = pairs().map(slope).fold(0.0, f64::max);
        let (one, other) = pairs().min_by(|a, b| slope(*a).total_cmp(&slope(*b)))?;
        (slope((one, other)) <= MIN_SLOPE * steepest).then_some([one.0, other.0])
    }
}

/// A load in newtons and its field in gauss.
type LoadedField = ([f64; 2], Vector3<f64>);

/// Offset of training samples from the surface of a magnet's fields along the gap axis, in gauss.
const OFF_SURFACE_G: f64 = 15.0;
/// The same for a polynomial, relative to the norm of the field's span.
const OFF_SURFACE_SHARE: f64 = 0.01;
/// Distance of centres from a polynomial's surface in offsets of training samples.
const CENTRE_OFFSETS: f64 = 10.0;
/// Loads of each axis between which fields are compared; of one force their square.
const AMBIGUITY_LOADS: usize = 15;
/// Least difference of fields by the difference of the loads in ranges, relative to the largest one.
const MIN_SLOPE: f64 = 0.01;

/// Margin of the box in the plane of motion, relative to the span: allowance for bias and drift before the
/// device reports an out-of-range field.
const MARGIN: f64 = 0.10;
/// Margin along the gap, relative to the field at rest, and its maximum in gauss: covers a change of the gap by
/// 0.25 mm. Loads hardly change this axis, and a wide box lowers its weight in distances.
const GAP_MARGIN: (f64, f64) = (0.25, 300.0);

/// Design box: loads of a region, and the range of their fields.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DesignBox {
    /// Loads.
    pub region: ForceRegion,
    /// Centre of the fields in gauss.
    pub middle_g: Vector3<f64>,
    /// Half their span with the margin, in gauss.
    pub half_g: Vector3<f64>,
}

impl DesignBox {
    /// Box of the region of a model.
    pub fn of(model: &StaticModel) -> Self {
        let (low, high) = model.field_range();
        let half = 0.5 * (high - low);
        let widened = half * (1.0 + 2.0 * MARGIN);
        let half_g = match model.base {
            StaticBase::Cylinder(..) => {
                let (share, most_g) = GAP_MARGIN;
                let gap_g = (share * model.field([0.0; 2]).norm()).min(most_g);
                Vector3::new(widened.x, half.y + gap_g, widened.z)
            }
            // Of one scale on all axes, like the distance to the surface: fields of an axis that the forces hardly move drift as
            // much as those of the others.
            StaticBase::Polynomial(_) => Vector3::repeat(widened.max()),
        };
        Self { region: model.region(), middle_g: 0.5 * (high + low), half_g }
    }

    /// A field as coordinates of -1 to 1 inside the box.
    pub fn coordinates(&self, field_g: &Vector3<f64>) -> Vector3<f64> {
        (field_g - self.middle_g).component_div(&self.half_g)
    }

    /// Offset and gain of each axis on the device, and the box that they represent exactly.
    pub fn device_scale(&self, gauss_per_lsb: f64) -> ([(f64, f64); 3], Self) {
        let units = f64::from(1_u32 << Field::BITS) / gauss_per_lsb;
        let limit = f64::from(COORDINATE_LIMIT);
        let bits = f64::from(1_u32 << firmware::model::formats::GAIN_BITS);
        let scale: [(f64, f64); 3] = std::array::from_fn(|axis| {
            let offset = (self.middle_g[axis] * units).round();
            let gain = (limit / (self.half_g[axis] * units) * bits).round();
            (offset, gain)
        });
        let exact = Self {
            middle_g: Vector3::from_fn(|axis, _| scale[axis].0 / units),
            half_g: Vector3::from_fn(|axis, _| limit * bits / scale[axis].1 / units),
            ..*self
        };
        (scale, exact)
    }
}

//! Static forward model that the tables invert: effects that depend on present forces, and permanent changes in
//! their state at the end of the campaign. Everything else is neutral: reference temperature, no ambient field.

use crate::effects::{DeviceForm, EffectTerm, FinalState, StateSeries};
use crate::physics::{FieldResponse, ForwardModel, ModelFrames, PhysicalState};
use firmware::fixed_point::Field;
use firmware::model::formats::COORDINATE_LIMIT;
use nalgebra::Vector3;

/// Half the step of numerical derivatives, relative to the force range.
const STEP: f64 = 0.002;

/// Static forward model of one sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct StaticModel {
    /// Magnet, flexures, sensor.
    pub model: ForwardModel,
    frames: ModelFrames,
    /// Static effects in the order of their stages, with their values.
    effects: Vec<(EffectTerm, Vec<f64>)>,
    /// Number of recordings of the campaign.
    recordings: usize,
    at: FinalState,
}

impl StaticModel {
    /// Without any effect.
    pub fn without_effects(model: ForwardModel) -> Self {
        let (frames, at) = (model.frames(), FinalState::ENDED);
        Self { frames, model, effects: Vec::new(), recordings: 1, at }
    }

    /// With the static ones of `effects`, fitted to this many recordings that ended in the state `at`.
    pub fn new(
        model: ForwardModel,
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
        Self { frames: model.frames(), model, effects: own, recordings, at }
    }

    /// Field in gauss under the forces `[Fx, Fz]` in N.
    pub fn field(&self, force_n: [f64; 2]) -> Vector3<f64> {
        self.model.field_at(&self.frames, &self.state(force_n))
    }

    /// Field in gauss under these forces, and `[dB/dFx, dB/dFz]` in G/N.
    pub fn linearised(&self, force_n: [f64; 2]) -> (Vector3<f64>, [Vector3<f64>; 2]) {
        if self.effects.is_empty() {
            let response = self.model.response_at(&self.frames, &self.state(force_n));
            return (response.field_g, self.model.per_newton(&response));
        }
        let step_n = STEP * self.model.force_range_n;
        let per_newton = [0, 1].map(|axis| {
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

    /// Reading and derivatives under these forces.
    pub fn response(&self, force_n: [f64; 2]) -> FieldResponse {
        self.model.response_at(&self.frames, &self.state(force_n))
    }

    fn state(&self, force_n: [f64; 2]) -> PhysicalState {
        if self.effects.is_empty() {
            return PhysicalState::displaced(self.model.displacement(force_n));
        }
        let track = self.at.row(force_n, self.recordings);
        let effects: Vec<(&EffectTerm, &[f64])> =
            self.effects.iter().map(|(effect, values)| (effect, values.as_slice())).collect();
        let states = StateSeries::of(&track, self.model.stiffness_n_per_mm, &effects).states;
        states.first().copied().unwrap_or(PhysicalState::displaced(Vector3::zeros()))
    }
}

/// Margin of the box in the plane of motion, relative to the span: allowance for bias and drift before the
/// device reports an out-of-range field.
const MARGIN: f64 = 0.10;
/// Margin along the gap, relative to the field at rest, and its maximum in gauss: covers a change of the gap by
/// 0.25 mm. Loads hardly change this axis, and a wide box lowers its weight in distances.
const GAP_MARGIN: (f64, f64) = (0.25, 300.0);

/// Design box: loads up to `force_n` either way on both axes, and the range of their fields.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DesignBox {
    /// Maximum force of each axis in newtons, either way.
    pub force_n: [f64; 2],
    /// Centre of the fields in gauss.
    pub middle_g: Vector3<f64>,
    /// Half their span with the margin, in gauss.
    pub half_g: Vector3<f64>,
}

impl DesignBox {
    /// Box of the design's force range.
    pub fn of(model: &StaticModel) -> Self {
        let force_n = [model.model.force_range_n; 2];
        let (mut low, mut high) =
            (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
        for force in lattice(force_n, 21) {
            let field = model.field(force);
            (low, high) = (low.inf(&field), high.sup(&field));
        }
        let half = 0.5 * (high - low);
        let (share, most_g) = GAP_MARGIN;
        let gap_g = (share * model.field([0.0; 2]).norm()).min(most_g);
        Self {
            force_n,
            middle_g: 0.5 * (high + low),
            half_g: Vector3::new(
                half.x * (1.0 + 2.0 * MARGIN),
                half.y + gap_g,
                half.z * (1.0 + 2.0 * MARGIN),
            ),
        }
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

/// A square lattice of `n` by `n` loads up to `force_n`.
pub fn lattice(force_n: [f64; 2], n: usize) -> impl Iterator<Item = [f64; 2]> {
    let at = move |i: usize| 2.0 * i as f64 / (n - 1) as f64 - 1.0;
    (0..n * n).map(move |i| [force_n[0] * at(i % n), force_n[1] * at(i / n)])
}

//! What the tables of the ideal model invert: the forward model with those effects that depend on
//! the present forces alone, and with what has changed the gripper for good, as it is in the end.
//! Everything else is at rest: the reference temperature, nothing outside.

use nalgebra::{Matrix3, Vector3};

use crate::effects::{Addition, Series, Track, Undone};
use crate::physics::{ForwardModel, Frames, State};

/// Load cycles and seconds after which whatever settles has settled.
const SETTLED: f64 = 1e9;

/// Half the step of the differences, as a share of the force range.
const STEP: f64 = 0.002;

/// The forward model of one sensor at rest.
#[derive(Clone, Debug)]
pub struct AtRest {
    /// Magnet, flexures, sensor.
    pub model: ForwardModel,
    frames: Frames,
    /// Effects that depend on the forces, in the order of their stages, with their values.
    effects: Vec<(Addition, Vec<f64>)>,
    /// Recordings of the campaign that the effects are of.
    recordings: usize,
}

impl AtRest {
    /// Without any effect.
    pub fn plain(model: ForwardModel) -> Self {
        Self {
            frames: model.frames(),
            model,
            effects: Vec::new(),
            recordings: 1,
        }
    }

    /// With those of `effects`, fitted to this many recordings, that belong here.
    pub fn new(model: ForwardModel, effects: &[(Addition, Vec<f64>)], recordings: usize) -> Self {
        let belongs = |effect: &Addition| matches!(effect, Addition::Catalogue(effect) if matches!(effect.undone, Undone::Tables | Undone::Settled));
        let mut own: Vec<_> = effects
            .iter()
            .filter(|(effect, _)| belongs(effect))
            .cloned()
            .collect();
        own.sort_by_key(|(effect, _)| effect.stage());
        Self {
            frames: model.frames(),
            model,
            effects: own,
            recordings,
        }
    }

    /// Field in gauss under the forces `[Fx, Fz]` in N.
    pub fn field(&self, force_n: [f64; 2]) -> Vector3<f64> {
        self.model.field_in(&self.frames, &self.state(force_n))
    }

    /// `[dB/dFx, dB/dFz]` in G/N.
    pub fn per_newton(&self, force_n: [f64; 2]) -> [Vector3<f64>; 2] {
        let step_n = STEP * self.model.force_range_n;
        [0, 1].map(|axis| {
            let at = |by: f64| {
                let mut moved = force_n;
                moved[axis] += by;
                self.field(moved)
            };
            (at(step_n) - at(-step_n)) / (2.0 * step_n)
        })
    }

    /// dB/dd in G/mm under these forces.
    pub fn per_mm(&self, force_n: [f64; 2]) -> Matrix3<f64> {
        self.model
            .respond_in(&self.frames, &self.state(force_n))
            .per_mm
    }

    fn state(&self, force_n: [f64; 2]) -> State {
        if self.effects.is_empty() {
            return State::displaced(self.model.displacement(force_n));
        }
        let track = Track {
            time_s: vec![0.0],
            force_n: vec![force_n],
            recording: self.recordings.saturating_sub(1),
            start_s: SETTLED,
            cycles: vec![[SETTLED; 2]],
            ..Track::default()
        };
        let effects: Vec<(&Addition, &[f64])> = self
            .effects
            .iter()
            .map(|(effect, values)| (effect, values.as_slice()))
            .collect();
        let states = Series::of(&track, self.model.stiffness_n_per_mm, &effects).states;
        states
            .first()
            .copied()
            .unwrap_or(State::displaced(Vector3::zeros()))
    }
}

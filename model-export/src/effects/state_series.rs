//! From reference forces to the states of a sensor, row by row, with the effects of a model.

use std::borrow::Cow;

use nalgebra::Vector3;

use crate::effects::EffectTerm;
use crate::effects::excitation::{ExcitationSeries, select_rows};
use crate::physics::{FieldResponse, PhysicalState};

/// Position of an effect in the chain from force to field. Effects are applied in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum EffectStage {
    /// Errors of the reference: clock, filter, zero.
    Reference,
    /// Forces on the flexures that the reference does not measure.
    Load,
    /// Non-elastic response of the flexures.
    Flexure,
    /// Displacement of the magnet in addition to the flexures' deflection.
    Displacement,
    /// Changes of the magnet.
    Magnet,
    /// Errors of the opening computed from the motor's angle.
    Opening,
    /// External fields.
    Outside,
    /// Errors of the Hall sensor.
    Sensor,
}

impl EffectStage {
    /// Stages of effects that change the force on the flexures.
    pub const FORCES: &'static [Self] = &[Self::Reference, Self::Load, Self::Flexure];
    /// Stages of effects that change the displacement, which follows from the force.
    pub const DISPLACEMENTS: &'static [Self] =
        &[Self::Reference, Self::Load, Self::Flexure, Self::Displacement];

    /// True where it changes the force on the flexures.
    pub fn acts_on_force(self) -> bool {
        self <= Self::Flexure
    }

    /// True where the effect requires a base with geometry.
    pub fn needs_geometry(self) -> bool {
        matches!(self, Self::Displacement | Self::Magnet)
    }
}

/// States of a sensor, row by row, while effects are applied.
#[derive(Clone, Debug, Default)]
pub struct StateSeries {
    /// Force on each flexure in newtons; after [`EffectStage::Flexure`] the equivalent elastic force.
    pub force_n: Vec<[f64; 2]>,
    /// Opening between the fingertips in mm; empty if not recorded.
    pub opening_mm: Vec<f64>,
    /// States; displacements are computed from the forces before [`EffectStage::Displacement`].
    pub states: Vec<PhysicalState>,
}

impl StateSeries {
    /// The states over an excitation with this stiffness in N/mm; `effects` in the order of their stages, each
    /// with its values.
    pub fn of(
        excitation: &ExcitationSeries,
        stiffness_n_per_mm: [f64; 2],
        effects: &[(&EffectTerm, &[f64])],
    ) -> Self {
        let mut series = Self::unloaded(excitation);
        for acts_on_force in [true, false] {
            let group = effects.iter();
            for effect in group.filter(|effect| effect.0.stage().acts_on_force() == acts_on_force) {
                series.apply(*effect, excitation, stiffness_n_per_mm);
            }
        }
        series.displaced(stiffness_n_per_mm)
    }

    /// The recorded forces and opening, without states.
    fn unloaded(excitation: &ExcitationSeries) -> Self {
        Self {
            force_n: excitation.force_n.clone(),
            opening_mm: excitation.covariates.get("opening_mm").cloned().unwrap_or_default(),
            states: Vec::new(),
        }
    }

    /// Applies the next effect of the chain with its values.
    fn apply(
        &mut self,
        (effect, values): (&EffectTerm, &[f64]),
        excitation: &ExcitationSeries,
        stiffness_n_per_mm: [f64; 2],
    ) {
        if !effect.stage().acts_on_force() {
            *self = std::mem::take(self).displaced(stiffness_n_per_mm);
        }
        effect.apply(values, excitation, self);
    }

    /// With the states that follow from the forces, where it has none.
    fn displaced(mut self, [kx, kz]: [f64; 2]) -> Self {
        if self.states.is_empty() {
            let displaced =
                |[x, z]: &[f64; 2]| PhysicalState::displaced(Vector3::new(x / kx, 0.0, z / kz));
            self.states = self.force_n.iter().map(displaced).collect();
        }
        self
    }

    /// The selected rows, in this order.
    pub fn at(&self, rows: &[usize]) -> Self {
        Self {
            force_n: select_rows(&self.force_n, rows),
            opening_mm: select_rows(&self.opening_mm, rows),
            states: select_rows(&self.states, rows),
        }
    }

    /// Adds `term(row)` to the force of one axis (0 lateral, 1 longitudinal).
    pub fn add_force(&mut self, axis: usize, term: impl Fn(usize) -> f64) {
        for (row, force) in self.force_n.iter_mut().enumerate() {
            force[axis] += term(row);
        }
    }
}

/// The series of a model before each of its effects: what a change of one parameter changes is computed from there.
pub struct EffectChain<'a> {
    excitation: &'a ExcitationSeries,
    stiffness_n_per_mm: [f64; 2],
    /// In the order of their stages, each with its values.
    effects: Vec<(&'a EffectTerm, &'a [f64])>,
    before: Vec<StateSeries>,
    last: StateSeries,
}

impl<'a> EffectChain<'a> {
    /// Of a model; arguments as of [`StateSeries::of`].
    pub fn new(
        excitation: &'a ExcitationSeries,
        stiffness_n_per_mm: [f64; 2],
        effects: Vec<(&'a EffectTerm, &'a [f64])>,
    ) -> Self {
        let mut last = StateSeries::unloaded(excitation);
        let mut before = Vec::with_capacity(effects.len());
        for effect in &effects {
            before.push(last.clone());
            last.apply(*effect, excitation, stiffness_n_per_mm);
        }
        let last = last.displaced(stiffness_n_per_mm);
        Self { excitation, stiffness_n_per_mm, effects, before, last }
    }

    /// States after all effects.
    pub fn states(&self) -> &[PhysicalState] {
        &self.last.states
    }

    /// The series where the effect at `place` has these values.
    pub fn moved(&self, place: usize, values: &[f64]) -> MovedSeries<'_> {
        let (Some((effect, _)), Some(before)) = (self.effects.get(place), self.before.get(place))
        else {
            return self.moved_force(Cow::Borrowed(&self.last.force_n), self.stiffness_n_per_mm);
        };
        let mut moved = before.clone();
        moved.apply((effect, values), self.excitation, self.stiffness_n_per_mm);
        let later = self.effects.get(place + 1..).unwrap_or_default();
        let on_state = |later: &&(&EffectTerm, &[f64])| !later.0.stage().acts_on_force();
        if effect.stage().acts_on_force() {
            for later in later.iter().filter(|later| !on_state(later)) {
                moved.apply(*later, self.excitation, self.stiffness_n_per_mm);
            }
        }
        if later.iter().filter(on_state).any(|(later, _)| later.depends_on(effect)) {
            for later in later.iter().filter(on_state) {
                moved.apply(*later, self.excitation, self.stiffness_n_per_mm);
            }
            return MovedSeries::between(self.states(), &moved.states);
        }
        if effect.stage().acts_on_force() {
            return self.moved_force(Cow::Owned(moved.force_n), self.stiffness_n_per_mm);
        }
        let from = self.before.get(place + 1).unwrap_or(&self.last);
        MovedSeries::between(&from.states, &moved.states)
    }

    /// The same where the flexures have another stiffness.
    pub fn moved_stiffness(&self, stiffness_n_per_mm: [f64; 2]) -> MovedSeries<'_> {
        let reads_displacement = |effect: &EffectTerm| {
            let reads = effect.effect().map_or(&[][..], |effect| effect.reads);
            !effect.stage().acts_on_force() && reads.contains(&EffectStage::Flexure)
        };
        if self.effects.iter().any(|(effect, _)| reads_displacement(effect)) {
            let moved = StateSeries::of(self.excitation, stiffness_n_per_mm, &self.effects);
            return MovedSeries::between(self.states(), &moved.states);
        }
        self.moved_force(Cow::Borrowed(&self.last.force_n), stiffness_n_per_mm)
    }

    fn moved_force<'s>(
        &'s self,
        to_n: Cow<'s, [[f64; 2]]>,
        to_n_per_mm: [f64; 2],
    ) -> MovedSeries<'s> {
        MovedSeries::Forces {
            from: (&self.last.force_n, self.stiffness_n_per_mm),
            to: (to_n, to_n_per_mm),
        }
    }
}

/// What a moved parameter changes in a series. A fit keeps one for each parameter at a time, of recordings of any length.
pub enum MovedSeries<'s> {
    /// Where no effect depends on the displacement: forces in newtons and stiffnesses in N/mm, before and after.
    Forces {
        /// At the parameters of the chain.
        from: (&'s [[f64; 2]], [f64; 2]),
        /// At the moved parameter.
        to: (Cow<'s, [[f64; 2]]>, [f64; 2]),
    },
    /// Components of the states that change in any row ([`PhysicalState::components`]), each with its changes.
    States(Vec<(usize, Vec<f64>)>),
}

impl MovedSeries<'_> {
    /// Between states at the parameters of the chain and at the moved parameter.
    fn between(from: &[PhysicalState], to: &[PhysicalState]) -> Self {
        let mut changing = [false; PhysicalState::COMPONENTS];
        for (from, to) in from.iter().zip(to).filter(|(from, to)| from != to) {
            let pairs = from.components().into_iter().zip(to.components());
            for (changing, (from, to)) in changing.iter_mut().zip(pairs) {
                *changing |= from != to;
            }
        }
        let changing = (0..PhysicalState::COMPONENTS).filter(|component| changing[*component]);
        let mut changes: Vec<(usize, Vec<f64>)> =
            changing.map(|component| (component, Vec::with_capacity(to.len()))).collect();
        for (from, to) in from.iter().zip(to) {
            let (from, to) = (from.components(), to.components());
            for (component, changes) in &mut changes {
                changes.push(to[*component] - from[*component]);
            }
        }
        Self::States(changes)
    }

    /// First-order changes of the reading, given the responses of the rows from `first` on.
    pub fn changes<'a>(
        &'a self,
        first: usize,
        responses: &'a [FieldResponse],
    ) -> impl Iterator<Item = Vector3<f64>> + 'a {
        responses.iter().enumerate().map(move |(row, response)| {
            let row = first + row;
            match self {
                Self::Forces { from: (from, [x, z]), to: (to, [kx, kz]) } => {
                    let (from, to) = (from[row], to[row]);
                    response.per_mm.column(0) * (to[0] / kx - from[0] / x)
                        + response.per_mm.column(2) * (to[1] / kz - from[1] / z)
                }
                Self::States(components) => {
                    components.iter().fold(Vector3::zeros(), |change, (component, changes)| {
                        change + response.per_component(*component) * changes[row]
                    })
                }
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{CATALOGUE, Effect, EffectParameter, ParameterKind};
    use crate::recordings::columns::STATOR_CURRENTS;
    use nalgebra::Matrix3;

    const ROWS: usize = 60;

    /// Value of a smooth curve of amplitude 1 in this row.
    fn wave(row: usize, phase: f64) -> f64 {
        (0.37 * row as f64 + phase).sin()
    }

    fn excitation() -> ExcitationSeries {
        let column = |phase: f64| -> Vec<f64> { (0..ROWS).map(|row| wave(row, phase)).collect() };
        let pair = |a: f64, b: f64| -> Vec<[f64; 2]> {
            (0..ROWS).map(|row| [100.0 * wave(row, a), 200.0 * wave(row, b)]).collect()
        };
        let names = [
            "opening_mm",
            "roll_rad",
            "pitch_rad",
            "yaw_rad",
            "accel_x_mps2",
            "accel_z_mps2",
            "motor_iq_a",
            STATOR_CURRENTS[0],
            STATOR_CURRENTS[1],
        ];
        let covariates = names.iter().enumerate();
        ExcitationSeries {
            time_s: (0..ROWS).map(|row| 0.1 * row as f64).collect(),
            force_n: pair(0.0, 1.0),
            smooth_n: pair(0.1, 1.1),
            rate_n_per_s: pair(2.0, 3.0),
            cycles: pair(0.5, 0.7).into_iter().map(|pair| pair.map(f64::abs)).collect(),
            temperature_c: column(4.0).into_iter().map(|t| 25.0 + 5.0 * t).collect(),
            covariates: covariates
                .map(|(i, name)| ((*name).to_owned(), column(i as f64)))
                .collect(),
            recording: 1,
            ..ExcitationSeries::default()
        }
    }

    /// Derivatives that are all different.
    fn responses() -> Vec<FieldResponse> {
        let matrix = |row: usize, phase: f64| {
            Matrix3::from_fn(|i, j| wave(row, phase + 1.3 * i as f64 + 0.7 * j as f64))
        };
        let response = |row: usize| FieldResponse {
            field_g: Vector3::zeros(),
            at_element_g: Vector3::zeros(),
            per_field: matrix(row, 1.0),
            per_mm: matrix(row, 2.0),
            per_tilt: [matrix(row, 3.0).column(0).into(), matrix(row, 3.0).column(1).into()],
            per_strength: matrix(row, 4.0).column(0).into(),
            per_external: matrix(row, 5.0),
            per_gain: matrix(row, 6.0).column(0).into(),
            per_rotation: matrix(row, 7.0),
            per_offset: matrix(row, 8.0),
            per_compression: matrix(row, 9.0).column(0).into(),
        };
        (0..ROWS).map(response).collect()
    }

    /// Values at typical magnitudes, and the same with one parameter moved.
    fn values(effect: &Effect, moved: Option<usize>) -> Vec<f64> {
        let parameters = effect.parameters.iter().flat_map(|parameter| parameter.repeated(2));
        let value = |(place, parameter): (usize, EffectParameter)| {
            let value = match &parameter.kind {
                ParameterKind::Shape { grid } => grid[grid.len() / 2],
                ParameterKind::Instant => 1.0,
                ParameterKind::InitialState => 0.3,
                ParameterKind::Coefficient => parameter.typical,
            };
            if moved == Some(place) { value * 1.1 } else { value }
        };
        parameters.enumerate().map(value).collect()
    }

    #[test]
    fn changes_are_those_of_the_whole_chain() {
        let (excitation, responses, stiffness) = (excitation(), responses(), [2.0, 5.0]);
        let all: Vec<EffectTerm> = CATALOGUE.into_iter().map(EffectTerm::Catalogue).collect();
        let compare = |found: MovedSeries, from: &StateSeries, to: &StateSeries, what: &str| {
            let states = from.states.iter().zip(&to.states).zip(&responses);
            let expected: Vec<Vector3<f64>> =
                states.map(|((from, to), response)| response.change(from, to)).collect();
            let largest = expected.iter().map(|change| change.amax()).fold(0.0, f64::max);
            // In two parts, as a fit does.
            let (first, second) = responses.split_at(ROWS / 3);
            let found = found.changes(0, first).chain(found.changes(first.len(), second));
            let found: Vec<Vector3<f64>> = found.collect();
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).amax() <= 1e-9 * largest.max(1e-3), "{what}");
            }
            assert_eq!(found.len(), expected.len(), "{what}");
            largest
        };
        for (one, other) in all.iter().flat_map(|one| all.iter().map(move |other| (one, other))) {
            let mut pair = if one == other { vec![one] } else { vec![one, other] };
            pair.sort_by_key(|effect| effect.stage());
            let terms: Vec<Vec<f64>> =
                pair.iter().map(|effect| values(effect.effect().unwrap(), None)).collect();
            let chain: Vec<(&EffectTerm, &[f64])> =
                pair.iter().zip(&terms).map(|(effect, values)| (*effect, &values[..])).collect();
            let from = StateSeries::of(&excitation, stiffness, &chain);
            let effect_chain = EffectChain::new(&excitation, stiffness, chain.clone());
            for (place, (effect, values_here)) in chain.iter().enumerate() {
                let mut largest = 0.0_f64;
                for index in 0..values_here.len() {
                    let moved = values(effect.effect().unwrap(), Some(index));
                    let mut other = chain.clone();
                    other[place].1 = &moved;
                    let to = StateSeries::of(&excitation, stiffness, &other);
                    let found = effect_chain.moved(place, &moved);
                    let what =
                        format!("{} of {:?}", effect.name(), [one.name(), other[0].0.name()]);
                    largest = largest.max(compare(found, &from, &to, &what));
                }
                // A backlash of the screw changes the field only through a magnet that depends on the opening.
                assert!(largest > 0.0 || effect.name() == "screw_backlash", "{}", effect.name());
            }
            let to = StateSeries::of(&excitation, [2.1, 4.8], &chain);
            let found = effect_chain.moved_stiffness([2.1, 4.8]);
            assert!(compare(found, &from, &to, one.name()) > 0.0);
        }
    }
}

//! From reference forces to the states of a sensor, with the effects of a model one by one.

use std::borrow::Cow;

use nalgebra::Vector3;

use crate::effects::{EffectStage, EffectTerm, ExcitationSeries, StateSeries};
use crate::physics::{FieldResponse, PhysicalState};

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

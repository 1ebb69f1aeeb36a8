//! The recurrent network: two layers of gated recurrent units and a linear head, in integers.
//!
//! The equation is PyTorch's, with the reset after the product:
//!
//! ```text
//! r = sigmoid(W_r x + b_r + U_r h)
//! z = sigmoid(W_z x + b_z + U_z h)
//! n = tanh(W_n x + b_n + r (U_n h + c_n))
//! h' = n + z (h - n)
//! ```
//!
//! [`portable`] is the definition of every bit; hosts run it. On the chip [`step`] runs a kernel in
//! assembly that gives the same bits, and the same number of instructions whatever the numbers are.
//!
//! **State.** 32 bits, of which the products see the upper half. With 16 bits a state would stand still
//! where its gate is slow: a step of (1 - z) times the difference would round to nothing. A candidate
//! stays within ±(2^30 - 2^16), and a state within two units of the last bit of that: it is a mean of
//! itself and the candidate, weighted with 32 bits and rounded once. So no difference of the two
//! overflows, however long the network runs, and rounding errors decay with the memory itself.
//!
//! **Reset.** [`State::RESET`], all zero: what training starts from. Until [`Network::warm_up`] steps
//! have passed the outputs still tell of that start more than of the inputs: the estimate must not be
//! used. The exporter counts these steps for each network: until the reset and a past with every input
//! at the end of its range tell the same.

pub mod portable;
pub mod scale;

use super::network::{Network, Source, State, Told, Weights};

/// One step over the inputs in `state`: changes the states, leaves the outputs there.
#[inline(always)]
pub fn step<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &Weights<INPUTS, HIDDEN, SENSORS>,
    state: &mut State<INPUTS, HIDDEN, SENSORS>,
) {
    #[cfg(target_os = "none")]
    super::kernel::gru::step(weights, state);
    #[cfg(not(target_os = "none"))]
    portable::step(weights, state);
}

/// A network's state with the steps that it has made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Run<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize> {
    /// What it remembers.
    pub state: State<INPUTS, HIDDEN, SENSORS>,
    /// Steps since the reset; it stays at the end of its range.
    pub steps: u16,
}

impl<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize> Run<INPUTS, HIDDEN, SENSORS> {
    /// After a reset.
    pub const RESET: Self = Self {
        state: State::RESET,
        steps: 0,
    };

    /// One step over `value`, which tells what a source says, in the source's unit. Nothing until the
    /// start is forgotten; where a source says nothing, the run begins anew: it has lost time.
    pub fn step(
        &mut self,
        network: &Network<INPUTS, HIDDEN, SENSORS>,
        value: impl Fn(Source) -> Option<i32>,
    ) -> Option<[Told; SENSORS]> {
        let mut is_whole = true;
        for (scaled, pair) in self.state.input.iter_mut().zip(&network.inputs) {
            *scaled = pair.map(|input| {
                let value = value(input.source);
                is_whole &= value.is_some();
                scale::input(input, value.unwrap_or_default())
            });
        }
        if !is_whole {
            *self = Self::RESET;
            return None;
        }
        step(&network.weights, &mut self.state);
        self.steps = self.steps.saturating_add(1);
        let told = self
            .state
            .outputs
            .map(|outputs| scale::told(network.force, outputs));
        (self.steps > network.warm_up).then_some(told)
    }
}

#[cfg(test)]
mod tests;

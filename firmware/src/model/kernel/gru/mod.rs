//! One step of a recurrent network: two layers of gated recurrent units and a linear head, in integers.
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
//! A step has two parts: [`prepare`] multiplies the states of both layers by the recurrent weights `U` and needs no input, so that
//! it can be done before the reading of a sensor arrives; [`finish`] does the rest.
//!
//! **State.** 32 bits, of which the products use the upper half. A state of 16 bits would stall at slow gates, where
//! (1 - z) times the difference rounds to zero. A candidate stays within ±(2^30 - 2^16), and a state within two units of
//! the last place of that: it is a mean of itself and the candidate with 32-bit weights, rounded once. So their
//! difference never overflows, and rounding errors decay with the state itself.

#[cfg(target_os = "none")]
mod assembly;
pub mod portable;

#[cfg(target_os = "none")]
pub use assembly::{finish, prepare};
#[cfg(not(target_os = "none"))]
pub use portable::{finish, prepare};

use crate::model::formats::{GruState, Weights};

/// One step on the inputs in `state`: updates the states and the outputs there.
#[inline(always)]
pub fn step<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    weights: &Weights<INPUTS, HIDDEN, SENSORS>,
    state: &mut GruState<INPUTS, HIDDEN, SENSORS>,
) {
    prepare(weights, state);
    finish(weights, state);
}

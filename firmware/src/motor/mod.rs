//! The motor: from what is sensed in a period of the pulses to what the switches do in the next.
//!
//! - [`stage`]: the border to what switches and senses.

pub mod stage;

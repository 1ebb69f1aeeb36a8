//! The plant against cases worked by hand.

mod energy;
mod grasps;
mod rotor;
mod source;
mod study;

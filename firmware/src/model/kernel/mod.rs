//! The chip's own versions of the two sums that take the time, in assembly.
//!
//! Each gives the bits of its definition in portable Rust, which the self-test proves on an emulated
//! core. The only unsafe code of the models stands here: functions in assembly, which Rust cannot look
//! into, and the calls of them. Their pointers come from references to structs whose layout is fixed
//! (`repr(C)`, words and pairs of half words, so no gaps) and whose sizes are the constants that the
//! loops count: they read and write inside them and nowhere else.
//!
//! The code lies in `.ccm`, the memory beside the core, where no instruction waits.
#![allow(unsafe_code)]

pub mod grbf;
pub mod gru;
mod placement;

//! Self-test of the kernels: on the core of the chip each has the bit-exact result of its portable definition, and takes the
//! same number of instructions for all inputs.
//!
//! It runs on an emulated core (`.ci/selftest`).
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod chip;
#[cfg(target_os = "none")]
mod counts;
#[cfg(target_os = "none")]
mod grip;
#[cfg(target_os = "none")]
mod motor;
#[cfg(target_os = "none")]
mod tasks;
#[cfg(target_os = "none")]
mod vectors;

#[cfg(not(target_os = "none"))]
fn main() {
    println!(
        "The self-test compares the chip's kernels with their portable definitions: it runs on the \
         chip's core. `.ci/selftest` builds it and runs it in QEMU."
    );
}

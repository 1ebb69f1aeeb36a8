//! The self-test of the kernels: on the chip's core each gives the bits of its portable definition, and
//! takes the same number of instructions whatever the numbers are.
//!
//! It runs on an emulated core (`.ci/selftest`); on a computer it says so.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod chip;
#[cfg(target_os = "none")]
mod copies;
#[cfg(target_os = "none")]
mod counts;
#[cfg(target_os = "none")]
mod grip;
#[cfg(target_os = "none")]
mod loops;
#[cfg(target_os = "none")]
mod motor;
#[cfg(target_os = "none")]
mod vectors;

#[cfg(not(target_os = "none"))]
fn main() {
    println!(
        "The self-test compares the chip's kernels with their portable definitions: it runs on the \
         chip's core. `.ci/selftest` builds it and runs it in QEMU."
    );
}

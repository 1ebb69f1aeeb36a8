//! The modules of `sim` that read plans of recordings, without its simulated gripper.
#![allow(dead_code)]

#[path = "../../../host-tools/sim/src/motion.rs"]
pub mod motion;
#[path = "../../../host-tools/sim/src/random.rs"]
pub mod random;

/// As in `sim`.
#[path = "."]
pub mod campaign {
    #[path = "../../../host-tools/sim/src/campaign/plan.rs"]
    pub mod plan;
}

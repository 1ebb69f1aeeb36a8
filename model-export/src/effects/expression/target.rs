//! What a formula may give: a displacement of the magnet, a force on it, a field.

use crate::effects::series::Stage;

/// What a formula gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Target {
    pub(super) name: &'static str,
    pub(super) unit: &'static str,
    pub(super) stage: Stage,
    /// x, y, z of the gripper.
    pub(super) axis: usize,
}

const fn target(name: &'static str, unit: &'static str, stage: Stage, axis: usize) -> Target {
    Target {
        name,
        unit,
        stage,
        axis,
    }
}

/// Everything that a formula may give.
pub(super) const TARGETS: [Target; 8] = [
    target("fx_n", "N", Stage::Load, 0),
    target("fz_n", "N", Stage::Load, 2),
    target("dx_um", "um", Stage::Displacement, 0),
    target("dy_um", "um", Stage::Displacement, 1),
    target("dz_um", "um", Stage::Displacement, 2),
    target("bx_g", "G", Stage::Outside, 0),
    target("by_g", "G", Stage::Outside, 1),
    target("bz_g", "G", Stage::Outside, 2),
];

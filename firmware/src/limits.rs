//! Where something counts as wrong: every detector's threshold, in one place.
//!
//! The loops take them as a value, so that a test can switch one detector off and see that nothing else
//! notices.

/// Thresholds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Ticks without a reading, one after the other, at which a sensor is lost.
    pub lost_ticks: u8,
    /// Axes that repeated their words, counted over readings that follow each other, at which a sensor is
    /// frozen: three readings after the last that moved. Four equal words in a row are, for Gaussian noise
    /// of s counts, 1 in 2 (2 pi)^(3/2) s^3 an axis: 3 in 10^9 of all readings for three, one tick a day.
    pub frozen_axes: u8,
    /// Transfers in a row that fail before a bus is cleared.
    pub failed_transfers: u8,
    /// Ticks in a row with a line held low that are a fault.
    pub stuck_ticks: u8,
    /// Ticks in a row in which a field is outside the model's box.
    pub outside_ticks: u8,
    /// Difference of the fingers' forces in newtons, with a tenth of the force on top (control study).
    pub unbalanced_n: i32,
    /// Ticks in a row with that difference.
    pub unbalanced_ticks: u8,
    /// Frames of one source within 10 ms that are heard; ten times what a host may send.
    pub flood_frames: u8,
}

impl Limits {
    /// What the gripper runs with.
    pub const GRIPPER: Self = Self {
        lost_ticks: 2,
        frozen_axes: 9,
        failed_transfers: 3,
        stuck_ticks: 4,
        outside_ticks: 3,
        unbalanced_n: 15,
        unbalanced_ticks: 3,
        flood_frames: 20,
    };
}

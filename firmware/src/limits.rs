//! Where something counts as wrong: every detector's threshold, in one place.
//!
//! The loops take them as a value, so that a test can switch one detector off and see that nothing else
//! notices.

use crate::params;

/// Thresholds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Ticks without a reading, one after the other, at which a sensor is lost.
    pub lost_ticks: u8,
    /// Axes that repeated their words, counted over readings that follow each other, at which a sensor is
    /// frozen: three readings after the last that moved. Four equal words in a row are, for Gaussian noise
    /// of s counts, 1 in 2 (2 pi)^(3/2) s^3 an axis: 3 in 10^9 of all readings for three, one tick a day.
    pub frozen_axes: u8,
    /// Looks in a row at which a sensor's configuration is not what it was, and the sensor is lost.
    pub strange_looks: u8,
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
    /// Newtons by which a network is away from the ideal model, with a fifth of the force on top, at which it is
    /// not believed.
    pub astray_n: i32,
    /// Ticks in a row with that difference.
    pub astray_ticks: u8,
    /// Frames of one source within 10 ms that are heard; ten times what a host may send.
    pub flood_frames: u8,
}

impl Limits {
    /// What the gripper runs with.
    pub const GRIPPER: Self = Self {
        lost_ticks: 2,
        frozen_axes: 9,
        strange_looks: 2,
        failed_transfers: 3,
        stuck_ticks: 4,
        outside_ticks: 3,
        unbalanced_n: 15,
        unbalanced_ticks: 3,
        astray_n: 40,
        astray_ticks: 2,
        flood_frames: 20,
    };
}

/// Thresholds of the grasp, and its times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grasp {
    /// Force in newtons beyond which the fingers press against something.
    pub contact_n: f32,
    /// Force in newtons below which they do not.
    pub no_contact_n: f32,
    /// Milliseconds below it after which a contact ends.
    pub no_contact_ms: u16,
    /// Speed in mm/s below which the fingers rest.
    pub resting_mm_s: f32,
    /// Milliseconds of rest after which they have stopped.
    pub resting_ms: u16,
    /// Milliseconds after which a stop is over, whether they rest or not.
    pub stop_ms: u32,
    /// Millimetres from a place at which it is reached.
    pub reached_mm: f32,
    /// A force is right within so many newtons, or this share of it.
    pub right_n: f32,
    /// See [`Self::right_n`].
    pub right: f32,
    /// Milliseconds for which it has to be.
    pub settle_ms: u16,
    /// While it is held, an error of so many newtons moves nothing, or this share of the force.
    pub dead_n: f32,
    /// See [`Self::dead_n`].
    pub dead: f32,
    /// Milliseconds after which a screw that locks itself holds alone.
    pub lock_ms: u32,
    /// Milliseconds in which the current then falls to zero.
    pub ramp_ms: u32,
    /// Without current the force may fall by so many newtons, or this share of it.
    pub weak_n: f32,
    /// See [`Self::weak_n`].
    pub weak: f32,
    /// Milliseconds for which it has to.
    pub weak_ms: u16,
    /// Times within [`Self::regrip_ms`] that it is gripped again.
    pub regrips: u8,
    /// See [`Self::regrips`].
    pub regrip_ms: u32,
    /// Force in newtons below which nothing is held.
    pub nothing_n: f32,
    /// Milliseconds after which an object is gone.
    pub gone_ms: u16,
    /// Share of what friction bears at which an object slips.
    pub slip_share: f32,
    /// Fall of the drag in newtons that is a slip: three standard deviations of the sum of four forces.
    pub slip_fall_n: f32,
    /// Milliseconds from one slip to the next.
    pub slip_pause_ms: u16,
    /// What a slip raises the force by.
    pub slip_factor: f32,
    /// Milliseconds within which a grip comes about once something is touched.
    pub grip_ms: u32,
    /// Milliseconds of an approach: the slowest one, over the whole stroke.
    pub approach_ms: u32,
    /// Opening in millimetres at which the fingers meet.
    pub met_mm: f32,
    /// Ticks without a force that is believed, after which there is none.
    pub blind_ticks: u8,
    /// Milliseconds of forces that are believed after which they are again.
    pub sighted_ms: u16,
    /// Force in newtons that is left after too much of it.
    pub backed_off_n: f32,
    /// Homing: force in newtons at which the fingers have met.
    pub home_n: f32,
    /// Homing: speed of closing in mm/s.
    pub home_mm_s: f32,
    /// Homing: greatest current in amperes.
    pub home_a: f32,
    /// Homing: milliseconds at the most.
    pub home_ms: u32,
    /// Homing: speed in mm/s below which the far end is reached: the rotor's noise is more on a steep screw.
    pub end_mm_s: f32,
    /// Homing: milliseconds of rest that are an end.
    pub end_ms: u16,
    /// Homing: the way is the stroke within so many millimetres.
    pub stroke_mm: f32,
    /// Millimetres beyond its ends at which an opening is not to be believed.
    pub stray_mm: f32,
    /// Milliseconds of it.
    pub stray_ms: u16,
    /// Current in amperes of a rotor that is jammed.
    pub jam_a: f32,
    /// Mean speed in mm/s below which it is; the slowest approach is at 2 mm/s.
    pub jam_mm_s: f32,
    /// Milliseconds of it.
    pub jam_ms: u16,
    /// Greatest force in newtons at each sensor before a foot, and at its end.
    pub unloaded_n: f32,
    /// Milliseconds without load after which a foot ends.
    pub unloaded_ms: u16,
    /// Opening in millimetres of a flat foot, at the most.
    pub flat_mm: f32,
    /// Opening in millimetres of a foot that stands on a line, and how far it may be off.
    pub line_mm: [f32; 2],
    /// Current in amperes that keeps a foot's fingers where they are.
    pub foot_a: f32,
    /// Force in newtons at which a fingertip stands.
    pub foot_on_n: f32,
    /// Force in newtons at which it stands no more.
    pub foot_off_n: f32,
    /// Milliseconds for which a peak is kept.
    pub peak_ms: u16,
    /// Force in newtons at one fingertip that is too much; an impact of 3 ms may be read 13 % low.
    pub overload_n: f32,
}

impl Grasp {
    /// What the gripper runs with.
    pub const GRIPPER: Self = Self {
        contact_n: 5.0,
        no_contact_n: 2.5,
        no_contact_ms: 5,
        resting_mm_s: 0.5,
        resting_ms: 5,
        stop_ms: 200,
        reached_mm: 0.1,
        right_n: 2.0,
        right: 0.02,
        settle_ms: 50,
        dead_n: 0.3,
        dead: 0.002,
        lock_ms: 200,
        ramp_ms: 20,
        weak_n: 5.0,
        weak: 0.05,
        weak_ms: 3,
        regrips: 3,
        regrip_ms: 10_000,
        nothing_n: 3.0,
        gone_ms: 3,
        slip_share: 0.9,
        slip_fall_n: 6.0,
        slip_pause_ms: 200,
        slip_factor: 1.2,
        grip_ms: 5_000,
        approach_ms: 60_000,
        met_mm: 0.2,
        blind_ticks: 3,
        sighted_ms: 20,
        backed_off_n: 50.0,
        home_n: 10.0,
        home_mm_s: 5.0,
        home_a: 1.5,
        home_ms: 30_000,
        end_mm_s: 1.0,
        end_ms: 50,
        stroke_mm: 1.0,
        stray_mm: 0.8,
        stray_ms: 3,
        jam_a: 1.2,
        jam_mm_s: 0.8,
        jam_ms: 40,
        unloaded_n: 20.0,
        unloaded_ms: 50,
        flat_mm: 1.0,
        line_mm: [params::LINE_FOOT.value as f32, 1.0],
        foot_a: 1.0,
        foot_on_n: 15.0,
        foot_off_n: 7.0,
        peak_ms: 10,
        overload_n: 0.87 * params::FORCE_RANGE.value as f32,
    };
}

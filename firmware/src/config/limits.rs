//! Thresholds of the detectors of sensing and communication, and of the grip. Those of the motor are in
//! [`crate::motor::settings`], those of the disturbance detection in [`crate::estimator::disturbance`].
//!
//! They are passed as values, so that a test can disable one detector and check that no other reacts.

use crate::config::constants;

/// [`DetectionLimits::frozen_axes`] of the gripper.
pub const FROZEN_AXES: u8 = 12;

/// Thresholds of the detectors of sensing and communication.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DetectionLimits {
    /// Ticks in a row without a reading until a sensor is lost.
    pub lost_ticks: u8,
    /// Axes with repeated words, summed over consecutive readings, until a sensor is frozen: four readings after the last
    /// change. Five equal words in a row have, for Gaussian noise of s counts, a probability of 1 in 5^(1/2) (2 pi)^2 s^4 per
    /// axis: 6 in 10^12 readings for three axes, one in 460 days of four sensors. With one reading less it would be one a day.
    /// `None`: never.
    pub frozen_axes: Option<u8>,
    /// Read-backs in a row with a changed configuration until a sensor is lost; `None`: never, and no recovery of its bus either.
    pub config_mismatches: Option<u8>,
    /// Failed transfers in a row until a bus is recovered.
    pub failed_transfers: u8,
    /// Ticks in a row with a line stuck low until a fault.
    pub stuck_ticks: u8,
    /// Ticks in a row with a field outside the range of the sensor until a fault.
    pub saturated_ticks: u8,
    /// Ticks in a row with a field outside the range of the model until a fault.
    pub outside_ticks: u8,
    /// Difference of the forces of the fingers in newtons, plus a tenth of the force (control study).
    pub unbalanced_n: i32,
    /// Ticks in a row with that difference until a fault.
    pub unbalanced_ticks: u8,
    /// Difference between network and ideal model in newtons, plus a fifth of the force, until the network is replaced.
    pub divergence_n: i32,
    /// Ticks in a row with that difference.
    pub divergence_ticks: u8,
    /// Frames of one source admitted within 10 ms; ten times the specified rate of a host.
    pub flood_frames: u8,
}

impl DetectionLimits {
    /// Thresholds of the gripper.
    pub const GRIPPER: Self = Self {
        lost_ticks: 2,
        frozen_axes: Some(FROZEN_AXES),
        config_mismatches: Some(2),
        failed_transfers: 3,
        stuck_ticks: 4,
        saturated_ticks: 1,
        outside_ticks: 3,
        unbalanced_n: 15,
        unbalanced_ticks: 3,
        divergence_n: 40,
        divergence_ticks: 2,
        flood_frames: 20,
    };
}

/// Thresholds and times of the grip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripLimits {
    /// Force in newtons above which contact begins.
    pub contact_n: f32,
    /// Force in newtons below which contact ends.
    pub no_contact_n: f32,
    /// Milliseconds below it until contact ends.
    pub no_contact_ms: u16,
    /// Speed in mm/s below which the fingers are at rest.
    pub resting_mm_s: f32,
    /// Milliseconds at rest until they have stopped.
    pub resting_ms: u16,
    /// Time-out of a stop in milliseconds.
    pub stop_ms: u32,
    /// Position tolerance in millimetres.
    pub reached_mm: f32,
    /// Force tolerance in newtons; the larger of this and [`Self::tolerance_ratio`] applies.
    pub tolerance_n: f32,
    /// Force tolerance as a fraction of the set-point.
    pub tolerance_ratio: f32,
    /// Milliseconds within the tolerance until the force has settled.
    pub settle_ms: u16,
    /// Deadband of the force control in newtons; the larger of this and [`Self::deadband_ratio`] applies.
    pub deadband_n: f32,
    /// Deadband as a fraction of the set-point.
    pub deadband_ratio: f32,
    /// Milliseconds until a self-locking screw holds without current.
    pub lock_ms: u32,
    /// Milliseconds of the ramp of the current to zero.
    pub ramp_ms: u32,
    /// Loss of force without current that triggers a regrip, in newtons; the larger of this and [`Self::force_loss_ratio`]
    /// applies.
    pub force_loss_n: f32,
    /// The same as a fraction of the set-point.
    pub force_loss_ratio: f32,
    /// Milliseconds with that loss.
    pub force_loss_ms: u16,
    /// Regrips allowed within [`Self::regrip_ms`].
    pub regrips: u8,
    /// Time window of [`Self::regrips`].
    pub regrip_ms: u32,
    /// Force in newtons below which there is no object.
    pub no_object_n: f32,
    /// Milliseconds until an object is lost.
    pub object_lost_ms: u16,
    /// Fraction of the friction limit above which an object slips.
    pub slip_ratio: f32,
    /// Drop of the tangential force in newtons that indicates slip: three standard deviations of the sum of four forces.
    pub slip_drop_n: f32,
    /// Minimum time between two slips in milliseconds.
    pub slip_pause_ms: u16,
    /// Factor on the force set-point at a slip.
    pub slip_factor: f32,
    /// Maximum force set-point after slips as a multiple of the requested one.
    pub slip_cap: f32,
    /// Milliseconds without a slip until the force returns to the requested one.
    pub slip_return_ms: u32,
    /// Time-out from contact to a settled grip in milliseconds.
    pub grip_ms: u32,
    /// Time-out of an approach in milliseconds: the slowest over the whole stroke.
    pub approach_ms: u32,
    /// Opening in millimetres below which the fingers touch.
    pub fingers_met_mm: f32,
    /// Ticks without a valid force until it is unknown.
    pub invalid_ticks: u8,
    /// Milliseconds of valid forces until they are used again.
    pub valid_again_ms: u16,
    /// Maximum force set-point of any profile in newtons, also after slips.
    pub max_n: f32,
    /// Force in newtons above which the fingers back off in every state.
    pub trip_n: f32,
    /// Force set-point in newtons after an overforce.
    pub overforce_release_n: f32,
    /// Homing: force in newtons at which the fingers meet.
    pub home_n: f32,
    /// Homing: speed of closing in mm/s.
    pub home_mm_s: f32,
    /// Homing: current limit in amperes.
    pub home_a: f32,
    /// Homing: time-out in milliseconds.
    pub home_ms: u32,
    /// Homing: speed in mm/s below which the end stop is reached: the noise is larger with a coarse screw.
    pub end_stop_mm_s: f32,
    /// Homing: milliseconds at rest that indicate the end stop.
    pub end_stop_ms: u16,
    /// Homing: tolerance of the measured stroke in millimetres.
    pub stroke_mm: f32,
    /// Closing moves: force in newtons, or its rise since the fingers were last unloaded, that ends them.
    pub move_n: f32,
    /// Moves without believed forces: maximum speed in mm/s.
    pub uncalibrated_mm_s: f32,
    /// Moves without believed forces: maximum current in amperes, which presses with 22 to 40 N; the moving rotor adds up to 20 N.
    pub uncalibrated_a: f32,
    /// Opening moves: outward force in newtons that ends them.
    pub outward_n: f32,
    /// Opening without a valid force: maximum speed in mm/s.
    pub blind_mm_s: f32,
    /// Opening without a valid force: maximum current in amperes; enough to loosen the screw under the maximum force.
    pub blind_a: f32,
    /// Opening without a valid force: rise of the current in amperes above its minimum that indicates an obstacle.
    pub blind_rise_a: f32,
    /// Travel in millimetres by which the fingers must close until an obstacle of such an opening is forgotten: more than a hand that
    /// was pressed with 60 N pushes a backdrivable screw back. A host that clears the faults has it forgotten as well.
    pub clear_mm: f32,
    /// Milliseconds of an opening, or of homing, in which the current loosens the screw and indicates no obstacle.
    pub loosening_ms: u32,
    /// Time-out of an opening in milliseconds.
    pub release_ms: u32,
    /// Time-out in milliseconds of the opening after excessive force.
    pub back_off_ms: u32,
    /// Last valid lateral force of a sensor in newtons beyond which its estimate outside the range of the model is taken for
    /// excessive force.
    pub beyond_n: f32,
    /// Backdrive test: rise of the force in newtons at which the stiffness of the part is evaluated.
    pub part_n: f32,
    /// Backdrive test: minimum stiffness of the part in N/mm; a hand is softer.
    pub part_n_per_mm: f32,
    /// Overtravel beyond the end stops in millimetres that is a fault.
    pub overtravel_mm: f32,
    /// Milliseconds with that overtravel.
    pub overtravel_ms: u16,
    /// Torque constant of the motor in N m per ampere, which the currents here are for.
    pub torque_nm_a: f32,
    /// Current in amperes above which a rotor at rest is stalled.
    pub stall_a: f32,
    /// Mean speed in mm/s below which it is stalled; the slowest approach is at 2 mm/s.
    pub stall_mm_s: f32,
    /// Milliseconds until a stall is detected.
    pub stall_ms: u16,
    /// Force in newtons at each sensor below which ground contact may be enabled, and ends.
    pub unloaded_n: f32,
    /// Milliseconds without load until ground contact mode ends.
    pub unloaded_ms: u16,
    /// Maximum opening in millimetres for flat ground contact.
    pub flat_contact_mm: f32,
    /// Opening for ground contact along a line, and its tolerance, in millimetres.
    pub line_contact_mm: [f32; 2],
    /// Current limit in amperes that holds the fingers in ground contact.
    pub ground_hold_a: f32,
    /// Force in newtons above which a fingertip has ground contact.
    pub ground_contact_n: f32,
    /// Force in newtons below which it has none.
    pub ground_release_n: f32,
    /// Hold time of a force peak in milliseconds.
    pub peak_ms: u16,
    /// Overload of one fingertip in newtons; an impact of 3 ms may be measured 13 % low.
    pub overload_n: f32,
}

impl GripLimits {
    /// Values of the gripper.
    pub const GRIPPER: Self = Self {
        contact_n: 5.0,
        no_contact_n: 2.5,
        no_contact_ms: 5,
        resting_mm_s: 0.5,
        resting_ms: 5,
        stop_ms: 200,
        reached_mm: 0.1,
        tolerance_n: 2.0,
        tolerance_ratio: 0.02,
        settle_ms: 50,
        deadband_n: 0.3,
        deadband_ratio: 0.002,
        lock_ms: 200,
        ramp_ms: 20,
        force_loss_n: 5.0,
        force_loss_ratio: 0.05,
        force_loss_ms: 3,
        regrips: 3,
        regrip_ms: 10_000,
        no_object_n: 3.0,
        object_lost_ms: 3,
        slip_ratio: 0.9,
        slip_drop_n: 6.0,
        slip_pause_ms: 200,
        slip_factor: 1.2,
        slip_cap: 1.5,
        slip_return_ms: 2_000,
        grip_ms: 5_000,
        approach_ms: 60_000,
        fingers_met_mm: 0.2,
        invalid_ticks: 3,
        valid_again_ms: 20,
        max_n: 400.0,
        trip_n: 450.0,
        overforce_release_n: 50.0,
        home_n: 10.0,
        home_mm_s: 5.0,
        home_a: 1.5,
        home_ms: 30_000,
        end_stop_mm_s: 1.0,
        end_stop_ms: 50,
        stroke_mm: 1.0,
        move_n: 20.0,
        uncalibrated_mm_s: 25.0,
        uncalibrated_a: 0.6,
        outward_n: 15.0,
        blind_mm_s: 10.0,
        blind_a: 4.0,
        blind_rise_a: 0.7,
        clear_mm: 6.0,
        loosening_ms: 100,
        release_ms: 10_000,
        back_off_ms: 2_000,
        beyond_n: 0.8 * constants::FORCE_RANGE.value as f32,
        part_n: 25.0,
        part_n_per_mm: 30.0,
        overtravel_mm: 0.8,
        overtravel_ms: 3,
        torque_nm_a: constants::TORQUE_CONSTANT.value as f32,
        stall_a: 1.2,
        stall_mm_s: 0.8,
        stall_ms: 40,
        unloaded_n: 20.0,
        unloaded_ms: 50,
        flat_contact_mm: 1.0,
        line_contact_mm: [constants::LINE_CONTACT_OPENING.value as f32, 1.0],
        ground_hold_a: 1.0,
        ground_contact_n: 15.0,
        ground_release_n: 7.0,
        peak_ms: 10,
        overload_n: 0.87 * constants::FORCE_RANGE.value as f32,
    };

    /// Maximum force set-point on the bench in newtons.
    pub const BENCH_N: f32 = 20.0;
}

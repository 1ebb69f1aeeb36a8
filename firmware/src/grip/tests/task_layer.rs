//! Details of the task layer: entry into states, events of single milliseconds, refusals, and the status message.

use crate::config::limits::GripLimits;
use crate::estimator::Estimate;
use crate::fixed_point::Force;
use crate::grip::commands::{MoveTarget, RefusalReason, WidthWindow, flag, mode};
use crate::grip::states::{PowerState, TaskState};
use crate::grip::tests::rig::{GripRig, pressed};
use crate::grip::transitions::TaskEvent;
use crate::grip::{ControlInputs, GripController};
use crate::motor::Setpoint;
use crate::motor::foc::Dq;
use crate::protocol::OPENING_UNKNOWN;
use crate::system::faults::Fault;

fn bit(fault: Fault) -> u32 {
    1 << fault.index()
}

fn in_task(task: TaskState) -> GripRig {
    let mut rig = GripRig::enabled(true);
    rig.grip.task = task;
    rig.grip.copy();
    rig
}

/// Estimates of equal forces on both fingers.
fn press(rig: &mut GripRig, newtons: f64) {
    let half = 0.5 * newtons;
    rig.estimates = Some(pressed([half, half, -half, -half], [0.0; 4]));
}

#[test]
fn disable_is_refused_while_something_moves_or_may_be_held() {
    use TaskState::*;
    for (task, refused) in [
        (Unhomed, None),
        (Idle, None),
        (NoObject, None),
        (Lost, None),
        (TimeoutHold, None),
        (Homing, Some(RefusalReason::Busy)),
        (Moving, Some(RefusalReason::Busy)),
        (Approach, Some(RefusalReason::Busy)),
        (Releasing, Some(RefusalReason::Busy)),
        (Stopping, Some(RefusalReason::Busy)),
        (ContactStop, Some(RefusalReason::Busy)),
        (Force, Some(RefusalReason::Gripping)),
        (HoldActive, Some(RefusalReason::Gripping)),
        (HoldLatched, Some(RefusalReason::Gripping)),
        (HoldFrozen, Some(RefusalReason::Gripping)),
        (GripFailed, Some(RefusalReason::Gripping)),
        (Foot, Some(RefusalReason::FootMode)),
    ] {
        let mut rig = in_task(task);
        rig.send(mode::DISABLE, |_| {});
        assert_eq!(rig.refused.first().copied(), refused, "{task:?}");
        let power = if refused.is_none() { PowerState::Armed } else { PowerState::Enabled };
        assert_eq!(rig.grip.power(), power, "{task:?}");
        // Once disabled, it has no effect.
        if refused.is_none() {
            rig.send(mode::STOP, |_| {});
            rig.send(mode::DISABLE, |_| {});
            assert_eq!(rig.refused, [RefusalReason::NotEnabled]);
        }
    }
}

#[test]
fn repeated_command_is_executed_again_only_with_the_flag_toggled() {
    let mut rig = GripRig::enabled(true);
    for (flags, is_executed) in [
        (flag::UNCALIBRATED, true),
        (flag::UNCALIBRATED, false),
        (flag::UNCALIBRATED | flag::AGAIN, true),
        (flag::UNCALIBRATED | flag::AGAIN, false),
        (flag::UNCALIBRATED, true),
    ] {
        // At the target already, a move lasts until the fingers have rested.
        rig.grip.resting_ms = 0;
        rig.send(mode::MOVE, |command| {
            (command.position, command.speed, command.flags) = (900, 200, flags);
        });
        assert_eq!(rig.grip.task() == TaskState::Moving, is_executed, "{flags}");
        rig.run_until(TaskState::Idle);
    }
    // Once enabled, ENABLE is a sign of life.
    rig.send(mode::ENABLE, |_| {});
    assert!(rig.refused.is_empty());
}

#[test]
fn fault_of_two_tasks_prevents_enabling() {
    let mut rig = GripRig::new(true);
    rig.run(5);
    rig.arm();
    rig.corrupt = Some(|estimates| *estimates = [Estimate::MISSING; 4]);
    rig.run(5);
    for is_reported_twice in [false, true] {
        rig.fault(Fault::Blind, is_reported_twice);
        rig.send(mode::ENABLE, |_| {});
        assert_eq!(rig.refused.pop(), Some(RefusalReason::FaultActive));
    }
}

#[test]
fn release_without_a_live_host_is_refused_while_disabled() {
    for (is_alive, refused) in [(false, Some(RefusalReason::NotEnabled)), (true, None)] {
        let mut rig = GripRig::new(true);
        rig.run(5);
        rig.arm();
        rig.host.is_alive = is_alive;
        rig.send(mode::RELEASE, |command| (command.position, command.speed) = (1400, 40));
        assert_eq!(rig.refused.first().copied(), refused);
        assert_eq!(rig.grip.power() == PowerState::Enabled, is_alive);
    }
}

#[test]
fn release_without_a_session_is_refused_as_not_enabled() {
    let mut rig = GripRig::new(true);
    rig.run(5);
    assert_eq!(rig.grip.power(), PowerState::Safe);
    rig.send(mode::RELEASE, |command| (command.position, command.speed) = (1400, 40));
    assert_eq!(rig.refused, [RefusalReason::NotEnabled]);
}

#[test]
fn homing_and_grips_are_refused_without_a_valid_force() {
    let mut rig = GripRig::enabled(true);
    // Disturbed forces are invalid and, unlike lost ones, no fault of the grip.
    rig.corrupt = Some(|estimates| {
        for estimate in estimates {
            estimate.disturbed = true;
        }
    });
    rig.run(3);
    for mode in [mode::HOME, mode::GRIP, mode::MOVE] {
        rig.send(mode, |command| {
            (command.position, command.speed, command.force) = (1400, 40, 500);
        });
    }
    assert_eq!(rig.refused, [RefusalReason::Blind; 2]);
    assert_eq!(rig.grip.task(), TaskState::Moving);
}

#[test]
fn loaded_foot_accepts_foot_again() {
    let mut rig = GripRig::foot(true);
    rig.estimates = Some(pressed([0.0; 4], [50.0; 4]));
    rig.run(10);
    rig.send(mode::FOOT, |command| command.flags = flag::AGAIN);
    assert_eq!((rig.refused.first(), rig.grip.task()), (None, TaskState::Foot));
}

#[test]
fn release_must_open() {
    // At 50 mm: 1000 counts of 0.05 mm.
    for (position, refused) in [
        (999, Some(RefusalReason::OutOfRange)),
        (1000, Some(RefusalReason::OutOfRange)),
        (1001, None),
    ] {
        let mut rig = GripRig::enabled(true);
        rig.send(mode::RELEASE, |command| (command.position, command.speed) = (position, 40));
        assert_eq!(rig.refused.first().copied(), refused, "{position}");
    }
}

#[test]
fn move_to_the_present_opening_closes() {
    for (position, is_opening) in [(999, false), (1000, false), (1001, true)] {
        let mut rig = GripRig::enabled(true);
        rig.send(mode::MOVE, |command| (command.position, command.speed) = (position, 40));
        assert_eq!(rig.grip.is_opening, is_opening, "{position}");
    }
}

#[test]
fn held_position_is_the_first_at_rest() {
    let mut rig = in_task(TaskState::Idle);
    rig.grip.hold_mm = None;
    rig.grip.copy();
    for _ in 0..10 {
        rig.motor.closing_mm_s = 10.0;
        rig.tick();
        assert_eq!(rig.grip.hold_mm, None);
    }
    for _ in 0..30 {
        rest(&mut rig, Some(45.0), 0.0);
    }
    assert_eq!(rig.grip.hold_mm, Some(45.0));
    for _ in 0..10 {
        rest(&mut rig, Some(45.5), 0.0);
    }
    assert_eq!(rig.grip.hold_mm, Some(45.0));
}

#[test]
fn line_foot_has_a_tolerance_of_one_millimetre() {
    for (opening_mm, flags, is_parked) in [
        (39.0, flag::LINE, true),
        (41.0, flag::LINE, true),
        (38.9, flag::LINE, false),
        (41.1, flag::LINE, false),
        (0.5, flag::LINE, false),
        (1.0, 0, true),
        (1.1, 0, false),
    ] {
        let mut rig = GripRig::enabled_at(true, opening_mm);
        rig.run(20);
        rig.send(mode::FOOT, |command| command.flags = flags);
        assert_eq!(rig.grip.task() == TaskState::Foot, is_parked, "{opening_mm}");
    }
}

/// A controller with all that a grasp leaves behind.
fn used() -> GripController {
    let mut grip = GripRig::enabled(true).grip;
    (grip.is_gripped, grip.has_settled) = (true, true);
    (grip.in_band_ms, grip.low_force_ms, grip.opening_ms) = (7, 8, 9);
    grip.hold_mm = Some(30.0);
    grip.move_target = MoveTarget { opening_mm: 60.0, speed_mm_s: 4.0, is_uncalibrated: false };
    for tick in 0_u8..100 {
        grip.stiffness.update(0.01 * f32::from(tick), -30.0 * f32::from(tick));
    }
    assert!((grip.stiffness() - 5.0).abs() < 1e-3);
    grip
}

#[test]
fn entered_states_reset_what_belongs_to_the_last() {
    use TaskState::*;
    // Gripped, settled, held position, time since the opening began.
    for (from, to, is_gripped, has_settled, hold_mm, opening_ms) in [
        (Idle, Approach, false, false, None, 9),
        (Approach, Force, true, true, None, 9),
        (Force, GripFailed, true, true, None, 9),
        (Force, HoldActive, true, true, None, 9),
        (Moving, Idle, false, false, Some(60.0), 9),
        (Releasing, Idle, false, false, Some(60.0), 9),
        (ContactStop, Idle, false, false, None, 9),
        (HoldActive, Lost, false, false, None, 9),
        (Approach, NoObject, false, false, None, 9),
        (HoldActive, Releasing, true, false, None, 0),
        (Releasing, Releasing, true, false, None, 9),
        (HoldActive, HoldLatched, true, true, None, 9),
    ] {
        let mut grip = used();
        grip.task = from;
        grip.enter_task(to);
        assert_eq!((grip.task, grip.task_ms), (to, 0));
        assert_eq!(
            (grip.is_gripped, grip.has_settled),
            (is_gripped, has_settled),
            "{from:?} {to:?}"
        );
        assert_eq!((grip.hold_mm, grip.opening_ms), (hold_mm, opening_ms), "{from:?} {to:?}");
        assert_eq!((grip.in_band_ms, grip.low_force_ms), (0, 0));
        let stiffness = if to == Approach { 333.0 } else { 5.0 };
        assert!((grip.stiffness() - stiffness).abs() < 1e-3, "{from:?} {to:?}");
    }
    let mut grip = used();
    (grip.is_gripped, grip.has_settled) = (false, false);
    grip.enter_task(Force);
    assert_eq!((grip.is_gripped, grip.has_settled), (true, false));
    grip.enter_task(HoldActive);
    assert!(grip.has_settled);
}

#[test]
fn each_slip_raises_the_force_by_a_fifth_up_to_one_and_a_half() {
    let slipped = |is_alive, cap_n| {
        let mut grip = used();
        (grip.target.setpoint_n, grip.target.cap_n, grip.setpoint_n) = (20.0, cap_n, 20.0);
        [(); 3].map(|()| {
            grip.task = TaskState::HoldActive;
            grip.apply_task_event(TaskEvent::Slipped, is_alive);
            assert_eq!((grip.slipping_ms, grip.since_slip_ms), (200, 0));
            grip.setpoint_n
        })
    };
    let near = |found: [f32; 3], expected: [f32; 3]| {
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-3), "{found:?}");
    };
    near(slipped(true, 100.0), [24.0, 28.8, 30.0]);
    near(slipped(true, 25.0), [24.0, 25.0, 25.0]);
    near(slipped(false, 100.0), [20.0, 20.0, 20.0]);
}

#[test]
fn slipping_is_reported_for_its_pause() {
    let mut rig = in_task(TaskState::Idle);
    (rig.grip.slipping_ms, rig.grip.setpoint_n) = (3, 100.0);
    rig.grip.copy();
    let active = [(); 3].map(|()| {
        rig.tick();
        rig.grip.fault_bits() & bit(Fault::Slipping) != 0
    });
    assert_eq!(active, [true, true, false]);
    rig.grip.slipping_ms = 2;
    rig.grip.copy();
    rig.tick();
    let event = rig.outputs.as_ref().unwrap().events.first().copied().unwrap();
    // 100 N * 1024.
    assert_eq!((event.code, event.detail), (Fault::Slipping as u16, 102_400));
}

/// Whether the screw may hold alone.
fn may_latch(change: impl Fn(&mut GripController)) -> bool {
    let mut grip = used();
    (grip.setpoint_n, grip.mean_n, grip.task_ms, grip.in_band_ms) = (100.0, 100.0, 200, 1);
    grip.now_ms = 50_000;
    change(&mut grip);
    grip.may_release_current()
}

#[test]
fn screw_holds_alone_after_200_ms_near_the_set_point() {
    assert!(may_latch(|_| {}));
    assert!(!may_latch(|grip| grip.task_ms = 199));
    assert!(!may_latch(|grip| grip.in_band_ms = 0));
    assert!(!may_latch(|grip| grip.self_locking = false));
    // One and a half deadbands of 0.3 N; after one second any error.
    assert!(may_latch(|grip| grip.mean_n = 99.56));
    assert!(!may_latch(|grip| grip.mean_n = 99.54));
    assert!(may_latch(|grip| grip.mean_n = 100.44));
    assert!(!may_latch(|grip| grip.mean_n = 100.46));
    assert!(!may_latch(|grip| (grip.mean_n, grip.task_ms) = (90.0, 999)));
    assert!(may_latch(|grip| (grip.mean_n, grip.task_ms) = (90.0, 1000)));
    // Of 350 N the deadband is 0.7 N, of 250 N 0.5 N.
    assert!(may_latch(|grip| (grip.setpoint_n, grip.mean_n) = (350.0, 349.0)));
    assert!(!may_latch(|grip| (grip.setpoint_n, grip.mean_n) = (350.0, 348.9)));
    assert!(!may_latch(|grip| (grip.setpoint_n, grip.mean_n) = (250.0, 249.25)));
    // Three regrips within ten seconds.
    assert!(may_latch(|grip| grip.regrips_ms = [Some(49_000), Some(48_000), None]));
    assert!(!may_latch(|grip| grip.regrips_ms = [Some(49_000), Some(48_000), Some(40_001)]));
    assert!(may_latch(|grip| grip.regrips_ms = [Some(49_000), Some(48_000), Some(40_000)]));
}

#[test]
fn force_lost_on_the_screw_is_regripped() {
    // More than 5 N, or 5 %, for 3 ms.
    for (setpoint_n, force_n, is_regripped) in [
        (50.0, 45.0, false),
        (50.0, 44.5, true),
        (200.0, 192.0, false),
        (200.0, 190.0, false),
        (200.0, 189.0, true),
    ] {
        let mut rig = in_task(TaskState::HoldLatched);
        (rig.grip.setpoint_n, rig.grip.target.setpoint_n) = (setpoint_n, setpoint_n);
        rig.grip.copy();
        press(&mut rig, force_n);
        rig.run(2);
        assert_eq!(rig.grip.task(), TaskState::HoldLatched);
        rig.tick();
        assert_eq!(rig.grip.task() == TaskState::Force, is_regripped, "{setpoint_n} {force_n}");
    }
}

#[test]
fn grip_settles_after_50_ms_or_fails_after_5_s() {
    let confirmed = |force_n: f64, from_ms: u32, ticks: u32| {
        let mut rig = in_task(TaskState::Idle);
        press(&mut rig, force_n);
        rig.run(3);
        rig.grip.task = TaskState::Force;
        (rig.grip.setpoint_n, rig.grip.target.setpoint_n) = (100.0, 100.0);
        rig.grip.task_ms = from_ms;
        rig.grip.copy();
        rig.run(ticks);
        rig.grip.task()
    };
    assert_eq!(confirmed(99.0, 0, 49), TaskState::Force);
    assert_eq!(confirmed(99.0, 0, 50), TaskState::HoldActive);
    assert_eq!(confirmed(98.0, 0, 60), TaskState::Force);
    assert_eq!(confirmed(101.5, 0, 50), TaskState::HoldActive);
    assert_eq!(confirmed(90.0, 4998, 1), TaskState::Force);
    assert_eq!(confirmed(90.0, 4998, 2), TaskState::GripFailed);
    // Without a confirmed contact there is no object.
    assert_eq!(confirmed(4.0, 0, 1), TaskState::Lost);
}

#[test]
fn tolerance_of_a_strong_grip_is_2_percent() {
    // 7 N of 350 N.
    for (force_n, settles) in [(344.0, true), (342.75, false)] {
        let mut rig = in_task(TaskState::Idle);
        press(&mut rig, force_n);
        rig.run(3);
        rig.grip.task = TaskState::Force;
        (rig.grip.setpoint_n, rig.grip.target.setpoint_n, rig.grip.task_ms) = (350.0, 350.0, 0);
        rig.grip.copy();
        rig.run(50);
        assert_eq!(rig.grip.task() == TaskState::HoldActive, settles, "{force_n}");
    }
}

#[test]
fn grip_does_not_settle_on_an_invalid_force() {
    for (is_valid, expected) in [(false, TaskState::Force), (true, TaskState::HoldActive)] {
        let mut rig = in_task(TaskState::Idle);
        press(&mut rig, 100.0);
        rig.run(3);
        rig.grip.task = TaskState::Force;
        (rig.grip.setpoint_n, rig.grip.target.setpoint_n) = (100.0, 100.0);
        (rig.grip.task_ms, rig.grip.in_band_ms) = (0, 49);
        rig.grip.copy();
        if !is_valid {
            rig.estimates = Some([Estimate::MISSING; 4]);
        }
        rig.tick();
        assert_eq!(rig.grip.task(), expected);
    }
}

#[test]
fn stop_of_moving_fingers_ends_after_200_ms() {
    let mut rig = in_task(TaskState::Stopping);
    rig.grip.task_ms = 0;
    for task_ms in 1..=200 {
        rig.motor.closing_mm_s = 10.0;
        rig.tick();
        let expected = if task_ms < 200 { TaskState::Stopping } else { TaskState::Idle };
        assert_eq!(rig.grip.task(), expected, "{task_ms}");
    }
}

#[test]
fn homing_again_begins_from_the_start() {
    let mut rig = GripRig::enabled(true);
    let limit_a = |rig: &GripRig| match rig.setpoint() {
        Setpoint::Speed { closing_mm_s, max_a } => (closing_mm_s, max_a),
        other => panic!("{other:?}"),
    };
    rig.send(mode::HOME, |_| {});
    assert_eq!(limit_a(&rig), (5.0, 4.0));
    rig.run(100);
    assert_eq!(limit_a(&rig), (5.0, 1.5));
    rig.send(mode::STOP, |_| {});
    rig.run_until(TaskState::Idle);
    // The current that loosens the screw, once more.
    rig.send(mode::HOME, |_| {});
    assert_eq!(limit_a(&rig), (5.0, 4.0));
}

#[test]
fn obstacle_of_a_blind_opening_is_a_rise_of_the_current() {
    for (limit_a, is_blocked) in [(0.75, false), (0.5, true)] {
        let mut rig = in_task(TaskState::Releasing);
        rig.estimates = Some([Estimate::MISSING; 4]);
        rig.grip.move_target.opening_mm = 60.0;
        (rig.grip.opening_ms, rig.grip.limits.blind_rise_a) = (100, limit_a);
        rig.grip.copy();
        rest(&mut rig, Some(50.0), 0.0);
        // The mean of a constant current.
        rig.grip.opening_a = 0.75;
        rest(&mut rig, Some(50.0), -0.75);
        let expected = if is_blocked { TaskState::ContactStop } else { TaskState::Releasing };
        assert_eq!(rig.grip.task(), expected, "{limit_a}");
    }
}

#[test]
fn raised_force_returns_after_two_seconds_without_a_slip() {
    for (task, since_slip_ms, setpoint_n, expected) in [
        (TaskState::HoldActive, 1999, 24.0, TaskState::Force),
        (TaskState::HoldActive, 1998, 24.0, TaskState::HoldActive),
        (TaskState::HoldActive, 1999, 20.0, TaskState::HoldActive),
        (TaskState::HoldLatched, 1999, 24.0, TaskState::Force),
    ] {
        let mut rig = in_task(task);
        rig.grip.target.setpoint_n = 20.0;
        (rig.grip.setpoint_n, rig.grip.since_slip_ms) = (setpoint_n, since_slip_ms);
        rig.grip.copy();
        press(&mut rig, f64::from(setpoint_n));
        rig.tick();
        assert_eq!(rig.grip.task(), expected, "{since_slip_ms} {setpoint_n}");
        let after_n = if expected == TaskState::Force { 20.0 } else { setpoint_n };
        assert_eq!(rig.grip.setpoint_n, after_n);
    }
}

/// One millisecond of fingers that rest at an opening, with a current.
fn rest(rig: &mut GripRig, opening_mm: Option<f32>, current_a: f32) {
    (rig.motor.opening_mm, rig.true_mm) = (opening_mm, opening_mm.unwrap_or(50.0));
    (rig.motor.closing_mm_s, rig.motor.current) = (0.0, Dq { d: 0.0, q: current_a });
    rig.tick();
}

/// Lets the fingers rest against something that gives no force, with a current.
fn stalled(task: TaskState, current_a: f32, ticks: u32) -> GripRig {
    let mut rig = in_task(task);
    rig.grip.target.setpoint_n = 100.0;
    rig.grip.move_target.opening_mm = 20.0;
    rig.grip.copy();
    for _ in 0..ticks {
        rest(&mut rig, Some(50.0), current_a);
    }
    rig
}

#[test]
fn stall_of_a_motion_is_a_jam_with_its_current() {
    for task in [TaskState::Approach, TaskState::Moving] {
        let jammed = |rig: &GripRig| rig.grip.fault_bits() & bit(Fault::Jammed) != 0;
        assert!(!jammed(&stalled(task, 1.5, 39)));
        assert!(!jammed(&stalled(task, 1.2, 100)));
        let rig = stalled(task, -1.5, 40);
        assert!(jammed(&rig), "{task:?}");
        let event = rig.outputs.as_ref().unwrap().events.last().copied().unwrap();
        assert_eq!((event.code, event.detail), (Fault::Jammed as u16, 1500));
    }
}

#[test]
fn move_without_believed_forces_ends_at_nine_tenths_of_its_current() {
    // Of 0.6 A, and of 4 A where it leaves an end of the stroke.
    for (opening_mm, is_opening, current_a, ends) in [
        (50.0, false, 0.53, false),
        (50.0, false, 0.55, true),
        (50.0, true, -0.55, true),
        (0.5, true, -3.55, false),
        (0.5, true, -3.65, true),
    ] {
        let mut rig = in_task(TaskState::Moving);
        rig.grip.move_target =
            MoveTarget { opening_mm: 30.0, speed_mm_s: 20.0, is_uncalibrated: true };
        rig.grip.is_opening = is_opening;
        rig.grip.copy();
        // A force of such a move has no effect.
        press(&mut rig, 30.0);
        for _ in 0..39 {
            rest(&mut rig, Some(opening_mm), current_a);
        }
        assert_eq!(rig.grip.task(), TaskState::Moving, "{opening_mm} {current_a}");
        rest(&mut rig, Some(opening_mm), current_a);
        let expected = if ends { TaskState::ContactStop } else { TaskState::Moving };
        assert_eq!(rig.grip.task(), expected, "{opening_mm} {current_a}");
        // At the target it has arrived.
        rig.grip.task = TaskState::Moving;
        rig.grip.copy();
        rest(&mut rig, Some(30.05), 0.1);
        assert_eq!(rig.grip.task(), TaskState::Idle);
    }
}

#[test]
fn opening_move_ends_above_15_n_outward() {
    for (newtons, ends) in [(-15.0, false), (-15.25, true)] {
        let mut rig = GripRig::enabled(true);
        rig.send(mode::MOVE, |command| (command.position, command.speed) = (1400, 40));
        press(&mut rig, newtons);
        rig.tick();
        let expected = if ends { TaskState::ContactStop } else { TaskState::Moving };
        assert_eq!(rig.grip.task(), expected, "{newtons}");
    }
}

/// State after one millisecond of an approach without a new force.
fn approached(change: impl Fn(&mut GripRig)) -> TaskState {
    let mut rig = in_task(TaskState::Approach);
    rig.estimates = Some([Estimate::MISSING; 4]);
    rig.grip.target.setpoint_n = 100.0;
    change(&mut rig);
    rig.grip.copy();
    let opening_mm = rig.motor.opening_mm;
    rest(&mut rig, opening_mm, 0.3);
    rig.grip.task()
}

#[test]
fn approach_ends_by_contact_or_by_a_rise_of_the_force() {
    use TaskState::{Approach, Force, GripFailed};
    // Samples of a force above 5 N, whether the contact is older than the approach, and the rise of the force.
    for (samples, was_touching, rise_n, expected) in [
        (2, false, 0.0, Force),
        (1, false, 30.0, Approach),
        (0, false, 20.0, Approach),
        (0, false, 20.25, GripFailed),
        (2, true, 10.0, Approach),
        (2, true, 10.25, Force),
        (2, true, 30.0, Force),
    ] {
        let found = approached(|rig| {
            for _ in 0..samples {
                rig.grip.contact.update(6.0, &GripLimits::GRIPPER);
            }
            (rig.grip.was_touching, rig.grip.rise_n) = (was_touching, rise_n);
        });
        assert_eq!(found, expected, "{samples} {was_touching} {rise_n}");
    }
}

#[test]
fn approach_ends_beyond_its_window_or_after_a_minute() {
    use TaskState::{Approach, Force, GripFailed, NoObject};
    let window = Some(WidthWindow { min_mm: 31.0, max_mm: 39.0 });
    let narrow = Some(WidthWindow { min_mm: -1.0, max_mm: 1.0 });
    for (window, opening_mm, in_contact, task_ms, expected) in [
        (window, 39.0, true, 0, Force),
        (window, 39.1, true, 0, GripFailed),
        (None, 60.0, true, 0, Force),
        (window, 31.1, false, 0, Approach),
        (window, 31.0, false, 0, NoObject),
        // Below 0.2 mm the fingers touch.
        (None, 0.25, false, 0, Approach),
        (None, 0.2, false, 0, NoObject),
        (narrow, 0.25, false, 0, Approach),
        (narrow, 0.2, false, 0, NoObject),
        (None, 50.0, false, 59_998, Approach),
        (None, 50.0, false, 59_999, GripFailed),
    ] {
        let found = approached(|rig| {
            rig.grip.target.window = window;
            rig.grip.task_ms = task_ms;
            rig.motor.opening_mm = Some(opening_mm);
            for _ in 0..2 * u8::from(in_contact) {
                rig.grip.contact.update(6.0, &GripLimits::GRIPPER);
            }
        });
        assert_eq!(found, expected, "{window:?} {opening_mm} {in_contact} {task_ms}");
    }
    // 4 ms ahead at 50 mm/s: 0.2 mm.
    for (opening_mm, closing_mm_s, expected) in
        [(31.15, 50.0, NoObject), (31.25, 50.0, Approach), (30.9, -50.0, Approach)]
    {
        let mut rig = in_task(Approach);
        rig.grip.target.window = window;
        rig.grip.copy();
        (rig.motor.opening_mm, rig.motor.closing_mm_s) = (Some(opening_mm), closing_mm_s);
        rig.tick();
        assert_eq!(rig.grip.task(), expected, "{opening_mm} {closing_mm_s}");
    }
}

#[test]
fn opening_is_stalled_40_ms_after_loosening_the_screw_for_100_ms() {
    for (opening_mm, ended) in [(Some(50.0), TaskState::ContactStop), (None, TaskState::Unhomed)] {
        let mut rig = in_task(TaskState::Releasing);
        rig.grip.move_target.opening_mm = 60.0;
        rig.grip.copy();
        for _ in 0..138 {
            rest(&mut rig, opening_mm, -1.5);
        }
        assert_eq!(rig.grip.task(), TaskState::Releasing);
        // The milliseconds 100 to 139 count.
        rest(&mut rig, opening_mm, -1.5);
        assert_eq!(rig.grip.task(), ended, "{opening_mm:?}");
    }
}

#[test]
fn move_arrives_within_a_tenth_of_a_millimetre() {
    for (target_mm, arrives) in [(50.05, true), (49.95, true), (50.15, false), (49.85, false)] {
        let mut rig = in_task(TaskState::Moving);
        rig.run(10);
        rig.grip.task = TaskState::Moving;
        rig.grip.move_target.opening_mm = target_mm;
        rig.grip.move_target.speed_mm_s = 0.0;
        rig.grip.copy();
        rig.tick();
        assert_eq!(rig.grip.task() == TaskState::Idle, arrives, "{target_mm}");
    }
}

#[test]
fn closing_move_with_an_offset_ends_above_20_n() {
    for (newtons, ends) in [(20.0, false), (20.25, true)] {
        let mut rig = in_task(TaskState::Idle);
        press(&mut rig, newtons);
        rig.run(5);
        // The contact is older than the move: an offset of the sensors.
        rig.send(mode::MOVE, |command| (command.position, command.speed) = (200, 40));
        rig.run(3);
        assert_eq!(rig.grip.task() != TaskState::Moving, ends, "{newtons}");
    }
}

#[test]
fn status_message_has_counts_and_signs_of_its_signals() {
    let mut rig = in_task(TaskState::Idle);
    press(&mut rig, 12.5);
    rig.motor.closing_mm_s = -3.5;
    rig.motor.current = Dq { d: 0.0, q: -2.25 };
    rig.motor.opening_mm = Some(50.25);
    rig.tick();
    let outputs = rig.outputs.as_ref().unwrap();
    let status = outputs.status;
    // 0.01 mm, 0.01 mm/s opening positive, 0.1 N, 0.01 A.
    assert_eq!((status.position, status.speed), (5025, 350));
    assert_eq!((status.force, status.current), (125, -225));
    assert_eq!((outputs.state, outputs.foot.is_some()), (18, false));
    rig.motor.opening_mm = None;
    rig.tick();
    assert_eq!(rig.outputs.as_ref().unwrap().status.position, OPENING_UNKNOWN);
}

#[test]
fn ground_contact_is_reported_only_in_foot_mode() {
    for (power, task, is_reported) in [
        (PowerState::Enabled, TaskState::Foot, true),
        (PowerState::Enabled, TaskState::Idle, false),
        (PowerState::Armed, TaskState::Foot, false),
    ] {
        let mut rig = in_task(task);
        rig.grip.power = power;
        rig.grip.copy();
        rig.tick();
        assert_eq!(rig.outputs.as_ref().unwrap().foot.is_some(), is_reported, "{power:?} {task:?}");
    }
}

#[test]
fn object_field_tells_motion_contact_and_position_apart() {
    // With a contact of the fingers: while opening and while closing.
    for (power, task, with_contact, without) in [
        (PowerState::Enabled, TaskState::Moving, [0, 0], 0),
        (PowerState::Enabled, TaskState::Stopping, [0, 0], 0),
        (PowerState::Enabled, TaskState::Idle, [1, 2], 3),
        (PowerState::Enabled, TaskState::ContactStop, [1, 2], 3),
        (PowerState::Enabled, TaskState::HoldActive, [2, 2], 3),
        (PowerState::Armed, TaskState::Moving, [2, 2], 3),
        (PowerState::Armed, TaskState::Stopping, [2, 2], 3),
    ] {
        let object = |is_opening, newtons| {
            let mut grip = used();
            for _ in 0..2 {
                grip.contact.update(newtons, &GripLimits::GRIPPER);
            }
            (grip.power, grip.task, grip.is_opening) = (power, task, is_opening);
            reported(grip)
        };
        assert_eq!([object(true, 6.0), object(false, 6.0)], with_contact, "{power:?} {task:?}");
        assert_eq!([object(true, 0.0), object(false, 0.0)], [without; 2], "{power:?} {task:?}");
    }
}

/// Field `object` of the status message of a controller as it is.
fn reported(mut grip: GripController) -> u8 {
    let mut rig = GripRig::new(true);
    rig.tick();
    let mut outputs = rig.outputs.take().unwrap();
    grip.report(
        &ControlInputs {
            estimates: &[Estimate::MISSING; 4],
            motor: rig.motor,
            host: rig.host,
            command: None,
            stop: false,
            clear: false,
            faults: 0,
            is_sound: Some(true),
            is_calibrating: false,
            acceleration: None,
        },
        &mut outputs,
    );
    outputs.status.object
}

#[test]
fn detail_of_a_grip_force_is_in_1024ths() {
    let mut rig = in_task(TaskState::Idle);
    press(&mut rig, 500.0);
    rig.tick();
    let events = &rig.outputs.as_ref().unwrap().events;
    let over = events.iter().find(|event| event.code == Fault::OverForce as u16).unwrap();
    assert_eq!(over.detail, (500.0 * Force::PER_NEWTON) as u32);
    assert!(matches!(rig.setpoint(), Setpoint::Speed { .. }));
}

//! State of a grasp: requested and raised force, object, contact stiffness, regrips; and its events.

use crate::config::limits::GripLimits;
use crate::fixed_point::Force;
use crate::grip::commands::GraspTarget;
use crate::grip::debounce::next_ms;
use crate::grip::force_controller::StiffnessEstimator;
use crate::grip::slip_detector::{ObjectState, SlipDetector};
use crate::grip::states::TaskState;
use crate::grip::step::GripStep;
use crate::grip::transitions::TaskEvent;
use crate::math::greater;

/// A self-locking screw holds alone at the latest after this multiple of [`GripLimits::lock_ms`], whatever the force error.
const LATEST: u32 = 5;
/// The holding current decreases, and a self-locking screw may hold alone, while the mean force error is below this
/// multiple of the deadband.
const RELAX_BAND: f32 = 1.5;

/// State of a grasp.
#[derive(Clone, Debug, Default)]
pub(super) struct Grasp {
    pub(super) target: GraspTarget,
    /// Force set-point in newtons; raised after a slip.
    pub(super) setpoint_n: f32,
    pub(super) stiffness: StiffnessEstimator,
    /// Last opening in millimetres.
    last_mm: Option<f32>,
    slip: SlipDetector,
    slipping_ms: u16,
    since_slip_ms: u32,
    in_band_ms: u16,
    low_force_ms: u16,
    /// Times of the last regrips, newest first.
    regrips_ms: [Option<u32>; 3],
    /// An object is, or may be, between the fingers.
    pub(super) is_gripped: bool,
    /// The force was reached and the object not released since.
    pub(super) has_settled: bool,
}

impl Grasp {
    /// Adds a force and the opening to the estimate of the stiffness while the force grows.
    pub(super) fn observe(&mut self, step: GripStep, task: TaskState) {
        let is_loading = matches!(task, TaskState::Approach | TaskState::Force);
        // The force lags the opening by one step.
        if let Some(opening_mm) = self.last_mm
            && is_loading
            && step.contact.is_valid()
            && step.contact.detector().is_suspected()
        {
            self.stiffness.update(-opening_mm, step.contact.force_n());
        }
        self.last_mm = step.inputs.motor.opening_mm;
    }

    pub(super) const fn request(&mut self, target: GraspTarget) {
        self.setpoint_n = target.setpoint_n;
        self.target = target;
    }

    /// Adds a millisecond; whether the object has slipped lately, and the set-point in 1/1024 N for the detail of a fault.
    pub(super) fn slipping(&mut self) -> (bool, u32) {
        self.slipping_ms = self.slipping_ms.saturating_sub(1);
        self.since_slip_ms = self.since_slip_ms.saturating_add(1);
        (self.slipping_ms > 0, (self.setpoint_n * Force::PER_NEWTON as f32) as u32)
    }

    /// Carries out an event that leads to another state.
    pub(super) fn apply(&mut self, event: TaskEvent, step: GripStep) {
        let limits = &step.settings.limits;
        match event {
            TaskEvent::Slipped => {
                let raised_n = self.setpoint_n * limits.slip_factor;
                let cap_n = limits.slip_cap * self.target.setpoint_n;
                // Never below the present one: without a host it is not raised.
                let is_alive = step.inputs.host.is_alive;
                let cap_n = if is_alive { cap_n.min(self.target.cap_n) } else { 0.0 };
                self.setpoint_n = greater(raised_n.min(cap_n), self.setpoint_n);
                self.slipping_ms = limits.slip_pause_ms;
                self.since_slip_ms = 0;
            }
            TaskEvent::SlipEnded => self.setpoint_n = self.target.setpoint_n,
            TaskEvent::ForceDropped => {
                let [newest, second, _] = self.regrips_ms;
                self.regrips_ms = [Some(step.now_ms), newest, second];
            }
            _ => {}
        }
    }

    /// Enters a state of the task layer.
    pub(super) fn enter(&mut self, to: TaskState) {
        (self.in_band_ms, self.low_force_ms) = (0, 0);
        match to {
            TaskState::Approach => {
                self.stiffness = StiffnessEstimator::default();
                self.slip = SlipDetector::default();
                (self.is_gripped, self.has_settled) = (false, false);
            }
            TaskState::Force | TaskState::GripFailed => self.is_gripped = true,
            TaskState::HoldActive => self.has_settled = true,
            TaskState::Idle | TaskState::Lost | TaskState::NoObject => {
                (self.is_gripped, self.has_settled) = (false, false);
            }
            TaskState::Releasing => self.has_settled = false,
            _ => {}
        }
    }

    /// Event of a gripped object.
    pub(super) fn event(
        &mut self,
        step: GripStep,
        (task, task_ms): (TaskState, u32),
    ) -> Option<TaskEvent> {
        let GripStep { inputs, contact, settings, .. } = step;
        if contact.is_blind(settings) {
            return Some(TaskEvent::ForceLost);
        }
        if !contact.is_valid() {
            return None;
        }
        // Before the force has settled, closing is expected and no sign of a lost object.
        let closing_mm_s = if self.has_settled { inputs.motor.closing_mm_s } else { 0.0 };
        let object = match task == TaskState::Force && !self.has_settled {
            true if contact.detector().is_confirmed() => ObjectState::Held,
            true => ObjectState::Lost,
            false => {
                let setpoint = (self.setpoint_n, closing_mm_s);
                self.slip.update(contact.fingers(), setpoint, &settings.limits)
            }
        };
        match object {
            ObjectState::Lost => Some(TaskEvent::ObjectLost),
            ObjectState::Slipping => Some(TaskEvent::Slipped),
            ObjectState::Held => self.force_event(step, (task, task_ms)),
        }
    }

    fn force_event(
        &mut self,
        step: GripStep,
        (task, task_ms): (TaskState, u32),
    ) -> Option<TaskEvent> {
        let limits = &step.settings.limits;
        let error_n = self.setpoint_n - step.contact.force_n();
        let is_in_band = error_n.abs() < self.tolerance_n(limits);
        self.in_band_ms = next_ms(self.in_band_ms, is_in_band);
        let drop_n = limits.force_loss_n.max(limits.force_loss_ratio * self.setpoint_n);
        self.low_force_ms = next_ms(self.low_force_ms, error_n > drop_n);
        match task {
            TaskState::Force if self.in_band_ms >= limits.settle_ms => Some(TaskEvent::Settled),
            TaskState::Force if task_ms >= limits.grip_ms => Some(TaskEvent::Failed),
            TaskState::HoldActive | TaskState::HoldLatched
                if self.setpoint_n > self.target.setpoint_n
                    && self.since_slip_ms >= limits.slip_return_ms =>
            {
                Some(TaskEvent::SlipEnded)
            }
            TaskState::HoldActive if self.may_release_current(step, task_ms) => {
                Some(TaskEvent::ReleaseCurrent)
            }
            TaskState::HoldLatched if self.low_force_ms >= limits.force_loss_ms => {
                Some(TaskEvent::ForceDropped)
            }
            _ => None,
        }
    }

    /// Whether the screw may hold alone: it is self-locking, and the force has not dropped too often lately.
    fn may_release_current(&self, step: GripStep, task_ms: u32) -> bool {
        let limits = &step.settings.limits;
        let all = self.regrips_ms.iter().flatten();
        let recent = all.filter(|at_ms| step.now_ms.wrapping_sub(**at_ms) < limits.regrip_ms);
        let is_spent = recent.count() >= usize::from(limits.regrips);
        let is_near = self.may_relax(self.setpoint_n - step.contact.mean_n(), limits);
        let is_late = task_ms >= LATEST * limits.lock_ms;
        let is_due = task_ms >= limits.lock_ms && (is_near || is_late);
        step.settings.self_locking && !is_spent && is_due && self.in_band_ms > 0
    }

    /// Whether a mean force error in newtons is so small that less current may hold the object.
    pub(super) fn may_relax(&self, error_n: f32, limits: &GripLimits) -> bool {
        error_n.abs() < RELAX_BAND * self.deadband_n(limits)
    }

    /// Force error in newtons that is not corrected.
    pub(super) fn deadband_n(&self, limits: &GripLimits) -> f32 {
        limits.deadband_n.max(limits.deadband_ratio * self.setpoint_n)
    }

    /// Force error in newtons up to which the force has settled.
    pub(super) fn tolerance_n(&self, limits: &GripLimits) -> f32 {
        limits.tolerance_n.max(limits.tolerance_ratio * self.setpoint_n)
    }
}

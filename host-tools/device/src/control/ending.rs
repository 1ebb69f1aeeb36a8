//! End of a session. It undoes only what the session has begun: an object that another host gripped stays gripped, ground contact
//! that another host began stays, and after a refusal the drive stays as it was.

use std::sync::atomic::Ordering::Relaxed;

use anyhow::Result;
use firmware::config::constants;
use firmware::config::limits::GripLimits;
use firmware::grip::commands::mode;
use firmware::grip::states::{PowerState, TASK_CODE, TaskState};

use super::log::Measured;
use super::result_code::ResultCode;
use super::session::{BEATS, RELEASE_S, Session, WaitResult, is_gripping};
use super::{DEFAULT_SPEED_MM_S, MARGIN_MM, mode_command, motion};

/// Timeouts in real seconds, with a margin for slow emulations.
const DISABLE_S: f64 = 10.0;
const CLOSE_S: f64 = 2.0;
/// Opening of a release in mm, and the largest opening.
const RELEASE_MM: f64 = 10.0;
const MAX_MM: f64 = constants::STROKE.value - MARGIN_MM;

impl Session {
    /// Ends what the session has begun, and the session.
    pub(super) fn shut_down(&mut self) -> Result<()> {
        // A further Ctrl-C is an emergency stop.
        let was_interrupted = self.interrupted.swap(false, Relaxed);
        self.is_shutting_down = true;
        // A command that was refused has begun nothing.
        let is_refused = self.client.refused.take().is_some();
        let has_acted = self.has_enabled || self.has_commanded && !is_refused;
        let result = if has_acted { self.undo() } else { Ok(()) };
        self.is_left_gripped = !self.owns_grip && self.task().is_some_and(is_gripping);
        let result = result.and(self.end_session());
        self.interrupted.fetch_or(was_interrupted, Relaxed);
        result
    }

    /// With an open session the gripper would refuse every service of the next program.
    fn end_session(&mut self) -> Result<()> {
        if !self.client.is_armed() {
            return Ok(());
        }
        self.client.end_session()?;
        // Reported by the next heartbeat; a latched fault remains the state.
        let is_closed = |session: &Self| {
            let beat = session.client.state.heartbeat;
            beat.is_some_and(|beat| {
                let state = beat.value.state;
                let is_open = state >= PowerState::Armed as u8 && state < TASK_CODE;
                !beat.value.command_alive && !is_open
            })
        };
        self.wait(CLOSE_S, is_closed).map(|_| ())
    }

    /// Opens an own grasp, leaves own ground contact, stops an own motion, and disables the drive.
    fn undo(&mut self) -> Result<()> {
        let is_foreign = !self.owns_grip && self.task().is_some_and(is_gripping);
        if is_foreign || !self.client.is_armed() {
            return Ok(());
        }
        // The state of the last heartbeat may be that before the command.
        self.finish(DISABLE_S, |session| session.client.beats >= BEATS, "no heartbeat")?;
        let end_s = self.client.elapsed_s() + RELEASE_S;
        while let Some(task) = self.task() {
            let (mode, failed) = match task {
                task if is_gripping(task) && self.owns_grip => (mode::RELEASE, "release timed out"),
                task if is_gripping(task) => return Ok(()),
                TaskState::Foot if !self.owns_foot => return Ok(()),
                TaskState::Foot => (mode::LEAVE, "leaving the ground contact timed out"),
                task if is_in_motion(task) => (mode::STOP, "stopping timed out"),
                // A soft object may still be pressed.
                _ if self.owns_grip && self.presses() => (mode::RELEASE, "release timed out"),
                _ => (mode::DISABLE, "disabling the drive timed out"),
            };
            let command = match mode {
                mode::RELEASE => {
                    let opening_mm = self.opening_mm().unwrap_or(0.0) + RELEASE_MM;
                    let opening_mm = opening_mm.min(MAX_MM);
                    motion(mode, opening_mm, DEFAULT_SPEED_MM_S)
                }
                mode => mode_command(mode),
            };
            self.client.command(command);
            let limit_s = if mode == mode::DISABLE { DISABLE_S } else { RELEASE_S };
            let is_done = |session: &Self| match (mode, session.task()) {
                (_, None) => true,
                (mode::DISABLE, _) => false,
                (mode::RELEASE, Some(task)) => {
                    matches!(task, TaskState::Idle | TaskState::Unhomed)
                }
                (mode::LEAVE, Some(task)) => task != TaskState::Foot,
                (_, Some(task)) => !is_in_motion(task),
            };
            // As above, the state before a command is not its result.
            let is_done = |session: &Self| session.client.beats >= BEATS && is_done(session);
            self.finish(limit_s, is_done, failed)?;
            if self.client.elapsed_s() >= end_s {
                return self.finish(0.0, |_| false, failed);
            }
        }
        Ok(())
    }

    /// Whether the fingers press on something and can open further.
    fn presses(&self) -> bool {
        let Measured { force_n, opening_mm, .. } = Measured::of(&self.client);
        let contact_n = f64::from(GripLimits::GRIPPER.contact_n);
        force_n.is_some_and(|n| n > contact_n) && opening_mm.is_some_and(|mm| mm < MAX_MM - 1.0)
    }

    /// Waits for a step of the end; a timeout or Ctrl-C is an emergency stop.
    fn finish(
        &mut self,
        limit_s: f64,
        is_done: impl FnMut(&Self) -> bool,
        failed: &str,
    ) -> Result<()> {
        let text = match self.wait(limit_s, is_done)? {
            WaitResult::Done => return Ok(()),
            WaitResult::Interrupted => {
                "emergency stop: inspect the gripper before arming it again".to_owned()
            }
            WaitResult::TimedOut => format!("{failed}: emergency stop"),
        };
        self.client.stop()?;
        Err(ResultCode::Fault.error(text))
    }
}

/// Whether the fingers move or are being stopped.
const fn is_in_motion(task: TaskState) -> bool {
    task.moves() || matches!(task, TaskState::Stopping | TaskState::ContactStop)
}

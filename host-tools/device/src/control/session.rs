//! Steps of a session: connect, clear faults, arm, enable, home, command, hold.

use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Error, Result};
use firmware::grip::commands::{flag, mode};
use firmware::grip::states::{PowerState, TASK_CODE, TaskState};
use firmware::protocol::messages::Command;
use firmware::protocol::opening_mm;
use firmware::protocol::session::{op, status};
use firmware::system::faults::Fault;

use super::log::{CommandLog, Measured};
use super::outcome::Outcome;
use super::result_code::ResultCode;
use super::{Request, SessionOptions, mode_command};
use crate::format;
use crate::session::{self, Client, Credentials, check_protocol};
use crate::source::{ConnectionLost, Source};

/// Position tolerance in mm.
const TOLERANCE_MM: f64 = 0.5;
/// Timeout of a stop in seconds.
const STOP_S: f64 = 1.0;
/// Timeouts of the steps in real seconds, with a margin for slow emulations.
const CONNECT_S: f64 = 10.0;
const ARM_S: f64 = 10.0;
const ENABLE_S: f64 = 10.0;
const HOME_S: f64 = 180.0;
pub(super) const RELEASE_S: f64 = 60.0;
/// Timeout for reaching the set-point.
const REACH_S: f64 = 120.0;
/// Period of arming requests.
const ARM_RETRY_S: f64 = 1.0;
/// Heartbeats after a command of which the last was sent after the gripper had received it.
pub(super) const BEATS: u32 = 2;
/// Heartbeats after which a motion has been seen if there was one.
const MOTION_BEATS: u32 = 5;

/// A session with a gripper, and what it has begun: nothing else is undone at its end.
pub struct Session {
    /// Connection and latest state.
    pub client: Client,
    /// What is printed and reported.
    pub log: CommandLog,
    options: SessionOptions,
    pub(super) interrupted: Arc<AtomicBool>,
    /// The motion ends: that the gripper was stopped is no error any more.
    pub(super) is_shutting_down: bool,
    /// The drive was enabled by this session.
    pub(super) has_enabled: bool,
    /// The drive has been enabled in this session, by whoever it was.
    was_enabled: bool,
    /// A command of this session that moves the fingers was sent.
    pub(super) has_commanded: bool,
    /// What is gripped, and the ground contact, are of this session.
    pub(super) owns_grip: bool,
    pub(super) owns_foot: bool,
    /// An object of another host is left as it is.
    pub(super) is_left_gripped: bool,
    is_reached: bool,
    /// For who waits in another thread.
    view: Arc<Mutex<View>>,
    has_moved: bool,
    has_touched: bool,
    has_slipped: bool,
}

/// What a session sees, for other threads.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct View {
    /// State, force and opening.
    #[serde(flatten)]
    pub measured: Measured,
    /// Active faults.
    pub faults: Vec<String>,
    /// The set-point was reached.
    #[serde(skip)]
    pub is_reached: bool,
}

/// Result of waiting for a condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WaitResult {
    /// The condition is true.
    Done,
    /// Timeout.
    TimedOut,
    /// Ctrl-C.
    Interrupted,
}

impl Session {
    /// A session on this connection, not begun yet; `interrupted` ends it.
    pub fn new(
        source: Box<dyn Source + Send>,
        credentials: Credentials,
        options: SessionOptions,
        interrupted: Arc<AtomicBool>,
    ) -> Self {
        Self {
            client: Client::new(source, credentials),
            log: CommandLog::default(),
            options,
            interrupted,
            is_shutting_down: false,
            has_enabled: false,
            was_enabled: false,
            has_commanded: false,
            owns_grip: false,
            owns_foot: false,
            is_left_gripped: false,
            is_reached: false,
            view: Arc::default(),
            has_moved: false,
            has_touched: false,
            has_slipped: false,
        }
    }

    /// What the session sees, from now on.
    pub fn view(&self) -> Arc<Mutex<View>> {
        self.view.clone()
    }

    /// State, force, opening and faults of the gripper, to which nothing is sent.
    ///
    /// # Errors
    /// The connection is lost.
    pub fn observe(mut self) -> Result<View> {
        self.connect()?;
        self.wait(CONNECT_S, |session| session.client.state.grip.is_some())?;
        Ok(self.present())
    }

    fn present(&self) -> View {
        View {
            measured: Measured::of(&self.client),
            faults: self.client.state.faults.iter().map(format::fault_line).collect(),
            is_reached: self.is_reached,
        }
    }

    /// The whole session.
    pub fn run(mut self, request: Request) -> Outcome {
        let result = self.perform(request);
        let measured = Measured::of(&self.client);
        let shut_down = self.shut_down();
        let is_disabled = shut_down.is_ok() && self.code().is_some_and(|code| code < TASK_CODE);
        let (code, error) = match (result, shut_down) {
            (Ok(ResultCode::Reached), Ok(())) => (ResultCode::Reached, None),
            (Ok(code), Ok(())) => (code, Some(code.error(code.meaning()))),
            // A lost connection is one error.
            (Err(error), Err(then)) if !then.is::<ConnectionLost>() => {
                (ResultCode::of(&error), Some(error.context(format!("{then:#}"))))
            }
            (Err(error), _) | (Ok(_), Err(error)) => (ResultCode::of(&error), Some(error)),
        };
        // Who reads the lines may go on.
        self.log.end_lines();
        Outcome {
            code,
            error,
            measured,
            is_reached: self.is_reached,
            is_disabled,
            is_left_gripped: self.is_left_gripped,
            gripper: self.client.name(),
            log: self.log,
        }
    }

    /// Stops the gripper, which needs no session; its state.
    ///
    /// # Errors
    /// The connection is lost, or the gripper still moves.
    pub fn stop(mut self) -> Result<String> {
        self.is_shutting_down = true;
        self.connect()?;
        self.client.stop()?;
        let is_stopped = |session: &Self| !session.task().is_some_and(TaskState::moves);
        if self.wait(STOP_S, is_stopped)? != WaitResult::Done {
            return Err(ResultCode::Fault.error("the gripper still moves: switch its supply off"));
        }
        Ok(self.code().map_or_else(String::new, format::state_name))
    }

    /// Arms, enables, homes, commands and holds.
    fn perform(&mut self, request: Request) -> Result<ResultCode> {
        let all = [
            Self::connect,
            Self::clear_faults,
            Self::arm,
            Self::enable,
            Self::leave_end_state,
            Self::home,
        ];
        let to_release = [Self::connect, Self::arm];
        let steps = match request {
            Request::Release { .. } if !self.options.clear_faults => &to_release[..],
            Request::Release { .. } => &all[..3],
            _ => &all[..],
        };
        for step in steps {
            if step(self)? == WaitResult::Interrupted {
                return Ok(ResultCode::Interrupted);
            }
        }
        if let Request::Release { opening_mm } = request {
            return self.release(opening_mm, request);
        }
        let task = self.task();
        self.owns_grip = matches!(request, Request::Force { .. }) && !task.is_some_and(is_gripping);
        self.owns_foot = matches!(request, Request::Foot(_)) && task != Some(TaskState::Foot);
        self.command(request);
        let waited = self.wait_for(REACH_S, |session| session.is_reached_now(request))?;
        match waited {
            WaitResult::Done => self.is_reached = true,
            WaitResult::Interrupted => return Ok(ResultCode::Interrupted),
            WaitResult::TimedOut => {
                return Err(ResultCode::Timeout
                    .error(format!("set-point not reached within {REACH_S} s{}", self.faults())));
            }
        }
        let hold_s = match (self.options.hold_s, request) {
            (Some(seconds), _) => seconds,
            (None, _) if self.options.keep => 0.0,
            (None, Request::Position { .. }) => 0.0,
            (None, _) => f64::INFINITY,
        };
        let waited = self.wait_for(hold_s, |session| {
            session.is_reached_now(request)?;
            Ok(false)
        })?;
        // As a grip of an earlier host, it stays.
        self.owns_grip &= !self.options.keep;
        Ok(match waited {
            WaitResult::Interrupted if hold_s.is_finite() => ResultCode::Interrupted,
            _ if self.has_slipped => ResultCode::Slipped,
            _ => ResultCode::Reached,
        })
    }

    /// Sends the command of the request, and repeats it.
    fn command(&mut self, request: Request) {
        self.client.command(request.command());
        self.has_commanded = true;
    }

    /// Whether the set-point is reached.
    ///
    /// # Errors
    /// It will not be reached any more, or the object is gone.
    fn is_reached_now(&mut self, request: Request) -> Result<bool> {
        // An earlier state is that of an earlier command.
        let Some(task) = self.task().filter(|_| self.client.beats >= BEATS) else {
            return Ok(false);
        };
        self.has_moved |= task.moves();
        self.has_touched |= task.holds();
        self.has_slipped |=
            self.client.state.faults.keys().any(|(code, _)| *code == Fault::Slipping as u16);
        let has_ended = self.has_moved || self.client.beats >= MOTION_BEATS;
        match (request, task) {
            (_, TaskState::TimeoutHold) => Err(ResultCode::Timeout.error(
                "command timeout (100 ms): the connection is too slow, or this machine is busy",
            )),
            (Request::Position { opening_mm, .. }, TaskState::Idle) => {
                let is_near = |mm: f64| (mm - opening_mm).abs() < TOLERANCE_MM;
                match self.opening_mm().is_some_and(is_near) {
                    true => Ok(true),
                    false if has_ended => Err(self.contact(request)),
                    false => Ok(false),
                }
            }
            (Request::Position { .. }, TaskState::ContactStop) => Err(self.contact(request)),
            (Request::Force { .. }, TaskState::HoldActive | TaskState::HoldLatched) => Ok(true),
            (Request::Force { .. }, TaskState::NoObject) => {
                Err(ResultCode::NoObject.error(format!("no object: {}", self.measured())))
            }
            (Request::Force { .. }, TaskState::Lost) => {
                Err(ResultCode::ObjectLost.error("the object was lost"))
            }
            (Request::Force { set_n, command }, TaskState::GripFailed) => {
                Err(self.grip_failure(set_n, command))
            }
            (Request::Foot(_), TaskState::Foot) => Ok(true),
            _ => Ok(false),
        }
    }

    /// Present force and opening in words.
    fn measured(&self) -> String {
        let Measured { force_n, opening_mm, .. } = Measured::of(&self.client);
        let text = |value: Option<f64>, unit| {
            value.map_or_else(|| format!("an unknown {unit}"), |value| format!("{value:.1} {unit}"))
        };
        format!("{} at {}", text(force_n, "N"), text(opening_mm, "mm"))
    }

    /// Error of a motion that ended before its target.
    fn contact(&self, request: Request) -> Error {
        let during = match self.client.state.grip.map(|status| status.value.object) {
            Some(1) => " while opening",
            Some(2) => " while closing",
            _ => "",
        };
        let remedy = match request {
            Request::Position { is_uncalibrated: false, .. } => {
                "; to grip it, use --force; if nothing is there, the tables are those of another gripper: \
                 --uncalibrated"
            }
            _ => "",
        };
        ResultCode::Contact.error(format!("contact{during}: {}{remedy}", self.measured()))
    }

    /// Error of a grip that failed.
    fn grip_failure(&self, set_n: f64, command: Command) -> Error {
        let measured = self.measured();
        if self.has_touched {
            ResultCode::TooSoft.error(format!(
                "the object is too soft: {measured} instead of {set_n:.0} N in time"
            ))
        } else if command.flags & flag::WINDOW != 0 {
            ResultCode::WrongWidth.error(format!("the object is wider than --width: {measured}"))
        } else {
            ResultCode::Timeout.error(format!(
                "no contact in time, or the forces have an offset ({measured}): unload the fingers and use `cargo magpie \
                 tare`"
            ))
        }
    }

    /// Opens the fingers, which faults do not prevent.
    fn release(&mut self, opening_mm: f64, request: Request) -> Result<ResultCode> {
        if let Some(present_mm) = self.opening_mm().filter(|present_mm| *present_mm >= opening_mm) {
            return Err(ResultCode::Refused.error(format!(
                "the fingers are open by {present_mm:.2} mm already: give a larger opening than {opening_mm}"
            )));
        }
        self.is_shutting_down = true;
        self.command(request);
        let opens = |session: &Self| session.task() == Some(TaskState::Releasing);
        if self.wait(ENABLE_S, opens)? == WaitResult::TimedOut {
            let reason = self.refusal();
            return Err(ResultCode::Timeout
                .error(format!("the gripper does not open{reason}{}", self.faults())));
        }
        match self.wait(RELEASE_S, |session| !opens(session))? {
            WaitResult::Done
                if self.opening_mm().is_none_or(|mm| mm > opening_mm - TOLERANCE_MM) =>
            {
                self.is_reached = true;
                Ok(ResultCode::Reached)
            }
            WaitResult::Done => Err(self.contact(request)),
            WaitResult::Interrupted => Ok(ResultCode::Interrupted),
            WaitResult::TimedOut => {
                Err(ResultCode::Timeout.error(format!("the opening does not end{}", self.faults())))
            }
        }
    }

    /// Waits for the first heartbeat and the end of the self-test.
    fn connect(&mut self) -> Result<WaitResult> {
        let is_ready = |session: &Self| {
            let is_fault = session.code() == Some(PowerState::Fault as u8);
            session.code().is_some_and(|code| code > PowerState::SelfTest as u8)
                && (!is_fault || session.client.is_certain())
        };
        let waited = self.wait(CONNECT_S, is_ready)?;
        if waited == WaitResult::TimedOut {
            let name = self.client.name();
            return Err(match self.code() {
                Some(code) => ResultCode::Refused.error(format!(
                    "{name}: the gripper remains in state {}",
                    format::state_name(code)
                )),
                None => ConnectionLost::unreachable(&name).into(),
            });
        }
        Ok(waited)
    }

    fn clear_faults(&mut self) -> Result<WaitResult> {
        let has_fault = |session: &Self| session.code() == Some(PowerState::Fault as u8);
        if self.options.clear_faults {
            self.client.request(op::CLEAR_FAULTS)?;
            let waited = self.wait(ARM_S, |session| session.client.is_answered())?;
            match waited {
                WaitResult::Done => {}
                WaitResult::Interrupted => return Ok(waited),
                WaitResult::TimedOut => {
                    return Err(ResultCode::Refused.error(format!(
                        "the gripper does not clear its faults: {}",
                        self.no_session()
                    )));
                }
            }
            if self.wait(ARM_S, |session| !session.client.state.is_stopped())?
                == WaitResult::TimedOut
            {
                return Err(
                    ResultCode::Refused.error("the stop stays latched: the fingers do not rest")
                );
            }
        }
        if !has_fault(self) {
            return Ok(WaitResult::Done);
        }
        if !self.options.clear_faults {
            return Err(ResultCode::Refused.error(format!(
                "the gripper has a fault{}: remove its cause and give --clear-faults",
                self.faults()
            )));
        }
        let waited = self.wait(ARM_S, |session| !has_fault(session))?;
        if waited == WaitResult::TimedOut {
            return Err(ResultCode::Fault
                .error(format!("the fault persists{}: remove its cause first", self.faults())));
        }
        Ok(waited)
    }

    fn arm(&mut self) -> Result<WaitResult> {
        if self.client.state.is_stopped() {
            return Err(ResultCode::Refused.error(
                "a stop is latched: make sure that the gripper may move again, and add --clear-faults",
            ));
        }
        let end_s = self.client.elapsed_s() + ARM_S;
        while self.client.elapsed_s() < end_s {
            self.client.arm()?;
            let waited = self.wait(ARM_RETRY_S, |session| session.client.is_armed())?;
            if waited != WaitResult::TimedOut {
                return Ok(waited);
            }
            // It does not become right by repetition.
            if self.client.not_armed == Some(status::REFUSED) {
                break;
            }
        }
        Err(ResultCode::Refused.error(format!(
            "the gripper does not arm: {}{}",
            self.no_session(),
            self.faults()
        )))
    }

    /// Why no session was opened.
    fn no_session(&self) -> &'static str {
        self.client.not_armed.map_or(
            "it does not answer: does the firmware drive a motor?",
            session::session_refusal,
        )
    }

    fn enable(&mut self) -> Result<WaitResult> {
        let is_enabled = |session: &Self| session.code().is_some_and(|code| code >= TASK_CODE);
        let was_enabled = is_enabled(self);
        self.has_enabled = !was_enabled;
        // Where the drive is enabled already, it is a sign of life.
        self.client.command(mode_command(mode::ENABLE));
        let waited = self.wait(ENABLE_S, is_enabled);
        self.has_enabled &= self.client.refused.is_none();
        let waited = waited?;
        if waited == WaitResult::TimedOut {
            return Err(ResultCode::Refused.error(format!(
                "the drive was not enabled{}{}",
                self.refusal(),
                self.faults()
            )));
        }
        self.was_enabled = waited == WaitResult::Done;
        Ok(waited)
    }

    /// Leaves the state in which the command of an earlier host ended, which is none of this session's command. Nothing
    /// moves.
    fn leave_end_state(&mut self) -> Result<WaitResult> {
        let is_end = |session: &Self| {
            let ends = [TaskState::TimeoutHold, TaskState::NoObject, TaskState::Lost];
            session.task().is_some_and(|task| ends.contains(&task))
        };
        if !is_end(self) {
            return Ok(WaitResult::Done);
        }
        if self.task() == Some(TaskState::TimeoutHold) {
            self.log.note("note: an earlier host stopped sending commands while the fingers moved, which stopped them");
        }
        self.client.command(mode_command(mode::STOP));
        self.wait(ENABLE_S, |session| !is_end(session))
    }

    fn home(&mut self) -> Result<WaitResult> {
        if self.task() != Some(TaskState::Unhomed) {
            return Ok(WaitResult::Done);
        }
        if !self.options.home {
            return Err(ResultCode::Refused.error(
                "the gripper is not homed: give --home (requires free fingers; they close to the end stop, then open \
                 fully)",
            ));
        }
        self.client.command(mode_command(mode::HOME));
        self.has_commanded = true;
        let mut has_started = false;
        let waited = self.wait(HOME_S, |session| {
            has_started |= session.task() == Some(TaskState::Homing);
            session.task() == Some(TaskState::Idle)
                || has_started && session.task() == Some(TaskState::Unhomed)
        });
        match (waited, self.task()) {
            (Ok(waited @ WaitResult::Interrupted), _) => Ok(waited),
            (Ok(waited @ WaitResult::Done), Some(TaskState::Idle)) => Ok(waited),
            (Err(error), _) if ResultCode::of(&error) != ResultCode::Fault => Err(error),
            _ => Err(ResultCode::Fault.error(format!(
                "homing failed{}{}",
                self.faults(),
                self.home_remedy()
            ))),
        }
    }

    /// Probable cause of a failed homing, and what to do.
    fn home_remedy(&self) -> &'static str {
        let is_stroke_wrong = |(code, _): &&(u16, Option<u8>)| *code == Fault::StrokeWrong as u16;
        match self.client.state.faults.keys().find(is_stroke_wrong) {
            Some(_) => {
                "\nHoming ends where the forces rise. Either something is between the fingers, or the tables on the gripper \
                 are those of another one (`cargo magpie board` names them): a gripper that was never calibrated needs \
                 `cargo magpie upload MODEL --nominal`, then --home --clear-faults"
            }
            None => "",
        }
    }

    /// As [`Self::wait`], for a condition that a state makes an error.
    fn wait_for(
        &mut self,
        limit_s: f64,
        mut is_done: impl FnMut(&mut Self) -> Result<bool>,
    ) -> Result<WaitResult> {
        let end_s = self.client.elapsed_s() + limit_s;
        loop {
            if self.interrupted.load(Relaxed) {
                return Ok(WaitResult::Interrupted);
            }
            match is_done(self) {
                Ok(true) => return Ok(WaitResult::Done),
                Ok(false) if self.client.elapsed_s() >= end_s => return Ok(WaitResult::TimedOut),
                Err(error) if self.client.is_certain() => return Err(error),
                // Perhaps by a stranger's heartbeat: the gripper's own next one says.
                Ok(false) | Err(_) => {}
            }
            self.client.poll()?;
            self.log.update(&self.client);
            *self.view.lock().unwrap_or_else(PoisonError::into_inner) = self.present();
            check_protocol(&self.client.state)?;
            self.check()?;
        }
    }

    /// Polls until a condition is true, a timeout or Ctrl-C. A fault or a refused command is an error.
    pub(super) fn wait(
        &mut self,
        limit_s: f64,
        mut is_done: impl FnMut(&Self) -> bool,
    ) -> Result<WaitResult> {
        self.wait_for(limit_s, |session| Ok(is_done(session)))
    }

    /// Fails after a fault reaction or a refused command.
    fn check(&mut self) -> Result<()> {
        let code = self.code().unwrap_or(0);
        let is_stopped = self.was_enabled && code < TASK_CODE
            || [PowerState::QuickStop, PowerState::FaultReaction, PowerState::Fault]
                .iter()
                .any(|power| *power as u8 == code);
        let is_stopped = is_stopped && self.client.is_certain();
        if is_stopped && self.client.is_armed() && !self.is_shutting_down {
            return Err(
                ResultCode::Fault.error(format!("the gripper was stopped{}", self.faults()))
            );
        }
        match self.client.refused {
            // The next heartbeat has the state that prevented it.
            Some(refusal) if refusal.is_not_enabled() && self.was_enabled => Ok(()),
            // The gripper has accepted the command that is repeated: if it is refused from now on, the heartbeats say why.
            Some(_) if self.is_reached && !self.is_shutting_down => {
                self.client.refused = None;
                Ok(())
            }
            Some(refusal) if !refusal.is_transient() => {
                let faults = if refusal.is_of_fault() { self.faults() } else { String::new() };
                Err(ResultCode::Refused.error(format!("{}{faults}", refusal.words())))
            }
            _ => Ok(()),
        }
    }

    /// State code of the last heartbeat.
    pub(super) fn code(&self) -> Option<u8> {
        self.client.state.heartbeat.map(|beat| beat.value.state)
    }

    pub(super) fn task(&self) -> Option<TaskState> {
        self.code().and_then(TaskState::of_code)
    }

    pub(super) fn opening_mm(&self) -> Option<f64> {
        opening_mm(&self.client.state.grip?.value)
    }

    /// The last refusal after a colon; empty without one.
    fn refusal(&self) -> String {
        self.client.refused.map_or(String::new(), |refusal| format!(": {}", refusal.words()))
    }

    /// Active faults after a colon; empty without faults.
    pub(super) fn faults(&self) -> String {
        let faults: Vec<_> = self.client.state.faults.iter().map(format::fault_line).collect();
        if faults.is_empty() { String::new() } else { format!(": {}", faults.join("; ")) }
    }
}

/// Whether an object may be gripped.
pub(super) const fn is_gripping(task: TaskState) -> bool {
    task.holds() || matches!(task, TaskState::GripFailed)
}

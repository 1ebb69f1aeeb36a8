//! Commands to a gripper on a serial line or CAN bus: arm, home, command, disable.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;

use anyhow::{Error, Result, bail};
use firmware::config::constants;
use firmware::grip::commands::{flag, mode};
use firmware::grip::states::{PowerState, TASK_CODE, TaskState};
use firmware::protocol::messages::Command;
use firmware::protocol::opening_mm;
use firmware::protocol::session::{op, status};
use serde_json::{Value, json};

use crate::commands::connection::{check_protocol, interrupted, print_unprotected};
use crate::commands::grasp::simulated::check_force;
use crate::commands::grasp::{Args, MARGIN_MM, check_opening};
use device::format;
use device::session::{self, Client};
use device::source::Source;
use report::text::terminal;
use sim::closed_loop::grasp_rig::grip_command;
use sim::closed_loop::landing::FootContact;

/// Timeouts of the steps in real seconds, with a margin for slow emulations.
const CONNECT_S: f64 = 10.0;
const ARM_S: f64 = 10.0;
const ENABLE_S: f64 = 10.0;
const HOME_S: f64 = 180.0;
const RELEASE_S: f64 = 60.0;
const DISABLE_S: f64 = 10.0;
const CLOSE_S: f64 = 2.0;
const STOP_S: f64 = 1.0;
/// Timeout for reaching the set-point.
const REACH_S: f64 = 120.0;
/// Period of arming requests.
const ARM_RETRY_S: f64 = 1.0;
/// Default speed of motions and speed of a release in mm/s.
const DEFAULT_SPEED_MM_S: f64 = 15.0;
/// Opening of a release in mm.
const RELEASE_MM: f64 = 10.0;
/// Position tolerance in mm.
const TOLERANCE_MM: f64 = 0.5;
/// Speed range of the command message.
const SPEED_RANGE_MM_S: std::ops::RangeInclusive<f64> = 0.25..=58.0;

/// The set-point of the command.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Request {
    Position { opening_mm: f64, speed_mm_s: f64, is_uncalibrated: bool },
    Force { set_n: f64 },
    Foot(FootContact),
    Release { opening_mm: f64 },
}

impl Request {
    fn of(args: &Args) -> Result<Self> {
        if let Some(opening_mm) = args.release {
            let opening_mm = opening_mm.unwrap_or(constants::STROKE.value - MARGIN_MM);
            check_opening("--release", opening_mm)?;
            return Ok(Self::Release { opening_mm });
        }
        if args.foot.flatten().is_some() {
            bail!("--foot takes no force with --port or --can");
        }
        if args.foot.is_some() {
            return Ok(Self::Foot(args.contact));
        }
        if let Some(set_n) = args.force {
            check_force(set_n)?;
            return Ok(Self::Force { set_n });
        }
        let Some(opening_mm) = args.position else {
            bail!("--speed without --position is possible in the simulation only");
        };
        check_opening("--position", opening_mm)?;
        let speed_mm_s = args.speed.unwrap_or(DEFAULT_SPEED_MM_S);
        if !SPEED_RANGE_MM_S.contains(&speed_mm_s) {
            let (min, max) = (SPEED_RANGE_MM_S.start(), SPEED_RANGE_MM_S.end());
            bail!("--speed {speed_mm_s:?} is not possible here; give {min} to {max} mm/s");
        }
        Ok(Self::Position { opening_mm, speed_mm_s, is_uncalibrated: args.uncalibrated })
    }

    fn command(&self) -> Command {
        match *self {
            Self::Position { opening_mm, speed_mm_s, is_uncalibrated } => Command {
                flags: if is_uncalibrated { flag::UNCALIBRATED } else { 0 },
                ..motion(mode::MOVE, opening_mm, speed_mm_s)
            },
            Self::Force { set_n } => grip_command(set_n),
            Self::Foot(contact) => contact.command(),
            Self::Release { opening_mm } => motion(mode::RELEASE, opening_mm, DEFAULT_SPEED_MM_S),
        }
    }

    /// True if the gripper has reached the set-point.
    fn is_reached(&self, task: TaskState, opening_mm: f64) -> bool {
        match self {
            Self::Position { opening_mm: target_mm, .. } => {
                task == TaskState::Idle && (opening_mm - target_mm).abs() < TOLERANCE_MM
            }
            Self::Force { .. } => matches!(task, TaskState::HoldActive | TaskState::HoldLatched),
            Self::Foot(_) => task == TaskState::Foot,
            // See [`Session::open`].
            Self::Release { .. } => false,
        }
    }

    /// Reason of a failure, if the state is one.
    const fn failure(&self, task: TaskState) -> Option<&'static str> {
        match (self, task) {
            (Self::Force { .. }, TaskState::NoObject) => Some("no object: the fingers met"),
            (Self::Force { .. }, TaskState::GripFailed) => Some("no stable grasp in time"),
            (Self::Force { .. }, TaskState::Lost) => Some("the object was lost"),
            (_, TaskState::ContactStop) => Some(
                "unexpected contact during the motion; without a calibration, effects look like contacts: --uncalibrated",
            ),
            (_, TaskState::TimeoutHold) => Some(
                "command timeout (100 ms): the connection is too slow, or this machine is busy",
            ),
            _ => None,
        }
    }
}

const fn mode_command(mode: u8) -> Command {
    Command { mode, position: 0, speed: 0, force: 0, flags: 0 }
}

fn motion(mode: u8, opening_mm: f64, speed_mm_s: f64) -> Command {
    Command {
        mode,
        position: counts("position", opening_mm) as u16,
        speed: counts("speed", speed_mm_s) as u8,
        ..Command::default()
    }
}

/// Raw value of a field of the command message.
fn counts(field: &str, value: f64) -> f64 {
    let field = Command::LAYOUT.signals.iter().find(|candidate| candidate.name == field);
    field.map_or(0.0, |field| (value / field.scale).round())
}

pub(super) fn run(args: &Args) -> Result<()> {
    if args.stop {
        return stop(args);
    }
    let request = Request::of(args)?;
    let source = args.port.open_given()?;
    let mut session = Session::new(source, args)?;
    eprintln!(
        "warning: the gripper at {} moves: keep hands clear of the fingers; Ctrl-C ends the motion and opens a grasp, a \
         second one is an emergency stop",
        session.client.name()
    );
    let result = session.perform(args, request);
    let shut_down = session.shut_down(request);
    let page = match (args.json, &result) {
        (true, _) => {
            let json = session.log.json(&session.client, result.as_ref(), shut_down.is_ok());
            format!("{json}\n")
        }
        (false, Ok(is_reached)) => session.log.text(*is_reached),
        (false, Err(_)) => String::new(),
    };
    terminal::print(&page)?;
    match (result, shut_down) {
        (Err(error), Err(then)) => Err(error.context(format!("{then:#}"))),
        (Err(error), Ok(())) | (Ok(_), Err(error)) => Err(error),
        (Ok(_), Ok(())) => Ok(()),
    }
}

/// Stops the gripper; needs no session.
fn stop(args: &Args) -> Result<()> {
    let source = args.port.open_given()?;
    let mut session = Session::new(source, args)?;
    session.is_shutting_down = true;
    session.connect(args)?;
    session.client.stop()?;
    let is_stopped = |session: &Session| !session.task().is_some_and(TaskState::moves);
    if session.wait(STOP_S, is_stopped)? != WaitResult::Done {
        bail!("the gripper still moves: switch its supply off");
    }
    let state = session.code().map_or_else(String::new, format::state_name);
    terminal::print_result(
        args.json,
        || json!({ "stopped": true, "state": state }),
        || {
            format!(
                "The gripper has stopped, state: {state}. The stop is latched; to open the fingers:\n  \
                 cargo magpie grasp {} --release --clear-faults\n",
                args.port.words()
            )
        },
    )
}

struct Session {
    client: Client,
    log: CommandLog,
    interrupted: Arc<AtomicBool>,
    /// The motion ends: that the gripper was stopped is no error any more.
    is_shutting_down: bool,
}

/// Result of waiting for a condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum WaitResult {
    /// The condition is true.
    Done,
    /// Timeout.
    TimedOut,
    /// Ctrl-C.
    Interrupted,
}

impl Session {
    fn new(source: Box<dyn Source + Send>, args: &Args) -> Result<Self> {
        Ok(Self {
            client: Client::new(source, args.port.credentials()?),
            log: CommandLog::new(args.json),
            interrupted: interrupted()?,
            is_shutting_down: false,
        })
    }

    /// Arms, enables, homes and commands; true if the set-point was reached before Ctrl-C.
    fn perform(&mut self, args: &Args, request: Request) -> Result<bool> {
        let all = [Self::connect, Self::clear_faults, Self::arm, Self::enable, Self::home];
        let to_release = [Self::connect, Self::arm];
        let steps = match request {
            Request::Release { .. } if !args.clear_faults => &to_release[..],
            Request::Release { .. } => &all[..3],
            _ => &all[..],
        };
        for step in steps {
            if step(self, args)? == WaitResult::Interrupted {
                return Ok(false);
            }
        }
        self.client.command(request.command());
        if let Request::Release { .. } = request {
            return self.open();
        }
        let mut failure = None;
        let waited = self.wait(REACH_S, |session| {
            let task = session.task();
            failure = task.and_then(|task| request.failure(task));
            let is_reached = task
                .zip(session.opening_mm())
                .is_some_and(|(task, opening_mm)| request.is_reached(task, opening_mm));
            is_reached || failure.is_some()
        })?;
        if let Some(failure) = failure {
            bail!("{failure}");
        }
        match waited {
            WaitResult::Done => {}
            WaitResult::Interrupted => return Ok(false),
            WaitResult::TimedOut => {
                bail!("set-point not reached within {REACH_S} s{}", self.faults())
            }
        }
        let hold_s = match (args.seconds, request) {
            (Some(seconds), _) => seconds,
            (None, Request::Position { .. }) => 0.0,
            (None, _) => f64::INFINITY,
        };
        self.wait(hold_s, |session| {
            failure = session.task().and_then(|task| request.failure(task));
            failure.is_some()
        })?;
        match failure {
            Some(failure) => bail!("{failure}"),
            None => Ok(true),
        }
    }

    /// Waits for the end of an opening, which faults do not prevent; true if it ended before Ctrl-C.
    fn open(&mut self) -> Result<bool> {
        self.is_shutting_down = true;
        let opens = |session: &Self| session.task() == Some(TaskState::Releasing);
        if self.wait(ENABLE_S, opens)? == WaitResult::TimedOut {
            let refusal = self.client.refused;
            let reason = refusal.map_or(String::new(), |refusal| format!(": {}", refusal.words()));
            bail!("the gripper does not open{reason}{}", self.faults());
        }
        match self.wait(RELEASE_S, |session| !opens(session))? {
            WaitResult::Done => Ok(true),
            WaitResult::Interrupted => Ok(false),
            WaitResult::TimedOut => bail!("the opening does not end{}", self.faults()),
        }
    }

    /// Waits for the first heartbeat and the end of the self-test.
    fn connect(&mut self, _: &Args) -> Result<WaitResult> {
        let is_ready =
            |session: &Self| session.code().is_some_and(|code| code > PowerState::SelfTest as u8);
        let waited = self.wait(CONNECT_S, is_ready)?;
        if waited == WaitResult::TimedOut {
            let name = self.client.name();
            match self.code() {
                Some(code) => {
                    bail!("{name}: the gripper remains in state {}", format::state_name(code))
                }
                None => bail!(
                    "{name}: nothing was received; is it this line or bus, is the board powered, and does its firmware \
                     run?"
                ),
            }
        }
        Ok(waited)
    }

    fn clear_faults(&mut self, args: &Args) -> Result<WaitResult> {
        let has_fault = |session: &Self| session.code() == Some(PowerState::Fault as u8);
        if args.clear_faults {
            self.client.request(op::CLEAR_FAULTS)?;
            let waited = self.wait(ARM_S, |session| session.client.is_answered())?;
            match waited {
                WaitResult::Done => {}
                WaitResult::Interrupted => return Ok(waited),
                WaitResult::TimedOut => {
                    bail!("the gripper does not clear its faults: {}", self.no_session())
                }
            }
            if self.wait(ARM_S, |session| !session.client.state.is_stopped())?
                == WaitResult::TimedOut
            {
                bail!("the stop stays latched: the fingers do not rest");
            }
        }
        if !has_fault(self) {
            return Ok(WaitResult::Done);
        }
        if !args.clear_faults {
            bail!(
                "the gripper has a fault{}: remove its cause and give --clear-faults",
                self.faults()
            );
        }
        let waited = self.wait(ARM_S, |session| !has_fault(session))?;
        if waited == WaitResult::TimedOut {
            bail!("the fault persists{}: remove its cause first", self.faults());
        }
        Ok(waited)
    }

    fn arm(&mut self, _: &Args) -> Result<WaitResult> {
        if self.client.state.is_stopped() {
            bail!(
                "a stop is latched: make sure that the gripper may move again, and add --clear-faults"
            );
        }
        let end_s = self.client.elapsed_s() + ARM_S;
        while self.client.elapsed_s() < end_s {
            self.client.arm()?;
            let waited = self.wait(ARM_RETRY_S, |session| session.client.is_armed())?;
            if waited != WaitResult::TimedOut {
                if self.client.state.is_unprotected() {
                    print_unprotected(&self.client.name());
                }
                return Ok(waited);
            }
            // It does not become right by repetition.
            if self.client.not_armed == Some(status::REFUSED) {
                break;
            }
        }
        bail!("the gripper does not arm: {}{}", self.no_session(), self.faults())
    }

    /// Why no session was opened.
    fn no_session(&self) -> &'static str {
        self.client.not_armed.map_or(
            "it does not answer: does the firmware drive a motor?",
            session::session_refusal,
        )
    }

    fn enable(&mut self, _: &Args) -> Result<WaitResult> {
        self.client.command(mode_command(mode::ENABLE));
        let waited =
            self.wait(ENABLE_S, |session| session.code().is_some_and(|code| code >= TASK_CODE))?;
        if waited == WaitResult::TimedOut {
            let reason = self
                .client
                .refused
                .map_or(String::new(), |refusal| format!(": {}", refusal.words()));
            bail!("the drive was not enabled{reason}{}", self.faults());
        }
        Ok(waited)
    }

    fn home(&mut self, args: &Args) -> Result<WaitResult> {
        if self.task() != Some(TaskState::Unhomed) {
            return Ok(WaitResult::Done);
        }
        if !args.home {
            bail!(
                "the gripper is not homed: give --home (requires free fingers; they close to the end stop, then open \
                 fully)"
            );
        }
        self.client.command(mode_command(mode::HOME));
        let mut has_started = false;
        let waited = self.wait(HOME_S, |session| {
            has_started |= session.task() == Some(TaskState::Homing);
            session.task() == Some(TaskState::Idle)
                || has_started && session.task() == Some(TaskState::Unhomed)
        })?;
        match (waited, self.task()) {
            (WaitResult::Interrupted, _) | (WaitResult::Done, Some(TaskState::Idle)) => Ok(waited),
            _ => bail!("homing failed{}", self.faults()),
        }
    }

    /// Ends the motion and disables the drive.
    fn shut_down(&mut self, request: Request) -> Result<()> {
        // A further Ctrl-C is an emergency stop.
        let was_interrupted = self.interrupted.swap(false, Relaxed);
        self.is_shutting_down = true;
        // With an open session the gripper would refuse every service.
        let result = self.release(request).and(self.end_session());
        self.interrupted.fetch_or(was_interrupted, Relaxed);
        result
    }

    fn end_session(&mut self) -> Result<()> {
        if !self.client.is_armed() {
            return Ok(());
        }
        self.client.end_session()?;
        let is_closed =
            |session: &Self| session.code().is_some_and(|code| code < PowerState::Armed as u8);
        // Reported by the next heartbeat; a latched fault remains the state.
        self.wait(CLOSE_S, is_closed).map(|_| ())
    }

    fn release(&mut self, request: Request) -> Result<()> {
        if !self.client.is_armed() {
            return Ok(());
        }
        let task = self.task();
        let command = match (request, task) {
            (_, None) => None,
            (_, Some(task)) if is_gripping(task) => {
                let opening_mm = self.opening_mm().unwrap_or(0.0) + RELEASE_MM;
                let opening_mm = opening_mm.min(constants::STROKE.value - MARGIN_MM);
                Some(motion(mode::RELEASE, opening_mm, DEFAULT_SPEED_MM_S))
            }
            (_, Some(TaskState::Foot)) => Some(mode_command(mode::LEAVE)),
            (_, Some(task)) if task.moves() => Some(mode_command(mode::STOP)),
            _ => None,
        };
        if let Some(command) = command {
            self.client.command(command);
            let is_idle = |session: &Self| {
                matches!(session.task(), None | Some(TaskState::Idle | TaskState::Unhomed))
            };
            self.finish(RELEASE_S, is_idle, "release timed out")?;
        }
        self.client.command(mode_command(mode::DISABLE));
        let is_off = |session: &Self| session.code().is_some_and(|code| code < TASK_CODE);
        self.finish(DISABLE_S, is_off, "disabling the drive timed out")
    }

    /// Waits for a shut-down step; a timeout or Ctrl-C is an emergency stop.
    fn finish(
        &mut self,
        limit_s: f64,
        is_done: impl FnMut(&Self) -> bool,
        failed: &str,
    ) -> Result<()> {
        match self.wait(limit_s, is_done) {
            Ok(WaitResult::Done) => Ok(()),
            Ok(WaitResult::Interrupted) => {
                self.client.stop()?;
                bail!("emergency stop: inspect the gripper before arming it again")
            }
            Ok(WaitResult::TimedOut) => {
                self.client.stop()?;
                bail!("{failed}: emergency stop")
            }
            Err(error) => Err(error),
        }
    }

    /// Polls until a condition is true, a timeout or Ctrl-C. A fault or a refused command is an error.
    fn wait(&mut self, limit_s: f64, mut is_done: impl FnMut(&Self) -> bool) -> Result<WaitResult> {
        let end_s = self.client.elapsed_s() + limit_s;
        loop {
            if self.interrupted.load(Relaxed) {
                return Ok(WaitResult::Interrupted);
            }
            if is_done(self) {
                return Ok(WaitResult::Done);
            }
            if self.client.elapsed_s() >= end_s {
                return Ok(WaitResult::TimedOut);
            }
            self.client.poll()?;
            self.log.update(&self.client);
            check_protocol(&self.client.state)?;
            self.check()?;
        }
    }

    /// Fails after a fault reaction or a refused command.
    fn check(&self) -> Result<()> {
        let code = self.code().unwrap_or(0);
        let is_stopped = [PowerState::QuickStop, PowerState::FaultReaction, PowerState::Fault]
            .iter()
            .any(|power| *power as u8 == code);
        if is_stopped && self.client.is_armed() && !self.is_shutting_down {
            bail!("the gripper was stopped{}", self.faults());
        }
        match self.client.refused {
            Some(refusal) if refusal.is_stopped() => bail!("{}", refusal.words()),
            // Enabling measures the current offsets, and the motor may still move during a release or disable.
            Some(refusal)
                if ![mode::ENABLE, mode::RELEASE, mode::DISABLE].contains(&refusal.mode) =>
            {
                bail!("{}", refusal.words())
            }
            _ => Ok(()),
        }
    }

    /// State code of the last heartbeat.
    fn code(&self) -> Option<u8> {
        self.client.state.heartbeat.map(|beat| beat.value.state)
    }

    fn task(&self) -> Option<TaskState> {
        self.code().and_then(TaskState::of_code)
    }

    fn opening_mm(&self) -> Option<f64> {
        opening_mm(&self.client.state.grip?.value)
    }

    /// Active faults after a colon; empty without faults.
    fn faults(&self) -> String {
        let faults: Vec<_> = self.client.state.faults.iter().map(format::fault_line).collect();
        if faults.is_empty() { String::new() } else { format!(": {}", faults.join("; ")) }
    }
}

const fn is_gripping(task: TaskState) -> bool {
    matches!(
        task,
        TaskState::Force
            | TaskState::HoldActive
            | TaskState::HoldLatched
            | TaskState::HoldFrozen
            | TaskState::GripFailed
    )
}

/// Period of printed lines and of points in JSON, in seconds.
const LINE_PERIOD_S: f64 = 1.0;
const POINT_PERIOD_S: f64 = 0.05;

/// States and measurements reported during a command.
struct CommandLog {
    /// Suppresses printed lines.
    is_silent: bool,
    state: Option<u8>,
    faults: Vec<String>,
    line_s: f64,
    point_s: f64,
    points: Vec<Value>,
    states: Vec<Value>,
}

impl CommandLog {
    fn new(is_silent: bool) -> Self {
        Self {
            is_silent,
            state: None,
            faults: Vec::new(),
            line_s: 0.0,
            point_s: 0.0,
            points: Vec::new(),
            states: Vec::new(),
        }
    }

    /// Records the current state of the client.
    fn update(&mut self, client: &Client) {
        let now_s = client.elapsed_s();
        let state = client.state.heartbeat.map(|beat| beat.value.state);
        let faults: Vec<_> = client.state.faults.iter().map(format::fault_line).collect();
        let is_new = state.is_some() && (state != self.state || faults != self.faults);
        if state != self.state {
            self.states.extend(state.map(|code| {
                json!({ "time_s": rounded(now_s), "state": format::state_name(code), "code": code })
            }));
        }
        (self.state, self.faults) = (state, faults);
        if is_new || state.is_some() && now_s >= self.line_s + LINE_PERIOD_S {
            self.line_s = now_s;
            if !self.is_silent {
                eprintln!("{}", self.line(client, now_s));
            }
        }
        if now_s >= self.point_s + POINT_PERIOD_S {
            self.point_s = now_s;
            self.points.extend(point(client, now_s));
        }
    }

    fn line(&self, client: &Client, now_s: f64) -> String {
        let state = self.state.map_or("-".to_owned(), format::state_name);
        let mut text = format!("{now_s:>7.2} s  {state:<14}");
        if let Some(([force_n, current_a], opening_mm)) = measurements(client) {
            let opening =
                opening_mm.map_or_else(|| "unknown".to_owned(), |mm| format!("{mm:>6.2} mm"));
            text +=
                &format!("  force {force_n:>6.1} N  opening {opening}  current {current_a:>6.2} A");
        }
        if self.faults.is_empty() { text } else { text + "  fault: " + &self.faults.join("; ") }
    }

    fn text(&self, is_reached: bool) -> String {
        let state = self.state.map_or("unknown".to_owned(), format::state_name);
        if is_reached {
            format!("Done. The gripper is in state {state}.\n")
        } else {
            format!("Stopped before the set-point was reached. The gripper is in state {state}.\n")
        }
    }

    fn json(&self, client: &Client, result: Result<&bool, &Error>, is_off: bool) -> Value {
        json!({
            "simulated": false,
            "gripper": client.name(),
            "reached": result.is_ok_and(|reached| *reached),
            "error": result.err().map(|error| format!("{error:#}")),
            "disabled": is_off,
            "states": self.states,
            "points": self.points,
            "faults": client.state.faults.iter().map(format::fault_json).collect::<Vec<_>>(),
        })
    }
}

/// Grasping force in newtons and current in amperes; opening in millimetres, if it is known.
fn measurements(client: &Client) -> Option<([f64; 2], Option<f64>)> {
    let status = client.state.grip?.value;
    let values = [0.1 * f64::from(status.force), 0.01 * f64::from(status.current)];
    Some((values, opening_mm(&status)))
}

fn point(client: &Client, now_s: f64) -> Option<Value> {
    let ([force_n, current_a], opening_mm) = measurements(client)?;
    let state = client.state.heartbeat.map(|beat| format::state_name(beat.value.state));
    Some(json!({
        "time_s": rounded(now_s),
        "state": state,
        "force_n": rounded(force_n),
        "opening_mm": opening_mm.map(rounded),
        "current_a": rounded(current_a),
    }))
}

/// Rounds to three decimals, the resolution of the messages.
fn rounded(value: f64) -> f64 {
    (1e3 * value).round() / 1e3
}

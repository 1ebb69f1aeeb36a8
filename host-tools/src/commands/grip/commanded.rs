//! A gripper on a serial line or CAN bus: armed, homed where that is allowed, commanded, and disabled at the end.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use anyhow::{Result, anyhow, bail};
use firmware::grip::order::mode;
use firmware::grip::states::{Power, TASK_CODE, Task};
use firmware::params;
use firmware::session::op;
use firmware::wire::messages::Command;

use super::course::Course;
use super::{Args, ROOM_MM, check_place, force};
use crate::commands::live::{check_language, interrupted};
use crate::drive::grasp::grip_command;
use crate::live::client::Client;
use crate::live::{answers, words};
use crate::show;

/// Limits of the steps in seconds of this machine's clock. An emulated gripper may take several times as long as a real
/// one.
const HEARD_S: f64 = 10.0;
const ARM_S: f64 = 10.0;
const ENABLE_S: f64 = 10.0;
const HOME_S: f64 = 180.0;
const RELEASE_S: f64 = 60.0;
const DISABLE_S: f64 = 10.0;
const CLOSE_S: f64 = 2.0;
/// Limit of the way to the request, and then of nothing but Ctrl-C.
const REACH_S: f64 = 120.0;
/// Between two requests to arm.
const ARM_AGAIN_S: f64 = 1.0;
/// Speed of motions where none is given, and of a release, in mm/s.
const SPEED_MM_S: f64 = 15.0;
/// A release opens by so much, in mm.
const RELEASE_MM: f64 = 10.0;
/// An opening counts as reached so close to it, in mm.
const REACHED_MM: f64 = 0.5;
/// Speeds of the message.
const SPEEDS_MM_S: std::ops::RangeInclusive<f64> = 0.25..=58.0;

/// What is to be done.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Request {
    Position { opening_mm: f64, speed_mm_s: f64 },
    Force { set_n: f64 },
    Foot,
}

impl Request {
    fn of(args: &Args) -> Result<Self> {
        if args.foot.flatten().is_some() {
            bail!("--foot takes no force with --port or --can: there the ground presses");
        }
        if args.foot.is_some() {
            return Ok(Self::Foot);
        }
        if let Some(set_n) = args.force {
            force::check(set_n)?;
            return Ok(Self::Force { set_n });
        }
        let Some(opening_mm) = args.position else {
            bail!(
                "--speed alone is possible in the simulation only; with --port or --can give --position, too"
            );
        };
        check_place("--position", opening_mm)?;
        let speed_mm_s = args.speed.unwrap_or(SPEED_MM_S);
        if !SPEEDS_MM_S.contains(&speed_mm_s) {
            let (least, most) = (SPEEDS_MM_S.start(), SPEEDS_MM_S.end());
            bail!("--speed {speed_mm_s} is not possible here; give {least} to {most} mm/s");
        }
        Ok(Self::Position {
            opening_mm,
            speed_mm_s,
        })
    }

    fn command(&self) -> Command {
        match *self {
            Self::Position {
                opening_mm,
                speed_mm_s,
            } => motion(mode::MOVE, opening_mm, speed_mm_s),
            Self::Force { set_n } => grip_command(set_n),
            Self::Foot => of_mode(mode::FOOT),
        }
    }

    /// Whether it has come about.
    fn is_reached(&self, task: Task, opening_mm: f64) -> bool {
        match self {
            Self::Position {
                opening_mm: asked_mm,
                ..
            } => task == Task::Idle && (opening_mm - asked_mm).abs() < REACHED_MM,
            Self::Force { .. } => matches!(task, Task::HoldActive | Task::HoldLatched),
            Self::Foot => task == Task::Foot,
        }
    }

    /// States in which it has failed, and why.
    const fn failure(&self, task: Task) -> Option<&'static str> {
        match (self, task) {
            (Self::Force { .. }, Task::NoObject) => {
                Some("the fingers met: there is no object between them")
            }
            (Self::Force { .. }, Task::GripFailed) => Some("no grip came about in time"),
            (Self::Force { .. }, Task::Lost) => Some("the object was lost"),
            (_, Task::ContactStop) => Some("something was touched on the way"),
            (_, Task::TimeoutHold) => Some(
                "the gripper received no command for 100 ms: the line or bus is too slow, or this machine is busy",
            ),
            _ => None,
        }
    }
}

const fn of_mode(mode: u8) -> Command {
    Command {
        mode,
        counter: 0,
        position: 0,
        speed: 0,
        force: 0,
        flags: 0,
        crc: 0,
    }
}

fn motion(mode: u8, opening_mm: f64, speed_mm_s: f64) -> Command {
    Command {
        mode,
        position: counts("position", opening_mm) as u16,
        speed: counts("speed", speed_mm_s) as u8,
        ..Command::default()
    }
}

/// Counts of a field of the command, of its value in the field's unit.
fn counts(field: &str, value: f64) -> f64 {
    let field = Command::LAYOUT
        .fields
        .iter()
        .find(|candidate| candidate.name == field);
    field.map_or(0.0, |field| (value / field.scale).round())
}

pub(super) fn run(args: &Args) -> Result<()> {
    let request = Request::of(args)?;
    let source = args
        .line
        .open()?
        .ok_or_else(|| anyhow!("give --port or --can"))?;
    let mut session = Session {
        client: Client::new(source, args.line.node()),
        course: Course::new(args.json),
        interrupted: interrupted()?,
    };
    eprintln!(
        "warning: this moves the gripper at {}: keep hands clear of the fingers; Ctrl-C stops it",
        session.client.name()
    );
    let result = session.perform(args, request);
    let shut_down = session.shut_down(request);
    let page = match (args.json, &result) {
        (true, _) => {
            let json = session
                .course
                .json(&session.client, result.as_ref(), shut_down.is_ok());
            format!("{json}\n")
        }
        (false, Ok(is_reached)) => session.course.text(*is_reached),
        (false, Err(_)) => String::new(),
    };
    show::page(&page)?;
    match (result, shut_down) {
        (Err(error), Err(then)) => Err(error.context(format!("{then:#}"))),
        (Err(error), Ok(())) | (Ok(_), Err(error)) => Err(error),
        (Ok(_), Ok(())) => Ok(()),
    }
}

struct Session {
    client: Client,
    course: Course,
    interrupted: Arc<AtomicBool>,
}

/// How waiting ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Waited {
    /// What was waited for is there.
    Done,
    /// The time is over.
    Over,
    /// Ctrl-C.
    Interrupted,
}

impl Session {
    /// Arms, enables, homes and commands; whether what was asked for came about before the end.
    fn perform(&mut self, args: &Args, request: Request) -> Result<bool> {
        let steps = [
            Self::find,
            Self::clear_faults,
            Self::arm,
            Self::enable,
            Self::home,
        ];
        for step in steps {
            if step(self, args)? == Waited::Interrupted {
                return Ok(false);
            }
        }
        self.client.command(request.command());
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
            Waited::Done => {}
            Waited::Interrupted => return Ok(false),
            Waited::Over => bail!("it was not reached within {REACH_S} s{}", self.faults()),
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

    /// Waits for the first heartbeat, and until the gripper has checked itself.
    fn find(&mut self, _: &Args) -> Result<Waited> {
        let is_there = |session: &Self| {
            session
                .code()
                .is_some_and(|code| code > Power::SelfTest as u8)
        };
        let waited = self.wait(HEARD_S, is_there)?;
        if waited == Waited::Over {
            let name = self.client.name();
            match self.code() {
                Some(code) => bail!(
                    "{name}: the gripper stays in state {}",
                    answers::state(code)
                ),
                None => bail!(
                    "{name}: nothing was received; is it this line or bus, is the board supplied, and does its firmware \
                     run?"
                ),
            }
        }
        Ok(waited)
    }

    fn clear_faults(&mut self, args: &Args) -> Result<Waited> {
        let is_faulty = |session: &Self| session.code() == Some(Power::Fault as u8);
        if args.clear_faults {
            self.client.request(op::CLEAR_FAULTS)?;
        }
        if !is_faulty(self) {
            return Ok(Waited::Done);
        }
        if !args.clear_faults {
            bail!(
                "the gripper has a fault{}: remove its cause and give --clear-faults",
                self.faults()
            );
        }
        let waited = self.wait(ARM_S, |session| !is_faulty(session))?;
        if waited == Waited::Over {
            bail!(
                "the fault is still there{}: remove its cause first",
                self.faults()
            );
        }
        Ok(waited)
    }

    fn arm(&mut self, _: &Args) -> Result<Waited> {
        let end_s = self.client.elapsed_s() + ARM_S;
        while self.client.elapsed_s() < end_s {
            self.client.arm()?;
            let waited = self.wait(ARM_AGAIN_S, |session| session.client.is_armed())?;
            if waited != Waited::Over {
                return Ok(waited);
            }
        }
        match self.client.not_armed {
            Some(status) => bail!(
                "the gripper does not arm: {}{}",
                answers::arming(status),
                self.faults()
            ),
            None => bail!(
                "the gripper does not answer a request to arm: does it run firmware with a motor?"
            ),
        }
    }

    fn enable(&mut self, _: &Args) -> Result<Waited> {
        self.client.command(of_mode(mode::ENABLE));
        let waited = self.wait(ENABLE_S, |session| {
            session.code().is_some_and(|code| code >= TASK_CODE)
        })?;
        if waited == Waited::Over {
            let refused = self
                .client
                .refused
                .map_or(String::new(), |refusal| format!(": {}", refusal.words()));
            bail!("the drive was not enabled{refused}{}", self.faults());
        }
        Ok(waited)
    }

    fn home(&mut self, args: &Args) -> Result<Waited> {
        if self.task() != Some(Task::Unhomed) {
            return Ok(Waited::Done);
        }
        if !args.home {
            bail!(
                "the gripper is not homed, its opening is not known: give --home (nothing between the fingers; they close \
                 until they press, then open fully)"
            );
        }
        self.client.command(of_mode(mode::HOME));
        let mut has_begun = false;
        let waited = self.wait(HOME_S, |session| {
            has_begun |= session.task() == Some(Task::Homing);
            session.task() == Some(Task::Idle) || has_begun && session.task() == Some(Task::Unhomed)
        })?;
        match (waited, self.task()) {
            (Waited::Interrupted, _) | (Waited::Done, Some(Task::Idle)) => Ok(waited),
            _ => bail!("homing failed{}", self.faults()),
        }
    }

    /// Stops what was asked for and disables the drive.
    fn shut_down(&mut self, request: Request) -> Result<()> {
        // From here on Ctrl-C is the second one.
        let was_interrupted = self.interrupted.swap(false, Relaxed);
        let result = self.release(request);
        self.interrupted.fetch_or(was_interrupted, Relaxed);
        result
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
                let opening_mm = opening_mm.min(params::STROKE.value - ROOM_MM);
                Some(motion(mode::RELEASE, opening_mm, SPEED_MM_S))
            }
            (_, Some(Task::Foot)) => Some(of_mode(mode::LEAVE)),
            (_, Some(task)) if task.moves() => Some(of_mode(mode::STOP)),
            _ => None,
        };
        if let Some(command) = command {
            self.client.command(command);
            let rests =
                |session: &Self| matches!(session.task(), None | Some(Task::Idle | Task::Unhomed));
            self.finish(RELEASE_S, rests, "it did not release in time")?;
        }
        self.client.command(of_mode(mode::DISABLE));
        let is_off = |session: &Self| session.code().is_some_and(|code| code < TASK_CODE);
        self.finish(DISABLE_S, is_off, "the drive was not disabled in time")?;
        self.client.end_session()?;
        let is_closed =
            |session: &Self| session.code().is_some_and(|code| code < Power::Armed as u8);
        // The gripper reports it with the next heartbeat. A fault that is latched stays its state.
        self.wait(CLOSE_S, is_closed).map(|_| ())
    }

    /// Waits for a step of the end; where it does not come about, or with Ctrl-C, it is an emergency stop.
    fn finish(
        &mut self,
        limit_s: f64,
        is_done: impl FnMut(&Self) -> bool,
        failed: &str,
    ) -> Result<()> {
        match self.wait(limit_s, is_done) {
            Ok(Waited::Done) => Ok(()),
            Ok(Waited::Interrupted) => {
                self.client.stop()?;
                bail!("emergency stop: look at the gripper before it is armed again")
            }
            Ok(Waited::Over) => {
                self.client.stop()?;
                bail!("{failed}: emergency stop")
            }
            Err(error) => Err(error),
        }
    }

    /// Goes on until something is so, the time is over, or Ctrl-C. A fault, or a refused command, is an error.
    fn wait(&mut self, limit_s: f64, mut is_done: impl FnMut(&Self) -> bool) -> Result<Waited> {
        let end_s = self.client.elapsed_s() + limit_s;
        loop {
            if self.interrupted.load(Relaxed) {
                return Ok(Waited::Interrupted);
            }
            if is_done(self) {
                return Ok(Waited::Done);
            }
            if self.client.elapsed_s() >= end_s {
                return Ok(Waited::Over);
            }
            self.client.poll()?;
            self.course.update(&self.client);
            check_language(&self.client.state)?;
            self.check()?;
        }
    }

    /// Neither a fault has stopped the gripper nor a command was refused.
    fn check(&self) -> Result<()> {
        let code = self.code().unwrap_or(0);
        let is_stopped = [Power::QuickStop, Power::FaultReaction, Power::Fault]
            .iter()
            .any(|power| *power as u8 == code);
        if is_stopped && self.client.is_armed() {
            bail!("the gripper was stopped{}", self.faults());
        }
        match self.client.refused {
            // The motor's offsets are measured as it is enabled, and it may still be moving as it is stopped.
            Some(refusal)
                if ![mode::ENABLE, mode::RELEASE, mode::DISABLE].contains(&refusal.mode) =>
            {
                bail!("{}", refusal.words())
            }
            _ => Ok(()),
        }
    }

    /// The heartbeat's state.
    fn code(&self) -> Option<u8> {
        self.client.state.heartbeat.map(|beat| beat.value.state)
    }

    fn task(&self) -> Option<Task> {
        self.code().and_then(answers::task)
    }

    fn opening_mm(&self) -> Option<f64> {
        self.client
            .state
            .grip
            .map(|status| 0.01 * f64::from(status.value.position))
    }

    /// Active faults, after a colon; empty where there is none.
    fn faults(&self) -> String {
        let faults: Vec<_> = self.client.state.faults.iter().map(words::fault).collect();
        match faults.is_empty() {
            true => String::new(),
            false => format!(": {}", faults.join("; ")),
        }
    }
}

const fn is_gripping(task: Task) -> bool {
    matches!(
        task,
        Task::Force | Task::HoldActive | Task::HoldLatched | Task::HoldFrozen | Task::GripFailed
    )
}

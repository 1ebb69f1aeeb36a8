//! What the steps ask of a gripper, in the time of its [`Source`].

use std::time::Duration;

use anyhow::{Context, Result, bail};
use firmware::grip::commands::mode;
use firmware::motor::calibration::CalibrationKind;
use firmware::parameters::schema::id;
use firmware::protocol::host_session::{HostSession, service};
use firmware::protocol::messages::{Command, EStop, Message};
use firmware::protocol::serial::{Packet, Tick};
use firmware::protocol::session::op;

use crate::session::{self, Credentials, with_session};
use crate::source::Source;
use crate::state::GripperState;
use crate::{calibration_client, params_client};

/// Period of commands.
const PERIOD: Duration = Duration::from_millis(20);
/// Timeout of arming.
const ARMING: Duration = Duration::from_secs(5);
/// Time of a restart until the gripper answers.
const RESTART: Duration = Duration::from_millis(1500);

/// Time from the end of a session until the motor is off.
const DISARMING: Duration = Duration::from_millis(500);

/// A gripper on a connection.
pub struct Gripper<'g> {
    pub source: &'g mut dyn Source,
    pub credentials: Credentials,
}

/// What a gripper has sent in a time.
#[derive(Default)]
pub struct Observed {
    pub state: GripperState,
    pub ticks: Vec<Tick>,
}

impl Gripper<'_> {
    /// A parameter, or what the board is ([`firmware::parameters::schema::counter`]).
    pub fn read(&mut self, id: u16) -> Result<u32> {
        params_client::read(self.source, id).map(|value| value as u32)
    }

    /// Listens for a time.
    pub fn observe(&mut self, time: Duration) -> Result<Observed> {
        let mut observed = Observed::default();
        let begun = self.source.now();
        while self.source.now() < begun + time {
            self.receive(&mut observed)?;
        }
        Ok(observed)
    }

    fn receive(&mut self, observed: &mut Observed) -> Result<()> {
        let mut packets = Vec::new();
        if !self.source.receive(&mut packets)? {
            bail!("{}: connection closed", self.source.name());
        }
        let now_s = self.source.now().as_secs_f64();
        for packet in &packets {
            observed.state.update(now_s, packet);
            if let Packet::Tick(tick) = packet {
                observed.ticks.push(*tick);
            }
        }
        Ok(())
    }

    /// Restarts the firmware.
    pub fn restart(&mut self) -> Result<()> {
        with_session(self.source, self.credentials, |session| {
            session.send(service(op::REBOOT, 0))
        })?;
        self.observe(RESTART).map(|_| ())
    }

    /// Sets or removes the limits of the bench for the next boot.
    pub fn set_bench(&mut self, is_on: bool) -> Result<()> {
        with_session(self.source, self.credentials, |session| {
            params_client::write(session, id::BENCH, is_on.into())?;
            calibration_client::save(session)
        })
    }

    /// Measures the motor, and saves the result.
    pub fn measure_motor(&mut self) -> Result<()> {
        with_session(self.source, self.credentials, |session| {
            calibration_client::identify(session, CalibrationKind::Motor, true).map(|_| ())
        })
    }

    /// Defines the present forces as zero.
    pub fn tare(&mut self) -> Result<()> {
        with_session(self.source, self.credentials, |session| {
            calibration_client::tare(session, false, true)
        })
    }

    /// Clears latched faults and stops.
    pub fn clear(&mut self) -> Result<()> {
        with_session(self.source, self.credentials, |session| {
            session.send(service(op::CLEAR_FAULTS, 0))
        })
    }

    /// Opens a session with motion.
    pub fn arm(&mut self) -> Result<Armed<'_>> {
        let Self { source, credentials } = self;
        let mut session = HostSession::new(credentials.node, credentials.key);
        session::open(&mut **source, &mut session, op::ARM, ARMING)
            .context("the gripper cannot be armed: see the faults in `cargo magpie monitor`")?;
        let gripper = Gripper { source: &mut **source, credentials: *credentials };
        Ok(Armed { gripper, session })
    }
}

/// A session with motion.
pub struct Armed<'g> {
    pub gripper: Gripper<'g>,
    session: HostSession,
}

impl Armed<'_> {
    /// Repeats a command for a time, or until a condition is true, and returns what was observed.
    pub fn command(
        &mut self,
        command: Command,
        time: Duration,
        is_done: impl Fn(&GripperState) -> bool,
    ) -> Result<Observed> {
        let mut observed = Observed::default();
        let begun = self.gripper.source.now();
        let mut due = begun;
        while self.gripper.source.now() < begun + time && !is_done(&observed.state) {
            if self.gripper.source.now() >= due {
                due = self.gripper.source.now() + PERIOD;
                let sealed = self.session.seal(Message::Command(command));
                for message in sealed.into_iter().flatten() {
                    self.gripper.source.send(message)?;
                }
            }
            self.gripper.receive(&mut observed)?;
        }
        Ok(observed)
    }

    /// Sends a stop, and listens for a time.
    pub fn stop(&mut self, time: Duration) -> Result<Observed> {
        self.gripper.source.send(Message::EStop(EStop::default()))?;
        self.gripper.observe(time)
    }

    /// Disables the gripper and ends the session, and waits until the motor is off.
    pub fn end(mut self) -> Result<()> {
        let disable = Command { mode: mode::DISABLE, ..Command::default() };
        self.command(disable, DISARMING, |_| false)?;
        for message in self.session.end() {
            self.gripper.source.send(message)?;
        }
        self.gripper.observe(DISARMING).map(|_| ())
    }
}

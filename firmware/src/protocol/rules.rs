//! Who may request what, and in which state of the gripper: the one table that the session, the service of hosts, the
//! documentation and the tests read.

use crate::parameters;
use crate::parameters::schema;
use crate::protocol::messages::{Message, ParamRequest, Service};
use crate::protocol::session::{UNLOADED, op, status};

/// What a request must prove.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Authority {
    /// Nothing: anybody may request it.
    Anyone,
    /// That it knows the key: its code answers a challenge.
    KeyHolder,
    /// That it is the owner of the session: its code and freshness counter belong to it.
    Owner,
    /// On the serial line only: as the owner, or physical presence, which is a pressed button or a gripper without a key.
    OwnerOrPresence,
}

/// Kinds of requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequestKind {
    /// Emergency stop.
    Stop,
    /// Version, description of the calibration, a parameter, a counter.
    Read,
    /// Motion of the gripper as a host knows it.
    ReportMotion,
    /// Part of an upload that the owner has begun, and whose end has a code over all parts.
    UploadPart,
    /// A session without motion, for services and parameters.
    OpenSession,
    /// A session with motion.
    Arm,
    /// End of the session.
    EndSession,
    /// That the owner is still there.
    RenewSession,
    /// A command.
    Command,
    /// Clear latched faults.
    ClearFaults,
    /// Tare.
    Tare,
    /// Measure motor or screw.
    Measure,
    /// Write the parameters to flash.
    Save,
    /// Reset.
    Reboot,
    /// Begin or finish an upload.
    Upload,
    /// Write a parameter that does not affect motion.
    WriteParameter,
    /// Write one that does.
    WriteMotionParameter,
    /// Write or erase the key.
    WriteKey,
}

/// Rule for a kind of requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rule {
    /// Kind of the request.
    pub kind: RequestKind,
    /// What it must prove.
    pub authority: Authority,
    /// Allowed while a host is armed or the motor is driven.
    pub while_armed: bool,
    /// Allowed during a tare or a calibration.
    pub while_calibrating: bool,
    /// Allowed while an object is gripped or the fingers are loaded.
    pub while_loaded: bool,
    /// Allowed while nobody has accepted the stored key
    /// ([`ParameterOrigin::is_doubtful`](crate::system::nv_storage::ParameterOrigin::is_doubtful)).
    pub while_doubtful: bool,
}

const fn rule(
    kind: RequestKind,
    authority: Authority,
    [while_armed, while_calibrating, while_loaded]: [bool; 3],
) -> Rule {
    // The others move the gripper, or change what it does.
    let while_doubtful = matches!(
        kind,
        RequestKind::Stop
            | RequestKind::Read
            | RequestKind::ReportMotion
            | RequestKind::OpenSession
            | RequestKind::EndSession
            | RequestKind::RenewSession
            | RequestKind::WriteKey
    );
    Rule { kind, authority, while_armed, while_calibrating, while_loaded, while_doubtful }
}

const YES: [bool; 3] = [true; 3];
const AT_REST: [bool; 3] = [false, false, true];
const UNLOADED_AT_REST: [bool; 3] = [false; 3];

/// The rules, in the order of [`RequestKind`].
pub const RULES: [Rule; 18] = [
    rule(RequestKind::Stop, Authority::Anyone, YES),
    rule(RequestKind::Read, Authority::Anyone, YES),
    rule(RequestKind::ReportMotion, Authority::Anyone, YES),
    rule(RequestKind::UploadPart, Authority::Anyone, AT_REST),
    rule(RequestKind::OpenSession, Authority::KeyHolder, YES),
    rule(RequestKind::Arm, Authority::KeyHolder, YES),
    rule(RequestKind::EndSession, Authority::Owner, YES),
    rule(RequestKind::RenewSession, Authority::Owner, YES),
    rule(RequestKind::Command, Authority::Owner, YES),
    rule(RequestKind::ClearFaults, Authority::Owner, YES),
    rule(RequestKind::Tare, Authority::Owner, UNLOADED_AT_REST),
    rule(RequestKind::Measure, Authority::Owner, UNLOADED_AT_REST),
    rule(RequestKind::Save, Authority::Owner, AT_REST),
    rule(RequestKind::Reboot, Authority::Owner, AT_REST),
    rule(RequestKind::Upload, Authority::Owner, AT_REST),
    rule(RequestKind::WriteParameter, Authority::Owner, YES),
    rule(RequestKind::WriteMotionParameter, Authority::Owner, AT_REST),
    rule(RequestKind::WriteKey, Authority::OwnerOrPresence, AT_REST),
];

/// State of the gripper that rules depend on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Situation {
    /// A host is armed, or the motor is driven.
    pub is_armed: bool,
    /// A tare or a calibration is in progress.
    pub is_calibrating: bool,
    /// An object is gripped.
    pub is_loaded: bool,
    /// Both fingers seem to press; their forces may be wrong.
    pub may_be_loaded: bool,
    /// The stored key may not be the last one, and nobody has accepted it.
    pub is_doubtful: bool,
}

impl RequestKind {
    /// Kind of a message of a host; `None` for an unknown operation, and for every other message.
    pub fn of(message: &Message) -> Option<Self> {
        Some(match message {
            Message::EStop(_) => Self::Stop,
            Message::Command(_) => Self::Command,
            Message::Service(service) => Self::of_service(service)?,
            Message::ParamRequest(request) => Self::of_parameter(request),
            Message::CalibrationChunk(_) => Self::UploadPart,
            Message::KeyPart(_) => Self::WriteKey,
            Message::HostAttitude(_) | Message::HostAcceleration(_) => Self::ReportMotion,
            _ => return None,
        })
    }

    const fn of_service(service: &Service) -> Option<Self> {
        Some(match service.op {
            op::VERSION | op::DESCRIPTION => Self::Read,
            op::OPEN => Self::OpenSession,
            op::ARM => Self::Arm,
            op::END => Self::EndSession,
            op::RENEW => Self::RenewSession,
            op::CLEAR_FAULTS => Self::ClearFaults,
            op::TARE => Self::Tare,
            op::MEASURE => Self::Measure,
            op::SAVE => Self::Save,
            op::REBOOT => Self::Reboot,
            op::UPLOAD | op::FINISH_UPLOAD => Self::Upload,
            op::WRITE_KEY | op::ERASE_KEY => Self::WriteKey,
            _ => return None,
        })
    }

    fn of_parameter(request: &ParamRequest) -> Self {
        if request.op != parameters::op::WRITE {
            return Self::Read;
        }
        match schema::RULES.iter().find(|rule| rule.id == request.id) {
            Some(rule) if rule.affects_motion => Self::WriteMotionParameter,
            _ => Self::WriteParameter,
        }
    }

    /// Its rule.
    pub fn rule(self) -> Rule {
        // The order is tested; an unlisted kind would need the most.
        let most = rule(self, Authority::Owner, UNLOADED_AT_REST);
        RULES.get(self as usize).copied().unwrap_or(most)
    }
}

impl Rule {
    /// Why the gripper refuses the request in this situation, as a [`status`]; `None` if it does not.
    pub fn refusal(&self, message: &Message, situation: &Situation) -> Option<u8> {
        let is_confirmed = matches!(
            message,
            Message::Service(
                Service { op: op::MEASURE, .. } | Service { op: op::TARE, argument: UNLOADED }
            )
        );
        let is_loaded = situation.is_loaded || (situation.may_be_loaded && !is_confirmed);
        if situation.is_doubtful && !self.while_doubtful {
            Some(status::FAULTY)
        } else if (situation.is_armed && !self.while_armed)
            || (situation.is_calibrating && !self.while_calibrating)
        {
            Some(status::ARMED)
        } else if is_loaded && !self.while_loaded {
            Some(status::GRIPPING)
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::protocol::messages::{
        CalibrationChunk, Command, EStop, Heartbeat, HostAcceleration, HostAttitude, KeyPart,
    };

    fn service(op: u8, argument: u32) -> Message {
        Message::Service(Service { op, argument })
    }

    fn parameter(op: u8, id: u16) -> Message {
        Message::ParamRequest(ParamRequest { op, id, ..ParamRequest::default() })
    }

    /// Requests with the columns of the table in SECURITY.md: what they must prove, and whether they are allowed while armed,
    /// while calibrating, with a gripped object, and with a doubtful key.
    #[test]
    fn requests_have_the_rules_of_the_document() {
        use Authority::{Anyone, KeyHolder, Owner, OwnerOrPresence};
        const MOVES: u16 = schema::id::COMMAND_TIMEOUT;
        const SENDS: u16 = schema::id::FORCE_RATE;
        let cases = [
            (Message::EStop(EStop::default()), Anyone, [true; 3], true),
            (service(op::VERSION, 0), Anyone, [true; 3], true),
            (service(op::DESCRIPTION, 3), Anyone, [true; 3], true),
            (parameter(parameters::op::READ, MOVES), Anyone, [true; 3], true),
            (Message::HostAttitude(HostAttitude::default()), Anyone, [true; 3], true),
            (Message::HostAcceleration(HostAcceleration::default()), Anyone, [true; 3], true),
            (
                Message::CalibrationChunk(CalibrationChunk::default()),
                Anyone,
                [false, false, true],
                false,
            ),
            (service(op::OPEN, 0), KeyHolder, [true; 3], true),
            (service(op::ARM, 0), KeyHolder, [true; 3], false),
            (service(op::END, 0), Owner, [true; 3], true),
            (service(op::RENEW, 0), Owner, [true; 3], true),
            (Message::Command(Command::default()), Owner, [true; 3], false),
            (service(op::CLEAR_FAULTS, 0), Owner, [true; 3], false),
            (service(op::TARE, 0), Owner, [false; 3], false),
            (service(op::TARE, UNLOADED), Owner, [false; 3], false),
            (service(op::MEASURE, 0), Owner, [false; 3], false),
            (service(op::SAVE, 0), Owner, [false, false, true], false),
            (service(op::REBOOT, 0), Owner, [false, false, true], false),
            (service(op::UPLOAD, 9), Owner, [false, false, true], false),
            (service(op::FINISH_UPLOAD, 9), Owner, [false, false, true], false),
            (parameter(parameters::op::WRITE, SENDS), Owner, [true; 3], false),
            (parameter(parameters::op::WRITE, MOVES), Owner, [false, false, true], false),
            (parameter(parameters::op::WRITE, 0xFFFF), Owner, [true; 3], false),
            (service(op::WRITE_KEY, 7), OwnerOrPresence, [false, false, true], true),
            (service(op::ERASE_KEY, 0), OwnerOrPresence, [false, false, true], true),
            (Message::KeyPart(KeyPart::default()), OwnerOrPresence, [false, false, true], true),
        ];
        let rest = Situation::default();
        for (message, authority, [armed, calibrating, loaded], doubtful) in cases {
            let rule = RequestKind::of(&message).map(RequestKind::rule);
            let Some(rule) = rule else { panic!("{message:?} has no rule") };
            assert_eq!(rule.authority, authority, "{message:?}");
            assert_eq!(rule.refusal(&message, &rest), None, "{message:?}");
            for (situation, is_allowed, reason) in [
                (Situation { is_armed: true, ..rest }, armed, status::ARMED),
                (Situation { is_calibrating: true, ..rest }, calibrating, status::ARMED),
                (Situation { is_loaded: true, ..rest }, loaded, status::GRIPPING),
                (Situation { is_doubtful: true, ..rest }, doubtful, status::FAULTY),
            ] {
                let expected = (!is_allowed).then_some(reason);
                assert_eq!(
                    rule.refusal(&message, &situation),
                    expected,
                    "{message:?} {situation:?}"
                );
            }
        }
        for message in [service(0, 0), service(99, 0), Message::Heartbeat(Heartbeat::default())] {
            assert_eq!(RequestKind::of(&message), None, "{message:?}");
        }
    }

    /// Forces that may be wrong refuse a tare, unless the host states that nothing is gripped; a measurement does without forces.
    #[test]
    fn seeming_load_refuses_a_tare_that_is_not_confirmed() {
        let situation = Situation { may_be_loaded: true, ..Situation::default() };
        for (message, refusal) in [
            (service(op::TARE, 0), Some(status::GRIPPING)),
            (service(op::TARE, UNLOADED), None),
            (service(op::MEASURE, 0), None),
            (service(op::SAVE, 0), None),
        ] {
            let rule = RequestKind::of(&message).map(RequestKind::rule);
            let found = rule.and_then(|rule| rule.refusal(&message, &situation));
            assert_eq!(found, refusal, "{message:?}");
        }
    }

    #[test]
    fn rules_are_in_the_order_of_their_kinds() {
        for (index, rule) in RULES.iter().enumerate() {
            assert_eq!(rule.kind as usize, index);
            assert_eq!(rule.kind.rule(), *rule);
        }
    }
}

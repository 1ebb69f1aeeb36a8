//! States and refusals of the gripper in words.

use firmware::grip::reason::Reason;
use firmware::grip::states::{Power, TASK_CODE, Task};
use firmware::session::status;

use super::faults::spaced;

/// A state as the heartbeat reports it: "armed", "hold active".
pub fn state(code: u8) -> String {
    if let Some(power) = Power::ALL
        .iter()
        .find(|power| **power as u8 == code && **power != Power::Enabled)
    {
        return spaced(power);
    }
    match task(code) {
        Some(task) => spaced(task),
        None => format!("state {code}"),
    }
}

/// What the fingers do, where the gripper is enabled.
pub fn task(code: u8) -> Option<Task> {
    let code = code.checked_sub(TASK_CODE)?;
    Task::ALL.iter().copied().find(|task| *task as u8 == code)
}

/// A refused command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Its mode.
    pub mode: u8,
    state: u8,
    reason: u8,
}

impl Refusal {
    /// From the detail of the reply ([`firmware::grip::reason::Refused::reply`]).
    pub const fn of(detail: u32) -> Self {
        let [reason, state, mode, _] = detail.to_le_bytes();
        Self {
            mode,
            state,
            reason,
        }
    }

    /// Why, in which state, and what to do.
    pub fn words(&self) -> String {
        let reason = REASONS
            .into_iter()
            .find(|reason| *reason as u8 == self.reason);
        let reason = match reason {
            Some(reason) => advice(reason).to_owned(),
            None => format!("reason {}, which this tool does not know", self.reason),
        };
        format!("refused in state {}: {reason}", state(self.state))
    }
}

const REASONS: [Reason; 14] = [
    Reason::UnknownMode,
    Reason::NotEnabled,
    Reason::Faulty,
    Reason::Latched,
    Reason::MotorNotReady,
    Reason::NotHomed,
    Reason::Busy,
    Reason::Gripping,
    Reason::IsFoot,
    Reason::Senseless,
    Reason::OutOfRange,
    Reason::Blind,
    Reason::Loaded,
    Reason::NotParked,
];

const fn advice(reason: Reason) -> &'static str {
    match reason {
        Reason::UnknownMode => {
            "the firmware does not know this command: it is older than this tool"
        }
        Reason::NotEnabled => "the drive is not enabled",
        Reason::Faulty => "a fault is active: remove its cause",
        Reason::Latched => {
            "a fault is latched: clear it with --clear-faults once its cause is gone"
        }
        Reason::MotorNotReady => {
            "the motor is not ready: its offsets are being measured, or it has tripped"
        }
        Reason::NotHomed => "the opening is not known: home first, with --home",
        Reason::Busy => "the fingers are moving",
        Reason::Gripping => "something is gripped: release it first",
        Reason::IsFoot => "it is a foot: leave that first",
        Reason::Senseless => "it has no meaning in this state",
        Reason::OutOfRange => "a number is out of range",
        Reason::Blind => {
            "no finger reports a usable force: look at the sensors with `magpie monitor`"
        }
        Reason::Loaded => "a load is on the fingers: take it away",
        Reason::NotParked => {
            "the fingers are not where a foot needs them: close them, or open them fully"
        }
    }
}

/// Why the gripper does not arm.
pub const fn arming(code: u8) -> &'static str {
    match code {
        status::REFUSED => "the nonce was wrong or came too late: is the connection slow?",
        status::FAULTY => {
            "a fault forbids it: look with `magpie monitor`, remove its cause, and use --clear-faults"
        }
        status::ARMED => "another host has armed it: end that one first",
        _ => "the firmware gives no reason that this tool knows",
    }
}

#[cfg(test)]
mod tests {
    use firmware::grip::reason::Refused;
    use firmware::grip::states::code;

    use super::*;

    #[test]
    fn each_state_has_words_of_its_own() {
        assert_eq!(state(code(Power::QuickStop, Task::Idle)), "quick stop");
        assert_eq!(state(code(Power::Enabled, Task::HoldActive)), "hold active");
        assert_eq!(task(code(Power::Enabled, Task::Foot)), Some(Task::Foot));
        assert_eq!(task(code(Power::Armed, Task::Foot)), None);
        assert_eq!(state(99), "state 99");
    }

    #[test]
    fn a_refusal_says_why_and_in_which_state() {
        for reason in REASONS {
            let refused = Refused {
                mode: 4,
                reason,
                state: code(Power::Enabled, Task::Unhomed),
            };
            let refusal = Refusal::of(refused.reply().detail);
            assert_eq!(refusal.mode, 4);
            assert_eq!(
                refusal.words(),
                format!("refused in state unhomed: {}", advice(reason))
            );
        }
    }
}

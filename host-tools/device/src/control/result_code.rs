//! Results of commands as codes: a name for JSON and an exit status, so that programs do not interpret sentences.

use std::fmt;

use crate::source::ConnectionLost;
use anyhow::Error;

/// Declares the codes: name in JSON, exit status, meaning.
macro_rules! codes {
    ($($code:ident $name:literal $status:literal $meaning:literal;)*) => {
        /// Result of a command that controls or observes a gripper.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum ResultCode {
            $(#[doc = $meaning] $code,)*
        }

        impl ResultCode {
            /// All codes.
            pub const ALL: &[Self] = &[$(Self::$code,)*];

            /// Name in JSON.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$code => $name,)* }
            }

            /// Exit status.
            pub const fn status(self) -> u8 {
                match self { $(Self::$code => $status,)* }
            }

            /// Meaning, for documents.
            pub const fn meaning(self) -> &'static str {
                match self { $(Self::$code => $meaning,)* }
            }
        }

        /// The codes as lines of `--help`.
        pub const HELP: &str = concat!(
            "Exit status, and code of the result in JSON:\n",
            $("  ", $status, " ", $name, ": ", $meaning, "\n",)*
        );
    };
}

codes! {
    Reached "reached" 0 "the set-point was reached, and held for the given time";
    Failed "failed" 1 "any other error";
    NoObject "no_object" 10 "the fingers met, or closed beyond --width, without an object";
    ObjectLost "object_lost" 11 "the force fell: the object is no longer between the fingers";
    Slipped "slipped" 12 "held until the end, but the object slipped meanwhile";
    TooSoft "too_soft" 13 "contact, but the force was not reached in time";
    Contact "contact" 14 "the fingers met an obstacle before the target opening";
    Refused "refused" 15 "the gripper, or this program for it, refuses the command in the present state";
    Fault "fault" 16 "a fault or an emergency stop ended the motion";
    Timeout "timeout" 17 "not reached in time, or commands arrived too late";
    ConnectionLost "connection_lost" 18 "the connection ended, or the gripper is silent";
    WrongWidth "wrong_width" 19 "the object is wider than --width";
    ReferenceEnded "reference_ended" 20 "the reference of a recording ended before it";
    Interrupted "interrupted" 130 "Ctrl-C or SIGTERM before the end";
}

impl ResultCode {
    /// Code of an error.
    pub fn of(error: &Error) -> Self {
        match error.downcast_ref::<Failure>() {
            Some(failure) => failure.code,
            None if error.is::<ConnectionLost>() => Self::ConnectionLost,
            None => Self::Failed,
        }
    }

    /// Error with this code.
    pub fn error(self, text: impl Into<String>) -> Error {
        Failure { code: self, text: text.into() }.into()
    }
}

/// An error with its code.
#[derive(Debug)]
struct Failure {
    code: ResultCode,
    text: String,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl std::error::Error for Failure {}

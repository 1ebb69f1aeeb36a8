//! Codes of the requests of one session: which counters its owner uses next, and how many codes are checked.
//!
//! A counter that is due comes from the owner: others guess one of [`DUE`] among 2^13
//! ([`SessionMac::following`]). Its authentication is kept until its request arrives, for [`MAX_TRIES`] requests; one that
//! repeats its counter does not replace it. All others, of owners with counters of their own choice or after many lost
//! messages, are checked at a limited rate on each line. So a flood of forged frames delays no request of the owner, costs
//! little time, and has a limited number of guesses: [`MAX_TRIES`] for each message of the owner, and [`MAX_CODES`] in
//! [`CODE_WINDOW_MS`].

use crate::protocol::authentication::{COUNTER_MASK, SessionMac, next_counter};
use crate::protocol::frame_id;
use crate::protocol::messages::{Authentication, Message};

/// Counters that are due: so many messages in a row, less one, may be lost without a check of the limited ones.
const DUE: usize = 4;
/// Requests that are tried with an authentication whose counter is due.
const MAX_TRIES: u8 = 8;
/// Other codes that are checked in [`CODE_WINDOW_MS`] on a line.
const MAX_CODES: u8 = 2;
const CODE_WINDOW_MS: u64 = 10;

/// Codes on a line.
#[derive(Clone, Copy, Debug)]
pub struct LineCodes {
    /// Latest authentication that was not due and that no request has used.
    pub latest: Option<Authentication>,
    /// Checked codes in the present window, and its begin.
    checked: (u8, u64),
}

/// Result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CodeCheck {
    /// The code is that of the request: its counter counts as used.
    Valid,
    /// It is not, or may not be checked now.
    Invalid,
    /// No authentication precedes the request.
    Missing,
}

/// Counters that are due, of the session and of an answer to the challenge ([`super::Session::due_counters`]).
#[derive(Clone, Copy, Debug)]
pub struct DueCounters(pub(super) [[u32; DUE]; 2]);

impl DueCounters {
    /// Requests of the line after an authentication with such a counter that are tried with it.
    pub const REQUESTS: u8 = MAX_TRIES;
    /// None.
    pub const NONE: Self = Self([[u32::MAX; DUE]; 2]);

    /// Whether one of them is this one, as transmitted.
    pub fn contains(&self, counter: u32) -> bool {
        self.0.as_flattened().contains(&counter)
    }
}

/// Codes and counters of a session.
#[derive(Clone, Debug)]
pub struct SessionCodes {
    mac: SessionMac,
    /// Counter of the last valid request.
    last: u64,
    /// Those that the owner uses next, as transmitted.
    due: [u32; DUE],
    pending: Option<Pending>,
}

/// An authentication with a counter that is due.
#[derive(Clone, Copy, Debug)]
struct Pending {
    source: u8,
    authentication: Authentication,
    tries: u8,
}

impl LineCodes {
    /// Nothing received.
    pub const NEW: Self = Self { latest: None, checked: (0, 0) };

    /// Whether another code may be checked now.
    fn may_check(&mut self, now_ms: u64) -> bool {
        let (count, begun_ms) = &mut self.checked;
        if now_ms.saturating_sub(*begun_ms) >= CODE_WINDOW_MS {
            (*count, *begun_ms) = (0, now_ms);
        }
        *count = count.saturating_add(1);
        *count <= MAX_CODES
    }
}

impl SessionCodes {
    /// Before the first request.
    pub fn new(mac: SessionMac) -> Self {
        let mut codes = Self { mac, last: 0, due: [0; DUE], pending: None };
        codes.advance(0);
        codes
    }

    /// Computes the codes.
    pub const fn mac(&self) -> &SessionMac {
        &self.mac
    }

    /// The counters that are due, as transmitted.
    pub const fn due(&self) -> [u32; DUE] {
        self.due
    }

    /// Keeps an authentication whose counter is due; false if it is not, or if that counter is there already.
    pub fn expect(&mut self, source: u8, authentication: &Authentication) -> bool {
        let is_new = self.pending.as_ref().is_none_or(|pending| {
            pending.source != source || pending.authentication.counter != authentication.counter
        });
        let is_due = is_new && self.due.contains(&authentication.counter);
        if is_due {
            self.pending = Some(Pending { source, authentication: *authentication, tries: 0 });
        }
        is_due
    }

    /// Checks a request by the authentication that is due, then by the latest other one of the line, which is used up.
    pub fn check(
        &mut self,
        now_ms: u64,
        (source, line): (u8, &mut LineCodes),
        node: u16,
        request: &Message,
    ) -> CodeCheck {
        let mut result = CodeCheck::Missing;
        if let Some(pending) = self.pending.as_mut().filter(|pending| pending.source == source) {
            pending.tries = pending.tries.saturating_add(1);
            let Pending { authentication, tries, .. } = *pending;
            if tries >= MAX_TRIES {
                self.pending = None;
            }
            result = self.check_code(node, request, &authentication);
        }
        if result != CodeCheck::Valid
            && let Some(authentication) = line.latest.take()
        {
            let may_check = line.may_check(now_ms);
            result = CodeCheck::Invalid;
            if may_check {
                result = self.check_code(node, request, &authentication);
            }
        }
        result
    }

    fn check_code(
        &mut self,
        node: u16,
        request: &Message,
        authentication: &Authentication,
    ) -> CodeCheck {
        let counter = next_counter(self.last, authentication.counter);
        let id = frame_id(node, request.number());
        if !self.mac.is_valid(counter, id, request.to_bytes(), authentication.tag()) {
            return CodeCheck::Invalid;
        }
        self.advance(counter);
        CodeCheck::Valid
    }

    /// A valid request had this counter.
    fn advance(&mut self, counter: u64) {
        self.last = counter;
        self.pending = None;
        let mut next = counter;
        for due in &mut self.due {
            next = self.mac.following(next);
            *due = (next & COUNTER_MASK) as u32;
        }
    }
}

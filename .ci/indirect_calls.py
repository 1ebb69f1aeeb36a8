"""Targets of the calls through pointers whose target is not a constant.

Each rule names the call sites by the functions inlined there, and the targets among the functions whose address the image
stores. The first rule that matches a site applies. A rule without sites or, unless it says so, without targets is an error,
and so is a stored address of a function that is neither an entry nor a target.
"""

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Rule:
    site: str  # Pattern of the functions inlined at the call, innermost first, joined by " < ".
    targets: str  # Pattern of function names; empty: none exists.
    reason: str


TASK_POLL = r"^embassy_executor::raw::(TaskStorage<F>::poll|poll_exited)$"

RULES = (
    Rule(
        r"\bembassy_executor::raw::SyncExecutor::poll\b",
        TASK_POLL,
        "An executor polls the tasks spawned on it.",
    ),
    Rule(
        r"\bfirmware::model::encoding::",
        r"^core::ops::function::FnOnce::call_once\{\{vtable\.shim\}\}$"
        r"|^firmware::tasks::calibration::load_calibration::\{\{closure\}\}::\{\{closure\}\}$"
        r"|^firmware::model::(integrity|encoding)::\w+::\{\{closure\}\}$",
        "The encoding of a calibration reads and visits words through closures.",
    ),
    Rule(
        r"\bfirmware::tasks::scrub::",
        r"^<T as firmware::model::integrity::Scrub>::scrub$",
        "The task checks each of the tables that it is given.",
    ),
    Rule(
        r"\bdefmt_rtt::channel::Channel::write_all\b",
        r"^defmt_rtt::channel::Channel::(blocking|nonblocking)_write$",
        "The log waits for a debugger or not.",
    ),
    Rule(
        r"\bembassy_sync::channel::SendDynamic|^embassy_stm32::can::\w+::RxMode::on_interrupt$",
        "",
        "Buffered CAN is not used, and the image has no implementation of its queues.",
    ),
    Rule(
        r"\bcore::task::wake::Waker\b|^embassy_sync::signal::Signal<M,T>::poll_wait\b",
        r"^embassy_executor::raw::waker::(clone|wake|drop)$",
        "All wakers are those of embassy-executor: no other table of waker functions is in the image.",
    ),
)
# Stored addresses of functions that are never called through them.
NEVER_CALLED = (
    (
        r"^embassy_stm32::_generated::interrupt::typelevel::Interrupt::pend$",
        "The CAN driver's `tx_waker`, which only buffered CAN calls.",
    ),
)


def find(frames):
    """The rule for a call site, or None."""
    text = " < ".join(name for name, _, _ in frames)
    return next((rule for rule in RULES if re.search(rule.site, text)), None)

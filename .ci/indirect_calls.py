"""Targets of the calls through pointers whose target is not a constant.

Each rule names the call sites by the functions inlined there, and the targets among the functions whose address the image
stores. The first rule that matches a site applies. A rule without sites or, unless it says so, without targets is an error,
and so is a stored address of a function that is neither an entry nor a target.
"""

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Rule:
    site: str  # Pattern of the places of the functions inlined at the call, innermost first, joined by " < ".
    targets: str  # Pattern of the places of functions; empty: none exists.
    reason: str


TASK_POLL = r"^embassy-executor/src/raw/mod\.rs::poll(_exited)?$"

RULES = (
    Rule(
        r"^embassy-executor/src/raw/mod\.rs::poll < embassy-executor/src/raw/run_queue\.rs::dequeue_all\b",
        TASK_POLL,
        "An executor polls the tasks spawned on it.",
    ),
    Rule(
        r"^firmware/src/model/encoding\.rs::(bytes|word|visit)\b",
        r"^core/src/ops/function\.rs::call_once$|^firmware/src/tasks/calibration\.rs::load_calibration$"
        r"|^firmware/src/model/(integrity/mod\.rs::update|encoding\.rs::word_count)$",
        "The encoding of a calibration reads and visits words through closures.",
    ),
    Rule(
        r"^firmware/src/tasks/scrub\.rs::",
        r"^firmware/src/model/integrity/mod\.rs::scrub$",
        "The task checks each of the tables that it is given.",
    ),
    Rule(
        r"^(embassy-sync/src/channel\.rs::try_(send|receive) < )?embassy-stm32/src/can/fdcan\.rs::on_interrupt\b",
        "",
        "Buffered CAN is not used, and the image has no implementation of its queues.",
    ),
    Rule(
        r"^core/src/task/wake\.rs::(clone|wake|wake_by_ref|drop)\b|^embassy-sync/src/signal\.rs::poll_wait\b",
        r"^embassy-executor/src/raw/waker\.rs::(clone|wake|drop)$",
        "All wakers are those of embassy-executor: no other table of waker functions is in the image.",
    ),
)
# Stored addresses of functions that are never called through them.
NEVER_CALLED = (
    (
        r"^embassy-hal-internal/src/interrupt\.rs::pend$",
        "The CAN driver's `tx_waker`, which only buffered CAN calls.",
    ),
)


def find(frames):
    """The rule for a call site, or None."""
    text = " < ".join(frame.place for frame in frames)
    return next((rule for rule in RULES if re.search(rule.site, text)), None)

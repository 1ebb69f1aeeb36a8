#!/usr/bin/env python3
"""Reads the golden frames through the .dbc with cantools, as a user's tool does, and writes them back; runs the example of
firmware/SECURITY.md on a session that the gripper's own code has accepted.
"""

import csv
import sys
from pathlib import Path

import cantools
from pytest import approx

ROOT = Path(__file__).resolve().parent.parent
# Far below the smallest count, 0.01, and far above the rounding of a double.
CLOSE = 1e-9


def rows_of(file):
    with open(ROOT / "tests/data" / file, newline="") as text:
        return list(csv.DictReader(text))


def stated_values(row):
    """The values that a row states, by signal."""
    return {name: float(value) for name, value in (field.split("=") for field in row["fields"].split())}


def comparisons(bus, row):
    """What cantools reads and writes, and what the row states."""
    message, stated, frame = bus.get_message_by_name(row["message"]), stated_values(row), bytes.fromhex(row["bytes"])
    yield "identifier", message.frame_id, int(row["identifier"], 16)
    yield "values", message.decode(frame, decode_choices=False), approx(stated, rel=0, abs=CLOSE)
    # Sees the bits that belong to no signal, too.
    yield "bytes", message.encode(stated, scaling=True), frame


def session_comparisons(bus):
    """What the documented example computes, and what the gripper's code does."""
    text, example, rows = (ROOT / "firmware/SECURITY.md").read_text(), {}, rows_of("golden_session.csv")
    exec(text.split("```python\n")[1].split("```")[0], example)
    reply = bus.decode_message("ServiceReply", bytes.fromhex(rows[0]["reply"]))
    session = example["Session"](bus, bytes.fromhex(rows[0]["key"]), example["challenge"](reply))
    for row in rows:
        for name, value in zip(("authentication", "message"), session.sealed(row["name"], **stated_values(row))):
            yield f"session, {row['name']}: {name}", value[1], bytes.fromhex(row[name])


bus, rows = cantools.database.load_file(ROOT / "firmware/magpie.dbc"), rows_of("golden_frames.csv")
pairs = [(f"{row['message']} {row['case']}: {what}", *pair) for row in rows for what, *pair in comparisons(bus, row)]
wrong = [(what, *pair) for what, *pair in [*pairs, *session_comparisons(bus)] if pair[0] != pair[1]]
for what, found, stated in wrong:
    print(f"{what} {found} instead of {stated}", file=sys.stderr)
print(f"{len(rows)} frames, {sum(len(stated_values(row)) for row in rows)} signals, {len(wrong)} comparisons failed")
sys.exit(bool(wrong))

#!/usr/bin/env python3
"""Reads the golden frames through the .dbc with cantools, as a user's tool does, and writes them back; runs the example of
firmware/SECURITY.md on a session that the gripper's own code has accepted.
"""

import csv
import sys
from pathlib import Path

import cantools

ROOT = Path(__file__).resolve().parent.parent
# Far below the smallest count, 0.01, and far above the rounding of a double.
CLOSE = 1e-9


def rows_of(file):
    with open(ROOT / "tests/data" / file, newline="") as text:
        return list(csv.DictReader(text))


def stated_values(row):
    """The values that a row states, by signal."""
    return {name: float(value) for name, value in (field.split("=") for field in row["fields"].split())}


def faults(bus, row):
    """What cantools reads otherwise than the row states."""
    message = bus.get_message_by_name(row["message"])
    if message.frame_id != int(row["identifier"], 16):
        yield f"identifier {message.frame_id:03X} instead of {row['identifier']}"
    read = message.decode(bytes.fromhex(row["bytes"]), decode_choices=False)
    stated = stated_values(row)
    if read.keys() != stated.keys():
        yield f"signals {sorted(read)} instead of {sorted(stated)}"
    for name in read.keys() & stated.keys():
        if not abs(float(read[name]) - stated[name]) < CLOSE:
            yield f"{name} = {read[name]} instead of {stated[name]}"
    # Sees the bits that belong to no signal, too.
    written = message.encode(stated, scaling=True)
    if written != bytes.fromhex(row["bytes"]):
        yield f"written as {written.hex(' ').upper()} instead of {row['bytes']}"


def session_faults(bus):
    """What the documented example computes otherwise than the gripper's code does."""
    text, example, rows = (ROOT / "firmware/SECURITY.md").read_text(), {}, rows_of("golden_session.csv")
    exec(text.split("```python\n")[1].split("```")[0], example)
    reply = bus.decode_message("ServiceReply", bytes.fromhex(rows[0]["reply"]))
    session = example["Session"](bus, bytes.fromhex(rows[0]["key"]), example["challenge"](reply))
    for row in rows:
        for name, value in zip(("authentication", "message"), session.sealed(row["name"], **stated_values(row))):
            if value[1] != bytes.fromhex(row[name]):
                yield f"session, {row['name']}: {name} {value[1].hex(' ')} instead of {row[name]}"


def main():
    bus, rows = cantools.database.load_file(ROOT / "firmware/magpie.dbc"), rows_of("golden_frames.csv")
    wrong = [f"{row['message']} {row['case']}: {fault}" for row in rows for fault in faults(bus, row)]
    absent = {message.name for message in bus.messages} - {row["message"] for row in rows}
    wrong += [f"no frame of {name}" for name in sorted(absent)] + list(session_faults(bus))
    for line in wrong:
        print(line, file=sys.stderr)
    signals = sum(len(stated_values(row)) for row in rows)
    print(f"{len(rows)} frames, {signals} signals, {len(wrong)} read otherwise than stated")
    sys.exit(bool(wrong))


main()

"""Where execution of the firmware begins: the vector table, and the tasks that the executors poll.

Tasks, the executor of each, and the priorities of interrupts are read from the sources of the board.
"""

import re
from collections import namedtuple
from pathlib import Path

from elf import without_types

BOARD = Path(__file__).parent.parent / "firmware/src/board/nucleo_g474"
# Task that `main` becomes.
MAIN = "main"
# Words of the vector table, and the priorities of those without a settable one: reset, non-maskable, hard fault.
RESET, FIXED = 1, {1: -3, 2: -2, 3: -1}
# `sync::lower_all_interrupts`.
DEFAULT_PRIORITY = 1
THREAD = "thread mode"
THREAD_EXECUTOR = r"^embassy-executor/src/platform/cortex_m\.rs::run$"

Handler = namedtuple("Handler", "address, name, priority")


def vectors(elf):
    """Each handler in the vector table once, at its most urgent priority, and the address of the reset handler."""
    section = elf.sections[".vector_table"]
    names = {}
    for name, address in elf.addresses.items():
        names.setdefault(address, set()).add(name)
    urgent, found = priorities(), {}
    reset = elf.read(section.address + 4 * RESET, 4) & ~1
    for word in range(RESET + 1, section.size // 4):
        address = elf.read(section.address + 4 * word, 4) & ~1
        if address in (0, reset):
            continue
        all_names = names.get(address, {f"{address:#x}"})
        priority = FIXED.get(word, min(urgent.get(name, DEFAULT_PRIORITY) for name in all_names))
        if address not in found or priority < found[address].priority:
            name = min(all_names & urgent.keys() or {name for name in all_names if name.isupper()} or all_names)
            found[address] = Handler(address, name, priority)
    return list(found.values()), reset


def priorities():
    """Interrupt to its priority, where the board's sources set one."""
    found = {}
    for file in BOARD.glob("*.rs"):
        text = file.read_text()
        constants = dict(re.findall(r"const (\w+): Priority = Priority::P(\d+);", text))
        for interrupt, value in re.findall(r"interrupt::(\w+)\.set_priority\(([\w:]+)\)", text):
            found[interrupt] = int(constants.get(value, value.removeprefix("Priority::P")))
    return found


def handler_stack():
    """Bytes of stack that the fault handler has at least."""
    return int(re.search(r"const HANDLER_STACK: usize = (\d+);", (BOARD / "crash.rs").read_text())[1])


def spawned():
    """Task to the interrupt of its executor, or thread mode."""
    text = (BOARD / "tasks.rs").read_text()
    declared = set(re.findall(r"#\[embassy_executor::task\]\s*(?:pub )?async fn (\w+)", text))
    interrupts = dict(re.findall(r"let (\w+) = \w+\.start\(interrupt::(\w+)\);", text))
    spawns = re.findall(r"\b(\w+)\.spawn\(once\((\w+)\(", text)
    found = {task: interrupts.get(spawner, THREAD) for spawner, task in spawns}
    if declared != found.keys():
        raise ValueError(f"tasks declared and spawned differ: {sorted(declared ^ found.keys())}")
    return found | {MAIN: THREAD}


def tasks(elf, graph, polls):
    """Task to its poll function, by the task's body that is inlined or called there."""
    calls = {start: graph.functions[start].calls for start in polls}
    frames = elf.frames(site for found in calls.values() for site in found)
    tasks_of = {}
    for start, found in calls.items():
        texts = {frame.name for site in found for frame in frames[site]}
        texts |= {elf.names[call.target] for call in found.values() if call.target in elf.names}
        matches = (re.search(r"::__(\w+)_task::", without_types(text)) for text in texts)
        names = {match[1] for match in matches if match}
        if len(names) != 1:
            raise ValueError(f"the poll function at {start:#x} belongs to the tasks {sorted(names)}")
        name = names.pop()
        tasks_of[MAIN if name == "__embassy_main" else name] = start
    return tasks_of

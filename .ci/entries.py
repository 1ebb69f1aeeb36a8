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
    section, urgent, found = elf.sections[".vector_table"], priorities(), {}
    _, reset, *words = (elf.read(section.address + 4 * word, 4) & ~1 for word in range(section.size // 4))
    for word, address in enumerate(words, start=RESET + 1):
        if address in (0, reset):
            continue
        names = {name for name, other in elf.addresses.items() if other == address} or {f"{address:#x}"}
        priority = FIXED.get(word, min(urgent.get(name, DEFAULT_PRIORITY) for name in names))
        if address not in found or priority < found[address].priority:
            name = min(names & urgent.keys() or {name for name in names if name.isupper()} or names)
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
    tasks_of = {}
    for start in polls:
        calls = graph.functions[start].calls
        texts = {frame.name for frames in elf.frames(calls).values() for frame in frames}
        texts |= {elf.names[call.target] for call in calls.values() if call.target in elf.names}
        names = set(re.findall(r"::__(\w+)_task::", "\n".join(map(without_types, texts))))
        if len(names) != 1:
            raise ValueError(f"the poll function at {start:#x} belongs to the tasks {sorted(names)}")
        name = names.pop()
        tasks_of[MAIN if name == "__embassy_main" else name] = start
    return tasks_of

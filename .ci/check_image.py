"""Checks a firmware image and prints its sizes, which the linker bounds: check_image.py ELF [PROFILE]

- The vector table is at the start of flash and points into RAM and flash.
- The stack is at the start of RAM, below the statics; a fault of the core and the non-maskable interrupt
  end in the firmware's own handlers; the record of a crash is in memory that the start leaves alone.
- From every handler of the vector table and every task no panic and no trap is reachable except the listed ones, and every
  call through a pointer has known targets (`image_rules.toml`); from the models and the motor's interrupts none at all.
- The deepest stack of all levels of priority, nested, fits, and is no less than the measured one in PROFILE, the output of
  `magpie dev emulate --json`.
- The kernels and the motor's interrupts are in the memory next to the core; the kernels' code, with the tables
  of the activations, and their stack stay within bounds.

`check_image.py --kernels ELF` looks at the kernels alone, wherever they are. `.ci/python` runs it with its packages.
"""

import gc
import json
import sys
import tomllib
from itertools import pairwise
from pathlib import Path

import entries
from call_graph import CallGraph
from elf import Elf
from panic_freedom import EXCEPTION_FRAME, Image, find_panics, matches, path

RULES = Path(__file__).parent / "image_rules.toml"
# The first bank: the other has calibrations and parameters, and is erased and written while the image runs. The linker refuses
# more.
FLASH = range(0x0800_0000, 0x0804_0000)
STACK = range(0x2000_0000, 0x2000_3800)
RAM = range(0x2000_3800, 0x2001_8000)
CCM = range(0x1000_0000, 0x1000_8000)
ENTRY = "firmware::estimator::estimate_all"
DETECTOR = "firmware::estimator::disturbance::DisturbanceDetector::update"
# The motor's interrupts: the control's inner tick, and its outer one.
DRIVE = ("ADC1_2", "CORDIC")
# Absent from an image without networks.
NETWORKS = "firmware::estimator::gru::apply"
TABLE = "firmware::model::kernel::activation::TABLE"
COPY = "firmware::model::kernel::copy_to_ccm"
RECORD = "firmware::board::selected::crash::RECORD"
# Most bytes: of a recurrent network's kernel with its tables, of a kernel's stack, and of the stack from
# an entry of the models or the motor down.
CODE_LIMIT, KERNEL_STACK_LIMIT, STACK_LIMIT = 7 * 1024, 200, 1280


def require(elf, good, message):
    if not good:
        sys.exit(f"{elf.path}: {message}")


def check_start(elf):
    """The vector table, and what happens in a crash."""
    section = elf.sections.get(".vector_table")
    is_placed = section is not None and section.address == FLASH.start and section.size >= 8
    require(elf, is_placed, f"no vector table at {FLASH.start:#010x}: the linker's arguments were lost")
    stack, reset = (elf.read(section.address + offset, 4) for offset in (0, 4))
    print(f"vector table at {section.address:#010x}: stack {stack:#010x}, reset {reset:#010x}")
    require(elf, stack == STACK.stop and reset in FLASH and reset % 2, "vectors make no sense")
    places = elf.addresses
    for handler, default in (("HardFault", "HardFault_"), ("NonMaskableInt", "DefaultHandler_")):
        is_own = places.get(handler) not in (None, places.get(default))
        require(elf, is_own, f"{handler} is not the firmware's own: a crash would leave no record")
    section = elf.sections.get(".uninit")
    is_kept = section is not None and 0 <= places.get(RECORD, 0) - section.address < section.size
    require(elf, is_kept, f"{RECORD} is not in .uninit: a reset would clear it")


def check_kernels(elf, graph=None):
    graph = graph or CallGraph(elf)
    section = elf.sections.get(".ccm")
    is_copied = section is not None and section.size and section.load != section.address
    require(elf, is_copied, "no kernels in .ccm: the linker script was lost")
    require(elf, COPY in elf.addresses, "nobody copies the kernels out of flash")
    table = next((size for name, size in elf.sizes.items() if name.startswith(TABLE)), 0)
    stop = section.address + section.size
    for start, end in pairwise([*(start for start in elf.starts if section.address <= start < stop), stop]):
        name, code, used = elf.names[start], end - start, graph.functions[start].depth
        if "kernel" not in name:
            continue
        tables = table if "gru" in name and "finish" in name else 0
        print(f"{name}: {code} bytes of code, {tables} of tables, {used} of stack")
        require(elf, code + tables <= CODE_LIMIT, f"{name} and its tables take more than {CODE_LIMIT} bytes")
        require(elf, used <= KERNEL_STACK_LIMIT, f"{name} takes more than {KERNEL_STACK_LIMIT} bytes of stack")


def check_entries(image):
    """The entries of the image: name to function, its handlers, and task to poll function."""
    handlers, reset = entries.vectors(image.elf)
    polls = [start for start in image.polls if image.elf.places[start].endswith("::poll")]
    tasks, spawned = entries.tasks(image.elf, image.graph, polls), entries.spawned()
    is_known = tasks.keys() == spawned.keys() and len(tasks) == len(polls)
    require(image.elf, is_known, f"{len(polls)} polls of tasks {sorted(tasks)}, but the sources have {sorted(spawned)}")
    found = {"Reset": reset, "panic handler": image.handler[0]}
    found |= {handler.name: handler.address for handler in handlers}
    return found | {f"task {task}": start for task, start in tasks.items()}, handlers, tasks


def check_panics(image, places, rules):
    """Returns the functions of the models and the motor's interrupts."""
    elf = image.elf
    panics, reached = find_panics(image, places)
    unused, refused = list(rules), {}
    for panic in panics:
        for rule in rules:
            if matches(rule["patterns"], panic.text) and panic.entries <= set(rule.get("entries", panic.entries)):
                unused = [other for other in unused if other is not rule]
                break
        else:
            refused.setdefault(panic.text, panic)
    problems = sorted(set(image.problems)) + [f"no panic is {rule['patterns']}: remove the rule" for rule in unused]
    for start in reached:
        problems += [f"{elf.names[start]}: {problem}" for problem in sorted(image.graph.functions[start].problems)]
    for panic in refused.values():
        print(f"at {panic.site:#010x}, line {panic.frames[0].line}, {panic.text}")
        print("    path: " + " > ".join(path(image, places, panic)))
    counts = f"{len(refused)} panics or traps are reachable, and {len(problems)} other problems"
    require(elf, not refused and not problems, "\n".join([counts, *problems]))
    kernels = {}
    for entry in (ENTRY, DETECTOR, NETWORKS, *DRIVE):
        found = {start: name for start, name in elf.names.items() if name.startswith(entry)}
        require(elf, found or entry == NETWORKS, f"{entry} is not in the image")
        kernels |= found
    for start, name in kernels.items():
        require(elf, not any(map(image.panics, image.reach(start))), f"a panic is reachable from {name}")
    print(f"{len(places)} entries reach {len(reached)} functions, {image.indirect} calls through pointers and {len(panics)} "
          f"branches to a panic, all of which {len(rules)} rules exclude; none from the models and the motor's interrupts")
    return kernels


def check_stack(image, handlers, tasks, reset, kernels, profile):
    elf, executors = image.elf, {}
    for task, level in entries.spawned().items():
        executors.setdefault(level, set()).add(tasks[task])
    exited = image.polls - set(tasks.values())
    levels_of = {handler.address: handler.name for handler in handlers}
    levels_of |= dict.fromkeys(image.matching([entries.THREAD_EXECUTOR]), entries.THREAD)
    stack = image.stacks(lambda start: exited | executors.get(levels_of.get(start), image.polls))
    require(elf, not image.problems, "; ".join(image.problems))
    total = stack[reset]
    print(f"stack: {total} bytes in thread mode", end="")
    for priority in sorted({handler.priority for handler in handlers if handler.priority >= 0}, reverse=True):
        deepest, name = max((stack[one.address], one.name) for one in handlers if one.priority == priority)
        print(f", {deepest} at priority {priority} ({name})", end="")
        total += deepest + EXCEPTION_FRAME
    fatal = {handler.name: stack[handler.address] for handler in handlers if handler.priority < 0}
    total += fatal["NonMaskableInt"] + EXCEPTION_FRAME
    print(f", {fatal['NonMaskableInt']} non-maskable; with the frames of the exceptions {total} of {len(STACK)} bytes")
    if profile:
        used = json.loads(Path(profile).read_text())["profile"]["stack"]["used"]
        print(f"{used} bytes of stack measured")
        require(elf, used <= total, "the measured stack is above the bound")
    require(elf, total <= len(STACK), "the stack is too short")
    limits = [("HardFault", fatal["HardFault"], entries.handler_stack())]
    for name, used, limit in limits + [(name, stack[start], STACK_LIMIT) for start, name in kernels.items()]:
        require(elf, used <= limit, f"{used} bytes of stack from {name} down, more than {limit}")


def main(path_, profile=None):
    elf, rules = Elf(path_), tomllib.loads(RULES.read_text())
    check_start(elf)
    image = Image(elf, rules["calls"])
    places, handlers, tasks = check_entries(image)
    kernels = check_panics(image, places, rules["panics"])
    check_stack(image, handlers, tasks, places["Reset"], kernels, profile)
    is_near = elf.sections[".ccm"].address in CCM and all(elf.addresses[name] in CCM for name in DRIVE)
    require(elf, is_near, "the kernels or the motor's interrupts are not in the memory next to the core")
    check_kernels(elf, image.graph)
    sections = elf.sections.values()
    flash = sum(len(section.contents) for section in sections if section.load in FLASH)
    ram, ccm = (sum(section.size for section in sections if section.address in memory) for memory in (RAM, CCM))
    print(f"flash {flash} of {len(FLASH)} bytes, RAM {ram} of {len(RAM)} bytes and {len(STACK)} of stack, "
          f"{ccm} of {len(CCM)} bytes next to the core")


if __name__ == "__main__":
    # A quarter of the time, for nothing: what is built here stays until the end.
    gc.disable()
    if sys.argv[1] == "--kernels":
        check_kernels(Elf(sys.argv[2]))
    else:
        main(*sys.argv[1:])

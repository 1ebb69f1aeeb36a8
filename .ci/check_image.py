"""Checks a firmware image and prints its sizes: check_image.py ELF

- The vector table stands at the start of flash and points into RAM and flash.
- From the model's entry no panic is reachable, and no call whose target is unknown.

Needs arm-none-eabi-objdump (Debian: binutils-arm-none-eabi).
"""

import re
import struct
import subprocess
import sys

FLASH = range(0x0800_0000, 0x0808_0000)
RAM = range(0x2000_0000, 0x2001_8001)
ENTRY = "firmware::force::estimate_all"


def objdump(*arguments):
    run = ["arm-none-eabi-objdump", *arguments]
    return subprocess.run(run, check=True, capture_output=True, text=True).stdout


def sections(elf):
    """Name to (size, address in memory, address in flash)."""
    row = re.compile(r"^\s*\d+ (\S+)\s+([0-9a-f]{8})\s+([0-9a-f]{8})\s+([0-9a-f]{8})")
    found = (row.match(line) for line in objdump("-h", elf).splitlines())
    return {m[1]: tuple(int(m[i], 16) for i in (2, 3, 4)) for m in found if m}


def check_vectors(elf, sections):
    size, address, _ = sections.get(".vector_table", (0, 0, 0))
    if address != FLASH.start or size < 8:
        sys.exit(f"{elf}: no vector table at {FLASH.start:#010x}: the linker's arguments were lost")
    lines = objdump("-s", "-j", ".vector_table", elf).splitlines()
    words = next(line for line in lines if line.strip().startswith("8000000")).split()[1:3]
    stack, reset = (struct.unpack("<I", bytes.fromhex(word))[0] for word in words)
    if stack not in RAM or reset not in FLASH or reset % 2 == 0:
        sys.exit(f"{elf}: vectors make no sense: stack {stack:#x}, reset {reset:#x}")
    print(f"vector table at {address:#010x}: stack {stack:#010x}, reset {reset:#010x}")


def functions(elf):
    """Name to the set of names that it calls or jumps to; None stands for an unknown target."""
    graph, name = {}, None
    head = re.compile(r"^[0-9a-f]+ <(.+)>:$")
    branch = re.compile(r"\t(?:bl|blx|b|b\.w|b\.n|bx|cbz|cbnz|b[a-z]{2}(?:\.[nw])?)\t(.*)$")
    for line in objdump("-d", "--demangle", elf).splitlines():
        if match := head.match(line):
            name = match[1]
            graph.setdefault(name, set())
        elif name and (match := branch.search(line)):
            target = re.search(r"<(.+?)(?:\+0x[0-9a-f]+)?>", match[1])
            if target:
                graph[name].add(target[1])
            elif match[1].strip() != "lr":
                graph[name].add(None)
    return graph


def check_no_panic(elf):
    graph = functions(elf)
    starts = [name for name in graph if name.startswith(ENTRY)]
    if not starts:
        sys.exit(f"{elf}: {ENTRY} is not in the image")
    reached, waiting = set(), starts
    while waiting:
        name = waiting.pop()
        if name in reached:
            continue
        reached.add(name)
        if "panic" in name or "unwrap_failed" in name or "expect_failed" in name:
            sys.exit(f"{elf}: {name} is reachable from {ENTRY}")
        for target in graph.get(name, ()):
            if target is None:
                sys.exit(f"{elf}: {name} calls through a pointer: what it reaches is not known")
            waiting.append(target)
    print(f"no panic among the {len(reached)} functions reachable from {ENTRY}")


def main(elf):
    found = sections(elf)
    check_vectors(elf, found)
    check_no_panic(elf)
    flash = sum(size for name, (size, _, load) in found.items() if load in FLASH and name != ".bss")
    ram = sum(size for size, address, _ in found.values() if address in RAM)
    print(f"flash {flash} of {len(FLASH)} bytes, RAM {ram} of {len(RAM) - 1} bytes before the stack")


main(*sys.argv[1:])

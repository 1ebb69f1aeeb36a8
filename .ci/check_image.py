"""Checks a firmware image and prints its sizes: check_image.py ELF

- The vector table stands at the start of flash and points into RAM and flash.
- From the model's entry no panic is reachable, and no call whose target is unknown.

Needs arm-none-eabi-objdump (Debian: binutils-arm-none-eabi).
"""

import bisect
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
    """Address of each function to its name and the addresses that it calls or jumps to.

    Names with templates in them cannot be told apart in the text of a branch, addresses can. None
    stands for an unknown target.
    """
    found, address = {}, None
    head = re.compile(r"^([0-9a-f]+) <(.+)>:$")
    condition = "eq|ne|cs|cc|hs|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le"
    branch = re.compile(rf"\t(?:bl|blx|bx|cbn?z|b(?:{condition})?)(?:\.[nw])?\t(.*)$")
    indirect = re.compile(r"\t(?:mov|ldr|pop)(?:\.[nw])?\t(?:pc, |.*\bpc\b.*\})")
    for line in objdump("-d", "--demangle", elf).splitlines():
        if match := head.match(line):
            address = int(match[1], 16)
            found[address] = (match[2], set())
        elif address and (match := branch.search(line)):
            target = re.search(r"(?:^|, )([0-9a-f]{6,8}) <", match[1])
            if target:
                found[address][1].add(int(target[1], 16))
            elif not match[1].startswith("lr"):
                found[address][1].add(None)
        elif address and indirect.search(line) and "\tpop" not in line and "sp!" not in line:
            found[address][1].add(None)
    return found


def check_no_panic(elf):
    found = functions(elf)
    starts = sorted(found)
    waiting = [address for address, (name, _) in found.items() if name.startswith(ENTRY)]
    if not waiting:
        sys.exit(f"{elf}: {ENTRY} is not in the image")
    reached = set()
    while waiting:
        target = waiting.pop()
        if target is None:
            sys.exit(f"{elf}: a call through a pointer is reachable from {ENTRY}: where it goes is not known")
        place = bisect.bisect_right(starts, target) - 1
        if place < 0:
            sys.exit(f"{elf}: a call to {target:#x} leads out of the image")
        address = starts[place]
        if address in reached:
            continue
        reached.add(address)
        name, targets = found[address]
        if "panic" in name or "unwrap_failed" in name or "expect_failed" in name:
            sys.exit(f"{elf}: {name} is reachable from {ENTRY}")
        waiting.extend(targets)
    names = sorted(found[address][0] for address in reached)
    print(f"no panic among the {len(names)} functions reachable from {ENTRY}")


def main(elf):
    found = sections(elf)
    check_vectors(elf, found)
    check_no_panic(elf)
    flash = sum(size for name, (size, _, load) in found.items() if load in FLASH and name != ".bss")
    ram = sum(size for size, address, _ in found.values() if address in RAM)
    print(f"flash {flash} of {len(FLASH)} bytes, RAM {ram} of {len(RAM) - 1} bytes before the stack")


main(*sys.argv[1:])

"""Checks a firmware image and prints its sizes: check_image.py ELF

- The vector table is at the start of flash and points into RAM and flash.
- The stack is at the start of RAM, below the statics; a fault of the core and the non-maskable interrupt
  end in the firmware's own handlers; the record of a crash is in memory that the start leaves alone.
- From the models' entries and from the motor's interrupts no panic is reachable, and no call whose target is
  unknown; the stack of the deepest way is printed.
- The kernels and the motor's interrupts are in the memory next to the core; the kernels' code, with the tables
  of the activations, and their stack stay within bounds.
- The image takes no more flash and RAM than was asked for.

`check_image.py --kernels ELF` looks at the kernels alone, wherever they are.

Needs arm-none-eabi-objdump (Debian: binutils-arm-none-eabi).
"""

import bisect
import re
import struct
import subprocess
import sys

# Behind the image two calibrations and the parameters.
FLASH = range(0x0800_0000, 0x0805_E000)
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
# an entry down (a task's own stack and interrupts come on top; 14 KiB hold all).
CODE_LIMIT, KERNEL_STACK_LIMIT, STACK_LIMIT = 7 * 1024, 200, 1280
# Most bytes of the image: one of the two banks of flash, because the other is erased and written while it runs.
FLASH_LIMIT = 256 * 1024


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
    if stack != STACK.stop or reset not in FLASH or reset % 2 == 0:
        sys.exit(f"{elf}: vectors make no sense: stack {stack:#x}, reset {reset:#x}")
    print(f"vector table at {address:#010x}: stack {stack:#010x}, reset {reset:#010x}")


def check_crash(elf, sections):
    places = {name: address for name, address, _ in symbols(elf)}
    for handler, default in (("HardFault", "HardFault_"), ("NonMaskableInt", "DefaultHandler_")):
        if places.get(handler) in (None, places.get(default)):
            sys.exit(f"{elf}: {handler} is not the firmware's own: a crash would leave no record")
    size, start, _ = sections.get(".uninit", (0, 0, 0))
    if places.get(RECORD) not in range(start, start + size):
        sys.exit(f"{elf}: {RECORD} is not in .uninit: a reset would clear it")


def functions(elf):
    """Address of each function to its name and the addresses that it calls or jumps to.

    Names with templates in them cannot be distinguished in the text of a branch, addresses can. None
    means an unknown target. A jump to the memory next to the core is too long for a branch, and where
    a function is called often its address waits in a register: what a register holds is followed line by
    line.
    """
    found, address, held = {}, None, {}
    head = re.compile(r"^([0-9a-f]+) <(.+)>:$")
    condition = "eq|ne|cs|cc|hs|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le"
    branch = re.compile(rf"\t(?:bl|blx|bx|cbn?z|b(?:{condition})?)(?:\.[nw])?\t(.*)$")
    indirect = re.compile(r"\t(?:mov|ldr|pop)(?:\.[nw])?\t(?:pc, |[^@]*\bpc\b[^@]*\})")
    # Between functions the linker fills up with a word that reads like a branch.
    filling = re.compile(r":\td4d4\s")
    lines = objdump("-d", "--demangle", elf).splitlines()
    word = re.compile(r"^\s*([0-9a-f]+):\t[0-9a-f]{8} \t\.word\t0x([0-9a-f]{8})")
    words = {int(m[1], 16): int(m[2], 16) for m in map(word.match, lines) if m}
    for line in lines:
        if filling.search(line):
            continue
        if match := head.match(line):
            address, held = int(match[1], 16), {}
            found[address] = (plain(match[2]), set())
        elif address and (match := branch.search(line)):
            target = re.search(r"(?:^|, )([0-9a-f]{6,8}) <", match[1])
            if target:
                found[address][1].add(int(target[1], 16))
            elif match[1] in held:
                found[address][1].add(held[match[1]] & ~1)
            elif not match[1].startswith("lr"):
                found[address][1].add(None)
        elif address and indirect.search(line) and "\tpop" not in line and "sp!" not in line:
            found[address][1].add(None)
        held = held_after(line, held, words)
    return found


def plain(name):
    """A function's name in either mangling of Rust's: legacy gives `a::Type::f::h0123456789abcdef`, v0 `<a::Type>::f`."""
    return re.sub(r"^<([\w:]+)>", r"\1", re.sub(r"::h[0-9a-f]{16}$", "", name))


def held_after(line, held, words):
    """What registers hold after an instruction, where it is known: a register that another one names is
    not, unless that only reads it."""
    match = re.search(r"\t([a-z][\w.]*)\t(.*)$", line)
    if not match:
        return held
    name, operands = match[1].split(".")[0], match[2]
    if loaded := re.match(r"(\w+), \[pc, #\d+\]\s@ \(?([0-9a-f]+) <", operands):
        if name == "ldr" and int(loaded[2], 16) in words:
            return held | {loaded[1]: words[int(loaded[2], 16)]}
    if half := re.match(r"(\w+), #(\d+)", operands):
        if name == "movw":
            return held | {half[1]: int(half[2])}
        if name == "movt" and half[1] in held:
            return held | {half[1]: int(half[2]) << 16 | held[half[1]] & 0xFFFF}
    if name in ("bl", "blx"):
        gone = {"r0", "r1", "r2", "r3", "ip", "lr"}
    elif name.startswith(("str", "cmp", "tst", "cb", "push")):
        gone = set()
    elif "{" in operands:
        gone = set(held)
    else:
        gone = set(re.findall(r"\w+", operands))
    return {register: value for register, value in held.items() if register not in gone}


def stacks(elf):
    """Address of each function to the bytes that it puts on the stack itself, at the most."""
    found, address = {}, None
    head = re.compile(r"^([0-9a-f]+) <.+>:$")
    pushed = re.compile(r"\t(?:push|stmdb|vpush|vstmdb)(?:\.w)?\t(?:sp!, )?\{(.*)\}")
    taken = re.compile(r"\tsub(?:w|\.w)?\tsp, (?:sp, )?#(\d+)|\tstrd?(?:\.w)?\t.*\[sp, #-(\d+)\]!")
    for line in objdump("-d", elf).splitlines():
        if match := head.match(line):
            address = int(match[1], 16)
            found[address] = 0
        elif address and (match := pushed.search(line)) and ("push" in line or "sp!" in line):
            found[address] += sum(register_bytes(word.strip()) for word in match[1].split(","))
        elif address and (match := taken.search(line)):
            found[address] += int(match[1] or match[2])
    return found


def register_bytes(word):
    """Of a register or a range of them."""
    ends = [int(re.sub(r"\D", "", end) or 0) for end in word.split("-")]
    return (4, 8)[word.startswith("d")] * (ends[-1] - ends[0] + 1)


def symbols(elf):
    """Name, address, size of each symbol that has one."""
    row = re.compile(r"^([0-9a-f]{8}) .{7} \S+\t([0-9a-f]{8}) (.+)$")
    found = (row.match(line) for line in objdump("-t", "--demangle", elf).splitlines())
    return [(m[3].removeprefix(".hidden "), int(m[1], 16), int(m[2], 16)) for m in found if m]


def check_kernels(elf, sections):
    size, start, load = sections.get(".ccm", (0, 0, 0))
    if size == 0 or load not in FLASH:
        sys.exit(f"{elf}: no kernels in .ccm: the linker script was lost")
    if not any(plain(name) == COPY for name, _, _ in symbols(elf)):
        sys.exit(f"{elf}: nobody copies the kernels out of flash")
    table = next((size for name, _, size in symbols(elf) if name.startswith(TABLE)), 0)
    stack = stacks(elf)
    ends = sorted(address for address in functions(elf) if start <= address < start + size) + [start + size]
    names = {address: name for address, (name, _) in functions(elf).items()}
    for address, end in zip(ends, ends[1:]):
        name, bytes_, used = names[address], end - address, stack[address]
        if "kernel" not in name:
            continue
        tables = table if "gru" in name else 0
        print(f"{name}: {bytes_} bytes of code, {tables} of tables, {used} of stack")
        if bytes_ + tables > CODE_LIMIT:
            sys.exit(f"{elf}: {name} and its tables take more than {CODE_LIMIT} bytes")
        if used > KERNEL_STACK_LIMIT:
            sys.exit(f"{elf}: {name} takes more than {KERNEL_STACK_LIMIT} bytes of stack")


def check_no_panic(elf):
    found = functions(elf)
    starts = sorted(found)
    entries = [address for address, (name, _) in found.items() if name.startswith((ENTRY, DETECTOR, NETWORKS, *DRIVE))]
    waiting = list(entries)
    for entry in (ENTRY, DETECTOR, *DRIVE):
        if not any(found[address][0].startswith(entry) for address in entries):
            sys.exit(f"{elf}: {entry} is not in the image")
    reached = set()
    while waiting:
        target = waiting.pop()
        if target is None:
            sys.exit(f"{elf}: a call through a pointer is reachable from the entries: where it goes is not known")
        place = bisect.bisect_right(starts, target) - 1
        if place < 0:
            sys.exit(f"{elf}: a call to {target:#x} leads out of the image")
        address = starts[place]
        if address in reached:
            continue
        reached.add(address)
        name, targets = found[address]
        if "panic" in name or "unwrap_failed" in name or "expect_failed" in name:
            sys.exit(f"{elf}: {name} is reachable from the entries")
        waiting.extend(targets)
    print(f"no panic among the {len(reached)} functions reachable from the models' entries and the motor's interrupts")
    for entry in entries:
        name, stack = found[entry][0], deepest(entry, found, starts, stacks(elf), {})
        print(f"{stack} bytes of stack from {name} down")
        if stack > STACK_LIMIT:
            sys.exit(f"{elf}: more than {STACK_LIMIT} bytes of stack from {name} down")


def deepest(address, found, starts, stack, known):
    """Bytes of stack of a function and the deepest of those that it calls."""
    if address not in known:
        known[address] = float("inf")  # Stays so where a function calls itself.
        called = {starts[bisect.bisect_right(starts, target) - 1] for target in found[address][1]}
        below = (deepest(target, found, starts, stack, known) for target in called - {address})
        known[address] = stack[address] + max(below, default=0)
    return known[address]


def main(elf):
    found = sections(elf)
    check_vectors(elf, found)
    check_crash(elf, found)
    check_no_panic(elf)
    places = {name: address for name, address, _ in symbols(elf)}
    if found.get(".ccm", (0, 0, 0))[1] not in CCM or any(places[name] not in CCM for name in DRIVE):
        sys.exit(f"{elf}: the kernels or the motor's interrupts are not in the memory next to the core")
    check_kernels(elf, found)
    flash = sum(size for name, (size, _, load) in found.items() if load in FLASH and name != ".bss")
    ram = sum(size for size, address, _ in found.values() if address in RAM)
    ccm = sum(size for size, address, _ in found.values() if address in CCM)
    print(
        f"flash {flash} of {len(FLASH)} bytes, RAM {ram} of {len(RAM)} bytes and {len(STACK)} of stack, "
        f"{ccm} of {len(CCM)} bytes next to the core"
    )
    if flash > FLASH_LIMIT:
        sys.exit(f"{elf}: {flash} bytes of flash are more than {FLASH_LIMIT}")


if sys.argv[1] == "--kernels":
    check_kernels(sys.argv[2], sections(sys.argv[2]))
else:
    main(sys.argv[1])

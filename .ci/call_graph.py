"""Control flow of an image of Thumb-2 code: what each function calls, where it traps, and the stack it uses.

Registers are followed as constants or as offsets from the stack pointer at the function's entry, over all paths of the
function until nothing changes, so that the target of a call through a register is known where it is a constant on all
paths. A jump into the middle of a function belongs to the flow of the function that jumps.
"""

import re
from dataclasses import dataclass, field

TRAPS = {"udf", "bkpt", "svc", "hlt"}
# Their first operand is no destination.
READS = {
    "cmp", "cmn", "tst", "teq", "cbz", "cbnz", "vcmp.f32", "vcmpe.f32", "vcmp.f64", "vcmpe.f64", "msr", "vmsr", "dmb",
    "dsb", "isb", "nop", "wfe", "wfi", "sev", "clrex", "cpsid", "cpsie", "pld", "yield",
}
WORD = 0xFFFF_FFFF
# Depths of the stack at one instruction on different paths, at the most: more are a loop.
MOST_DEPTHS = 8
CLOBBERED = ("r0", "r1", "r2", "r3", "ip", "lr")


@dataclass(frozen=True)
class Offset:
    """An address on the stack, in bytes from the stack pointer at the function's entry."""

    bytes: int


@dataclass
class Call:
    site: int
    target: int | None  # None: unknown.
    depth: int
    is_tail: bool = False


@dataclass
class Function:
    start: int
    depth: int = 0  # Bytes of its own stack, at the most.
    calls: list = field(default_factory=list)
    traps: list = field(default_factory=list)
    problems: list = field(default_factory=list)
    successors: dict = field(default_factory=dict)
    returns: bool = False


class CallGraph:
    def __init__(self, elf):
        self.elf = elf
        self.never_return = set()
        self.functions = {}
        self.constants = set()  # That the code builds in registers.
        waiting = set(elf.starts)
        while waiting:
            for start in waiting:
                self.functions[start] = self.analyse(start)
            # A function that never returns ends the paths of its callers; until none more is found.
            found = {s for s, f in self.functions.items() if not self.can_return(f)} - self.never_return
            self.never_return |= found
            waiting = {s for s, f in self.functions.items() if any(call.target in found for call in f.calls)}

    def can_return(self, function):
        if function.returns:
            return True
        tails = [call.target for call in function.calls if call.is_tail]
        return any(target is None or target not in self.never_return for target in tails)

    def analyse(self, start):
        function = Function(start)
        states = {start: {"sp": Offset(0)}}
        calls, waiting, deeper = {}, [start], {}
        while waiting:
            address = waiting.pop()
            instruction = self.elf.instructions.get(address)
            if instruction is None:
                function.problems.append(f"execution runs into data at {address:#x}")
                continue
            state = states[address]
            before = state.get("sp")
            if not isinstance(before, Offset):
                function.problems.append(f"the stack pointer is unknown at {address:#x}")
                continue
            after = transfer(self.elf, instruction, state)
            depth = after.get("sp", before)
            depth = -min(before.bytes, depth.bytes if isinstance(depth, Offset) else before.bytes)
            function.depth = max(function.depth, depth)
            self.constants.update(value for value in after.values() if isinstance(value, int) and value & 1)
            following = self.step(function, instruction, state, calls, -before.bytes)
            function.successors[address] = following
            for next_ in following:
                known = states.get(next_)
                joined = join(known, after)
                if joined == known:
                    continue
                if known is not None and joined.get("sp") != known.get("sp"):
                    deeper[next_] = deeper.get(next_, 0) + 1
                    if deeper[next_] > MOST_DEPTHS:
                        function.problems.append(f"the stack grows in a loop at {next_:#x}")
                        continue
                states[next_] = joined
                waiting.append(next_)
        function.calls = list(calls.values())
        function.problems = sorted(set(function.problems))
        function.traps = sorted(set(function.traps))
        return function

    def step(self, function, instruction, state, calls, depth):
        """Addresses that follow in this function; notes calls, traps and returns."""
        name, operands, address = instruction.name, instruction.operands, instruction.address
        following = [address + instruction.size]
        if name in TRAPS:
            function.traps.append(address)
            return following if name == "svc" else []
        if name in ("b", "cbz", "cbnz"):
            target = direct(operands)
            if target in self.elf.names and target != function.start:
                calls[address] = Call(address, target, depth, is_tail=True)
                jumps = []
            else:
                jumps = [target]
            goes_on = instruction.is_conditional or name != "b"
            return jumps + (following if goes_on else [])
        if name in ("bl", "blx"):
            target = direct(operands) if name == "bl" else constant(state.get(operands))
            calls[address] = Call(address, target, depth)
            if target in self.never_return and not instruction.is_conditional:
                return []
            return following
        if name == "bx" or (name == "mov" and operands.startswith("pc,")):
            register = operands.split(", ")[-1]
            if register == "lr":
                function.returns = True
            else:
                calls[address] = Call(address, constant(state.get(register)), depth, is_tail=True)
            return following if instruction.is_conditional else []
        if name in ("tbb", "tbh"):
            return self.table(instruction, function.start)
        if re.search(r"\{.*\bpc\b.*\}", operands) or (name == "ldr" and operands.startswith("pc, [sp]")):
            function.returns = True
            return following if instruction.is_conditional else []
        if re.match(r"pc\b", operands) and name not in READS and not name.startswith("st"):
            function.problems.append(f"{name} {operands} at {address:#x}")
            return []
        if following[0] in self.elf.names and following[0] != function.start:
            calls[address] = Call(address, following[0], depth, is_tail=True)
            return []
        return following

    def table(self, instruction, start):
        """Targets of a jump by a table behind the instruction, which follow the table in the function. Literals may be between
        both: the first that is no target ends the table."""
        if not instruction.operands.startswith("[pc"):
            return []
        base, width = instruction.address + 4, 1 if instruction.name == "tbb" else 2
        place, found = base, set()
        end = next((other for other in self.elf.starts if other > start), WORD)
        while place in self.elf.data and place < min(found, default=WORD):
            target = base + 2 * self.elf.read(place, width)
            if target > place:
                if target >= end or target not in self.elf.instructions:
                    break
                found.add(target)
            place += width
        return sorted(found)


def direct(operands):
    return int(re.search(r"(?:^|, )([0-9a-f]{6,8}) <", operands)[1], 16)


def constant(value):
    return value & ~1 if isinstance(value, int) else None


def join(old, new):
    """What holds on both paths; of two depths of the stack the deeper."""
    if old is None:
        return dict(new)
    joined = {name: value for name, value in old.items() if new.get(name) == value}
    depths = old.get("sp"), new.get("sp")
    if all(isinstance(depth, Offset) for depth in depths):
        joined["sp"] = min(depths, key=lambda depth: depth.bytes)
    return joined


def transfer(elf, instruction, state):
    """Registers after an instruction."""
    name, operands = instruction.name, instruction.operands
    state = dict(state)
    if name in ("bl", "blx"):
        for register in CLOBBERED:
            state.pop(register, None)
        return state
    if name in ("push", "vpush", "stmdb", "vstmdb", "pop", "vpop", "ldmia", "vldmia", "stmia", "vstmia", "ldmdb"):
        base, registers = ("sp", operands) if name.endswith(("push", "pop")) else operands.split(", ", 1)
        names = listed(registers)
        if "st" not in name and "push" not in name:
            for register in names:
                if register != "sp":
                    state.pop(register, None)
        if name.endswith(("push", "pop")) or base.endswith("!"):
            size = sum(8 if register.startswith("d") else 4 for register in names)
            down = "push" in name or name.endswith("db")
            move(state, base.rstrip("!"), -size if down else size)
        return state
    # Write-back of an address.
    if match := re.search(r"\[(\w+), #(-?\d+)\]!", operands) or re.search(r"\[(\w+)\], #(-?\d+)", operands):
        move(state, match[1], int(match[2]))
    elif match := re.search(r"\[(\w+), .*\]!|\[(\w+)\], \w", operands):
        state.pop(match[1] or match[2], None)
    if name in READS or (name.startswith(("str", "vstr", "stm")) and not name.startswith("strex")):
        return state
    parts = [part.strip() for part in operands.split(",")]
    destinations = 2 if name in ("ldrd", "ldrexd", "umull", "smull", "umlal", "smlal", "umaal") or (
        name.startswith("vmov") and len(parts) >= 3
    ) or name.startswith(("smlal", "smlsl")) else 1
    value = computed(elf, instruction, state, parts)
    if instruction.is_conditional and state.get(parts[0]) != value:
        old = state.get(parts[0])
        both = isinstance(old, Offset) and isinstance(value, Offset) and parts[0] == "sp"
        value = min(old, value, key=lambda depth: depth.bytes) if both else None
    for register in parts[:destinations]:
        state.pop(register, None)
    if value is not None:
        state[parts[0]] = value
    return state


def move(state, register, size):
    value = add(state.get(register), size)
    state.pop(register, None)
    if value is not None:
        state[register] = value


def add(value, size):
    if isinstance(value, Offset) and isinstance(size, int):
        # As a 32-bit number.
        size = (size + 0x8000_0000 & WORD) - 0x8000_0000
        return Offset(value.bytes + size)
    if isinstance(value, int) and isinstance(size, int):
        return value + size & WORD
    return None


def listed(registers):
    """Names in a list of registers with ranges."""
    found = []
    for word in registers.strip("{} ^").split(","):
        ends = word.strip().split("-")
        if len(ends) == 2:
            kind, low, high = ends[0][0], int(ends[0][1:]), int(re.sub(r"\D", "", ends[1]))
            found += [f"{kind}{number}" for number in range(low, high + 1)]
        else:
            found += ends
    return found


def computed(elf, instruction, state, parts):
    """The value that an instruction writes, where it is known."""
    name = instruction.name

    def operand(text):
        if match := re.fullmatch(r"#(-?\d+)(?: .*)?", text):
            return int(match[1])
        return state.get(text)

    if name in ("mov", "movs", "movw") and len(parts) == 2:
        value = operand(parts[1])
        return value & WORD if isinstance(value, int) else value
    if name == "movt":
        low, high = state.get(parts[0]), operand(parts[1])
        return high << 16 | low & 0xFFFF if isinstance(low, int) and isinstance(high, int) else None
    if name in ("add", "adds", "addw", "sub", "subs", "subw"):
        if len(parts) > 3:
            return None
        left, right = operand(parts[-2]), operand(parts[-1])
        if parts[-2] == "pc" and isinstance(right, int):
            left = instruction.address + 4 & ~3
        if name.startswith("sub"):
            right = -right if isinstance(right, int) else None
        elif isinstance(right, Offset):
            left, right = right, left
        return add(left, right)
    if name in ("bic", "bics") and len(parts) in (2, 3):
        value, mask = operand(parts[-2]), operand(parts[-1])
        if isinstance(value, Offset) and isinstance(mask, int):
            return Offset(value.bytes - mask)
    if name == "bfc" and parts[1] == "#0":
        value, bits = state.get(parts[0]), operand(parts[2])
        if isinstance(value, Offset):
            return Offset(value.bytes - (1 << bits) + 1)
    if name == "ldr" and len(parts) >= 2:
        text = instruction.operands
        if match := re.search(r"\[pc, .*@([0-9a-f]+)$", text):
            return elf.read(int(match[1], 16), 4)
        if match := re.fullmatch(r"\w+, \[(\w+)(?:, #(-?\d+))?\](?: @.*)?", text):
            base = state.get(match[1])
            if isinstance(base, int):
                return elf.read(base + int(match[2] or 0) & WORD, 4, is_constant=True)
    return None

"""Control flow of an image of Thumb-2 code: what each function calls, where it traps, and the stack it uses.

Registers are followed as constants or as addresses on the stack, over all paths of the function until nothing changes, so
that the target of a call through a register is known where it is a constant on all paths. A jump into the middle of a
function belongs to the flow of the function that jumps.
"""

from collections import namedtuple
from dataclasses import dataclass, field
from heapq import heappop, heappush

from capstone.arm_const import ARM_OP_IMM as IMMEDIATE, ARM_OP_MEM as MEMORY, ARM_OP_REG as REGISTER
from capstone.arm_const import ARM_REG_D0, ARM_REG_D31, ARM_REG_LR as LR, ARM_REG_PC as PC, ARM_REG_SP as SP
from capstone.arm_const import ARM_REG_R0, ARM_REG_R4, ARM_REG_R12

TRAPS = {"udf", "trap", "bkpt", "svc", "hlt"}
# Directions in which a list of registers moves the stack pointer.
LISTS = {"push": -1, "vpush": -1, "pop": 1, "vpop": 1}
COMPUTED = {*LISTS, "mov", "movt", "add", "sub", "adr", "ldr"}
CLOBBERED = {*range(ARM_REG_R0, ARM_REG_R4), ARM_REG_R12, LR}
WORD = 0xFFFF_FFFF
# The stack pointer at a function's entry, apart from all words, and the most bytes below it: more are a loop.
STACK, MOST = 1 << 40 | 1 << 31, 1 << 16

# The target is None where it is unknown.
Call = namedtuple("Call", "target, depth, is_tail")


@dataclass
class Function:
    start: int
    depth: int = 0  # Bytes of its own stack, at the most.
    calls: dict = field(default_factory=dict)  # By the address of the instruction.
    traps: set = field(default_factory=set)
    problems: set = field(default_factory=set)
    successors: dict = field(default_factory=dict)
    returns: bool = False


class CallGraph:
    def __init__(self, elf):
        self.elf = elf
        self.never_return = set()
        self.functions = {}
        self.constants = set()  # Odd ones that the code builds in registers.
        waiting = set(elf.starts)
        while waiting:
            for start in waiting:
                self.functions[start] = self.analyse(start)
            # A function that never returns ends the paths of its callers; until none more is found.
            found = {s for s, f in self.functions.items() if not self.can_return(f)} - self.never_return
            self.never_return |= found
            waiting = {s for s, f in self.functions.items() if any(call.target in found for call in f.calls.values())}

    def can_return(self, function):
        tails = (call.target for call in function.calls.values() if call.is_tail)
        return function.returns or any(target not in self.never_return for target in tails)

    def analyse(self, start):
        function, states, waiting = Function(start), {start: {SP: STACK}}, [start]
        while waiting:
            place = heappop(waiting)
            instruction, state = self.elf.instructions.get(place), states[place]
            if instruction is None:
                function.problems.add(f"execution runs into data at {place:#x}")
                continue
            if not STACK - MOST <= state.get(SP, 0) <= STACK:
                function.problems.add(f"the stack pointer is unknown or moves in a loop at {place:#x}")
                continue
            after = self.transfer(place, instruction, state)
            function.depth = max(function.depth, STACK - after.get(SP, STACK))
            function.successors[place] = self.step(function, place, instruction, state)
            for following in function.successors[place]:
                known = states.get(following)
                states[following] = join(known, after)
                if states[following] != known:
                    heappush(waiting, following)
        return function

    def step(self, function, place, instruction, state):
        """Addresses that follow in this function; notes calls, traps and returns."""
        name, following = instruction.name, [place + instruction.size]
        otherwise = following if place in self.elf.conditional else []

        def call(target, is_tail=True):
            function.calls[place] = Call(target, STACK - state[SP], is_tail)

        def pointer(operand):
            value = state.get(operand.reg)
            return None if value is None else value & ~1

        if name in TRAPS:
            function.traps.add(place)
            return following if name == "svc" else []
        if name in ("b", "cbz", "cbnz"):
            target = place + instruction.operands[-1].imm
            if target not in self.elf.names or target == function.start:
                return [target, *otherwise]
            call(target)
            return otherwise
        if name in ("bl", "blx"):
            operand = instruction.operands[0]
            call(place + operand.imm if name == "bl" else pointer(operand), is_tail=False)
            return otherwise if function.calls[place].target in self.never_return else following
        if name in ("tbb", "tbh"):
            return self.table(place, instruction, function.start)
        if PC in instruction.writes:
            operand = instruction.operands[-1]
            if name in ("bx", "mov") and operand.reg != LR:
                call(pointer(operand))
            elif name in ("bx", "mov") or SP in instruction.writes:
                function.returns = True
            else:
                function.problems.add(f"unknown jump at {place:#x}")
            return otherwise
        if following[0] in self.elf.names and following[0] != function.start:
            call(following[0])
            return []
        return following

    def table(self, place, instruction, start):
        """Targets of a jump by a table behind the instruction, which follow the table in the function. Literals may be between
        both: the first that is no target ends the table."""
        if instruction.operands[0].mem.base != PC:
            return []
        base, width = place + 4, 1 if instruction.name == "tbb" else 2
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

    def transfer(self, place, instruction, state):
        """Registers after an instruction."""
        written, after = instruction.writes, state
        if instruction.name in ("bl", "blx"):
            written = written | CLOBBERED
        if not written.isdisjoint(state):
            after = {register: value for register, value in state.items() if register not in written}
        if SP in written or instruction.name in COMPUTED:
            value = self.computed(place, instruction, state)
            if value is not None:
                after = after | {SP if SP in written else instruction.operands[0].reg: value}
                if value & 1:
                    self.constants.add(value)
        return join(state, after) if place in self.elf.conditional else after

    def computed(self, place, instruction, state):
        """The value that an instruction writes, to the stack pointer or else its first operand, where it is known."""
        name, operands = instruction.name, instruction.operands

        def base(register):
            return place + 4 & ~3 if register == PC else state.get(register)

        def value(operand):
            if operand.type == IMMEDIATE:
                return operand.imm & WORD
            return state.get(operand.reg) if operand.type == REGISTER and not operand.shift.type else None

        if name in LISTS:
            return state[SP] + LISTS[name] * sum(8 if ARM_REG_D0 <= one.reg <= ARM_REG_D31 else 4 for one in operands)
        if instruction.decoded.writeback:
            offsets = [one.mem.disp if one.type == MEMORY else one.imm for one in operands if one.type != REGISTER]
            return state[SP] + sum(offsets) if offsets and SP in instruction.writes else None
        if name == "mov":
            return value(operands[1])
        if name == "movt" and (low := value(operands[0])) is not None:
            return operands[1].imm << 16 | low & 0xFFFF
        if name in ("add", "sub", "adr"):
            return add(base(PC if name == "adr" else operands[-2].reg), value(operands[-1]), -1 if name == "sub" else 1)
        if name == "ldr" and not operands[1].mem.index:
            address = add(base(operands[1].mem.base), operands[1].mem.disp & WORD)
            return None if address is None else self.elf.read(address, 4, is_constant=True)
        return None


def join(old, new):
    """What holds on both paths; of two depths of the stack the deeper."""
    if old is None or old == new:
        return new
    joined = {register: value for register, value in old.items() if new.get(register) == value}
    if SP in old and SP in new:
        joined[SP] = min(old[SP], new[SP])
    return joined


def add(left, right, sign=1):
    """Sum or difference as 32-bit numbers, on the stack if one of them is."""
    return None if None in (left, right) else max(left, right) & ~WORD | left + sign * right & WORD

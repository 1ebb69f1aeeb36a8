"""Panics and traps that are reachable from the entries of an image, and the stack of each entry.

A panic is a call of a function all of whose paths end in the panic handler. As equal code is merged, one call may serve
many panics: what distinguishes them are the branches that decide for the call, and the functions inlined at these branches.
"""

import linecache
import re
from collections import deque
from dataclasses import dataclass, field

import indirect_calls
from call_graph import CallGraph
from disassembly import Frame

HANDLER = re.compile(r"\brust_begin_unwind$")
# An exception's frame with floating-point state (ARMv7-M B1.5.7), and alignment to 8 bytes.
EXCEPTION_FRAME = 26 * 4 + 4
# Lines of a signature, at the most.
SIGNATURE = 15


@dataclass
class Panic:
    kind: str  # Trap, resumed future, or panic.
    function: int
    site: int
    frames: list
    entries: set = field(default_factory=set)

    @property
    def text(self):
        return f"{self.kind}: " + " < ".join(frame.place for frame in self.frames)


class Image:
    """The call graph with indirect calls resolved."""

    def __init__(self, elf):
        self.elf = elf
        self.graph = CallGraph(elf)
        self.problems = []
        self.handler = [start for start, name in elf.names.items() if HANDLER.search(name)]
        if len(self.handler) != 1:
            self.problems.append(f"{len(self.handler)} panic handlers")
        stored = self.stored_functions()
        self.polls = [start for start in self.matching(indirect_calls.TASK_POLL) if start in stored]
        self.resolve()
        self.panicking = self.panicking_functions()

    def matching(self, pattern):
        return [start for start, place in self.elf.places.items() if re.search(pattern, place)]

    def resolve(self):
        """Targets of each call site: (function, target, depth, whether an executor polls a task there)."""
        functions = self.graph.functions
        unknown = [call.site for function in functions.values() for call in function.calls if call.target is None]
        frames = self.elf.frames(unknown)
        self.indirect = len(unknown)
        stored = self.stored_functions()
        used, targets = set(), {}
        for rule in indirect_calls.RULES:
            targets[rule] = {t for t in stored if rule.targets and re.search(rule.targets, self.elf.places[t])}
        self.edges = {}
        for start, function in functions.items():
            edges = self.edges[start] = []
            for call in function.calls:
                if call.target is not None:
                    if call.target in functions:
                        edges.append((call.target, call.depth, False))
                    else:
                        self.problems.append(f"{self.elf.names[start]} calls {call.target:#x}, where no function begins")
                    continue
                rule = indirect_calls.find(frames.get(call.site, ()))
                if rule is None:
                    text = " < ".join(frame.place for frame in frames.get(call.site, ())[:6])
                    self.problems.append(f"call through a pointer at {call.site:#x} in {self.elf.names[start]}: {text}")
                    continue
                used.add(rule)
                is_poll = rule.targets == indirect_calls.TASK_POLL
                edges += [(target, call.depth, is_poll) for target in targets[rule]]
        for rule in indirect_calls.RULES:
            if rule not in used:
                self.problems.append(f"no call through a pointer is in {rule.site}: remove the rule")
            if rule.targets and not targets[rule]:
                self.problems.append(f"no stored function is {rule.targets}: correct the rule")
        called = set().union(*targets.values())
        direct = {target for edges in self.edges.values() for target, _, _ in edges}
        never = {pattern: set(self.matching(pattern)) & stored.keys() for pattern, _ in indirect_calls.NEVER_CALLED}
        self.problems += [f"no stored function is {pattern}: remove it" for pattern, found in never.items() if not found]
        called = called.union(*never.values())
        for target, is_data in stored.items():
            if target not in called and (is_data or target not in direct):
                self.problems.append(f"the address of {self.elf.places[target]} is stored, and no rule says what calls it")

    def stored_functions(self):
        """Functions whose address is in data, apart from the vector table, or built by code; whether it is in data."""
        table = self.elf.sections[".vector_table"]
        found = {}
        for place, word in self.elf.words():
            if word & 1 and word & ~1 in self.elf.names and not 0 <= place - table.address < table.size:
                found[word & ~1] = found.get(word & ~1, False) or self.elf.is_data(place)
        for word in self.graph.constants:
            if word & 1 and word & ~1 in self.elf.names:
                found.setdefault(word & ~1, False)
        return found

    def panicking_functions(self):
        """Functions all of whose paths end in the panic handler."""
        found = set(self.handler)
        candidates = {start for start in self.graph.never_return if not has_cycle(self.graph.functions[start])}
        while True:
            more = {start for start in candidates - found if self.always_calls(start, found)}
            if not more:
                return found
            found |= more

    def always_calls(self, start, targets):
        function = self.graph.functions[start]
        calls = {call.site: call for call in function.calls}
        ends = [site for site, following in function.successors.items() if not following]
        return bool(ends) and all(site in calls and calls[site].target in targets for site in ends)

    def reach(self, entry):
        """Functions reached from one, each with the one that calls it on a shortest path; tasks are entries of their own."""
        parents, waiting = {entry: None}, deque([entry])
        while waiting:
            start = waiting.popleft()
            if start in self.panicking and start not in self.handler:
                continue
            for target, _, is_poll in self.edges[start]:
                if target not in parents and not is_poll and target not in self.panicking:
                    parents[target] = start
                    waiting.append(target)
        return parents

    def panics(self, start):
        """Panics and traps in a function, by the branches that decide for them."""
        function = self.graph.functions[start]
        sites = {call.site: "panic" for call in function.calls if call.target in self.panicking}
        sites |= {site: "trap" for site in function.traps}
        before = {}
        for place, following in function.successors.items():
            for next_ in following:
                before.setdefault(next_, []).append(place)
        found = []
        for site, kind in sites.items():
            deciding, seen, waiting = set(), set(), [site]
            instruction = self.elf.instructions[site]
            if instruction.is_conditional or instruction.name in ("cbz", "cbnz"):
                deciding.add(site)
                waiting = []
            while waiting:
                place = waiting.pop()
                if place in seen:
                    continue
                seen.add(place)
                for previous in before.get(place, ()):
                    if len(function.successors[previous]) > 1:
                        deciding.add(previous)
                    else:
                        waiting.append(previous)
            found += [(kind, branch) for branch in deciding or {site}]
        return found

    def stacks(self, targets_of_polls):
        """Function to the bytes of stack from it down, panics left out; `targets_of_polls` gives the tasks that a
        function polls."""
        known, active = {}, []

        def deepest(start):
            if start in known:
                return known[start]
            if start in active:
                names = [self.elf.names[place] for place in active[active.index(start) :]]
                self.problems.append("recursion: " + " > ".join(names))
                return 0
            active.append(start)
            below = [0]
            for target, depth, is_poll in self.edges[start]:
                if target in self.panicking or (is_poll and target not in targets_of_polls(start)):
                    continue
                below.append(depth + deepest(target))
            active.pop()
            known[start] = max(self.graph.functions[start].depth, *below)
            return known[start]

        for start in self.elf.starts:
            if start not in self.panicking:
                deepest(start)
        return known


def has_cycle(function):
    done, active = set(), set()
    stack = [(function.start, iter(function.successors.get(function.start, ())))]
    active.add(function.start)
    while stack:
        place, following = stack[-1]
        next_ = next(following, None)
        if next_ is None:
            stack.pop()
            active.discard(place)
            done.add(place)
        elif next_ in active:
            return True
        elif next_ not in done:
            active.add(next_)
            stack.append((next_, iter(function.successors.get(next_, ()))))
    return False


def is_resumed_future(frames):
    """Whether a branch is the choice by the state of a future that an `async` block or function is compiled to: it has
    the line where the block begins, in the sources that the image was built from."""
    file, line = frames[0].file, frames[0].line
    if not re.search(r"\{closure[^{}]*\}+$", frames[0].name) or not line.isdigit():
        return False
    line = int(line)
    text = linecache.getline(file, line)
    # An attribute that makes the block is before the signature.
    if re.search(r"\basync\b", text) or text.startswith("#["):
        return True
    if not re.match(r"\s*[){]", text):
        return False
    # The last line of a signature of several.
    for number in range(line - 1, max(0, line - SIGNATURE), -1):
        text = linecache.getline(file, number)
        if re.search(r"[;{}]\s*$", text):
            return False
        if re.search(r"\basync\b", text):
            return True
    return False


def find_panics(image, entries):
    """Panics and traps reachable from the entries (name to function), and for each function reached from which and on
    which path."""
    reached = {}
    for name, start in entries.items():
        for function, parent in image.reach(start).items():
            reached.setdefault(function, {})[name] = parent
    places = {start: image.panics(start) for start in reached}
    frames = image.elf.frames(site for found in places.values() for _, site in found)
    panics = []
    for start, found in places.items():
        for kind, site in found:
            inlined = frames.get(site) or [Frame(image.elf.names[start], "", "")]
            if kind != "trap" or is_resumed_future(inlined):
                kind = "resumed future" if is_resumed_future(inlined) else "panic"
            panics.append(Panic(kind, start, site, inlined, set(reached[start])))
    return panics, reached


def path(image, reached, panic):
    """Names from the entry to the function of a panic, on the shortest of the shortest paths."""
    paths = []
    for entry in reached[panic.function]:
        names, place = [], panic.function
        while place is not None:
            names.append(image.elf.names[place])
            place = reached[place][entry]
        paths.append([entry, *reversed(names)])
    return min(paths, key=len)

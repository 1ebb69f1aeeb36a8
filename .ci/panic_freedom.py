"""Panics and traps that are reachable from the entries of an image, and the stack of each entry.

A panic is a call of a function all of whose paths end in the panic handler. As equal code is merged, one call may serve
many panics: what distinguishes them are the branches that decide for the call, and the functions inlined at these branches.
"""

import functools
import itertools
import linecache
import re
from dataclasses import dataclass

import networkx

from call_graph import CallGraph
from elf import joined

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
    entries: set  # Names of those that reach it.

    @functools.cached_property
    def text(self):
        return f"{self.kind}: {joined(self.frames)}"


def matches(patterns, text):
    return any(re.search(pattern, text) for pattern in patterns)


class Image:
    """The call graph, with the calls through pointers resolved by rules (`image_rules.toml`)."""

    def __init__(self, elf, rules):
        self.elf = elf
        self.graph = CallGraph(elf)
        self.problems = []
        self.handler = [start for start, name in elf.names.items() if HANDLER.search(name)]
        if len(self.handler) != 1:
            self.problems.append(f"{len(self.handler)} panic handlers")
        self.polls = set()  # Functions that poll a task.
        self.edges = {start: [] for start in elf.starts}  # Target, depth, whether an executor polls a task there.
        self.resolve(rules)
        self.panicking = self.panicking_functions()
        # What each function calls apart from panics. Tasks are entries of their own.
        calls = {start: {target for target, _, is_poll in edges if not is_poll} for start, edges in self.edges.items()}
        leaves = dict.fromkeys(self.panicking.difference(self.handler), set())
        self.calls = networkx.DiGraph({start: targets - self.panicking for start, targets in (calls | leaves).items()})

    def matching(self, patterns):
        return {start for start, place in self.elf.places.items() if matches(patterns, place)}

    def resolve(self, rules):
        calls = [(start, *call) for start, function in self.graph.functions.items() for call in function.calls.items()]
        frames = self.elf.frames(site for _, site, call in calls if call.target is None)
        self.indirect = len(frames)
        stored, used = self.stored_functions(), []
        targets = [self.matching(rule["targets"]) & stored.keys() for rule in rules]
        for start, site, call in calls:
            if call.target is None:
                text = joined(frames[site])
                rule = next((number for number, rule in enumerate(rules) if matches(rule["sites"], text)), None)
                if rule is None:
                    self.problems.append(f"call through a pointer at {site:#x} in {self.elf.names[start]}: {text}")
                    continue
                used.append(rule)
                is_poll = rules[rule].get("polls_tasks", False)
                self.edges[start] += [(target, call.depth, is_poll) for target in targets[rule]]
            elif call.target in self.edges:
                self.edges[start].append((call.target, call.depth, False))
            else:
                self.problems.append(f"{self.elf.names[start]} calls {call.target:#x}, where no function begins")
        for number, rule in enumerate(rules):
            if rule["sites"] and number not in used:
                self.problems.append(f"no call through a pointer is in {rule['sites']}: remove the rule")
            if rule["targets"] and not targets[number]:
                self.problems.append(f"no stored function is {rule['targets']}: correct the rule")
            if rule.get("polls_tasks"):
                self.polls |= targets[number]
        direct = {call.target for _, _, call in calls}
        for target, is_data in stored.items():
            if target not in set().union(*targets) and (is_data or target not in direct):
                self.problems.append(f"the address of {self.elf.places[target]} is stored, and no rule says what calls it")

    def stored_functions(self):
        """Functions whose address is in data, apart from the vector table, or built by code; whether it is in data."""
        table = self.elf.sections[".vector_table"]
        found = {word & ~1: False for word in self.graph.constants if word & ~1 in self.elf.names}
        for place, word, is_data in self.elf.words():
            if word & 1 and word & ~1 in self.elf.names and not 0 <= place - table.address < table.size:
                found[word & ~1] = is_data or found.get(word & ~1, False)
        return found

    def panicking_functions(self):
        """Functions all of whose paths end in the panic handler."""
        ends = {}
        for start in self.graph.never_return:
            function = self.graph.functions[start]
            if networkx.is_directed_acyclic_graph(networkx.DiGraph(function.successors)):
                last = (site for site, following in function.successors.items() if not following)
                ends[start] = {function.calls[site].target if site in function.calls else None for site in last}
        found, more = set(), set(self.handler)
        while more:
            found |= more
            more = {start for start, targets in ends.items() if targets and targets <= found} - found
        return found

    def reach(self, entry):
        return {entry} | networkx.descendants(self.calls, entry)

    def panics(self, start):
        """Panics and traps in a function, by the branches that decide for them."""
        function = self.graph.functions[start]
        sites = {site: "panic" for site, call in function.calls.items() if call.target in self.panicking}
        sites |= dict.fromkeys(function.traps, "trap")
        if not sites:
            return []
        branches = {place: following for place, following in function.successors.items() if len(following) > 1}
        # Without what follows a branch.
        straight = networkx.DiGraph(function.successors | dict.fromkeys(branches, ()))
        found = []
        for site, kind in sites.items():
            before = {site} | networkx.ancestors(straight, site)
            deciding = {place for place, following in branches.items() if not before.isdisjoint(following)}
            found += [(kind, branch) for branch in ({site} if site in self.elf.conditional else deciding or {site})]
        return found

    def stacks(self, targets_of_polls):
        """Function to the bytes of stack from it down, panics left out; `targets_of_polls` gives the tasks that a
        function polls."""
        edges = {
            start: [(target, depth) for target, depth, is_poll in self.edges[start]
                    if target not in self.panicking and (not is_poll or target in targets_of_polls(start))]
            for start in self.edges.keys() - self.panicking
        }
        calls = networkx.DiGraph({start: [target for target, _ in found] for start, found in edges.items()})
        if cycle := next(networkx.simple_cycles(calls), None):
            self.problems.append("recursion: " + " > ".join(self.elf.names[start] for start in cycle))
            return {}
        found = {}
        for start in reversed(list(networkx.topological_sort(calls))):
            found[start] = max(self.graph.functions[start].depth, 0, *(depth + found[target] for target, depth in edges[start]))
        return found


def is_resumed_future(frames):
    """Whether a branch is the choice by the state of a future that an `async` block or function is compiled to: it has
    the line where the block begins, in the sources that the image was built from."""
    frame = frames[0]
    if not re.search(r"\{closure[^{}]*\}+$", frame.name) or not frame.line.isdigit():
        return False
    number = int(frame.line)
    first, *before = (linecache.getline(frame.file, line) for line in range(number, max(0, number - SIGNATURE), -1))
    # An attribute that makes the block is before the signature.
    if re.search(r"\basync\b", first) or first.startswith("#["):
        return True
    # The last line of a signature of several.
    signature = itertools.takewhile(lambda text: not re.search(r"[;{}]\s*$", text), before)
    return bool(re.match(r"\s*[){]", first)) and any(re.search(r"\basync\b", text) for text in signature)


def find_panics(image, entries):
    """Panics and traps reachable from the entries (name to function), and the names of those that reach each function."""
    reached = {}
    for name, start in entries.items():
        for function in image.reach(start):
            reached.setdefault(function, set()).add(name)
    places = sorted((site, kind, start) for start in reached for kind, site in image.panics(start))
    frames = image.elf.frames(site for site, _, _ in places)
    panics = []
    for site, kind, start in places:
        kind = "resumed future" if is_resumed_future(frames[site]) else kind
        panics.append(Panic(kind, start, site, frames[site], reached[start]))
    return panics, reached


def path(image, entries, panic):
    """Names from the entry to the function of a panic, on the shortest of the shortest paths."""
    paths = {name: networkx.shortest_path(image.calls, entries[name], panic.function) for name in sorted(panic.entries)}
    name = min(paths, key=lambda name: len(paths[name]))
    return [name, *(image.elf.names[start] for start in paths[name])]

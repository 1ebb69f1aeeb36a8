"""An ELF of the Cortex-M4 as instructions, words and names, read by the binutils of arm-none-eabi."""

import functools
import posixpath
import re
import subprocess
from dataclasses import dataclass


def binutils(tool, *arguments, text=None):
    run = [f"arm-none-eabi-{tool}", *arguments]
    return subprocess.run(run, check=True, capture_output=True, text=True, input=text).stdout


def plain(name):
    """A function's name in either mangling of Rust's: legacy gives `a::Type::f::h0123456789abcdef`, v0 `<a::Type>::f`."""
    return re.sub(r"^<([\w:]+)>", r"\1", re.sub(r"::h[0-9a-f]{16}$", "", name))


@dataclass(frozen=True)
class Frame:
    """A function that is inlined somewhere, or contains it."""

    name: str
    file: str
    line: str

    @property
    def place(self):
        """Crate, file and function, which do not depend on the mangling of names: `core/src/cell.rs::borrow_mut`."""
        return f"{short(self.file)}::{last(self.name)}"


def short(file):
    """Path of a source file from its crate."""
    file = posixpath.normpath(file)
    for pattern in (
        r"/registry/src/[^/]+/(.+?)-\d+\.\d+\.\d+[^/]*(/.*)$",
        r"/library/([\w-]+)(/.*)$",
        r"/build/([\w-]+)-[0-9a-f]+(/out/.*)$",
        r"/(firmware)(/src/.*)$",
    ):
        if match := re.search(pattern, file):
            return match[1] + match[2]
    return file


def last(name):
    """Function in a path, without its types and the numbers of closures in it."""
    parts = without_types(name.replace("{{vtable.shim}}", "")).split("::")
    return [part for part in parts if part and not part.startswith("{")][-1]


def without_types(name):
    name = name.replace("->", "")
    while (bare := re.sub(r"<[^<>]*>", "", name)) != name:
        name = bare
    return name


@dataclass(frozen=True)
class Instruction:
    address: int
    size: int
    name: str  # Without width and condition: `ldr`, `b`.
    operands: str
    is_conditional: bool


@dataclass(frozen=True)
class Section:
    size: int
    address: int
    load: int
    is_readonly: bool


class Elf:
    """Sections, symbols, instructions and the words of what is loaded."""

    def __init__(self, path):
        self.path = path
        self.sections = read_sections(path)
        self.symbols = read_symbols(path)
        self.names, self.instructions, self.data = read_code(path)
        self.starts = sorted(self.names)
        self._contents = {}
        for name, section in self.sections.items():
            if section.size and section.load and name in (".vector_table", ".text", ".rodata", ".ccm", ".data"):
                self._contents[name] = read_contents(path, name)

    def address(self, name):
        """Of the symbol, or None."""
        return next((address for symbol, address, _ in self.symbols if plain(symbol) == name), None)

    def read(self, address, size, is_constant=False):
        """An unsigned number, or None where nothing is loaded or, if required, where it may change."""
        for name, contents in self._contents.items():
            section = self.sections[name]
            offset = address - section.address
            if 0 <= offset <= section.size - size:
                if is_constant and not section.is_readonly:
                    return None
                return int.from_bytes(contents[offset : offset + size], "little")
        return None

    @functools.cached_property
    def places(self):
        """Start of each function to its place, or its name where there is no debug information."""
        frames = self.frames(self.starts)
        found = dict(self.names)
        for start in self.starts:
            if frames.get(start) and frames[start][-1].file not in ("??", ""):
                found[start] = frames[start][-1].place
        return found

    def is_data(self, address):
        """Whether an address is in a section without code."""
        sections = (self.sections[name] for name in (".rodata", ".data") if name in self.sections)
        return any(0 <= address - section.address < section.size for section in sections)

    def words(self):
        """Every aligned word that is loaded, with its address."""
        for name, contents in self._contents.items():
            start = self.sections[name].address
            for offset in range(-start % 4, len(contents) - 3, 4):
                yield start + offset, int.from_bytes(contents[offset : offset + 4], "little")

    def frames(self, addresses):
        """Address to the functions inlined there, innermost first."""
        addresses = sorted(set(addresses))
        if not addresses:
            return {}
        text = "\n".join(f"{address:#x}" for address in addresses)
        lines = binutils("addr2line", "-i", "-f", "-C", "-a", "-e", self.path, text=text).splitlines()
        found, frames, name = {}, [], None
        for line in lines:
            if re.fullmatch(r"0x[0-9a-f]{8}", line):
                frames, name = found.setdefault(int(line, 16), []), None
            elif name is None:
                name = plain(line)
            else:
                file, _, number = line.partition(" (")[0].rpartition(":")
                frames.append(Frame(name, file, number))
                name = None
        return found


def read_sections(path):
    row = re.compile(r"^\s*\d+ (\S+)\s+([0-9a-f]{8})\s+([0-9a-f]{8})\s+([0-9a-f]{8})")
    found, name = {}, None
    for line in binutils("objdump", "-h", path).splitlines():
        if match := row.match(line):
            name, (size, address, load) = match[1], (int(match[i], 16) for i in (2, 3, 4))
            found[name] = Section(size, address, load, False)
        elif name and "READONLY" in line:
            section = found[name]
            found[name] = Section(section.size, section.address, section.load, True)
    return found


def read_symbols(path):
    """Name, address, size of each symbol that has one."""
    row = re.compile(r"^([0-9a-f]{8}) .{7} \S+\t([0-9a-f]{8}) (.+)$")
    found = (row.match(line) for line in binutils("objdump", "-t", "--demangle", path).splitlines())
    return [(m[3].removeprefix(".hidden "), int(m[1], 16), int(m[2], 16)) for m in found if m]


def read_contents(path, section):
    lines = binutils("objdump", "-s", "-j", section, path).splitlines()
    rows = (re.match(r"^ [0-9a-f]+ ([0-9a-f ]{35}) ", line) for line in lines)
    return bytes.fromhex("".join(m[1].replace(" ", "") for m in rows if m))


def read_code(path):
    return parse_code(binutils("objdump", "-d", "-z", "--demangle", path))


def parse_code(text):
    """Function names by address, instructions by address, and the addresses of data between them."""
    names, instructions, data = {}, {}, set()
    head = re.compile(r"^([0-9a-f]+) <(.+)>:$")
    row = re.compile(r"^\s*([0-9a-f]+):\t([0-9a-f ]+?)\s*\t(\S+)(?:\t(.*))?$")
    conditional = 0  # Instructions left in the block of an `it`.
    for line in text.splitlines():
        if match := head.match(line):
            names[int(match[1], 16)] = plain(match[2])
        elif match := row.match(line):
            address, size = int(match[1], 16), len(match[2].replace(" ", "")) // 2
            name, operands = match[3], (match[4] or "").split("\t@")[0].strip()
            if name.startswith("."):
                data.update(range(address, address + size))
                continue
            if comment := re.search(r"@ \(?([0-9a-f]{7,8}) <", line):
                operands += f" @{comment[1]}"
            name = re.sub(r"\.[nw]$", "", name)
            in_block, conditional = conditional > 0, max(conditional - 1, 0)
            if in_block:
                stem, _, suffix = name.partition(".")
                name = stem[:-2] + (f".{suffix}" if suffix else "")
            elif re.fullmatch("it[te]{0,3}", name):
                conditional = len(name) - 1
            is_conditional = in_block
            if re.fullmatch("b(?:eq|ne|cs|cc|hs|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)", name):
                name, is_conditional = "b", True
            instructions[address] = Instruction(address, size, name, operands, is_conditional)
    return names, instructions, data

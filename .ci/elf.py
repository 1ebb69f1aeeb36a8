"""An ELF of the Cortex-M4: sections, symbols, instructions, words, and the functions inlined at an address."""

import functools
import posixpath
import re
import subprocess
from dataclasses import dataclass
from itertools import pairwise

import capstone
from capstone.arm_const import ARM_CC_AL, ARM_REG_SP
from elftools.elf.constants import SH_FLAGS
from elftools.elf.elffile import ELFFile

CAPSTONE = capstone.Cs(capstone.CS_ARCH_ARM, capstone.CS_MODE_THUMB | capstone.CS_MODE_MCLASS)
CAPSTONE.detail = True
# Highest five bits of an instruction of two half-words (ARMv7-M A5.1).
WIDE = (0b11101, 0b11110, 0b11111)
# High byte of `it`, with a mask in the low one; without one it is `nop` or another hint.
IT, NOP = 0xBF, b"\x00\xbf"
# Name of a crate, and the path in it.
CRATE = re.compile(
    r"/(?:registry/src/[^/]+/(.+?)-\d+\.\d+\.\d+[^/]*|library/([\w-]+)|build/([\w-]+)-[0-9a-f]+(?=/out/)|(firmware)(?=/src/))"
    r"(/.*)"
)


def binutils(tool, *arguments, text=None):
    run = [f"arm-none-eabi-{tool}", *arguments]
    return subprocess.run(run, check=True, capture_output=True, text=True, input=text).stdout


@dataclass(frozen=True)
class Frame:
    """A function that is inlined somewhere, or contains it."""

    name: str
    file: str
    line: str

    @functools.cached_property
    def place(self):
        """Crate, file and function, which do not depend on the mangling of names: `core/src/cell.rs::borrow_mut`."""
        file = posixpath.normpath(self.file)
        if match := CRATE.search(file):
            file = "".join(filter(None, match.groups()))
        # Without types and the numbers of closures.
        parts = without_types(self.name.replace("{{vtable.shim}}", "")).split("::")
        return f"{file}::{[part for part in parts if part and not part.startswith('{')][-1]}"


def joined(frames):
    """Places of inlined functions, innermost first, as the rules name them."""
    return " < ".join(frame.place for frame in frames)


def without_types(name):
    name = name.replace("->", "")
    while (bare := re.sub(r"<[^<>]*>", "", name)) != name:
        name = bare
    return name


class Instruction:
    """One encoding, as if at address 0."""

    def __init__(self, decoded):
        self.decoded = decoded
        self.name = decoded.insn_name()  # Without width and condition: `ldr`, `b`.
        self.size, self.operands = decoded.size, decoded.operands
        self.is_conditional = self.name in ("cbz", "cbnz") or (self.name == "b" and decoded.cc != ARM_CC_AL)
        self.writes = set(decoded.regs_access()[1])
        # Capstone leaves these out.
        if self.name in ("vpush", "vpop"):
            self.writes.add(ARM_REG_SP)
        if self.name.startswith(("stm", "vstm")) and decoded.writeback:
            self.writes.add(self.operands[0].reg)


@functools.cache
def decode(code):
    """The instruction, or None."""
    decoded = next(CAPSTONE.disasm(code, 0, 1), None)
    return decoded and Instruction(decoded)


class Section:
    """A section that takes memory of the chip."""

    def __init__(self, elf, section):
        self.address, self.size, flags = section["sh_addr"], section["sh_size"], section["sh_flags"]
        self.is_code = bool(flags & SH_FLAGS.SHF_EXECINSTR)
        self.is_readonly = not flags & SH_FLAGS.SHF_WRITE
        self.contents = b"" if section["sh_type"] == "SHT_NOBITS" else section.data()
        segments = (segment for segment in elf.iter_segments("PT_LOAD") if segment.section_in_segment(section))
        self.load = next((segment["p_paddr"] - segment["p_vaddr"] for segment in segments), 0) + self.address


class Elf:
    def __init__(self, path):
        self.path = path
        with open(path, "rb") as file:
            elf = ELFFile(file)
            loaded = (section for section in elf.iter_sections() if section["sh_flags"] & SH_FLAGS.SHF_ALLOC)
            self.sections = {section.name: Section(elf, section) for section in loaded}
            symbols = [symbol for symbol in elf.get_section_by_name(".symtab").iter_symbols() if symbol.name]
        names = binutils("c++filt", "-i", text="\n".join(symbol.name for symbol in symbols)).split("\n")
        self.addresses, self.sizes = {}, {}
        self.names = {}  # Of functions, by their start.
        # Where code or data begins (ELF for the Arm architecture, 5.5.5), and where a section ends.
        marks = [(section.address + section.size, "") for section in self.sections.values()]
        for symbol, name in zip(symbols, names):
            address = symbol["st_value"]
            # Legacy mangling gives `a::Type::f`, v0 `<a::Type>::f`.
            name = re.sub(r"^<([\w:]+)>", r"\1", name)
            if symbol["st_info"]["type"] == "STT_FUNC":
                address &= ~1
                self.names.setdefault(address, name)
            if name[:2] in ("$t", "$d"):
                marks.append((address, name[1]))
            else:
                self.addresses[name], self.sizes[name] = address, symbol["st_size"]
        self.starts = sorted(self.names)
        self.instructions, self.conditional, self.data = {}, set(), set()
        for (start, kind), (stop, _) in pairwise(sorted(marks)):
            if kind == "t":
                self.read_code(start, self.loaded(start, stop - start))
            elif kind == "d":
                self.data.update(range(start, stop))

    def read_code(self, place, code):
        block = 0  # Instructions left in the block of an `it`.
        while code:
            size = 4 if code[1] >> 3 in WIDE else 2
            one, code = code[:size], code[size:]
            if block:
                self.conditional.add(place)
                block -= 1
            if one[1] == IT and one[0] & 0xF:
                # The last one in its mask ends the block. Capstone would take what it decodes next for the block.
                block = 5 - (one[0] & -one[0] & 0xF).bit_length()
                one = NOP
            if instruction := decode(one):
                self.instructions[place] = instruction
                if instruction.is_conditional:
                    self.conditional.add(place)
            place += size

    def loaded(self, address, size, is_constant=False):
        """Bytes, or None where nothing is loaded or, if required, where it may change."""
        for section in self.sections.values():
            offset = address - section.address
            if 0 <= offset <= len(section.contents) - size and (section.is_readonly or not is_constant):
                return section.contents[offset : offset + size]
        return None

    def read(self, address, size, is_constant=False):
        """An unsigned number, or None."""
        found = self.loaded(address, size, is_constant)
        return None if found is None else int.from_bytes(found, "little")

    @functools.cached_property
    def places(self):
        """Start of each function to its place, or its name where there is no debug information."""
        frames = {start: found[-1] for start, found in self.frames(self.starts).items()}
        return {start: self.names[start] if frame.file in ("??", "") else frame.place for start, frame in frames.items()}

    def words(self):
        """Every aligned word that is loaded: its address, value, and whether it is in a section without code."""
        for section in self.sections.values():
            for offset in range(-section.address % 4, len(section.contents) - 3, 4):
                word = int.from_bytes(section.contents[offset : offset + 4], "little")
                yield section.address + offset, word, not section.is_code

    def frames(self, addresses):
        """Address to the functions inlined there, innermost first."""
        text = "\n".join(f"{address:#x}" for address in sorted(set(addresses)))
        found = {}
        for block in re.split(r"^(?=0x)", binutils("addr2line", "-ifCa", "-e", self.path, text=text), flags=re.M)[1:]:
            address, *lines = block.splitlines()
            places = (place.partition(" (")[0].rpartition(":") for place in lines[1::2])
            found[int(address, 16)] = [Frame(name, file, line) for name, (file, _, line) in zip(lines[::2], places)]
        return found

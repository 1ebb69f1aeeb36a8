#!/usr/bin/env python3
"""The walk through an image finds planted panics and traps and computes the stack: assembled examples.

`.ci/python` runs it; as, ld, c++filt and addr2line for arm-none-eabi are in Debian's binutils-arm-none-eabi.
"""

import contextlib
import io
import tempfile
import unittest
from pathlib import Path

import check_image
import panic_freedom
from elf import Elf, Frame, binutils

START = """
    .syntax unified
    .cpu cortex-m4
    .fpu fpv4-sp-d16
    .section .vector_table, "a"
    .word 0x20003800, reset + 1, 0, 0
    .text
    .macro function name
    .type \\name, %function
    .thumb_func
    .global \\name
    \\name:
    .endm
    function rust_begin_unwind; b .
    function panic_bounds_check; push {r7, lr}; bl rust_begin_unwind
"""
STORED = 'function stored; udf #0; .section .rodata, "a"; .word stored'
RULE = {"sites": [""], "targets": ["^stored$"]}
# By what the code has: the code, rules for calls through pointers, and patterns of the panics with their paths and of what the
# walk cannot decide.
CASES = {
    "no panic": ("function reset; bl leaf; b .; function leaf; bx lr", [], []),
    "a trap": (
        "function reset; bl middle; b .; function middle; cbz r0, 1f; bx lr; 1: udf #254", [], ["^trap: reset > middle$"]
    ),
    "a trap that nothing reaches": ("function reset; b .; udf #0; function unused; udf #0", [], []),
    "breakpoint and supervisor call": (
        "function reset; cbz r0, 1f; svc #0; b .; 1: bkpt #0", [], ["^trap: reset$", "^trap: reset$"]
    ),
    "a panic behind calls and jumps": (
        "function reset; bl middle; b .; function middle; cmp r0, #4; bls leaf; bx lr;"
        "function leaf; cmp r1, #8; bhs 1f; bx lr; 1: bl panic_bounds_check",
        [], ["^panic: reset > middle > leaf$"],
    ),
    "a conditional call of a panic": (
        "function reset; cmp r0, #1; it eq; bleq panic_bounds_check; b .", [], ["^panic: reset$"]
    ),
    "two branches to a merged panic": (
        "function reset; cbz r0, 1f; cbz r1, 1f; b .; 1: bl panic_bounds_check", [], ["^panic: reset$", "^panic: reset$"]
    ),
    "a panic behind a jump table and a literal": (
        "function reset; tbb [pc, r0]; 0: .byte (1f - 0b) / 2, (2f - 0b) / 2; .word 0x12345678;"
        "1: b .; 2: bl panic_bounds_check",
        [], ["^panic: reset$"],
    ),
    "a panic behind a constant pointer": (
        "function reset; ldr r4, =leaf; movs r0, #1; bl other; blx r4; b .; .ltorg; function other; bx lr;"
        "function leaf; cbz r0, 1f; bx lr; 1: bl panic_bounds_check",
        [], ["^panic: reset > leaf$"],
    ),
    "a trap behind a stored pointer": (
        "function reset; ldr r0, [r1]; blx r0; b .;" + STORED, [RULE], ["^trap: reset > stored$"]
    ),
    "a pointer that differs between paths": (
        "function reset; ldr r4, =leaf; cbz r0, 1f; ldr r4, =leaf + 4; 1: blx r4; b .; .ltorg; function leaf; bx lr",
        [], ["^call through a pointer at", "address of leaf is stored"],
    ),
    "a stored function without a rule": ("function reset; b .;" + STORED, [], ["address of stored is stored"]),
    "a rule without calls and targets": ("function reset; b .", [RULE], ["remove the rule$", "correct the rule$"]),
    "recursion": (
        "function reset; bl again; b .; function again; push {lr}; cbz r0, 1f; bl again; 1: pop {pc}",
        [], ["^recursion: again$"],
    ),
}
# Each with the bytes of stack from it down.
STACKS = {
    "shallow": ("vpush {d8-d9}; vpop {d8-d9}; bx lr", 16),
    "leaf": ("str lr, [sp, #-8]!; movw r12, #0x1000; sub sp, r12; add sp, r12; ldr pc, [sp], #8", 8 + 0x1000),
    "deep": (
        "push {r4, r5, r7, lr}; sub sp, #40; bl shallow; add sp, #40; push {r0, r1}; bl leaf; add sp, #8;"
        "pop {r4, r5, r7, pc}",
        16 + 8 + 8 + 0x1000,
    ),
    "returns_early": ("push {r4, lr}; cmp r0, #1; it eq; popeq {r4, pc}; bl shallow; pop {r4, pc}", 8 + 16),
    "reset": ("bl deep; bl shallow; bl returns_early; b .", 16 + 8 + 8 + 0x1000),
}


class Walk(unittest.TestCase):
    def image(self, code, rules=()):
        folder = self.enterContext(tempfile.TemporaryDirectory())
        binutils("as", "-o", f"{folder}/image.o", text=f"{START}{code}\n")
        places = ["--section-start=.vector_table=0x08000000", "-Ttext=0x08001000", "-e", "reset"]
        binutils("ld", *places, "-o", f"{folder}/image", f"{folder}/image.o")
        return panic_freedom.Image(Elf(f"{folder}/image"), rules)

    def test_panics_are_found_with_their_path_and_the_undecidable_is_a_problem(self):
        for condition, (code, rules, expected) in CASES.items():
            with self.subTest(condition):
                image = self.image(code, rules)
                entries = {"Reset": image.elf.addresses["reset"]}
                panics, _ = panic_freedom.find_panics(image, entries)
                paths = (" > ".join(panic_freedom.path(image, entries, panic)[1:]) for panic in panics)
                image.stacks(lambda _: set())
                found = [f"{panic.kind}: {path}" for panic, path in zip(panics, paths)] + image.problems
                self.assertEqual(len(found), len(expected), found)
                for text, pattern in zip(found, expected):
                    self.assertRegex(text, pattern)

    def test_stack_is_that_of_the_deepest_path(self):
        image = self.image("; ".join(f"function {name}; {code}" for name, (code, _) in STACKS.items()))
        found = image.stacks(lambda _: set())
        self.assertEqual({name: found[image.elf.addresses[name]] for name in STACKS}, {n: s for n, (_, s) in STACKS.items()})
        self.assertEqual(image.problems, [])

    def test_only_the_signature_of_an_async_function_is_a_resumed_future(self):
        source = ["async fn f(", "    a: usize,", ") -> u8 {", "    let b = c[a];", "    d(", "    )", "}", "fn g() {", "}"]
        file = Path(self.enterContext(tempfile.TemporaryDirectory())) / "f.rs"
        file.write_text("\n".join(source))
        for name, lines in (("f::{{closure}}", {1, 3}), ("f::{closure#0}", {1, 3}), ("f", set())):
            frames = (Frame(name, str(file), str(line + 1)) for line in range(len(source)))
            found = {int(frame.line) for frame in frames if panic_freedom.is_resumed_future([frame])}
            self.assertEqual(found, lines, name)

    def test_check_refuses_a_planted_panic_a_growing_stack_and_an_unused_rule(self):
        for code, rules, message in (
            ("function reset; cbz r0, 1f; b .; 1: udf #0", [], "1 panics or traps"),
            ("function reset; 1: push {r0}; b 1b", [], "1 other problems"),
            ("function reset; b .", [{"patterns": ["^trap: reset$"]}], "1 other problems"),
        ):
            image = self.image(code)
            with contextlib.redirect_stdout(io.StringIO()), self.assertRaisesRegex(SystemExit, message):
                check_image.check_panics(image, {"Reset": image.elf.addresses["reset"]}, rules)


if __name__ == "__main__":
    unittest.main()

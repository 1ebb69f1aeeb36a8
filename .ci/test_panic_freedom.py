#!/usr/bin/env python3
"""The walk through an image finds planted panics and traps and computes the stack: assembled examples.

Needs as, ld, objdump and addr2line for arm-none-eabi (Debian: binutils-arm-none-eabi).
"""

import contextlib
import io
import tempfile
import unittest
from pathlib import Path
from unittest import mock

import allowed_panics
import check_image
import indirect_calls
import panic_freedom
from disassembly import Elf, Frame, binutils

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
    function rust_begin_unwind
    b .
    function panic_bounds_check
    push {r7, lr}
    bl rust_begin_unwind
"""


class Walk(unittest.TestCase):
    def image(self, text, rules=(), never_called=()):
        folder = Path(self.enterContext(tempfile.TemporaryDirectory()))
        (folder / "image.s").write_text(START + text)
        binutils("as", "-o", str(folder / "image.o"), str(folder / "image.s"))
        places = ["--section-start=.vector_table=0x08000000", "-Ttext=0x08001000", "-e", "reset"]
        binutils("ld", *places, "-o", str(folder / "image"), str(folder / "image.o"))
        with mock.patch.multiple(indirect_calls, RULES=rules, NEVER_CALLED=never_called):
            return panic_freedom.Image(Elf(str(folder / "image")))

    def panics(self, image):
        reset = image.elf.address("reset")
        panics, reached = panic_freedom.find_panics(image, {"Reset": reset})
        return [(panic.kind, panic_freedom.path(image, reached, panic)[1:]) for panic in panics]

    def stack(self, image, name):
        return image.stacks(lambda _: set())[image.elf.address(name)]

    def test_image_without_panic_has_none(self):
        image = self.image("function reset\nbl leaf\nb .\nfunction leaf\nbx lr\n")
        self.assertEqual((self.panics(image), image.problems), ([], []))

    def test_planted_trap_is_found_with_its_path(self):
        image = self.image("function reset\nbl middle\nb .\nfunction middle\ncbz r0, 1f\nbx lr\n1: udf #254\n")
        self.assertEqual(self.panics(image), [("trap", ["reset", "middle"])])

    def test_trap_that_nothing_reaches_is_not_reported(self):
        image = self.image("function reset\nb .\nudf #0\nfunction unused\nudf #0\n")
        self.assertEqual(self.panics(image), [])

    def test_breakpoint_and_supervisor_call_are_traps(self):
        image = self.image("function reset\ncbz r0, 1f\nsvc #0\nb .\n1: bkpt #0\n")
        self.assertEqual(sorted(kind for kind, _ in self.panics(image)), ["trap", "trap"])

    def test_planted_panic_is_found_through_calls_and_jumps(self):
        image = self.image(
            """function reset
            bl middle
            b .
            function middle
            cmp r0, #4
            bls leaf
            bx lr
            function leaf
            cmp r1, #8
            bhs 1f
            bx lr
            1: bl panic_bounds_check
            """
        )
        self.assertEqual(self.panics(image), [("panic", ["reset", "middle", "leaf"])])

    def test_conditional_call_of_a_panic_is_found(self):
        image = self.image("function reset\ncmp r0, #1\nit eq\nbleq panic_bounds_check\nb .\n")
        self.assertEqual(self.panics(image), [("panic", ["reset"])])

    def test_each_branch_to_a_merged_panic_is_found(self):
        image = self.image("function reset\ncbz r0, 1f\ncbz r1, 1f\nb .\n1: bl panic_bounds_check\n")
        self.assertEqual(len(self.panics(image)), 2)

    def test_panic_behind_a_jump_table_is_found(self):
        image = self.image(
            """function reset
            tbb [pc, r0]
            0: .byte (1f - 0b) / 2, (2f - 0b) / 2
            .word 0x12345678 @ A literal.
            1: b .
            2: bl panic_bounds_check
            """
        )
        self.assertEqual(self.panics(image), [("panic", ["reset"])])

    def test_panic_behind_a_constant_pointer_is_found(self):
        text = "function reset\nldr r4, =leaf\nmovs r0, #1\nbl other\nblx r4\nb .\n.ltorg\n"
        image = self.image(text + "function other\nbx lr\nfunction leaf\ncbz r0, 1f\nbx lr\n1: bl panic_bounds_check\n")
        self.assertEqual((self.panics(image), image.problems), ([("panic", ["reset", "leaf"])], []))

    def test_pointer_that_differs_between_paths_is_unknown(self):
        text = "function reset\nldr r4, =leaf\ncbz r0, 1f\nldr r4, =other\n1: blx r4\nb .\n.ltorg\n"
        image = self.image(text + "function other\nbx lr\nfunction leaf\nbx lr\n")
        self.assertTrue(any("call through a pointer" in problem for problem in image.problems))

    def test_stored_function_without_a_rule_is_a_problem(self):
        text = "function reset\nb .\nfunction stored\nudf #0\n.section .rodata, \"a\"\n.word stored\n"
        self.assertTrue(any("stored is stored" in problem for problem in self.image(text).problems))

    def test_rule_resolves_a_call_to_the_stored_functions(self):
        text = "function reset\nldr r0, [r1]\nblx r0\nb .\nfunction stored\nudf #0\n.section .rodata, \"a\"\n.word stored\n"
        image = self.image(text, (indirect_calls.Rule("", "^stored$", "example"),))
        self.assertEqual((self.panics(image), image.problems), ([("trap", ["reset", "stored"])], []))

    def test_rule_without_calls_is_a_problem(self):
        image = self.image("function reset\nb .\n", (indirect_calls.Rule("^never$", "", "example"),))
        self.assertTrue(any("remove the rule" in problem for problem in image.problems))

    def test_only_the_signature_of_an_async_function_is_a_resumed_future(self):
        folder = Path(self.enterContext(tempfile.TemporaryDirectory()))
        source = ["async fn f(", "    a: usize,", ") -> u8 {", "    let b = c[a];", "    d(", "    )", "}", "fn g() {", "}"]
        (folder / "f.rs").write_text("\n".join(source) + "\n")
        for name, lines in (("f::{{closure}}", {1, 3}), ("f::{closure#0}", {1, 3}), ("f", set())):
            found = {
                line
                for line in range(1, len(source) + 1)
                if panic_freedom.is_resumed_future([Frame(name, str(folder / "f.rs"), str(line))])
            }
            self.assertEqual(found, lines, name)

    def test_stack_is_that_of_the_deepest_path(self):
        image = self.image(
            """function reset
            bl deep
            bl shallow
            b .
            function deep
            push {r4, r5, r7, lr}
            sub sp, #40
            bl shallow
            add sp, #40
            push {r0, r1}
            bl leaf
            add sp, #8
            pop {r4, r5, r7, pc}
            function shallow
            vpush {d8-d9}
            vpop {d8-d9}
            bx lr
            function leaf
            str lr, [sp, #-8]!
            movw r12, #0x1000
            sub sp, r12
            add sp, r12
            ldr pc, [sp], #8
            """
        )
        self.assertEqual(image.problems, [])
        self.assertEqual(self.stack(image, "shallow"), 16)
        self.assertEqual(self.stack(image, "leaf"), 8 + 0x1000)
        self.assertEqual(self.stack(image, "reset"), 16 + 8 + 8 + 0x1000)

    def test_recursion_is_a_problem(self):
        image = self.image("function reset\nbl again\nb .\nfunction again\npush {lr}\ncbz r0, 1f\nbl again\n1: pop {pc}\n")
        image.stacks(lambda _: set())
        self.assertEqual(image.problems, ["recursion: again"])

    def test_check_refuses_a_planted_panic_and_an_unused_rule(self):
        clean = "function reset\nb .\n"
        planted = clean + "function leaf\nbx lr\nfunction main\ncbz r0, 1f\nbx lr\n1: udf #0\n"
        rule = allowed_panics.Allowed("^trap: main$", "example")
        for text, entry, rules, message in (
            (planted, "main", (), "1 panics or traps"),
            (clean, "reset", (rule,), "1 other problems"),
        ):
            image = self.image(text)
            with (
                mock.patch.object(allowed_panics, "RULES", rules),
                contextlib.redirect_stdout(io.StringIO()),
                self.assertRaisesRegex(SystemExit, message),
            ):
                check_image.check_panics(image, {"Reset": image.elf.address(entry)})


if __name__ == "__main__":
    unittest.main()

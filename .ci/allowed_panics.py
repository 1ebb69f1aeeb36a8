"""Panics of libraries that stay in the image, each with the reason why nothing that the device receives reaches it.

A rule applies where its pattern is found in "kind: place < place ...", the functions inlined at the branch that decides for
the panic, innermost first, and where, if it names entries, no other entry reaches the branch. The first rule that applies
counts. A rule that applies nowhere is an error: remove it.
"""

import re
from dataclasses import dataclass

# Entries that run before the tasks, once.
START = frozenset({"Reset", "task main"})
BEGIN = frozenset({"Reset", "task main", "task begin"})


@dataclass(frozen=True)
class Allowed:
    pattern: str
    reason: str
    entries: frozenset = frozenset()

    def applies(self, panic):
        return bool(re.search(self.pattern, panic.text)) and (not self.entries or panic.entries <= self.entries)


RULES = (
    Allowed(
        r"^resumed future: ",
        "A future that is ready is not polled again: `await` drops it, the executor replaces the poll function of a task "
        "that has ended, and `join` and `select` keep its output or end.",
    ),
    Allowed(
        r"^panic: core/src/cell\.rs::new < core/src/cell\.rs::try_borrow_mut < (core/src/cell\.rs::borrow_mut < )?"
        r"(embassy-sync/src/channel|embassy-stm32/src/(time_driver/gp16|can/fdcan))\.rs::.* critical-section/src/lib\.rs::with\b",
        "The cells of queues, timers and CAN are borrowed inside a critical section, and nothing called there borrows them "
        "again.",
    ),
    Allowed(
        r"\bembassy-stm32/",
        "Start of clocks and peripherals from the constants of `Bsp::init`, before anything is received; the start on the "
        "emulated chip, with the same constants, ends without a panic.",
        START,
    ),
    Allowed(
        r"\bembassy-stm32/(.* < firmware/src/board/nucleo_g474/(drive|feedback|pwm)\.rs::|src/rcc/mod\.rs::enable_and_reset$)",
        "Start of the motor's peripherals from constants, before anything is received; the start on the emulated chip ends "
        "without a panic.",
        BEGIN,
    ),
    Allowed(
        r"\bembassy-executor/src/(platform/cortex_m\.rs::start|raw/state_atomics_arm\.rs::spawn)\b",
        "`main` is spawned once, and it starts each executor once.",
        BEGIN,
    ),
    Allowed(
        r"\bembassy-executor/src/raw/waker\.rs::try_task_from_waker\b",
        "All wakers are those of embassy-executor: no other table of waker functions is in the image.",
    ),
    Allowed(
        r"\bembassy-futures/src/join\.rs::(take_output|poll)\b",
        "`join` takes both outputs once, when both are ready, and ends; `await` and `select` do not poll it again.",
    ),
    Allowed(
        r"\bfutures-util/src/future/select\.rs::",
        "`select` takes its futures when one is ready, and ends.",
    ),
    Allowed(
        r"\bdefmt-rtt/src/lib\.rs::(acquire|release)\b",
        "A log message is written inside a critical section, which only the motor's interrupt at priority 0 can preempt, and "
        "that does not log.",
    ),
    Allowed(
        r"\bembassy-stm32/src/dma/(mod\.rs::info|dma_bdma\.rs::(reset_complete_count|set_waker|poll))\b",
        "The number of a DMA channel is a constant of the type of its peripheral.",
    ),
    Allowed(
        r"\bembassy-stm32/src/dma/dma_bdma\.rs::configure < embassy-stm32/src/dma/dma_bdma\.rs::(read|write)_raw\b",
        "DMA transfers have a constant length or that of a packet, which is neither empty nor longer than its buffer.",
    ),
    Allowed(
        r"\bembassy-stm32/src/dma/dma_bdma\.rs::on_irq\b",
        "DMA fails only at an address without memory, and the addresses are those of buffers and registers.",
    ),
    Allowed(
        r"\bembassy-stm32/src/dma/ringbuffer/mod\.rs::(advance|as_index|read_raw)\b",
        "Positions in the receive buffer are remainders by its length, a constant, and at most what the reader takes is copied.",
    ),
    Allowed(
        r"^panic: (core/src/option\.rs::unwrap < )?embassy-stm32/src/(spi|usart)/mod\.rs::(read|write|transfer_inner)\b",
        "The DMA channels are given at the start, and a transfer in place reads and writes the same bytes.",
    ),
    Allowed(
        r"\bembassy-stm32/src/can/fdcan\.rs::register\b",
        "The CAN driver stays in the mode without buffers of its own.",
    ),
    Allowed(
        r"\bembassy-time/src/instant\.rs::sub < embassy-stm32/src/can/fd/peripheral\.rs::calc_timestamp\b",
        "Timestamps of CAN frames are off, the default of the driver: nothing is subtracted.",
    ),
    Allowed(
        r"\bembassy-stm32/src/can/(frame\.rs::data|fd/peripheral\.rs::(read|rx_fifo_element|tx_buffer_element|put_tx_data|"
        r"put_tx_header))\b",
        "A frame has at most 8 bytes: the driver maps longer codes of the length to 8, and the controller is configured for "
        "classic CAN; the numbers of elements come from fields of its registers that name one of three.",
    ),
    Allowed(
        r"\bembassy-stm32/src/(rcc/mod\.rs::disable\w*|usart/mod\.rs::drop_tx_rx|can/fdcan\.rs::adjust_reference_counter)\b"
        r"|\bembassy-stm32/src/dma/dma_bdma\.rs::(is_running|request_pause)\b",
        "Drivers are dropped with the task that owns them, and no task with a driver ends.",
        BEGIN,
    ),
    Allowed(
        r"\bembassy-stm32/src/flash/(common\.rs::get_sector|asynch\.rs::write_chunked|mod\.rs::(sectors|base))\b",
        "Pages and words are those of the parameters and of the calibration slots, whose size limits an upload; a write is "
        "one word.",
    ),
)

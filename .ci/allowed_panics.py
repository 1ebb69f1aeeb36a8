"""Panics of libraries that stay in the image, each with the reason why nothing that the device receives reaches it.

A rule applies where its pattern is found in "kind: function < function ...", the functions inlined at the branch that decides
for the panic, innermost first, and where, if it names entries, no other entry reaches the branch. A rule that applies nowhere
is an error: remove it.
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
        "that has ended, and `join` and `select` of embassy-futures keep its output or end.",
    ),
    Allowed(
        r"^panic: core::cell::BorrowRef(Mut)?::new < core::cell::RefCell<T>::try_borrow(_mut)? < "
        r"(core::cell::RefCell<T>::borrow(_mut)? < )?<?(embassy_sync::channel|embassy_stm32::(time_driver|can))::.* critical_section::with\b",
        "The cells of queues, timers and CAN are borrowed inside a critical section, and nothing called there borrows them "
        "again.",
    ),
    Allowed(
        r"\bembassy_stm32::",
        "Start of clocks and peripherals from the constants of `Bsp::init`, before anything is received; each start on the "
        "emulated chip passes these branches.",
        START,
    ),
    Allowed(
        r"\bembassy_stm32::.* < firmware::board::selected::(drive|feedback|pwm)::",
        "Start of the motor's peripherals from constants, before anything is received; each start on the emulated chip passes "
        "these branches.",
        BEGIN,
    ),
    Allowed(
        r"\bembassy_executor::platform::interrupt::InterruptExecutor::start\b"
        r"|\bembassy_executor::raw::state::State::spawn\b.* < firmware::__cortex_m_rt_main\b",
        "Each executor is started once and `main` is spawned once.",
        BEGIN,
    ),
    Allowed(
        r"\bembassy_executor::raw::waker::try_task_from_waker\b",
        "All wakers are those of embassy-executor: no other table of waker functions is in the image.",
    ),
    Allowed(
        r"\bembassy_futures::join::MaybeDone<Fut>::take_output\b",
        "`join` takes both outputs once, when both are ready, and ends.",
    ),
    Allowed(
        r"\bfutures_util::future::select::Select<A,B> as core::future::future::Future>::poll\b",
        "The futures of a `select` are taken when one is ready, and it ends.",
    ),
    Allowed(
        r"\bdefmt_rtt::RttEncoder::(acquire|release)\b",
        "A log message is written inside a critical section, which only the motor's interrupt at priority 0 can enter, and "
        "that does not log.",
    ),
    Allowed(
        r"\bembassy_stm32::dma::info\b|\bembassy_stm32::dma::dma_bdma::(DmaCtrlImpl|Transfer) as [^<]*>::"
        r"(reset_complete_count|set_waker|poll)$|(DmaCtrlImpl|Transfer) as [^<]*>::(reset_complete_count|set_waker|poll) <",
        "The number of a DMA channel is a constant of the type of its peripheral.",
    ),
    Allowed(
        r"\bembassy_stm32::dma::dma_bdma::<impl embassy_stm32::dma::Channel>::configure\b",
        "DMA transfers have a constant length or that of a packet, which is neither empty nor longer than its buffer.",
    ),
    Allowed(
        r"\bembassy_stm32::dma::dma_bdma::on_irq\b",
        "DMA fails only at an address without memory, and the addresses are those of buffers and registers.",
    ),
    Allowed(
        r"\bembassy_stm32::dma::ringbuffer::(DmaIndex|ReadableDmaRingBuffer<W>)::",
        "Positions in the receive buffer are remainders by its constant length.",
    ),
    Allowed(
        r"\bembassy_stm32::(spi::Spi<embassy_stm32::mode::Async,CM>|usart::UartTx<embassy_stm32::mode::Async>)::",
        "The DMA channels are given at the start, and a transfer in place reads and writes the same bytes.",
    ),
    Allowed(
        r"\bembassy_stm32::can::_version::(RxMode|TxMode)::register\b",
        "The CAN driver stays in the mode without buffers of its own.",
    ),
    Allowed(
        r"\bembassy_time::instant::Instant::checked_sub\b.* < embassy_stm32::can::\w+::fd::peripheral::Registers::"
        r"calc_timestamp\b",
        "Timestamps of CAN frames are off: nothing is subtracted.",
    ),
    Allowed(
        r"\bembassy_stm32::can::(frame::(Fd)?Frame::data|_version::fd::peripheral::(Registers::(read|rx_fifo_element|"
        r"tx_buffer_element|put_tx_frame)|put_tx_data|put_tx_header)\b)",
        "The driver limits the length of a frame to 64 bytes when it reads the code of the length, and to 8 in a frame of "
        "classic CAN, before it copies; the controller has three elements in each queue and gives their numbers.",
    ),
    Allowed(
        r"\bembassy_stm32::(rcc::RccInfo::disable\w*|usart::drop_tx_rx|can::_version::Info::adjust_reference_counter)\b",
        "Drivers are dropped with their task, and no task ends.",
    ),
    Allowed(
        r"\bembassy_stm32::flash::(common::get_sector|asynch::write_chunked|FlashRegion::)"
        r"|FlashBank>::base\b",
        "The driver has compared offset and length with the size of the flash, and both are multiples of the word or page.",
    ),
    Allowed(
        r"\bembassy_stm32::adc::\w+::<impl embassy_stm32::adc::AdcRegs for [\w:]+>::configure_sequence\b",
        "The channels and their number are constants.",
    ),
)

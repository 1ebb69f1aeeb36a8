//! A crash on the chip: outputs safe, then the record, then a reset.
//!
//! | what | ends in |
//! | --- | --- |
//! | a panic | [`panicked`], the binary's panic handler |
//! | a fault of the core, whichever: none is handled apart | `HardFault` |
//! | the stack's end is crossed | `HardFault`: the stack lies below the statics, at the very start of RAM (`memory.x`), and below that there is no memory to write to |
//! | two wrong bits in flash outside [`super::flash`], the crystal fails | `NonMaskableInt` |
//! | a word of the grasp's memory is not what it was | [`end`], by the grasp's loop |
//! | a loop hangs | [`note`] by [`super::watchdog`], then the watchdog resets |
//!
//! Outputs are safe with TIM1's main output off (MOE): then the pins of the power stage are at their idle
//! levels, all switches off. Where the timer has no clock the write has no effect, and nothing is driven.
//!
//! None of this has run on hardware. On QEMU's Cortex-M4, where nothing lies below RAM either, a push across
//! the stack's end ends in the handler of the fault, with the stack pointer below RAM.
#![allow(unsafe_code)] // Memory that a reset does not touch, a fault's stack frame, handlers.

use core::arch::{asm, naked_asm};
use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;
use embassy_stm32::pac;
use embassy_time::Instant;

use crate::crash::{self, Crash, Kind, Memory, Starts};

/// Bytes at the end of the stack that a handler needs: with fewer it takes the stack anew.
const HANDLERS_STACK: usize = 512;

/// Memory that the start does not initialise.
struct Kept<T>(UnsafeCell<MaybeUninit<T>>);

// SAFETY: written by the start before any task runs, and by handlers that never return or that run one at a
// time in thread mode; every access is one volatile copy of plain words.
unsafe impl<T> Sync for Kept<T> {}

impl<T: Copy> Kept<T> {
    const fn new() -> Self {
        Self(UnsafeCell::new(MaybeUninit::uninit()))
    }

    /// Whatever is there.
    ///
    /// # Safety
    /// Any bits are a `T`.
    unsafe fn read(&self) -> T {
        // SAFETY: the pointer is to a static; the caller promises that any bits will do.
        unsafe { self.0.get().cast::<T>().read_volatile() }
    }

    fn write(&self, value: T) {
        // SAFETY: the pointer is to a static.
        unsafe { self.0.get().cast::<T>().write_volatile(value) }
    }
}

/// The record.
#[unsafe(link_section = ".uninit.crash")]
static RECORD: Kept<Memory> = Kept::new();
/// Starts since the power came.
#[unsafe(link_section = ".uninit.starts")]
static STARTS: Kept<Starts> = Kept::new();

unsafe extern "C" {
    /// Highest address of the stack; `memory.x`.
    static _stack_start: u32;
    /// Lowest.
    static _stack_end: u32;
}

/// Counts this start, and tells it with the crash that ended the last one, if it was one. Once, first thing
/// after [`super::board::bring_up`].
pub fn take() -> (u32, Option<Crash>) {
    // SAFETY: any bits are words.
    let (mut record, mut starts) = unsafe { (RECORD.read(), STARTS.read()) };
    let boot = crash::count_start(&mut starts);
    let told = crash::take(&mut record);
    RECORD.write(record);
    STARTS.write(starts);
    let cause = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    // The watchdog resets without a record where nobody was left to write one.
    let bitten = cause.iwdgrstf().then(|| Crash {
        boot: boot.saturating_sub(1),
        ..Crash::new(Kind::Watchdog)
    });
    (boot, told.or(bitten))
}

/// Writes a record and goes on: the watchdog is about to reset.
pub fn note(crash: Crash) {
    // SAFETY: any bits are words.
    let starts = unsafe { STARTS.read() };
    let [boot, _] = starts;
    let dated = Crash {
        tick_ms: Instant::now().as_millis() as u32,
        boot,
        ..crash
    };
    RECORD.write(dated.to_memory());
}

/// The end of a panic, for the binary's panic handler. Its words and the names of source files are not asked
/// for, and so the image holds none of them: addresses tell the same.
pub fn panicked() -> ! {
    static PANICKED: AtomicBool = AtomicBool::new(false);
    cortex_m::interrupt::disable();
    outputs_off();
    // A panic while one is told: the first counts.
    if !PANICKED.swap(true, Ordering::Relaxed) {
        let [pc, lr, third, fourth] = callers();
        note(Crash {
            pc,
            lr,
            callers: [third, fourth],
            ..Crash::new(Kind::Panic)
        });
        defmt::error!(
            "panic under {=u32:08x} {=u32:08x} {=u32:08x} {=u32:08x}",
            pc,
            lr,
            third,
            fourth
        );
    }
    SCB::sys_reset()
}

/// Where the functions on the stack would have returned to, that of a kind of panic first: each keeps in r7 where its
/// caller's r7 and its way back lie.
fn callers() -> [u32; 4] {
    let mut frame: *const u32;
    // SAFETY: a register that is only read.
    unsafe { asm!("mov {}, r7", out(reg) frame, options(nomem, nostack, preserves_flags)) };
    let (end, start) = (&raw const _stack_end, &raw const _stack_start);
    let mut up = || {
        if !frame.is_aligned() || frame < end || frame.wrapping_add(2) > start {
            return 0;
        }
        // SAFETY: two words within the stack.
        let [next, back] = unsafe { frame.cast::<[u32; 2]>().read_volatile() };
        frame = next as *const u32;
        back
    };
    // The handler's own, and the library's.
    (up(), up());
    [(); 4].map(|()| up())
}

/// Switches the power stage off.
fn outputs_off() {
    pac::TIM1.bdtr().modify(|w| w.set_moe(false));
}

/// Runs on any stack: where too little is left of it, on a new one.
#[unsafe(naked)]
#[unsafe(no_mangle)]
#[unsafe(link_section = ".HardFault.crash")]
unsafe extern "C" fn HardFault() -> ! {
    naked_asm!(
        "mrs r0, msp",
        "ldr r1, ={end}",
        "add r1, r1, #{reserve}",
        "cmp r0, r1",
        "bhs 2f",
        "ldr r1, ={start}",
        "msr msp, r1",
        "2:",
        "b {faulted}",
        ".ltorg",
        end = sym _stack_end,
        start = sym _stack_start,
        reserve = const HANDLERS_STACK,
        faulted = sym faulted,
    )
}

/// `frame` is what the core has put on the stack: r0 to r3, r12, lr, pc, and more. Everything runs on the
/// main stack.
unsafe extern "C" fn faulted(frame: *const u32) -> ! {
    outputs_off();
    let (end, start) = (&raw const _stack_end, &raw const _stack_start);
    let mut crash = match frame < end {
        true => Crash::new(Kind::StackOverflow),
        false => Crash::new(Kind::HardFault),
    };
    if frame >= end && frame.wrapping_add(8) <= start {
        // SAFETY: eight words within the stack.
        let [.., lr, pc, _] = unsafe { frame.cast::<[u32; 8]>().read_volatile() };
        (crash.lr, crash.pc) = (lr, pc);
    }
    // SAFETY: a register of the core that is only read.
    crash.status = unsafe { (*SCB::PTR).cfsr.read() };
    note(crash);
    SCB::sys_reset()
}

#[exception]
unsafe fn NonMaskableInt() {
    if super::flash::was_unreadable() {
        return;
    }
    end(Kind::NonMaskable)
}

/// Outputs off, a record of which nothing is known but what happened, a reset.
pub fn end(kind: Kind) -> ! {
    // The motor's interrupt would switch on again.
    cortex_m::interrupt::disable();
    outputs_off();
    note(Crash::new(kind));
    SCB::sys_reset()
}

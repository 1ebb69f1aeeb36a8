//! Crash handling and watchdog: outputs off, a record, a reset.
//!
//! | cause | path |
//! | --- | --- |
//! | panic | [`panicked`], called by the binary's panic handler |
//! | any fault exception of the core: none has its own handler | `HardFault` |
//! | stack overflow | `HardFault`: the stack is below the statics, at the start of RAM (`memory.x`), and [`guard_stack`] forbids what is below |
//! | double bit error in flash outside [`super::flash`], crystal failure | `NonMaskableInt` |
//! | corrupt memory of the grasp, or of what boot takes once | [`reset`], called by the grip task and by boot |
//! | a task hangs | [`IndependentWatchdog`] writes the record and resets |
//!
//! Outputs are off when the main output enable of TIM1 (MOE) is cleared: the pins of the power stage are at their idle
//! levels, all switches off. While the timer has no clock the write has no effect, and nothing is driven.
//!
//! Not tested on hardware. On QEMU's Cortex-M4, which also has no memory below RAM, a push across the end of the stack
//! ends in the fault handler, with the stack pointer below RAM.
#![allow(unsafe_code)] // Memory that survives a reset, the stack frame of a fault, handlers.

use core::arch::{asm, naked_asm};
use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;
use embassy_stm32::{Peri, pac, peripherals, wdg};
use embassy_time::Instant;

use crate::board::Watchdog;
use crate::system::crash::{self, BootCounter, Crash, CrashKind, CrashRecord};
use crate::system::task_watchdog::{TaskProgress, TaskWatchdog, WATCHDOG_TIMEOUT_MS};

/// Stack that a handler needs, in bytes; with less left it starts at the top of the stack again.
const HANDLER_STACK: usize = 512;

/// Memory that is not initialised at boot.
struct Retained<T>(UnsafeCell<MaybeUninit<T>>);

// SAFETY: written at boot before any task runs, by handlers that never return, and by the watchdog task; every access is
// one volatile copy of plain words.
unsafe impl<T> Sync for Retained<T> {}

impl<T: Copy> Retained<T> {
    const fn new() -> Self {
        Self(UnsafeCell::new(MaybeUninit::uninit()))
    }

    /// The present content.
    ///
    /// # Safety
    /// Any bits are a `T`.
    unsafe fn read(&self) -> T {
        // SAFETY: the pointer is to a static; the caller guarantees that any bits are valid.
        unsafe { self.0.get().cast::<T>().read_volatile() }
    }

    fn write(&self, value: T) {
        // SAFETY: the pointer is to a static.
        unsafe { self.0.get().cast::<T>().write_volatile(value) }
    }
}

#[unsafe(link_section = ".uninit.crash")]
static RECORD: Retained<CrashRecord> = Retained::new();
#[unsafe(link_section = ".uninit.boots")]
static BOOTS: Retained<BootCounter> = Retained::new();

unsafe extern "C" {
    /// Highest address of the stack; `memory.x`.
    static _stack_start: u32;
    /// Lowest address.
    static _stack_end: u32;
}

/// Forbids the 32 KiB below RAM, and with it below the stack: reserved addresses, where a store may be lost without a fault.
pub fn guard_stack() {
    const START: u32 = 0x1FFF_8000;
    const VALID: u32 = 1 << 4;
    // No access, no execution, 2^(14 + 1) bytes, enabled.
    const NO_ACCESS: u32 = 1 << 28 | 14 << 1 | 1;
    // With the default map for all other addresses.
    const ENABLED: u32 = 1 << 2 | 1;
    // SAFETY: nothing accesses these addresses.
    unsafe {
        let unit = &*cortex_m::peripheral::MPU::PTR;
        unit.rbar.write(START | VALID);
        unit.rasr.write(NO_ACCESS);
        unit.ctrl.write(ENABLED);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Number of this boot, the flags of its cause, and the crash that ended the previous run. Must be called once, directly after
/// [`crate::board::Bsp::init`].
pub fn take_record() -> (u32, u32, Option<Crash>) {
    // SAFETY: any bits are words.
    let (mut record, mut boots) = unsafe { (RECORD.read(), BOOTS.read()) };
    let boot = crash::count_boot(&mut boots);
    let recorded = crash::take_record(&mut record);
    RECORD.write(record);
    BOOTS.write(boots);
    let cause = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    // Without a record the watchdog task itself was not running.
    let expired = cause
        .iwdgrstf()
        .then(|| Crash { boot: boot.saturating_sub(1), ..Crash::new(CrashKind::Watchdog) });
    (boot, cause.0, recorded.or(expired))
}

/// Writes the record.
fn record(crash: Crash) {
    // SAFETY: any bits are words.
    let boots = unsafe { BOOTS.read() };
    let [boot, _] = boots;
    let crash = Crash { uptime_ms: Instant::now().as_millis() as u32, boot, ..crash };
    RECORD.write(crash.to_record());
}

/// Body of the binary's panic handler. Records return addresses; message and file names are not used, so the image
/// contains none.
pub fn panicked() -> ! {
    static PANICKED: AtomicBool = AtomicBool::new(false);
    cortex_m::interrupt::disable();
    outputs_off();
    // A panic within this handler: the first one is recorded.
    if !PANICKED.swap(true, Ordering::Relaxed) {
        let [pc, lr, third, fourth] = callers();
        record(Crash { pc, lr, callers: [third, fourth], ..Crash::new(CrashKind::Panic) });
        defmt::error!(
            "panic below {=u32:08x} {=u32:08x} {=u32:08x} {=u32:08x}",
            pc,
            lr,
            third,
            fourth
        );
    }
    SCB::sys_reset()
}

/// Return addresses on the stack, from the function that panicked upwards: r7 is the frame pointer, at which the caller's
/// r7 and the return address are stored.
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
    // Skips the handler's own frame and the library's.
    (up(), up());
    [(); 4].map(|()| up())
}

/// Switches the power stage off.
fn outputs_off() {
    pac::TIM1.bdtr().modify(|w| w.set_moe(false));
}

/// Starts at the top of the stack again when too little is left.
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
        reserve = const HANDLER_STACK,
        faulted = sym faulted,
    )
}

/// `frame` is the exception frame on the main stack: r0 to r3, r12, lr, pc, xpsr.
unsafe extern "C" fn faulted(frame: *const u32) -> ! {
    outputs_off();
    let (end, start) = (&raw const _stack_end, &raw const _stack_start);
    let mut crash =
        Crash::new(if frame < end { CrashKind::StackOverflow } else { CrashKind::HardFault });
    if frame >= end && frame.wrapping_add(8) <= start {
        // SAFETY: eight words within the stack.
        let [.., lr, pc, _] = unsafe { frame.cast::<[u32; 8]>().read_volatile() };
        (crash.lr, crash.pc) = (lr, pc);
    }
    // SAFETY: a register of the core that is only read.
    crash.status = unsafe { (*SCB::PTR).cfsr.read() };
    record(crash);
    SCB::sys_reset()
}

#[exception]
unsafe fn NonMaskableInt() {
    if super::flash::handle_ecc_error() {
        return;
    }
    reset(CrashKind::NonMaskable)
}

/// What can be taken once, at boot; if it was taken before, memory is corrupt.
#[inline]
pub fn once<T>(value: Option<T>) -> T {
    match value {
        Some(value) => value,
        None => taken_twice(),
    }
}

#[cold]
#[inline(never)]
fn taken_twice() -> ! {
    reset(CrashKind::Corruption)
}

/// Switches the outputs off, records the kind of crash, and resets.
pub fn reset(kind: CrashKind) -> ! {
    // The motor interrupt would switch them on again.
    cortex_m::interrupt::disable();
    outputs_off();
    record(Crash::new(kind));
    SCB::sys_reset()
}

/// The IWDG: it cannot be stopped.
pub struct IndependentWatchdog {
    driver: wdg::IndependentWatchdog<'static, peripherals::IWDG>,
    tasks: TaskWatchdog,
    is_recorded: bool,
}

impl IndependentWatchdog {
    /// Configures the peripheral; it does not run yet.
    pub fn new(peripheral: Peri<'static, peripherals::IWDG>) -> Self {
        Self {
            driver: wdg::IndependentWatchdog::new(peripheral, 1000 * WATCHDOG_TIMEOUT_MS),
            tasks: TaskWatchdog::new(now_ms()),
            is_recorded: false,
        }
    }
}

impl Watchdog for IndependentWatchdog {
    fn start(&mut self) {
        self.driver.unleash();
        self.tasks = TaskWatchdog::new(now_ms());
    }

    fn feed(&mut self, progress: &TaskProgress) {
        match self.tasks.check(now_ms(), progress) {
            Ok(()) => self.driver.pet(),
            Err(task) if !self.is_recorded => {
                self.is_recorded = true;
                record(Crash { task: task as u32, ..Crash::new(CrashKind::Watchdog) });
            }
            Err(_) => {}
        }
    }
}

fn now_ms() -> u32 {
    Instant::now().as_millis() as u32
}

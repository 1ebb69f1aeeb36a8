//! Synchronisation: critical sections that never mask the motor interrupt at priority 0, and queues that need none.
#![allow(unsafe_code)] // Interrupt priorities; values that are owned by one side at a time.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, Ordering, compiler_fence};

use cortex_m::register::{basepri, basepri_max};
use critical_section::{Impl, RawRestoreState};

/// Priority 1 in the upper four bits.
const PRIORITY_1: u8 = 0x10;

struct BelowMotor;
critical_section::set_impl!(BelowMotor);

// SAFETY: what enters runs at priority 1 or below, so that nothing else that enters can interrupt it.
unsafe impl Impl for BelowMotor {
    #[inline]
    unsafe fn acquire() -> RawRestoreState {
        let before = basepri::read();
        // Never lowers the mask.
        basepri_max::write(PRIORITY_1);
        compiler_fence(Ordering::SeqCst);
        before
    }

    #[inline]
    unsafe fn release(before: RawRestoreState) {
        compiler_fence(Ordering::SeqCst);
        // SAFETY: what it was before `acquire`.
        unsafe { basepri::write(before) };
    }
}

/// Sets every interrupt to priority 1: critical sections do not mask the reset value 0. Must be called before any
/// interrupt is enabled.
pub fn lower_all_interrupts() {
    // SAFETY: only priorities are written, and none is above what it was.
    let parts = unsafe { cortex_m::Peripherals::steal() };
    for priority in &parts.NVIC.ipr {
        // SAFETY: as above.
        unsafe { priority.write(PRIORITY_1) };
    }
}

/// Storage of one value.
#[derive(Debug)]
struct Slot<T> {
    value: UnsafeCell<Option<T>>,
    is_full: AtomicBool,
}

// SAFETY: the flag passes the value from the one writer to the one reader and back.
unsafe impl<T: Send> Sync for Slot<T> {}

/// A queue of `N` values from one writer to one reader, which may interrupt each other and never wait. Unlike the queue of
/// `heapless` it has no division by a length only known at run time, hence no panic.
#[derive(Debug)]
pub struct Queue<T, const N: usize>([Slot<T>; N]);

/// Writing end of a [`Queue`].
#[derive(Debug)]
pub struct Writer<T: 'static, const N: usize> {
    slots: &'static [Slot<T>; N],
    next: usize,
}

/// Reading end of a [`Queue`].
#[derive(Debug)]
pub struct Reader<T: 'static, const N: usize> {
    slots: &'static [Slot<T>; N],
    next: usize,
}

impl<T, const N: usize> Queue<T, N> {
    /// Empty.
    pub const fn new() -> Self {
        Self([const { Slot { value: UnsafeCell::new(None), is_full: AtomicBool::new(false) } }; N])
    }

    /// The two ends.
    pub fn split(&'static mut self) -> (Writer<T, N>, Reader<T, N>) {
        let slots = &self.0;
        (Writer { slots, next: 0 }, Reader { slots, next: 0 })
    }
}

impl<T, const N: usize> Default for Queue<T, N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T, const N: usize> Writer<T, N> {
    /// Appends a value.
    ///
    /// # Errors
    /// The value, when the queue is full.
    pub fn push(&mut self, value: T) -> Result<(), T> {
        let Some(slot) = self.slots.get(self.next) else {
            return Err(value);
        };
        if slot.is_full.load(Ordering::Acquire) {
            return Err(value);
        }
        // SAFETY: the slot is empty, so the reader does not access it.
        unsafe { *slot.value.get() = Some(value) };
        slot.is_full.store(true, Ordering::Release);
        self.next = after::<N>(self.next);
        Ok(())
    }
}

impl<T, const N: usize> Reader<T, N> {
    /// Removes the oldest value.
    pub fn pop(&mut self) -> Option<T> {
        let slot = self.slots.get(self.next)?;
        if !slot.is_full.load(Ordering::Acquire) {
            return None;
        }
        // SAFETY: the slot is full, so the writer does not access it.
        let value = unsafe { (*slot.value.get()).take() };
        slot.is_full.store(false, Ordering::Release);
        self.next = after::<N>(self.next);
        value
    }
}

const fn after<const N: usize>(index: usize) -> usize {
    let next = index.wrapping_add(1);
    if next < N { next } else { 0 }
}

//! Critical sections that leave the motor's interrupt alone: they hold off what has priority 1 or less urgent.
//! Code at priority 0 must not rely on them, and does not: it shares what needs none ([`super::slot`]).
#![allow(unsafe_code)] // Priorities, and the promise that nothing at priority 0 enters a critical section.

use core::sync::atomic::{Ordering, compiler_fence};

use cortex_m::register::{basepri, basepri_max};
use critical_section::{Impl, RawRestoreState};

/// Priority 1 in the upper four bits.
const FIRST: u8 = 0x10;

struct BelowMotor;
critical_section::set_impl!(BelowMotor);

// SAFETY: what enters runs at priority 1 or below, so that nothing else that enters can interrupt it.
unsafe impl Impl for BelowMotor {
    // A call in a hundred places is less than the same four instructions there.
    #[inline(never)]
    unsafe fn acquire() -> RawRestoreState {
        let before = basepri::read();
        // Never lets through what is held off already.
        basepri_max::write(FIRST);
        compiler_fence(Ordering::SeqCst);
        before
    }

    #[inline(never)]
    unsafe fn release(before: RawRestoreState) {
        compiler_fence(Ordering::SeqCst);
        // SAFETY: what it was before `acquire`.
        unsafe { basepri::write(before) };
    }
}

/// Gives every interrupt of the chip priority 1: with the reset's priority 0 critical sections would not hold
/// it off. To be called before any interrupt is enabled.
pub fn lower_all() {
    // SAFETY: only priorities are written, and none is above what it was.
    let parts = unsafe { cortex_m::Peripherals::steal() };
    for priority in &parts.NVIC.ipr {
        // SAFETY: as above.
        unsafe { priority.write(FIRST) };
    }
}

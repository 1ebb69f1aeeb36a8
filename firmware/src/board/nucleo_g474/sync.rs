//! Synchronisation: critical sections that never mask the motor interrupt at priority 0.
#![allow(unsafe_code)] // Interrupt priorities.

use core::sync::atomic::{Ordering, compiler_fence};

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

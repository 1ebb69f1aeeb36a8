//! Memory of the running calibration, which is not cleared before `main`: with the clock after a reset that would take 7 ms.

#![allow(unsafe_code)] // A section that the start leaves as it is.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;

use static_cell::ConstStaticCell;

use crate::board::selected::crash;
use crate::model::calibration::{CalibrationMemory, CompensationMemory, POOL_INTEGERS};
use crate::tasks::calibration::Memories;

struct Uncleared<T>(UnsafeCell<MaybeUninit<T>>);

// SAFETY: `take` alone refers to the memory, once.
unsafe impl<T> Sync for Uncleared<T> {}

impl<T> Uncleared<T> {
    const fn new() -> Self {
        Self(UnsafeCell::new(MaybeUninit::uninit()))
    }

    /// Writes a value in place: it is larger than the stack.
    ///
    /// # Safety
    /// Must be called once.
    #[inline(always)]
    unsafe fn init(&'static self, value: T) -> &'static mut T {
        // SAFETY: the caller guarantees that there is no other reference.
        unsafe { (*self.0.get()).write(value) }
    }
}

#[unsafe(link_section = ".uninit.calibration")]
static CALIBRATION: Uncleared<CalibrationMemory<'static>> = Uncleared::new();
#[unsafe(link_section = ".uninit.compensations")]
static COMPENSATIONS: Uncleared<CompensationMemory<'static>> = Uncleared::new();
#[unsafe(link_section = ".uninit.pool")]
static POOL: Uncleared<[i32; POOL_INTEGERS]> = Uncleared::new();

/// Empty memory. Must be called once.
pub fn take() -> Memories<'static> {
    static ONCE: ConstStaticCell<()> = ConstStaticCell::new(());
    crash::once(ONCE.try_take());
    // SAFETY: a second call would not come this far.
    unsafe {
        Memories {
            calibration: CALIBRATION.init(CalibrationMemory::EMPTY),
            compensations: COMPENSATIONS.init(CompensationMemory::EMPTY),
            pool: POOL.init([0; POOL_INTEGERS]),
        }
    }
}

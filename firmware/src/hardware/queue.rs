//! Values from one writer to one reader, who may interrupt each other and never wait. Unlike `heapless`'s it has
//! no division by a length that is only known at run time, so no panic.
#![allow(unsafe_code)] // Each side touches a value only while its flag says that it is its own.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, Ordering};

/// Where one value lies.
#[derive(Debug)]
struct Slot<T> {
    value: UnsafeCell<Option<T>>,
    is_full: AtomicBool,
}

// SAFETY: the flag hands the value from the writer to the reader and back; there is one of each.
unsafe impl<T: Send> Sync for Slot<T> {}

/// Where the values lie.
#[derive(Debug)]
pub struct Queue<T, const N: usize>([Slot<T>; N]);

/// The writer's end.
#[derive(Debug)]
pub struct Writer<T: 'static, const N: usize> {
    slots: &'static [Slot<T>; N],
    next: usize,
}

/// The reader's end.
#[derive(Debug)]
pub struct Reader<T: 'static, const N: usize> {
    slots: &'static [Slot<T>; N],
    next: usize,
}

impl<T, const N: usize> Queue<T, N> {
    /// Empty.
    pub const fn new() -> Self {
        Self(
            [const {
                Slot {
                    value: UnsafeCell::new(None),
                    is_full: AtomicBool::new(false),
                }
            }; N],
        )
    }

    /// Its ends, one of each.
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
    /// Puts a value behind the others; it comes back where there is no room.
    pub fn put(&mut self, value: T) -> Result<(), T> {
        let Some(slot) = self.slots.get(self.next) else {
            return Err(value);
        };
        if slot.is_full.load(Ordering::Acquire) {
            return Err(value);
        }
        // SAFETY: empty, so the reader leaves it alone.
        unsafe { *slot.value.get() = Some(value) };
        slot.is_full.store(true, Ordering::Release);
        self.next = after::<N>(self.next);
        Ok(())
    }
}

impl<T, const N: usize> Reader<T, N> {
    /// Takes the first value, where there is one.
    pub fn take(&mut self) -> Option<T> {
        let slot = self.slots.get(self.next)?;
        if !slot.is_full.load(Ordering::Acquire) {
            return None;
        }
        // SAFETY: full, so the writer leaves it alone.
        let value = unsafe { (*slot.value.get()).take() };
        slot.is_full.store(false, Ordering::Release);
        self.next = after::<N>(self.next);
        value
    }
}

const fn after<const N: usize>(place: usize) -> usize {
    let next = place.wrapping_add(1);
    if next < N { next } else { 0 }
}

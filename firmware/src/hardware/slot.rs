//! One value from one writer to one reader, who may interrupt each other and never wait.
#![allow(unsafe_code)] // Each side touches the value only while the flag says that it is its own.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, Ordering};

/// Where the value lies.
#[derive(Debug)]
pub struct Slot<T> {
    value: UnsafeCell<Option<T>>,
    is_full: AtomicBool,
}

// SAFETY: the flag hands the value from the writer to the reader and back; there is one of each.
unsafe impl<T: Send> Sync for Slot<T> {}

/// The writer's end.
#[derive(Debug)]
pub struct Writer<T: 'static>(&'static Slot<T>);

/// The reader's end.
#[derive(Debug)]
pub struct Reader<T: 'static>(&'static Slot<T>);

impl<T> Slot<T> {
    /// Empty.
    pub const fn new() -> Self {
        Self {
            value: UnsafeCell::new(None),
            is_full: AtomicBool::new(false),
        }
    }

    /// Its ends, one of each.
    pub fn split(&'static mut self) -> (Writer<T>, Reader<T>) {
        (Writer(self), Reader(self))
    }
}

impl<T> Default for Slot<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T> Writer<T> {
    /// Puts a value; it comes back where the last one was not taken yet.
    pub fn put(&mut self, value: T) -> Result<(), T> {
        if self.0.is_full.load(Ordering::Acquire) {
            return Err(value);
        }
        // SAFETY: empty, so the reader leaves it alone.
        unsafe { *self.0.value.get() = Some(value) };
        self.0.is_full.store(true, Ordering::Release);
        Ok(())
    }
}

impl<T> Reader<T> {
    /// Takes the value, where there is one.
    pub fn take(&mut self) -> Option<T> {
        if !self.0.is_full.load(Ordering::Acquire) {
            return None;
        }
        // SAFETY: full, so the writer leaves it alone.
        let value = unsafe { (*self.0.value.get()).take() };
        self.0.is_full.store(false, Ordering::Release);
        value
    }
}

//! A queue between two interrupts that needs no critical section.
#![allow(unsafe_code)] // Values that are owned by one side at a time.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, Ordering};

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

#[cfg(test)]
mod tests {
    use std::boxed::Box;
    use std::string::{String, ToString};
    use std::sync::Arc;
    use std::thread;
    use std::vec::Vec;

    use super::*;

    fn queue<T, const N: usize>() -> (Writer<T, N>, Reader<T, N>) {
        Box::leak(Box::new(Queue::new())).split()
    }

    #[test]
    fn values_come_out_in_their_order_and_a_full_queue_refuses() {
        let (mut writer, mut reader) = queue::<String, 3>();
        assert_eq!(reader.pop(), None);
        for round in 0..5 {
            for number in 0..3 {
                assert_eq!(writer.push((10 * round + number).to_string()), Ok(()));
            }
            assert_eq!(writer.push("more".to_string()), Err("more".to_string()));
            let all: Vec<String> = core::iter::from_fn(|| reader.pop()).collect();
            assert_eq!(all, [0, 1, 2].map(|number| (10 * round + number).to_string()));
        }
    }

    #[test]
    fn a_queue_without_places_refuses_everything() {
        let (mut writer, mut reader) = queue::<u8, 0>();
        assert_eq!((writer.push(1), reader.pop()), (Err(1), None));
    }

    #[test]
    fn popped_values_are_dropped_once() {
        let (mut writer, mut reader) = queue::<Arc<()>, 2>();
        let value = Arc::new(());
        for _ in 0..5 {
            writer.push(Arc::clone(&value)).unwrap();
            assert_eq!(Arc::strong_count(&value), 2);
            drop(reader.pop());
            assert_eq!(Arc::strong_count(&value), 1);
        }
    }

    /// Under Miri each access is checked for races between the two sides.
    #[test]
    fn two_threads_exchange_all_values_in_their_order() {
        let count = if cfg!(miri) { 60 } else { 100_000 };
        let (mut writer, mut reader) = queue::<Box<u32>, 3>();
        let sender = thread::spawn(move || {
            for number in 0..count {
                let mut value = Box::new(number);
                while let Err(refused) = writer.push(value) {
                    value = refused;
                    thread::yield_now();
                }
            }
        });
        for number in 0..count {
            let value = loop {
                match reader.pop() {
                    Some(value) => break value,
                    None => thread::yield_now(),
                }
            };
            assert_eq!(*value, number);
        }
        sender.join().unwrap();
        assert_eq!(reader.pop(), None);
    }
}

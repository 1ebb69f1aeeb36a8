//! Virtual time: constant while tasks are ready, then it jumps to the next deadline.

use firmware::clock::Clock;
use std::cell::{Cell, RefCell};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::{Poll, Waker};

/// Virtual clock; clones share the time.
#[derive(Clone, Default)]
pub struct VirtualClock(Rc<ClockState>);

#[derive(Default)]
struct ClockState {
    now_us: Cell<u64>,
    deadlines: RefCell<BinaryHeap<Reverse<Deadline>>>,
}

struct Deadline {
    time_us: u64,
    waker: Waker,
}

impl PartialEq for Deadline {
    fn eq(&self, other: &Self) -> bool {
        self.time_us == other.time_us
    }
}

impl Eq for Deadline {}

impl PartialOrd for Deadline {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Deadline {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.time_us.cmp(&other.time_us)
    }
}

impl VirtualClock {
    /// Jumps to the next deadline and wakes its tasks. Returns false where none precedes `end_us`; then the clock
    /// jumps to `end_us`.
    pub fn advance(&self, end_us: u64) -> bool {
        let mut deadlines = self.0.deadlines.borrow_mut();
        let next_us = deadlines.peek().map_or(u64::MAX, |Reverse(next)| next.time_us);
        if next_us > end_us {
            self.0.now_us.set(self.0.now_us.get().max(end_us));
            return false;
        }
        self.0.now_us.set(self.0.now_us.get().max(next_us));
        while deadlines.peek().is_some_and(|Reverse(next)| next.time_us <= next_us) {
            if let Some(Reverse(next)) = deadlines.pop() {
                next.waker.wake();
            }
        }
        true
    }
}

impl Clock for VirtualClock {
    fn now_us(&self) -> u64 {
        self.0.now_us.get()
    }

    fn until(&self, time_us: u64) -> impl Future<Output = ()> {
        let mut waiting = false;
        poll_fn(move |context| {
            if self.0.now_us.get() >= time_us {
                return Poll::Ready(());
            }
            // Already registered when polled for another reason.
            if !std::mem::replace(&mut waiting, true) {
                let waker = context.waker().clone();
                let deadline = Deadline { time_us, waker };
                self.0.deadlines.borrow_mut().push(Reverse(deadline));
            }
            Poll::Pending
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::executor::LocalPool;
    use futures::task::LocalSpawnExt;

    #[test]
    fn deadlines_run_in_order_at_their_exact_times() {
        let clock = VirtualClock::default();
        let order = Rc::new(RefCell::new(Vec::new()));
        let mut pool = LocalPool::new();
        for time_us in [30, 10, 20, 10] {
            let (clock, order) = (clock.clone(), order.clone());
            let task = async move {
                clock.until(time_us).await;
                order.borrow_mut().push((time_us, clock.now_us()));
            };
            pool.spawner().spawn_local(task).unwrap();
        }
        pool.run_until_stalled();
        while clock.advance(25) {
            pool.run_until_stalled();
        }
        assert_eq!(*order.borrow(), [(10, 10), (10, 10), (20, 20)]);
        assert_eq!(clock.now_us(), 25);
    }
}

//! Virtual time: a clock that stands still while anything can be done, and then leaps to what is due next.

use std::cell::{Cell, RefCell};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::{Poll, Waker};

use firmware::clock::Clock;

/// The clock; its clones show the same time.
#[derive(Clone, Default)]
pub struct VirtualClock(Rc<State>);

#[derive(Default)]
struct State {
    now_us: Cell<u64>,
    due: RefCell<BinaryHeap<Reverse<Due>>>,
}

struct Due {
    time_us: u64,
    waker: Waker,
}

impl PartialEq for Due {
    fn eq(&self, other: &Self) -> bool {
        self.time_us == other.time_us
    }
}

impl Eq for Due {}

impl PartialOrd for Due {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Due {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.time_us.cmp(&other.time_us)
    }
}

impl VirtualClock {
    /// Leaps to what is due next and wakes it; where nothing is due before `end_us`, leaps there and says
    /// so by `false`.
    pub fn leap(&self, end_us: u64) -> bool {
        let mut due = self.0.due.borrow_mut();
        let next_us = due.peek().map_or(u64::MAX, |Reverse(due)| due.time_us);
        if next_us > end_us {
            self.0.now_us.set(self.0.now_us.get().max(end_us));
            return false;
        }
        self.0.now_us.set(self.0.now_us.get().max(next_us));
        while due
            .peek()
            .is_some_and(|Reverse(due)| due.time_us <= next_us)
        {
            if let Some(Reverse(due)) = due.pop() {
                due.waker.wake();
            }
        }
        true
    }
}

impl Clock for VirtualClock {
    fn now_us(&self) -> u64 {
        self.0.now_us.get()
    }

    async fn until(&self, time_us: u64) {
        let mut waiting = false;
        poll_fn(|context| {
            if self.0.now_us.get() >= time_us {
                return Poll::Ready(());
            }
            // Polled again for another reason, it is in the list already.
            if !std::mem::replace(&mut waiting, true) {
                let waker = context.waker().clone();
                let due = Due { time_us, waker };
                self.0.due.borrow_mut().push(Reverse(due));
            }
            Poll::Pending
        })
        .await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::executor::LocalPool;
    use futures::task::LocalSpawnExt;

    #[test]
    fn what_is_due_earlier_is_done_earlier_and_time_stands_still_between() {
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
        while clock.leap(25) {
            pool.run_until_stalled();
        }
        assert_eq!(*order.borrow(), [(10, 10), (10, 10), (20, 20)]);
        assert_eq!(clock.now_us(), 25);
    }
}

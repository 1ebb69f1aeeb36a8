//! Counters of what the executions of a target reached, printed at the end of its run.

use std::cell::RefCell;
use std::collections::BTreeMap;

/// Names and values of the counters of one execution.
pub type Counts<const N: usize> = [(&'static str, u32); N];

/// Sums over all executions of a thread; printed when the thread ends.
#[derive(Default)]
struct Sums {
    executions: u64,
    sums: BTreeMap<&'static str, u64>,
}

thread_local! {
    static SUMS: RefCell<Sums> = RefCell::default();
}

/// Adds the counters of one execution.
pub fn add<const N: usize>(counts: Counts<N>) {
    SUMS.with_borrow_mut(|sums| {
        sums.executions += 1;
        for (name, count) in counts {
            *sums.sums.entry(name).or_default() += u64::from(count);
        }
    });
}

impl Drop for Sums {
    fn drop(&mut self) {
        let sums: Vec<String> =
            self.sums.iter().map(|(name, sum)| format!("{name}={sum}")).collect();
        eprintln!("counters: executions={} {}", self.executions, sums.join(" "));
    }
}

//! Counters of what the executions of a target reached, printed at the end of its run.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt;

/// Names and values of the counters of one execution.
pub type Counts<const N: usize> = [(&'static str, u32); N];

/// Sums over executions.
#[derive(Debug, Default)]
pub struct Sums {
    pub executions: u64,
    sums: BTreeMap<&'static str, u64>,
}

impl Sums {
    /// Adds the counters of one execution.
    pub fn add<const N: usize>(&mut self, counts: Counts<N>) {
        self.executions += 1;
        for (name, count) in counts {
            *self.sums.entry(name).or_default() += u64::from(count);
        }
    }

    /// Sum of a counter in each execution, on average.
    #[allow(dead_code)] // The fuzz targets print sums.
    pub fn average(&self, name: &str) -> f64 {
        self.sums[name] as f64 / self.executions as f64
    }
}

impl fmt::Display for Sums {
    fn fmt(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        write!(formatter, "counters: executions={}", self.executions)?;
        self.sums.iter().try_for_each(|(name, sum)| write!(formatter, " {name}={sum}"))
    }
}

/// Prints its sums when the thread ends.
#[derive(Default)]
struct Printed(Sums);

impl Drop for Printed {
    fn drop(&mut self) {
        eprintln!("{}", self.0);
    }
}

thread_local! {
    static SUMS: RefCell<Printed> = RefCell::default();
}

/// Adds the counters of one execution to the sums of the thread.
#[allow(dead_code)] // Tests have sums of their own.
pub fn add<const N: usize>(counts: Counts<N>) {
    SUMS.with_borrow_mut(|Printed(sums)| sums.add(counts));
}

//! Runs the vectors through kernel and definition side by side, then counts; prints over semihosting.

use core::fmt::Write;
use core::panic::PanicInfo;

use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};
use cortex_m_semihosting::hio;
// The log of the library's tasks, which are linked and not run.
use defmt_rtt as _;
use firmware::model::network::{State, Weights};
use firmware::model::table::{CentrePair, EXP_ENTRIES};
use firmware::model::{grbf, gru, kernel};

use crate::copies;
use crate::counts;
use crate::vectors::{self, Machine, STEPS, SUMS};

/// Kernel and definition side by side.
#[derive(Default)]
struct Both {
    steps: u32,
    sums: u32,
    differing_bits: u32,
}

impl Both {
    fn compare(&mut self, kernel: &[i32], portable: &[i32]) {
        let differing = kernel
            .iter()
            .zip(portable)
            .map(|(a, b)| (a ^ b).count_ones());
        self.differing_bits += differing.sum::<u32>();
    }
}

impl Machine for Both {
    fn step<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
        &mut self,
        weights: &Weights<INPUTS, HIDDEN, SENSORS>,
        state: &mut State<INPUTS, HIDDEN, SENSORS>,
    ) {
        let mut portable = state.clone();
        kernel::gru::step(weights, state);
        gru::portable::step(weights, &mut portable);
        self.steps += 1;
        self.compare(
            state.full.as_flattened().as_flattened(),
            portable.full.as_flattened().as_flattened(),
        );
        self.compare(
            state.outputs.as_flattened(),
            portable.outputs.as_flattened(),
        );
        if state.upper != portable.upper || state.input != portable.input {
            self.differing_bits += 1;
        }
    }

    fn sum(&mut self, exp: &[u32; EXP_ENTRIES], pairs: &[CentrePair], at: [i16; 3]) -> [i32; 2] {
        let sum = kernel::grbf::sum(exp, pairs, at);
        self.compare(&sum, &grbf::portable(exp, pairs, at));
        self.sums += 1;
        sum
    }
}

#[cortex_m_rt::entry]
fn main() -> ! {
    let mut both = Both::default();
    let digest = vectors::run(&mut both);
    let complete = both.steps == STEPS && both.sums == SUMS && copies::wrong() == 0;
    let counted = hio::hstdout().is_ok_and(|mut out| {
        writeln!(
            out,
            "{} steps and {} sums, {} bits differ, digest {digest:016x}",
            both.steps, both.sums, both.differing_bits
        )
        .is_ok()
            && counts::print(&mut out).is_ok()
    });
    debug::exit(match complete && counted && both.differing_bits == 0 {
        true => EXIT_SUCCESS,
        false => EXIT_FAILURE,
    });
    loop {
        cortex_m::asm::wfi();
    }
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    if let Ok(mut out) = hio::hstdout() {
        let _ = writeln!(out, "{info}");
    }
    debug::exit(EXIT_FAILURE);
    loop {
        cortex_m::asm::wfi();
    }
}

//! Compares kernels with their portable definitions and memory copies with a reference, counts instructions, and prints over
//! semihosting.

use core::fmt::Write;
use core::hint::black_box;
use core::panic::PanicInfo;

use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};
use cortex_m_semihosting::hio;
// Log of the library tasks, which are linked but not run.
use defmt_rtt as _;
use firmware::model::formats::{CentrePair, EXP_ENTRIES, GruState, Weights};
use firmware::model::kernel::{self, grbf, gru};

use crate::counts::{self, Counter};
use crate::vectors::{self, Machine, STEPS, SUMS};
use crate::{grip, motor, tasks};

/// Comparison of kernel and portable definition.
#[derive(Default)]
struct Comparison {
    steps: u32,
    sums: u32,
    differing_bits: u32,
}

impl Comparison {
    fn compare(&mut self, kernel: &[i32], portable: &[i32]) {
        let differing = kernel.iter().zip(portable).map(|(a, b)| (a ^ b).count_ones());
        self.differing_bits += differing.sum::<u32>();
    }
}

impl Machine for Comparison {
    fn step<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
        &mut self,
        weights: &Weights<INPUTS, HIDDEN, SENSORS>,
        state: &mut GruState<INPUTS, HIDDEN, SENSORS>,
    ) {
        let mut portable = state.clone();
        gru::step(weights, state);
        gru::portable::step(weights, &mut portable);
        self.steps += 1;
        self.compare(
            state.full.as_flattened().as_flattened(),
            portable.full.as_flattened().as_flattened(),
        );
        self.compare(state.outputs.as_flattened(), portable.outputs.as_flattened());
        self.compare(
            state.recurrent.as_flattened().as_flattened().as_flattened(),
            portable.recurrent.as_flattened().as_flattened().as_flattened(),
        );
        if state.upper != portable.upper || state.input != portable.input {
            self.differing_bits += 1;
        }
    }

    fn sum(&mut self, exp: &[u32; EXP_ENTRIES], pairs: &[CentrePair], at: [i16; 3]) -> [i32; 2] {
        let sum = kernel::grbf::assembly(exp, pairs, at);
        self.compare(&sum, &grbf::portable(exp, pairs, at));
        self.sums += 1;
        sum
    }
}

/// Prints the instructions of kernels, motor control, grip and tasks.
fn print_counts(out: &mut impl Write) -> core::fmt::Result {
    let counter = Counter::new().ok_or(core::fmt::Error)?;
    counts::print(&counter, out)?;
    motor::print(&counter, out)?;
    grip::print(&counter, out)?;
    tasks::print(&counter, out)
}

#[cortex_m_rt::entry]
fn main() -> ! {
    kernel::copy_to_ccm();
    let mut comparison = Comparison::default();
    let digest = vectors::run(&mut comparison);
    let complete = comparison.steps == STEPS && comparison.sums == SUMS && wrong_copies() == 0;
    let counted = hio::hstdout().is_ok_and(|mut out| {
        writeln!(
            out,
            "{} steps and {} sums, {} bits differ, digest {digest:016x}",
            comparison.steps, comparison.sums, comparison.differing_bits
        )
        .is_ok()
            && print_counts(&mut out).is_ok()
    });
    let is_successful = complete && counted && comparison.differing_bits == 0;
    debug::exit(if is_successful { EXIT_SUCCESS } else { EXIT_FAILURE });
    loop {
        cortex_m::asm::wfi();
    }
}

/// Longest copy, and size of the buffers.
const MAX_COPY_BYTES: usize = 70;
const BUFFER_BYTES: usize = 96;
const FILL: u8 = 0xA5;

/// Count of wrong copies, over every length up to a few words and every alignment.
fn wrong_copies() -> u32 {
    let mut wrong = 0;
    let mut from = Buffer([0; BUFFER_BYTES]);
    for (byte, value) in from.0.iter_mut().zip(1..) {
        *byte = value;
    }
    for source in 0..8 {
        for target in 0..8 {
            for length in 0..=MAX_COPY_BYTES {
                wrong += u32::from(!is_right(&from, source, target, length).unwrap_or(false));
            }
        }
    }
    wrong
}

#[repr(align(8))]
struct Buffer([u8; BUFFER_BYTES]);

fn is_right(from: &Buffer, source: usize, target: usize, length: usize) -> Option<bool> {
    let mut to = Buffer([FILL; BUFFER_BYTES]);
    let bytes = black_box(from.0.get(source..source + length)?);
    black_box(to.0.get_mut(target..target + length)?).copy_from_slice(bytes);
    let expected = |at: usize| match at.checked_sub(target) {
        Some(index) if index < length => bytes.get(index).copied(),
        _ => Some(FILL),
    };
    Some(black_box(&to.0).iter().enumerate().all(|(at, byte)| expected(at) == Some(*byte)))
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

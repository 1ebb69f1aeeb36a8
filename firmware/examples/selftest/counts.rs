//! Counts executed instructions: the emulator's clock advances by the same time with every instruction
//! (`-icount`), and the core's own timer reads that clock.

use core::fmt::{Error, Result, Write};
use core::hint::black_box;

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{Peripherals, SYST};
use firmware::model::formats::{GruState, Weights};
use firmware::model::kernel::{grbf, gru};
use firmware::protocol::authentication::{Key, SessionMac};

use crate::vectors::{self, Random};

/// Number of inputs; all must take the same number of instructions.
const TRIALS: u32 = 40;
/// Iterations of a loop of two instructions that calibrates the timer.
const ITERATIONS: u32 = 10_000;
/// Instructions of these iterations.
const CALIBRATION_INSTRUCTIONS: u32 = 2 * ITERATIONS;

/// Prints name and instructions per call of each kernel.
pub fn print(counter: &Counter, out: &mut impl Write) -> Result {
    network::<2, 4, 1>("gru_3_8", counter, out)?;
    network::<2, 8, 1>("gru_3_16", counter, out)?;
    network::<6, 16, 1>("gru_12_32", counter, out)?;
    network::<6, 16, 4>("gru_12_32_16", counter, out)?;
    for (name, pairs) in [("grbf_25", 13), ("grbf_50", 25), ("grbf_100", 50)] {
        basis_functions(name, pairs, counter, out)?;
    }
    authentication(counter, out)
}

/// Check of the code of a message, and the keys of a session.
fn authentication(counter: &Counter, out: &mut impl Write) -> Result {
    let mut random = Random(13);
    let (mut check, mut open) = (Counts::default(), Counts::default());
    for trial in 0..TRIALS {
        let key = Key([random.word() as u8; 16]);
        let challenge = random.word() as u64;
        open.add(counter.instructions(|| {
            black_box(SessionMac::new(&key, 16, black_box(challenge)));
        }));
        let mac = SessionMac::new(&key, 16, challenge);
        let message = (random.word() as u64).to_le_bytes();
        let tag = mac.tag(trial.into(), 0x203, message);
        check.add(counter.instructions(|| {
            black_box(mac.is_valid(trial.into(), 0x203, black_box(message), tag));
        }));
    }
    open.print("session_keys", out)?;
    check.print("message_code", out)
}

/// A whole call of [`gru::step`].
fn network<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    name: &str,
    counter: &Counter,
    out: &mut impl Write,
) -> Result {
    let mut weights: Weights<INPUTS, HIDDEN, SENSORS> = vectors::zero_weights();
    let mut random = Random(7);
    let mut state = GruState::RESET;
    let mut counts = Counts::default();
    for trial in 0..TRIALS {
        vectors::draw(&mut weights, trial % 3, &mut random);
        state.input = vectors::inputs(&mut random, trial * 7);
        counts.add(counter.instructions(|| gru::step(&weights, &mut state)));
    }
    counts.print(name, out)
}

/// A whole call of [`grbf::sum`].
fn basis_functions(name: &str, pairs: usize, counter: &Counter, out: &mut impl Write) -> Result {
    let mut random = Random(11);
    let mut counts = Counts::default();
    for trial in 0..TRIALS {
        let (exp, all) = vectors::centres(&mut random, trial % 3 == 0);
        let used = all.get(..pairs).ok_or(Error)?;
        let at = vectors::coordinates(&mut random, trial % 3 == 0);
        counts.add(counter.instructions(|| {
            black_box(grbf::sum(&exp, used, at));
        }));
    }
    counts.print(name, out)
}

/// The counts of one kernel over several inputs.
#[derive(Default)]
struct Counts {
    runs: u32,
    range: Option<(u32, u32)>,
}

impl Counts {
    /// The first run of a code section is not counted: the emulator translates it, and its clock is off by one instruction.
    fn add(&mut self, count: u32) {
        if self.runs > 0 {
            let (min, max) = self.range.unwrap_or((count, count));
            self.range = Some((min.min(count), max.max(count)));
        }
        self.runs += 1;
    }

    fn print(&self, name: &str, out: &mut impl Write) -> Result {
        match self.range {
            Some((min, max)) if min == max => writeln!(out, "{name} {min}"),
            Some((min, max)) => {
                writeln!(out, "{name} takes {min} to {max} instructions")?;
                Err(Error)
            }
            None => Err(Error),
        }
    }
}

/// Ticks of the core's timer during [`CALIBRATION_INSTRUCTIONS`] instructions.
pub struct Counter {
    ticks_per_calibration: u32,
    /// Ticks of an empty measurement.
    overhead: u32,
}

impl Counter {
    /// Takes the core's timer and calibrates it; `None` if it is taken or does not count.
    pub fn new() -> Option<Self> {
        let mut timer = Peripherals::take()?.SYST;
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(0x00ff_ffff);
        timer.clear_current();
        timer.enable_counter();
        let mut counter = Self { ticks_per_calibration: 0, overhead: 0 };
        // Twice, because the first run of a code section is not counted. The difference of two runs contains only iterations.
        for _ in 0..2 {
            let [short, long] = [ITERATIONS, 2 * ITERATIONS]
                .map(|iterations| Self::ticks(|| cortex_m::asm::delay(iterations)));
            counter.ticks_per_calibration = long.checked_sub(short)?;
            counter.overhead = Self::ticks(|| ());
        }
        // Fewer than two ticks per instruction would not resolve single instructions.
        (counter.ticks_per_calibration >= 2 * CALIBRATION_INSTRUCTIONS).then_some(counter)
    }

    /// One code section for each closure: not inlined, not unrolled.
    #[inline(never)]
    fn ticks(work: impl FnOnce()) -> u32 {
        let before = SYST::get_current();
        work();
        let after = SYST::get_current();
        before.wrapping_sub(after) & 0x00ff_ffff
    }

    /// Instructions of a closure.
    pub fn instructions(&self, work: impl FnOnce()) -> u32 {
        let ticks = Self::ticks(work).saturating_sub(self.overhead);
        let rounded = u64::from(ticks) * u64::from(CALIBRATION_INSTRUCTIONS)
            + u64::from(self.ticks_per_calibration / 2);
        (rounded / u64::from(self.ticks_per_calibration)) as u32
    }
}

//! Counts executed instructions: the emulator's clock advances by the same time with every instruction
//! (`-icount`), and the core's own timer reads that clock.

use core::fmt::{Error, Result, Write};
use core::hint::black_box;

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{Peripherals, SYST};
use firmware::model::grbf;
use firmware::model::gru;
use firmware::model::network::{State, Weights};

use crate::grip;
use crate::loops;
use crate::motor;
use crate::vectors::{self, Random};

/// Inputs that must all take the same number of instructions.
const INPUTS_TRIED: u32 = 40;
/// Turns of a loop of two instructions, of which the timer's pace is learnt.
const TURNS: u32 = 10_000;
/// Instructions of these turns.
const PACE: u32 = 2 * TURNS;

/// A line for each kernel: its name, and how many instructions one call takes.
pub fn print(out: &mut impl Write) -> Result {
    let counter = Counter::new().ok_or(Error)?;
    network::<2, 4, 1>("gru_3_8", &counter, out)?;
    network::<2, 8, 1>("gru_3_16", &counter, out)?;
    network::<6, 16, 1>("gru_12_32", &counter, out)?;
    network::<6, 16, 4>("gru_12_32_16", &counter, out)?;
    for (name, pairs) in [("grbf_25", 13), ("grbf_50", 25), ("grbf_100", 50)] {
        basis_functions(name, pairs, &counter, out)?;
    }
    motor::print(&counter, out)?;
    grip::print(&counter, out)?;
    loops::print(&counter, out)
}

/// A whole call of [`gru::step`].
fn network<const INPUTS: usize, const HIDDEN: usize, const SENSORS: usize>(
    name: &str,
    counter: &Counter,
    out: &mut impl Write,
) -> Result {
    let mut weights: Weights<INPUTS, HIDDEN, SENSORS> = vectors::nothing();
    let mut random = Random(7);
    let mut state = State::RESET;
    let mut counts = Counts::default();
    for tried in 0..INPUTS_TRIED {
        vectors::draw(&mut weights, tried % 3, &mut random);
        state.input = vectors::inputs(&mut random, tried * 7);
        counts.add(counter.instructions(|| gru::step(&weights, &mut state)));
    }
    counts.print(name, out)
}

/// A whole call of [`grbf::sum`].
fn basis_functions(name: &str, pairs: usize, counter: &Counter, out: &mut impl Write) -> Result {
    let mut random = Random(11);
    let mut counts = Counts::default();
    for tried in 0..INPUTS_TRIED {
        let (exp, all) = vectors::centres(&mut random, tried % 3 == 0);
        let used = all.get(..pairs).ok_or(Error)?;
        let at = vectors::coordinates(&mut random, tried % 3 == 0);
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
    /// The first run of a piece of code does not count: the emulator translates it meanwhile, and its
    /// clock is off by an instruction.
    fn add(&mut self, count: u32) {
        if self.runs > 0 {
            let (least, greatest) = self.range.unwrap_or((count, count));
            self.range = Some((least.min(count), greatest.max(count)));
        }
        self.runs += 1;
    }

    fn print(&self, name: &str, out: &mut impl Write) -> Result {
        match self.range {
            Some((least, greatest)) if least == greatest => writeln!(out, "{name} {least}"),
            Some((least, greatest)) => {
                writeln!(out, "{name} takes {least} to {greatest} instructions")?;
                Err(Error)
            }
            None => Err(Error),
        }
    }
}

/// Ticks of the core's timer during [`PACE`] instructions.
pub struct Counter {
    pace: u32,
    /// Ticks around nothing.
    nothing: u32,
}

impl Counter {
    fn new() -> Option<Self> {
        let mut timer = Peripherals::take()?.SYST;
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(0x00ff_ffff);
        timer.clear_current();
        timer.enable_counter();
        let mut counter = Self {
            pace: 0,
            nothing: 0,
        };
        // Twice, for the first run of a piece of code does not count. The difference of two runs of
        // the loop holds nothing but its turns.
        for _ in 0..2 {
            let [short, long] =
                [TURNS, 2 * TURNS].map(|turns| Self::ticks(|| cortex_m::asm::delay(turns)));
            counter.pace = long.checked_sub(short)?;
            counter.nothing = Self::ticks(|| ());
        }
        // Less than two ticks to an instruction would not tell one more from one less.
        (counter.pace >= 2 * PACE).then_some(counter)
    }

    /// One piece of code for each kind of work: not inlined, not unrolled.
    #[inline(never)]
    fn ticks(work: impl FnOnce()) -> u32 {
        let before = SYST::get_current();
        work();
        let after = SYST::get_current();
        before.wrapping_sub(after) & 0x00ff_ffff
    }

    /// Instructions of some work.
    pub fn instructions(&self, work: impl FnOnce()) -> u32 {
        let ticks = Self::ticks(work).saturating_sub(self.nothing);
        let rounded = u64::from(ticks) * u64::from(PACE) + u64::from(self.pace / 2);
        (rounded / u64::from(self.pace)) as u32
    }
}

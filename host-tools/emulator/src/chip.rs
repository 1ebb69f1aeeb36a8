//! A chip with an image in its flash: runs, resets, loses its supply, and tells where its time goes.

use std::collections::HashMap;
use std::fmt;

use crate::core::system_control::{FIRST_INTERRUPT, HARD_FAULT, NMI};
use crate::core::{Core, CycleModel, Pause, Statistics, Stop};
use crate::devices::Devices;
use crate::image::Image;
use crate::log::{Log, LogLine};
use crate::peripherals::clocks::ResetCause;
use crate::peripherals::watchdog::Feeds;
use crate::registers::interrupt_name;
use crate::soc::{Options, Soc};
use crate::time::{Frequency, Time};

/// How often the log is read: its buffer in the chip holds a kilobyte.
const LOG_PERIOD: Time = Time::from_us(100);

/// Why a chip goes no further.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Halt {
    /// BOOT0 was high at the reset: the chip waits in its boot loader (RM0440 2.6.1). The image never runs.
    #[error("BOOT0 is high at the reset and nSWBOOT0 = 1: the chip is in its boot loader")]
    BootLoader,
    /// The supply was cut, as [`crate::peripherals::flash::Flash::cut_power`] asked for.
    #[error("the supply is cut")]
    PowerLost,
    /// An instruction that the emulator cannot go on from.
    #[error(transparent)]
    Stopped(#[from] Stop),
}

/// A reset, and what went before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ResetRecord {
    /// When.
    pub time: Time,
    /// Why.
    pub cause: ResetCause,
    /// Program counter at that moment.
    pub pc: u32,
    /// How the watchdog was fed since the reset before.
    pub feeds: Feeds,
}

/// What the core is able to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum CoreState {
    Running,
    /// A fault where none can be handled: it waits for a reset.
    LockedUp,
    /// In reset while the supply is too low.
    Held,
    /// By a debugger.
    Halted,
}

/// The chip.
pub struct Chip {
    core: Core,
    state: CoreState,
    /// Everything but the core.
    pub soc: Soc,
    image: Image,
    log: Log,
    logged: Time,
    /// Resets since power-on.
    pub resets: Vec<ResetRecord>,
    measured_from: Time,
    asleep: Time,
    sampler: Option<Sampler>,
}

/// Program counters at regular times.
#[derive(Clone, Debug)]
struct Sampler {
    period: Time,
    next: Time,
    counts: HashMap<u32, u64>,
    /// Samples, those of a sleeping core included.
    total: u64,
}

impl Chip {
    /// Programs an image into a chip and switches it on.
    ///
    /// # Errors
    /// [`Halt::BootLoader`], or a vector table that cannot be read.
    pub fn new(
        image: Image,
        model: CycleModel,
        options: Options,
        devices: Devices,
    ) -> Result<Self, Halt> {
        let mut soc = Soc::new(options, devices);
        for (offset, bytes) in &image.segments {
            soc.load_flash(*offset, bytes);
        }
        let log = Log::new(&image);
        let mut chip = Self {
            core: Core::new(model),
            state: CoreState::Running,
            soc,
            image,
            log,
            logged: Time::ZERO,
            resets: Vec::new(),
            measured_from: Time::ZERO,
            asleep: Time::ZERO,
            sampler: None,
        };
        chip.start()?;
        Ok(chip)
    }

    /// A copy in its present state, with other devices, which must be in the state of its own. A line of the log that has begun
    /// is lost.
    pub fn copy(&self, devices: Devices) -> Self {
        Self {
            core: self.core.clone(),
            state: self.state,
            soc: self.soc.copy(devices),
            image: self.image.clone(),
            log: self.log.copy(),
            logged: self.logged,
            resets: self.resets.clone(),
            measured_from: self.measured_from,
            asleep: self.asleep,
            sampler: self.sampler.clone(),
        }
    }

    fn start(&mut self) -> Result<(), Halt> {
        self.log.restart();
        if self.soc.is_browned_out() {
            self.state = CoreState::Held;
            return Ok(());
        }
        self.state = CoreState::Running;
        if !self.soc.boots_from_flash() {
            return Err(Halt::BootLoader);
        }
        self.core.reset(&mut self.soc)?;
        Ok(())
    }

    /// The image.
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// Time since power-on.
    pub fn now(&self) -> Time {
        self.soc.now()
    }

    /// Goes on until this time, across resets.
    ///
    /// # Errors
    /// [`Halt`]. After [`Halt::PowerLost`], [`Self::power_cycle`] starts the chip again; a breakpoint can be passed by
    /// calling again.
    pub fn run_until(&mut self, end: Time) -> Result<(), Halt> {
        while self.now() < end {
            if self.state == CoreState::Held && !self.soc.is_browned_out() {
                self.start()?;
            }
            let sample = self.sampler.as_ref().map_or(Time::NEVER, |sampler| sampler.next);
            self.soc.run_to(end.min(self.logged + LOG_PERIOD).min(sample));
            let asleep = self.asleep;
            let result = self.run_to_pause();
            if self.now() >= sample {
                self.sample(self.asleep > asleep);
            }
            if self.now() >= self.logged + LOG_PERIOD {
                self.logged = self.now();
                self.log.read(&mut self.soc);
            }
            match result {
                Err(Halt::Stopped(Stop::ResetRequested)) => self.reset(ResetCause::Software)?,
                Err(Halt::Stopped(Stop::LockUp { .. })) => {
                    self.state = CoreState::LockedUp;
                    self.soc.lock_up();
                }
                result => result?,
            }
            if self.soc.flash.take_power_loss() {
                self.log.read(&mut self.soc);
                return Err(Halt::PowerLost);
            }
            if let Some(cause) = self.soc.take_reset() {
                self.reset(cause)?;
            }
        }
        Ok(())
    }

    /// Notes where the core is at regular times: [`Profile::functions`] then tells in which functions it spends them. The
    /// period should share no factor with those of the program.
    pub fn sample_every(&mut self, period: Time) {
        self.sampler =
            Some(Sampler { period, next: self.now() + period, counts: HashMap::new(), total: 0 });
    }

    fn sample(&mut self, is_asleep: bool) {
        let (now, pc) = (self.now(), self.core.pc());
        if let Some(sampler) = &mut self.sampler {
            sampler.next = now + sampler.period;
            sampler.total += 1;
            if !is_asleep {
                *sampler.counts.entry(pc).or_default() += 1;
            }
        }
    }

    /// Functions by their share of the core's time, the greatest first.
    fn functions(&self) -> Vec<(String, f64)> {
        let Some(sampler) = &self.sampler else {
            return Vec::new();
        };
        let mut shares: HashMap<String, f64> = HashMap::new();
        for (pc, count) in &sampler.counts {
            let name = self
                .image
                .symbol_at(*pc)
                .map_or_else(|| format!("{pc:#010x}"), |symbol| symbol.name.clone());
            *shares.entry(name).or_default() += *count as f64 / sampler.total as f64;
        }
        let mut shares: Vec<_> = shares.into_iter().collect();
        shares.sort_by(|one, other| other.1.total_cmp(&one.1).then_with(|| one.0.cmp(&other.0)));
        shares
    }

    /// Runs to the next event or the end, and handles it.
    fn run_to_pause(&mut self) -> Result<(), Halt> {
        let runs = self.state == CoreState::Running && self.soc.core_clock() > Frequency(0);
        let pause = if runs { self.core.run(&mut self.soc)? } else { Pause::Asleep };
        if pause == Pause::Asleep {
            let passed = self.soc.skip();
            self.asleep += passed;
        }
        self.soc.advance();
        Ok(())
    }

    fn reset(&mut self, cause: ResetCause) -> Result<(), Halt> {
        self.log.read(&mut self.soc);
        let record = ResetRecord {
            time: self.now(),
            cause,
            pc: self.core.pc(),
            feeds: *self.soc.iwdg.feeds(),
        };
        self.resets.push(record);
        match cause {
            // A brown-out: memories but flash are lost.
            ResetCause::PowerOn => self.soc.power_on(),
            _ => self.soc.reset(cause),
        }
        self.start()
    }

    /// Takes the supply away and gives it back: memories but flash are lost.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn power_cycle(&mut self) -> Result<(), Halt> {
        self.soc.power_on();
        self.start()
    }

    /// The core's registers, for fault injection and reports.
    pub fn core(&self) -> &Core {
        &self.core
    }

    /// As [`Self::core`], to change them.
    pub fn core_mut(&mut self) -> &mut Core {
        &mut self.core
    }

    /// A debugger that has asked for the whole log stops reading it: its cable is pulled, or its program has ended.
    pub fn stall_log(&mut self) {
        self.log.stall(&mut self.soc);
    }

    /// A debugger halts the core, or lets it run again.
    pub fn set_halted(&mut self, is_halted: bool) {
        self.state = if is_halted { CoreState::Halted } else { CoreState::Running };
        self.soc.set_halted(is_halted);
    }

    /// Lines of the log so far.
    pub fn log(&self) -> &[LogLine] {
        &self.log.lines
    }

    /// Takes the lines of the log.
    pub fn take_log(&mut self) -> Vec<LogLine> {
        std::mem::take(&mut self.log.lines)
    }

    /// How the watchdog has been fed since the last reset.
    pub fn feeds(&self) -> &Feeds {
        self.soc.iwdg.feeds()
    }

    /// Begins to measure anew.
    pub fn clear_profile(&mut self) {
        self.core.clear_statistics();
        self.asleep = Time::ZERO;
        self.measured_from = self.now();
    }

    /// Where the time went since the measurement began.
    pub fn profile(&mut self) -> Profile {
        let clock = self.soc.core_clock();
        let duration = self.now() - self.measured_from;
        let (stack, functions) = (self.stack(), self.functions());
        let (soc, statistics) = (&self.soc, self.core.statistics());
        Profile { functions, ..Profile::new(soc, statistics, clock, duration, self.asleep, stack) }
    }

    /// Lowest and highest address of the main stack, as the linker script says.
    pub fn stack(&self) -> Option<[u32; 2]> {
        let address = |name| {
            self.image
                .symbols_named(name)
                .find(|symbol| symbol.name == name)
                .map(|symbol| symbol.address)
        };
        Some([address("_stack_end")?, address("_stack_start")?])
    }
}

/// Load of one exception, or of thread mode.
#[derive(Clone, Debug, PartialEq)]
pub struct Load {
    /// Interrupt, exception, or `thread`.
    pub name: String,
    /// Priority level, 0 the most urgent; none for thread mode and what has a fixed one.
    pub level: Option<u8>,
    /// Share of the core's time.
    pub share: f64,
    /// Instructions in a millisecond.
    pub instructions_per_ms: f64,
    /// Entries in a second.
    pub entries_per_s: f64,
    /// Longest time from an entry to its return, preemption by more urgent ones included.
    pub longest: Time,
    /// Longest time that it waited for its entry.
    pub latency: Time,
}

/// Where the core's time went.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// What was measured.
    pub duration: Time,
    /// The core's clock.
    pub clock: Frequency,
    /// Share of the time in which the core slept.
    pub idle: f64,
    /// Most urgent first, thread mode last.
    pub loads: Vec<Load>,
    /// Bytes of stack used at the most, and available.
    pub stack: Option<[u32; 2]>,
    /// Functions by their share of the core's time, the greatest first; empty without [`Chip::sample_every`].
    pub functions: Vec<(String, f64)>,
}

/// Functions that are worth a line.
const FUNCTIONS: usize = 12;

impl Profile {
    fn new(
        soc: &Soc,
        statistics: &Statistics,
        clock: Frequency,
        duration: Time,
        asleep: Time,
        stack: Option<[u32; 2]>,
    ) -> Self {
        let cycles = duration.ps() as f64 / clock.period().ps() as f64;
        let used =
            statistics.by_exception.iter().enumerate().filter(|(_, load)| load.instructions > 0);
        let mut loads: Vec<_> = used
            .map(|(number, load)| Load {
                name: exception_name(number as u16),
                level: if number == 0 { None } else { soc.priority_level(number as u16) },
                share: load.cycles as f64 / cycles,
                instructions_per_ms: load.instructions as f64 / (1e3 * duration.as_s()),
                entries_per_s: load.entries as f64 / duration.as_s(),
                longest: clock.cycles(load.longest_cycles),
                latency: clock.cycles(load.longest_latency_cycles),
            })
            .collect();
        let urgency = |load: &Load| match (load.level, load.name.as_str()) {
            (_, THREAD) => u8::MAX,
            (Some(level), _) => level + 1,
            (None, _) => 0,
        };
        loads.sort_by_key(urgency);
        let stack = stack.map(|[lowest, highest]| {
            let used = highest.saturating_sub(statistics.lowest_msp.clamp(lowest, highest));
            [used, highest - lowest]
        });
        Self {
            duration,
            clock,
            idle: asleep.ps() as f64 / duration.ps().max(1) as f64,
            loads,
            stack,
            functions: Vec::new(),
        }
    }

    /// Share of the core's time at each priority level, the most urgent first; none is thread mode.
    pub fn by_level(&self) -> Vec<(Option<u8>, f64)> {
        let mut levels: Vec<(Option<u8>, f64)> = Vec::new();
        for load in &self.loads {
            match levels.iter_mut().find(|(level, _)| *level == load.level) {
                Some((_, share)) => *share += load.share,
                None => levels.push((load.level, load.share)),
            }
        }
        levels
    }
}

impl fmt::Display for Profile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:.3} s at {} MHz, core idle {:.1} %",
            self.duration.as_s(),
            self.clock.0 / 1_000_000,
            100.0 * self.idle
        )?;
        writeln!(
            f,
            "{:<22} {:>5} {:>8} {:>15} {:>10} {:>11} {:>11}",
            "exception", "level", "load", "instructions/ms", "entries/s", "longest", "latency"
        )?;
        for load in &self.loads {
            let level = load.level.map_or("-".to_owned(), |level| level.to_string());
            writeln!(
                f,
                "{:<22} {level:>5} {:>6.2} % {:>15.0} {:>10.0} {:>8.1} us {:>8.1} us",
                load.name,
                100.0 * load.share,
                load.instructions_per_ms,
                load.entries_per_s,
                load.longest.ns() as f64 / 1e3,
                load.latency.ns() as f64 / 1e3
            )?;
        }
        if let Some([used, available]) = self.stack {
            writeln!(
                f,
                "stack {used} of {available} bytes, {:.0} %",
                100.0 * f64::from(used) / f64::from(available.max(1))
            )?;
        }
        for (name, share) in self.functions.iter().take(FUNCTIONS) {
            writeln!(f, "{:>6.2} % in {name}", 100.0 * share)?;
        }
        Ok(())
    }
}

const THREAD: &str = "thread";

fn exception_name(number: u16) -> String {
    match number {
        0 => THREAD.to_owned(),
        NMI => "NMI".to_owned(),
        HARD_FAULT => "HardFault".to_owned(),
        FIRST_INTERRUPT.. => interrupt_name(usize::from(number - FIRST_INTERRUPT)).to_owned(),
        _ => format!("exception {number}"),
    }
}

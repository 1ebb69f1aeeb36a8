//! Reads every sensor each millisecond: two buses side by side, two sensors on each.

use core::pin::pin;
use core::sync::atomic::Ordering;

use embassy_futures::join::join;
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::{Exchange, Finder};
use crate::clock::{Clock, within};
use crate::events::Event;
use crate::frame::{Frame, SENSORS};
use crate::hall::bus::SensorBus;
use crate::hall::read_back::{ReadBack, Word};
use crate::hall::watch::{Watch, Watched};
use crate::hall::{self, Part, Sample, TRANSFER_BYTES, WORD_BYTES};
use crate::limits::Limits;
use crate::params::{SENSE_LIMIT_US, TICK_US, TRANSFER_LIMIT_US};
use crate::progress::Loop;
use crate::status::{Fault, Faults};

/// A tick that begins later than this is skipped: its frame would be no millisecond after the last.
const LATE_US: u64 = 50;
/// The first tick begins this long after the loop: probing every address takes 1 ms at the most.
pub const FIRST_TICK_US: u64 = 2_000;
/// Ticks after a clearing that did not help until the next: a bus without sensors is free, and silent.
const PATIENCE: u8 = 100;

/// What one tick of sensing gave.
#[derive(Clone, Copy, Debug)]
pub struct Sensed {
    /// The readings that may be used.
    pub frame: Frame,
    /// Every sensor's condition and age.
    pub watched: [Watched; SENSORS],
    /// When the tick began, in microseconds since boot.
    pub begun_us: u64,
}

/// Probes both buses and then reads the sensors at `addresses`, the first two on the first bus, for ever.
///
/// Within a tick a bus repeats one transfer at the most, and only where the others still find their time.
/// After three failed ones in a row it is cleared; the other bus goes on meanwhile. Once the readings are handed over,
/// a sensor's configuration is read back, in its turn; a bus from which an unexpected word comes is cleared as well.
pub async fn sense<P: Part, B: SensorBus, C: Clock, M: RawMutex>(
    [first, second]: [B; 2],
    addresses: [u8; SENSORS],
    limits: &Limits,
    clock: &C,
    exchange: &Exchange<M>,
) -> ! {
    let [a, b, c, d] = addresses;
    let mut begin_us = clock.now_us().saturating_add(FIRST_TICK_US);
    let mut first = Line::new(first, 0, limits);
    let mut second = Line::new(second, 1, limits);
    join(
        first.probe::<P, C, M>(clock, exchange),
        second.probe::<P, C, M>(clock, exchange),
    )
    .await;
    let mut watches = [Watch::new(limits); SENSORS];
    let mut read_back = ReadBack::new(limits);
    let mut faults = Faults::default();
    let mut missed = 0_u32;
    loop {
        clock.until(begin_us).await;
        let now_us = clock.now_us();
        let late_us = now_us.saturating_sub(begin_us);
        if late_us > LATE_US {
            let ticks = (late_us as u32).div_ceil(TICK_US as u32);
            begin_us = begin_us.saturating_add(u64::from(ticks) * TICK_US);
            missed = missed.saturating_add(ticks);
            exchange
                .counts
                .ticks_missed
                .store(missed, Ordering::Relaxed);
            let fault = (Fault::TicksMissed, 0);
            exchange.note(Finder::Sense, &mut faults, fault, true, missed);
            continue;
        }
        exchange.progress.check_in(Loop::Sense);
        let ([r0, r1], [r2, r3]) = join(
            first.read::<P, C, M>([a, b], now_us, clock, exchange),
            second.read::<P, C, M>([c, d], now_us, clock, exchange),
        )
        .await;
        for line in [(&first.stuck, 0), (&second.stuck, 1)] {
            let (stuck, bus) = line;
            let fault = (Fault::BusStuck, bus);
            exchange.note(
                Finder::Sense,
                &mut faults,
                fault,
                *stuck >= limits.stuck_ticks,
                0,
            );
        }
        let mut samples = [r0, r1, r2, r3];
        let answer = samples.map(|sample| sample.is_some());
        read_back.sift(&mut samples);
        let mut samples = samples.into_iter();
        let watched = watches
            .each_mut()
            .map(|watch| watch.note(samples.next().flatten()));
        exchange.sensed.signal(Sensed {
            frame: Frame {
                time_us: now_us as u32,
                readings: watched.map(|sensor| sensor.reading),
            },
            watched,
            begun_us: now_us,
        });
        let sensor = read_back.turn();
        if clock.now_us() <= now_us.saturating_add(SENSE_LIMIT_US - TRANSFER_LIMIT_US) {
            let line = if sensor < 2 { &mut first } else { &mut second };
            let at = addresses
                .get(sensor)
                .filter(|_| answer.get(sensor) == Some(&true));
            let is_read = match at {
                Some(address) => {
                    let word = (P::CONFIGURATION, WORD_BYTES);
                    line.transfer(*address, word, clock, exchange).await
                }
                None => false,
            };
            let [upper, lower, ..] = line.bytes;
            if read_back.update(is_read.then_some([upper, lower])) == Word::Unexpected {
                // Bytes may be shifted; a sensor that has changed is found at the next look.
                line.clear(exchange).await;
            }
        }
        begin_us = begin_us.saturating_add(TICK_US);
    }
}

/// The first of some registers, and how many bytes of them.
type Registers = (u8, usize);

const fn reading<P: Part>() -> Registers {
    (P::READING, TRANSFER_BYTES)
}

/// A bus and how it has behaved.
struct Line<B> {
    bus: B,
    number: u8,
    /// What the last transfer read.
    bytes: [u8; TRANSFER_BYTES],
    /// Transfers in a row that fail before it is cleared.
    limit: u8,
    /// Transfers in a row that failed.
    failed: u8,
    /// Both lines were high after the last clearing.
    free: bool,
    /// Ticks in a row with a line held low.
    stuck: u8,
    /// Ticks until clearing may be tried again.
    patience: u8,
}

impl<B: SensorBus> Line<B> {
    const fn new(bus: B, number: u8, limits: &Limits) -> Self {
        Self {
            limit: limits.failed_transfers,
            bus,
            number,
            bytes: [0; TRANSFER_BYTES],
            failed: 0,
            free: true,
            stuck: 0,
            patience: 0,
        }
    }

    /// Tells which of the part's addresses answer.
    async fn probe<P: Part, C: Clock, M: RawMutex>(&mut self, clock: &C, exchange: &Exchange<M>) {
        let mut answers = 0;
        for (bit, address) in P::ADDRESSES.into_iter().enumerate() {
            let answer = self.attempt(address, reading::<P>(), clock).await;
            answers |= u8::from(answer) << bit;
        }
        let bus = self.number;
        exchange.events.post(Event::Found { bus, answers });
    }

    /// Reads both sensors in the tick that began at `begun_us`.
    async fn read<P: Part, C: Clock, M: RawMutex>(
        &mut self,
        addresses: [u8; 2],
        begun_us: u64,
        clock: &C,
        exchange: &Exchange<M>,
    ) -> [Option<Sample>; 2] {
        self.patience = self.patience.saturating_sub(1);
        if !self.free {
            self.clear(exchange).await;
        }
        let mut samples = [None; 2];
        if !self.free {
            return samples;
        }
        let end_us = begun_us.saturating_add(SENSE_LIMIT_US);
        let mut may_repeat = true;
        // Time that the transfers after this one may take.
        let mut reserved_us = addresses.len() as u64 * TRANSFER_LIMIT_US;
        for (sample, address) in samples.iter_mut().zip(addresses) {
            reserved_us = reserved_us.saturating_sub(TRANSFER_LIMIT_US);
            let mut is_read = self
                .transfer(address, reading::<P>(), clock, exchange)
                .await;
            let done_us = clock.now_us().saturating_add(TRANSFER_LIMIT_US);
            if !is_read && may_repeat && done_us.saturating_add(reserved_us) <= end_us {
                may_repeat = false;
                is_read = self
                    .transfer(address, reading::<P>(), clock, exchange)
                    .await;
            }
            *sample = is_read.then(|| P::decode(self.bytes));
        }
        if self.failed >= self.limit && self.patience == 0 {
            self.patience = PATIENCE;
            self.clear(exchange).await;
        }
        samples
    }

    /// Reads so many bytes of registers from this one on; false where the sensor does not answer in time.
    async fn attempt<C: Clock>(
        &mut self,
        address: u8,
        (register, length): Registers,
        clock: &C,
    ) -> bool {
        let bytes = self.bytes.get_mut(..length).unwrap_or_default();
        // In its place: moved, its few hundred bytes would be copied once more.
        let transfer = pin!(hall::read(&mut self.bus, address, register, bytes));
        let ended = within(clock, TRANSFER_LIMIT_US, transfer).await;
        matches!(ended, Some(Ok(())))
    }

    /// As [`Self::attempt`], and remembers how it went.
    async fn transfer<C: Clock, M: RawMutex>(
        &mut self,
        address: u8,
        registers: Registers,
        clock: &C,
        exchange: &Exchange<M>,
    ) -> bool {
        if self.attempt(address, registers, clock).await {
            self.failed = 0;
            self.patience = 0;
            return true;
        }
        self.failed = self.failed.saturating_add(1);
        let failed = &exchange.counts.transfers_failed;
        failed.fetch_add(1, Ordering::Relaxed);
        false
    }

    async fn clear<M: RawMutex>(&mut self, exchange: &Exchange<M>) {
        let was_free = self.free;
        self.free = self.bus.recover().await;
        self.failed = 0;
        self.stuck = match self.free {
            true => 0,
            false => self.stuck.saturating_add(1),
        };
        // A line that stays low is cleared each millisecond and told once.
        if was_free || self.free {
            exchange.events.post(Event::Cleared {
                bus: self.number,
                free: self.free,
            });
        }
    }
}

//! Reads the Hall sensors each millisecond: two buses in parallel, two sensors on each.

use core::pin::pin;
use core::sync::atomic::Ordering;

use embassy_futures::join::join;
use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::clock::{Clock, with_timeout_us};
use crate::config::constants::{SENSE_LIMIT_US, TICK_US, TRANSFER_LIMIT_US};
use crate::config::limits::DetectionLimits;
use crate::sensors::hall::config_readback::{ConfigReadback, ReadbackResult};
use crate::sensors::hall::liveness::{LivenessMonitor, MonitoredReading};
use crate::sensors::hall::{
    self, HallFrame, HallSample, HallSensor, SENSORS, SensorBus, TRANSFER_BYTES, WORD_BYTES,
};
use crate::system::faults::{Event, Fault, FaultSet};
use crate::system::task_watchdog::TaskId;
use crate::tasks::{FaultReporter, SharedState};

/// A tick that begins later than this is skipped, to keep frames one millisecond apart.
const MAX_LATENESS_US: u64 = 200;
/// Delay of the first tick: the scan of the addresses takes up to 1 ms.
pub const FIRST_TICK_US: u64 = 2_000;
/// Ticks between two recoveries of a bus that is free but without answer, as without sensors.
const RECOVERY_PAUSE: u8 = 100;

/// Result of one tick of sensing.
#[derive(Clone, Copy, Debug)]
pub struct SensedFrame {
    /// Usable readings.
    pub frame: HallFrame,
    /// Condition and age of each sensor.
    pub watched: [MonitoredReading; SENSORS],
    /// When the tick began, in microseconds since boot.
    pub begun_us: u64,
}

/// Scans both buses, then reads the sensors at `addresses` each tick, the first two on the first bus.
///
/// A bus repeats at most one transfer in a tick, if the time allows. After three failures in a row it is recovered while
/// the other bus continues. After the readings are published, the configuration of one sensor, in turn, is read back; an
/// unexpected word also triggers a recovery of its bus.
pub async fn sense<P: HallSensor, B: SensorBus, C: Clock, M: RawMutex>(
    [first, second]: [B; 2],
    addresses: [u8; SENSORS],
    limits: &DetectionLimits,
    clock: &C,
    shared: &SharedState<M>,
) -> ! {
    let [a, b, c, d] = addresses;
    let mut begin_us = clock.now_us().saturating_add(FIRST_TICK_US);
    let mut first = BusReader::new(first, 0, limits);
    let mut second = BusReader::new(second, 1, limits);
    join(first.scan::<P, C, M>(clock, shared), second.scan::<P, C, M>(clock, shared)).await;
    let mut watches = [LivenessMonitor::new(limits); SENSORS];
    let mut read_back = ConfigReadback::new(limits);
    let mut faults = FaultSet::default();
    let mut missed = 0_u32;
    loop {
        clock.until(begin_us).await;
        let now_us = clock.now_us();
        let late_us = now_us.saturating_sub(begin_us);
        if late_us > MAX_LATENESS_US {
            let ticks = (late_us as u32).div_ceil(TICK_US as u32);
            begin_us = begin_us.saturating_add(u64::from(ticks) * TICK_US);
            missed = missed.saturating_add(ticks);
            shared.counts.ticks_missed.store(missed, Ordering::Relaxed);
            let fault = (Fault::TicksMissed, 0);
            shared.update_fault(FaultReporter::Sense, &mut faults, fault, true, missed);
            continue;
        }
        shared.progress.check_in(TaskId::Sense);
        let ([r0, r1], [r2, r3]) = join(
            first.read::<P, C, M>([a, b], now_us, clock, shared),
            second.read::<P, C, M>([c, d], now_us, clock, shared),
        )
        .await;
        for (stuck_ticks, bus) in [(first.stuck_ticks, 0), (second.stuck_ticks, 1)] {
            let fault = (Fault::BusStuck, bus);
            shared.update_fault(
                FaultReporter::Sense,
                &mut faults,
                fault,
                stuck_ticks >= limits.stuck_ticks,
                0,
            );
        }
        let mut samples = [r0, r1, r2, r3];
        let answer = samples.map(|sample| sample.is_some());
        read_back.discard_changed(&mut samples);
        let mut samples = samples.into_iter();
        let watched = watches.each_mut().map(|watch| watch.update(samples.next().flatten()));
        shared.sensed.signal(SensedFrame {
            frame: HallFrame {
                time_us: now_us as u32,
                readings: watched.map(|sensor| sensor.reading),
            },
            watched,
            begun_us: now_us,
        });
        let sensor = read_back.next_sensor();
        if clock.now_us() <= now_us.saturating_add(SENSE_LIMIT_US - TRANSFER_LIMIT_US) {
            let bus = if sensor < 2 { &mut first } else { &mut second };
            let at = addresses.get(sensor).filter(|_| answer.get(sensor) == Some(&true));
            let is_read = match at {
                Some(address) => {
                    let word = (P::CONFIGURATION, WORD_BYTES);
                    bus.transfer(*address, word, clock, shared).await
                }
                None => false,
            };
            let [upper, lower, ..] = bus.bytes;
            if read_back.update(is_read.then_some([upper, lower])) == ReadbackResult::Changed {
                // Bytes may be shifted; a changed configuration shows again at the next read-back.
                bus.clear(shared).await;
            }
        }
        begin_us = begin_us.saturating_add(TICK_US);
    }
}

/// First register and number of bytes.
type Registers = (u8, usize);

const fn reading<P: HallSensor>() -> Registers {
    (P::READING, TRANSFER_BYTES)
}

/// A bus with its error state.
struct BusReader<B> {
    bus: B,
    number: u8,
    /// Bytes of the last transfer.
    bytes: [u8; TRANSFER_BYTES],
    /// Failed transfers in a row that trigger a recovery.
    failure_limit: u8,
    /// Failed transfers in a row.
    failed: u8,
    /// Whether both lines were high after the last recovery.
    free: bool,
    /// Ticks in a row with a line stuck low.
    stuck_ticks: u8,
    /// Ticks until the next recovery is allowed.
    recovery_pause: u8,
}

impl<B: SensorBus> BusReader<B> {
    const fn new(bus: B, number: u8, limits: &DetectionLimits) -> Self {
        Self {
            failure_limit: limits.failed_transfers,
            bus,
            number,
            bytes: [0; TRANSFER_BYTES],
            failed: 0,
            free: true,
            stuck_ticks: 0,
            recovery_pause: 0,
        }
    }

    /// Posts which addresses answer.
    async fn scan<P: HallSensor, C: Clock, M: RawMutex>(
        &mut self,
        clock: &C,
        shared: &SharedState<M>,
    ) {
        let mut answers = 0;
        for (bit, address) in P::ADDRESSES.into_iter().enumerate() {
            let answer = self.attempt(address, reading::<P>(), clock).await;
            answers |= u8::from(answer) << bit;
        }
        let bus = self.number;
        shared.events.post(Event::BusScanned { bus, answers });
    }

    /// Reads both sensors in the tick that began at `begun_us`.
    async fn read<P: HallSensor, C: Clock, M: RawMutex>(
        &mut self,
        addresses: [u8; 2],
        begun_us: u64,
        clock: &C,
        shared: &SharedState<M>,
    ) -> [Option<HallSample>; 2] {
        self.recovery_pause = self.recovery_pause.saturating_sub(1);
        if !self.free {
            self.clear(shared).await;
        }
        let mut samples = [None; 2];
        if !self.free {
            return samples;
        }
        let end_us = begun_us.saturating_add(SENSE_LIMIT_US);
        let mut may_repeat = true;
        // Time reserved for the transfers after this one.
        let mut reserved_us = addresses.len() as u64 * TRANSFER_LIMIT_US;
        for (sample, address) in samples.iter_mut().zip(addresses) {
            reserved_us = reserved_us.saturating_sub(TRANSFER_LIMIT_US);
            let mut is_read = self.transfer(address, reading::<P>(), clock, shared).await;
            let done_us = clock.now_us().saturating_add(TRANSFER_LIMIT_US);
            if !is_read && may_repeat && done_us.saturating_add(reserved_us) <= end_us {
                may_repeat = false;
                is_read = self.transfer(address, reading::<P>(), clock, shared).await;
            }
            *sample = is_read.then(|| P::decode(self.bytes));
        }
        if self.failed >= self.failure_limit && self.recovery_pause == 0 {
            self.recovery_pause = RECOVERY_PAUSE;
            self.clear(shared).await;
        }
        samples
    }

    /// Reads registers; false on an error or time-out.
    async fn attempt<C: Clock>(
        &mut self,
        address: u8,
        (register, length): Registers,
        clock: &C,
    ) -> bool {
        let bytes = self.bytes.get_mut(..length).unwrap_or_default();
        // Pinned in place: a move would copy its few hundred bytes again.
        let transfer = pin!(hall::read_registers(&mut self.bus, address, register, bytes));
        let ended = with_timeout_us(clock, TRANSFER_LIMIT_US, transfer).await;
        matches!(ended, Some(Ok(())))
    }

    /// As [`Self::attempt`], and counts failures.
    async fn transfer<C: Clock, M: RawMutex>(
        &mut self,
        address: u8,
        registers: Registers,
        clock: &C,
        shared: &SharedState<M>,
    ) -> bool {
        if self.attempt(address, registers, clock).await {
            self.failed = 0;
            self.recovery_pause = 0;
            return true;
        }
        self.failed = self.failed.saturating_add(1);
        let failed = &shared.counts.transfers_failed;
        failed.fetch_add(1, Ordering::Relaxed);
        false
    }

    async fn clear<M: RawMutex>(&mut self, shared: &SharedState<M>) {
        let was_free = self.free;
        self.free = self.bus.recover().await;
        self.failed = 0;
        self.stuck_ticks = if self.free { 0 } else { self.stuck_ticks.saturating_add(1) };
        // A line that stays low is recovered each millisecond but reported once.
        if was_free || self.free {
            shared.events.post(Event::BusCleared { bus: self.number, free: self.free });
        }
    }
}

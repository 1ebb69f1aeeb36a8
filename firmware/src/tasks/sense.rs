//! Reads the Hall sensors each millisecond: two buses in parallel, two sensors on each.

use core::future::poll_fn;
use core::pin::{Pin, pin};
use core::sync::atomic::Ordering;
use core::task::Poll;

use embassy_futures::join::join;
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::clock::Clock;
use crate::config::constants::{READ_LIMIT_US, SENSE_LIMIT_US, TICK_US, TRANSFER_LIMIT_US};
use crate::config::limits::DetectionLimits;
use crate::sensors::hall::config_readback::{ConfigReadback, ReadbackResult};
use crate::sensors::hall::liveness::{LivenessMonitor, MonitoredReading, SensorCondition};
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
/// Addresses that are scanned: of all sensors that the drivers know, with any straps.
const SCANNED: core::ops::RangeInclusive<u8> = 0x60..=0x6F;
/// Ticks between two recoveries of a bus that is free but without answer, as without sensors.
const RECOVERY_PAUSE: u8 = 100;

/// Result of one tick of sensing.
#[derive(Clone, Copy, Debug)]
pub struct SensedFrame {
    /// Usable reading, condition and age of each sensor.
    pub watched: [MonitoredReading; SENSORS],
    /// When the tick began, in microseconds since boot.
    pub begun_us: u64,
}

impl SensedFrame {
    /// Usable readings.
    pub fn frame(&self) -> HallFrame {
        let readings = self.watched.map(|sensor| sensor.reading);
        HallFrame { time_us: self.begun_us as u32, readings }
    }
}

/// Readings of the sensors that are read first ([`hall::FIRST_SENSORS`]), published while the others are read.
#[derive(Clone, Copy, Debug)]
pub struct FirstReadings {
    /// Usable readings.
    pub frame: HallFrame,
    /// When the tick began, in microseconds since boot.
    pub begun_us: u64,
}

/// Scans both buses, then reads the sensors at `addresses` each tick, the first two on the first bus. The first readings of
/// both buses are published at once: they are estimated while the others are read.
///
/// A bus repeats at most one transfer in a tick, if the time allows. After three failures in a row it is recovered while
/// the other bus continues. After the readings are published, the configuration of one sensor, in turn, is read back; an
/// unexpected word also triggers a recovery of its bus.
///
/// A timer for each transfer would wake the task after the transfer has ended. So all transfers of a tick share one, which is also
/// the beginning of the read-back.
pub async fn sense<P: HallSensor, B: SensorBus, C: Clock, M: RawMutex>(
    [first, second]: [B; 2],
    addresses: [u8; SENSORS],
    limits: &DetectionLimits,
    clock: &C,
    shared: &SharedState<M>,
) -> ! {
    let [a, b, c, d] = addresses;
    let mut begin_us = clock.now_us().saturating_add(FIRST_TICK_US);
    shared.first_tick_us.set(begin_us);
    let mut first = BusReader::new(first, 0, limits);
    let mut second = BusReader::new(second, 1, limits);
    let scan_end_us = begin_us.saturating_sub(TRANSFER_LIMIT_US);
    join(
        first.scan::<P, C, M>(scan_end_us, clock, shared),
        second.scan::<P, C, M>(scan_end_us, clock, shared),
    )
    .await;
    let mut watches = [LivenessMonitor::new(limits); SENSORS];
    let mut read_back = ConfigReadback::new(limits);
    let mut faults = FaultSet::default();
    let mut missed = 0_u32;
    let mut next_tick = pin!(clock.until(begin_us));
    loop {
        next_tick.as_mut().await;
        let now_us = clock.now_us();
        let late_us = now_us.saturating_sub(begin_us);
        if late_us > MAX_LATENESS_US {
            let ticks = (late_us as u32).div_ceil(TICK_US as u32);
            begin_us = begin_us.saturating_add(u64::from(ticks) * TICK_US);
            missed = missed.saturating_add(ticks);
            shared.counts.ticks_missed.store(missed, Ordering::Relaxed);
            let fault = (Fault::TicksMissed, 0);
            shared.update_fault(FaultReporter::Sense, &mut faults, fault, true, missed);
            next_tick.set(clock.until(begin_us));
            continue;
        }
        shared.progress.check_in(TaskId::Sense);
        let mut read_limit = pin!(clock.until(now_us.saturating_add(READ_LIMIT_US)));
        let mut sense_limit = pin!(clock.until(now_us.saturating_add(SENSE_LIMIT_US)));
        let (r0, r2) = {
            let reads = pin!(join(
                first.read_first::<P, C, M>(a, now_us, clock, shared),
                second.read_first::<P, C, M>(c, now_us, clock, shared),
            ));
            polled_at([read_limit.as_mut(), sense_limit.as_mut()], reads).await
        };
        let [w0, w1, w2, w3] = &mut watches;
        let ((r1, r3), (m0, m2)) = {
            let reads = join(
                first.read_last::<P, C, M>(b, now_us, clock, shared),
                second.read_last::<P, C, M>(d, now_us, clock, shared),
            );
            // After both transfers have begun.
            let publish = async {
                let [s0, _, s2, _] = read_back.without_changed([r0, None, r2, None]);
                let (m0, m2) = (w0.update(s0), w2.update(s2));
                let readings = [m0.reading, None, m2.reading, None];
                let frame = HallFrame { time_us: now_us as u32, readings };
                shared.first_readings.signal(FirstReadings { frame, begun_us: now_us });
                (m0, m2)
            };
            let reads = pin!(join(reads, publish));
            polled_at([read_limit.as_mut(), sense_limit.as_mut()], reads).await
        };
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
        let answer = [r0, r1, r2, r3].map(|sample| sample.is_some());
        let [_, s1, _, s3] = read_back.without_changed([None, r1, None, r3]);
        let watched = [m0, w1.update(s1), m2, w3.update(s3)];
        shared.sensed.signal(SensedFrame { watched, begun_us: now_us });
        let is_read = |sensor: &&MonitoredReading| {
            matches!(sensor.condition, SensorCondition::Live | SensorCondition::Frozen)
        };
        let repeated = watched.iter().filter(is_read).map(|sensor| sensor.age.into()).max();
        shared.counts.repeated_readings.fetch_max(repeated.unwrap_or_default(), Ordering::Relaxed);
        begin_us = begin_us.saturating_add(TICK_US);
        next_tick.set(clock.until(begin_us));
        read_limit.await;
        let sensor = read_back.next_sensor();
        if clock.now_us() <= now_us.saturating_add(SENSE_LIMIT_US - TRANSFER_LIMIT_US) {
            let bus = if sensor < 2 { &mut first } else { &mut second };
            let at = addresses.get(sensor).filter(|_| answer.get(sensor) == Some(&true));
            let is_read = match at {
                Some(address) => {
                    let word = (P::CONFIGURATION, WORD_BYTES);
                    let transfer = pin!(bus.transfer(*address, word, begin_us, clock, shared));
                    polled_at([next_tick.as_mut()], transfer).await
                }
                None => false,
            };
            let [upper, lower, ..] = bus.bytes;
            if read_back.update(is_read.then_some([upper, lower])) == ReadbackResult::Changed {
                // Bytes may be shifted; a changed configuration shows again at the next read-back.
                bus.clear(shared).await;
            }
            shared.counts.configurations.store(read_back.summary(), Ordering::Relaxed);
        }
    }
}

/// Output of a future that is also polled at the ends of these waits.
async fn polled_at<W: Future, F: Future, const N: usize>(
    waits: [Pin<&mut W>; N],
    mut future: Pin<&mut F>,
) -> F::Output {
    for wait in waits {
        if let Either::First(output) = select(future.as_mut(), wait).await {
            return output;
        }
    }
    future.await
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
    /// Whether a failed transfer may be repeated in this tick: no other has been.
    may_repeat: bool,
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
            may_repeat: true,
            free: true,
            stuck_ticks: 0,
            recovery_pause: 0,
        }
    }

    /// Posts which addresses answer. On a stuck bus each takes the longest time: the last ones are left out.
    async fn scan<P: HallSensor, C: Clock, M: RawMutex>(
        &mut self,
        end_us: u64,
        clock: &C,
        shared: &SharedState<M>,
    ) {
        let mut answers = 0;
        for (bit, address) in SCANNED.enumerate() {
            if clock.now_us() > end_us {
                break;
            }
            let limit_us = clock.now_us().saturating_add(TRANSFER_LIMIT_US);
            let attempt = pin!(self.attempt(address, reading::<P>(), limit_us, clock));
            let answer = polled_at([pin!(clock.until(limit_us))], attempt).await;
            answers |= u16::from(answer) << bit;
        }
        let bus = self.number;
        let both = u32::from(answers) << (16 * u32::from(bus));
        shared.counts.bus_answers.fetch_or(both, Ordering::Relaxed);
        shared.events.post(Event::BusScanned { bus, answers });
    }

    /// Reads the first sensor in the tick that began at `begun_us`. This and [`Self::read_last`] must be polled at
    /// [`READ_LIMIT_US`] and [`SENSE_LIMIT_US`] after it.
    async fn read_first<P: HallSensor, C: Clock, M: RawMutex>(
        &mut self,
        address: u8,
        begun_us: u64,
        clock: &C,
        shared: &SharedState<M>,
    ) -> Option<HallSample> {
        self.recovery_pause = self.recovery_pause.saturating_sub(1);
        self.may_repeat = true;
        if !self.free {
            self.clear(shared).await;
        }
        self.read::<P, C, M>(address, (begun_us, TRANSFER_LIMIT_US), clock, shared).await
    }

    /// Reads the last sensor in a tick.
    async fn read_last<P: HallSensor, C: Clock, M: RawMutex>(
        &mut self,
        address: u8,
        begun_us: u64,
        clock: &C,
        shared: &SharedState<M>,
    ) -> Option<HallSample> {
        let sample = self.read::<P, C, M>(address, (begun_us, 0), clock, shared).await;
        if self.failed >= self.failure_limit && self.recovery_pause == 0 {
            self.recovery_pause = RECOVERY_PAUSE;
            self.clear(shared).await;
        }
        sample
    }

    /// Reads a sensor; `reserved_us` is for the transfers after this one.
    async fn read<P: HallSensor, C: Clock, M: RawMutex>(
        &mut self,
        address: u8,
        (begun_us, reserved_us): (u64, u64),
        clock: &C,
        shared: &SharedState<M>,
    ) -> Option<HallSample> {
        let [read_us, end_us] =
            [READ_LIMIT_US, SENSE_LIMIT_US].map(|limit| begun_us.saturating_add(limit));
        while self.free {
            let done_us = clock.now_us().saturating_add(TRANSFER_LIMIT_US);
            let limit_us = if done_us <= read_us { read_us } else { end_us };
            if self.transfer(address, reading::<P>(), limit_us, clock, shared).await {
                return Some(P::decode(self.bytes));
            }
            let done_us = clock.now_us().saturating_add(TRANSFER_LIMIT_US);
            if !self.may_repeat || done_us.saturating_add(reserved_us) > end_us {
                break;
            }
            self.may_repeat = false;
        }
        None
    }

    /// Reads registers; false on an error, or if polled after `limit_us`.
    async fn attempt<C: Clock>(
        &mut self,
        address: u8,
        (register, length): Registers,
        limit_us: u64,
        clock: &C,
    ) -> bool {
        let bytes = self.bytes.get_mut(..length).unwrap_or_default();
        // Pinned in place: a move would copy its few hundred bytes again.
        let mut transfer = pin!(hall::read_registers(&mut self.bus, address, register, bytes));
        poll_fn(|context| match transfer.as_mut().poll(context) {
            Poll::Pending if clock.now_us() < limit_us => Poll::Pending,
            ended => Poll::Ready(matches!(ended, Poll::Ready(Ok(())))),
        })
        .await
    }

    /// As [`Self::attempt`], and counts failures.
    async fn transfer<C: Clock, M: RawMutex>(
        &mut self,
        address: u8,
        registers: Registers,
        limit_us: u64,
        clock: &C,
        shared: &SharedState<M>,
    ) -> bool {
        if self.attempt(address, registers, limit_us, clock).await {
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

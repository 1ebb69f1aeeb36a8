//! Delay from a tick to the end of its packet on the serial line, and to the end of the frames on the CAN bus with its forces:
//! the latency from the sample to the host.

use emulator::Time;
use firmware::config::constants::TICK_US;
use firmware::sensors::hall::SENSORS;

/// Bin width.
pub const BIN_US: u64 = 25;
/// Bins up to four periods; the last one collects all longer delays.
const BINS: usize = (4 * TICK_US / BIN_US) as usize + 1;

/// Simultaneous readings of the emulation's and the firmware's clock.
#[derive(Clone, Copy, Debug)]
pub struct Clocks {
    /// Time of the emulation.
    pub now: Time,
    /// Time of the firmware in microseconds since its start, and the period after which it wraps to zero.
    pub firmware_us: (u64, u64),
}

impl Clocks {
    /// Emulation time of a firmware timestamp less than one period before the
    /// reading.
    pub fn time(&self, firmware_us: u32) -> Time {
        let (now_us, period_us) = self.firmware_us;
        let age_us = (now_us + period_us - u64::from(firmware_us) % period_us) % period_us;
        self.now - Time::from_us(age_us)
    }
}

/// Histogram of the delays.
#[derive(Clone, Debug)]
pub struct Deadlines {
    bins: [u64; BINS],
    /// Ticks with a packet.
    pub ticks: u64,
    /// Ticks without a packet, from gaps between timestamps.
    pub missed: u64,
    /// Ticks whose packet ended after the start of the next tick.
    pub late: u64,
    /// Maximum delay.
    pub longest: Time,
    before_us: Option<u32>,
}

impl Default for Deadlines {
    fn default() -> Self {
        Self { bins: [0; BINS], ticks: 0, missed: 0, late: 0, longest: Time::ZERO, before_us: None }
    }
}

impl Deadlines {
    /// Adds the tick with this firmware timestamp; its packet ended at `ended`.
    pub fn push(&mut self, tick_us: u32, ended: Time, clocks: Clocks) {
        if let Some(before_us) = self.before_us.replace(tick_us) {
            let ticks = (u64::from(tick_us.wrapping_sub(before_us)) + TICK_US / 2) / TICK_US;
            self.missed += ticks.saturating_sub(1);
        }
        let delay = ended - clocks.time(tick_us);
        let place = (delay.us() / BIN_US) as usize;
        if let Some(bin) = self.bins.get_mut(place.min(BINS - 1)) {
            *bin += 1;
        }
        self.ticks += 1;
        self.late += u64::from(delay > Time::from_us(TICK_US));
        self.longest = self.longest.max(delay);
    }

    /// The firmware restarts and with it its clock.
    pub fn restart(&mut self) {
        self.before_us = None;
    }

    /// Lower edge in microseconds and count of each non-empty bin.
    pub fn bins(&self) -> Vec<(u64, u64)> {
        let bins = (0..).step_by(BIN_US as usize).zip(self.bins);
        bins.filter(|(_, ticks)| *ticks > 0).collect()
    }

    /// Quantile of the delay in microseconds (upper edge of the bin).
    pub fn quantile_us(&self, share: f64) -> Option<u64> {
        let wanted = share * self.ticks as f64;
        let mut ticks = 0;
        let place = self.bins.iter().position(|bin| {
            ticks += bin;
            ticks > 0 && ticks as f64 >= wanted
        })?;
        Some((place as u64 + 1) * BIN_US)
    }

    /// True if the last bin is not empty.
    pub const fn is_last_bin(from_us: u64) -> bool {
        from_us / BIN_US == BINS as u64 - 1
    }
}

/// Delays from a tick to the end of the CAN frame with the forces at each sensor.
#[derive(Clone, Debug, Default)]
pub struct FrameDelays {
    /// Frames of all sensors.
    pub frames: u64,
    /// Maximum delay at each sensor.
    pub longest: [Time; SENSORS],
    /// Sensor and end of frames that may belong to a tick whose packet has not arrived yet.
    waiting: Vec<(usize, Time)>,
    /// Beginning of the latest tick, and of the one whose forces are being sent.
    begun: Option<Time>,
    sampled: Option<Time>,
}

impl FrameDelays {
    /// Adds a frame with the forces at a sensor.
    pub fn push_frame(&mut self, sensor: u8, ended: Time) {
        self.waiting.push((sensor.into(), ended));
    }

    /// Adds a tick. The frame of the first sensor belongs to the last tick before its end, those of the others to the same.
    pub fn push_tick(&mut self, begun: Time) {
        let previous = self.begun.replace(begun);
        let is_before = |(_, ended): &(usize, Time)| *ended <= begun;
        let count = self.waiting.iter().take_while(|frame| is_before(frame)).count();
        for (sensor, ended) in self.waiting.drain(..count) {
            if sensor == 0 {
                self.sampled = previous;
            }
            if let (Some(sampled), Some(longest)) = (self.sampled, self.longest.get_mut(sensor)) {
                *longest = (*longest).max(ended - sampled);
                self.frames += 1;
            }
        }
    }

    /// The firmware restarts.
    pub fn restart(&mut self) {
        (self.begun, self.sampled) = (None, None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_belong_to_the_last_tick_before_the_first_of_them() {
        let mut delays = FrameDelays::default();
        let us = Time::from_us;
        delays.push_frame(0, us(900));
        delays.push_tick(us(1000));
        for (sensor, ended_us) in [(0, 1700), (1, 1835), (2, 1970), (3, 2105), (0, 3690)] {
            delays.push_frame(sensor, us(ended_us));
        }
        for begun_us in [2000, 3000, 4000] {
            delays.push_tick(us(begun_us));
        }
        assert_eq!((delays.frames, delays.longest), (5, [us(700), us(835), us(970), us(1105)]));
    }

    #[test]
    fn delays_use_the_emulation_clock() {
        let mut deadlines = Deadlines::default();
        // The firmware's clock started 2.5 ms after power-on.
        for tick in 14..17 {
            let (tick_us, delay_us) = (1000 * tick, 600 + u64::from(tick));
            let ended = Time::from_us(2500 + u64::from(tick_us) + delay_us);
            let clocks = Clocks { now: Time::from_us(20_000), firmware_us: (17_500 % 4096, 4096) };
            deadlines.push(tick_us, ended, clocks);
        }
        assert_eq!(deadlines.bins(), [(600, 3)]);
        assert_eq!((deadlines.ticks, deadlines.missed, deadlines.late), (3, 0, 0));
        assert_eq!(deadlines.longest, Time::from_us(616));
        assert_eq!(deadlines.quantile_us(0.5), Some(625));
    }

    #[test]
    fn missed_and_late_ticks_are_counted_except_at_a_restart() {
        let mut deadlines = Deadlines::default();
        let mut push = |tick_us: u32, delay_us: u64| {
            let clocks = Clocks { now: Time::from_ms(100), firmware_us: (tick_us.into(), 1 << 32) };
            deadlines.push(tick_us, Time::from_us(100_000 + delay_us), clocks);
        };
        push(u32::MAX - 499, 100);
        push(500, 1200);
        push(3500, 50_000);
        deadlines.restart();
        assert_eq!((deadlines.ticks, deadlines.missed, deadlines.late), (3, 2, 2));
        deadlines.push(
            1000,
            Time::from_ms(1),
            Clocks { now: Time::from_ms(1), firmware_us: (1000, 1 << 32) },
        );
        assert_eq!(deadlines.missed, 2);
        let bins = deadlines.bins();
        assert_eq!(bins.first(), Some(&(0, 1)));
        assert_eq!(bins.last(), Some(&(4000, 1)));
        assert!(Deadlines::is_last_bin(4000) && !Deadlines::is_last_bin(3975));
    }
}

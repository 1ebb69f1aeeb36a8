//! Assembly of packets to rows: of the ticks of a serial line, or of the frames between two force messages of a CAN bus.

use firmware::compensation::covariates::Covariates;
use firmware::config::constants::TICK_US;
use firmware::fixed_point::Force;
use firmware::protocol::messages::{HallRaw, Message};
use firmware::protocol::serial::Packet;
use firmware::sensors::hall::{HallReading, SENSORS};

use crate::state::BoardClock;

/// Readings of one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorRow {
    /// Board time in microseconds.
    pub time_us: u64,
    pub readings: [Option<HallReading>; SENSORS],
    /// Lateral and longitudinal force in newtons that the board estimated; none where invalid and over a CAN bus.
    pub force_n: [Option<[f64; 2]>; SENSORS],
    /// Covariates; none over a CAN bus.
    pub covariates: Covariates,
}

/// The board restarted: its clock is not continuous.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Restarted;

/// Assembles rows from packets.
#[derive(Clone, Debug)]
pub struct SensorRowAssembler {
    clock: BoardClock,
    sets: Option<Sets>,
    /// True after the first row.
    begun: bool,
}

/// Steps of the heartbeats' counter of a board that did not restart.
const STEPS: std::ops::RangeInclusive<u8> = 1..=3;

impl SensorRowAssembler {
    /// For a serial line: one packet per tick.
    pub fn of_ticks() -> Self {
        Self { clock: BoardClock::default(), sets: None, begun: false }
    }

    /// For a CAN bus: one frame per sensor follows the forces, which come every `period_us`.
    pub fn of_sets(period_us: u64) -> Self {
        let sets = Sets {
            period_us,
            counted: None,
            readings: [None; SENSORS],
            beat: None,
            has_version: false,
        };
        Self { sets: Some(sets), ..Self::of_ticks() }
    }

    /// Period of the rows in microseconds.
    pub fn period_us(&self) -> u64 {
        self.sets.as_ref().map_or(TICK_US, |sets| sets.period_us)
    }

    /// Returns the row that a packet completes, received `at_s` seconds after the start.
    ///
    /// # Errors
    /// The board restarted since the last row.
    pub fn take(&mut self, at_s: f64, packet: &Packet) -> Result<Option<SensorRow>, Restarted> {
        let row = match (packet, &mut self.sets) {
            // The ticks of a serial line show a restart by their time.
            (Packet::Message { message: Message::Version(_), .. }, Some(sets)) => {
                sets.has_version = self.begun;
                None
            }
            (Packet::Message { message: Message::Heartbeat(beat), .. }, Some(sets)) => {
                if !sets.continues(beat.counter) {
                    return Err(Restarted);
                }
                None
            }
            (Packet::Tick(tick), None) => Some(SensorRow {
                time_us: self.clock.extend(tick.time_us, at_s).ok_or(Restarted)?,
                readings: tick.sensors.map(|sensor| sensor.reading()),
                force_n: tick.sensors.map(|sensor| {
                    let is_valid = sensor.validity().is_in_range();
                    is_valid.then(|| sensor.force.map(|counts| Force(counts).newtons()))
                }),
                covariates: tick.covariates,
            }),
            (Packet::Message { message, .. }, Some(sets)) => sets.take(at_s, message),
            _ => None,
        };
        self.begun |= row.is_some();
        Ok(row)
    }
}

/// Raw frames between two force messages.
#[derive(Clone, Debug)]
struct Sets {
    period_us: u64,
    /// Counter of the forces, number of the set since the first, reception time.
    counted: Option<(u8, u64, f64)>,
    readings: [Option<HallReading>; SENSORS],
    /// Counter of the latest heartbeat.
    beat: Option<u8>,
    /// A version came after it: a board sends one at its start, and to whoever asks for it.
    has_version: bool,
}

impl Sets {
    /// Whether the heartbeat with this counter is of a board that did not restart.
    fn continues(&mut self, counter: u8) -> bool {
        let step = self.beat.replace(counter).map(|last| counter.wrapping_sub(last));
        let is_suspect = std::mem::take(&mut self.has_version);
        !is_suspect || step.is_none_or(|step| STEPS.contains(&step))
    }

    fn take(&mut self, at_s: f64, message: &Message) -> Option<SensorRow> {
        match message {
            Message::Force(force) => match self.counted {
                Some((counter, _, _)) if counter == force.counter => None,
                Some(_) | None => self.next(at_s, force.counter),
            },
            Message::HallRaw(raw) => {
                self.read(raw);
                None
            }
            _ => None,
        }
    }

    fn read(&mut self, raw: &HallRaw) {
        // Without preceding forces the time is unknown; a second frame of a sensor means that the
        // forces in between were lost.
        let place = self.readings.get_mut(usize::from(raw.sensor));
        if let (Some(place @ None), Some(_)) = (place, self.counted) {
            *place =
                Some(HallReading { field: [raw.x, raw.y, raw.z], temperature: raw.temperature });
        }
    }

    /// Forces with a new counter: the previous set is complete.
    fn next(&mut self, at_s: f64, counter: u8) -> Option<SensorRow> {
        let Some((before, set, before_s)) = self.counted else {
            self.counted = Some((counter, 0, at_s));
            return None;
        };
        let step = u64::from(counter.wrapping_sub(before));
        // Lost counter overflows follow from the elapsed time.
        let passed = 1e6 * (at_s - before_s) / self.period_us as f64;
        let turns = ((passed - step as f64) / 256.0).round().max(0.0) as u64;
        self.counted = Some((counter, set + step + 256 * turns, at_s));
        let readings = std::mem::take(&mut self.readings);
        readings.iter().any(Option::is_some).then_some(SensorRow {
            time_us: set * self.period_us,
            readings,
            force_n: [None; SENSORS],
            covariates: Covariates::default(),
        })
    }
}

#[cfg(test)]
mod tests {
    use firmware::protocol::messages::{Force, Heartbeat, Version};
    use firmware::protocol::serial::{SensorTick, Tick};

    use super::*;

    fn force(counter: u8) -> Packet {
        let force = Force { counter, ..Force::default() };
        Packet::Message { copy: 0, message: Message::Force(force) }
    }

    fn raw(sensor: u8, x: i16) -> Packet {
        let raw = HallRaw { sensor, x, ..HallRaw::default() };
        Packet::Message { copy: 0, message: Message::HallRaw(raw) }
    }

    fn tick(time_us: u32) -> Packet {
        let silent = SensorTick { field: [0; 3], temperature: 0, force: [0; 2], validity: 3 };
        let covariates = Covariates::default();
        Packet::Tick(Tick { time_us, sensors: [silent; SENSORS], covariates })
    }

    fn xs(row: &SensorRow) -> [Option<i16>; SENSORS] {
        row.readings.map(|reading| reading.map(|reading| reading.field[0]))
    }

    #[test]
    fn frames_after_the_forces_form_a_row_at_their_time() {
        let mut rows = SensorRowAssembler::of_sets(10_000);
        let packets = [
            raw(3, 1),
            force(7),
            raw(0, 10),
            raw(2, 12),
            force(8),
            force(8),
            raw(0, 20),
            force(11),
        ];
        let assembled: Vec<SensorRow> =
            packets.iter().filter_map(|packet| rows.take(0.0, packet).unwrap()).collect();
        assert_eq!(assembled.iter().map(|row| row.time_us).collect::<Vec<_>>(), [0, 10_000]);
        assert_eq!(xs(&assembled[0]), [Some(10), None, Some(12), None]);
        assert_eq!(xs(&assembled[1]), [Some(20), None, None, None]);
        // The set of counter 11 is the fourth.
        rows.take(0.04, &raw(1, 40)).unwrap();
        let last = rows.take(0.05, &force(12)).unwrap().unwrap();
        assert_eq!((last.time_us, xs(&last)[1]), (40_000, Some(40)));
    }

    #[test]
    fn lost_counter_overflows_count_as_elapsed_time() {
        let mut rows = SensorRowAssembler::of_sets(2_000);
        rows.take(0.0, &force(0)).unwrap();
        // 2 s and 10 ms later: 1005 sets, of which the counter shows 237.
        rows.take(2.01, &force(237)).unwrap();
        rows.take(2.01, &raw(0, 1)).unwrap();
        let row = rows.take(2.012, &force(238)).unwrap().unwrap();
        assert_eq!(row.time_us, 2_010_000);
    }

    #[test]
    fn a_decreasing_clock_is_a_restart_and_a_version_is_none() {
        let version = Packet::Message { copy: 0, message: Message::Version(Version::default()) };
        let mut rows = SensorRowAssembler::of_ticks();
        assert_eq!(rows.take(0.0, &version), Ok(None));
        assert_eq!(rows.take(0.0, &tick(9_000)).unwrap().unwrap().time_us, 9_000);
        assert_eq!(rows.take(0.1, &version), Ok(None));
        assert_eq!(rows.take(0.1, &tick(10_000)).unwrap().unwrap().time_us, 10_000);
        assert_eq!(rows.take(0.1, &tick(2_000)), Err(Restarted));
    }

    /// Whoever asks a board for its version gets it on the bus of all.
    #[test]
    fn a_version_and_new_heartbeats_are_a_restart_on_a_bus() {
        let message = |message| Packet::Message { copy: 0, message };
        let beat =
            |counter| message(Message::Heartbeat(Heartbeat { counter, ..Heartbeat::default() }));
        let version = message(Message::Version(Version::default()));
        let mut rows = SensorRowAssembler::of_sets(10_000);
        for packet in [force(7), raw(0, 1), force(8), beat(254), version, beat(255), beat(0)] {
            assert!(rows.take(0.0, &packet).is_ok(), "{packet:?}");
        }
        assert!(rows.take(0.1, &version).is_ok());
        assert_eq!(rows.take(0.2, &beat(0)), Err(Restarted));
    }
}

//! What the sensors read, tick by tick, out of the packets of a line or a bus.

use firmware::frame::SENSORS;
use firmware::hall::Reading;
use firmware::params::TICK_US;
use firmware::wire::messages::{HallRaw, Message};
use firmware::wire::serial::Packet;

use super::board_clock::BoardClock;

/// One tick of sensing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// The board's time in microseconds.
    pub time_us: u64,
    /// What each sensor read.
    pub readings: [Option<Reading>; SENSORS],
}

/// The board has started anew: its clock does not go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Restarted;

/// Gathers rows.
#[derive(Clone, Debug)]
pub struct Rows {
    clock: BoardClock,
    sets: Option<Sets>,
    /// Whether a row has come.
    begun: bool,
}

impl Rows {
    /// Of a serial line: every tick has its own packet.
    pub fn of_ticks() -> Self {
        Self {
            clock: BoardClock::default(),
            sets: None,
            begun: false,
        }
    }

    /// Of a bus: a frame for each sensor follows the forces, which come every `period_us`.
    pub fn of_sets(period_us: u64) -> Self {
        let sets = Sets {
            period_us,
            counted: None,
            readings: [None; SENSORS],
        };
        Self {
            sets: Some(sets),
            ..Self::of_ticks()
        }
    }

    /// Time between two rows where none is lost.
    pub fn period_us(&self) -> u64 {
        self.sets.as_ref().map_or(TICK_US, |sets| sets.period_us)
    }

    /// The row that a packet completes, heard `at_s` seconds after hearing began.
    ///
    /// # Errors
    /// The board has started anew since the last row.
    pub fn take(&mut self, at_s: f64, packet: &Packet) -> Result<Option<Row>, Restarted> {
        let row = match (packet, &mut self.sets) {
            (
                Packet::Message {
                    message: Message::Version(_),
                    ..
                },
                _,
            ) => {
                return if self.begun { Err(Restarted) } else { Ok(None) };
            }
            (Packet::Tick(tick), None) => Some(Row {
                time_us: self.clock.take(tick.time_us, at_s).ok_or(Restarted)?,
                readings: tick.sensors.map(|sensor| sensor.reading()),
            }),
            (Packet::Message { message, .. }, Some(sets)) => sets.take(at_s, message),
            _ => None,
        };
        self.begun |= row.is_some();
        Ok(row)
    }
}

/// Raw frames between two messages of forces.
#[derive(Clone, Debug)]
struct Sets {
    period_us: u64,
    /// The forces' counter, which set since the first that was, and when it came.
    counted: Option<(u8, u64, f64)>,
    readings: [Option<Reading>; SENSORS],
}

impl Sets {
    fn take(&mut self, at_s: f64, message: &Message) -> Option<Row> {
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
        // Without forces before it nobody knows when it was read; where it is the sensor's second, the
        // forces before it were lost.
        let place = self.readings.get_mut(usize::from(raw.sensor));
        if let (Some(place @ None), Some(_)) = (place, self.counted) {
            *place = Some(Reading {
                field: [raw.x, raw.y, raw.z],
                temperature: raw.temperature,
            });
        }
    }

    /// Forces with another counter: the set before them is complete.
    fn next(&mut self, at_s: f64, counter: u8) -> Option<Row> {
        let Some((before, set, before_s)) = self.counted else {
            self.counted = Some((counter, 0, at_s));
            return None;
        };
        let step = u64::from(counter.wrapping_sub(before));
        // Turns of the counter that were lost show in the time that has passed.
        let passed = 1e6 * (at_s - before_s) / self.period_us as f64;
        let turns = ((passed - step as f64) / 256.0).round().max(0.0) as u64;
        self.counted = Some((counter, set + step + 256 * turns, at_s));
        let readings = std::mem::take(&mut self.readings);
        readings.iter().any(Option::is_some).then_some(Row {
            time_us: set * self.period_us,
            readings,
        })
    }
}

#[cfg(test)]
mod tests {
    use firmware::wire::messages::{Force, Version};
    use firmware::wire::serial::{Sensor, Tick};

    use super::*;

    fn force(counter: u8) -> Packet {
        let force = Force {
            counter,
            ..Force::default()
        };
        Packet::Message {
            copy: 0,
            message: Message::Force(force),
        }
    }

    fn raw(sensor: u8, x: i16) -> Packet {
        let raw = HallRaw {
            sensor,
            x,
            ..HallRaw::default()
        };
        Packet::Message {
            copy: 0,
            message: Message::HallRaw(raw),
        }
    }

    fn tick(time_us: u32) -> Packet {
        let silent = Sensor {
            field: [0; 3],
            temperature: 0,
            force: [0; 2],
            validity: 3,
        };
        Packet::Tick(Tick {
            time_us,
            sensors: [silent; SENSORS],
        })
    }

    fn xs(row: &Row) -> [Option<i16>; SENSORS] {
        row.readings
            .map(|reading| reading.map(|reading| reading.field[0]))
    }

    #[test]
    fn on_a_bus_the_frames_after_the_forces_are_a_row_at_the_counter_s_time() {
        let mut rows = Rows::of_sets(10_000);
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
        let told: Vec<Row> = packets
            .iter()
            .filter_map(|packet| rows.take(0.0, packet).unwrap())
            .collect();
        assert_eq!(
            told.iter().map(|row| row.time_us).collect::<Vec<_>>(),
            [0, 10_000]
        );
        assert_eq!(xs(&told[0]), [Some(10), None, Some(12), None]);
        assert_eq!(xs(&told[1]), [Some(20), None, None, None]);
        // The set of counter 11 is the fourth.
        rows.take(0.04, &raw(1, 40)).unwrap();
        let last = rows.take(0.05, &force(12)).unwrap().unwrap();
        assert_eq!((last.time_us, xs(&last)[1]), (40_000, Some(40)));
    }

    #[test]
    fn turns_of_the_counter_that_nobody_heard_are_time_that_passed() {
        let mut rows = Rows::of_sets(2_000);
        rows.take(0.0, &force(0)).unwrap();
        // 2 s and 10 ms later: 1005 sets, of which the counter shows 237.
        rows.take(2.01, &force(237)).unwrap();
        rows.take(2.01, &raw(0, 1)).unwrap();
        let row = rows.take(2.012, &force(238)).unwrap().unwrap();
        assert_eq!(row.time_us, 2_010_000);
    }

    #[test]
    fn a_version_or_a_clock_that_goes_back_after_the_first_row_is_a_restart() {
        let version = Packet::Message {
            copy: 0,
            message: Message::Version(Version::default()),
        };
        let mut rows = Rows::of_ticks();
        assert_eq!(rows.take(0.0, &version), Ok(None));
        assert_eq!(
            rows.take(0.0, &tick(9_000)).unwrap().unwrap().time_us,
            9_000
        );
        assert_eq!(rows.clone().take(0.1, &version), Err(Restarted));
        assert_eq!(rows.take(0.1, &tick(2_000)), Err(Restarted));
    }
}

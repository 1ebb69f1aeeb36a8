//! What a board sends as topics: rows, its estimates, and the messages on its state; written to a file, or live.

use anyhow::Result;
use firmware::protocol::layout::{MessageLayout, SignalLayout, decode};
use firmware::protocol::messages::{FaultEvent, GripStatus, Heartbeat, Message, Power, Timing};
use model_export::recordings::mcap::{
    EstimatedForce, McapWriter, RecordingTopics, StateTopic, TopicColumns, TopicSink,
};

/// Messages on the state of the board.
const STATE: [&MessageLayout; 5] =
    [&Heartbeat::LAYOUT, &FaultEvent::LAYOUT, &GripStatus::LAYOUT, &Power::LAYOUT, &Timing::LAYOUT];

pub struct BoardTopics<S: TopicSink> {
    topics: RecordingTopics<S>,
    sensors: Vec<usize>,
}

impl<S: TopicSink> BoardTopics<S> {
    /// For these columns; `create` makes the topics.
    ///
    /// # Errors
    /// Those of `create`.
    pub fn new(
        hall: &[String],
        force: &[String],
        sensors: &[usize],
        create: impl FnOnce(TopicColumns) -> Result<RecordingTopics<S>>,
    ) -> Result<Self> {
        let numbers: Vec<u32> = sensors.iter().map(|sensor| *sensor as u32).collect();
        let state = STATE.map(|layout| StateTopic {
            name: layout.name,
            signals: layout.signals.iter().map(|signal| (signal.name, signal.unit)).collect(),
        });
        let topics = create(TopicColumns { hall, force, sensors: &numbers, state: &state })?;
        Ok(Self { topics, sensors: sensors.to_vec() })
    }

    /// Writes a row.
    ///
    /// # Errors
    /// Writing failed; so for the other methods.
    pub fn row(&mut self, time_us: f64, hall: &[f64]) -> Result<()> {
        Ok(self.topics.board(time_us, hall)?)
    }

    /// Writes the estimates, of all sensors of the board.
    pub fn estimates(&mut self, time_us: f64, estimates: &[EstimatedForce]) -> Result<()> {
        let of = |sensor: &usize| estimates.get(*sensor).copied().unwrap_or_default();
        Ok(self.topics.estimate(time_us, self.sensors.iter().map(of))?)
    }

    /// Writes a row of the reference.
    pub fn reference(&mut self, time_us: f64, force_n: &[f64]) -> Result<()> {
        Ok(self.topics.reference(time_us, force_n)?)
    }

    /// Writes a message on the state of the board; others are left out.
    pub fn message(&mut self, time_us: f64, message: &Message) -> Result<()> {
        let Some(place) = STATE.iter().position(|layout| layout.number == message.number()) else {
            return Ok(());
        };
        let frame = u64::from_le_bytes(message.to_bytes());
        let values = STATE[place].signals.iter().map(|signal| physical(signal, frame));
        Ok(self.topics.state(place, time_us, &values.collect::<Vec<f64>>())?)
    }
}

impl BoardTopics<McapWriter> {
    /// Writes the messages so far to the file if the first of them is a second old.
    pub fn flush_due(&mut self) -> Result<()> {
        Ok(self.topics.flush_due()?)
    }

    /// Writes the messages so far to the file.
    pub fn flush(&mut self) -> Result<()> {
        Ok(self.topics.flush()?)
    }

    /// Completes the file.
    pub fn finish(self) -> Result<()> {
        Ok(self.topics.finish()?)
    }
}

/// Value of a signal in its unit.
fn physical(signal: &SignalLayout, frame: u64) -> f64 {
    let bits = signal.first_bit..signal.end_bit;
    let counts = if signal.signed {
        f64::from(decode::<i32>(frame, bits))
    } else {
        f64::from(decode::<u32>(frame, bits))
    };
    counts * signal.scale
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signals_have_their_sign_and_unit() {
        let power =
            Power { bus: 2412, current: -150, mcu: -128, motor: 40, sensor: -5, counter: 7 };
        let frame = u64::from_le_bytes(Message::Power(power).to_bytes());
        let values: Vec<f64> =
            Power::LAYOUT.signals.iter().map(|signal| physical(signal, frame)).collect();
        let expected = [24.12, -1.5, -128.0, 40.0, -5.0, 7.0];
        assert!(values.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{values:?}");
    }
}

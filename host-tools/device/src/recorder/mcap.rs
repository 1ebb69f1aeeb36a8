//! The MCAP file that is written alongside a recording: rows, the board's estimates, and the messages on its state.

use std::path::{Path, PathBuf};

use anyhow::Result;
use firmware::protocol::layout::{MessageLayout, SignalLayout, decode};
use firmware::protocol::messages::{FaultEvent, GripStatus, Heartbeat, Message, Power, Timing};
use firmware::sensors::hall::SENSORS;
use model_export::recordings::description::RecordingDescription;
use model_export::recordings::mcap::{EstimatedForce, RecordingMcap, StateTopic};

/// Messages on the state of the board.
const STATE: [&MessageLayout; 5] =
    [&Heartbeat::LAYOUT, &FaultEvent::LAYOUT, &GripStatus::LAYOUT, &Power::LAYOUT, &Timing::LAYOUT];

/// A file that is created with the first rows.
pub struct McapOutput {
    path: PathBuf,
    file: Option<RecordingMcap>,
    sensors: Vec<usize>,
}

impl McapOutput {
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_path_buf(), file: None, sensors: Vec::new() }
    }

    /// Creates the file for these columns of the recording.
    pub fn begin(
        &mut self,
        description: &RecordingDescription,
        hall: &[String],
        force: &[String],
        sensors: &[usize],
    ) -> Result<()> {
        self.sensors = sensors.to_vec();
        let numbers: Vec<u32> = sensors.iter().map(|sensor| *sensor as u32).collect();
        let state = STATE.iter().map(|layout| StateTopic {
            name: layout.name,
            signals: layout.signals.iter().map(|signal| (signal.name, signal.unit)).collect(),
        });
        let state: Vec<StateTopic> = state.collect();
        self.file =
            Some(RecordingMcap::create(&self.path, description, hall, force, &numbers, &state)?);
        Ok(())
    }

    /// Writes a row with the forces that the board estimated.
    pub fn row(
        &mut self,
        time_us: u64,
        hall: &[f64],
        force_n: &[Option<[f64; 2]>; SENSORS],
    ) -> Result<()> {
        let Some(file) = &mut self.file else { return Ok(()) };
        file.board(time_us as f64, hall)?;
        let estimate = |sensor: &usize| EstimatedForce {
            force_n: force_n.get(*sensor).copied().flatten(),
            sigma_n: None,
        };
        if force_n.iter().any(Option::is_some) {
            file.estimate(time_us as f64, self.sensors.iter().map(estimate))?;
        }
        Ok(())
    }

    /// Writes a row of the reference.
    pub fn reference(&mut self, time_us: f64, force_n: &[f64]) -> Result<()> {
        match &mut self.file {
            Some(file) => Ok(file.reference(time_us, force_n)?),
            None => Ok(()),
        }
    }

    /// Writes a message on the state of the board; others are left out.
    pub fn message(&mut self, time_us: u64, message: &Message) -> Result<()> {
        let place = STATE.iter().position(|layout| layout.number == message.number());
        let (Some(file), Some(place)) = (&mut self.file, place) else {
            return Ok(());
        };
        let frame = u64::from_le_bytes(message.to_bytes());
        let values = STATE[place].signals.iter().map(|signal| physical(signal, frame));
        Ok(file.state(place, time_us as f64, &values.collect::<Vec<f64>>())?)
    }

    /// Completes the file.
    pub fn finish(self) -> Result<()> {
        match self.file {
            Some(file) => Ok(file.finish()?),
            None => Ok(()),
        }
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

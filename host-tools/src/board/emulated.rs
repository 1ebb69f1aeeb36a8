//! The firmware's image in an emulated chip, with the sensors, buses and gripper around it that the loops in virtual time
//! have: boot, drivers, interrupts, DMA, execution times and stack are those of the image.

use anyhow::{Context, Result};
use firmware::events::Event;
use firmware::wire::messages::FaultEvent;
use firmware::wire::serial::{Packet, Receiver};
use sim_board::{Chip, CycleModel, Devices, Frequency, Image, Options, Time};

use super::world::World;
use super::{Connections, SimulatedBoard};
use crate::drive::world::{Bridges, RotorSensor, Shared};

/// What of the emulation may vary from chip to chip.
#[derive(Clone, Copy, Debug)]
pub struct Conditions {
    /// Execution times.
    pub model: CycleModel,
    /// What a bit on the sensor buses takes beyond the times of the register.
    pub i2c_synchronisation: Time,
    /// The watchdog's oscillator.
    pub lsi: Frequency,
    /// Of random numbers and memory at power-on.
    pub seed: u64,
}

impl Conditions {
    /// Shortest execution times, fastest buses, slowest watchdog.
    pub const FAST: Self = Self {
        model: CycleModel::FAST,
        i2c_synchronisation: Time::from_ns(250),
        lsi: Frequency(29_500),
        seed: 1,
    };

    /// Between both ends.
    pub const TYPICAL: Self = Self {
        model: CycleModel::TYPICAL,
        i2c_synchronisation: Time::from_ns(375),
        lsi: Frequency(32_000),
        seed: 2,
    };

    /// Longest execution times, slowest buses, fastest watchdog.
    pub const SLOW: Self = Self {
        model: CycleModel::SLOW,
        i2c_synchronisation: Time::from_ns(500),
        lsi: Frequency(34_000),
        seed: 3,
    };
}

/// A board whose program is an image.
pub struct EmulatedBoard {
    /// The chip.
    pub chip: Chip,
    /// What is around it.
    pub connections: Connections,
}

impl EmulatedBoard {
    /// Programs an image into a chip and switches it on, in a world and with a gripper.
    ///
    /// # Errors
    /// The chip does not start from flash.
    pub fn start(
        image: Image,
        conditions: Conditions,
        world: Box<dyn World>,
        gripper: Shared,
    ) -> Result<Self> {
        gripper.borrow_mut().connect_chip();
        let connections = Connections::new(world);
        let [first, second] = connections.buses.clone();
        let devices = Devices {
            sensor_buses: [Box::new(first), Box::new(second)],
            encoder: Box::new(RotorSensor::new(gripper.clone())),
            drivetrain: Box::new(Bridges(gripper)),
            can: Box::new(connections.can.clone()),
            serial: Box::new(connections.line.clone()),
        };
        let options = Options {
            i2c_synchronisation: conditions.i2c_synchronisation,
            lsi: conditions.lsi,
            seed: conditions.seed,
            ..Options::default()
        };
        let chip = Chip::new(image, conditions.model, options, devices)
            .context("the image does not start")?;
        Ok(Self { chip, connections })
    }

    /// What passed on the serial line since the last call.
    pub fn take_sent(&self) -> Sent {
        let mut line = self.connections.line.borrow_mut();
        Sent {
            bytes: std::mem::take(&mut line.sent),
            ended: std::mem::take(&mut line.ended),
        }
    }

    /// Packets on the serial line since the last call, with the time at which each had passed.
    pub fn take_packets(&self, receiver: &mut Receiver) -> Vec<(Time, Packet)> {
        self.take_sent().packets(receiver)
    }
}

/// Bytes of the serial line.
pub struct Sent {
    /// All of them.
    pub bytes: Vec<u8>,
    /// When each of the zeros among them had passed.
    ended: Vec<Time>,
}

impl Sent {
    /// Its packets, with the time at which each had passed.
    pub fn packets(&self, receiver: &mut Receiver) -> Vec<(Time, Packet)> {
        let mut ended = self.ended.iter();
        let mut packets = Vec::new();
        for &byte in &self.bytes {
            let time = if byte == 0 { ended.next() } else { None };
            if let (Some(packet), Some(time)) = (receiver.take(byte), time) {
                packets.push((*time, packet));
            }
        }
        packets
    }
}

impl SimulatedBoard for EmulatedBoard {
    fn run_until(&mut self, time_us: u64) -> Result<()> {
        self.chip.run_until(Time::from_us(time_us))?;
        Ok(())
    }

    fn connections(&self) -> &Connections {
        &self.connections
    }

    fn take_events(&mut self) -> Vec<(u64, Event)> {
        let lines = self.chip.take_log().into_iter();
        lines
            .filter_map(|line| {
                let time_us = 1e6 * line.stamp?.parse::<f64>().ok()?;
                Some((time_us as u64, event(&line.text)?))
            })
            .collect()
    }
}

/// The event that a line of the image's log reports.
fn event(line: &str) -> Option<Event> {
    let words = line.split([' ', ',', ':']);
    let words: Vec<_> = words.filter(|word| !word.is_empty()).collect();
    match words[..] {
        ["info", "fault", code, "of", source, active, detail] => Some(Event::Fault(FaultEvent {
            code: code.parse().ok()?,
            source: source.parse().ok()?,
            active: active.parse().ok()?,
            detail: detail.parse().ok()?,
        })),
        ["info", "bus", bus, "cleared", "free", free] => Some(Event::Cleared {
            bus: bus.parse().ok()?,
            free: free.parse().ok()?,
        }),
        _ => None,
    }
}

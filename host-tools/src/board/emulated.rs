//! The firmware's image in an emulated chip, with the sensors, buses and gripper around it that the loops in virtual time
//! have: boot, drivers, interrupts, DMA, execution times and stack are those of the image.

use anyhow::{Context, Result};
use firmware::events::Event;
use firmware::grip::kept::WORDS;
use firmware::wire::messages::FaultEvent;
use firmware::wire::serial::{Packet, Receiver};
use sim_board::log::LogLine;
use sim_board::wiring::Wiring;
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
        Self::wired(image, conditions, Wiring::NUCLEO_G474, world, gripper)
    }

    /// The same on another circuit board.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn wired(
        image: Image,
        conditions: Conditions,
        wiring: Wiring,
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
            wiring,
            i2c_synchronisation: conditions.i2c_synchronisation,
            lsi: conditions.lsi,
            seed: conditions.seed,
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

impl EmulatedBoard {
    /// As [`SimulatedBoard::take_events`], with the time since the board was switched on, to 100 us: its own clock begins
    /// with its program.
    pub fn take_dated_events(&mut self) -> Vec<(Time, Event)> {
        let logged = self.take_logged().into_iter();
        logged.map(|(line, event)| (line.time, event)).collect()
    }

    fn take_logged(&mut self) -> Vec<(LogLine, Event)> {
        let lines = self.chip.take_log().into_iter();
        lines
            .filter_map(|line| event(&line.text).map(|event| (line, event)))
            .collect()
    }

    /// Address of the copies of [`firmware::grip::kept`]: complements of single-precision numbers close to each other.
    fn copies_of_grasp(&self) -> Option<u32> {
        let pool = self
            .chip
            .image()
            .symbols_named("tasks::grip::POOL")
            .next()?;
        let memory = self.chip.soc.memory(pool.address, pool.length as usize)?;
        let words: Vec<u32> = memory
            .chunks_exact(4)
            .map(|bytes| u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
            .collect();
        // The first word are states, the sixth is of two numbers.
        let has_originals = |copies: &[u32]| {
            [1, 2, 3, 4, 6]
                .iter()
                .all(|&place| words.contains(&!copies[place]))
                && f32::from_bits(!copies[1]) > 0.0
        };
        let place = words.windows(WORDS).position(has_originals)?;
        Some(pool.address + 4 * place as u32)
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

    /// The copies lie in the memory of the grasp's task, next to what they are the complement of.
    ///
    /// # Panics
    /// The image has no such task.
    fn spoil_grasp(&mut self, bit: u32) {
        let found = self.copies_of_grasp();
        let copies = found.unwrap_or_else(|| panic!("no task that grasps in this image"));
        let address = copies + bit / 32 * 4;
        let memory = self.chip.soc.memory(address, 4).unwrap_or_default();
        let mut bytes: Vec<u8> = memory.to_vec();
        if let Some(byte) = bytes.get_mut((bit % 32 / 8) as usize) {
            *byte ^= 1 << (bit % 8);
        }
        self.chip.soc.write_memory(address, &bytes);
    }

    fn take_events(&mut self) -> Vec<(u64, Event)> {
        let logged = self.take_logged().into_iter();
        logged
            .filter_map(|(line, event)| {
                let time_us = 1e6 * line.stamp?.parse::<f64>().ok()?;
                Some((time_us as u64, event))
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

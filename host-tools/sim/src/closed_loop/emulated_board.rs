//! The firmware's image in an emulated chip, with the same connections and gripper as the tasks in virtual time: boot,
//! drivers, interrupts, DMA, execution times and stack are those of the image.

use crate::board::flash::{CALIBRATIONS, Flash};
use crate::board::inertial::InertialPins;
use crate::board::world::World;
use crate::board::{Connections, SimulatedBoard};
use crate::closed_loop::coupling::{PowerStagePins, RotorSensor, SharedGripper};
use anyhow::{Context, Result};
use emulator::log::LogLine;
use emulator::peripherals::flash::BANK;
use emulator::peripherals::gpio::Pin;
use emulator::wiring::Wiring;
use emulator::{Chip, CycleModel, Devices, Frequency, Image, Options, Time};
use firmware::board::selected::table::{self, Function};
use firmware::config::constants::AMPLIFIER_SETTLING;
use firmware::grip::redundant_copy::COPY_WORDS;
use firmware::parameters::Parameters;
use firmware::parameters::schema::id;
use firmware::protocol::messages::FaultEvent;
use firmware::protocol::serial::{Packet, PacketDecoder};
use firmware::system::faults::Event;
use firmware::system::nv_storage::ParameterStore;
use futures::executor::block_on;
use std::cell::RefCell;
use std::rc::Rc;

/// Properties that vary between chips.
#[derive(Clone, Copy, Debug)]
pub struct ChipConditions {
    /// Instruction timing.
    pub model: CycleModel,
    /// Delay of a bit on the sensor buses by edges and filter.
    pub i2c_delay: Time,
    /// Oscillator of the watchdog.
    pub lsi: Frequency,
    /// Seed of random numbers and of memory contents at power-on.
    pub seed: u64,
}

impl ChipConditions {
    /// Shortest execution times, fastest buses, slowest watchdog.
    pub const FAST: Self = Self {
        model: CycleModel::FAST,
        i2c_delay: Time::from_ns(100),
        lsi: Frequency(29_500),
        seed: 1,
    };

    /// Typical values.
    pub const TYPICAL: Self = Self {
        model: CycleModel::TYPICAL,
        i2c_delay: Time::from_ns(360),
        lsi: Frequency(32_000),
        seed: 2,
    };

    /// Longest execution times, slowest buses, fastest watchdog.
    pub const SLOW: Self = Self {
        model: CycleModel::SLOW,
        i2c_delay: Time::from_ns(625),
        lsi: Frequency(34_000),
        seed: 3,
    };
}

/// The circuit board by the table of the firmware's board.
pub fn wiring() -> Wiring {
    Wiring {
        sensor_buses: [pins(&table::FIRST_BUS), pins(&table::SECOND_BUS)],
        can: pins(&table::CAN),
        serial: pins(&table::SERIAL),
        encoder: pins(&table::ENCODER),
        inertial: pins(&table::INERTIAL),
        bridges: [pins(&table::HIGH_SIDES), pins(&table::LOW_SIDES)],
        gate_fault: pins::<1>(&table::BREAK)[0],
        analog: pins(&table::ANALOG),
        thermistors: pins(&table::THERMISTORS),
        crystal: Frequency(table::CRYSTAL_HZ),
    }
}

fn pins<const N: usize>(function: &Function) -> [Pin; N] {
    std::array::from_fn(|index| Pin::named(function.pins[index].1))
}

/// A board that runs an image.
pub struct EmulatedBoard {
    /// Emulated chip.
    pub chip: Chip,
    /// Connections of the board.
    pub connections: Connections,
}

impl EmulatedBoard {
    /// Programs an image into a chip and switches it on, with a world and a gripper. The limits of the bench were removed before.
    ///
    /// # Errors
    /// The chip does not start from flash.
    pub fn start(
        image: Image,
        conditions: ChipConditions,
        world: Box<dyn World>,
        gripper: SharedGripper,
    ) -> Result<Self> {
        Self::wired(image, conditions, wiring(), world, gripper)
    }

    /// As [`Self::start`], on another circuit board.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn wired(
        image: Image,
        conditions: ChipConditions,
        wiring: Wiring,
        world: Box<dyn World>,
        gripper: SharedGripper,
    ) -> Result<Self> {
        let mut board = Self::unused(image, conditions, wiring, world, gripper)?;
        let mut parameters = Parameters::DEFAULT;
        // The value is in its range.
        let _ = parameters.set(id::BENCH, 0);
        board.store(&parameters);
        Ok(board)
    }

    /// Stores parameters as if they had been saved before the chip was switched on.
    pub fn store(&mut self, parameters: &Parameters) {
        let flash = Flash::default();
        // Cannot fail on an empty flash.
        let _ = block_on(ParameterStore::new(flash.clone(), 0).save(parameters));
        let mut pages = flash.bytes();
        pages.truncate(CALIBRATIONS as usize);
        // In the last pages of the flash (memory.x).
        self.chip.soc.load_flash(2 * BANK - pages.len(), &pages);
    }

    /// As [`Self::wired`], never operated: without stored parameters, and so with the limits of the bench.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn unused(
        image: Image,
        conditions: ChipConditions,
        wiring: Wiring,
        world: Box<dyn World>,
        gripper: SharedGripper,
    ) -> Result<Self> {
        gripper.borrow_mut().connect_chip();
        let connections = Connections::new(world);
        let devices = devices(&connections, gripper);
        let options = Options {
            wiring,
            i2c_delay: conditions.i2c_delay,
            lsi: conditions.lsi,
            amplifier_settling: Time::from_ns((1e3 * AMPLIFIER_SETTLING.value) as u64),
            seed: conditions.seed,
        };
        let chip = Chip::new(image, conditions.model, options, devices)
            .context("the image does not start")?;
        Ok(Self { chip, connections })
    }

    /// A copy in its present state, which goes on with copies of its world and gripper.
    pub fn copy(&self, world: Box<dyn World>, gripper: SharedGripper) -> Self {
        let connections = self.connections.copy(world);
        let chip = self.chip.copy(devices(&connections, gripper));
        Self { chip, connections }
    }

    /// Bytes of the serial line since the last call.
    pub fn take_sent(&self) -> SerialCapture {
        let mut line = self.connections.line.borrow_mut();
        SerialCapture {
            bytes: std::mem::take(&mut line.sent),
            ended: std::mem::take(&mut line.ended),
        }
    }

    /// Packets of the serial line since the last call, with their end times.
    pub fn take_packets(&self, receiver: &mut PacketDecoder) -> Vec<(Time, Packet)> {
        self.take_sent().packets(receiver)
    }
}

/// What is at the chip's pins.
fn devices(connections: &Connections, gripper: SharedGripper) -> Devices {
    let [first, second] = connections.buses.clone();
    Devices {
        sensor_buses: [first, second],
        spi: [
            Rc::new(RefCell::new(RotorSensor(gripper.clone()))),
            Rc::new(RefCell::new(InertialPins(connections.inertial.clone()))),
        ],
        drivetrain: Rc::new(RefCell::new(PowerStagePins(gripper))),
        can: connections.can.clone(),
        serial: connections.line.clone(),
    }
}

/// Captured bytes of the serial line.
pub struct SerialCapture {
    /// Captured bytes.
    pub bytes: Vec<u8>,
    /// End time of each zero byte.
    ended: Vec<Time>,
}

impl SerialCapture {
    /// Decodes the packets, with their end times.
    pub fn packets(&self, receiver: &mut PacketDecoder) -> Vec<(Time, Packet)> {
        let mut ended = self.ended.iter();
        let mut packets = Vec::new();
        for &byte in &self.bytes {
            let time = if byte == 0 { ended.next() } else { None };
            if let (Some(packet), Some(time)) = (receiver.push(byte), time) {
                packets.push((*time, packet));
            }
        }
        packets
    }
}

impl EmulatedBoard {
    /// As [`SimulatedBoard::take_events`], with the time since power-on, to 100 us; the board's own clock starts
    /// with its program.
    pub fn take_dated_events(&mut self) -> Vec<(Time, Event)> {
        let logged = self.take_logged().into_iter();
        logged.map(|(line, event)| (line.time, event)).collect()
    }

    fn take_logged(&mut self) -> Vec<(LogLine, Event)> {
        let lines = self.chip.take_log().into_iter();
        lines.filter_map(|line| event(&line.text).map(|event| (line, event))).collect()
    }

    /// Address of the shadow copies of [`firmware::grip::redundant_copy`]: complements of adjacent single-precision numbers.
    fn copies_of_grasp(&self) -> Option<u32> {
        let pool = self.chip.image().symbols_named("tasks::control::POOL").next()?;
        let memory = self.chip.soc.memory(pool.address, pool.length as usize)?;
        let words: Vec<u32> = memory
            .chunks_exact(4)
            .map(|bytes| u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
            .collect();
        // The first word contains states, the sixth two numbers.
        let has_originals = |copies: &[u32]| {
            [1, 2, 3, 4, 6].iter().all(|&place| words.contains(&!copies[place]))
                && f32::from_bits(!copies[1]) > 0.0
        };
        let place = words.windows(COPY_WORDS).position(has_originals)?;
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

    /// The copies are in the memory of the grasp task.
    ///
    /// # Panics
    /// The image has no grasp task.
    fn corrupt_grasp_memory(&mut self, bit: u32) {
        let found = self.copies_of_grasp();
        let copies = found.unwrap_or_else(|| panic!("the image has no grasp task"));
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

/// Parses an event from a line of the image's log.
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
        ["info", "bus", bus, "cleared", "free", free] => {
            Some(Event::BusCleared { bus: bus.parse().ok()?, free: free.parse().ok()? })
        }
        _ => None,
    }
}

//! The rows' faults, each done where it arises: bytes on a bus, counts of a converter, a frame, the rotor, the object.

use firmware::grip::kept::WORDS;
use firmware::hall::a31301::FIELD_LIMITS;
use firmware::motor::limits::Temperatures;
use firmware::motor::{Order, as5047};
use firmware::params;

use super::row::{GROUND, Row};
use crate::board::SimulatedBoard;
use crate::board::i2c::Sensor;
use crate::drive::grasp::object;
use crate::drive::workcell::Workcell;
use crate::plant::impact::Impact;

/// Bits from one that may be turned to the next; twelve of them are in all words.
const BITS: u32 = 45;
/// Counts by which the rotor's angle jumps: 0.5 rad.
const JUMP: u16 = 1304;
/// Force in N of something that swells, and newtons to the millimetre of its contact.
const SWELLS_N: f64 = 470.0;
const RIGID: f64 = params::CONTACT_STIFFNESS.value;
/// A magnet's field at every sensor, in gauss.
const MAGNET_G: f64 = 15.0;
/// Rotor's speed in rad/s that is too fast.
const FAST: f64 = 220.0;

/// Counts of the bus voltage.
fn bus_counts(volts: f64) -> u16 {
    (1e3 * volts / params::BUS_SCALE.value) as u16
}

impl Row {
    /// Lets it happen; `pick` chooses the sensor.
    pub fn inject<B: SimulatedBoard>(self, cell: &mut Workcell<B>, pick: usize) {
        match self {
            Self::BusHigh | Self::BusLow => {
                let bus = bus_counts(if self == Self::BusHigh { 34.0 } else { 14.0 });
                counts(cell, move |[u, v, w, _]| [u, v, w, bus]);
            }
            Self::CurrentOffset => {
                let off = (2e3 / params::CURRENT_SCALE.value) as u16;
                counts(cell, move |mut counts| {
                    let phase = &mut counts[pick % 3];
                    *phase = phase.saturating_add(off);
                    counts
                });
            }
            Self::EncoderChecksum => frames(cell, |frame| frame ^ 1),
            Self::EncoderStuck => {
                let mut first = None;
                frames(cell, move |frame| *first.get_or_insert(frame));
            }
            Self::EncoderJump => frames(cell, |frame| {
                let angle = as5047::angle(frame).unwrap_or_default();
                as5047::answer(angle.wrapping_add(JUMP))
            }),
            Self::OverSpeed => {
                let mut gripper = cell.gripper.borrow_mut();
                let ratio = gripper.rig.plant.parameters().screw.travel_m_per_rad;
                let train = &mut gripper.rig.plant.train;
                // The way it goes: a rotor that turns back from one period to the next is another fault.
                let way = if train.speed_rad_s > 1.0 { FAST } else { -FAST };
                (train.speed_rad_s, train.travel_m_s) = (way, way * ratio);
            }
            Self::Hot => {
                let mut gripper = cell.gripper.borrow_mut();
                gripper.rig.motor.obey(Order::Temperatures(Temperatures {
                    motor: None,
                    stage: Some(115.0),
                }));
            }
            Self::Jam => cell.gripper.borrow_mut().wrong.is_jammed = true,
            Self::OverForce => {
                let mut gripper = cell.gripper.borrow_mut();
                let plant = &mut gripper.rig.plant;
                // As if the thing swelled into the fingertips: 470 N.
                let width_mm = 1e3 * plant.opening_m() + SWELLS_N / RIGID;
                let object = object(plant.parameters(), width_mm, RIGID);
                plant.hold(Some(&object));
            }
            Self::SensorGone => sensor(cell, pick, |sensor| sensor.unplugged = true),
            Self::SensorFrozen => sensor(cell, pick, |sensor| sensor.frozen = true),
            Self::HalfGain => sensor(cell, pick, |sensor| sensor.gain = 0.5),
            Self::BrownOut => sensor(cell, pick, Sensor::brown_out),
            Self::LineLow => cell.board.connections().buses[pick % 2].borrow_mut().held = u32::MAX,
            Self::Saturated => {
                let (_, end) = FIELD_LIMITS;
                sensor(cell, pick, |sensor| {
                    sensor.beside = [2.0 * f64::from(end); 3]
                });
            }
            Self::Magnet => {
                let counts = MAGNET_G / params::SENSOR_SCALE.value;
                for number in 0..4 {
                    sensor(cell, number, |sensor| sensor.beside = [0.0, counts, 0.0]);
                }
            }
            Self::Corrupted => {
                let bit = BITS * pick as u32 % (32 * WORDS as u32);
                cell.board.spoil_grasp(bit);
            }
            Self::BusOff => cell.board.connections().can.borrow_mut().disturbed = true,
            Self::HostSilent => cell.host.is_silent = true,
            // Frame by frame, in the run.
            Self::Flood => {}
            Self::ObjectGone => cell.gripper.borrow_mut().rig.plant.hold(None),
            Self::FootOverload => {
                let mut gripper = cell.gripper.borrow_mut();
                let start_s = gripper.rig.plant.time_s();
                let (peak_n, lasts_s) = GROUND;
                gripper.impacts.push(Impact {
                    start_s,
                    lasts_s,
                    peak_n,
                });
            }
        }
    }
}

fn counts<B>(cell: &mut Workcell<B>, change: impl FnMut([u16; 4]) -> [u16; 4] + 'static) {
    cell.gripper.borrow_mut().wrong.counts = Some(Box::new(change));
}

fn frames<B>(cell: &mut Workcell<B>, change: impl FnMut(u16) -> u16 + 'static) {
    cell.gripper.borrow_mut().wrong.frame = Some(Box::new(change));
}

fn sensor<B: SimulatedBoard>(cell: &Workcell<B>, number: usize, change: impl Fn(&mut Sensor)) {
    for bus in &cell.board.connections().buses {
        let sensors = &mut bus.borrow_mut().sensors;
        let of_number = sensors.iter_mut().filter(|s| s.number == number % 4);
        of_number.for_each(&change);
    }
}

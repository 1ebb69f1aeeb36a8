//! Injected faults: what is done to the gripper, the specified detection and its latency.

use crate::board::SimulatedBoard;
use crate::board::i2c::I2cSensor;
use crate::closed_loop::grasp_rig::contact_object;
use crate::closed_loop::{ClosedLoop, ClosedLoopSetup, DisabledProtection};
use crate::drivetrain::fingertips::Impact;
use crate::drivetrain::sensors::ROOM_C;
use crate::faults::hazards::HazardTable;
use crate::faults::operating_state::OperatingState;
use firmware::config::constants::{self, TICK_US};
use firmware::config::limits::GripLimits;
use firmware::grip::fault_reactions::Reaction;
use firmware::grip::redundant_copy::COPY_WORDS;
use firmware::motor::as5047;
use firmware::sensors::hall::SENSORS;
use firmware::sensors::hall::a31301::FIELD_LIMITS;
use firmware::system::faults::Fault;
use std::f64::consts::PI;

/// A fault of the fault matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InjectedFault {
    BusHigh,
    BusLow,
    CurrentOffset,
    EncoderChecksum,
    EncoderStuck,
    EncoderJump,
    OverSpeed,
    Hot,
    Jam,
    OverForce,
    OverForceAside,
    SensorGone,
    AllSensorsGone,
    SensorFrozen,
    HalfGain,
    LineLow,
    BrownOut,
    Saturated,
    Magnet,
    MemoryCorruption,
    BusOff,
    HostSilent,
    Flood,
    ObjectGone,
    FootOverload,
}

/// Specification of a fault.
pub struct FaultSpecification {
    /// Number in the fault matrix.
    pub number: u8,
    /// Short description.
    pub description: &'static str,
    /// Fault code that the firmware must report.
    pub fault: Fault,
    /// Maximum detection latency in milliseconds.
    pub within_ms: f64,
    /// Operating states in which it is detectable.
    pub states: &'static [OperatingState],
    /// Disables its detector.
    pub disable_detector: fn(&mut ClosedLoopSetup),
}

const EVERYWHERE: &[OperatingState] = &OperatingState::ALL;
/// States with a session: all but the calibration.
const SESSION: &[OperatingState] = match OperatingState::ALL.split_last() {
    Some((OperatingState::Calibrating, states)) => states,
    _ => panic!("the last operating state is the calibration"),
};
const CLOSING: &[OperatingState] =
    &[OperatingState::Approach, OperatingState::Moving, OperatingState::Homing];
const GRIPPED: &[OperatingState] = &[OperatingState::Force, OperatingState::Hold];
const FREE: &[OperatingState] = &[
    OperatingState::Approach,
    OperatingState::Idle,
    OperatingState::Moving,
    OperatingState::Homing,
    OperatingState::Opening,
];
const HELD: &[OperatingState] = &[OperatingState::Hold];
const FOOT: &[OperatingState] = &[OperatingState::Foot];

/// Overload on the ground: peak force on all fingertips in N, duration in s.
pub(super) const GROUND: (f64, f64) = (900.0, 0.04);

impl InjectedFault {
    /// All faults.
    pub const ALL: [Self; 25] = [
        Self::BusHigh,
        Self::BusLow,
        Self::CurrentOffset,
        Self::EncoderChecksum,
        Self::EncoderStuck,
        Self::EncoderJump,
        Self::OverSpeed,
        Self::Hot,
        Self::Jam,
        Self::OverForce,
        Self::OverForceAside,
        Self::SensorGone,
        Self::AllSensorsGone,
        Self::SensorFrozen,
        Self::HalfGain,
        Self::LineLow,
        Self::BrownOut,
        Self::Saturated,
        Self::Magnet,
        Self::MemoryCorruption,
        Self::BusOff,
        Self::HostSilent,
        Self::Flood,
        Self::ObjectGone,
        Self::FootOverload,
    ];

    /// Specification of this fault.
    pub fn specification(self) -> FaultSpecification {
        let specification = |number, description, fault, within_ms, states, disable_detector| {
            FaultSpecification { number, description, fault, within_ms, states, disable_detector }
        };
        match self {
            Self::BusHigh => {
                specification(7, "bus at 34 V", Fault::Supply, 0.1, EVERYWHERE, |setup| {
                    setup.motor.overvoltage_v = 1e3;
                    setup.motor.dissipation_v = [1e3, 1e3 + 1.0];
                })
            }
            Self::BusLow => {
                specification(7, "bus at 14 V", Fault::Supply, 0.1, EVERYWHERE, |setup| {
                    setup.motor.undervoltage_v = [1.0, 2.0];
                })
            }
            Self::CurrentOffset => specification(
                8,
                "current offset of 2 A",
                Fault::CurrentSense,
                5.0,
                EVERYWHERE,
                |setup| {
                    setup.motor.sum_periods = u16::MAX;
                    setup.motor.tracking_error_periods = u16::MAX;
                },
            ),
            Self::EncoderChecksum => specification(
                9,
                "rotor sensor: parity",
                Fault::RotorSensor,
                2.0,
                EVERYWHERE,
                |setup| {
                    setup.motor.bridged_angles = u8::MAX;
                },
            ),
            Self::EncoderStuck => specification(
                9,
                "rotor sensor: stuck",
                Fault::RotorSensor,
                2.0,
                EVERYWHERE,
                |setup| {
                    setup.motor.stuck_periods = None;
                    setup.motor.unexplained_periods = u16::MAX;
                },
            ),
            Self::EncoderJump => specification(
                9,
                "rotor sensor: jump",
                Fault::RotorSensor,
                2.0,
                EVERYWHERE,
                |setup| {
                    setup.motor.bridged_angles = u8::MAX;
                },
            ),
            Self::OverSpeed => {
                specification(10, "rotor at 220 rad/s", Fault::OverSpeed, 2.0, FREE, |setup| {
                    setup.motor.trip_speed = 1e6;
                })
            }
            Self::Hot => {
                specification(11, "power stage at 115 C", Fault::Hot, 100.0, EVERYWHERE, |setup| {
                    setup.motor.stage_c = [1e3, 1e3 + 1.0];
                })
            }
            Self::Jam => specification(12, "rotor locked", Fault::Jammed, 60.0, CLOSING, |setup| {
                setup.grasp.stall_ms = u16::MAX;
            }),
            Self::OverForce => specification(
                14,
                "grip force above 450 N",
                Fault::OverForce,
                2.0,
                GRIPPED,
                |setup| {
                    setup.grasp.trip_n = 1e6;
                    setup.grasp.beyond_n = 1e6;
                },
            ),
            Self::OverForceAside => specification(
                14,
                "grip force above 450 N, off centre",
                Fault::OverForce,
                25.0,
                GRIPPED,
                |setup| {
                    setup.grasp.beyond_n = 1e6;
                },
            ),
            Self::SensorGone => {
                specification(15, "sensor unplugged", Fault::SensorLost, 2.2, EVERYWHERE, |setup| {
                    setup.limits.lost_ticks = u8::MAX;
                })
            }
            Self::AllSensorsGone => {
                specification(15, "all sensors unplugged", Fault::Blind, 4.2, EVERYWHERE, |setup| {
                    setup.grasp.invalid_ticks = u8::MAX;
                })
            }
            Self::SensorFrozen => {
                specification(16, "sensor frozen", Fault::SensorFrozen, 4.2, EVERYWHERE, |setup| {
                    setup.limits.frozen_axes = None;
                })
            }
            Self::HalfGain => specification(
                17,
                "sensor gain halved",
                Fault::OutsideModel,
                12.0,
                EVERYWHERE,
                |setup| {
                    setup.limits.outside_ticks = u8::MAX;
                },
            ),
            Self::LineLow => {
                specification(18, "sensor bus shorted", Fault::BusStuck, 5.0, EVERYWHERE, |setup| {
                    setup.limits.stuck_ticks = u8::MAX;
                })
            }
            Self::BrownOut => specification(
                19,
                "sensor configuration lost",
                Fault::SensorLost,
                100.0,
                EVERYWHERE,
                |setup| {
                    setup.limits.config_mismatches = None;
                },
            ),
            Self::Saturated => specification(
                20,
                "sensor saturated",
                Fault::SensorSaturated,
                1.0,
                EVERYWHERE,
                |setup| {
                    setup.limits.saturated_ticks = u8::MAX;
                },
            ),
            Self::Magnet => {
                specification(21, "magnet of 15 G", Fault::Disturbed, 20.0, EVERYWHERE, |setup| {
                    setup.disabled = Some(DisabledProtection::DisturbanceDetection);
                })
            }
            Self::MemoryCorruption => {
                specification(24, "bit flip in memory", Fault::Crashed, 1.0, EVERYWHERE, |setup| {
                    setup.disabled = Some(DisabledProtection::MemoryCheck);
                })
            }
            Self::BusOff => {
                specification(25, "CAN disturbed", Fault::BusOff, 1.0, EVERYWHERE, |setup| {
                    setup.disabled = Some(DisabledProtection::BusOffDetection);
                })
            }
            Self::HostSilent => {
                specification(26, "host silent", Fault::HostSilent, 101.0, SESSION, |setup| {
                    setup.disabled = Some(DisabledProtection::HostTimeout);
                })
            }
            Self::Flood => specification(
                27,
                "20,000 frames a second",
                Fault::Flooded,
                10.0,
                EVERYWHERE,
                |setup| {
                    setup.limits.flood_frames = u8::MAX;
                },
            ),
            Self::ObjectGone => {
                specification(30, "object pulled out", Fault::ObjectLost, 5.0, HELD, |setup| {
                    setup.grasp.object_lost_ms = u16::MAX;
                })
            }
            Self::FootOverload => {
                specification(31, "225 N on a fingertip", Fault::FootOverload, 1.0, FOOT, |setup| {
                    setup.grasp.overload_n = 1e6;
                })
            }
        }
    }

    /// Whether the motor control detects it, within a few PWM periods.
    pub const fn is_found_by_motor(self) -> bool {
        matches!(
            self,
            Self::BusHigh
                | Self::BusLow
                | Self::CurrentOffset
                | Self::EncoderChecksum
                | Self::EncoderStuck
                | Self::EncoderJump
                | Self::OverSpeed
        )
    }

    /// Earliest time of detection in microseconds, for an injection at `at_us` and a next sensor tick at
    /// `tick_us`.
    pub fn observable_us(self, at_us: u64, tick_us: u64) -> u64 {
        match self {
            Self::FootOverload => {
                let (peak_n, lasts_s) = GROUND;
                // With a margin for the sensors' own error.
                let share = 1.02 * 4.0 * f64::from(GripLimits::GRIPPER.overload_n) / peak_n;
                let crosses_us = at_us + (1e6 * lasts_s * share.asin() / PI) as u64;
                // The first sample after it.
                tick_us + TICK_US * crosses_us.saturating_sub(tick_us).div_ceil(TICK_US)
            }
            Self::SensorGone
            | Self::AllSensorsGone
            | Self::SensorFrozen
            | Self::HalfGain
            | Self::LineLow
            | Self::BrownOut
            | Self::Saturated
            | Self::Magnet
            | Self::MemoryCorruption
            | Self::OverForce
            | Self::OverForceAside
            | Self::ObjectGone => tick_us,
            _ => at_us,
        }
    }

    /// Whether it is a fault of one force sensor, after which a grip of 100 N must stay below 110 N.
    pub const fn is_of_sensor(self) -> bool {
        matches!(
            self,
            Self::SensorGone
                | Self::SensorFrozen
                | Self::HalfGain
                | Self::LineLow
                | Self::BrownOut
                | Self::Saturated
        )
    }

    /// Reaction that the hazard table requires.
    pub fn reaction(self, situation: OperatingState, locks: bool) -> Option<Reaction> {
        HazardTable::gripper().reaction(self.specification().fault, situation.phase(), locks)
    }
}

/// Spacing of the candidate bits; twelve of them cover all words.
const BIT_SPACING: u32 = 45;
/// Jump of the rotor angle in counts: 0.5 rad.
const JUMP: u16 = 1304;
/// Contact of an object that expands off centre: one sensor of each finger leaves the range of the model.
const OFF_CENTRE: f64 = 0.8;
/// Force in N of an expanding object, and contact stiffness in N/mm.
pub(super) const EXPANSION_N: f64 = 470.0;
const RIGID: f64 = constants::CONTACT_STIFFNESS.value;
/// Field of a magnet at every sensor, in gauss.
const MAGNET_G: f64 = 15.0;
/// Excessive rotor speed in rad/s.
const OVER_SPEED_RAD_S: f64 = 220.0;

/// ADC counts of a bus voltage.
fn bus_counts(volts: f64) -> u16 {
    (1e3 * volts / constants::BUS_SCALE.value) as u16
}

impl InjectedFault {
    /// Injects the fault; `pick` selects the sensor.
    pub fn inject<B: SimulatedBoard>(self, cell: &mut ClosedLoop<B>, pick: usize) {
        match self {
            Self::BusHigh | Self::BusLow => {
                let bus = bus_counts(if self == Self::BusHigh { 34.0 } else { 14.0 });
                counts(cell, move |[u, v, w, _]| [u, v, w, bus]);
            }
            Self::CurrentOffset => {
                let off = (2e3 / constants::CURRENT_SCALE.value) as u16;
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
                // In the direction of motion: a reversal from one period to the next is another fault.
                let speed_rad_s =
                    if train.speed_rad_s > 1.0 { OVER_SPEED_RAD_S } else { -OVER_SPEED_RAD_S };
                (train.speed_rad_s, train.travel_m_s) = (speed_rad_s, speed_rad_s * ratio);
            }
            Self::Hot => cell.gripper.borrow_mut().temperatures_c = [ROOM_C, 115.0],
            Self::Jam => cell.gripper.borrow_mut().errors.is_jammed = true,
            Self::OverForce => {
                cell.gripper.borrow_mut().towards_first = 0.0;
                expand(cell, 1.0);
            }
            // Expands during the run.
            Self::OverForceAside => {
                let towards_first = OFF_CENTRE.copysign(pick as f64 - 5.5);
                cell.gripper.borrow_mut().towards_first = towards_first;
            }
            Self::SensorGone => sensor(cell, pick, |sensor| sensor.unplugged = true),
            Self::AllSensorsGone => {
                (0..SENSORS)
                    .for_each(|number| sensor(cell, number, |sensor| sensor.unplugged = true));
            }
            Self::SensorFrozen => sensor(cell, pick, |sensor| sensor.frozen = true),
            Self::HalfGain => sensor(cell, pick, |sensor| sensor.gain = 0.5),
            Self::BrownOut => sensor(cell, pick, I2cSensor::brown_out),
            Self::LineLow => {
                cell.board.connections().buses[pick % 2].borrow_mut().data_low_clocks = u32::MAX
            }
            Self::Saturated => {
                let (_, end) = FIELD_LIMITS;
                sensor(cell, pick, |sensor| sensor.extra_field = [2.0 * f64::from(end); 3]);
            }
            Self::Magnet => {
                let counts = MAGNET_G / constants::SENSOR_SCALE.value;
                for number in 0..4 {
                    sensor(cell, number, |sensor| sensor.extra_field = [0.0, counts, 0.0]);
                }
            }
            Self::MemoryCorruption => {
                let bit = BIT_SPACING * pick as u32 % (32 * COPY_WORDS as u32);
                cell.board.corrupt_grasp_memory(bit);
            }
            Self::BusOff => cell.board.connections().can.borrow_mut().disturbed = true,
            Self::HostSilent => cell.host.is_silent = true,
            // Injected frame by frame during the run.
            Self::Flood => {}
            Self::ObjectGone => cell.gripper.borrow_mut().rig.plant.set_object(None),
            Self::FootOverload => {
                let mut gripper = cell.gripper.borrow_mut();
                let start_s = gripper.rig.plant.time_s();
                let (peak_n, lasts_s) = GROUND;
                gripper.impacts.push(Impact { start_s, lasts_s, peak_n });
            }
        }
    }
}

/// The object swells into the fingertips, by a share of the deflection under 470 N.
pub(super) fn expand<B>(cell: &mut ClosedLoop<B>, share: f64) {
    let plant = &mut cell.gripper.borrow_mut().rig.plant;
    let width_mm = 1e3 * plant.opening_m() + share * EXPANSION_N / RIGID;
    let object = contact_object(plant.parameters(), width_mm, RIGID);
    plant.set_object(Some(&object));
}

fn counts<B>(cell: &mut ClosedLoop<B>, change: impl FnMut([u16; 4]) -> [u16; 4] + 'static) {
    cell.gripper.borrow_mut().errors.counts = Some(Box::new(change));
}

fn frames<B>(cell: &mut ClosedLoop<B>, change: impl FnMut(u16) -> u16 + 'static) {
    cell.gripper.borrow_mut().errors.frame = Some(Box::new(change));
}

fn sensor<B: SimulatedBoard>(cell: &ClosedLoop<B>, number: usize, change: impl Fn(&mut I2cSensor)) {
    for bus in &cell.board.connections().buses {
        let sensors = &mut bus.borrow_mut().sensors;
        let of_number = sensors.iter_mut().filter(|s| s.number == number % 4);
        of_number.for_each(&change);
    }
}

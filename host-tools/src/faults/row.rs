//! The rows of the matrix of faults: what is done to the gripper, what should be found, and within what time.

use std::f64::consts::PI;

use firmware::grip::react::{Reaction, reaction};
use firmware::limits::Grasp;
use firmware::params::TICK_US;
use firmware::status::Fault;

use super::situation::Situation;
use crate::drive::workcell::Plan;

/// Rows that only hardware or the image can show. They are looked at there, register by register, and no run
/// counts for them.
pub const ELSEWHERE: [(u8, &str); 5] = [
    (1, "phase over-current, at the comparators"),
    (2, "locked-up core, clock, memory parity, flash errors"),
    (4, "the motor's interrupt late or gone"),
    (5, "the force loop gone: watchdog"),
    (6, "a clock that is wrong"),
];

/// Rows that other tests show and no run here.
pub const BESIDE: [(u8, &str); 7] = [
    (3, "panics: firmware/src/crash.rs"),
    (13, "the stroke: firmware/src/grip/tests/layers.rs"),
    (22, "a network astray: firmware/src/astray.rs"),
    (23, "tables: firmware/src/loops/scrub.rs"),
    (28, "strange frames: tests/scenarios"),
    (29, "a save that is cut off: firmware/src/store"),
    (32, "commands for another state: firmware/src/grip/tests"),
];

/// What is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // The words of each row say it.
pub enum Row {
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
    SensorGone,
    SensorFrozen,
    HalfGain,
    LineLow,
    BrownOut,
    Saturated,
    Magnet,
    Corrupted,
    BusOff,
    HostSilent,
    Flood,
    ObjectGone,
    FootOverload,
}

/// What is known of a row.
pub struct Facts {
    /// Its number in the matrix.
    pub number: u8,
    /// In words.
    pub words: &'static str,
    /// The fault that should be told.
    pub fault: Fault,
    /// Milliseconds within which it should be found.
    pub within_ms: f64,
    /// Situations in which it shows.
    pub shows: &'static [Situation],
    /// Raises its detector out of reach; none where its threshold is no limit.
    pub off: Option<fn(&mut Plan)>,
}

const EVERYWHERE: &[Situation] = &Situation::ALL;
const CLOSING: &[Situation] = &[Situation::Approach];
const GRIPPED: &[Situation] = &[Situation::Force, Situation::Hold];
const FREE: &[Situation] = &[Situation::Approach, Situation::Idle];
const HELD: &[Situation] = &[Situation::Hold];
const STANDING: &[Situation] = &[Situation::Foot];

/// The ground's force on all fingertips, in N, and for how long it pushes, in s.
pub(super) const GROUND: (f64, f64) = (900.0, 0.04);

impl Row {
    /// All.
    pub const ALL: [Self; 23] = [
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
        Self::SensorGone,
        Self::SensorFrozen,
        Self::HalfGain,
        Self::LineLow,
        Self::BrownOut,
        Self::Saturated,
        Self::Magnet,
        Self::Corrupted,
        Self::BusOff,
        Self::HostSilent,
        Self::Flood,
        Self::ObjectGone,
        Self::FootOverload,
    ];

    /// What is known of it.
    pub fn facts(self) -> Facts {
        let facts = |number, words, fault, within_ms, shows, off| Facts {
            number,
            words,
            fault,
            within_ms,
            shows,
            off,
        };
        match self {
            Self::BusHigh => facts(
                7,
                "bus at 34 V",
                Fault::Supply,
                0.1,
                EVERYWHERE,
                Some(|plan| {
                    plan.motor.high_v = 1e3;
                    plan.motor.burn_v = [1e3, 1e3 + 1.0];
                }),
            ),
            Self::BusLow => facts(
                7,
                "bus at 14 V",
                Fault::Supply,
                0.1,
                EVERYWHERE,
                Some(|plan| {
                    plan.motor.low_v = [1.0, 2.0];
                }),
            ),
            Self::CurrentOffset => facts(
                8,
                "a current off by 2 A",
                Fault::CurrentSense,
                5.0,
                EVERYWHERE,
                Some(|plan| {
                    plan.motor.sum_periods = u16::MAX;
                    plan.motor.unfollowed_periods = u16::MAX;
                }),
            ),
            Self::EncoderChecksum => facts(
                9,
                "rotor's sensor: parity",
                Fault::RotorSensor,
                2.0,
                EVERYWHERE,
                None,
            ),
            Self::EncoderStuck => facts(
                9,
                "rotor's sensor: stuck",
                Fault::RotorSensor,
                2.0,
                EVERYWHERE,
                Some(|plan| {
                    plan.motor.stuck_periods = u16::MAX;
                    plan.motor.beside_periods = u16::MAX;
                }),
            ),
            Self::EncoderJump => facts(
                9,
                "rotor's sensor: jump",
                Fault::RotorSensor,
                2.0,
                EVERYWHERE,
                None,
            ),
            Self::OverSpeed => facts(
                10,
                "rotor at 220 rad/s",
                Fault::OverSpeed,
                2.0,
                FREE,
                Some(|plan| {
                    plan.motor.trip_speed = 1e6;
                }),
            ),
            Self::Hot => facts(
                11,
                "power stage at 115 C",
                Fault::Hot,
                100.0,
                EVERYWHERE,
                Some(|plan| {
                    plan.motor.stage_c = [1e3, 1e3 + 1.0];
                }),
            ),
            Self::Jam => facts(
                12,
                "rotor held",
                Fault::Jammed,
                60.0,
                CLOSING,
                Some(|plan| {
                    plan.grasp.jam_ms = u16::MAX;
                }),
            ),
            Self::OverForce => facts(
                14,
                "pressed beyond 450 N",
                Fault::OverForce,
                2.0,
                GRIPPED,
                None,
            ),
            Self::SensorGone => facts(
                15,
                "a sensor unplugged",
                Fault::SensorLost,
                2.2,
                EVERYWHERE,
                Some(|plan| {
                    plan.limits.lost_ticks = u8::MAX;
                }),
            ),
            Self::SensorFrozen => facts(
                16,
                "a sensor frozen",
                Fault::SensorFrozen,
                3.2,
                EVERYWHERE,
                Some(|plan| {
                    plan.limits.frozen_axes = u8::MAX;
                }),
            ),
            Self::HalfGain => facts(
                17,
                "a sensor of half gain",
                Fault::OutsideModel,
                12.0,
                EVERYWHERE,
                Some(|plan| {
                    plan.limits.outside_ticks = u8::MAX;
                }),
            ),
            Self::LineLow => facts(
                18,
                "a sensors' bus shorted",
                Fault::BusStuck,
                5.0,
                EVERYWHERE,
                Some(|plan| {
                    plan.limits.stuck_ticks = u8::MAX;
                }),
            ),
            Self::BrownOut => facts(
                19,
                "a sensor's configuration lost",
                Fault::SensorLost,
                100.0,
                EVERYWHERE,
                Some(|plan| {
                    plan.limits.strange_looks = u8::MAX;
                }),
            ),
            Self::Saturated => facts(
                20,
                "a sensor saturated",
                Fault::SensorSaturated,
                1.0,
                EVERYWHERE,
                None,
            ),
            Self::Magnet => facts(
                21,
                "a magnet of 15 G",
                Fault::Disturbed,
                20.0,
                EVERYWHERE,
                None,
            ),
            Self::Corrupted => facts(
                24,
                "a bit turned in memory",
                Fault::Crashed,
                1.0,
                EVERYWHERE,
                None,
            ),
            Self::BusOff => facts(25, "CAN disturbed", Fault::BusOff, 1.0, EVERYWHERE, None),
            Self::HostSilent => facts(
                26,
                "host silent",
                Fault::HostSilent,
                101.0,
                EVERYWHERE,
                None,
            ),
            Self::Flood => facts(
                27,
                "20,000 frames a second",
                Fault::Flooded,
                10.0,
                EVERYWHERE,
                Some(|plan| {
                    plan.limits.flood_frames = u8::MAX;
                }),
            ),
            Self::ObjectGone => facts(
                30,
                "the object pulled out",
                Fault::ObjectLost,
                5.0,
                HELD,
                Some(|plan| {
                    plan.grasp.gone_ms = u16::MAX;
                }),
            ),
            Self::FootOverload => facts(
                31,
                "225 N on a fingertip",
                Fault::FootOverload,
                1.0,
                STANDING,
                Some(|plan| {
                    plan.grasp.overload_n = 1e6;
                }),
            ),
        }
    }

    /// Whether the motor finds it by itself, within a few periods of its pulses.
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

    /// When it can be seen at the earliest, in microseconds: done at `at_us`, the next tick of sensing begins at
    /// `tick_us`.
    pub fn shows_us(self, at_us: u64, tick_us: u64) -> u64 {
        match self {
            Self::FootOverload => {
                let (peak_n, lasts_s) = GROUND;
                // Beyond what the sensors' own error may hide.
                let share = 1.02 * 4.0 * f64::from(Grasp::GRIPPER.overload_n) / peak_n;
                let crosses_us = at_us + (1e6 * lasts_s * share.asin() / PI) as u64;
                // The first sample after it.
                tick_us + TICK_US * crosses_us.saturating_sub(tick_us).div_ceil(TICK_US)
            }
            Self::SensorGone
            | Self::SensorFrozen
            | Self::HalfGain
            | Self::LineLow
            | Self::BrownOut
            | Self::Saturated
            | Self::Magnet
            | Self::Corrupted
            | Self::OverForce
            | Self::ObjectGone => tick_us,
            _ => at_us,
        }
    }

    /// Whether it is a fault of one sensor of force, after which a grip of 100 N is to stay below 110 N.
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

    /// What should be done about it.
    pub fn reaction(self, situation: Situation, locks: bool) -> Reaction {
        reaction(self.facts().fault, situation.phase(), locks)
    }
}

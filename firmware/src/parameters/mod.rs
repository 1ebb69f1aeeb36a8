//! Parameters that a host may change at run time. They are read and written one at a time ([`handle_request`]) and stored
//! in flash together ([`crate::system::nv_storage`]).
//!
//! On the bus a value is an `i32`. Values out of range are rejected, not clamped. Parameters that affect motion are writable
//! only while disarmed.

pub mod schema;

use crate::config::constants::TICK_US;
use crate::config::limits::{DetectionLimits, GripLimits};
use crate::estimator::tare::{MAX_OFFSET, Tare};
use crate::fixed_point::Force;
use crate::math::lesser;
use crate::motor;
use crate::motor::calibration::CalibrationOutcome;
use crate::motor::settings::{MotorLimits, MotorWiring, Settings};
use crate::parameters::schema::{COUNT, PARAMETERS, Parameter, RULES, detector, id, index_of};
use crate::protocol::messages::{ParamReply, ParamRequest};
use crate::sensors::hall::{GripperHallSensor, HallSensor, SENSORS};

/// See [`schema::MICRO`].
const MICRO: f32 = schema::MICRO as f32;
/// From 2^-32 turns to the parameter's 2^-16: five thousandths of a degree.
const OFFSET_SHIFT: u32 = 16;
/// See [`schema::NANO`]; also nanohenries in a henry.
const NANO: f32 = schema::NANO as f32;

/// Operations of a request.
pub mod op {
    /// Read the value.
    pub const READ: u8 = 0;
    /// Write a value.
    pub const WRITE: u8 = 1;
}

/// Status of a reply.
pub mod status {
    /// Done.
    pub const DONE: u8 = 0;
    /// Unknown identifier.
    pub const UNKNOWN: u8 = 1;
    /// The value is out of range; nothing has changed.
    pub const OUT_OF_RANGE: u8 = 2;
    /// The parameter affects motion and a host is armed; nothing has changed.
    pub const ARMED: u8 = 3;
    /// Unknown operation.
    pub const NO_SUCH_OP: u8 = 4;
    /// The counter is read-only.
    pub const READ_ONLY: u8 = 5;
    /// Not from the owner of a session.
    pub const UNAUTHENTICATED: u8 = 6;
}

/// Whether the load can turn the screw back without current.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backdrivability {
    /// Not tested: treated as safe for both cases.
    Unknown,
    /// The screw holds the load.
    SelfLocking,
    /// The load turns the screw back.
    BackDriven,
}

/// The values of all parameters, each in its range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parameters {
    /// In the order of [`PARAMETERS`].
    values: [i32; COUNT],
}

impl Parameters {
    /// Default values.
    pub const DEFAULT: Self = {
        let mut values = [0; COUNT];
        let (mut to, mut from): (&mut [i32], &[Parameter]) = (&mut values, &PARAMETERS);
        while let (Some((value, values)), Some((parameter, others))) =
            (to.split_first_mut(), from.split_first())
        {
            *value = parameter.default;
            (to, from) = (values, others);
        }
        Self { values }
    };

    /// All identifiers with their values.
    pub fn all(&self) -> impl Iterator<Item = (u16, i32)> {
        RULES.iter().map(|rule| rule.id).zip(self.values)
    }

    /// The value of the parameter with this identifier.
    #[inline(never)] // As of [`Self::set`].
    pub fn get(&self, id: u16) -> Option<i32> {
        self.all().find_map(|(each, value)| (each == id).then_some(value))
    }

    /// The value of a parameter of the schema.
    fn value<const ID: u16>(&self) -> i32 {
        let value = self.values.get(const { index_of(ID) });
        value.copied().unwrap_or_default()
    }

    /// Sets a value.
    ///
    /// # Errors
    /// [`status::UNKNOWN`] or [`status::OUT_OF_RANGE`].
    #[inline(never)] // Short where it is called.
    pub fn set(&mut self, id: u16, value: i32) -> Result<(), u8> {
        let mut rows = RULES.iter().zip(&mut self.values);
        let (rule, current) = rows.find(|(rule, _)| rule.id == id).ok_or(status::UNKNOWN)?;
        if !rule.range.contains(value) {
            return Err(status::OUT_OF_RANGE);
        }
        *current = value;
        Ok(())
    }

    /// Node number on the CAN bus.
    pub fn node(&self) -> u16 {
        self.value::<{ id::NODE }>() as u16
    }

    /// Time without a command after which the gripper holds.
    pub fn command_timeout_ms(&self) -> u32 {
        self.value::<{ id::COMMAND_TIMEOUT }>() as u32
    }

    /// Rate of the force messages in Hz; 0: off.
    pub fn force_rate_hz(&self) -> u32 {
        self.value::<{ id::FORCE_RATE }>() as u32
    }

    /// Ticks between force messages; none where they are off.
    pub fn force_period(&self) -> Option<u32> {
        const TICKS_PER_SECOND: u32 = (1_000_000 / TICK_US) as u32;
        TICKS_PER_SECOND.checked_div(self.force_rate_hz())
    }

    /// Whether raw readings are sent on the CAN bus.
    pub fn raw(&self) -> bool {
        self.value::<{ id::RAW }>() == 1
    }

    /// Whether ground contact messages are sent.
    pub fn ground_contact(&self) -> bool {
        self.value::<{ id::FOOT }>() == 1
    }

    /// Whether every tick is sent on the serial line.
    pub fn telemetry(&self) -> bool {
        self.value::<{ id::TELEMETRY }>() == 1
    }

    /// Settings of the motor control, with the limits of the bench where they apply.
    pub fn settings(&self) -> Settings {
        let mut settings = Settings::assumed(match self.value::<{ id::LEAD }>() {
            1 => motor::screw::Screw::B,
            _ => motor::screw::Screw::A,
        });
        let machine = &mut settings.machine;
        machine.pole_pairs = self.value::<{ id::POLE_PAIRS }>() as u8;
        machine.resistance_ohm = self.value::<{ id::RESISTANCE }>() as f32 / MICRO;
        machine.inductance_h = self.value::<{ id::INDUCTANCE }>() as f32 / NANO;
        machine.torque_nm_a = self.torque_nm_a();
        machine.inertia_kg_m2 = self.value::<{ id::INERTIA }>() as f32 / NANO;
        machine.dry_nm = self.value::<{ id::DRY_FRICTION }>() as f32 / MICRO;
        let limits =
            if self.is_on_bench() { MotorLimits::bench(&settings.screw) } else { settings.limits };
        settings.limits = limits.for_torque_constant(self.torque_nm_a());
        if !self.detects(detector::STUCK) {
            settings.limits.stuck_periods = None;
        }
        settings.wiring = MotorWiring {
            offset: (self.value::<{ id::ROTOR_OFFSET }>() as u32) << OFFSET_SHIFT,
            is_swapped: self.value::<{ id::SWAPPED }>() == 1,
        };
        settings
    }

    /// Whether a detector of [`detector`] is on.
    pub fn detects(&self, detector: i32) -> bool {
        self.value::<{ id::DETECTORS }>() & detector != 0
    }

    /// Thresholds of sensing.
    pub fn detection_limits(&self) -> DetectionLimits {
        let mut limits = DetectionLimits::GRIPPER;
        if !self.detects(detector::FROZEN) {
            limits.frozen_axes = None;
        }
        if !self.detects(detector::CONFIGURATION) {
            limits.config_mismatches = None;
        }
        limits
    }

    /// Thresholds of the grip: currents have the torque that they have with the assumed motor, as far as the motor's limit allows.
    pub fn grip_limits(&self) -> GripLimits {
        let motor = self.settings();
        let mut limits = GripLimits::GRIPPER;
        limits.torque_nm_a = motor.machine.torque_nm_a;
        let share = GripLimits::GRIPPER.torque_nm_a / limits.torque_nm_a;
        // A motor that cannot exceed the current of a stall would not be found stalled.
        let share = lesser(share, motor.limits.peak_a / limits.home_a);
        for current_a in [
            &mut limits.home_a,
            &mut limits.uncalibrated_a,
            &mut limits.blind_a,
            &mut limits.blind_rise_a,
            &mut limits.stall_a,
            &mut limits.ground_hold_a,
        ] {
            *current_a *= share;
        }
        if self.is_on_bench() {
            limits.max_n = GripLimits::BENCH_N;
        }
        limits
    }

    /// Applies the result of a calibration; values out of range are ignored.
    pub fn set_measured(&mut self, outcome: &CalibrationOutcome) {
        match *outcome {
            CalibrationOutcome::Motor(found) => {
                for (id, value) in [
                    (id::POLE_PAIRS, i32::from(found.pole_pairs)),
                    (id::RESISTANCE, (found.resistance_ohm * MICRO) as i32),
                    (id::INDUCTANCE, (found.inductance_h * NANO) as i32),
                    (id::ROTOR_OFFSET, (found.wiring.offset >> OFFSET_SHIFT) as i32),
                    (id::SWAPPED, i32::from(found.wiring.is_swapped)),
                    (id::TORQUE_CONSTANT, (found.torque_nm_a * MICRO) as i32),
                    (id::INERTIA, (found.inertia_kg_m2 * NANO) as i32),
                    (id::DRY_FRICTION, (found.dry_nm * MICRO) as i32),
                    (id::COMMISSIONED, 1),
                ] {
                    // Plausible values are in range.
                    let _ = self.set(id, value);
                }
            }
            CalibrationOutcome::Screw { locks } => {
                let _ = self.set(id::SELF_LOCKING, if locks { 1 } else { 2 });
            }
            CalibrationOutcome::Failed(_) => {}
        }
    }

    /// Whether the motor's parameters were measured by a calibration; else they are assumed.
    pub fn is_commissioned(&self) -> bool {
        self.value::<{ id::COMMISSIONED }>() == 1
    }

    /// Whether the limits of the bench apply: until a host has removed them.
    pub fn is_on_bench(&self) -> bool {
        self.value::<{ id::BENCH }>() == 1
    }

    /// Torque constant in N m per ampere along q.
    pub fn torque_nm_a(&self) -> f32 {
        self.value::<{ id::TORQUE_CONSTANT }>() as f32 / MICRO
    }

    /// Whether the load can turn the screw back without current.
    pub fn backdrivability(&self) -> Backdrivability {
        match self.value::<{ id::SELF_LOCKING }>() {
            1 => Backdrivability::SelfLocking,
            2 => Backdrivability::BackDriven,
            _ => Backdrivability::Unknown,
        }
    }

    /// 7-bit addresses of the sensors.
    pub fn addresses(&self) -> [u8; SENSORS] {
        let mut id = id::ADDRESS..;
        GripperHallSensor::ADDRESSES.map(|default| {
            let stated = id.next().and_then(|id| self.get(id));
            stated.map_or(default, |address| address as u8)
        })
    }

    /// Offsets that are subtracted from the forces.
    pub fn tare(&self) -> Tare {
        let tare = self.values.get(const { index_of(id::TARE) }..);
        let mut values = tare.unwrap_or_default().iter().copied();
        Tare(
            [[(); 2]; SENSORS]
                .map(|forces| forces.map(|()| Force(values.next().unwrap_or_default()))),
        )
    }

    /// Sets the tare, clamped to its range.
    pub fn set_tare(&mut self, tare: &Tare) {
        for (id, force) in (id::TARE..).zip(tare.0.as_flattened()) {
            // Cannot fail: the identifiers exist and the values are in range.
            let _ = self.set(id, force.0.clamp(-MAX_OFFSET.0, MAX_OFFSET.0));
        }
    }
}

/// Executes a request that is allowed by [`crate::protocol::rules`], and returns the reply. A write takes effect at once, and is
/// lost at the next boot unless the host saves.
pub fn handle_request(parameters: &mut Parameters, request: &ParamRequest) -> ParamReply {
    let rule = RULES.iter().find(|rule| rule.id == request.id);
    let status = match (rule, request.op) {
        (None, _) => status::UNKNOWN,
        (_, op::READ) => status::DONE,
        (_, op::WRITE) => match parameters.set(request.id, request.value as i32) {
            Ok(()) => status::DONE,
            Err(status) => status,
        },
        _ => status::NO_SUCH_OP,
    };
    ParamReply {
        op: request.op,
        id: request.id,
        status,
        value: parameters.get(request.id).unwrap_or_default() as u32,
    }
}

/// The reply to a request for a counter ([`crate::parameters::schema::counter`]).
pub const fn handle_counter_request(count: u32, request: &ParamRequest) -> ParamReply {
    let status = match request.op {
        op::READ => status::DONE,
        op::WRITE => status::READ_ONLY,
        _ => status::NO_SUCH_OP,
    };
    ParamReply { op: request.op, id: request.id, status, value: count }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::diagnostics::SensorMonitor;
    use crate::motor::power_stage::MotorSamples;
    use crate::parameters::schema::ValueRange;
    use crate::protocol::ESTOP_ALL_ID;
    use crate::protocol::frame_id;
    use crate::sensors::hall::config_readback::{ConfigReadback, ReadbackResult};
    use crate::sensors::hall::liveness::LivenessMonitor;
    use crate::sensors::hall::{HallReading, HallSample};
    use std::vec::Vec;

    fn request(parameters: &mut Parameters, op: u8, id: u16, value: i32) -> (u8, i32) {
        let message = ParamRequest { op, id, status: 0, value: value as u32 };
        let reply = handle_request(parameters, &message);
        assert_eq!((reply.op, reply.id), (op, id));
        (reply.status, reply.value as i32)
    }

    /// However long a reading, an angle stays the same, or a configuration word differs.
    #[test]
    fn detectors_that_are_switched_off_never_react() {
        for (detectors, reacts) in [(detector::ALL, true), (0, false)] {
            let mut parameters = Parameters::DEFAULT;
            assert_eq!(parameters.set(id::DETECTORS, detectors), Ok(()));
            let limits = parameters.detection_limits();
            let mut monitor = LivenessMonitor::new(&limits);
            let reading = Some(HallSample::New(HallReading::default()));
            let is_frozen = (0..300).any(|_| monitor.update(reading).reading.is_none());
            let mut readback = ConfigReadback::new(&limits);
            let mut word = 0_u8;
            let is_changed = (0..2000).any(|read| {
                word = u8::from(read > 100);
                readback.update(Some([word; 2])) == ReadbackResult::Changed
            });
            let is_lost = readback.without_changed([reading; SENSORS]).contains(&None);
            assert_eq!(readback.summary() & 0xFFFF, 0xF);
            assert!(readback.summary() >> 16 > 0);
            let motor = parameters.settings().limits;
            let mut sensors = SensorMonitor::default();
            let samples = MotorSamples { phases: [2048; 3], bus: 1600, angle: Ok(7) };
            let is_stuck = (0..70_000).any(|_| sensors.update(&samples, [0.0; 3], &motor).is_err());
            assert_eq!([is_frozen, is_changed, is_stuck], [reacts; 3]);
            assert!(reacts || !is_lost);
        }
    }

    #[test]
    fn identifiers_and_names_are_unique_and_defaults_valid() {
        for (index, parameter) in PARAMETERS.iter().enumerate() {
            assert!(parameter.range.contains(parameter.default), "{}", parameter.name);
            for other in &PARAMETERS[..index] {
                assert_ne!(parameter.id, other.id, "{}", parameter.name);
                assert_ne!(parameter.name, other.name);
            }
        }
    }

    #[test]
    fn default_parameters_have_reference_values() {
        let all = Parameters::DEFAULT;
        assert_eq!((all.node(), all.command_timeout_ms()), (0x10, 100));
        assert_eq!(all.force_rate_hz(), 100);
        assert_eq!([all.raw(), all.ground_contact(), all.telemetry()], [false, false, true]);
        assert_eq!(all.addresses(), GripperHallSensor::ADDRESSES);
        assert_eq!((all.tare(), all.backdrivability()), (Tare::NONE, Backdrivability::Unknown));
    }

    #[test]
    fn write_changes_exactly_one_parameter() {
        for parameter in &PARAMETERS {
            let values: Vec<i32> = match parameter.range {
                ValueRange::Between(min, max) => [min, max].into(),
                ValueRange::OneOf(choices) => choices.into(),
            };
            for value in values {
                let mut changed = Parameters::DEFAULT;
                let written = request(&mut changed, op::WRITE, parameter.id, value);
                assert_eq!(written, (status::DONE, value), "{}", parameter.name);
                let read = request(&mut changed, op::READ, parameter.id, 0);
                assert_eq!(read, (status::DONE, value));
                for ((id, now), (_, before)) in changed.all().zip(Parameters::DEFAULT.all()) {
                    assert_eq!(now, if id == parameter.id { value } else { before });
                }
            }
        }
    }

    #[test]
    fn value_out_of_range_is_rejected() {
        for parameter in &PARAMETERS {
            let beyond: Vec<i32> = match parameter.range {
                ValueRange::Between(min, max) => [min - 1, max + 1, i32::MIN, i32::MAX].into(),
                ValueRange::OneOf(choices) => choices.iter().map(|choice| choice + 1).collect(),
            };
            for value in beyond {
                let mut same = Parameters::DEFAULT;
                let reply = request(&mut same, op::WRITE, parameter.id, value);
                assert_eq!(reply, (status::OUT_OF_RANGE, parameter.default));
                assert_eq!(same, Parameters::DEFAULT);
            }
        }
    }

    #[test]
    fn unknown_identifier_or_operation_is_reported() {
        let mut same = Parameters::DEFAULT;
        let unknown = (status::UNKNOWN, 0);
        assert_eq!(request(&mut same, op::READ, 0, 0), unknown);
        assert_eq!(request(&mut same, op::WRITE, 0x38, 1), unknown);
        let no_op = (status::NO_SUCH_OP, 16);
        assert_eq!(request(&mut same, 2, id::NODE, 17), no_op);
        assert_eq!(same, Parameters::DEFAULT);
    }

    #[test]
    fn no_node_owns_the_identifier_of_the_estop() {
        let row = PARAMETERS.iter().find(|row| row.id == id::NODE).unwrap();
        let nodes = (0..=i32::from(u16::MAX)).filter(|node| row.range.contains(*node));
        for node in nodes {
            assert_ne!(frame_id(node as u16, 0) >> 5, ESTOP_ALL_ID >> 5);
        }
    }

    #[test]
    fn tare_is_clamped_to_the_range_of_its_parameters() {
        let mut all = Parameters::DEFAULT;
        let mut tare = Tare::NONE;
        tare.0[2] = [Force(-5), Force(i32::MAX)];
        all.set_tare(&tare);
        assert_eq!(all.get(id::TARE + 4), Some(-5));
        assert_eq!(all.get(id::TARE + 5), Some(250 << 10));
        assert_eq!(all.tare().0[2], [Force(-5), Force(250 << 10)]);
    }

    #[test]
    fn default_motor_settings_are_the_assumed_ones() {
        use crate::motor::{Settings, screw::Screw as Lead};
        let settings = Parameters::DEFAULT.settings();
        let assumed = Settings::assumed(Lead::A);
        let near = |a: f32, b: f32| (a / b - 1.0).abs() < 1e-6;
        assert!(near(settings.machine.resistance_ohm, assumed.machine.resistance_ohm));
        assert!(near(settings.machine.inductance_h, assumed.machine.inductance_h));
        let mut coarse = Parameters::DEFAULT;
        coarse.set(id::LEAD, 1).unwrap();
        assert_eq!(coarse.settings().screw, Lead::B);
        assert_eq!(settings.screw, Lead::A);
    }

    #[test]
    fn limits_of_the_bench_apply_until_a_host_removes_them() {
        for bench in [None, Some(1), Some(0)] {
            let mut parameters = Parameters::DEFAULT;
            if let Some(bench) = bench {
                parameters.set(id::BENCH, bench).unwrap();
            }
            let limits = parameters.settings().limits;
            let max_n = parameters.grip_limits().max_n;
            let [no_current_v, _] = limits.undervoltage_v;
            let is_bench = [limits.peak_a <= 2.0, no_current_v < 12.0, max_n <= 20.0];
            assert_eq!(is_bench, [bench != Some(0); 3], "{bench:?}");
        }
    }

    #[test]
    fn currents_of_the_grip_have_the_torque_of_the_assumed_motor() {
        for share in [0.4, 1.0, 2.5] {
            let mut parameters = Parameters::DEFAULT;
            parameters.set(id::TORQUE_CONSTANT, (share * 100_000.0) as i32).unwrap();
            parameters.set(id::BENCH, 0).unwrap();
            let limits = parameters.grip_limits();
            assert!((limits.home_a * share - GripLimits::GRIPPER.home_a).abs() < 1e-4);
            assert!((limits.stall_a * share - GripLimits::GRIPPER.stall_a).abs() < 1e-4);
            // On the bench a stall is still found.
            parameters.set(id::BENCH, 1).unwrap();
            let limits = parameters.grip_limits();
            assert!(limits.stall_a < 0.9 * parameters.settings().limits.peak_a);
        }
    }

    #[test]
    fn calibration_results_are_stored_and_restored() {
        use crate::motor::calibration::CalibrationOutcome;
        use crate::motor::settings::IdentifiedMotor;
        use crate::motor::settings::MotorWiring;
        let mut parameters = Parameters::DEFAULT;
        parameters.set(id::BENCH, 0).unwrap();
        let wiring = MotorWiring { offset: 0xF001_0000, is_swapped: true };
        parameters.set_measured(&CalibrationOutcome::Motor(IdentifiedMotor {
            resistance_ohm: 0.375,
            inductance_h: 0.000_5,
            pole_pairs: 11,
            wiring,
            torque_nm_a: 0.25,
            inertia_kg_m2: 1e-4,
            dry_nm: 0.03,
        }));
        assert!(parameters.is_commissioned() && !Parameters::DEFAULT.is_commissioned());
        let settings = parameters.settings();
        assert_eq!((settings.wiring, settings.machine.pole_pairs), (wiring, 11));
        assert_eq!(settings.machine.resistance_ohm, 0.375);
        assert!((settings.machine.inductance_h - 0.000_5).abs() < 1e-9);
        assert!((settings.machine.torque_nm_a - 0.25).abs() < 1e-6);
        assert!((settings.machine.inertia_kg_m2 - 1e-4).abs() < 1e-9);
        assert!((settings.machine.dry_nm - 0.03).abs() < 1e-6);
        // No more torque than the assumed motor.
        assert!((settings.limits.peak_a - 3.84).abs() < 1e-3);
        for (locks, screw) in
            [(true, Backdrivability::SelfLocking), (false, Backdrivability::BackDriven)]
        {
            parameters.set_measured(&CalibrationOutcome::Screw { locks });
            assert_eq!(parameters.backdrivability(), screw);
        }
    }
}

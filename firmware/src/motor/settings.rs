//! Parameters of motor, screw and board, and the limits of motor control. Controller gains are derived from them.

use crate::config::constants;
use crate::math::lesser;
use crate::motor::screw::Screw;

/// Peak motor current in amperes.
pub const PEAK_A: f32 = (constants::PEAK_TORQUE.value / constants::TORQUE_CONSTANT.value) as f32;

/// Parameters of the motor and of what turns with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorParameters {
    /// Pole pairs.
    pub pole_pairs: u8,
    /// Phase resistance in ohms.
    pub resistance_ohm: f32,
    /// Phase inductance in henries, equal on both axes.
    pub inductance_h: f32,
    /// Torque constant in N m per ampere along q.
    pub torque_nm_a: f32,
    /// Inertia of rotor, screws and coupling in kg m^2.
    pub inertia_kg_m2: f32,
    /// Dry friction without load in N m.
    pub dry_nm: f32,
    /// Viscous friction in N m per rad/s.
    pub viscous_nm_s: f32,
}

impl MotorParameters {
    /// The assumed motor; commissioning measures all but the viscous friction.
    pub const ASSUMED: Self = Self {
        pole_pairs: constants::POLE_PAIRS.value as u8,
        resistance_ohm: constants::PHASE_RESISTANCE.value as f32,
        inductance_h: (constants::PHASE_INDUCTANCE.value * 1e-3) as f32,
        torque_nm_a: constants::TORQUE_CONSTANT.value as f32,
        inertia_kg_m2: constants::ROTOR_INERTIA.value as f32,
        dry_nm: constants::DRY_FRICTION.value as f32,
        viscous_nm_s: constants::VISCOUS_FRICTION.value as f32,
    };

    /// Largest plausible ratio of a measured value to the assumed one, in either direction.
    pub const PLAUSIBLE_FACTOR: f32 = 4.0;

    /// Whether a measured value is plausible.
    pub fn is_plausible(measured: f32, assumed: f32) -> bool {
        let share = measured / assumed;
        (1.0 / Self::PLAUSIBLE_FACTOR..=Self::PLAUSIBLE_FACTOR).contains(&share)
    }

    /// Flux linkage of a phase in webers, derived from the torque constant.
    pub fn flux_wb(&self) -> f32 {
        self.torque_nm_a / (1.5 * f32::from(self.pole_pairs))
    }
}

/// Mounting of the rotor sensor and order of the phases; measured by commissioning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotorWiring {
    /// Negative electrical angle at zero of the sensor, in 2^-32 turns.
    pub offset: u32,
    /// Phases V and W are swapped: a field that turns forward opens the gripper.
    pub is_swapped: bool,
}

/// Result of commissioning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IdentifiedMotor {
    /// Phase resistance in ohms.
    pub resistance_ohm: f32,
    /// Phase inductance in henries.
    pub inductance_h: f32,
    /// Pole pairs.
    pub pole_pairs: u8,
    /// Sensor and phases.
    pub wiring: MotorWiring,
    /// Torque constant in N m per ampere along q.
    pub torque_nm_a: f32,
    /// Inertia of rotor and what turns with it in kg m^2.
    pub inertia_kg_m2: f32,
    /// Dry friction without load in N m.
    pub dry_nm: f32,
}

impl IdentifiedMotor {
    /// The assumed motor.
    pub const ASSUMED: Self = {
        let assumed = MotorParameters::ASSUMED;
        Self {
            resistance_ohm: assumed.resistance_ohm,
            inductance_h: assumed.inductance_h,
            pole_pairs: assumed.pole_pairs,
            wiring: MotorWiring { offset: 0, is_swapped: false },
            torque_nm_a: assumed.torque_nm_a,
            inertia_kg_m2: assumed.inertia_kg_m2,
            dry_nm: assumed.dry_nm,
        }
    };
}

/// [`MotorLimits::stuck_periods`] of the gripper.
pub const STUCK_PERIODS: u16 = 36;

/// Limits of motor control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorLimits {
    /// Continuous current in amperes.
    pub rated_a: f32,
    /// Current allowed for [`Self::peak_s`].
    pub peak_a: f32,
    /// Seconds of peak current from cold.
    pub peak_s: f32,
    /// Phase current in amperes that trips.
    pub trip_a: f32,
    /// Power from the bus in watts.
    pub power_w: f32,
    /// Rotor speed in rad/s.
    pub speed: f32,
    /// Rotor speed in rad/s that trips.
    pub trip_speed: f32,
    /// Motor temperatures in degrees Celsius at which de-rating begins, and at which the current is zero.
    pub motor_c: [f32; 2],
    /// The same of the power stage.
    pub stage_c: [f32; 2],
    /// Bus voltages in volts below which the current is zero, and above which it is unlimited.
    pub undervoltage_v: [f32; 2],
    /// Bus voltages in volts at which the windings begin to dissipate braking energy, and at which they take all.
    pub dissipation_v: [f32; 2],
    /// Bus voltage in volts at which the windings are shorted.
    pub overvoltage_v: f32,
    /// Maximum sum of the phase currents in amperes.
    pub sum_a: f32,
    /// Periods above [`Self::sum_a`] that trip.
    pub sum_periods: u16,
    /// Consecutive missing or implausible angles that are bridged: half a millisecond.
    pub bridged_angles: u8,
    /// Consecutive equal angle counts that trip. With noise of 0.9 counts a working sensor repeats three times in
    /// ten, and 36 times in a row once in 10^19. `None`: none trips.
    pub stuck_periods: Option<u16>,
    /// Maximum voltage residual in volts.
    pub unexplained_v: f32,
    /// Addition to it, as a fraction of the induced voltage.
    pub unexplained: f32,
    /// Periods above it that trip.
    pub unexplained_periods: u16,
    /// Maximum control error of the currents in amperes.
    pub tracking_error_a: f32,
    /// Periods above it that trip.
    pub tracking_error_periods: u16,
    /// Speed in rad/s, and excess over the set-point, at which a current of [`Self::runaway_a`] must brake.
    pub runaway: f32,
    /// In amperes: more torque than any load.
    pub runaway_a: f32,
    /// Periods without deceleration that trip.
    pub runaway_periods: u16,
    /// Ends of the opening in millimetres: below zero by the deflection of the flexures, and the stroke.
    pub ends_mm: [f32; 2],
    /// Speed of the fingers in mm/s while the opening is unknown.
    pub homing_mm_s: f32,
}

impl MotorLimits {
    /// Limits of the gripper.
    pub const GRIPPER: Self = Self {
        rated_a: (constants::RATED_TORQUE.value / constants::TORQUE_CONSTANT.value) as f32,
        peak_a: PEAK_A,
        peak_s: constants::PEAK_TORQUE_TIME.value as f32,
        trip_a: constants::CURRENT_TRIP.value as f32,
        power_w: constants::SUPPLY_POWER_MAX.value as f32,
        speed: (1.1 * constants::RATED_SPEED.value) as f32,
        trip_speed: (1.5 * constants::RATED_SPEED.value) as f32,
        motor_c: [80.0, constants::MOTOR_TEMPERATURE_MAX.value as f32],
        stage_c: [90.0, constants::STAGE_TEMPERATURE_MAX.value as f32],
        undervoltage_v: [16.0, 19.0],
        dissipation_v: [26.5, 28.5],
        overvoltage_v: constants::BUS_VOLTAGE_MAX.value as f32,
        sum_a: 0.8,
        sum_periods: 10,
        bridged_angles: 10,
        stuck_periods: Some(STUCK_PERIODS),
        unexplained_v: 2.5,
        unexplained: 0.25,
        unexplained_periods: 20,
        tracking_error_a: 1.5,
        tracking_error_periods: 90,
        runaway: 20.0,
        runaway_a: 5.0,
        runaway_periods: 36,
        ends_mm: [-2.0, constants::STROKE.value as f32],
        homing_mm_s: 5.0,
    };

    /// Speed of the opening on the bench in mm/s.
    pub const BENCH_MM_S: f32 = 10.0;

    /// Limits of a first operation: a supply of 12 V and 1 A, [`Self::BENCH_MM_S`].
    pub fn bench(screw: &Screw) -> Self {
        Self {
            rated_a: 2.0,
            peak_a: 2.0,
            trip_a: 8.0,
            power_w: 12.0,
            speed: 1.1 * screw.rotor_speed(Self::BENCH_MM_S),
            // Above the speed of commissioning.
            trip_speed: (0.5 * constants::RATED_SPEED.value) as f32,
            undervoltage_v: [9.0, 10.5],
            runaway_a: 1.5,
            ..Self::GRIPPER
        }
    }

    /// Limits for a motor with this torque constant: neither the currents nor their torques exceed those of the assumed motor.
    #[must_use]
    pub fn for_torque_constant(self, torque_nm_a: f32) -> Self {
        let share = lesser(1.0, MotorParameters::ASSUMED.torque_nm_a / torque_nm_a);
        Self {
            rated_a: share * self.rated_a,
            peak_a: share * self.peak_a,
            runaway_a: share * self.runaway_a,
            ..self
        }
    }
}

/// All settings of motor control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Motor parameters.
    pub machine: MotorParameters,
    /// Sensor and phases.
    pub wiring: MotorWiring,
    /// Lead screw.
    pub screw: Screw,
    /// Limits.
    pub limits: MotorLimits,
    /// Age of the angle when the currents are sampled, in PWM periods.
    pub angle_age_periods: f32,
}

impl Settings {
    /// The assumed motor with a screw; the angle has no age.
    pub const fn assumed(screw: Screw) -> Self {
        Self {
            machine: MotorParameters::ASSUMED,
            wiring: MotorWiring { offset: 0, is_swapped: false },
            screw,
            limits: MotorLimits::GRIPPER,
            angle_age_periods: 0.0,
        }
    }

    /// Takes over the result of commissioning.
    pub fn apply_identification(&mut self, identified: &IdentifiedMotor) {
        self.machine.resistance_ohm = identified.resistance_ohm;
        self.machine.inductance_h = identified.inductance_h;
        self.machine.pole_pairs = identified.pole_pairs;
        self.machine.torque_nm_a = identified.torque_nm_a;
        self.machine.inertia_kg_m2 = identified.inertia_kg_m2;
        self.machine.dry_nm = identified.dry_nm;
        self.wiring = identified.wiring;
    }

    /// Whether all values are finite and have the required sign and order.
    pub fn is_sound(&self) -> bool {
        let (machine, screw, limits) = (&self.machine, &self.screw, &self.limits);
        let positive = [
            machine.resistance_ohm,
            machine.inductance_h,
            machine.torque_nm_a,
            machine.inertia_kg_m2,
            screw.ratio_mm,
            limits.rated_a,
            limits.peak_a,
            limits.peak_s,
            limits.trip_a,
            limits.power_w,
            limits.speed,
            limits.trip_speed,
            limits.overvoltage_v,
            limits.homing_mm_s,
            limits.sum_a,
            limits.unexplained_v,
            limits.unexplained,
            limits.tracking_error_a,
            limits.runaway,
            limits.runaway_a,
        ];
        let not_negative = [
            machine.dry_nm,
            machine.viscous_nm_s,
            screw.play_mm,
            screw.friction,
            self.angle_age_periods,
        ];
        let rising = [
            limits.motor_c,
            limits.stage_c,
            limits.undervoltage_v,
            limits.dissipation_v,
            limits.ends_mm,
        ];
        machine.pole_pairs > 0
            && positive.iter().all(|value| value.is_normal() && *value > 0.0)
            && not_negative.iter().all(|value| value.is_finite() && *value >= 0.0)
            && rising.iter().all(|[from, to]| from.is_finite() && to.is_finite() && from < to)
    }
}

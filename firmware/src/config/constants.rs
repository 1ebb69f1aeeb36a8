//! Design constants of the gripper with their sources.
//!
//! A constant has a unit, a source, and a [`Basis`]; *assumed* is a value that the paper
//! (Tanaka et al., "Mechanisms and Computational Design of Multi-Modal End-Effector with Force
//! Sensing using Gated Networks") does not state and that was not confirmed on a board.
//! The firmware binary prints them on a computer.

/// What a statement rests on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Basis {
    /// Neither stated nor measured for this gripper.
    Assumed,
    /// By the paper, a data sheet or a manual.
    Stated,
    /// On a board: its source is which board, and how.
    Measured,
}

impl Basis {
    /// Name for display.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Assumed => "assumed",
            Self::Stated => "stated",
            Self::Measured => "measured",
        }
    }
}

/// A design constant with its source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constant {
    /// Name for display.
    pub name: &'static str,
    /// The number, in [`Constant::unit`].
    pub value: f64,
    /// The unit, as in column names.
    pub unit: &'static str,
    /// Where the number comes from.
    pub source: &'static str,
    /// What it rests on.
    pub basis: Basis,
}

impl Constant {
    /// Whether it is neither stated nor measured for this gripper.
    pub const fn is_assumed(&self) -> bool {
        matches!(self.basis, Basis::Assumed)
    }
}

/// A constant with a stated value.
pub const fn stated(
    name: &'static str,
    value: f64,
    unit: &'static str,
    source: &'static str,
) -> Constant {
    Constant { name, value, unit, source, basis: Basis::Stated }
}

/// A constant with an assumed value.
pub const fn assumed(
    name: &'static str,
    value: f64,
    unit: &'static str,
    source: &'static str,
) -> Constant {
    Constant { name, value, unit, source, basis: Basis::Assumed }
}

/// Diameter of the axially magnetised cylinder.
pub const MAGNET_DIAMETER: Constant = stated("magnet diameter", 3.0, "mm", "paper V-B");
/// Length of the magnet along its axis.
pub const MAGNET_LENGTH: Constant =
    stated("magnet length", 2.0, "mm", "paper, caption of the sensitivity figure");
/// Remanence of the magnet's material.
pub const REMANENCE: Constant = stated("remanence", 1.2, "T", "paper IV-C (NdFeB, N32)");
/// Distance from the magnet's face to the Hall element, at rest.
pub const GAP: Constant = stated("gap, face to Hall element", 1.5, "mm", "paper V-B");
/// Lateral flexure: 250 N at the paper's 0.5 mm of travel.
pub const STIFFNESS_X: Constant = assumed("lateral stiffness", 500.0, "N/mm", "250 N over 0.5 mm");
/// Longitudinal flexure.
pub const STIFFNESS_Z: Constant =
    assumed("longitudinal stiffness", 800.0, "N/mm", "stiffer than lateral");
/// Effective length of the flexure beam.
pub const BEAM_LENGTH: Constant = stated("beam length", 30.0, "mm", "paper V-B");
/// Scale of the Hall sensor at a range of +-2000 G.
pub const SENSOR_SCALE: Constant =
    assumed("Hall sensor scale", 0.125, "G/LSB", "A31301, 8 LSB/G, inferred");
/// Range of each axis of the Hall sensor.
pub const SENSOR_RANGE: Constant = stated("Hall sensor range", 2000.0, "G", "paper V-B");
/// White noise of one reading of each axis of the Hall sensor, root mean square.
pub const SENSOR_NOISE: Constant = assumed("Hall sensor noise", 0.35, "G", "A31301 at full rate");
/// Width of the Hall sensor's field word, two's complement.
pub const SENSOR_BITS: Constant = stated("Hall sensor word", 15.0, "bit", "A31301");
/// Scale of the temperature word of the Hall sensor. Only ratios to a calibration matter: the host converts counts to
/// degrees and back by this one constant.
pub const TEMPERATURE_SCALE: Constant =
    assumed("Hall temperature scale", 8.0, "LSB/K", "A31301, not stated in public; zero at 25 C");
/// Hall sensors on the gripper.
pub const SENSORS: Constant = stated("Hall sensors", 4.0, "", "paper II-B");
/// Rate at which the board reads every Hall sensor.
pub const SENSE_RATE: Constant = stated("Hall rate", 1000.0, "Hz", "paper V-C");
/// Rate of the reference force/torque sensors on the bench.
pub const REFERENCE_RATE: Constant = stated("reference rate", 100.0, "Hz", "paper V-C");
/// Design range of the force on each axis of each sensor, either sign.
pub const FORCE_RANGE: Constant =
    assumed("force range, each axis", 250.0, "N", "design box of the ideal model");
/// Frames averaged for a tare: a quarter of a second, 1/16 of the noise of a frame.
pub const TARE_FRAMES: Constant = assumed("frames of a tare", 256.0, "", "a quarter of a second");
/// Standard deviation of the force above which a tare is rejected because the load moves.
pub const TARE_SIGMA_MAX: Constant =
    assumed("max. sigma of a tare", 1.0, "N", "twice the noise of 0.5 N assumed");

/// Pole pairs of the motor.
pub const POLE_PAIRS: Constant =
    assumed("motor pole pairs", 7.0, "", "the paper names no motor; common for its size");

/// Supply of the power stage.
pub const BUS_VOLTAGE: Constant = assumed("bus voltage", 24.0, "V", "the paper names none");
/// Capacitance between the supply and the power stage.
pub const BUS_CAPACITANCE: Constant = assumed("bus capacitance", 470.0, "uF", "common for 24 V");
/// Torque per ampere of quadrature current (phase peak).
pub const TORQUE_CONSTANT: Constant =
    assumed("torque constant", 0.100, "N m/A", "the paper names no motor; rated torque at 5.8 A");
/// Resistance of one phase.
pub const PHASE_RESISTANCE: Constant = assumed("phase resistance", 0.40, "ohm", "no motor named");
/// Inductance of one phase, the same on d and q.
pub const PHASE_INDUCTANCE: Constant = assumed("phase inductance", 0.40, "mH", "no motor named");
/// Inertia of rotor, screws and coupling.
pub const ROTOR_INERTIA: Constant = assumed("inertia", 6e-5, "kg m^2", "rotor, screws, coupling");
/// Torque of viscous friction.
pub const VISCOUS_FRICTION: Constant =
    assumed("viscous friction", 1e-4, "N m s/rad", "no motor named");
/// Torque of dry friction without load.
pub const DRY_FRICTION: Constant = assumed("dry friction", 0.02, "N m", "no motor named");
/// Continuous torque of the motor.
pub const RATED_TORQUE: Constant = stated("rated torque", 0.58, "N m", "paper V-D");
/// Short-term torque of the motor.
pub const PEAK_TORQUE: Constant = stated("peak torque", 0.96, "N m", "paper V-D");
/// Speed of the rotor at which the fingers close at [`CLOSING_SPEED`].
pub const RATED_SPEED: Constant = stated("rated speed", 114.0, "rad/s", "paper V-D");
/// Nominal speed of the opening.
pub const CLOSING_SPEED: Constant = stated("closing speed", 58.3, "mm/s", "paper V-D");
/// Force of a grasp at rated torque.
pub const GRASP_FORCE: Constant = stated("grasping force", 350.0, "N", "paper V-D");
/// Lead of each screw if [`CLOSING_SPEED`] is that of the opening.
pub const LEAD_A: Constant =
    assumed("lead of screw A", 1.607, "mm/rev", "58.3 mm/s at 114 rad/s, both fingers together");
/// Lead of each screw if [`CLOSING_SPEED`] is that of each finger.
pub const LEAD_B: Constant =
    assumed("lead of screw B", 3.213, "mm/rev", "58.3 mm/s at 114 rad/s, each finger");
/// Efficiency of screw A at rated torque; below 0.5 it is self-locking.
pub const EFFICIENCY_A: Constant =
    assumed("efficiency of screw A", 0.309, "", "350 N at rated torque");
/// Efficiency of screw B at rated torque.
pub const EFFICIENCY_B: Constant =
    assumed("efficiency of screw B", 0.617, "", "350 N at rated torque");
/// PWM frequency of the motor.
pub const PWM_RATE: Constant = assumed("PWM rate", 20.0, "kHz", "inaudible; 50 electrical turns");
/// Dead time of a half bridge.
pub const DEAD_TIME: Constant = assumed("dead time", 500.0, "ns", "common for MOSFETs of 24 V");
/// Scale of the phase current converter; mid-scale is zero current.
pub const CURRENT_SCALE: Constant =
    assumed("current scale", 12.5, "mA/LSB", "12 bits over +-25.6 A");
/// Scale of the bus voltage converter.
pub const BUS_SCALE: Constant = assumed("bus voltage scale", 15.0, "mV/LSB", "12 bits over 61 V");
/// Resolution of the rotor angle over one turn.
pub const ENCODER_BITS: Constant =
    assumed("rotor angle", 14.0, "bit", "the paper names no rotor sensor; absolute, magnetic");
/// Maximum duty cycle; the remainder is for the current measurement.
pub const MODULATION: Constant = assumed("modulation", 0.93, "", "3.5 us without a high side");
/// Time from the switching of a low side until its current amplifier is valid.
pub const AMPLIFIER_SETTLING: Constant = assumed("amplifier settling", 1.0, "us", "DRV8316");
/// Crossover of the current loop.
pub const CURRENT_BANDWIDTH: Constant =
    assumed("current loop", 1100.0, "Hz", "a period's delay leaves 70 degrees");
/// Crossover of the speed loop.
pub const SPEED_BANDWIDTH: Constant = assumed("speed loop", 150.0, "Hz", "control study");
/// Share of an increase of a speed set-point that acts at once.
pub const SPEED_SETPOINT_WEIGHT: Constant =
    assumed("speed set-point weight", 0.5, "", "overshoot below 10 %; tests/acceptance");
/// Crossover of the position loop.
pub const POSITION_BANDWIDTH: Constant =
    assumed("position loop", 25.0, "Hz", "a sixth of the speed loop");
/// Natural frequency of the angle tracking loop.
pub const ENCODER_BANDWIDTH: Constant =
    assumed("angle tracking", 600.0, "Hz", "four times the speed loop");
/// Acceleration of the opening in a trajectory.
pub const MOTION_ACCELERATION: Constant =
    assumed("trajectory acceleration", 2000.0, "mm/s^2", "half the rated torque on screw A");
/// Jerk of the opening in a trajectory.
pub const MOTION_JERK: Constant =
    assumed("trajectory jerk", 500.0, "m/s^3", "the acceleration turns within 8 ms");
/// Backlash of the screws, as seen in the opening.
pub const BACKLASH: Constant = assumed("backlash", 0.03, "mm", "20 to 50 um is common");
/// Permitted time at [`PEAK_TORQUE`] from cold.
pub const PEAK_TORQUE_TIME: Constant = assumed("time at peak torque", 3.0, "s", "55 W of copper");
/// Current of a phase at which the power stage is switched off.
pub const CURRENT_TRIP: Constant = assumed("current trip", 19.2, "A", "twice the peak");
/// Maximum power of the supply.
pub const SUPPLY_POWER_MAX: Constant = assumed("supply power", 150.0, "W", "6.25 A at 24 V");
/// Bus voltage above which the windings are shorted.
pub const BUS_VOLTAGE_MAX: Constant = assumed("max. bus voltage", 32.0, "V", "parts of 40 V");
/// Motor temperature at which the current is de-rated to zero.
pub const MOTOR_TEMPERATURE_MAX: Constant =
    assumed("max. motor temperature", 100.0, "C", "insulation of class B");
/// Power stage temperature at which the current is de-rated to zero.
pub const STAGE_TEMPERATURE_MAX: Constant =
    assumed("max. stage temperature", 110.0, "C", "MOSFETs of 150 C");
/// Resistance of the thermistors of motor and power stage at 25 degrees Celsius.
pub const THERMISTOR_RESISTANCE: Constant =
    assumed("thermistor", 10.0, "kOhm", "common; the paper names none");
/// Their constant B.
pub const THERMISTOR_B: Constant = assumed("thermistor B", 3435.0, "K", "common for 10 kOhm");
/// Resistance from each of them to the converter's reference.
pub const THERMISTOR_PULL_UP: Constant = assumed("thermistor pull-up", 10.0, "kOhm", "board");
/// Maximum opening between the fingers.
pub const STROKE: Constant = assumed("stroke", 80.0, "mm", "the paper states none");
/// Breakaway torque without load; falls to [`DRY_FRICTION`] in motion.
pub const BREAKAWAY_FRICTION: Constant =
    assumed("breakaway friction", 0.025, "N m", "no motor named");
/// Speed at half of the fall from [`BREAKAWAY_FRICTION`] to [`DRY_FRICTION`] (Stribeck).
pub const STRIBECK_SPEED: Constant = assumed("Stribeck speed", 2.0, "rad/s", "no motor named");
/// Amplitude of the cogging torque.
pub const COGGING: Constant = assumed("cogging torque", 0.003, "N m", "half a percent of rated");
/// Cogging periods per turn.
pub const COGGING_PERIODS: Constant =
    assumed("cogging periods", 84.0, "1/rev", "12 slots, 14 poles");
/// Stiffness of screws and nuts, as seen in the opening.
pub const SCREW_STIFFNESS: Constant =
    assumed("screw stiffness", 20.0, "kN/mm", "steel in bronze, both screws");
/// Mass of one finger with its carriage.
pub const FINGER_MASS: Constant = assumed("finger mass", 0.2, "kg", "the paper states none");
/// Friction of one finger's guide.
pub const GUIDE_FRICTION: Constant = assumed("guide friction", 1.0, "N", "the paper states none");
/// Resistance of supply and cable; nothing flows back into the supply.
pub const SUPPLY_RESISTANCE: Constant =
    assumed("supply resistance", 0.1, "ohm", "cable and connectors");
/// Forward voltage of the body diodes.
pub const DIODE_DROP: Constant = assumed("diode drop", 0.8, "V", "common for MOSFETs of 24 V");
/// Noise of a phase current, root mean square.
pub const CURRENT_NOISE: Constant =
    assumed("current noise", 20.0, "mA", "1.6 counts, shunt amplifier");
/// Maximum offset of a phase current.
pub const CURRENT_OFFSET: Constant =
    assumed("current offset", 0.25, "A", "20 counts, shunt amplifier");
/// Noise of the rotor angle, root mean square.
pub const ENCODER_NOISE: Constant =
    assumed("rotor angle noise", 0.02, "deg", "one count of 14 bits");
/// Error of the rotor angle, once per turn.
pub const ENCODER_ECCENTRICITY: Constant =
    assumed("rotor angle error", 0.2, "deg", "magnet off centre by 0.1 mm");
/// Stiffness of the hardest contact: two flexures of 667 N/mm in series.
pub const CONTACT_STIFFNESS: Constant = assumed("hardest contact", 333.0, "N/mm", "control study");
/// Time from a contact to the reaction of the speed.
pub const CONTACT_REACTION_TIME: Constant =
    assumed("contact reaction time", 2.5, "ms", "control study");
/// Crossover of the force loop.
pub const FORCE_BANDWIDTH: Constant =
    assumed("force loop", 32.0, "Hz", "control study: 24 to 48 Hz");
/// Friction between fingertip and object.
pub const OBJECT_FRICTION: Constant =
    assumed("fingertip friction", 0.5, "", "rubber on most materials; not measured");
/// Distance of the two sensors along a finger.
pub const SENSOR_DISTANCE: Constant =
    assumed("sensors along a finger", 60.0, "mm", "the paper states none");
/// Mass of the fingertip on the flexures of each sensor.
pub const FINGERTIP_MASS: Constant = assumed("fingertip mass", 0.05, "kg", "the paper states none");
/// Opening for ground contact along a line.
pub const LINE_CONTACT_OPENING: Constant =
    assumed("line contact opening", 40.0, "mm", "half the stroke");

/// All constants, in the order of the data path.
pub const ALL: &[Constant] = &[
    MAGNET_DIAMETER,
    MAGNET_LENGTH,
    REMANENCE,
    GAP,
    STIFFNESS_X,
    STIFFNESS_Z,
    BEAM_LENGTH,
    FORCE_RANGE,
    SENSORS,
    SENSOR_SCALE,
    SENSOR_RANGE,
    SENSOR_NOISE,
    SENSOR_BITS,
    TEMPERATURE_SCALE,
    SENSE_RATE,
    REFERENCE_RATE,
    TARE_FRAMES,
    TARE_SIGMA_MAX,
    POLE_PAIRS,
    BUS_VOLTAGE,
    BUS_CAPACITANCE,
    TORQUE_CONSTANT,
    PHASE_RESISTANCE,
    PHASE_INDUCTANCE,
    ROTOR_INERTIA,
    VISCOUS_FRICTION,
    DRY_FRICTION,
    RATED_TORQUE,
    PEAK_TORQUE,
    RATED_SPEED,
    CLOSING_SPEED,
    GRASP_FORCE,
    LEAD_A,
    LEAD_B,
    EFFICIENCY_A,
    EFFICIENCY_B,
    PWM_RATE,
    DEAD_TIME,
    CURRENT_SCALE,
    BUS_SCALE,
    ENCODER_BITS,
    MODULATION,
    AMPLIFIER_SETTLING,
    CURRENT_BANDWIDTH,
    SPEED_BANDWIDTH,
    SPEED_SETPOINT_WEIGHT,
    POSITION_BANDWIDTH,
    ENCODER_BANDWIDTH,
    MOTION_ACCELERATION,
    MOTION_JERK,
    BACKLASH,
    PEAK_TORQUE_TIME,
    CURRENT_TRIP,
    SUPPLY_POWER_MAX,
    BUS_VOLTAGE_MAX,
    MOTOR_TEMPERATURE_MAX,
    STAGE_TEMPERATURE_MAX,
    THERMISTOR_RESISTANCE,
    THERMISTOR_B,
    THERMISTOR_PULL_UP,
    STROKE,
    BREAKAWAY_FRICTION,
    STRIBECK_SPEED,
    COGGING,
    COGGING_PERIODS,
    SCREW_STIFFNESS,
    FINGER_MASS,
    GUIDE_FRICTION,
    SUPPLY_RESISTANCE,
    DIODE_DROP,
    CURRENT_NOISE,
    CURRENT_OFFSET,
    ENCODER_NOISE,
    ENCODER_ECCENTRICITY,
    CONTACT_STIFFNESS,
    CONTACT_REACTION_TIME,
    FORCE_BANDWIDTH,
    OBJECT_FRICTION,
    SENSOR_DISTANCE,
    FINGERTIP_MASS,
    LINE_CONTACT_OPENING,
];

/// Time from one tick of sensing to the next.
pub const TICK_US: u64 = (1e6 / SENSE_RATE.value) as u64;
/// Longest time of a sensor transfer; it takes 102 us at 1 MHz.
pub const TRANSFER_LIMIT_US: u64 = 200;
/// Time from the beginning of a tick at which a transfer that hangs is aborted; both of a bus have ended by then.
pub const READ_LIMIT_US: u64 = 2 * TRANSFER_LIMIT_US;
/// Deadline of the transfers from the beginning of a tick, retries included: the rest is for a bus recovery (105 us) and
/// the estimate.
pub const SENSE_LIMIT_US: u64 = 750;

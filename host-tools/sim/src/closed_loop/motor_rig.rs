//! The firmware's motor control on the plant, and runs of it: to a position, at a speed, against an object.
use crate::drivetrain::mechanics::Object;
use crate::drivetrain::parameters::{Lead, PlantParameters};
use crate::drivetrain::{PERIOD_S, Plant};
use firmware::config::constants;
use firmware::motor::power_stage::{BridgeCommand, MotorSamples, PowerStage};
use firmware::motor::settings::{MotorLimits, MotorWiring};
use firmware::motor::{Motor, MotorCommand, MotorState, MotorStatus, Setpoint, Settings};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Timeout of arming in seconds.
const ARMING_S: f64 = 0.1;

/// The firmware's motor control on a plant.
#[derive(Clone)]
pub struct MotorRig {
    /// Drivetrain.
    pub plant: Plant,
    /// The firmware's motor control.
    pub motor: Motor,
    drive: BridgeCommand,
    settings: Settings,
}

/// Power stage that stores the drive for the next period.
struct DriveOutput<'a>(&'a mut BridgeCommand);

impl PowerStage for DriveOutput<'_> {
    fn drive(&mut self, drive: BridgeCommand) {
        *self.0 = drive;
    }
}

impl MotorRig {
    /// Disarmed at an opening. The control is configured for the nominal motor, with the sensor offset and phase
    /// order of this plant.
    pub fn new(lead: Lead, parameters: PlantParameters, opening_mm: f64, seed: u64) -> Self {
        Self::with_limits(MotorLimits::GRIPPER, lead, parameters, opening_mm, seed)
    }

    /// The same with other motor limits.
    pub fn with_limits(
        limits: MotorLimits,
        lead: Lead,
        parameters: PlantParameters,
        opening_mm: f64,
        seed: u64,
    ) -> Self {
        let settings =
            Settings { wiring: wiring(&parameters), limits, ..Settings::assumed(lead.screw()) };
        Self::with_settings(settings, parameters, opening_mm, seed)
    }

    /// The same with other control settings.
    pub fn with_settings(
        settings: Settings,
        parameters: PlantParameters,
        opening_mm: f64,
        seed: u64,
    ) -> Self {
        Self {
            plant: Plant::new(parameters, 1e-3 * opening_mm, seed),
            motor: Motor::new(settings),
            drive: BridgeCommand::Off,
            settings,
        }
    }

    /// Armed, with the opening known.
    pub fn armed(lead: Lead, parameters: PlantParameters, opening_mm: f64, seed: u64) -> Self {
        let mut rig = Self::new(lead, parameters, opening_mm, seed);
        rig.motor.handle_command(MotorCommand::Arm);
        rig.run_while(ARMING_S, |telling| telling.state != MotorState::Armed);
        let opening_mm = opening_mm as f32;
        rig.motor.handle_command(MotorCommand::SetOpening { opening_mm });
        rig.run_while(ARMING_S, |telling| telling.opening_mm.is_none());
        rig
    }

    /// Restarts the control: off, opening unknown.
    pub fn restart(&mut self) {
        self.motor = Motor::new(self.settings);
        self.drive = BridgeCommand::Off;
    }

    /// One PWM period.
    pub fn period(&mut self) {
        self.period_with(|_| {});
    }

    /// One PWM period with the samples modified.
    pub fn period_with(&mut self, modify: impl FnOnce(&mut MotorSamples)) {
        let mut sensed = self.plant.step(self.drive);
        modify(&mut sensed);
        self.motor.period(&sensed, &mut DriveOutput(&mut self.drive));
    }

    /// Runs for a time.
    pub fn run(&mut self, seconds: f64) {
        self.run_while(seconds, |_| true);
    }

    /// Runs while a condition is true, at max this long.
    pub fn run_while(&mut self, seconds: f64, condition: impl Fn(&MotorStatus) -> bool) {
        for _ in 0..periods(seconds) {
            if !condition(&self.motor.status()) {
                break;
            }
            self.period();
        }
    }

    /// Applies a set-point for a time.
    pub fn run_setpoint(&mut self, setpoint: Setpoint, seconds: f64) {
        self.motor.handle_command(MotorCommand::Setpoint(setpoint));
        self.run(seconds);
    }
}

/// PWM periods in a time.
pub fn periods(seconds: f64) -> u32 {
    (seconds / PERIOD_S).round() as u32
}

/// Result of commissioning for this plant.
pub(super) fn wiring(parameters: &PlantParameters) -> MotorWiring {
    let turns = -parameters.zero_rad * parameters.windings.pole_pairs / TAU;
    MotorWiring {
        offset: (turns.rem_euclid(1.0) * 4_294_967_296.0) as u32,
        is_swapped: parameters.swapped,
    }
}

/// True state of the drivetrain at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorSample {
    /// Time since the set-point, in s.
    pub time_s: f64,
    /// Opening in mm.
    pub opening_mm: f64,
    /// Set-point of the position loop in mm; none without a position set-point.
    pub setpoint_mm: Option<f64>,
    /// Speed of the opening, closing positive, in mm/s.
    pub closing_mm_s: f64,
    /// Direct and quadrature current in A.
    pub current_a: [f64; 2],
    /// Direct and quadrature voltage commanded by the control, in V.
    pub voltage_v: [f64; 2],
    /// Bus voltage in V.
    pub bus_v: f64,
    /// Grip force in N.
    pub force_n: f64,
}

impl MotorSample {
    /// Samples a rig.
    pub fn of(rig: &MotorRig, start_s: f64) -> Self {
        let telling = rig.motor.status();
        let plant = &rig.plant;
        Self {
            time_s: plant.time_s() - start_s,
            opening_mm: 1e3 * plant.opening_m(),
            setpoint_mm: telling.setpoint_mm.map(f64::from),
            closing_mm_s: 1e3 * plant.train.travel_m_s,
            current_a: plant.direct_quadrature_a(),
            voltage_v: [telling.voltage.d, telling.voltage.q].map(f64::from),
            bus_v: plant.bus.voltage_v,
            force_n: plant.grip_n(),
        }
    }
}

/// Samples of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MotorTrace {
    /// One per PWM period.
    pub points: Vec<MotorSample>,
}

impl MotorTrace {
    /// Runs a rig for a time and records it.
    pub fn record(&mut self, rig: &mut MotorRig, start_s: f64, seconds: f64) {
        for _ in 0..periods(seconds) {
            rig.period();
            self.points.push(MotorSample::of(rig, start_s));
        }
    }

    /// Maximum of a quantity.
    pub fn max(&self, of: impl Fn(&MotorSample) -> f64) -> f64 {
        self.points.iter().map(of).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Mean of a quantity over the last `seconds`.
    pub fn mean_of_last(&self, seconds: f64, of: impl Fn(&MotorSample) -> f64) -> f64 {
        let count = (periods(seconds) as usize).clamp(1, self.points.len().max(1));
        let tail = &self.points[self.points.len().saturating_sub(count)..];
        tail.iter().map(of).sum::<f64>() / tail.len() as f64
    }
}

/// A position step, from and to, in mm.
pub const POSITION_STEP_MM: [f64; 2] = [40.0, 30.0];
/// Current limit of the runs, in A: that of the peak torque.
pub const MAX_A: f64 = constants::PEAK_TORQUE.value / constants::TORQUE_CONSTANT.value;
/// Settling time at the end of a position run.
const SETTLE_S: f64 = 0.2;
/// Maximum duration of a position run.
const LONGEST_S: f64 = 20.0;
/// Stiffness of a rigid object in N/mm; a third of it in series with the flexures.
pub const RIGID_N_PER_MM: f64 = 1000.0;
/// Rise and settling time of a static grip.
const STATIC_GRIP_S: [f64; 2] = [1.0, 0.2];

/// A drivetrain to simulate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveCase {
    /// Screw.
    pub lead: Lead,
    /// Plant parameters.
    pub parameters: PlantParameters,
    /// Seed of the sensor noise.
    pub seed: u64,
}

impl DriveCase {
    /// Nominal parameters.
    pub fn nominal(lead: Lead, seed: u64) -> Self {
        Self { lead, parameters: PlantParameters::nominal(lead), seed }
    }

    /// Parameters with a tolerance of `share`.
    pub fn scattered(lead: Lead, share: f64, seed: u64) -> Self {
        Self { lead, parameters: PlantParameters::scattered(lead, share, seed), seed }
    }

    fn rig(&self, opening_mm: f64) -> MotorRig {
        MotorRig::armed(self.lead, self.parameters, opening_mm, self.seed)
    }
}

/// Moves from one opening to another.
pub fn run_to_position(
    case: &DriveCase,
    [from_mm, to_mm]: [f64; 2],
    speed_mm_s: f64,
) -> MotorTrace {
    let mut rig = case.rig(from_mm);
    rig.motor.handle_command(MotorCommand::Setpoint(Setpoint::Position {
        opening_mm: to_mm as f32,
        speed_mm_s: speed_mm_s as f32,
        max_a: MAX_A as f32,
    }));
    let start_s = rig.plant.time_s();
    let mut trace = MotorTrace::default();
    // The trajectory ends when its set-point is the target.
    let arrived = |trace: &MotorTrace| {
        let setpoint_mm = trace.points.last().and_then(|point| point.setpoint_mm);
        setpoint_mm.is_some_and(|mm| (mm - to_mm).abs() < 1e-3)
    };
    while !arrived(&trace) && rig.plant.time_s() - start_s < LONGEST_S {
        trace.record(&mut rig, start_s, 1e-3);
    }
    trace.record(&mut rig, start_s, SETTLE_S);
    trace
}

/// Closes at a speed for a time, then brakes.
pub fn run_at_speed(case: &DriveCase, from_mm: f64, closing_mm_s: f64, seconds: f64) -> SpeedRun {
    let mut rig = case.rig(from_mm);
    rig.motor.handle_command(MotorCommand::Setpoint(Setpoint::Speed {
        closing_mm_s: closing_mm_s as f32,
        max_a: MAX_A as f32,
    }));
    let start_s = rig.plant.time_s();
    let mut trace = MotorTrace::default();
    trace.record(&mut rig, start_s, seconds);
    let (mean_mm_s, braked_at) = (trace.mean_of_last(0.02, |p| p.closing_mm_s), trace.points.len());
    rig.motor.handle_command(MotorCommand::Setpoint(Setpoint::Brake));
    trace.record(&mut rig, start_s, 0.05);
    let distance = |index: usize| trace.points.get(index).map_or(0.0, |p| p.opening_mm);
    let braking_mm =
        (distance(braked_at.saturating_sub(1)) - distance(trace.points.len() - 1)).abs();
    SpeedRun { closing_mm_s, mean_mm_s, braking_mm, trace }
}

/// A run at a speed, and its braking.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeedRun {
    /// Set-point of the closing speed in mm/s.
    pub closing_mm_s: f64,
    /// Mean speed of closing before the brake, in mm/s.
    pub mean_mm_s: f64,
    /// Braking distance of the fingers in mm.
    pub braking_mm: f64,
    /// All samples.
    pub trace: MotorTrace,
}

impl SpeedRun {
    /// Overshoot of the closing speed over its set-point, as a fraction of it.
    pub fn overshoot(&self) -> f64 {
        self.trace.max(|point| point.closing_mm_s) / self.closing_mm_s - 1.0
    }
}

/// Grip force in N of a slowly rising current on a rigid object.
pub fn static_force_n(case: &DriveCase, current_a: f64) -> f64 {
    let opening_mm = 40.0;
    let mut rig = case.rig(opening_mm);
    let object = Object::new(1e-3 * opening_mm, RIGID_N_PER_MM);
    rig.plant.set_object(Some(&object));
    let [rise_s, rest_s] = STATIC_GRIP_S;
    let start_s = rig.plant.time_s();
    while rig.plant.time_s() - start_s < rise_s + rest_s {
        let share = ((rig.plant.time_s() - start_s) / rise_s).min(1.0);
        let closing_a = (current_a * (share * FRAC_PI_2).sin()) as f32;
        rig.run_setpoint(Setpoint::Current { closing_a }, 1e-3);
    }
    rig.plant.grip_n()
}

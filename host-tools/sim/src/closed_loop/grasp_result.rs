//! A grasp from approach to hold, sampled each millisecond: by the firmware, or by a current limit alone.

use crate::closed_loop::drive_result;
use crate::closed_loop::grasp_rig::{
    GraspRig, NOISE_N, TICK_S, contact_object, grip_command, object_width_mm,
};
use crate::closed_loop::motor_rig::{DriveCase, MotorRig};
use crate::drivetrain::parameters::{Lead, PlantParameters};
use firmware::config::constants::{self, Constant};
use firmware::grip::states::{PowerState, TaskState};
use firmware::motor::{MotorCommand, Setpoint};

/// Timeouts of contact to hold and of the approach, in seconds.
const TIMEOUTS_S: [f64; 2] = [10.0, 20.0];
/// Averaging time at the end, in seconds.
const END_S: f64 = 0.1;
/// Force that counts as contact, in N.
const CONTACT_N: f64 = 0.5;

/// State of a grasp at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GraspSample {
    /// Time since contact, in s.
    pub time_s: f64,
    /// Force set-point in N.
    pub set_n: f64,
    /// Force estimate of the firmware in N; none without force control.
    pub estimated_n: Option<f64>,
    /// True grip force in N.
    pub true_n: f64,
    /// Opening in mm.
    pub opening_mm: f64,
    /// Quadrature current in A.
    pub current_a: f64,
    /// State of the firmware; none without force control.
    pub state: Option<(PowerState, TaskState)>,
}

impl GraspSample {
    /// Samples a grasp; the contact time is subtracted later.
    fn of(bench: &GraspRig, set_n: f64) -> Self {
        Self {
            estimated_n: Some(f64::from(bench.grip.force_n())),
            state: Some((bench.grip.power(), bench.grip.task())),
            ..Self::of_rig(&bench.rig, set_n)
        }
    }

    fn of_rig(rig: &MotorRig, set_n: f64) -> Self {
        let [_, current_a] = rig.plant.direct_quadrature_a();
        Self {
            time_s: rig.plant.time_s(),
            set_n,
            estimated_n: None,
            true_n: rig.plant.grip_n(),
            opening_mm: 1e3 * rig.plant.opening_m(),
            current_a,
            state: None,
        }
    }
}

/// Object and force of a grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GraspTarget {
    /// Contact stiffness, flexures included, in N/mm.
    pub contact_n_per_mm: f64,
    /// Force set-point in newtons.
    pub set_n: f64,
    /// Initial distance to the object in mm.
    pub from_mm: f64,
    /// Simulated time after hold, or after the current limit is reached, in seconds.
    pub hold_s: f64,
}

impl GraspTarget {
    /// A grasp that begins 2 mm before the object.
    pub fn new(contact_n_per_mm: f64, set_n: f64, hold_s: f64) -> Self {
        Self { contact_n_per_mm, set_n, from_mm: 2.0, hold_s }
    }

    /// Whether the initial opening is within the stroke.
    pub fn is_possible(&self) -> bool {
        self.opening_mm() <= constants::STROKE.value
    }

    fn width_mm(&self) -> f64 {
        object_width_mm(self.set_n, self.contact_n_per_mm)
    }

    fn opening_mm(&self) -> f64 {
        self.width_mm() + self.from_mm
    }
}

/// Samples of a grasp.
#[derive(Clone, Debug, PartialEq)]
pub struct GraspTrace {
    /// Object and force.
    pub target: GraspTarget,
    /// One per millisecond.
    pub points: Vec<GraspSample>,
}

/// Grips an object with the firmware's force control and holding it.
pub fn run_grasp(
    lead: Lead,
    parameters: PlantParameters,
    target: GraspTarget,
    seed: u64,
) -> GraspTrace {
    let mut bench = GraspRig::new(lead, parameters, target.opening_mm(), seed);
    let object = contact_object(&parameters, target.width_mm(), target.contact_n_per_mm);
    bench.rig.plant.set_object(Some(&object));
    bench.order(grip_command(target.set_n));
    let mut trace = GraspTrace::new(target);
    let [timeout_s, approach_s] = TIMEOUTS_S;
    let mut remaining =
        [approach_s + timeout_s, target.hold_s].map(|seconds| (seconds / TICK_S) as u32);
    while remaining.iter().all(|remaining| *remaining > 0) {
        bench.tick();
        trace.points.push(GraspSample::of(&bench, target.set_n));
        let [waiting, holding] = &mut remaining;
        if is_held(bench.grip.task()) {
            *holding -= 1
        } else {
            *waiting -= 1
        }
        if trace.has_timed_out(timeout_s) {
            break;
        }
    }
    trace.relative_to_contact()
}

/// Grips at the paper's closing speed with only a current limit, that of the static force.
pub fn run_current_limited(
    lead: Lead,
    parameters: PlantParameters,
    target: GraspTarget,
    seed: u64,
) -> GraspTrace {
    let mut rig = MotorRig::armed(lead, parameters, target.opening_mm(), seed);
    let object = contact_object(&parameters, target.width_mm(), target.contact_n_per_mm);
    rig.plant.set_object(Some(&object));
    let torque_nm =
        lead.screw().torque_nm(target.set_n as f32, constants::DRY_FRICTION.value as f32);
    rig.motor.handle_command(MotorCommand::Setpoint(Setpoint::Speed {
        closing_mm_s: constants::CLOSING_SPEED.value as f32,
        max_a: torque_nm / constants::TORQUE_CONSTANT.value as f32,
    }));
    let mut trace = GraspTrace::new(target);
    let mut contact_s = 0.0;
    let [_, approach_s] = TIMEOUTS_S;
    while contact_s < target.hold_s && trace.points.len() < (approach_s / TICK_S) as usize {
        rig.run(TICK_S);
        trace.points.push(GraspSample::of_rig(&rig, target.set_n));
        if rig.plant.grip_n() > CONTACT_N || contact_s > 0.0 {
            contact_s += TICK_S;
        }
    }
    trace.relative_to_contact()
}

fn is_held(task: TaskState) -> bool {
    matches!(task, TaskState::HoldActive | TaskState::HoldLatched)
}

impl GraspTrace {
    fn new(target: GraspTarget) -> Self {
        Self { target, points: Vec::new() }
    }

    /// Whether the timeout has passed since contact without a hold.
    fn has_timed_out(&self, timeout_s: f64) -> bool {
        let earlier = self.points.iter().rev().nth((timeout_s / TICK_S) as usize);
        earlier.is_some_and(|point| point.true_n > CONTACT_N) && self.hold_s().is_none()
    }

    /// Shifts time to the contact.
    fn relative_to_contact(mut self) -> Self {
        let contact = self.points.iter().find(|point| point.true_n > CONTACT_N);
        let contact_s = contact.map_or(0.0, |point| point.time_s);
        for point in &mut self.points {
            point.time_s -= contact_s;
        }
        self
    }

    fn when(&self, condition: impl Fn(&GraspSample) -> bool) -> Option<f64> {
        let point = self.points.iter().find(|point| condition(point));
        point.map(|point| point.time_s)
    }

    /// Peak true force in N.
    pub fn peak_n(&self) -> f64 {
        let forces = self.points.iter().map(|point| point.true_n);
        forces.fold(0.0, f64::max)
    }

    /// Rise time in seconds from contact to 95 % of the force; none where it was not reached.
    pub fn rise_s(&self) -> Option<f64> {
        self.when(|point| point.true_n >= 0.95 * self.target.set_n)
    }

    /// Time in seconds from contact to hold; none without a hold.
    pub fn hold_s(&self) -> Option<f64> {
        self.when(|point| point.state.is_some_and(|(_, task)| is_held(task)))
    }

    /// Samples of the last tenth of a second.
    fn end(&self) -> &[GraspSample] {
        let count = (END_S / TICK_S) as usize;
        &self.points[self.points.len().saturating_sub(count)..]
    }

    fn mean(&self, of: impl Fn(&GraspSample) -> f64) -> f64 {
        let end = self.end();
        end.iter().map(of).sum::<f64>() / end.len() as f64
    }

    /// Mean force at the end, in N.
    pub fn end_n(&self) -> f64 {
        self.mean(|point| point.true_n)
    }

    /// RMS force error at the end, in N.
    pub fn error_n(&self) -> f64 {
        self.mean(|point| (point.true_n - self.target.set_n).powi(2)).sqrt()
    }

    /// Mean current at the end, in A.
    pub fn current_a(&self) -> f64 {
        self.mean(|point| point.current_a)
    }

    /// State of the firmware at the end.
    pub fn task(&self) -> Option<TaskState> {
        self.points.last()?.state.map(|(_, task)| task)
    }

    /// Sequence of states with their start times.
    pub fn states(&self) -> Vec<(f64, PowerState, TaskState)> {
        let mut states: Vec<(f64, PowerState, TaskState)> = Vec::new();
        for point in &self.points {
            let Some((power, task)) = point.state else {
                continue;
            };
            let last = states.last().map(|(_, power, task)| (*power, *task));
            if last != Some((power, task)) {
                states.push((point.time_s, power, task));
            }
        }
        states
    }
}

/// Constants of a grasp in addition to those of the drive.
const GRASP_CONSTANTS: [Constant; 3] =
    [constants::CONTACT_STIFFNESS, constants::CONTACT_REACTION_TIME, constants::FORCE_BANDWIDTH];

/// A grasp by the firmware, optionally compared with a current limit.
#[derive(Clone, Debug, PartialEq)]
pub struct GraspResult {
    /// Drivetrain.
    pub case: DriveCase,
    /// With the firmware's force control.
    pub own: GraspTrace,
    /// With a current limit only.
    pub other: Option<GraspTrace>,
}

impl GraspResult {
    /// Figures: name, value, unit; NaN where the event did not happen.
    pub fn figures(trace: &GraspTrace) -> Vec<(&'static str, f64, &'static str)> {
        let ms = |seconds: Option<f64>| 1e3 * seconds.unwrap_or(f64::NAN);
        let set_n = trace.target.set_n;
        vec![
            ("set-point of the force", set_n, "N"),
            ("peak force", trace.peak_n(), "N"),
            ("overshoot of the force", (trace.peak_n() - set_n).max(0.0), "N"),
            ("rise time to 95 %", ms(trace.rise_s()), "ms"),
            ("time to hold", ms(trace.hold_s()), "ms"),
            ("final force", trace.end_n(), "N"),
            ("RMS force error", trace.error_n(), "N"),
            ("final current", trace.current_a(), "A"),
        ]
    }

    /// Readable name of a state, such as "hold latched".
    pub fn state_name((power, task): (PowerState, TaskState)) -> String {
        let name = match power {
            PowerState::Enabled => format!("{task:?}"),
            power => format!("{power:?}"),
        };
        let mut text = String::new();
        for letter in name.chars() {
            if letter.is_uppercase() && !text.is_empty() {
                text.push(' ');
            }
            text.extend(letter.to_lowercase());
        }
        text
    }

    /// States of the firmware's grasp with their start times in seconds since contact.
    pub fn states(&self) -> Vec<(f64, String)> {
        let states = self.own.states().into_iter();
        states.map(|(time_s, power, task)| (time_s, Self::state_name((power, task)))).collect()
    }

    /// Summary of the simulated case.
    pub fn sentence(&self) -> String {
        let (lead, target) = (self.case.lead, &self.own.target);
        format!(
            "Screw {lead:?} grips an object of {} N/mm contact stiffness, flexures included, with {} N; seed {}. \
             The firmware's grasp and motor control on a simulated gripper; the force of each finger is measured with \
             {NOISE_N} N of noise and 1 ms delay.",
            target.contact_n_per_mm, target.set_n, self.case.seed
        )
    }

    /// Assumed constants of the simulation.
    pub fn assumed(&self) -> Vec<Constant> {
        drive_result::assumed_constants(self.case.lead, &GRASP_CONSTANTS)
    }
}

//! A grasp from before the contact to the hold, millisecond by millisecond: by the firmware's law, or by nothing
//! but a bound of the current.

use firmware::grip::states::{Power, Task};
use firmware::motor::{Order, Setpoint};
use firmware::params;

use super::Rig;
use super::grasp::{Bench, grip_command, object};
use crate::plant::parameters::{Lead, Parameters};

/// Seconds from one point to the next.
pub const STEP_S: f64 = 1e-3;
/// Width of what is gripped, in mm, unless it gives way by more.
const WIDTH_MM: f64 = 40.0;
/// What is left between the fingers once a soft thing has given way, in mm.
const LEFT_MM: f64 = 5.0;
/// A hold is waited for so long after the contact, in seconds; the approach so long.
const WAITS_S: [f64; 2] = [10.0, 20.0];
/// Seconds of the end over which is averaged.
const END_S: f64 = 0.1;
/// The force of a touch, in N.
const TOUCH_N: f64 = 0.5;

/// A grasp at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Since the contact, in s.
    pub time_s: f64,
    /// Force that is asked for, in N.
    pub set_n: f64,
    /// Force as the firmware is told, in N; none where nothing tells it.
    pub told_n: Option<f64>,
    /// Force between the fingers, in N.
    pub true_n: f64,
    /// Between the fingers, in mm.
    pub opening_mm: f64,
    /// Quadrature current in A.
    pub current_a: f64,
    /// What the firmware does; none where it does not control the grasp.
    pub state: Option<(Power, Task)>,
}

impl Point {
    /// What a bench does now; the contact's time is set later.
    fn of(bench: &Bench, set_n: f64) -> Self {
        Self {
            told_n: Some(f64::from(bench.grip.force_n())),
            state: Some((bench.grip.power(), bench.grip.task())),
            ..Self::of_rig(&bench.rig, set_n)
        }
    }

    fn of_rig(rig: &Rig, set_n: f64) -> Self {
        let [_, current_a] = rig.plant.direct_quadrature_a();
        Self {
            time_s: rig.plant.time_s(),
            set_n,
            told_n: None,
            true_n: rig.plant.grip_n(),
            opening_mm: 1e3 * rig.plant.opening_m(),
            current_a,
            state: None,
        }
    }
}

/// What is to be gripped, and how hard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Asked {
    /// Stiffness of the contact, flexures included, in newtons to the millimetre.
    pub contact_n_per_mm: f64,
    /// Force in newtons.
    pub set_n: f64,
    /// Where the fingers begin, in mm before the object.
    pub from_mm: f64,
    /// How long is looked on after the force is held, or after the current's bound is reached, in seconds.
    pub hold_s: f64,
}

impl Asked {
    /// A grasp that begins 2 mm before the object.
    pub fn new(contact_n_per_mm: f64, set_n: f64, hold_s: f64) -> Self {
        Self {
            contact_n_per_mm,
            set_n,
            from_mm: 2.0,
            hold_s,
        }
    }

    /// Whether the fingers open as far as it takes.
    pub fn is_possible(&self) -> bool {
        self.opening_mm() <= params::STROKE.value
    }

    /// Wide enough to give way as far as it must.
    fn width_mm(&self) -> f64 {
        WIDTH_MM.max(self.set_n / self.contact_n_per_mm + LEFT_MM)
    }

    fn opening_mm(&self) -> f64 {
        self.width_mm() + self.from_mm
    }
}

/// How a grasp went.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    /// What was asked.
    pub asked: Asked,
    /// One for each millisecond.
    pub points: Vec<Point>,
}

/// Grips something by the firmware's law, and holds it.
pub fn grasp(lead: Lead, parameters: Parameters, asked: Asked, seed: u64) -> Course {
    let mut bench = Bench::new(lead, parameters, asked.opening_mm(), seed);
    let object = object(&parameters, asked.width_mm(), asked.contact_n_per_mm);
    bench.rig.plant.hold(Some(&object));
    bench.order(grip_command(asked.set_n));
    let mut course = Course::new(asked);
    let [most_s, approach_s] = WAITS_S;
    let mut left = [approach_s + most_s, asked.hold_s].map(|seconds| (seconds / STEP_S) as u32);
    while left.iter().all(|left| *left > 0) {
        bench.tick();
        course.points.push(Point::of(&bench, asked.set_n));
        let [waits, holds] = &mut left;
        match is_held(bench.grip.task()) {
            true => *holds -= 1,
            false => *waits -= 1,
        }
        if course.has_failed_before(most_s) {
            break;
        }
    }
    course.since_contact()
}

/// The same at the paper's closing speed with nothing but a bound of the current: that which presses with the
/// force at rest.
pub fn current_limited(lead: Lead, parameters: Parameters, asked: Asked, seed: u64) -> Course {
    let mut rig = Rig::armed(lead, parameters, asked.opening_mm(), seed);
    let object = object(&parameters, asked.width_mm(), asked.contact_n_per_mm);
    rig.plant.hold(Some(&object));
    let torque_nm = lead
        .screw()
        .torque_nm(asked.set_n as f32, params::DRY_FRICTION.value as f32);
    rig.motor.obey(Order::Do(Setpoint::Speed {
        closing_mm_s: params::CLOSING_SPEED.value as f32,
        most_a: torque_nm / params::TORQUE_CONSTANT.value as f32,
    }));
    let mut course = Course::new(asked);
    let mut touched_s = 0.0;
    let [_, approach_s] = WAITS_S;
    while touched_s < asked.hold_s && course.points.len() < (approach_s / STEP_S) as usize {
        rig.run(STEP_S);
        course.points.push(Point::of_rig(&rig, asked.set_n));
        if rig.plant.grip_n() > TOUCH_N || touched_s > 0.0 {
            touched_s += STEP_S;
        }
    }
    course.since_contact()
}

fn is_held(task: Task) -> bool {
    matches!(task, Task::HoldActive | Task::HoldLatched)
}

impl Course {
    fn new(asked: Asked) -> Self {
        Self {
            asked,
            points: Vec::new(),
        }
    }

    /// Whether so long after the contact nothing is held.
    fn has_failed_before(&self, most_s: f64) -> bool {
        let late = self.points.iter().rev().nth((most_s / STEP_S) as usize);
        late.is_some_and(|point| point.true_n > TOUCH_N) && self.hold_s().is_none()
    }

    /// Counts the time from the contact.
    fn since_contact(mut self) -> Self {
        let touches = self.points.iter().find(|point| point.true_n > TOUCH_N);
        let contact_s = touches.map_or(0.0, |point| point.time_s);
        for point in &mut self.points {
            point.time_s -= contact_s;
        }
        self
    }

    fn when(&self, is_so: impl Fn(&Point) -> bool) -> Option<f64> {
        let point = self.points.iter().find(|point| is_so(point));
        point.map(|point| point.time_s)
    }

    /// Greatest true force, in N.
    pub fn peak_n(&self) -> f64 {
        let forces = self.points.iter().map(|point| point.true_n);
        forces.fold(0.0, f64::max)
    }

    /// Seconds from the contact to 95 % of the force; none where it did not get there.
    pub fn rise_s(&self) -> Option<f64> {
        self.when(|point| point.true_n >= 0.95 * self.asked.set_n)
    }

    /// Seconds from the contact to the hold; none where there was none.
    pub fn hold_s(&self) -> Option<f64> {
        self.when(|point| point.state.is_some_and(|(_, task)| is_held(task)))
    }

    /// What it ends with, over the last tenth of a second.
    fn end(&self) -> &[Point] {
        let count = (END_S / STEP_S) as usize;
        &self.points[self.points.len().saturating_sub(count)..]
    }

    fn mean(&self, of: impl Fn(&Point) -> f64) -> f64 {
        let end = self.end();
        end.iter().map(of).sum::<f64>() / end.len() as f64
    }

    /// Mean force at the end, in N.
    pub fn end_n(&self) -> f64 {
        self.mean(|point| point.true_n)
    }

    /// Root mean square of its error, in N.
    pub fn error_n(&self) -> f64 {
        self.mean(|point| (point.true_n - self.asked.set_n).powi(2))
            .sqrt()
    }

    /// Mean current at the end, in A.
    pub fn current_a(&self) -> f64 {
        self.mean(|point| point.current_a)
    }

    /// What the firmware does at the end.
    pub fn task(&self) -> Option<Task> {
        self.points.last()?.state.map(|(_, task)| task)
    }

    /// States one after the other, each with the time at which it began.
    pub fn states(&self) -> Vec<(f64, Power, Task)> {
        let mut states: Vec<(f64, Power, Task)> = Vec::new();
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

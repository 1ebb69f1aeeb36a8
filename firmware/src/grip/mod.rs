//! The grasp, and the gripper as a foot: once a millisecond from forces, motor and hosts to what the motor is
//! asked to do. In newtons and millimetres; closing is positive.
//!
//! Two layers of states ([`states`]) whose transitions are tables ([`table`]): what they do not list is refused,
//! with a reason ([`reason`]). Arming is the session's ([`crate::session`]); this follows it.
//!
//! - [`states`], [`table`], [`reason`]: what may follow what.
//! - [`order`], [`profile`]: what hosts ask for.
//! - [`fingers`], [`contact`], [`stiffness`], [`object`], [`pace`], [`jam`]: what is felt.
//! - [`law`]: from the force that is missing to a speed.
//! - [`home`]: both ends found by force.
//! - [`foot`]: which fingertips stand, and where the ground pushes.
//! - [`react`], [`latch`]: what faults do, and which came first.
//! - [`kept`]: copies of what would be dangerous if memory lost it.
//! - [`Inputs`], [`Outputs`]: what it is told, and what it tells.
//! - `power`, `task`, `drive`, `tell`: a millisecond of each layer, the set-point, the messages.
//!
//! | word | meaning |
//! | --- | --- |
//! | contact | the fingers press against something |
//! | hold | the force that was asked for is there, and is kept |
//! | believed | the force of a finger whose sensors both answer, with no foreign magnet near |
//! | silent | no command for the session's time; what moves stops, a hold goes on |

pub mod contact;
mod drive;
pub mod fingers;
#[cfg(test)]
mod fixture;
pub mod foot;
pub mod home;
mod interface;
pub mod jam;
pub mod kept;
pub mod latch;
pub mod law;
pub mod object;
pub mod order;
pub mod pace;
mod power;
pub mod profile;
pub mod react;
pub mod reason;
pub mod states;
pub mod stiffness;
pub mod table;
mod task;
mod tell;
#[cfg(test)]
mod tests;

use crate::force::Estimate;
use crate::frame::SENSORS;
use crate::limits::Grasp;
use crate::motor::Setpoint;
use crate::motor::screw::Screw;
use crate::params;
use crate::status::{Fault, Faults};
use crate::wire::messages::GripStatus;
use contact::Contact;
use fingers::{Finger, Fingers};
use foot::{Feeling, Standing};
use home::Homing;
use jam::Jam;
use latch::{Cause, Latch};
use object::Watch;
use order::{Order, Way};
use pace::Pace;
use react::Reaction;
use reason::Refused;
use states::{Power, Task};
use stiffness::Stiffness;

pub use interface::{Arming, Host, Inputs, Outputs};

/// Greatest current in amperes.
const PEAK_A: f32 = (params::PEAK_TORQUE.value / params::TORQUE_CONSTANT.value) as f32;
/// Forces of which a hold's force is the mean.
const MEAN_TICKS: f32 = 16.0;

/// The grasp. [`Grip::tick`] runs once a millisecond.
#[derive(Clone, Debug)]
pub struct Grip {
    limits: Grasp,
    screw: Screw,
    /// The screw is known to hold its load without current.
    locks: bool,
    power: Power,
    task: Task,
    now_ms: u32,
    power_ms: u32,
    task_ms: u32,
    /// The order that is being done, and how its flag was turned.
    seen: Option<(Order, bool)>,
    grip: order::Grip,
    way: Way,
    /// The way opens.
    is_opening: bool,
    /// Something was touched before the way began.
    was_touching: bool,
    /// The force that is asked for, in newtons: slips raise it.
    set_n: f32,
    fingers: Fingers,
    /// The last that was believed.
    force_n: f32,
    /// Means of each finger's last sixteen or so, in newtons; none while it is not believed.
    means_n: [Option<f32>; 2],
    /// The greater of both: the greater of two that are noisy would be too much.
    mean_n: f32,
    unbelieved_ticks: u8,
    lost_ticks: u8,
    believed_ms: u16,
    last_mm: Option<f32>,
    contact: Contact,
    stiffness: Stiffness,
    watch: Watch,
    homing: Homing,
    home_step: home::Step,
    jam: Jam,
    feeling: Feeling,
    standing: Standing,
    unloaded_ms: u16,
    pace: Pace,
    resting_ms: u16,
    right_ms: u16,
    weak_ms: u16,
    /// When it was gripped again, newest first.
    regrips: [Option<u32>; 3],
    /// Something hangs on the fingers, or may.
    is_gripped: bool,
    /// The force was reached, and what is gripped not let go since.
    has_settled: bool,
    /// Amperes that the hold took last.
    hold_a: f32,
    hold: drive::Hold,
    /// Where the fingers are kept, in millimetres; none until they rest.
    place_mm: Option<f32>,
    latch: Latch,
    faults: Faults,
    /// What is done about the fault that is being reacted to.
    reaction: Reaction,
    /// The fingers give way after too much force.
    backs_off: bool,
    slipping_ms: u16,
    stray_ms: u16,
    clearing_ms: u8,
    copies: [u32; kept::WORDS],
}

impl Grip {
    /// Just begun; `locks` is whether the screw is known to hold its load without current.
    pub fn new(limits: Grasp, screw: Screw, locks: bool) -> Self {
        let mut grip = Self {
            limits,
            screw,
            locks,
            power: Power::Boot,
            task: Task::Unhomed,
            now_ms: 0,
            power_ms: 0,
            task_ms: 0,
            seen: None,
            grip: order::Grip {
                set_n: 0.0,
                most_mm_s: 0.0,
                cap_n: 0.0,
                window: None,
                is_fast: false,
            },
            way: Way {
                opening_mm: 0.0,
                speed_mm_s: 0.0,
            },
            is_opening: false,
            was_touching: false,
            set_n: 0.0,
            fingers: Fingers::of(&[Estimate::MISSING; SENSORS]),
            force_n: 0.0,
            means_n: [None; 2],
            mean_n: 0.0,
            unbelieved_ticks: 0,
            lost_ticks: 0,
            believed_ms: 0,
            last_mm: None,
            contact: Contact::default(),
            stiffness: Stiffness::default(),
            watch: Watch::default(),
            homing: Homing::default(),
            home_step: home::Step::Drive(Setpoint::Off),
            jam: Jam::default(),
            feeling: Feeling::default(),
            standing: Standing::default(),
            unloaded_ms: 0,
            pace: Pace::default(),
            resting_ms: 0,
            right_ms: 0,
            weak_ms: 0,
            regrips: [None; 3],
            is_gripped: false,
            has_settled: false,
            hold_a: 0.0,
            hold: drive::Hold::default(),
            place_mm: None,
            latch: Latch::default(),
            faults: Faults::default(),
            reaction: Reaction::Warn,
            backs_off: false,
            slipping_ms: 0,
            stray_ms: 0,
            clearing_ms: 0,
            copies: [0; kept::WORDS],
        };
        grip.copy();
        grip
    }

    /// One millisecond. Between two of them nothing may change ([`Grip::is_intact`]) but by [`Grip::set_locks`].
    pub fn tick(&mut self, inputs: &Inputs) -> Outputs {
        self.now_ms = self.now_ms.wrapping_add(1);
        self.power_ms = self.power_ms.saturating_add(1);
        self.task_ms = self.task_ms.saturating_add(1);
        let mut outputs = Outputs {
            setpoint: Setpoint::Off,
            arming: None,
            opening_mm: None,
            may_arm: false,
            state: 0,
            status: GripStatus::default(),
            foot: None,
            refused: None,
            events: heapless::Vec::new(),
        };
        self.feel(inputs);
        self.find_faults(inputs, &mut outputs);
        self.follow_power(inputs, &mut outputs);
        if let Some(command) = inputs.command
            && let Err(reason) = self.hear(&command, inputs)
        {
            outputs.refused = Some(Refused {
                mode: command.mode,
                reason,
                state: self.state(),
            });
        }
        if self.power == Power::Enabled {
            self.follow_task(inputs, &mut outputs);
        }
        outputs.setpoint = self.drive(&inputs.motor);
        self.tell(inputs, &mut outputs);
        self.copy();
        outputs
    }

    /// Another word on whether the screw holds its load without current; it counts while nothing is driven.
    pub const fn set_locks(&mut self, locks: bool) {
        if matches!(self.power, Power::Safe) {
            self.locks = locks;
        }
    }

    /// Whether the motor is driven, or may be.
    pub const fn is_driven(&self) -> bool {
        matches!(
            self.power,
            Power::Armed | Power::Enabled | Power::QuickStop | Power::FaultReaction
        )
    }

    /// As in the heartbeat.
    pub const fn state(&self) -> u8 {
        states::code(self.power, self.task)
    }

    /// The power layer's state.
    pub const fn power(&self) -> Power {
        self.power
    }

    /// The task layer's state, meant while [`Power::Enabled`].
    pub const fn task(&self) -> Task {
        self.task
    }

    /// What began the faults since a host cleared them last.
    pub const fn first_cause(&self) -> Option<Cause> {
        self.latch.cause()
    }

    /// Active faults of motor and grasp, in the heartbeat's bits.
    pub fn fault_bits(&self) -> u32 {
        self.faults.bits()
    }

    /// The greater force of the fingers in newtons, as it was believed last.
    pub const fn force_n(&self) -> f32 {
        self.force_n
    }

    /// What the foot feels.
    pub const fn standing(&self) -> &Standing {
        &self.standing
    }

    /// The contact's stiffness as it is estimated, in newtons to the millimetre.
    pub const fn stiffness(&self) -> f32 {
        self.stiffness.told()
    }

    /// What is felt in this millisecond.
    fn feel(&mut self, inputs: &Inputs) {
        self.fingers = Fingers::of(inputs.estimates);
        let step = |ticks: &mut u8, counts: bool| {
            *ticks = if counts { ticks.saturating_add(1) } else { 0 };
        };
        let told = self.fingers.greatest_n();
        step(&mut self.unbelieved_ticks, told.is_none());
        step(&mut self.lost_ticks, self.fingers.are_lost());
        self.believed_ms = match told {
            Some(_) => self.believed_ms.saturating_add(1),
            None => 0,
        };
        let motor = &inputs.motor;
        if let Some(force_n) = told {
            self.force_n = force_n;
            self.average();
            self.contact.note(force_n, &self.limits);
            let loads = matches!(self.task, Task::Approach | Task::Force);
            // A force is a millisecond old.
            if let Some(opening_mm) = self.last_mm
                && loads
                && self.contact.is_suspected()
            {
                self.stiffness.take(-opening_mm, force_n);
            }
        }
        self.last_mm = motor.opening_mm;
        let pace_mm_s = self.pace.note(motor.closing_mm_s);
        self.resting_ms = match pace_mm_s.abs() < self.limits.resting_mm_s {
            true => self.resting_ms.saturating_add(1),
            false => 0,
        };
        let standing = self.feeling.note(
            inputs.estimates,
            inputs.acceleration,
            motor.opening_mm,
            &self.limits,
        );
        self.unloaded_ms = match standing.is_unloaded {
            true => self.unloaded_ms.saturating_add(1),
            false => 0,
        };
        self.standing = standing;
    }

    /// Goes on with the fingers' means.
    fn average(&mut self) {
        let fingers = [self.fingers.left, self.fingers.right];
        for (mean_n, finger) in self.means_n.iter_mut().zip(fingers) {
            *mean_n = match (finger, *mean_n) {
                (Finger::Told(now_n), Some(mean_n)) => Some(mean_n + (now_n - mean_n) / MEAN_TICKS),
                (Finger::Told(now_n), None) => Some(now_n),
                _ => None,
            };
        }
        let means_n = self.means_n.into_iter().flatten();
        self.mean_n = means_n.reduce(f32::max).unwrap_or(self.force_n);
    }

    /// Whether the fingers have come to rest.
    fn rests(&self) -> bool {
        self.resting_ms >= self.limits.resting_ms
    }

    /// Whether no finger's force is believed, and has not been for a while.
    fn is_blind(&self) -> bool {
        self.unbelieved_ticks >= self.limits.blind_ticks
    }

    /// Notes a fault of its own.
    fn note(&mut self, fault: Fault, active: bool, detail: u32, outputs: &mut Outputs) {
        if self.faults.has(fault, 0) == active {
            return;
        }
        if let Some(event) = self.faults.note(fault, 0, active, detail) {
            // There is room for every kind; what finds none is in the heartbeat's bits all the same.
            let _ = outputs.events.push(event);
        }
    }
}

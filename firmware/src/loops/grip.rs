//! The grasp in time: with each estimate a millisecond of [`Grip`], and an order for the motor.

use embassy_sync::blocking_mutex::raw::RawMutex;

use super::{Exchange, Finder};
use crate::force::Estimate;
use crate::frame::SENSORS;
use crate::grip::states::Power;
use crate::grip::{Arming, Grip, Host, Inputs, Outputs};
use crate::motor::calibration::{Calibration, Failure, Measure, Outcome};
use crate::motor::{Order, Telling};
use crate::parameters::{Parameters, Screw};
use crate::progress::Loop;
use crate::status::Fault;
use crate::wire::messages::{Command, Foot, GripStatus, Message};

/// Ticks from one [`GripStatus`] to the next.
const STATUS_TICKS: u16 = GripStatus::LAYOUT.period_ms;

/// What the loop holds the motor by.
pub trait Reins {
    /// Hands an order over, to be done within a period of the pulses; gives it back where the one before
    /// still waits.
    ///
    /// # Errors
    /// The order.
    fn order(&mut self, order: Order) -> Result<(), Order>;

    /// Switches the power stage off and restarts: the grasp's memory is not what it was. On the chip it does not
    /// return.
    fn give_up(&mut self);
}

/// What is felt in a tick.
#[derive(Clone, Copy, Debug)]
pub struct Felt {
    /// Forces, tare taken off.
    pub estimates: [Estimate; SENSORS],
    /// The motor as it was when they were estimated.
    pub motor: Telling,
    /// Of the fingertips ([`Inputs::acceleration`]).
    pub acceleration: Option<[i32; 3]>,
}

/// What hosts have asked for since the last tick.
#[derive(Clone, Copy, Debug)]
pub struct Asked {
    /// A command that counts; of two the newer.
    pub command: Option<Command>,
    /// Somebody says stop.
    pub stop: bool,
    /// A host clears faults.
    pub clear: bool,
    /// Something is to be measured.
    pub measure: Option<Measure>,
}

impl Asked {
    /// Nothing.
    pub const NOTHING: Self = Self {
        command: None,
        stop: false,
        clear: false,
        measure: None,
    };
}

/// What is known of hosts and of the start.
#[derive(Clone, Copy, Debug)]
pub struct Hosts {
    /// The session.
    pub host: Host,
    /// Tables and networks have been looked at.
    pub is_checked: bool,
    /// A tare is under way.
    pub is_taring: bool,
}

impl Hosts {
    /// Just begun.
    pub const NONE: Self = Self {
        host: Host {
            is_offered: false,
            is_open: false,
            is_alive: false,
        },
        is_checked: false,
        is_taring: false,
    };
}

/// Where the grasp stands.
#[derive(Clone, Copy, Debug)]
pub struct Stands {
    /// As in the heartbeat.
    pub state: u8,
    /// Likewise.
    pub object: u8,
    /// Whether a session may be open.
    pub may_arm: bool,
    /// The motor is driven, or may be: no time for flash, tare or another start, session or not.
    pub is_driven: bool,
}

impl Stands {
    /// Not begun.
    pub const NOWHERE: Self = Self {
        state: 0,
        object: 0,
        may_arm: false,
        is_driven: false,
    };
}

/// Grasps, for ever.
pub async fn grip<R: Reins, M: RawMutex>(
    grip: &mut Grip,
    mut reins: R,
    exchange: &Exchange<M>,
) -> ! {
    let mut turns = Turns::default();
    loop {
        let felt = exchange.felt.wait().await;
        turns.take(grip, &felt, &mut reins, exchange);
    }
}

/// What the loop keeps from one millisecond to the next.
#[derive(Default)]
pub struct Turns {
    pending: Pending,
    ticks: u16,
    counters: Counters,
}

/// Counters of messages: by them a host sees what it has missed, and so they count what is sent.
#[derive(Clone, Copy, Debug, Default)]
struct Counters {
    status: u8,
    foot: u8,
}

impl Turns {
    /// A millisecond.
    pub fn take<R: Reins, M: RawMutex>(
        &mut self,
        grip: &mut Grip,
        felt: &Felt,
        reins: &mut R,
        exchange: &Exchange<M>,
    ) {
        exchange.progress.check_in(Loop::Grip);
        if !grip.is_intact() {
            reins.give_up();
            return;
        }
        let pending = &mut self.pending;
        grip.set_locks(exchange.parameter(Parameters::screw) == Screw::SelfLocking);
        let asked = exchange.asked.set(Asked::NOTHING);
        if let Some(measure) = asked.measure {
            pending.calibration = Some(Calibration::new(measure));
        }
        let is_busy = pending.calibration.is_some();
        let outputs = tick(grip, felt, (&asked, is_busy), exchange);
        let order = match is_busy {
            true => pending.measure(grip.power(), asked.stop, &felt.motor, exchange),
            false => Some(pending.order(&outputs)),
        };
        if let Some(order) = order {
            let is_taken = reins.order(order).is_ok();
            pending.was_given(&order, is_taken);
        }
        self.ticks = (self.ticks + 1) % STATUS_TICKS;
        tell(&outputs, self.ticks == 0, &mut self.counters, exchange);
        exchange.stands.set(Stands {
            state: outputs.state,
            object: outputs.status.object,
            may_arm: outputs.may_arm,
            is_driven: grip.is_driven(),
        });
        exchange.tell(Finder::Grip, grip.fault_bits(), &outputs.events);
    }
}

/// What the motor is still to be told or asked.
#[derive(Default)]
struct Pending {
    /// What is not a number: the opening is not known any more.
    opening_mm: Option<f32>,
    calibration: Option<Calibration>,
}

impl Pending {
    /// One order in a tick: what is left waits for the next, where a set-point is a newer one.
    fn order(&mut self, outputs: &Outputs) -> Order {
        self.opening_mm = outputs.opening_mm.or(self.opening_mm);
        match (outputs.arming, self.opening_mm) {
            (Some(Arming::Arm), _) => Order::Arm,
            (Some(Arming::Disarm), _) => Order::Disarm,
            (None, Some(opening_mm)) => Order::Opening { opening_mm },
            (None, None) => Order::Do(outputs.setpoint),
        }
    }

    fn was_given(&mut self, order: &Order, is_taken: bool) {
        if is_taken && matches!(order, Order::Opening { .. }) {
            self.opening_mm = None;
        }
    }

    /// A millisecond of a calibration; its end is told.
    fn measure<M: RawMutex>(
        &mut self,
        power: Power,
        stop: bool,
        motor: &Telling,
        exchange: &Exchange<M>,
    ) -> Option<Order> {
        let step = match (&mut self.calibration, power) {
            (Some(running), Power::Calibrating) if !stop => running.tick(motor),
            (_, Power::Calibrating) => Err(Outcome::Failed(Failure::Stopped)),
            _ => Err(Outcome::Failed(Failure::NotNow)),
        };
        step.unwrap_or_else(|outcome| {
            self.calibration = None;
            exchange.measured.signal(outcome);
            // Where it never began, the motor is the grasp's.
            (power == Power::Calibrating).then_some(Order::Disarm)
        })
    }
}

fn tick<M: RawMutex>(
    grip: &mut Grip,
    felt: &Felt,
    (asked, is_calibrating): (&Asked, bool),
    exchange: &Exchange<M>,
) -> Outputs {
    let hosts = exchange.hosts.get();
    let is_sound = !exchange.is_active(Fault::TablesUnsound);
    grip.tick(&Inputs {
        estimates: &felt.estimates,
        motor: felt.motor,
        host: hosts.host,
        command: asked.command,
        stop: asked.stop,
        clear: asked.clear,
        faults: exchange.fault_bits_beside(Finder::Grip),
        is_sound: hosts.is_checked.then_some(is_sound),
        is_calibrating: is_calibrating || hosts.is_taring,
        acceleration: felt.acceleration,
    })
}

/// A bus or line that is full loses a status; the next tick tells a newer one.
fn tell<M: RawMutex>(
    outputs: &Outputs,
    is_due: bool,
    counters: &mut Counters,
    exchange: &Exchange<M>,
) {
    let refused = outputs.refused.map(|refused| refused.reply());
    let foot = outputs
        .foot
        .filter(|_| exchange.parameter(Parameters::foot));
    let foot = foot.map(|foot| {
        counters.foot = counters.foot.wrapping_add(1);
        let counter = counters.foot;
        Message::Foot(Foot { counter, ..foot })
    });
    let status = is_due.then(|| {
        counters.status = counters.status.wrapping_add(1) & 0xF;
        let counter = counters.status;
        Message::GripStatus(GripStatus {
            counter,
            ..outputs.status
        })
    });
    let messages = [refused.map(Message::ServiceReply), foot, status];
    for message in messages.into_iter().flatten() {
        let _ = exchange.grasp.try_send(message);
    }
}

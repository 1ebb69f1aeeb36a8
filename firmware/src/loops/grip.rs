//! The grasp in time: with each estimate a millisecond of [`Grip`], and an order for the motor.

use embassy_sync::blocking_mutex::raw::RawMutex;

use super::{Exchange, Finder};
use crate::force::Estimate;
use crate::frame::SENSORS;
use crate::grip::states::Power;
use crate::grip::{Arming, Grip, Host, Inputs, Outputs};
use crate::motor::calibration::{Calibration, Failure, Outcome};
use crate::motor::{Order, Telling};
use crate::parameters::{Parameters, Screw};
use crate::progress::Loop;
use crate::status::Fault;
use crate::wire::messages::{GripStatus, Message};

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
    mut grip: Grip,
    mut reins: R,
    exchange: &Exchange<M>,
) -> ! {
    // An opening that the motor was not told yet.
    let mut opening_mm = None;
    let mut calibration = None;
    let mut ticks = 0_u16;
    loop {
        let felt = exchange.felt.wait().await;
        exchange.progress.check_in(Loop::Grip);
        let parameters = exchange.parameters();
        grip.set_locks(parameters.screw() == Screw::SelfLocking);
        if let Some(measure) = exchange.measure_wanted.try_take() {
            calibration = Some(Calibration::new(measure));
        }
        let stop = exchange.stopped.try_take().is_some();
        let is_busy = [calibration.is_some(), stop];
        let outputs = tick(&mut grip, &felt, is_busy, exchange);
        opening_mm = outputs.opening_mm.or(opening_mm);
        let order = match &mut calibration {
            None => Some(order(&outputs, opening_mm)),
            Some(running) => {
                let step = match (grip.power(), stop) {
                    (Power::Calibrating, false) => running.tick(&felt.motor),
                    (Power::Calibrating, true) => Err(Outcome::Failed(Failure::Stopped)),
                    _ => Err(Outcome::Failed(Failure::NotNow)),
                };
                step.unwrap_or_else(|outcome| {
                    calibration = None;
                    exchange.measured.signal(outcome);
                    // What the grasp asks for in the next tick, if it was no calibration.
                    matches!(grip.power(), Power::Calibrating).then_some(Order::Disarm)
                })
            }
        };
        if let Some(order) = order
            && reins.order(order).is_ok()
            && matches!(order, Order::Opening { .. })
        {
            opening_mm = None;
        }
        ticks = (ticks + 1) % STATUS_TICKS;
        tell(&outputs, &parameters, ticks == 0, exchange);
        exchange.stands.set(Stands {
            state: outputs.state,
            object: outputs.status.object,
            may_arm: outputs.may_arm,
            is_driven: grip.is_driven(),
        });
        exchange.tell(Finder::Grip, grip.fault_bits(), &outputs.events);
    }
}

fn tick<M: RawMutex>(
    grip: &mut Grip,
    felt: &Felt,
    [is_calibrating, stop]: [bool; 2],
    exchange: &Exchange<M>,
) -> Outputs {
    let hosts = exchange.hosts.get();
    let is_sound = !exchange.is_active(Fault::TablesUnsound);
    grip.tick(&Inputs {
        estimates: &felt.estimates,
        motor: felt.motor,
        host: hosts.host,
        command: exchange.commanded.try_take(),
        stop,
        clear: exchange.cleared.try_take().is_some(),
        faults: exchange.fault_bits_beside(Finder::Grip),
        is_sound: hosts.is_checked.then_some(is_sound),
        is_calibrating: is_calibrating || hosts.is_taring,
        acceleration: felt.acceleration,
    })
}

/// One order in a tick: what is left waits for the next, where a set-point is a newer one.
fn order(outputs: &Outputs, opening_mm: Option<f32>) -> Order {
    match (outputs.arming, opening_mm) {
        (Some(Arming::Arm), _) => Order::Arm,
        (Some(Arming::Disarm), _) => Order::Disarm,
        (None, Some(opening_mm)) => Order::Opening { opening_mm },
        (None, None) => Order::Do(outputs.setpoint),
    }
}

/// A bus or line that is full loses a status; the next tick tells a newer one.
fn tell<M: RawMutex>(
    outputs: &Outputs,
    parameters: &Parameters,
    is_due: bool,
    exchange: &Exchange<M>,
) {
    let refused = outputs.refused.map(|refused| refused.reply());
    let foot = outputs.foot.filter(|_| parameters.foot());
    let status = is_due.then_some(outputs.status);
    let messages = [
        refused.map(Message::ServiceReply),
        foot.map(Message::Foot),
        status.map(Message::GripStatus),
    ];
    for message in messages.into_iter().flatten() {
        let _ = exchange.grasp.try_send(message);
    }
}

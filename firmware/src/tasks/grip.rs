//! Runs [`GripController`] once for each estimate, in the task that estimates, and sends its set-point to the motor.

use core::ops::ControlFlow;

use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::estimator::Estimate;
use crate::grip::states::PowerState;
use crate::grip::{ArmingRequest, ControlInputs, ControlOutputs, GripController, SessionStatus};
use crate::motor::calibration::{
    Calibration, CalibrationFailure, CalibrationKind, CalibrationOutcome,
};
use crate::motor::limits::Temperatures;
use crate::motor::state::MotorPort;
use crate::motor::{MotorCommand, MotorState, MotorStatus};
use crate::parameters::{Backdrivability, Parameters};
use crate::protocol::messages::{Command, Foot, GripStatus, Message};
use crate::sensors::hall::SENSORS;
use crate::system::faults::Fault;
use crate::system::task_watchdog::TaskId;
use crate::tasks::{FaultReporter, SharedState};

/// Ticks between two [`GripStatus`] messages.
const STATUS_TICKS: u16 = GripStatus::LAYOUT.period_ms;

/// Inputs of one tick.
#[derive(Clone, Copy, Debug)]
pub struct GripInputs<'e> {
    /// Forces after subtraction of the tare.
    pub estimates: &'e [Estimate; SENSORS],
    /// State of the motor at the time of the estimate.
    pub motor: MotorStatus,
    /// Acceleration of the fingertips ([`ControlInputs::acceleration`]).
    pub acceleration: Option<[i32; 3]>,
}

/// Requests of hosts since the last tick.
#[derive(Clone, Copy, Debug)]
pub struct PendingRequests {
    /// The latest accepted command.
    pub command: Option<Command>,
    /// Emergency stop.
    pub stop: bool,
    /// Clear latched faults.
    pub clear: bool,
    /// Start a calibration.
    pub measure: Option<CalibrationKind>,
}

impl PendingRequests {
    /// No request.
    pub const NONE: Self = Self { command: None, stop: false, clear: false, measure: None };
}

/// State of hosts and of the integrity check.
#[derive(Clone, Copy, Debug)]
pub struct HostStatus {
    /// State of the session.
    pub host: SessionStatus,
    /// Tables and networks have been checked once.
    pub is_checked: bool,
    /// A tare is in progress.
    pub is_taring: bool,
    /// No key is stored ([`crate::protocol::messages::Heartbeat::unprotected`]).
    pub is_unprotected: bool,
}

impl HostStatus {
    /// State at boot.
    pub const NONE: Self = Self {
        host: SessionStatus { is_offered: false, is_open: false, is_alive: false },
        is_checked: false,
        is_taring: false,
        is_unprotected: false,
    };
}

/// State of the grip for other tasks.
#[derive(Clone, Copy, Debug)]
pub struct GripSummary {
    /// State as in the heartbeat.
    pub state: u8,
    /// Object detection as in the heartbeat.
    pub object: u8,
    /// A stop is latched.
    pub is_stopped: bool,
    /// Whether arming is allowed.
    pub may_arm: bool,
    /// The motor is or may be driven, with or without a session: no flash access, tare or reboot.
    pub is_driven: bool,
    /// The fingers should move.
    pub is_moving: bool,
    /// See [`GripController::is_loaded`].
    pub is_loaded: bool,
    /// See [`GripController::may_be_loaded`].
    pub may_be_loaded: bool,
}

impl GripSummary {
    /// State at boot.
    pub const INITIAL: Self = Self {
        state: 0,
        object: 0,
        is_stopped: false,
        may_arm: false,
        is_driven: false,
        is_moving: false,
        is_loaded: false,
        may_be_loaded: false,
    };
}

/// Supply of the power stage.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Supply {
    /// Bus voltage in volts.
    pub bus_v: f32,
    /// Current from the bus in amperes, from the power of the windings; negative while the motor brakes.
    pub current_a: f32,
}

impl Supply {
    /// Before the first measurement.
    pub const UNKNOWN: Self = Self { bus_v: 0.0, current_a: 0.0 };

    fn of(motor: &MotorStatus) -> Self {
        // Amplitude-invariant transform: three halves of the products.
        let watts = 1.5 * (motor.voltage.d * motor.current.d + motor.voltage.q * motor.current.q);
        let is_driven = motor.state == MotorState::Armed && motor.bus_v > 0.0;
        let current_a = if is_driven { watts / motor.bus_v } else { 0.0 };
        Self { bus_v: motor.bus_v, current_a }
    }
}

/// Runs the grip state machine on every estimate; this is its state between two ticks.
#[derive(Default)]
pub struct GripLoop {
    pending: Pending,
    ticks: u16,
    counters: Counters,
}

/// Counters of sent messages: a gap shows the host that it has missed some.
#[derive(Clone, Copy, Debug, Default)]
struct Counters {
    status: u8,
    foot: u8,
}

impl GripLoop {
    /// Runs one tick.
    pub fn step<P: MotorPort, M: RawMutex>(
        &mut self,
        grip: &mut GripController,
        inputs: &GripInputs,
        motor: &mut P,
        shared: &SharedState<M>,
    ) {
        shared.progress.check_in(TaskId::Grip);
        if !grip.is_intact() {
            motor.shut_down();
            return;
        }
        let pending = &mut self.pending;
        grip.set_self_locking(
            shared.parameter(Parameters::backdrivability) == Backdrivability::SelfLocking,
        );
        pending.temperatures = shared.temperatures.get().motor;
        shared.supply.set(Supply::of(&inputs.motor));
        let requests = shared.requests.set(PendingRequests::NONE);
        if let Some(measure) = requests.measure {
            let torque_nm_a = shared.parameter(Parameters::torque_nm_a);
            pending.calibration = Some(Calibration::new(measure, torque_nm_a));
        }
        let is_busy = pending.calibration.is_some();
        let outputs = tick(grip, inputs, (&requests, is_busy), shared);
        let order = if is_busy {
            let order = pending.calibrate(grip, requests.stop, &inputs.motor, shared);
            pending.new_temperatures().filter(|_| !changes_state(order.as_ref())).or(order)
        } else {
            Some(pending.order(&outputs))
        };
        // One in each tick: the motion loop detects by them that the current loop has stopped.
        let order = order.unwrap_or(MotorCommand::Temperatures(pending.temperatures));
        let is_accepted = motor.order(order).is_ok();
        pending.on_sent(&order, is_accepted);
        self.ticks = (self.ticks + 1) % STATUS_TICKS;
        send_messages(&outputs, self.ticks == 0, &mut self.counters, shared);
        shared.grip_summary.set(GripSummary {
            state: outputs.state,
            object: outputs.status.object,
            is_stopped: grip.is_stopped(),
            may_arm: outputs.may_arm,
            is_driven: grip.is_driven(),
            is_moving: grip.is_moving(),
            is_loaded: grip.is_loaded(),
            may_be_loaded: grip.may_be_loaded(),
        });
        shared.publish_faults(FaultReporter::Grip, grip.fault_bits(), &outputs.events);
    }
}

/// Orders that are not sent yet.
#[derive(Default)]
struct Pending {
    /// New value of the opening; NaN: unknown.
    opening_mm: Option<f32>,
    /// The newest temperatures, and those that the motor has.
    temperatures: Temperatures,
    sent_temperatures: Temperatures,
    calibration: Option<Calibration>,
}

impl Pending {
    /// One order in a tick; the others wait for the next, which has a newer set-point.
    fn order(&mut self, outputs: &ControlOutputs) -> MotorCommand {
        self.opening_mm = outputs.opening_mm.or(self.opening_mm);
        match (outputs.arming, self.opening_mm) {
            (Some(ArmingRequest::Arm), _) => MotorCommand::Arm,
            (Some(ArmingRequest::Disarm), _) => MotorCommand::Disarm,
            (None, Some(opening_mm)) => MotorCommand::SetOpening { opening_mm },
            (None, None) => {
                self.new_temperatures().unwrap_or(MotorCommand::Setpoint(outputs.setpoint))
            }
        }
    }

    fn new_temperatures(&self) -> Option<MotorCommand> {
        let is_new = self.temperatures != self.sent_temperatures;
        is_new.then_some(MotorCommand::Temperatures(self.temperatures))
    }

    fn on_sent(&mut self, order: &MotorCommand, is_accepted: bool) {
        match order {
            MotorCommand::SetOpening { .. } if is_accepted => self.opening_mm = None,
            MotorCommand::Temperatures(temperatures) if is_accepted => {
                self.sent_temperatures = *temperatures;
            }
            _ => {}
        }
    }

    /// One tick of a calibration; publishes its result.
    fn calibrate<M: RawMutex>(
        &mut self,
        grip: &mut GripController,
        stop: bool,
        motor: &MotorStatus,
        shared: &SharedState<M>,
    ) -> Option<MotorCommand> {
        let power = grip.power();
        let faults = shared.fault_bits_except(FaultReporter::Grip);
        let step = match (&mut self.calibration, power) {
            (Some(running), PowerState::Calibrating) if !stop => {
                match grip.calibration_failure(running.kind(), motor, faults) {
                    Some(failure) => ControlFlow::Break(CalibrationOutcome::Failed(failure)),
                    None => running.tick(motor),
                }
            }
            (_, power) => {
                let is_stopped = power == PowerState::Calibrating || grip.is_stopped();
                let failure = if is_stopped {
                    CalibrationFailure::Stopped
                } else {
                    CalibrationFailure::NotAllowed
                };
                ControlFlow::Break(CalibrationOutcome::Failed(failure))
            }
        };
        match step {
            ControlFlow::Continue(order) => order,
            ControlFlow::Break(outcome) => {
                self.calibration = None;
                shared.calibration_result.signal(outcome);
                // If it never began, the grip controls the motor.
                (power == PowerState::Calibrating).then_some(MotorCommand::Disarm)
            }
        }
    }
}

/// Whether an order is more than a set-point, which the next millisecond repeats.
const fn changes_state(order: Option<&MotorCommand>) -> bool {
    !matches!(order, None | Some(MotorCommand::Setpoint(_)))
}

fn tick<M: RawMutex>(
    grip: &mut GripController,
    inputs: &GripInputs,
    (requests, is_calibrating): (&PendingRequests, bool),
    shared: &SharedState<M>,
) -> ControlOutputs {
    let hosts = shared.host_status.get();
    let is_sound = !shared.is_active(Fault::TablesUnsound);
    grip.tick(&ControlInputs {
        estimates: inputs.estimates,
        motor: inputs.motor,
        host: hosts.host,
        command: requests.command,
        stop: requests.stop,
        clear: requests.clear,
        faults: shared.fault_bits_except(FaultReporter::Grip),
        is_sound: hosts.is_checked.then_some(is_sound),
        is_calibrating: is_calibrating || hosts.is_taring,
        acceleration: inputs.acceleration,
    })
}

/// Queues messages; a full queue drops a status, and the next tick sends a newer one.
fn send_messages<M: RawMutex>(
    outputs: &ControlOutputs,
    is_due: bool,
    counters: &mut Counters,
    shared: &SharedState<M>,
) {
    let refused = outputs.refused.map(|refused| refused.reply());
    let foot = outputs.foot.filter(|_| shared.parameter(Parameters::ground_contact));
    let foot = foot.map(|foot| {
        counters.foot = counters.foot.wrapping_add(1);
        let counter = counters.foot;
        Message::Foot(Foot { counter, ..foot })
    });
    let status = is_due.then(|| {
        counters.status = counters.status.wrapping_add(1) & 0xF;
        let counter = counters.status;
        Message::GripStatus(GripStatus { counter, ..outputs.status })
    });
    let messages = [refused.map(Message::ServiceReply), foot, status];
    for message in messages.into_iter().flatten() {
        let _ = shared.grip_messages.try_send(message);
    }
}

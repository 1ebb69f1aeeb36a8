//! Serves hosts: arming, commands, services, parameters.

use core::sync::atomic::Ordering;

use embassy_futures::select::{Either4, select4};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_can::Frame;
use embedded_storage_async::nor_flash::NorFlash;

use crate::clock::Clock;
use crate::estimator::tare::TareProgress;
use crate::grip::SessionStatus;
use crate::motor::calibration::{CalibrationKind, CalibrationOutcome};
use crate::parameters;
use crate::protocol::messages::{Message, Service, ServiceReply, Version};
use crate::protocol::session::{self, Session, SessionEvent, op, service_reply, status};
use crate::system::faults::{Fault, FaultSet};
use crate::system::nv_storage::{LoadedParameters, ParameterOrigin, ParameterStore};
use crate::system::task_watchdog::TaskId;
use crate::tasks::calibration::CalibrationService;
use crate::tasks::{FaultReporter, GripSummary, HostStatus, SharedState};

/// Interval at which the time-out of hosts is checked.
const CHECK_US: u64 = 1000;

/// Loads the stored parameters, before any task starts.
pub async fn load_parameters<F: NorFlash, M: RawMutex>(
    store: &mut ParameterStore<F>,
    shared: &SharedState<M>,
) -> LoadedParameters {
    let loaded = store.load().await;
    shared.set_parameters(loaded.parameters);
    loaded
}

/// Sources of [`Fault::StoreUnsound`].
const PARAMETERS: u8 = 0;
const CALIBRATION: u8 = 1;
const CONFIGURATION: u8 = 2;

/// Resources of the task.
pub struct HostService<F, R, B> {
    /// Versions of protocol, firmware and tables.
    pub version: Version,
    /// Store of the parameters.
    pub store: ParameterStore<F>,
    /// Result of [`load_parameters`].
    pub loaded: LoadedParameters,
    /// Calibrations in the same flash.
    pub calibration: CalibrationService,
    /// See [`crate::board::Peripherals::configuration_defect`].
    pub configuration_defect: Option<u32>,
    /// A fresh random number at every call, for nonces.
    pub random: R,
    /// Resets the chip.
    pub reboot: B,
}

/// Serves hosts.
pub async fn host_service<F: NorFlash, R: FnMut() -> u16, B: FnMut(), C: Clock, M: RawMutex>(
    mut service: HostService<F, R, B>,
    clock: &C,
    shared: &SharedState<M>,
) -> ! {
    let parameters = shared.parameters();
    let mut session = Session::new(parameters.node(), parameters.command_timeout_ms());
    let mut faults = FaultSet::default();
    let loaded = service.loaded;
    if !loaded.is_settled {
        // On failure the loaded values stay in use, and the next save tries again.
        let _ = service.store.save(&loaded.parameters).await;
    }
    let is_sound = matches!(
        loaded.origin,
        ParameterOrigin::Stored | ParameterOrigin::Older | ParameterOrigin::Empty
    );
    shared.update_fault(
        FaultReporter::HostService,
        &mut faults,
        (Fault::StoreUnsound, PARAMETERS),
        !is_sound,
        loaded.origin.code(),
    );
    let defect = service.calibration.defect;
    shared.update_fault(
        FaultReporter::HostService,
        &mut faults,
        (Fault::StoreUnsound, CALIBRATION),
        defect.is_some(),
        defect.map_or(0, |defect| defect as u32),
    );
    let defect = service.configuration_defect;
    shared.update_fault(
        FaultReporter::HostService,
        &mut faults,
        (Fault::StoreUnsound, CONFIGURATION),
        defect.is_some(),
        defect.unwrap_or_default(),
    );
    // No frame is processed, and so no host can arm, before the tables have been checked.
    shared.tables_checked.wait().await;
    let mut check_us = clock.now_us();
    let mut pending = None;
    loop {
        let next = select4(
            shared.rx_frames.receive(),
            shared.tare_result.wait(),
            shared.calibration_result.wait(),
            clock.until(check_us),
        );
        let next = next.await;
        shared.progress.check_in(TaskId::HostService);
        let now_ms = (clock.now_us() / 1000) as u32;
        let grip = shared.grip_summary.get();
        session.set_may_arm(grip.may_arm);
        let reply = match next {
            Either4::First(received) => {
                let frame = received.frame;
                let random = (service.random)();
                let event = session.receive(now_ms, frame.identifier(), frame.data(), random);
                publish_host_status(&session, &pending, now_ms, shared);
                let is_armed = session.is_open() || grip.is_driven;
                let is_calibrating = pending.is_some();
                match event {
                    SessionEvent::Reply { reply, .. } => Some(Message::ServiceReply(reply)),
                    // What is gripped would become the zero of the forces, or be dropped.
                    SessionEvent::Other(Message::Service(request))
                        if !is_armed && is_prevented_by_load(request, &grip) =>
                    {
                        let reply = service_reply(request, status::GRIPPING, 0);
                        Some(Message::ServiceReply(reply))
                    }
                    SessionEvent::Other(Message::Service(request))
                        if !is_armed && starts_long_service(request, &mut pending, shared) =>
                    {
                        None
                    }
                    SessionEvent::Other(Message::Service(request)) => {
                        let is_busy = is_armed || is_calibrating;
                        Some(service.handle_request(request, is_busy, shared).await)
                    }
                    SessionEvent::Other(Message::ParamRequest(request))
                        if let Some(count) = shared.counts.counter(request.id) =>
                    {
                        let reply = parameters::handle_counter_request(count, &request);
                        Some(Message::ParamReply(reply))
                    }
                    SessionEvent::Other(Message::ParamRequest(request)) => {
                        let mut parameters = shared.parameters();
                        let is_busy = is_armed || is_calibrating;
                        let reply = parameters::handle_request(&mut parameters, &request, is_busy);
                        shared.set_parameters(parameters);
                        session.set_timeout_ms(parameters.command_timeout_ms());
                        Some(Message::ParamReply(reply))
                    }
                    SessionEvent::Command(command) => {
                        shared.requests.modify(|requests| requests.command = Some(command));
                        None
                    }
                    SessionEvent::Stop => {
                        shared.requests.modify(|requests| requests.stop = true);
                        None
                    }
                    SessionEvent::Other(Message::CalibrationChunk(chunk)) => {
                        let HostService { store, calibration, .. } = &mut service;
                        let reply = calibration
                            .receive(store.flash(), &chunk, is_armed || is_calibrating)
                            .await;
                        reply.map(Message::ServiceReply)
                    }
                    SessionEvent::Other(message) => {
                        shared.host_motion.modify(|motion| {
                            motion.update(&message, clock.now_us());
                        });
                        None
                    }
                    SessionEvent::Ignored => None,
                }
            }
            Either4::Second(step) => pending
                .take()
                .map(|request| Message::ServiceReply(finish_tare(request, step, shared))),
            Either4::Third(outcome) => pending.take().map(|request| {
                Message::ServiceReply(finish_calibration(request, &outcome, shared))
            }),
            Either4::Fourth(()) => {
                check_us = clock.now_us().saturating_add(CHECK_US);
                None
            }
        };
        if let Some(reply) = reply {
            // A full queue drops the reply; the host repeats its request.
            let _ = shared.replies.try_send(reply);
        }
        publish_host_status(&session, &pending, now_ms, shared);
        update_faults(&session, &mut faults, now_ms, shared);
    }
}

/// Whether a load forbids a service; that the fingers seem loaded only forbids a tare that does not confirm the contrary.
const fn is_prevented_by_load(request: Service, grip: &GripSummary) -> bool {
    match request.op {
        op::TARE => grip.is_loaded || (grip.may_be_loaded && request.argument != session::UNLOADED),
        op::MEASURE => grip.is_loaded,
        _ => false,
    }
}

/// Starts a tare or a calibration; false if the request is another service or one is in progress.
fn starts_long_service<M: RawMutex>(
    request: Service,
    pending: &mut Option<Service>,
    shared: &SharedState<M>,
) -> bool {
    if pending.is_some() {
        return false;
    }
    match (request.op, CalibrationKind::of(request.argument)) {
        (op::TARE, _) => shared.tare_request.signal(()),
        (op::MEASURE, Some(measure)) => {
            shared.requests.modify(|requests| requests.measure = Some(measure))
        }
        _ => return false,
    }
    *pending = Some(request);
    true
}

impl<F: NorFlash, R, B: FnMut()> HostService<F, R, B> {
    /// Executes a service that completes at once. `is_armed`: a session is open, the motor is driven, or a tare or a
    /// calibration is in progress.
    async fn handle_request<M: RawMutex>(
        &mut self,
        request: Service,
        is_armed: bool,
        shared: &SharedState<M>,
    ) -> Message {
        let reply = |status| Message::ServiceReply(service_reply(request, status, 0));
        match request.op {
            op::VERSION => Message::Version(self.version),
            // The next heartbeat shows whether the cause is gone.
            op::CLEAR_FAULTS => {
                shared.requests.modify(|requests| requests.clear = true);
                reply(status::DONE)
            }
            op::TARE | op::SAVE | op::REBOOT | op::MEASURE if is_armed => reply(status::ARMED),
            // Another one is in progress, or the argument is invalid.
            op::TARE | op::MEASURE => reply(status::FAILED),
            op::SAVE => match self.store.save(&shared.parameters()).await {
                Ok(()) => reply(status::DONE),
                Err(_) => reply(status::FAILED),
            },
            op::REBOOT => {
                (self.reboot)();
                reply(status::DONE)
            }
            op::UPLOAD | op::FINISH_UPLOAD | op::DESCRIPTION => {
                let Self { store, calibration, .. } = self;
                let reply = calibration.handle_request(store.flash(), request, is_armed).await;
                Message::ServiceReply(reply)
            }
            _ => reply(status::UNKNOWN),
        }
    }
}

/// Applies the result of a tare, and returns the reply.
fn finish_tare<M: RawMutex>(
    request: Service,
    step: TareProgress,
    shared: &SharedState<M>,
) -> ServiceReply {
    match step {
        TareProgress::Done(tare) => {
            let mut parameters = shared.parameters();
            parameters.set_tare(&tare);
            shared.set_parameters(parameters);
            service_reply(request, status::DONE, 0)
        }
        TareProgress::Refused(refusal) => service_reply(request, status::FAILED, refusal.detail()),
        TareProgress::Collecting => service_reply(request, status::FAILED, 0),
    }
}

/// Applies the result of a calibration, and returns the reply.
fn finish_calibration<M: RawMutex>(
    request: Service,
    outcome: &CalibrationOutcome,
    shared: &SharedState<M>,
) -> ServiceReply {
    let mut parameters = shared.parameters();
    parameters.set_measured(outcome);
    shared.set_parameters(parameters);
    match outcome {
        CalibrationOutcome::Failed(failure) => {
            service_reply(request, status::FAILED, *failure as u32)
        }
        CalibrationOutcome::Motor(_) => service_reply(request, status::DONE, 0),
        CalibrationOutcome::Screw { locks } => {
            service_reply(request, status::DONE, u32::from(*locks))
        }
    }
}

#[inline(never)]
fn publish_host_status<M: RawMutex>(
    session: &Session,
    pending: &Option<Service>,
    now_ms: u32,
    shared: &SharedState<M>,
) {
    shared.host_status.set(HostStatus {
        host: SessionStatus {
            is_offered: session.is_challenge_pending(now_ms),
            is_open: session.is_open(),
            is_alive: session.is_alive(now_ms),
        },
        is_checked: true,
        is_taring: pending.is_some_and(|request| request.op == op::TARE),
    });
}

fn update_faults<M: RawMutex>(
    session: &Session,
    faults: &mut FaultSet,
    now_ms: u32,
    shared: &SharedState<M>,
) {
    let counts = &shared.counts;
    let alive = u32::from(session.is_alive(now_ms));
    counts.command_alive.store(alive, Ordering::Relaxed);
    let dropped = session.dropped().all();
    counts.dropped.store(dropped, Ordering::Relaxed);
    for (fault, active, detail) in [
        (Fault::HostSilent, session.is_silent(now_ms), 0),
        (Fault::StrangeFrames, session.is_flooded(now_ms), dropped),
    ] {
        shared.update_fault(FaultReporter::HostService, faults, (fault, 0), active, detail);
    }
}

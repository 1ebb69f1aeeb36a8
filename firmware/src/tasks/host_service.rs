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
use crate::protocol::authentication::{KEY_BYTES, Key};
use crate::protocol::messages::{KeyPart, Message, Service, ServiceReply, Version};
use crate::protocol::rules::{RequestKind, Situation};
use crate::protocol::session::{Session, SessionEvent, op, refusal, service_reply, status};
use crate::system::faults::{Fault, FaultSet};
use crate::system::nv_storage::{LoadedParameters, ParameterOrigin, ParameterStore};
use crate::system::task_watchdog::TaskId;
use crate::tasks::calibration::CalibrationService;
use crate::tasks::{FaultReporter, HostStatus, RxFrame, SharedState};

/// Loads the stored parameters, before any task starts.
pub async fn load_parameters<F: NorFlash, M: RawMutex>(
    store: &mut ParameterStore<F>,
    shared: &SharedState<M>,
) -> LoadedParameters {
    let loaded = store.load().await;
    shared.set_parameters(loaded.parameters);
    loaded
}

/// Parts of a key.
const KEY_PARTS: usize = KEY_BYTES / size_of::<u32>();
/// Sources of [`Fault::StoreUnsound`].
const PARAMETERS: u8 = 0;
const CALIBRATION: u8 = 1;
const CONFIGURATION: u8 = 2;

/// Resources of the task.
pub struct HostService<F, R, P, B> {
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
    /// A fresh random number at every call, for challenges; none if the source fails.
    pub random: R,
    /// Whether the button is pressed, which allows to write the key, and accepts a doubtful one.
    pub is_pressed: P,
    /// Resets the chip.
    pub reboot: B,
}

/// Serves hosts.
///
/// While the stored key is [doubtful](ParameterOrigin::is_doubtful) no host can arm, tare, measure, upload, change or save
/// anything: a person accepts the loaded values by the button, or stores a key. Until then the store is not written.
pub async fn host_service<F, R, P, B, C, M>(
    mut service: HostService<F, R, P, B>,
    clock: &C,
    shared: &SharedState<M>,
) -> !
where
    F: NorFlash,
    R: FnMut() -> Option<u64>,
    P: FnMut() -> bool,
    B: FnMut(),
    C: Clock,
    M: RawMutex,
{
    let parameters = shared.parameters();
    let loaded = service.loaded;
    let mut session = Session::new(parameters.node(), loaded.key, parameters.command_timeout_ms());
    let mut key_parts = [None; KEY_PARTS];
    let mut faults = FaultSet::default();
    if !loaded.is_settled {
        // On failure the loaded values stay in use, and the next save tries again.
        let _ = service.store.save(&loaded.parameters).await;
    }
    report_origin(service.loaded.origin, &mut faults, shared);
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
        let now_ms = clock.now_us() / 1000;
        let grip = shared.grip_summary.get();
        let is_pressed = (service.is_pressed)();
        if is_pressed && service.loaded.origin.is_doubtful() {
            service.accept_loaded(shared).await;
        }
        let is_doubtful = service.loaded.origin.is_doubtful();
        session.set_may_arm(grip.may_arm && !is_doubtful);
        session.set_is_moving(grip.is_moving);
        // A gripper without a key takes the first one, unless it may have lost one.
        session.set_is_present((session.key() == Key::NONE && !is_doubtful) || is_pressed);
        session.expire(now_ms);
        let reply = match next {
            Either4::First(received) => {
                let RxFrame { source, frame } = received;
                let frame = (frame.identifier(), frame.data());
                let event = session.receive(now_ms, source, frame, &mut service.random);
                publish_host_status(&session, &pending, now_ms, shared);
                match event {
                    SessionEvent::Ignored => None,
                    SessionEvent::Reply(reply) => Some(reply),
                    SessionEvent::Stop => {
                        shared.requests.modify(|requests| requests.stop = true);
                        None
                    }
                    SessionEvent::Command(command) => {
                        shared.requests.modify(|requests| requests.command = Some(command));
                        None
                    }
                    SessionEvent::Other(request) => {
                        let situation = Situation {
                            is_armed: session.is_armed() || grip.is_driven,
                            is_calibrating: pending.is_some(),
                            is_loaded: grip.is_loaded,
                            may_be_loaded: grip.may_be_loaded,
                            is_doubtful,
                        };
                        let rule = RequestKind::of(&request).map(RequestKind::rule);
                        match rule.and_then(|rule| rule.refusal(&request, &situation)) {
                            Some(status) => refusal(&request, status),
                            None => {
                                let state = (&mut session, &mut pending, &mut key_parts);
                                service.handle_request(request, state, clock.now_us(), shared).await
                            }
                        }
                    }
                }
            }
            Either4::Second(step) => pending
                .take()
                .map(|request| Message::ServiceReply(finish_tare(request, step, shared))),
            Either4::Third(outcome) => pending.take().map(|request| {
                Message::ServiceReply(finish_calibration(request, &outcome, shared))
            }),
            Either4::Fourth(()) => {
                // One alarm with the tick of the sensors.
                check_us = shared.next_tick_us(clock.now_us());
                None
            }
        };
        if let Some(reply) = reply {
            // A full queue drops the reply; the host repeats its request.
            let _ = shared.replies.try_send(reply);
        }
        shared.due_counters.set(session.due_counters());
        publish_host_status(&session, &pending, now_ms, shared);
        update_faults(&session, &mut faults, now_ms, shared);
        report_origin(service.loaded.origin, &mut faults, shared);
    }
}

/// Starts a tare or a calibration; false if the request is another service.
fn starts_long_service<M: RawMutex>(
    request: Service,
    pending: &mut Option<Service>,
    shared: &SharedState<M>,
) -> bool {
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

impl<F: NorFlash, R, P, B: FnMut()> HostService<F, R, P, B> {
    /// Carries out a request that has the authority it needs and is allowed in the present situation; returns the reply, if
    /// any.
    async fn handle_request<M: RawMutex>(
        &mut self,
        request: Message,
        (session, pending, key_parts): (
            &mut Session,
            &mut Option<Service>,
            &mut [Option<u32>; KEY_PARTS],
        ),
        now_us: u64,
        shared: &SharedState<M>,
    ) -> Option<Message> {
        let Self { store, calibration, .. } = self;
        match request {
            Message::Service(request) if starts_long_service(request, pending, shared) => None,
            Message::Service(Service { op: op::WRITE_KEY, argument }) => {
                let key = assemble(key_parts, argument);
                *key_parts = [None; KEY_PARTS];
                Some(self.write_key(op::WRITE_KEY, key, session).await)
            }
            Message::Service(Service { op: op::ERASE_KEY, .. }) => {
                Some(self.write_key(op::ERASE_KEY, Some(Key::NONE), session).await)
            }
            Message::Service(request) => Some(self.handle_service(request, session, shared).await),
            Message::KeyPart(KeyPart { number, part }) => {
                if let Some(place) = key_parts.get_mut(usize::from(number)) {
                    *place = Some(part);
                }
                None
            }
            Message::ParamRequest(request) => {
                if let Some(count) = shared.counts.counter(request.id) {
                    let reply = parameters::handle_counter_request(count, &request);
                    return Some(Message::ParamReply(reply));
                }
                let mut parameters = shared.parameters();
                let reply = parameters::handle_request(&mut parameters, &request);
                shared.set_parameters(parameters);
                session.set_timeout_ms(parameters.command_timeout_ms());
                Some(Message::ParamReply(reply))
            }
            Message::CalibrationChunk(chunk) => {
                let reply = calibration.receive(store.flash(), &chunk).await;
                reply.map(Message::ServiceReply)
            }
            message => {
                shared.host_motion.modify(|motion| {
                    motion.update(&message, now_us);
                });
                None
            }
        }
    }

    /// Carries out a service that completes at once.
    async fn handle_service<M: RawMutex>(
        &mut self,
        request: Service,
        session: &Session,
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
            // The argument is invalid.
            op::TARE | op::MEASURE => reply(status::FAILED),
            op::SAVE => match self.store.save(&shared.parameters()).await {
                Ok(()) => {
                    self.loaded.origin = ParameterOrigin::Stored;
                    reply(status::DONE)
                }
                Err(_) => reply(status::FAILED),
            },
            op::REBOOT => {
                (self.reboot)();
                reply(status::DONE)
            }
            op::UPLOAD | op::FINISH_UPLOAD | op::DESCRIPTION => {
                let Self { store, calibration, .. } = self;
                let reply = calibration.handle_request(store.flash(), request, session.mac()).await;
                Message::ServiceReply(reply)
            }
            _ => reply(status::UNKNOWN),
        }
    }

    /// A person accepts the values in use: they are stored.
    async fn accept_loaded<M: RawMutex>(&mut self, shared: &SharedState<M>) {
        if self.store.save(&shared.parameters()).await.is_ok() {
            self.loaded.origin = ParameterOrigin::Stored;
        }
    }

    /// Stores a key, which is valid at once. None: the parts are incomplete or not those of the host. The present one is
    /// stored already: requests that need no key do not wear the flash.
    async fn write_key(&mut self, op: u8, key: Option<Key>, session: &mut Session) -> Message {
        let request = Service { op, argument: 0 };
        let status = match key {
            Some(key) if key == session.key() && !self.loaded.origin.is_doubtful() => status::DONE,
            Some(key) if self.store.save_key(key).await.is_ok() => {
                self.loaded.origin = ParameterOrigin::Stored;
                session.set_key(key);
                status::DONE
            }
            _ => status::FAILED,
        };
        Message::ServiceReply(service_reply(request, status, 0))
    }
}

/// The key of these parts, if its check value is that of the host.
fn assemble(parts: &[Option<u32>; KEY_PARTS], check: u32) -> Option<Key> {
    let mut key = Key::NONE;
    let (places, _) = key.0.as_chunks_mut::<4>();
    for (place, part) in places.iter_mut().zip(parts) {
        *place = (*part)?.to_le_bytes();
    }
    (key != Key::NONE && key.check_number() == check).then_some(key)
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
    now_ms: u64,
    shared: &SharedState<M>,
) {
    shared.host_status.set(HostStatus {
        host: SessionStatus {
            is_offered: session.is_arming(now_ms),
            is_open: session.is_armed(),
            is_alive: session.is_alive(now_ms),
        },
        is_checked: true,
        is_taring: pending.is_some_and(|request| request.op == op::TARE),
        is_unprotected: session.key() == Key::NONE,
    });
}

fn report_origin<M: RawMutex>(
    origin: ParameterOrigin,
    faults: &mut FaultSet,
    shared: &SharedState<M>,
) {
    let is_unsound = origin.is_doubtful() || origin == ParameterOrigin::Newer;
    let fault = (Fault::StoreUnsound, PARAMETERS);
    shared.update_fault(FaultReporter::HostService, faults, fault, is_unsound, origin.code());
}

fn update_faults<M: RawMutex>(
    session: &Session,
    faults: &mut FaultSet,
    now_ms: u64,
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

//! Answers hosts: arming, commands, services, parameters.

use core::sync::atomic::Ordering;

use embassy_futures::select::{Either4, select4};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_can::Frame;
use embedded_storage_async::nor_flash::NorFlash;

use super::{Exchange, Finder, Hosts};
use crate::clock::Clock;
use crate::grip::Host;
use crate::motor::calibration::{Measure, Outcome};
use crate::parameters;
use crate::progress::Loop;
use crate::session::{Heard as Meant, Session, answer, op, status};
use crate::status::{Fault, Faults};
use crate::store::{Loaded, Origin, Store};
use crate::tare::Step;
use crate::wire::messages::{Message, Service, ServiceReply, Version};

/// How often a host's silence is looked for.
const LOOK_US: u64 = 1000;

/// Brings the stored parameters to the loops, before any of them begins.
pub async fn begin<F: NorFlash, M: RawMutex>(
    store: &mut Store<F>,
    exchange: &Exchange<M>,
) -> Loaded {
    let loaded = store.load().await;
    exchange.set_parameters(loaded.parameters);
    loaded
}

/// What the loop needs of the board.
pub struct Desk<F, R, B> {
    /// What runs here.
    pub version: Version,
    /// Where parameters are kept.
    pub store: Store<F>,
    /// What was there ([`begin`]).
    pub loaded: Loaded,
    /// A new number with every call: nonces are made of it.
    pub random: R,
    /// Restarts.
    pub reboot: B,
}

/// Hears hosts and answers them, for ever.
pub async fn command<F: NorFlash, R: FnMut() -> u16, B: FnMut(), C: Clock, M: RawMutex>(
    mut desk: Desk<F, R, B>,
    clock: &C,
    exchange: &Exchange<M>,
) -> ! {
    let parameters = exchange.parameters();
    let mut session = Session::new(parameters.node(), parameters.command_timeout_ms());
    let mut faults = Faults::default();
    let loaded = desk.loaded;
    if !loaded.is_settled {
        // Where it fails, what was read still holds, and the next save tries again.
        let _ = desk.store.save(&loaded.parameters).await;
    }
    let stored = matches!(
        loaded.origin,
        Origin::Stored | Origin::Older | Origin::Empty
    );
    let unsound = (Fault::StoreUnsound, 0);
    exchange.note(
        Finder::Command,
        &mut faults,
        unsound,
        !stored,
        loaded.origin.code(),
    );
    // Nobody is heard, and so nobody arms, before the tables have been looked at.
    exchange.checked.wait().await;
    let mut look_us = clock.now_us();
    let mut waiting = None;
    loop {
        let next = select4(
            exchange.heard.receive(),
            exchange.tare_ended.wait(),
            exchange.measured.wait(),
            clock.until(look_us),
        );
        let next = next.await;
        exchange.progress.check_in(Loop::Command);
        let now_ms = (clock.now_us() / 1000) as u32;
        let stands = exchange.stands.get();
        session.allow(stands.may_arm);
        let reply = match next {
            Either4::First(heard) => {
                let frame = heard.frame;
                let random = (desk.random)();
                let meant = session.hear(now_ms, frame.identifier(), frame.data(), random);
                show(&session, &waiting, now_ms, exchange);
                let is_armed = session.is_open() || stands.is_driven;
                match meant {
                    Meant::Reply { reply, .. } => Some(Message::ServiceReply(reply)),
                    Meant::Other(Message::Service(service))
                        if !is_armed && begins(service, &mut waiting, exchange) =>
                    {
                        None
                    }
                    Meant::Other(Message::Service(service)) => {
                        Some(desk.serve(service, is_armed, exchange).await)
                    }
                    Meant::Other(Message::ParamRequest(request))
                        if let Some(count) = exchange.counts.counter(request.id) =>
                    {
                        let reply = parameters::answer_counter(count, &request);
                        Some(Message::ParamReply(reply))
                    }
                    Meant::Other(Message::ParamRequest(request)) => {
                        let mut parameters = exchange.parameters();
                        let reply = parameters::answer(&mut parameters, &request, is_armed);
                        exchange.set_parameters(parameters);
                        session.set_silent_ms(parameters.command_timeout_ms());
                        Some(Message::ParamReply(reply))
                    }
                    Meant::Command(command) => {
                        exchange.asked.change(|asked| asked.command = Some(command));
                        None
                    }
                    Meant::Stop => {
                        exchange.asked.change(|asked| asked.stop = true);
                        None
                    }
                    Meant::Nothing | Meant::Other(_) => None,
                }
            }
            Either4::Second(step) => {
                let service = waiting.take();
                service.map(|service| Message::ServiceReply(tared(service, step, exchange)))
            }
            Either4::Third(outcome) => {
                let service = waiting.take();
                service.map(|service| Message::ServiceReply(measured(service, &outcome, exchange)))
            }
            Either4::Fourth(()) => {
                look_us = clock.now_us().saturating_add(LOOK_US);
                None
            }
        };
        if let Some(reply) = reply {
            // A host that asks faster than the bus can answer asks again.
            let _ = exchange.replies.try_send(reply);
        }
        show(&session, &waiting, now_ms, exchange);
        judge(&session, &mut faults, now_ms, exchange);
    }
}

/// Begins a service that takes its time; whether it is one, and none is under way.
fn begins<M: RawMutex>(
    service: Service,
    waiting: &mut Option<Service>,
    exchange: &Exchange<M>,
) -> bool {
    if waiting.is_some() {
        return false;
    }
    match (service.op, Measure::of(service.argument)) {
        (op::TARE, _) => exchange.tare_wanted.signal(()),
        (op::MEASURE, Some(measure)) => {
            exchange.asked.change(|asked| asked.measure = Some(measure))
        }
        _ => return false,
    }
    *waiting = Some(service);
    true
}

impl<F: NorFlash, R, B: FnMut()> Desk<F, R, B> {
    /// Does a service that takes no time of sensing. `is_armed`: a session is open, or the motor is driven.
    async fn serve<M: RawMutex>(
        &mut self,
        service: Service,
        is_armed: bool,
        exchange: &Exchange<M>,
    ) -> Message {
        let reply = |status| Message::ServiceReply(answer(service, status, 0));
        match service.op {
            op::VERSION => Message::Version(self.version),
            // Whether the cause is gone the next heartbeat tells.
            op::CLEAR_FAULTS => {
                exchange.asked.change(|asked| asked.clear = true);
                reply(status::DONE)
            }
            op::TARE | op::SAVE | op::REBOOT | op::MEASURE if is_armed => reply(status::ARMED),
            // Another one is under way, or the argument means nothing.
            op::TARE | op::MEASURE => reply(status::FAILED),
            op::SAVE => match self.store.save(&exchange.parameters()).await {
                Ok(()) => reply(status::DONE),
                Err(_) => reply(status::FAILED),
            },
            op::REBOOT => {
                (self.reboot)();
                reply(status::DONE)
            }
            _ => reply(status::UNKNOWN),
        }
    }
}

/// Takes a tare that has ended, or says why there is none.
fn tared<M: RawMutex>(service: Service, step: Step, exchange: &Exchange<M>) -> ServiceReply {
    match step {
        Step::Done(tare) => {
            let mut parameters = exchange.parameters();
            parameters.set_tare(&tare);
            exchange.set_parameters(parameters);
            answer(service, status::DONE, 0)
        }
        Step::Refused(refusal) => answer(service, status::FAILED, refusal.detail()),
        Step::Gathering => answer(service, status::FAILED, 0),
    }
}

/// Takes what was measured, or says why nothing was.
fn measured<M: RawMutex>(
    service: Service,
    outcome: &Outcome,
    exchange: &Exchange<M>,
) -> ServiceReply {
    let mut parameters = exchange.parameters();
    parameters.set_measured(outcome);
    exchange.set_parameters(parameters);
    match outcome {
        Outcome::Failed(failure) => answer(service, status::FAILED, *failure as u32),
        Outcome::Motor(_) => answer(service, status::DONE, 0),
        Outcome::Screw { locks } => answer(service, status::DONE, u32::from(*locks)),
    }
}

/// Shows the grasp what is known of hosts.
#[inline(never)]
fn show<M: RawMutex>(
    session: &Session,
    waiting: &Option<Service>,
    now_ms: u32,
    exchange: &Exchange<M>,
) {
    exchange.hosts.set(Hosts {
        host: Host {
            is_offered: session.is_offered(now_ms),
            is_open: session.is_open(),
            is_alive: session.is_alive(now_ms),
        },
        is_checked: true,
        is_taring: waiting.is_some_and(|service| service.op == op::TARE),
    });
}

/// Notes what the session says of hosts.
fn judge<M: RawMutex>(session: &Session, faults: &mut Faults, now_ms: u32, exchange: &Exchange<M>) {
    let counts = &exchange.counts;
    let alive = u32::from(session.is_alive(now_ms));
    counts.command_alive.store(alive, Ordering::Relaxed);
    let dropped = session.dropped().all();
    counts.dropped.store(dropped, Ordering::Relaxed);
    for (fault, active, detail) in [
        (Fault::HostSilent, session.is_silent(now_ms), 0),
        (Fault::StrangeFrames, session.is_flooded(now_ms), dropped),
    ] {
        exchange.note(Finder::Command, faults, (fault, 0), active, detail);
    }
}

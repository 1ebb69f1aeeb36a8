//! A simulated CAN bus: frames take their time, the lowest identifier goes first. The emulated chip's controller is at one
//! end of it, or the firmware's loops in virtual time by a [`Controller`] of their own.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::{Poll, Waker};

use embedded_can::{Frame as _, StandardId};
use firmware::clock::Clock;
use firmware::wire::can::{CanError, CanFrame, CanReceiver, CanSender};
use firmware::wire::{DEFAULT_NODE, STOP_ALL};
use sim_board::Time;
use sim_board::devices::{self, CanBus as _, CanEvent, Transmission};

use super::time::VirtualClock;

/// A bit at 1 Mbit/s.
const BIT: Time = Time::from_us(1);

/// Bits of a frame with so many bytes, with as many stuffed ones as can be: an end of the frame and a pause of 13 that
/// are not stuffed, 34 around the data that are.
const fn frame_bits(bytes: u64) -> u64 {
    let stuffed = 34 + 8 * bytes;
    13 + stuffed + (stuffed - 1) / 4
}

/// A frame under way.
#[derive(Clone, Copy, Debug)]
struct Passage {
    frame: devices::CanFrame,
    /// The board's.
    is_own: bool,
    ends: Time,
}

/// The bus.
#[derive(Default)]
pub struct CanBus {
    /// The frame that the board's controller would send next.
    offered: Option<devices::CanFrame>,
    /// Frames of other nodes that wait.
    others: VecDeque<devices::CanFrame>,
    passage: Option<Passage>,
    events: VecDeque<CanEvent>,
    /// Every bit that the board sends is disturbed.
    pub disturbed: bool,
    /// Nobody else is on the bus.
    pub alone: bool,
    /// What the board sent, and when it was over, in microseconds.
    pub heard: Vec<(u64, CanFrame)>,
    waker: Option<Waker>,
}

impl CanBus {
    /// A frame of another node.
    pub fn put(&mut self, frame: CanFrame) {
        self.put_any(devices::CanFrame::standard(
            frame.identifier(),
            frame.data(),
        ));
    }

    /// A frame of another node, of any kind.
    pub fn put_any(&mut self, frame: devices::CanFrame) {
        self.others.push_back(frame);
        self.wake();
    }

    fn wake(&mut self) {
        if let Some(waker) = self.waker.take() {
            waker.wake();
        }
    }

    /// Frames of other nodes that wait.
    pub fn waiting(&self) -> usize {
        self.others.len()
    }

    /// Lets a frame begin where the bus is idle.
    fn begin(&mut self, time: Time) {
        if self.passage.is_some() {
            return;
        }
        let other = self.others.front().copied();
        let (frame, is_own) = match (self.offered, other) {
            (Some(own), Some(other)) if own.priority() > other.priority() => (other, false),
            (Some(own), _) => (own, true),
            (None, Some(other)) => (other, false),
            (None, None) => return,
        };
        if !is_own {
            self.others.pop_front();
        }
        let bits = frame_bits(frame.length.into());
        let ends = time + Time::from_ps(BIT.ps() * bits);
        self.passage = Some(Passage {
            frame,
            is_own,
            ends,
        });
    }

    /// Ends the frame under way.
    fn end(&mut self, passage: Passage) {
        if !passage.is_own {
            self.events.push_back(CanEvent::Received(passage.frame));
            return;
        }
        let outcome = match (self.disturbed, self.alone) {
            (true, _) => Transmission::BitError,
            (false, true) => Transmission::NotAcknowledged,
            (false, false) => Transmission::Acknowledged,
        };
        if outcome == Transmission::Acknowledged
            && let Some(frame) = of_board(&passage.frame)
        {
            self.heard.push((passage.ends.us(), frame));
        }
        // The controller offers it again where it has not passed.
        self.offered = None;
        self.events
            .push_back(CanEvent::Sent(passage.frame, outcome));
    }
}

/// A frame as the firmware has them: standard, with data.
fn of_board(frame: &devices::CanFrame) -> Option<CanFrame> {
    let id = StandardId::new(u16::try_from(frame.id).ok()?).filter(|_| !frame.is_extended)?;
    CanFrame::new(id, frame.bytes())
}

impl devices::CanBus for CanBus {
    fn offer(&mut self, time: Time, frame: Option<devices::CanFrame>) {
        self.offered = frame;
        if frame.is_some() {
            self.begin(time);
        }
    }

    fn is_sending(&self) -> bool {
        self.passage.as_ref().is_some_and(|passage| passage.is_own)
    }

    fn next_event(&self) -> Time {
        match &self.passage {
            _ if !self.events.is_empty() => Time::ZERO,
            Some(passage) => passage.ends,
            None if self.others.is_empty() => Time::NEVER,
            // It begins with the next call.
            None => Time::ZERO,
        }
    }

    fn take_event(&mut self, time: Time) -> Option<CanEvent> {
        if let Some(passage) = self.passage.take_if(|passage| passage.ends <= time) {
            self.end(passage);
        }
        let event = self.events.pop_front();
        if event.is_none() {
            self.begin(time);
        }
        event
    }

    fn bit_time(&self) -> Time {
        BIT
    }
}

/// Frames that the controller keeps.
const FIFO: usize = 3;
/// What the transmit error counter grows by with an error, and above which the controller leaves the bus.
const ERROR: u32 = 8;
const OFF: u32 = 255;
/// Nobody's acknowledgement brings the counter here and no further.
const PASSIVE: u32 = 128;
/// A controller that joins again waits for 128 times 11 recessive bits.
const RECOVERY_US: u64 = 128 * 11;

/// The controller of the loops in virtual time: one mailbox, a memory of three frames, an error counter.
pub struct Controller {
    bus: Rc<RefCell<CanBus>>,
    state: RefCell<State>,
    clock: VirtualClock,
}

#[derive(Default)]
struct State {
    /// The frame that waits, and what became of it.
    own: Option<devices::CanFrame>,
    sent: Option<Result<(), CanError>>,
    fifo: VecDeque<CanFrame>,
    /// Frames for the board that found the memory full.
    overrun: u64,
    errors: u32,
    /// It has left the bus, and where it joins again, when its recovery ends.
    is_off: bool,
    recovers_us: Option<u64>,
    wakers: Vec<Waker>,
}

impl State {
    fn wake(&mut self) {
        self.wakers.drain(..).for_each(Waker::wake);
    }

    /// The filters of the board.
    fn receive(&mut self, frame: &devices::CanFrame) {
        let Some(frame) = of_board(frame) else { return };
        let id = frame.identifier();
        if id >> 5 != DEFAULT_NODE && id != STOP_ALL || self.is_off {
            return;
        }
        match self.fifo.len() < FIFO {
            true => self.fifo.push_back(frame),
            false => self.overrun += 1,
        }
    }

    fn end(&mut self, frame: &devices::CanFrame, outcome: Transmission) {
        // Given up meanwhile, it counts for nobody.
        if self.own != Some(*frame) {
            return;
        }
        match outcome {
            Transmission::Acknowledged => {
                self.errors = self.errors.saturating_sub(1);
                (self.own, self.sent) = (None, Some(Ok(())));
            }
            Transmission::NotAcknowledged => self.errors = (self.errors + ERROR).min(PASSIVE),
            Transmission::BitError => self.errors += ERROR,
        }
        if self.errors > OFF {
            self.is_off = true;
            (self.own, self.sent) = (None, Some(Err(CanError::BusOff)));
        }
    }
}

impl Controller {
    /// A controller on a bus.
    pub fn new(bus: Rc<RefCell<CanBus>>, clock: VirtualClock) -> Rc<Self> {
        Rc::new(Self {
            bus,
            state: RefCell::default(),
            clock,
        })
    }

    /// Whether it has left the bus.
    pub fn is_off(&self) -> bool {
        self.state.borrow().is_off
    }

    /// Frames for the board for which it had no place.
    pub fn overrun(&self) -> u64 {
        self.state.borrow().overrun
    }

    /// Carries frames between bus and board, for ever.
    pub async fn run(self: Rc<Self>) {
        loop {
            let now_us = self.clock.now_us();
            {
                let (mut bus, mut state) = (self.bus.borrow_mut(), self.state.borrow_mut());
                if state
                    .recovers_us
                    .take_if(|recovers_us| *recovers_us <= now_us)
                    .is_some()
                {
                    (state.is_off, state.errors) = (false, 0);
                }
                let now = Time::from_us(now_us);
                while let Some(event) = bus.take_event(now) {
                    match event {
                        CanEvent::Received(frame) => state.receive(&frame),
                        CanEvent::Sent(frame, outcome) => state.end(&frame, outcome),
                    }
                    bus.offer(now, state.own);
                }
                bus.offer(now, state.own);
                state.wake();
            }
            let next = self.bus.borrow().next_event();
            let recovers = self
                .state
                .borrow()
                .recovers_us
                .map_or(Time::NEVER, Time::from_us);
            let next = next.min(recovers);
            let until = async {
                match next {
                    Time::NEVER => std::future::pending().await,
                    // Frames end at whole microseconds.
                    next => self.clock.until(next.us()).await,
                }
            };
            embassy_futures::select::select(until, self.changed()).await;
        }
    }

    /// Waits until somebody puts a frame on the bus or offers one.
    async fn changed(&self) {
        let mut is_first = true;
        poll_fn(|context| {
            if !std::mem::take(&mut is_first) {
                return Poll::Ready(());
            }
            self.bus.borrow_mut().waker = Some(context.waker().clone());
            Poll::Pending
        })
        .await;
    }

    /// Waits until something is found in the controller.
    async fn found<T>(&self, mut look: impl FnMut(&mut State) -> Option<T>) -> T {
        poll_fn(|context| {
            let mut state = self.state.borrow_mut();
            match look(&mut state) {
                Some(found) => Poll::Ready(found),
                None => {
                    state.wakers.push(context.waker().clone());
                    Poll::Pending
                }
            }
        })
        .await
    }

    fn set_own(&self, frame: Option<devices::CanFrame>) {
        let mut state = self.state.borrow_mut();
        (state.own, state.sent) = (frame, None);
        drop(state);
        self.bus.borrow_mut().wake();
    }
}

/// Frames out.
pub struct Sender(pub Rc<Controller>);

impl CanSender for Sender {
    async fn send(&mut self, frame: &CanFrame) -> Result<(), CanError> {
        let controller = &self.0;
        if controller.is_off() {
            return Err(CanError::BusOff);
        }
        let frame = devices::CanFrame::standard(frame.identifier(), frame.data());
        controller.set_own(Some(frame));
        let _given_up = GiveUp(controller);
        controller.found(|state| state.sent.take()).await
    }

    fn rejoin(&mut self) {
        let mut state = self.0.state.borrow_mut();
        if state.is_off && state.recovers_us.is_none() {
            state.recovers_us = Some(self.0.clock.now_us() + RECOVERY_US);
        }
        drop(state);
        self.0.bus.borrow_mut().wake();
    }
}

/// Takes a frame back that nobody waits for any more.
struct GiveUp<'c>(&'c Controller);

impl Drop for GiveUp<'_> {
    fn drop(&mut self) {
        self.0.set_own(None);
    }
}

/// Frames in.
pub struct Receiver(pub Rc<Controller>);

impl CanReceiver for Receiver {
    async fn receive(&mut self) -> Result<CanFrame, CanError> {
        self.0
            .found(|state| match state.is_off {
                true => Some(Err(CanError::BusOff)),
                false => state.fifo.pop_front().map(Ok),
            })
            .await
    }
}

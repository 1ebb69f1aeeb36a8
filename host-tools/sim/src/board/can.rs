//! CAN bus with bit timing and arbitration. Its controller is that of the emulated chip, or [`CanController`] for the
//! firmware's tasks in virtual time.

use crate::board::clock::VirtualClock;
use embedded_can::{Frame as _, StandardId};
use emulator::Time;
use emulator::devices::{self, CanBus as _, CanEvent, Transmission};
use firmware::clock::Clock;
use firmware::protocol::can::{CanError, CanFrame, CanReceiver, CanSender};
use firmware::protocol::{DEFAULT_NODE, ESTOP_ALL_ID, frame_id};
use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::{Poll, Waker};

/// Bit time at 1 Mbit/s.
const BIT: Time = Time::from_us(1);

/// Bits of a frame with maximum stuffing: 13 bits of frame end and pause
/// are not stuffed, 34 bits around the data are.
const fn frame_bits(bytes: u64) -> u64 {
    let stuffed = 34 + 8 * bytes;
    13 + stuffed + (stuffed - 1) / 4
}

/// Frames of a flood that wait at most.
const FLOOD_QUEUE: usize = 50;

/// A frame in transmission.
#[derive(Clone, Copy, Debug)]
struct Transfer {
    frame: devices::CanFrame,
    /// Sent by the board.
    is_own: bool,
    ends: Time,
}

/// Simulated bus.
#[derive(Clone, Default)]
pub struct CanBus {
    /// Pending frame of the board's controller.
    offered: Option<devices::CanFrame>,
    /// Pending frames of other nodes.
    others: VecDeque<devices::CanFrame>,
    transfer: Option<Transfer>,
    events: VecDeque<CanEvent>,
    /// Disturbs every frame of the board.
    pub disturbed: bool,
    /// No other node acknowledges.
    pub no_acknowledge: bool,
    /// Frames of the board with their end times in microseconds.
    pub board_frames: Vec<(u64, CanFrame)>,
    /// The same of the other nodes, where somebody takes them.
    pub other_frames: Option<Vec<(u64, CanFrame)>>,
    waker: Option<Waker>,
}

impl CanBus {
    /// Queues a frame of another node.
    pub fn put(&mut self, frame: CanFrame) {
        self.put_any(devices::CanFrame::standard(frame.identifier(), frame.data()));
    }

    /// Queues a frame of another node, of any kind.
    pub fn put_any(&mut self, frame: devices::CanFrame) {
        self.others.push_back(frame);
        self.wake();
    }

    fn wake(&mut self) {
        if let Some(waker) = self.waker.take() {
            waker.wake();
        }
    }

    /// Queues frames of the shortest length without a message, up to `FLOOD_QUEUE` waiting ones.
    pub fn flood(&mut self, frames: u32) {
        let id = StandardId::new(frame_id(DEFAULT_NODE, 0x1F));
        let Some(frame) = id.and_then(|id| CanFrame::new(id, &[])) else { return };
        for _ in 0..frames {
            if self.waiting() < FLOOD_QUEUE {
                self.put(frame);
            }
        }
    }

    /// Frames of other nodes that wait.
    pub fn waiting(&self) -> usize {
        self.others.len()
    }

    /// Starts the frame of highest priority on an idle bus.
    fn begin(&mut self, time: Time) {
        if self.transfer.is_some() {
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
        self.transfer = Some(Transfer { frame, is_own, ends });
    }

    /// Completes a frame.
    fn end(&mut self, transfer: Transfer) {
        if !transfer.is_own {
            let received = self.other_frames.as_mut().zip(firmware_frame(&transfer.frame));
            if let Some((frames, frame)) = received {
                frames.push((transfer.ends.us(), frame));
            }
            self.events.push_back(CanEvent::Received(transfer.frame));
            return;
        }
        let outcome = match (self.disturbed, self.no_acknowledge) {
            (true, _) => Transmission::BitError,
            (false, true) => Transmission::NotAcknowledged,
            (false, false) => Transmission::Acknowledged,
        };
        if outcome == Transmission::Acknowledged
            && let Some(frame) = firmware_frame(&transfer.frame)
        {
            self.board_frames.push((transfer.ends.us(), frame));
        }
        // The controller offers it again after an error.
        self.offered = None;
        self.events.push_back(CanEvent::Sent(transfer.frame, outcome));
    }
}

/// Converts standard data frames.
fn firmware_frame(frame: &devices::CanFrame) -> Option<CanFrame> {
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
        self.transfer.as_ref().is_some_and(|transfer| transfer.is_own)
    }

    fn next_event(&self) -> Time {
        match &self.transfer {
            _ if !self.events.is_empty() => Time::ZERO,
            Some(transfer) => transfer.ends,
            None if self.others.is_empty() => Time::NEVER,
            // Starts with the next call.
            None => Time::ZERO,
        }
    }

    fn take_event(&mut self, time: Time) -> Option<CanEvent> {
        if let Some(transfer) = self.transfer.take_if(|transfer| transfer.ends <= time) {
            self.end(transfer);
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

/// Receive memory of the controller, in frames.
const FIFO: usize = 3;
/// Increment of the transmit error counter, and its limit for bus-off.
const ERROR: u32 = 8;
const OFF: u32 = 255;
/// Limit of the error counter for missing acknowledges.
const PASSIVE: u32 = 128;
/// Bus-off recovery time: 128 times 11 recessive bits.
const RECOVERY_US: u64 = 128 * 11;

/// CAN controller in virtual time: one mailbox, three receive frames, an error counter.
pub struct CanController {
    bus: Rc<RefCell<CanBus>>,
    state: RefCell<ControllerState>,
    clock: VirtualClock,
    /// Bus-off is reported as an error of one frame.
    pub hides_bus_off: Cell<bool>,
}

#[derive(Default)]
struct ControllerState {
    /// Pending frame and its result.
    own: Option<devices::CanFrame>,
    sent: Option<Result<(), CanError>>,
    fifo: VecDeque<CanFrame>,
    /// Received frames lost to a full memory.
    overrun: u64,
    errors: u32,
    /// Bus-off, and end of the recovery.
    is_off: bool,
    recovers_us: Option<u64>,
    wakers: Vec<Waker>,
}

impl ControllerState {
    fn wake(&mut self) {
        self.wakers.drain(..).for_each(Waker::wake);
    }

    /// Acceptance filters of the board.
    fn receive(&mut self, frame: &devices::CanFrame) {
        let Some(frame) = firmware_frame(frame) else {
            return;
        };
        let id = frame.identifier();
        if id >> 5 != DEFAULT_NODE && id != ESTOP_ALL_ID || self.is_off {
            return;
        }
        if self.fifo.len() < FIFO { self.fifo.push_back(frame) } else { self.overrun += 1 }
    }

    fn end(&mut self, frame: &devices::CanFrame, outcome: Transmission) {
        // An aborted frame is not counted.
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

impl CanController {
    /// Connects a controller.
    pub fn new(bus: Rc<RefCell<CanBus>>, clock: VirtualClock) -> Rc<Self> {
        let hides_bus_off = Cell::default();
        Rc::new(Self { bus, state: RefCell::default(), clock, hides_bus_off })
    }

    /// Whether the controller is bus-off.
    pub fn is_off(&self) -> bool {
        self.state.borrow().is_off
    }

    /// Received frames lost to a full memory.
    pub fn overrun(&self) -> u64 {
        self.state.borrow().overrun
    }

    /// Transfers frames between bus and board, forever.
    pub async fn run(self: Rc<Self>) {
        loop {
            let now_us = self.clock.now_us();
            {
                let (mut bus, mut state) = (self.bus.borrow_mut(), self.state.borrow_mut());
                if state.recovers_us.take_if(|recovers_us| *recovers_us <= now_us).is_some() {
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
            let recovers = self.state.borrow().recovers_us.map_or(Time::NEVER, Time::from_us);
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

    /// Waits for a new frame on the bus or in the mailbox.
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

    /// Waits for a condition of the controller.
    async fn wait_for<T>(&self, mut condition: impl FnMut(&mut ControllerState) -> Option<T>) -> T {
        poll_fn(|context| {
            let mut state = self.state.borrow_mut();
            match condition(&mut state) {
                Some(wait_for) => Poll::Ready(wait_for),
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

/// Transmit half of the controller.
pub struct CanTx(pub Rc<CanController>);

impl CanSender for CanTx {
    async fn send(&mut self, frame: &CanFrame) -> Result<(), CanError> {
        let controller = &self.0;
        let of_bus = |error| match error {
            CanError::BusOff if controller.hides_bus_off.get() => CanError::Transient,
            error => error,
        };
        if controller.is_off() {
            return Err(of_bus(CanError::BusOff));
        }
        let frame = devices::CanFrame::standard(frame.identifier(), frame.data());
        controller.set_own(Some(frame));
        let _abort = AbortOnDrop(controller);
        controller.wait_for(|state| state.sent.take()).await.map_err(of_bus)
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

/// Aborts a frame when its future is dropped.
struct AbortOnDrop<'c>(&'c CanController);

impl Drop for AbortOnDrop<'_> {
    fn drop(&mut self) {
        self.0.set_own(None);
    }
}

/// Receive half of the controller.
pub struct CanRx(pub Rc<CanController>);

impl CanReceiver for CanRx {
    async fn receive(&mut self) -> Result<CanFrame, CanError> {
        let controller = &self.0;
        controller
            .wait_for(|state| {
                if state.is_off && !controller.hides_bus_off.get() {
                    Some(Err(CanError::BusOff))
                } else {
                    state.fifo.pop_front().map(Ok)
                }
            })
            .await
    }
}

//! A simulated CAN bus: frames take their time, the lowest identifier goes first, errors count.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::{Poll, Waker};

use embedded_can::Frame;
use firmware::clock::{Clock, pause};
use firmware::wire::can::{CanError, CanFrame, CanReceiver, CanSender};
use firmware::wire::{DEFAULT_NODE, STOP_ALL};

use super::time::VirtualClock;

/// Bits of a frame with so many bytes at 1 Mbit/s, with as many stuffed ones as can be: an end of the frame
/// and a pause of 13 that are not stuffed, 34 around the data that are.
const fn frame_us(bytes: u64) -> u64 {
    let stuffed = 34 + 8 * bytes;
    13 + stuffed + (stuffed - 1) / 4
}

/// Frames that the controller keeps.
const FIFO: usize = 3;
/// What the transmit error counter grows by with an error, and above which the controller leaves.
const ERROR: u32 = 8;
const OFF: u32 = 255;
/// Nobody's acknowledgement brings the counter here and no further.
const PASSIVE: u32 = 128;
/// A controller that joins again waits for 128 times 11 recessive bits.
const JOIN_US: u64 = 128 * 11;

/// The bus and the controller on the board.
#[derive(Default)]
pub struct CanBus {
    /// The board's frame that waits, and what became of it.
    own: Option<CanFrame>,
    sent: Option<Result<(), CanError>>,
    /// Frames of others that wait.
    others: VecDeque<CanFrame>,
    /// The controller's memory.
    fifo: VecDeque<CanFrame>,
    /// Frames for the board that found it full.
    pub overrun: u64,
    /// Every bit that the board sends is disturbed.
    pub disturbed: bool,
    /// Nobody else is on the bus.
    pub alone: bool,
    errors: u32,
    joins_us: u64,
    /// What the board sent, and when it was over.
    pub heard: Vec<(u64, CanFrame)>,
    wakers: Vec<Waker>,
}

impl CanBus {
    /// A frame of somebody else.
    pub fn put(&mut self, frame: CanFrame) {
        self.others.push_back(frame);
        self.wake();
    }

    /// Frames of others that wait.
    pub fn waiting(&self) -> usize {
        self.others.len()
    }

    /// A frame of the board.
    fn offer(&mut self, frame: CanFrame) {
        self.own = Some(frame);
        self.sent = None;
        self.wake();
    }

    fn wake(&mut self) {
        self.wakers.drain(..).for_each(Waker::wake);
    }

    /// Whether the board's controller has left the bus.
    pub fn is_off(&self) -> bool {
        self.errors > OFF
    }

    /// The filters of the board.
    fn receive(&mut self, frame: CanFrame) {
        let id = frame.identifier();
        if id >> 5 != DEFAULT_NODE && id != STOP_ALL {
            return;
        }
        match self.fifo.len() < FIFO && !self.is_off() {
            true => self.fifo.push_back(frame),
            false => self.overrun += 1,
        }
    }
}

/// Waits until `look` finds something on the bus.
async fn found<T>(bus: &RefCell<CanBus>, mut look: impl FnMut(&mut CanBus) -> Option<T>) -> T {
    poll_fn(|context| {
        let mut bus = bus.borrow_mut();
        match look(&mut bus) {
            Some(found) => Poll::Ready(found),
            None => {
                bus.wakers.push(context.waker().clone());
                Poll::Pending
            }
        }
    })
    .await
}

/// The bus itself: lets one frame pass after the other, for ever.
pub async fn pass(bus: Rc<RefCell<CanBus>>, clock: VirtualClock) {
    loop {
        let (frame, own) = found(&bus, |bus| {
            let other = bus.others.front().copied();
            match (bus.own, other) {
                (Some(own), Some(other)) if own.identifier() <= other.identifier() => {
                    Some((own, true))
                }
                (_, Some(other)) => Some((other, false)),
                (Some(own), None) => Some((own, true)),
                (None, None) => None,
            }
        })
        .await;
        pause(&clock, frame_us(frame.dlc() as u64)).await;
        let mut bus = bus.borrow_mut();
        match own {
            true => transmitted(&mut bus, frame, clock.now_us()),
            false => {
                bus.others.pop_front();
                bus.receive(frame);
            }
        }
        bus.wake();
    }
}

/// The board's frame has passed, or has not.
fn transmitted(bus: &mut CanBus, frame: CanFrame, now_us: u64) {
    // Given up meanwhile: it has left the controller, and counts for nobody.
    if bus.own != Some(frame) {
        return;
    }
    if bus.disturbed {
        bus.errors += ERROR;
    } else if bus.alone {
        bus.errors = (bus.errors + ERROR).min(PASSIVE);
    } else {
        bus.errors = bus.errors.saturating_sub(1);
        bus.own = None;
        bus.sent = Some(Ok(()));
        bus.heard.push((now_us, frame));
        return;
    }
    if bus.is_off() {
        bus.own = None;
        bus.sent = Some(Err(CanError::BusOff));
    }
}

/// Frames out.
pub struct Sender {
    /// The bus.
    pub bus: Rc<RefCell<CanBus>>,
    /// Time.
    pub clock: VirtualClock,
}

impl CanSender for Sender {
    async fn send(&mut self, frame: &CanFrame) -> Result<(), CanError> {
        let joins_us = {
            let bus = self.bus.borrow();
            if bus.is_off() {
                return Err(CanError::BusOff);
            }
            bus.joins_us
        };
        self.clock.until(joins_us).await;
        self.bus.borrow_mut().offer(*frame);
        let _given_up = GiveUp(&self.bus);
        found(&self.bus, |bus| bus.sent.take()).await
    }

    fn rejoin(&mut self) {
        let mut bus = self.bus.borrow_mut();
        if bus.is_off() {
            bus.errors = 0;
            bus.joins_us = self.clock.now_us() + JOIN_US;
        }
    }
}

/// Takes a frame back that nobody waits for any more.
struct GiveUp<'b>(&'b RefCell<CanBus>);

impl Drop for GiveUp<'_> {
    fn drop(&mut self) {
        self.0.borrow_mut().own = None;
    }
}

/// Frames in.
pub struct Receiver(pub Rc<RefCell<CanBus>>);

impl CanReceiver for Receiver {
    async fn receive(&mut self) -> Result<CanFrame, CanError> {
        found(&self.0, |bus| match bus.is_off() {
            true => Some(Err(CanError::BusOff)),
            false => bus.fifo.pop_front().map(Ok),
        })
        .await
    }
}

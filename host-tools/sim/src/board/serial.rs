//! Serial line. Its port is that of the emulated chip, or [`SerialTx`] and [`SerialRx`] for tasks in virtual time.
//!

use crate::board::clock::VirtualClock;
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use emulator::Time;
use emulator::devices::SerialLine;
use firmware::clock::delay_us;
use firmware::protocol::serial::BAUD_RATE;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::future::poll_fn;
use std::rc::Rc;
use std::task::{Poll, Waker};

/// Duration of bytes with start and stop bits, in microseconds, rounded up.
fn duration_us(bytes: usize) -> u64 {
    (10_000_000 * bytes as u64).div_ceil(u64::from(BAUD_RATE))
}

/// Receive memory of the port in virtual time.
const RX_BYTES: usize = 512;

/// Both directions of the line.
#[derive(Clone, Default)]
pub struct SerialLink {
    /// Bytes from the board.
    pub sent: Vec<u8>,
    /// End time of each zero byte, which ends a packet; of an emulated port only.
    pub ended: Vec<Time>,
    received: VecDeque<u8>,
    waker: Option<Waker>,
}

impl SerialLink {
    /// Bytes that wait for the board.
    pub fn waiting(&self) -> usize {
        self.received.len()
    }

    /// Sends a byte to the board.
    pub fn put(&mut self, byte: u8) {
        self.received.push_back(byte);
        if let Some(waker) = self.waker.take() {
            waker.wake();
        }
    }
}

impl SerialLine for SerialLink {
    fn receive(&mut self, time: Time, byte: u8) {
        if byte == 0 {
            self.ended.push(time);
        }
        self.sent.push(byte);
    }

    fn next_byte(&self) -> Time {
        if self.received.is_empty() { Time::NEVER } else { Time::ZERO }
    }

    fn transmit(&mut self, _: Time) -> Option<u8> {
        self.received.pop_front()
    }

    fn baud_rate(&self) -> u32 {
        BAUD_RATE
    }
}

/// Transmit half of the port.
pub struct SerialTx {
    /// Line.
    pub line: Rc<RefCell<SerialLink>>,
    /// Virtual time.
    pub clock: VirtualClock,
}

impl ErrorType for SerialTx {
    type Error = Infallible;
}

impl Write for SerialTx {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        delay_us(&self.clock, duration_us(bytes.len())).await;
        self.line.borrow_mut().sent.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Receive half of the port.
pub struct SerialRx(pub Rc<RefCell<SerialLink>>);

impl ErrorType for SerialRx {
    type Error = ErrorKind;
}

impl Read for SerialRx {
    async fn read(&mut self, bytes: &mut [u8]) -> Result<usize, ErrorKind> {
        poll_fn(|context| {
            let mut line = self.0.borrow_mut();
            if line.received.len() > RX_BYTES {
                line.received.clear();
                return Poll::Ready(Err(ErrorKind::Other));
            }
            if line.received.is_empty() {
                line.waker = Some(context.waker().clone());
                return Poll::Pending;
            }
            let count = bytes.len().min(line.received.len());
            for (byte, received) in bytes.iter_mut().zip(line.received.drain(..count)) {
                *byte = received;
            }
            Poll::Ready(Ok(count))
        })
        .await
    }
}
